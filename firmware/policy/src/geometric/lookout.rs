//! What lies on a vehicle's course, whoever flies it and wherever its nose points: the grid of what was seen, along the velocity.

use crate::geometric::occupancy_grid::{CELL_M, HIT, OccupancyGrid};
use crate::geometric::position_ned_m;
use crate::geometric::range_scan::{RangeScan, Scan};
use crate::{PilotInput, smaller};
use vigil_types::{Nanos, NedVector};

/// Kept between the vehicle's middle and what is remembered, cells: 0.50 m, its radius of 0.30 m and a cell's error.
const KEEP_CLEAR_CELLS: f32 = 2.0;
/// And more for what is farther ahead, cells a metre: the velocity turns, and drifts, by some 0.1 rad before the vehicle is there.
const WIDENS_CELLS_PER_M: f32 = 0.4;
/// The most that the grid's clearance tells is 6.
const WIDEST_CELLS: f32 = 4.0;
/// The course is looked at this often, metres: no cell is passed over.
const LOOK_EVERY_M: f32 = CELL_M / 2.0;
/// Farther than this nothing is entered into the grid.
const FARTHEST_M: f32 = 11.0;

/// The grid and what fills it. Fixed size, no allocation.
#[derive(Debug, Clone, Default)]
pub struct Lookout {
    surroundings: RangeScan,
    grid: OccupancyGrid,
    last_stamp_ns: Option<Nanos>,
}

impl Lookout {
    /// One that has seen nothing.
    pub fn new() -> Self {
        Self::default()
    }

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

    /// Metres along the velocity to where the vehicle would come too near to something that was seen, within `reach_m`. What is too
    /// near already must not get nearer.
    pub fn obstacle_ahead_m(&self, here_ned_m: NedVector, velocity_ned_m_s: NedVector, reach_m: f32) -> Option<f32> {
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
        let keep = |ahead_m: f32| {
            let cells = smaller(KEEP_CLEAR_CELLS + WIDENS_CELLS_PER_M * ahead_m, WIDEST_CELLS);
            here.min((cells * cells) as u8)
        };
        let looks = (smaller(reach_m, FARTHEST_M) / LOOK_EVERY_M) as usize;
        (1..=looks)
            .map(|look| look as f32 * LOOK_EVERY_M)
            .find(|ahead_m| clearance(*ahead_m) < keep(*ahead_m))
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
    extern crate std;

    use super::*;
    use std::boxed::Box;

    fn seen(places: &[(f32, f32)]) -> Box<Lookout> {
        let mut lookout = Box::new(Lookout::new());
        lookout.grid.follow(NedVector::ZERO);
        for (north_m, east_m) in places {
            lookout.grid.occupy(*north_m, *east_m);
        }
        lookout.grid.measure_clearance();
        lookout
    }

    #[test]
    fn what_lies_on_the_course_counts_and_what_lies_beside_it_does_not_wherever_the_nose_points() {
        let lookout = seen(&[(5.1, 0.1), (0.1, -6.1)]);
        let ahead = |north: f32, east: f32, reach_m: f32| {
            lookout.obstacle_ahead_m(NedVector::ZERO, NedVector::new(north, east, 0.0), reach_m)
        };
        let found_m = ahead(2.0, 0.0, 9.0).expect("something");
        assert!((4.2..4.9).contains(&found_m), "{found_m}");
        assert_eq!(ahead(2.0, 0.0, 4.0), None, "beyond the reach");
        let found_m = ahead(0.0, -0.5, 9.0).expect("something");
        assert!((5.2..5.9).contains(&found_m), "{found_m}");
        assert_eq!(ahead(2.0, 2.0, 9.0), None);
        assert_eq!(ahead(0.0, 0.0, 9.0), None, "it stands");
    }

    #[test]
    fn a_vehicle_that_is_too_near_already_may_go_away_but_not_nearer() {
        let lookout = seen(&[(0.3, 0.1)]);
        let ahead = |north: f32| lookout.obstacle_ahead_m(NedVector::ZERO, NedVector::new(north, 0.0, 0.0), 3.0);
        assert_eq!(ahead(-1.0), None);
        assert!(ahead(1.0).is_some());
    }
}
