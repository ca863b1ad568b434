//! Intermediate goals: what an imported policy flies to when the goal is farther away than any that it has learned.
//!
//! Seen from 200 m, a goal lies straight ahead however far off the line the vehicle is: a policy that knows nothing but its
//! bearing is brought past everything, and out of the course. So it follows the line on which the goal was taken up. Where that brings
//! the vehicle no nearer, or past the goal, it follows the path that the recovery pilot plans, until it has come nearer.

use vigil_policy::actor::FARTHEST_KNOWN_M;
use vigil_types::{Action, GoalRelative, Nanos, NedVector};

/// How far ahead along the line the intermediate goal lies, metres. Farther ahead, a vehicle that went around something is brought back
/// to the line too late: at 15 m five of a hundred flights leave the course. Along a path it seems to lie as far away.
const AHEAD_M: f32 = 8.0;
/// A vehicle that has not come nearer to the goal by so much in this time follows the path ...
const NEARER_M: f32 = 0.5;
const STALLED_NS: Nanos = 6_000_000_000;
/// ... as does one that is farther away again than it was, metres, or has the goal aside of what it sees, radians.
const FARTHER_M: f32 = 1.5;
const ASIDE_RAD: f32 = 1.2;
/// The path is left when it has brought the vehicle nearer by this, or has not in this time.
const PATH_NEARER_M: f32 = 3.0;
const PATH_NS: Nanos = 30_000_000_000;
/// A path that goes this far aside is turned to on the spot, radians: no flight that a policy learned from begins with that.
const TURN_RAD: f32 = 1.0;
const TURN_YAW: f32 = 1.0;

/// A far goal and how near the vehicle came to it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Approach {
    nearest_m: f32,
    /// When it came so near, or what it flies to changed.
    since_ns: Nanos,
    by_path: bool,
}

/// The line from where the goal was taken up to the goal.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Segment {
    /// From, to.
    line: Option<(NedVector, NedVector)>,
    /// For a goal that was too far away to be known when it was taken up.
    far: Option<Approach>,
}

impl Segment {
    /// Forgets the line: the next goal is taken up where the vehicle then is.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Whether the goal was too far away to be known when it was taken up.
    pub fn is_far(&self) -> bool {
        self.far.is_some()
    }

    /// Whether the policy follows the planned path.
    pub fn is_by_path(&self) -> bool {
        self.far.is_some_and(|approach| approach.by_path)
    }

    /// Takes up the goal if it is another than before. To be asked first in every step.
    pub fn take_up(&mut self, now_ns: Nanos, here: NedVector, goal: NedVector) {
        if self.line.is_none_or(|(_, to)| to != goal) {
            let nearest_m = (goal - here).horizontal_norm();
            self.line = Some((here, goal));
            self.far = (nearest_m > FARTHEST_KNOWN_M).then_some(Approach {
                nearest_m,
                since_ns: now_ns,
                by_path: false,
            });
        }
    }

    /// Where to fly: to the goal if it is known, to the point of the line [`AHEAD_M`] farther than the vehicle has come, at the goal's
    /// height; `None` is along the path. `bearing_rad` is the goal's.
    pub fn next(&mut self, now_ns: Nanos, here: NedVector, bearing_rad: f32) -> Option<NedVector> {
        let Some((from, goal)) = self.line else {
            return Some(here);
        };
        let distance_m = (goal - here).horizontal_norm();
        if let Some(approach) = &mut self.far {
            approach.note(now_ns, distance_m, bearing_rad);
            if approach.by_path {
                return None;
            }
        }
        if distance_m <= FARTHEST_KNOWN_M {
            return Some(goal);
        }
        let path = goal - from;
        let length_m = path.horizontal_norm();
        let [north, east] = [path.x, path.y].map(|along_m| along_m / length_m.max(f32::MIN_POSITIVE));
        let come = here - from;
        let ahead_m = (come.x * north + come.y * east).max(0.0) + AHEAD_M;
        Some(if ahead_m >= length_m {
            goal
        } else {
            NedVector::new(from.x + north * ahead_m, from.y + east * ahead_m, goal.z)
        })
    }
}

impl Approach {
    /// Changes what leads where that brings the vehicle no nearer.
    fn note(&mut self, now_ns: Nanos, distance_m: f32, bearing_rad: f32) {
        let waited_ns = now_ns.saturating_sub(self.since_ns);
        let (nearer_m, changes) = if self.by_path {
            (PATH_NEARER_M, waited_ns > PATH_NS)
        } else {
            let farther = distance_m > self.nearest_m + FARTHER_M;
            (
                NEARER_M,
                farther || waited_ns > STALLED_NS || bearing_rad.abs() > ASIDE_RAD,
            )
        };
        let nearer = distance_m < self.nearest_m - nearer_m;
        if nearer || changes {
            // What was not reached along the path is no measure for what follows.
            if nearer || self.by_path {
                self.nearest_m = distance_m;
            }
            self.since_ns = now_ns;
            self.by_path = !nearer && !self.by_path;
        }
    }
}

/// What a path shows the actor: its bearing, as near as a point of the line.
pub(crate) fn along_path(path: GoalRelative) -> GoalRelative {
    GoalRelative {
        distance_m: path.distance_m.min(AHEAD_M),
        ..path
    }
}

/// What the actor decided on its way along a path, or a turn on the spot to a path that leads aside.
pub(crate) fn turned_to_path(path: GoalRelative, action: Action) -> Action {
    if path.bearing_rad.abs() > TURN_RAD {
        Action::new(0.0, TURN_YAW.copysign(path.bearing_rad))
    } else {
        action
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: Nanos = 1_000_000_000;

    fn at(north: f32, east: f32) -> NedVector {
        NedVector::new(north, east, -1.5)
    }

    /// The local goal of a vehicle that has just come there.
    fn local_goal(segment: &mut Segment, here: NedVector, goal: NedVector) -> NedVector {
        segment.take_up(0, here, goal);
        segment.next(0, here, 0.0).expect("not by the path")
    }

    /// The local goal of a vehicle that comes there from the origin at once.
    fn local_goal_from_origin(here: NedVector, goal: NedVector) -> NedVector {
        let mut segment = Segment::default();
        segment.take_up(0, at(0.0, 0.0), goal);
        local_goal(&mut segment, here, goal)
    }

    #[test]
    fn a_goal_that_the_actor_knows_is_flown_to_as_it_is() {
        let mut segment = Segment::default();
        assert_eq!(local_goal(&mut segment, at(0.0, 0.0), at(20.0, 5.0)), at(20.0, 5.0));
        assert_eq!(local_goal(&mut segment, at(10.0, -7.0), at(20.0, 5.0)), at(20.0, 5.0));
        let later = segment.next(1_000 * SECOND_NS, at(10.0, -7.0), 3.0);
        assert_eq!(later, Some(at(20.0, 5.0)), "however long that takes");
    }

    #[test]
    fn a_vehicle_off_the_line_is_brought_back_to_it() {
        let goal = at(200.0, 0.0);
        assert_eq!(local_goal_from_origin(at(0.0, 0.0), goal), at(AHEAD_M, 0.0));
        assert_eq!(
            local_goal_from_origin(at(50.0, 9.0), goal),
            at(50.0 + AHEAD_M, 0.0),
            "not straight on"
        );
        assert_eq!(
            local_goal_from_origin(at(-1.0, 2.0), goal),
            at(AHEAD_M, 0.0),
            "blown back behind its beginning"
        );
        assert_eq!(local_goal_from_origin(at(184.0, 20.0), goal), at(184.0 + AHEAD_M, 0.0));
        assert_eq!(local_goal_from_origin(at(190.0, 3.0), goal), goal);
    }

    #[test]
    fn a_vehicle_that_comes_no_nearer_follows_the_path_until_it_has() {
        let goal = at(200.0, 0.0);
        let mut segment = Segment::default();
        segment.take_up(0, at(0.0, 0.0), goal);
        let mut next = |seconds: u64, north: f32, bearing_rad: f32| {
            let local_goal = segment.next(seconds * SECOND_NS, at(north, 0.0), bearing_rad);
            assert_eq!(local_goal.is_none(), segment.is_by_path());
            local_goal
        };
        assert_eq!(next(5, 0.0, 0.0), Some(at(AHEAD_M, 0.0)));
        assert_eq!(next(7, 0.3, 0.0), None, "it stands");
        assert_eq!(next(12, -6.0, 0.0), None, "the path out goes back first");
        assert_eq!(next(20, 2.0, 0.0), None);
        assert_eq!(next(30, 3.1, 0.0), Some(at(3.1 + AHEAD_M, 0.0)));
        assert_eq!(next(34, 60.0, 0.0), Some(at(60.0 + AHEAD_M, 0.0)));
        assert_eq!(next(35, 57.0, 0.0), None, "it flies back");
        assert_eq!(next(70, 50.0, 0.0), Some(at(58.0, 0.0)), "nor does the path help");
        assert_eq!(next(72, 195.0, 0.0), Some(goal));
        assert_eq!(next(73, 195.2, 1.4), None, "it passes the goal");
    }

    #[test]
    fn a_path_that_leads_aside_is_turned_to_on_the_spot() {
        let flown = Action::new(1.2, 0.1);
        let path = |bearing_rad| GoalRelative::new(90.0, bearing_rad);
        assert_eq!(turned_to_path(path(0.6), flown), flown);
        let turn = turned_to_path(path(-2.0), flown);
        assert_eq!((turn.forward_m_s, turn.yaw), (0.0, -1.0));
        assert_eq!(along_path(path(0.6)).distance_m, AHEAD_M);
    }

    #[test]
    fn another_goal_is_another_line_and_so_is_the_same_one_after_a_new_take_off() {
        let mut segment = Segment::default();
        local_goal(&mut segment, at(0.0, 0.0), at(200.0, 0.0));
        let turned = local_goal(&mut segment, at(50.0, 10.0), at(50.0, 210.0));
        assert_eq!(turned, at(50.0, 10.0 + AHEAD_M));
        segment.reset();
        assert_eq!(
            local_goal(&mut segment, at(60.0, 30.0), at(60.0, 210.0)),
            at(60.0, 30.0 + AHEAD_M)
        );
    }

    #[test]
    fn a_goal_where_the_line_begins_is_no_line() {
        let mut segment = Segment::default();
        let goal = at(3.0, 3.0);
        local_goal(&mut segment, goal, goal);
        assert_eq!(local_goal(&mut segment, at(40.0, 3.0), goal), goal);
    }
}
