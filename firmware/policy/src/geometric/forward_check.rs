//! What lies on a vehicle's course, whoever flies it and wherever its nose points: the grid of what was seen, along the velocity.

use crate::geometric::occupancy_grid::{CELL_M, HIT, OccupancyGrid};
use crate::geometric::position_ned_m;
use crate::geometric::range_scan::{RangeScan, Scan};
use crate::{PilotInput, smaller};
use vigil_types::{Nanos, NedVector};

/// Kept between the vehicle's middle and what is remembered, cells: 0.50 m, its radius of 0.30 m and a cell's error.
const KEEP_CLEAR_CELLS: f32 = 2.0;
const KEEP_CLEAR_SQUARED: u8 = (KEEP_CLEAR_CELLS * KEEP_CLEAR_CELLS) as u8;
const KEEP_CLEAR_M: f32 = KEEP_CLEAR_CELLS * CELL_M;
/// Something that has come no nearer for so many metres of the course lies beside it: cells are coarse.
const PASSES_M: f32 = 2.0 * CELL_M;
/// The course is looked at this often, metres: no cell is passed over.
const LOOK_EVERY_M: f32 = CELL_M / 2.0;

/// The velocity of an estimate that drifts is off by so much, metres per second, and its course by no more than the angle, radians.
const DRIFTS_M_S: f32 = 0.4;
const DRIFTS_RAD: f32 = 0.25;
/// Slower than this a vehicle is on no course, metres per second.
const SLOWEST_M_S: f32 = 0.1;

/// A course may lie so far aside of the reported one, to both sides: more is kept clear of what is farther ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aside {
    /// Radians.
    rad: f32,
    /// At the most, metres; with what is kept clear besides no more than the 1.5 m that the grid's clearance shows.
    most_m: f32,
}

impl Aside {
    /// The velocity turns by some 0.1 rad before the vehicle is there.
    pub const TURNS: Self = Self { rad: 0.1, most_m: 0.5 };

    /// And an estimate that disagrees with itself drifts, of a vehicle of this speed, metres per second: PX4's in SIH by 0.4 m/s for some
    /// seconds as it begins to move, its heading by 3° (docs/foreign-vehicles.md).
    pub fn drifts(speed_m_s: f32) -> Self {
        Self {
            rad: (DRIFTS_M_S / speed_m_s.max(SLOWEST_M_S)).clamp(Self::TURNS.rad, DRIFTS_RAD),
            most_m: 1.0,
        }
    }
}

/// The grid and what fills it; by default nothing. Fixed size, no allocation.
#[derive(Debug, Clone, Default)]
pub struct ForwardCheck {
    surroundings: RangeScan,
    grid: OccupancyGrid,
    last_stamp_ns: Option<Nanos>,
}

impl ForwardCheck {
    /// Farther than this, metres, nothing is entered into the grid, and nothing is looked for.
    pub const FARTHEST_M: f32 = 11.0;

    /// Enters what a frame shows; the same frame again changes nothing. The input's goal is not looked at.
    pub fn observe(&mut self, input: &PilotInput<'_>) {
        let here = position_ned_m(input);
        self.surroundings.observe(input);
        self.grid.follow(here);
        let stamp_ns = input.depth.header.stamp_ns;
        if self.last_stamp_ns.replace(stamp_ns) != Some(stamp_ns) {
            let yaw_rad = input.attitude.yaw_rad();
            self.grid
                .observe(self.surroundings.scan(), HIT, here, yaw_rad, |_, _| false);
            self.grid.measure_clearance();
        }
    }

    /// Metres along the velocity, which may lie aside, to where the vehicle would come too near to something that was seen, within
    /// `reach_m`. What is too near already must not get nearer.
    pub fn obstacle_ahead_m(
        &self,
        here_ned_m: NedVector,
        velocity_ned_m_s: NedVector,
        reach_m: f32,
        aside: Aside,
    ) -> Option<f32> {
        let speed_m_s = velocity_ned_m_s.horizontal_norm();
        if speed_m_s <= 0.0 || !here_ned_m.is_finite() {
            return None;
        }
        let (north, east) = (velocity_ned_m_s.x / speed_m_s, velocity_ned_m_s.y / speed_m_s);
        let clearance = |ahead_m: f32| {
            self.grid
                .clearance_squared_at(here_ned_m.x + north * ahead_m, here_ned_m.y + east * ahead_m)
        };
        let here = clearance(0.0);
        // What is too near already must not get nearer, until it is left behind.
        let mut leaves = here < KEEP_CLEAR_SQUARED;
        let mut keep = KEEP_CLEAR_SQUARED;
        let looks = (smaller(reach_m + KEEP_CLEAR_M + PASSES_M, Self::FARTHEST_M) / LOOK_EVERY_M) as usize;
        let mut look_at_m = (1..=looks).map(|look| look as f32 * LOOK_EVERY_M);
        let blocked_m = look_at_m.find(|ahead_m| {
            let there = clearance(*ahead_m);
            leaves &= there < KEEP_CLEAR_SQUARED;
            keep = if leaves { here } else { here.max(KEEP_CLEAR_SQUARED) };
            let cells = KEEP_CLEAR_CELLS + smaller(aside.rad * *ahead_m, aside.most_m) / CELL_M;
            there < keep.min((cells * cells) as u8)
        })?;
        let touched = keep.min(KEEP_CLEAR_SQUARED);
        // The wider berth is one to the sides: what lies ahead is reached where it is touched. What is passed within it is touched, if the
        // course leads to it, that much before it is passed.
        let mut least = (clearance(blocked_m), blocked_m);
        for ahead_m in look_at_m {
            if least.0 < touched || ahead_m > least.1 + PASSES_M {
                break;
            }
            let there = clearance(ahead_m);
            if there < least.0 {
                least = (there, ahead_m);
            }
        }
        let at_m = if least.0 < touched {
            least.1
        } else {
            (least.1 - KEEP_CLEAR_M).max(blocked_m)
        };
        (at_m <= reach_m).then_some(at_m)
    }

    /// The surroundings as they were last seen.
    pub fn scan(&self) -> &Scan {
        self.surroundings.scan()
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.grid.clear();
        self.last_stamp_ns = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;

    fn seen(places: &[(f32, f32)]) -> Box<ForwardCheck> {
        let grid = *OccupancyGrid::of(places.iter().copied());
        Box::new(ForwardCheck {
            grid,
            ..ForwardCheck::default()
        })
    }

    #[test]
    fn what_lies_on_the_course_counts_and_what_lies_beside_it_does_not_wherever_the_nose_points() {
        let forward_check = seen(&[(5.1, 0.1), (0.1, -6.1)]);
        let ahead = |north: f32, east: f32, reach_m: f32| {
            forward_check.obstacle_ahead_m(NedVector::ZERO, NedVector::new(north, east, 0.0), reach_m, Aside::TURNS)
        };
        let found_m = ahead(2.0, 0.0, 9.0).expect("something");
        assert!((4.2..4.9).contains(&found_m), "{found_m}");
        assert_eq!(ahead(2.0, 0.0, 4.0), None, "beyond the reach");
        let found_m = ahead(0.0, -0.5, 9.0).expect("something");
        assert!((5.2..5.9).contains(&found_m), "{found_m}");
        assert_eq!(ahead(2.0, 2.0, 9.0), None);
        assert_eq!(ahead(0.0, 0.0, 9.0), None, "it stands");
    }

    /// A course 5 m ahead is asked for 1 m on both sides, and for 1.5 m where its estimate drifts: not in front.
    #[test]
    fn the_wider_berth_far_ahead_is_one_to_the_sides() {
        let course = NedVector::new(2.0, 0.0, 0.0);
        let ahead = |east_m: f32, reach_m: f32, aside: Aside| {
            seen(&[(8.1, east_m)]).obstacle_ahead_m(NedVector::ZERO, course, reach_m, aside)
        };
        for aside in [Aside::TURNS, Aside::drifts(2.0)] {
            // Before it, and where it is touched if the course leads to it.
            for east_m in [0.1, 0.8] {
                let found_m = ahead(east_m, 9.0, aside).expect("something");
                assert!((7.4..7.8).contains(&found_m), "{east_m}: {found_m}");
            }
            assert_eq!(ahead(0.1, 7.2, aside), None, "within the reach it is not touched");
            assert_eq!(ahead(1.9, 9.0, aside), None);
        }
        assert_eq!(ahead(1.4, 9.0, Aside::TURNS), None);
        assert!(ahead(1.4, 9.0, Aside::drifts(2.0)).is_some());
    }

    #[test]
    fn a_vehicle_that_is_too_near_already_may_go_away_but_not_nearer() {
        let forward_check = seen(&[(0.3, 0.1)]);
        let ahead = |north: f32| {
            forward_check.obstacle_ahead_m(NedVector::ZERO, NedVector::new(north, 0.0, 0.0), 3.0, Aside::TURNS)
        };
        assert_eq!(ahead(-1.0), None);
        assert!(ahead(1.0).is_some());
        // What it leaves hides nothing of what lies behind.
        let forward_check = seen(&[(0.1, 0.1), (5.1, 0.1)]);
        let found_m = forward_check.obstacle_ahead_m(NedVector::ZERO, NedVector::new(1.0, 0.0, 0.0), 8.0, Aside::TURNS);
        let is_it = found_m.is_some_and(|found_m| (4.2..4.9).contains(&found_m));
        assert!(is_it, "{found_m:?}");
    }
}
