//! Getting out of the way of what moves: of some ways to fly on for three seconds the one that meets nothing and leads nearest to the waypoint.
//!
//! The dynamic window approach (Fox, Burgard, Thrun 1997) with obstacles that go on as they go (velocity obstacles; Fiorini, Shiller
//! 1998), each with all that its lane's ends may be, weighed by how likely they are: when it turns back, and where it is if it is not seen.
//! The wanted action is kept where it meets nothing.

use crate::geometric::governor::{Motion, STEP_S, Simulated};
use crate::geometric::occupancy_grid::OccupancyGrid;
use crate::geometric::track::{LEAST_SPEED_M_S, Track, Whereabouts};
use crate::{larger, smaller};
use vigil_types::{ACTION_LIMIT, Action, NedVector, YAW_RATE_PER_UNIT_RAD_S};

/// How far ahead the vehicle is flown on.
const HORIZON_STEPS: usize = 30;
/// The same in seconds.
pub const HORIZON_S: f32 = HORIZON_STEPS as f32 * STEP_S;
/// An action is held for so long; then the vehicle flies straight on, at a speed of its own.
const FIRST_STEPS: usize = 10;
/// The vehicle's radius, metres.
const VEHICLE_M: f32 = 0.30;
/// Nearer than this beside a mover counts as met, metres.
const MET_M: f32 = 0.10;
/// Nearer than this is better avoided, metres; and what a metre of it costs, in metres of path.
const SPARE_M: f32 = 0.40;
const SPARE_COST: f32 = 6.0;
/// What meeting a mover costs at once and at the horizon, and meeting something that stands, in metres of path. The governor stops before
/// what stands, but only where the vehicle flies forward.
const MEET_COST: f32 = 100.0;
const LATE_MEET_COST: f32 = 20.0;
const STANDING_COST: f32 = 40.0;
/// Squared clearance of what stands that is kept, cells: 0.50 m.
const KEEP_SQUARED_CELLS: u8 = 4;
/// What it costs to end on a lane to which a mover may return, in metres of path: nothing at this distance from its edge.
const LANE_COST: f32 = 5.0;
const LANE_M: f32 = 0.25;
/// What a radian off the waypoint at the end costs, in metres of path.
const HEADING_COST: f32 = 0.3;
/// An action that risks no more than this is as good as wanted.
const LEAST_RISK: f32 = 0.1;
/// What the plan of the step before costs less, in metres of path: of two that are about as good it does not go to and fro.
const KEPT_PLAN: f32 = 0.3;

/// Speeds that are tried, as parts of the cruise speed (backward only over what was just flown), and yaw outputs, as parts of the greatest.
const SPEEDS: [f32; 7] = [1.0, 0.75, 0.5, 0.25, 0.0, -0.3, -0.6];
const YAWS: [f32; 7] = [0.0, -0.33, 0.33, -0.67, 0.67, -1.0, 1.0];

/// Places at which movers may be, at most, and what weighs less counts for nothing.
const MOST_GUESSES: usize = 96;
const LEAST_WEIGHT: f32 = 0.005;
/// Places nearer together than this are one, metres.
const SAME_M: f32 = 1e-3;

/// Where a mover may be and go to, and how much that counts.
#[derive(Debug, Clone, Copy, Default)]
struct Guess {
    north_m: f32,
    east_m: f32,
    north_m_s: f32,
    east_m_s: f32,
    radius_m: f32,
    /// When it turns back.
    turns_after_s: f32,
    weight: f32,
}

/// What may move near the vehicle, and the lanes that it comes back on.
#[derive(Debug, Clone)]
pub struct Guesses {
    guesses: [Guess; MOST_GUESSES],
    used: usize,
}

impl Guesses {
    /// Of movers whose places are `age_s` old.
    pub fn new<'a>(movers: impl Iterator<Item = &'a Track> + Clone, age_s: f32) -> Self {
        let mut all = Self {
            guesses: [Guess::default(); MOST_GUESSES],
            used: 0,
        };
        // Those that are seen first: one that is lost may be at many places.
        for is_located in [true, false] {
            let movers = movers.clone().filter(|m| m.is_located() == is_located);
            movers.for_each(|m| all.enter(m, age_s));
        }
        all
    }

    /// Enters where a mover may be. What differs only in what comes after the horizon is one guess.
    fn enter(&mut self, m: &Track, age_s: f32) {
        let reach_m = m.speed_m_s() * HORIZON_S;
        // Ends come in such an order that those which make no difference follow one another, but for those that it does not reach: they are
        // the first guess.
        let (mut first, mut last): (Option<Whereabouts>, Option<Whereabouts>) = (None, None);
        m.for_each_whereabouts(age_s, |w| {
            let is_later = w.turns_after_m > reach_m;
            let turns_after_m = if is_later { f32::INFINITY } else { w.turns_after_m };
            let w = Whereabouts { turns_after_m, ..w };
            let is_same = |a: f32, b: f32| a == b || (a - b).abs() < SAME_M;
            for one in [&mut first, &mut last].into_iter().flatten() {
                if one.direction == w.direction
                    && is_same(one.along_m, w.along_m)
                    && is_same(one.turns_after_m, w.turns_after_m)
                {
                    one.weight += w.weight;
                    return;
                }
            }
            if first.is_none() && turns_after_m == f32::INFINITY && w.direction > 0.0 {
                first = Some(w);
            } else if let Some(done) = last.replace(w) {
                self.add_whereabouts(m, done);
            }
        });
        for w in [first, last].into_iter().flatten() {
            self.add_whereabouts(m, w);
        }
    }

    fn add_whereabouts(&mut self, m: &Track, w: Whereabouts) {
        if w.weight > LEAST_WEIGHT
            && let Some(guess) = self.guesses.get_mut(self.used)
        {
            let (north_m, east_m) = m.place_m(w.along_m);
            *guess = Guess {
                north_m,
                east_m,
                north_m_s: w.direction * m.north_m_s,
                east_m_s: w.direction * m.east_m_s,
                radius_m: m.radius_m,
                turns_after_s: w.turns_after_m / larger(m.speed_m_s(), LEAST_SPEED_M_S),
                weight: w.weight,
            };
            self.used += 1;
        }
    }

    fn all(&self) -> &[Guess] {
        self.guesses.get(..self.used).unwrap_or(&[])
    }
}

/// What a manner of flying on leads to.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    /// What it may meet, in metres of path.
    risk: f32,
    /// Step at which it comes too near to what stands, if it does.
    standing_at: Option<usize>,
    /// Where it ends.
    end_ned_m: NedVector,
    /// Heading at the end, radians.
    end_yaw_rad: f32,
}

/// How much an event costs the less the later it comes.
fn early(at: usize) -> f32 {
    1.0 - at as f32 / HORIZON_STEPS as f32
}

/// How to fly on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// For the first second.
    pub action: Action,
    /// Forward speed then, straight on, metres per second.
    pub then_m_s: f32,
}

impl From<Action> for Plan {
    /// The action, carried on.
    fn from(action: Action) -> Self {
        let then_m_s = action.forward_m_s;
        Self { action, then_m_s }
    }
}

/// What the vehicle would do if nothing moved.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// Its action.
    pub action: Action,
    /// Fastest forward speed, metres per second.
    pub cruise_m_s: f32,
    /// Where it is to get to.
    pub waypoint: NedVector,
}

/// The best of the plans that are tried, `last` being that of the step before; `None` where the wanted action meets no mover.
pub fn evade<'a>(
    motion: &Motion,
    wanted: &Wanted,
    movers: impl Iterator<Item = &'a Track> + Clone,
    guesses: &Guesses,
    memory: &OccupancyGrid,
    last: Option<Plan>,
) -> Option<Plan> {
    let (cruise_m_s, waypoint) = (wanted.cruise_m_s, wanted.waypoint);
    let outcome = |plan: Plan| fly_on(motion, plan, movers.clone(), guesses, memory);
    let wanted = Plan::from(wanted.action);
    let first = outcome(wanted);
    if first.risk < LEAST_RISK {
        return None;
    }
    let cost = |o: &Outcome| {
        let standing = o.standing_at.map_or(0.0, |at| STANDING_COST * early(at));
        let to_waypoint = waypoint - o.end_ned_m;
        let off_rad = vigil_types::wrap_pi(libm::atan2f(to_waypoint.y, to_waypoint.x) - o.end_yaw_rad);
        o.risk + standing + to_waypoint.horizontal_norm() + HEADING_COST * off_rad.abs()
    };
    let mut best = (cost(&first), wanted);
    let mut compare = |plan: Plan, bonus: f32| {
        let cost = cost(&outcome(plan)) - bonus;
        if cost < best.0 {
            best = (cost, plan);
        }
    };
    if let Some(last) = last {
        compare(last, KEPT_PLAN);
    }
    for speed in SPEEDS {
        let forward_m_s = speed * cruise_m_s;
        for yaw in YAWS {
            let action = Action::new(forward_m_s, yaw * ACTION_LIMIT);
            for (i, then_m_s) in [forward_m_s, cruise_m_s, 0.0].into_iter().enumerate() {
                if i == 0 || then_m_s != forward_m_s {
                    compare(Plan { action, then_m_s }, 0.0);
                }
            }
        }
    }
    Some(best.1)
}

/// Flies a plan on and compares with what moves and what stands.
fn fly_on<'a>(
    motion: &Motion,
    plan: Plan,
    movers: impl Iterator<Item = &'a Track>,
    guesses: &Guesses,
    memory: &OccupancyGrid,
) -> Outcome {
    let start = motion.position_ned_m;
    let velocity = motion.velocity_m_s.to_ned(motion.yaw_rad);
    let mut vehicle = Simulated::new(
        (start.x, start.y),
        (libm::cosf(motion.yaw_rad), libm::sinf(motion.yaw_rad)),
        (velocity.x, velocity.y),
        plan.action.yaw * YAW_RATE_PER_UNIT_RAD_S,
    );
    let keep = memory.clearance_squared_at(start.x, start.y).min(KEEP_SQUARED_CELLS);
    let mut standing_at = None;
    // Of each guess the least squared distance, and the step at which it is met.
    let mut least = [(f32::INFINITY, HORIZON_STEPS); MOST_GUESSES];
    for step in 0..HORIZON_STEPS {
        if step < FIRST_STEPS {
            vehicle.turn();
            vehicle.advance(plan.action.forward_m_s);
        } else {
            vehicle.advance(plan.then_m_s);
        }
        let (north_m, east_m) = vehicle.at;
        let after_s = (step + 1) as f32 * STEP_S;
        for (guess, (least, met_at)) in guesses.all().iter().zip(&mut least) {
            // What it has gone on by then, less what it has come back.
            let on_s = after_s - 2.0 * larger(after_s - guess.turns_after_s, 0.0);
            let n = guess.north_m + guess.north_m_s * on_s - north_m;
            let e = guess.east_m + guess.east_m_s * on_s - east_m;
            let squared = n * n + e * e;
            *least = smaller(*least, squared);
            let met_m = guess.radius_m + VEHICLE_M + MET_M;
            if squared < met_m * met_m && *met_at == HORIZON_STEPS {
                *met_at = step;
            }
        }
        if standing_at.is_none() && memory.clearance_squared_at(north_m, east_m) < keep {
            standing_at = Some(step);
        }
    }
    let mut risk = 0.0;
    for (guess, (squared, met_at)) in guesses.all().iter().zip(least) {
        let least_m = libm::sqrtf(squared) - guess.radius_m - VEHICLE_M;
        let near = SPARE_COST * larger(SPARE_M - least_m, 0.0);
        let met = if met_at < HORIZON_STEPS {
            LATE_MEET_COST + (MEET_COST - LATE_MEET_COST) * early(met_at)
        } else {
            0.0
        };
        risk += guess.weight * (met + near);
    }
    let ((north_m, east_m), (nose_n, nose_e)) = (vehicle.at, vehicle.nose);
    let mut on_lane = 0.0;
    for mover in movers {
        let off_m = mover.off_lane_m(north_m, east_m, HORIZON_S) - mover.radius_m - VEHICLE_M;
        on_lane = larger(on_lane, (1.0 - off_m / LANE_M).clamp(0.0, 1.0));
    }
    Outcome {
        risk: risk + LANE_COST * on_lane,
        standing_at,
        end_ned_m: NedVector::new(north_m, east_m, start.z),
        end_yaw_rad: libm::atan2f(nose_e, nose_n),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometric::movers::MoverTracker;
    use crate::geometric::movers::tests::{RADIUS_M, Scene, look_aside, track};
    use std::boxed::Box;
    use vigil_types::HeadingVector;

    const WANTED: Action = Action::new(1.5, 0.0);

    fn decide(tracker: &MoverTracker, wanted: Action, last: Option<Plan>) -> Option<Plan> {
        let guesses = Guesses::new(tracker.movers(), 0.0);
        let motion = Motion {
            velocity_m_s: HeadingVector::new(wanted.forward_m_s, 0.0, 0.0),
            ..Motion::default()
        };
        let memory = Box::<OccupancyGrid>::default();
        let wanted = Wanted {
            action: wanted,
            cruise_m_s: 1.5,
            waypoint: NedVector::new(4.0, 0.0, 0.0),
        };
        evade(&motion, &wanted, tracker.movers(), &guesses, &memory, last)
    }

    /// Flies a plan on beside the scene's own motion from `from_s` on; the least distance between the vehicle's edge and the mover's.
    fn least_m(scene: &Scene, from_s: f32, plan: Plan) -> f32 {
        let (mut north_m, mut east_m, mut v, mut yaw) = (0.0_f32, 0.0_f32, WANTED.forward_m_s, 0.0_f32);
        let mut least_m = f32::INFINITY;
        for i in 0..30 {
            let forward_m_s = if i < 10 {
                yaw += plan.action.yaw * YAW_RATE_PER_UNIT_RAD_S * 0.1;
                plan.action.forward_m_s
            } else {
                plan.then_m_s
            };
            v += (forward_m_s - v) * 0.133;
            north_m += v * libm::cosf(yaw) * 0.1;
            east_m += v * libm::sinf(yaw) * 0.1;
            let (n, e) = scene.at(from_s + i as f32 * 0.1);
            least_m = least_m.min(libm::hypotf(n - north_m, e - east_m) - RADIUS_M - VEHICLE_M);
        }
        least_m
    }

    #[test]
    fn what_would_be_met_is_evaded_also_where_it_goes_on_to_out_of_sight() {
        // It comes from the left, is followed for 1.5 s, and is before the vehicle two seconds later; or the vehicle
        // looks west for two seconds first.
        for (begins, unseen_frames, evaded_by_m) in [(3.5, 0, 0.2), (5.3, 40, 0.1)] {
            let from_s = 1.5 + unseen_frames as f32 * 0.05;
            for speed_m_s in [0.4, 0.6, 0.8] {
                let scene = Scene::of((3.0, -begins * speed_m_s), (0.0, speed_m_s));
                let mut tracker = track(&scene, 30);
                look_aside(&mut tracker, 30..30 + unseen_frames);
                let is_seen = unseen_frames == 0;
                assert!(tracker.movers().all(|m| m.is_located() == is_seen), "the test's own");
                assert!(
                    least_m(&scene, from_s, WANTED.into()) < 0.1,
                    "the test's own: it would be met"
                );
                let plan = decide(&tracker, WANTED, None).expect("another plan");
                let by_m = least_m(&scene, from_s, plan);
                assert!(by_m > evaded_by_m, "{speed_m_s} m/s: {plan:?}");
            }
        }
    }

    #[test]
    fn the_plan_of_the_step_before_is_kept_where_another_is_hardly_better() {
        let scene = Scene::of((3.0, -2.1), (0.0, 0.6));
        let tracker = track(&scene, 30);
        let best = decide(&tracker, WANTED, None).expect("another plan");
        // About as good as the best: a little faster or slower afterwards.
        let as_good = Plan {
            then_m_s: best.then_m_s - 0.05,
            ..best
        };
        assert_eq!(decide(&tracker, WANTED, Some(as_good)), Some(as_good));
        assert_eq!(decide(&tracker, WANTED, Some(WANTED.into())), Some(best));
    }

    #[test]
    fn what_passes_far_off_changes_nothing() {
        let scene = Scene::of((4.5, 2.5), (0.6, 0.3));
        assert_eq!(decide(&track(&scene, 30), WANTED, None), None);
    }

    #[test]
    fn a_mover_that_is_seen_is_not_crowded_out_by_those_that_are_lost() {
        let lost = Scene::of((3.0, -1.5), (0.0, 0.6));
        let mut tracker = track(&lost, 30);
        look_aside(&mut tracker, 30..130);
        let seen = track(&lost, 30);
        let of = |m: &MoverTracker| m.movers().copied().collect::<std::vec::Vec<_>>();
        let (lost, seen) = (of(&tracker), of(&seen));
        let many = || lost.iter().cycle().take(11).chain(&seen);
        let guesses = Guesses::new(many(), 0.0);
        assert_eq!(
            guesses.all().len(),
            MOST_GUESSES,
            "the test's own: more than there is room for"
        );
        let first = guesses.all()[0];
        assert!((first.east_m - seen[0].east_m).abs() < 0.01, "{first:?}");
    }

    #[test]
    fn the_vehicle_does_not_wait_on_a_movers_lane() {
        // Out of the view it has gone to the right, along a line through the vehicle, and will come back.
        let scene = Scene::of((0.9, -1.2), (-0.2, 0.7));
        let waiting = Action::new(0.0, 0.0);
        let plan = decide(&track(&scene, 30), waiting, None).expect("another plan");
        assert!(plan.action != waiting, "{plan:?}");
    }
}
