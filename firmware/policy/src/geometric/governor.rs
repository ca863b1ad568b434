//! The speed governor: the fastest forward speed from which the vehicle can still stop clear of everything it knows.
//!
//! For each candidate speed the vehicle is simulated: a short time under the command, then braking to a stop. A
//! candidate is admissible if no point of the scan and no remembered obstacle comes too near on the way (the admissible
//! velocities of the dynamic window approach; Fox, Burgard, Thrun 1997).

use crate::geometric::occupancy_grid::OccupancyGrid;
use crate::geometric::range_scan::{SECTORS, Scan};
use crate::smaller;
use vigil_types::{ACTION_LIMIT, HeadingVector, NedVector};

/// Distance kept between the vehicle's middle and any point seen: its radius of 0.30 m and 0.15 m.
const KEEP_CLEAR_M: f32 = 0.45;
/// The same for what is remembered, which is known to a cell only; squared cells, 0.50 m.
const KEEP_CLEAR_SQUARED_CELLS: u8 = 4;
/// Where even stopping does not keep that, the vehicle may squeeze through slowly with less.
const SQUEEZE_CLEAR_M: f32 = 0.37;
const SQUEEZE_SQUARED_CELLS: u8 = 2;
const SQUEEZE_SPEED_M_S: f32 = 0.3;
/// A point that is too near already must not get nearer; this much is noise.
const CREEP_M: f32 = 0.005;
/// Time under the command before braking begins: a step, the frame's age and the estimator's delay.
pub(super) const REACTION_S: f32 = 0.2;
/// Simulation step and number of steps: until nearly all of the speed is gone.
pub(super) const STEP_S: f32 = 0.1;
const STEPS: usize = 18;
/// Share of the way to its setpoint that the velocity goes in one step: 1 − e^(−0.1 s / 0.7 s). A lag of 0.7 s stops from
/// 1.5 m/s in 1.05 m; measured: 1.07 m.
const GAIN: f32 = 0.133_122;
/// Speeds tried, as parts of the wanted one.
const PARTS: [f32; 7] = [1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1];

/// What the governor needs to know of the vehicle.
#[derive(Debug, Clone, Copy, Default)]
pub struct Motion {
    /// Position now.
    pub position_ned_m: NedVector,
    /// Heading now, radians clockwise from north.
    pub yaw_rad: f32,
    /// Velocity now.
    pub velocity_m_s: HeadingVector,
    /// Yaw rate commanded, radians per second clockwise.
    pub yaw_rate_rad_s: f32,
}

/// The vehicle as it is simulated, in level axes: its velocity lags behind the command along its nose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Simulated {
    /// Position, metres.
    pub at: (f32, f32),
    /// Unit vector of the nose.
    pub nose: (f32, f32),
    velocity: (f32, f32),
    /// Sine and cosine of the turn in a step.
    turn: (f32, f32),
}

impl Simulated {
    pub(super) fn new(at: (f32, f32), nose: (f32, f32), velocity: (f32, f32), yaw_rate_rad_s: f32) -> Self {
        let turn_rad = yaw_rate_rad_s * STEP_S;
        Self {
            at,
            nose,
            velocity,
            turn: (libm::sinf(turn_rad), libm::cosf(turn_rad)),
        }
    }

    /// Turns for a step.
    #[inline]
    pub(super) fn turn(&mut self) {
        let ((x, y), (sin, cos)) = (self.nose, self.turn);
        self.nose = (x * cos - y * sin, x * sin + y * cos);
    }

    /// Flies for a step at this commanded speed.
    #[inline]
    pub(super) fn advance(&mut self, forward_m_s: f32) {
        let (vx, vy) = self.velocity;
        let change_x = (forward_m_s * self.nose.0 - vx) * GAIN;
        let change_y = (forward_m_s * self.nose.1 - vy) * GAIN;
        self.at.0 += (vx + 0.5 * change_x) * STEP_S;
        self.at.1 += (vy + 0.5 * change_y) * STEP_S;
        self.velocity = (vx + change_x, vy + change_y);
    }
}

/// What must stay free around the vehicle's middle on its way: the squared distance to each point of the scan, and the
/// squared clearance in the memory, cells.
type Margins = ([f32; SECTORS], u8);

/// These distances, or the present ones where they are less: what is too near already must not get nearer.
fn margins(scan: &Scan, memory: &OccupancyGrid, at: NedVector, keep_m: f32, keep_squared_cells: u8) -> Margins {
    let squared_m2 = scan.range_m.map(|range_m| {
        let keep_m = keep_m.min(range_m - CREEP_M).max(0.0);
        keep_m * keep_m
    });
    let squared_cells = memory.clearance_squared_at(at.x, at.y).min(keep_squared_cells);
    (squared_m2, squared_cells)
}

/// The fastest admissible forward speed up to `wanted_m_s`; 0 if none is.
pub fn admissible_speed_m_s(motion: &Motion, scan: &Scan, memory: &OccupancyGrid, wanted_m_s: f32) -> f32 {
    let wanted_m_s = wanted_m_s.clamp(0.0, ACTION_LIMIT);
    let here = motion.position_ned_m;
    let clear = margins(scan, memory, here, KEEP_CLEAR_M, KEEP_CLEAR_SQUARED_CELLS);
    let free = PARTS
        .iter()
        .map(|part| part * wanted_m_s)
        .find(|&speed_m_s| stays_clear(motion, scan, &clear, memory, speed_m_s, REACTION_S));
    if let Some(speed_m_s) = free {
        return speed_m_s;
    }
    let squeezed = margins(scan, memory, here, SQUEEZE_CLEAR_M, SQUEEZE_SQUARED_CELLS);
    let slow_m_s = smaller(wanted_m_s, SQUEEZE_SPEED_M_S);
    if stays_clear(motion, scan, &squeezed, memory, slow_m_s, REACTION_S) {
        slow_m_s
    } else {
        0.0
    }
}

/// Whether the vehicle, commanded this speed for `carried_s` and then to stop, would run into what is remembered.
///
/// Only its own cell counts: with a cell more around it, pilots that pass half a metre beside an obstacle would be stopped for it.
pub fn on_collision_course(motion: &Motion, memory: &OccupancyGrid, speed_m_s: f32, carried_s: f32) -> bool {
    const NOTHING_SEEN: &Scan = &Scan::EMPTY;
    let own = margins(NOTHING_SEEN, memory, motion.position_ned_m, 0.0, 1);
    !stays_clear(motion, NOTHING_SEEN, &own, memory, speed_m_s, carried_s)
}

/// Whether the vehicle stays clear if it is commanded this speed for `carried_s` and then to stop.
fn stays_clear(
    motion: &Motion,
    scan: &Scan,
    (squared_m2, squared_cells): &Margins,
    memory: &OccupancyGrid,
    speed_m_s: f32,
    carried_s: f32,
) -> bool {
    let (yaw_sin, yaw_cos) = (libm::sinf(motion.yaw_rad), libm::cosf(motion.yaw_rad));
    let start = (motion.velocity_m_s.x, motion.velocity_m_s.y);
    let mut vehicle = Simulated::new((0.0, 0.0), (1.0, 0.0), start, motion.yaw_rate_rad_s);
    for step in 0..STEPS {
        vehicle.turn();
        vehicle.advance(if (step as f32) * STEP_S < carried_s {
            speed_m_s
        } else {
            0.0
        });
        let (x, y) = vehicle.at;
        let mut least = f32::INFINITY;
        for ((px, py), limit) in scan.forward_m.iter().zip(&scan.right_m).zip(squared_m2) {
            let (dx, dy) = (px - x, py - y);
            least = smaller(least, dx * dx + dy * dy - limit);
        }
        if least < 0.0 {
            return false;
        }
        let north_m = motion.position_ned_m.x + yaw_cos * x - yaw_sin * y;
        let east_m = motion.position_ned_m.y + yaw_sin * x + yaw_cos * y;
        if memory.clearance_squared_at(north_m, east_m) < *squared_cells {
            return false;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;

    /// A scan of points (forward, right).
    fn scan_of(points: &[(f32, f32)]) -> Scan {
        let mut scan = Scan::EMPTY;
        for (i, &(x, y)) in points.iter().enumerate() {
            scan.forward_m[i] = x;
            scan.right_m[i] = y;
            scan.range_m[i] = libm::sqrtf(x * x + y * y);
        }
        scan
    }

    fn speed(points: &[(f32, f32)], velocity_m_s: f32, yaw_rate_rad_s: f32) -> f32 {
        let motion = Motion {
            velocity_m_s: HeadingVector::new(velocity_m_s, 0.0, 0.0),
            yaw_rate_rad_s,
            ..Motion::default()
        };
        admissible_speed_m_s(&motion, &scan_of(points), &Box::<OccupancyGrid>::default(), 1.5)
    }

    #[test]
    fn nothing_near_is_full_speed() {
        assert_eq!(speed(&[], 1.5, 0.0), 1.5);
        assert_eq!(speed(&[(1.0, 0.6), (2.0, -0.7), (5.0, 0.0)], 1.5, 0.0), 1.5);
    }

    #[test]
    fn a_surface_ahead_slows_and_stops_the_vehicle_in_time() {
        let mut last = 1.5;
        // Driven by the governor alone towards a wall, with the lag that it assumes.
        let (mut x, mut v) = (0.0_f32, 0.0_f32);
        for _ in 0..400 {
            let wall: [(f32, f32); 9] = core::array::from_fn(|i| (5.0 - x, (i as f32 - 4.0) * 0.2));
            last = speed(&wall, v, 0.0);
            for _ in 0..5 {
                v += (last - v) * 0.01 / 0.7;
                x += v * 0.01;
            }
        }
        let left_m = 5.0 - x;
        let stops = (SQUEEZE_CLEAR_M..KEEP_CLEAR_M).contains(&left_m);
        assert!(stops && last < 0.16, "stopped {left_m} m before the wall");
    }

    #[test]
    fn braking_begins_no_later_than_the_real_stopping_distance() {
        // Measured: 1.07 m from 1.5 m/s, and the vehicle's own 0.30 m.
        assert!(speed(&[(1.07 + 0.30, 0.0)], 1.5, 0.0) < 0.5);
    }

    #[test]
    fn turning_away_is_faster_than_going_on() {
        let pillar = [(1.2, 0.35), (1.3, 0.3)];
        let (turning, straight) = (speed(&pillar, 1.0, -0.78), speed(&pillar, 1.0, 0.0));
        assert!(turning > straight, "{turning} {straight}");
    }

    #[test]
    fn what_is_too_near_already_may_be_left_but_not_approached() {
        let beside = [(0.0, 0.38), (0.05, 0.38)];
        assert!(speed(&beside, 0.0, 0.0) > 1.0, "past it");
        assert_eq!(speed(&[(0.38, 0.0)], 0.0, 0.0), 0.0, "into it");
    }

    #[test]
    fn a_collision_course_is_one_that_braking_does_not_end() {
        let memory = OccupancyGrid::of((-4..=4).map(|i| (1.6, i as f32 * 0.25)));
        let carried = |carried_s: f32, north_m: f32, velocity_m_s: f32, yaw_rad: f32, wanted_m_s: f32| {
            let motion = Motion {
                position_ned_m: NedVector::new(north_m, 0.0, 0.0),
                yaw_rad,
                velocity_m_s: HeadingVector::new(velocity_m_s, 0.0, 0.0),
                ..Motion::default()
            };
            on_collision_course(&motion, &memory, wanted_m_s, carried_s)
        };
        let course = |north_m, velocity_m_s, yaw_rad, wanted_m_s| {
            carried(REACTION_S, north_m, velocity_m_s, yaw_rad, wanted_m_s)
        };
        assert!(!course(0.0, 1.5, 0.0, 1.5), "1.6 m are enough to stop from 1.5 m/s");
        assert!(course(0.5, 1.5, 0.0, 1.5), "1.1 m and the reaction are not");
        assert!(
            carried(0.7, 0.0, 1.5, 0.0, 1.5),
            "nor are 1.6 m to whoever goes on for 0.7 s"
        );
        assert!(!course(0.5, 0.7, 0.0, 0.7), "at half the speed they are");
        assert!(!course(0.5, 1.5, 3.1, 1.5), "away from it");
        // Along it, half a metre beside.
        assert!(!course(1.1, 1.5, 1.57, 1.5));
    }

    #[test]
    fn remembered_obstacles_count_without_being_seen() {
        let memory = OccupancyGrid::of([-0.3, -0.1, 0.1, 0.3].map(|east| (0.8, east)));
        let motion = Motion {
            velocity_m_s: HeadingVector::new(0.5, 0.0, 0.0),
            ..Motion::default()
        };
        let toward = admissible_speed_m_s(&motion, &Scan::EMPTY, &memory, 1.5);
        let away = admissible_speed_m_s(&Motion { yaw_rad: 3.0, ..motion }, &Scan::EMPTY, &memory, 1.5);
        assert!(toward < 1.0 && away == 1.5, "{toward} {away}");
    }
}
