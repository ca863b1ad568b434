//! Obstacles that go to and fro along a line.

use crate::world::solid::{Solid, radians};
use vigil_types::settings::{free, required};
use vigil_types::{Nanos, settings};

/// No mover may be faster: the pace of somebody who walks slowly.
pub const MAX_MOVER_SPEED_M_S: f32 = 1.0;

settings! {
    /// A column or box on the ground that goes to and fro between two points at constant speed, turning at once at each end.
    #[derive(Copy)]
    pub struct Mover {
        /// One end of the way of its centre, `[north, east]` of home.
        pub from_m: [f32; 2] = required(),
        /// Other end, `[north, east]` of home.
        pub to_m: [f32; 2] = required(),
        /// Speed along the way, at most [`MAX_MOVER_SPEED_M_S`].
        pub speed_m_s: f32 = required(),
        /// Where it is at time zero, as a share of one way to and fro: 0 at `from_m`, 0.5 at `to_m`, 0.75 half-way back.
        pub phase: f32 = free(0.0),
        /// Height.
        pub height_m: f32 = required(),
        /// Outline.
        pub shape: MoverShape = required(),
    }

    /// The outline of a [`Mover`]: exactly one of these.
    #[derive(Copy)]
    pub struct MoverShape {
        /// An upright cylinder.
        pub column: Option<ColumnOutline> = free(None),
        /// A box.
        pub cuboid: Option<BoxOutline> = free(None) => "box",
    }

    /// The outline of an upright cylinder.
    #[derive(Copy)]
    pub struct ColumnOutline {
        /// Radius.
        pub radius_m: f32 = required(),
    }

    /// The outline of a box, which does not turn while it moves.
    #[derive(Copy)]
    pub struct BoxOutline {
        /// Size along the box's own heading.
        pub length_m: f32 = required(),
        /// Size across it.
        pub width_m: f32 = required(),
        /// Heading of the length axis.
        pub yaw_deg: f32 = free(0.0),
    }
}

impl Mover {
    /// Length of its way in one direction.
    pub fn length_m(&self) -> f32 {
        libm::hypotf(self.to_m[0] - self.from_m[0], self.to_m[1] - self.from_m[1])
    }

    /// Time for one way to and fro.
    pub fn period_s(&self) -> f64 {
        2.0 * f64::from(self.length_m()) / f64::from(self.speed_m_s)
    }

    /// Seconds from `at_ns` until it turns at an end of its way.
    pub fn turns_in_s(&self, at_ns: Nanos) -> f32 {
        let halves = 2.0 * (at_ns as f64 * 1e-9 / self.period_s() + f64::from(self.phase));
        ((1.0 - (halves - libm::floor(halves))) * 0.5 * self.period_s()) as f32
    }

    /// Its geometry at `at_ns` of simulated time.
    pub fn solid_at(&self, at_ns: Nanos) -> Solid {
        let [north_m, east_m] = self.centre_at_m(at_ns);
        match self.shape.cuboid {
            None => Solid::cylinder((north_m, east_m), self.radius_m(), self.height_m),
            Some(outline) => Solid::cuboid(
                (north_m, east_m),
                [outline.length_m, outline.width_m],
                [0.0, self.height_m],
                radians(outline.yaw_deg),
            ),
        }
    }

    /// Of a column.
    fn radius_m(&self) -> f32 {
        self.shape.column.map_or(0.0, |column| column.radius_m)
    }

    /// In double precision, so that an hour of nanoseconds keeps its last digit.
    fn centre_at_m(&self, at_ns: Nanos) -> [f32; 2] {
        let turns = at_ns as f64 * 1e-9 / self.period_s() + f64::from(self.phase);
        let share = turns - libm::floor(turns);
        let along = if share < 0.5 { 2.0 * share } else { 2.0 - 2.0 * share };
        [0, 1].map(|k| {
            let (from, to) = (f64::from(self.from_m[k]), f64::from(self.to_m[k]));
            (from + along * (to - from)) as f32
        })
    }

    /// A box that holds the mover at all times.
    pub fn track(&self) -> Solid {
        // Half of the outline's size along the way and across it.
        let (along_m, across_m) = match self.shape.cuboid {
            None => (self.radius_m(), self.radius_m()),
            Some(outline) => {
                let heading_rad = libm::atan2f(self.to_m[1] - self.from_m[1], self.to_m[0] - self.from_m[0]);
                let turn = radians(outline.yaw_deg) - heading_rad;
                let (s, c) = (libm::sinf(turn).abs(), libm::cosf(turn).abs());
                let (length_m, width_m) = (outline.length_m, outline.width_m);
                (0.5 * (c * length_m + s * width_m), 0.5 * (s * length_m + c * width_m))
            }
        };
        Solid::along(self.from_m, self.to_m, along_m, 2.0 * across_m, self.height_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: Nanos = 1_000_000_000;

    fn column() -> Mover {
        Mover {
            from_m: [5.0, -1.0],
            to_m: [5.0, 3.0],
            speed_m_s: 0.5,
            phase: 0.0,
            height_m: 2.0,
            shape: MoverShape {
                column: Some(ColumnOutline { radius_m: 0.3 }),
                cuboid: None,
            },
        }
    }

    #[test]
    fn a_mover_goes_to_its_end_and_back_in_one_period() {
        let m = column();
        assert_eq!(m.period_s(), 16.0);
        for (at_s, east_m) in [(0, -1.0), (4, 1.0), (8, 3.0), (10, 2.0), (16, -1.0), (1604, 1.0)] {
            let centre = m.solid_at(at_s * S).centre_ned_m();
            assert!((centre.y - east_m).abs() < 1e-5, "{at_s} s: {centre:?}");
            assert_eq!((centre.x, centre.z), (5.0, -1.0));
        }
        let later = Mover { phase: 0.75, ..m };
        assert!((later.solid_at(0).centre_ned_m().y - 1.0).abs() < 1e-6);
        assert!((later.solid_at(S).centre_ned_m().y - 0.5).abs() < 1e-6);
    }

    #[test]
    fn no_mover_leaves_its_track_or_is_faster_than_it_says() {
        let boxy = Mover {
            to_m: [8.0, 1.0],
            phase: 0.3,
            shape: MoverShape {
                column: None,
                cuboid: Some(BoxOutline {
                    length_m: 1.4,
                    width_m: 0.5,
                    yaw_deg: 35.0,
                }),
            },
            ..column()
        };
        for m in [column(), boxy] {
            let track = m.track();
            let mut last = m.solid_at(0).centre_ned_m();
            for k in 1..400 {
                let solid = m.solid_at(k * S / 10);
                let centre = solid.centre_ned_m();
                assert!((centre - last).norm() <= 0.1 * m.speed_m_s + 1e-5);
                last = centre;
                let corners = solid.plan_rectangle().map_or_else(Vec::new, |r| r.corners().to_vec());
                for [n, e] in corners.into_iter().chain([[centre.x, centre.y]]) {
                    assert!(track.plan_distance_m(n, e) < 1e-4, "{m:?} at {n} {e}");
                }
            }
        }
    }
}
