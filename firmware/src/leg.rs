//! Intermediate goals: what the actor flies to when the goal is farther away than any that it has learned.
//!
//! Seen from 200 m, a goal lies straight ahead however far off the line the vehicle is: an actor that knows nothing but its
//! bearing is led past everything, and out of the course. So it follows the line on which the goal was taken up.

use vigil_policy::actor::FARTHEST_KNOWN_M;
use vigil_types::NedVector;

/// How far ahead along the line the intermediate goal lies, metres. Farther ahead, a vehicle that went around something is led back
/// to the line too late: at 15 m five of a hundred flights leave the course.
const AHEAD_M: f32 = 8.0;

/// The line from where the goal was taken up to the goal.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Leg {
    /// From, to.
    line: Option<(NedVector, NedVector)>,
}

impl Leg {
    /// Forgets the line: the next goal is taken up where the vehicle then is.
    pub fn reset(&mut self) {
        self.line = None;
    }

    /// Where to fly: the goal, or the point of the line [`AHEAD_M`] farther than the vehicle has come, at the goal's height.
    pub fn next(&mut self, here: NedVector, goal: NedVector) -> NedVector {
        let from = match self.line {
            Some((from, to)) if to == goal => from,
            _ => {
                self.line = Some((here, goal));
                here
            }
        };
        if (goal - here).horizontal_norm() <= FARTHEST_KNOWN_M {
            return goal;
        }
        let way = goal - from;
        let length_m = way.horizontal_norm();
        let (north, east) = (
            way.x / length_m.max(f32::MIN_POSITIVE),
            way.y / length_m.max(f32::MIN_POSITIVE),
        );
        let come = here - from;
        let ahead_m = (come.x * north + come.y * east).max(0.0) + AHEAD_M;
        if ahead_m >= length_m {
            goal
        } else {
            NedVector::new(from.x + north * ahead_m, from.y + east * ahead_m, goal.z)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(north: f32, east: f32) -> NedVector {
        NedVector::new(north, east, -1.5)
    }

    #[test]
    fn a_goal_that_the_actor_knows_is_flown_to_as_it_is() {
        let mut leg = Leg::default();
        assert_eq!(leg.next(at(0.0, 0.0), at(20.0, 5.0)), at(20.0, 5.0));
        assert_eq!(leg.next(at(10.0, -7.0), at(20.0, 5.0)), at(20.0, 5.0));
    }

    #[test]
    fn a_vehicle_off_the_line_is_led_back_to_it() {
        let mut leg = Leg::default();
        let goal = at(200.0, 0.0);
        assert_eq!(leg.next(at(0.0, 0.0), goal), at(AHEAD_M, 0.0));
        assert_eq!(
            leg.next(at(50.0, 9.0), goal),
            at(50.0 + AHEAD_M, 0.0),
            "not straight on"
        );
        assert_eq!(
            leg.next(at(-5.0, 2.0), goal),
            at(AHEAD_M, 0.0),
            "blown back behind its beginning"
        );
        assert_eq!(leg.next(at(184.0, 20.0), goal), at(184.0 + AHEAD_M, 0.0));
        assert_eq!(leg.next(at(190.0, 3.0), goal), goal);
        assert_eq!(leg.next(at(240.0, 3.0), goal), goal, "flown past it");
    }

    #[test]
    fn another_goal_is_another_line_and_so_is_the_same_one_after_a_new_take_off() {
        let mut leg = Leg::default();
        leg.next(at(0.0, 0.0), at(200.0, 0.0));
        let turned = leg.next(at(50.0, 10.0), at(50.0, 210.0));
        assert_eq!(turned, at(50.0, 10.0 + AHEAD_M));
        leg.reset();
        assert_eq!(leg.next(at(60.0, 30.0), at(60.0, 210.0)), at(60.0, 30.0 + AHEAD_M));
    }

    #[test]
    fn a_goal_where_the_line_begins_is_no_line() {
        let mut leg = Leg::default();
        let goal = at(3.0, 3.0);
        leg.next(goal, goal);
        assert_eq!(leg.next(at(40.0, 3.0), goal), goal);
    }
}
