//! Getting out of the way of what moves: of some ways to fly on for three seconds the one that meets nothing and leads nearest to the waypoint.
//!
//! The dynamic window approach (Fox, Burgard, Thrun 1997) with obstacles that go on as they go (velocity obstacles; Fiorini, Shiller
//! 1998), and, with less weight, as they would go if they turned back. The wanted action is kept where it meets nothing.

use crate::geometric::governor::{Motion, STEP_S, Simulated};
use crate::geometric::movers::Track;
use crate::geometric::occupancy_grid::OccupancyGrid;
use crate::{larger, smaller};
use vigil_types::{ACTION_LIMIT, Action, NedVector, YAW_RATE_PER_UNIT_RAD_S};

/// How far ahead movers are known well enough: they turn back at the ends of their ways.
const HORIZON_STEPS: usize = 30;
/// The same in seconds.
pub const HORIZON_S: f32 = HORIZON_STEPS as f32 * STEP_S;
/// A turn is held for so long, then the vehicle flies straight on.
const TURN_STEPS: usize = 10;
/// The vehicle's radius, metres.
const VEHICLE_M: f32 = 0.30;
/// Nearer than this beside a mover counts as met, metres.
const MET_M: f32 = 0.10;
/// Nearer than this is better avoided, metres; and what a metre of it costs, in metres of way.
const SPARE_M: f32 = 0.40;
const SPARE_COST: f32 = 6.0;
/// What meeting a mover costs at once and at the horizon, and meeting something that stands, in metres of way. The governor stops before
/// what stands, but only where the vehicle flies forward.
const MEET_COST: f32 = 100.0;
const LATE_MEET_COST: f32 = 20.0;
const STANDING_COST: f32 = 40.0;
/// Squared clearance of what stands that is kept, cells: 0.50 m.
const KEEP_SQUARED_CELLS: u8 = 4;
/// What it costs to end on a lane to which a mover may return, in metres of way: nothing at this distance from its edge.
const LANE_COST: f32 = 5.0;
const LANE_M: f32 = 0.25;
/// What a radian off the waypoint at the end costs, in metres of way.
const HEADING_COST: f32 = 0.3;
/// An action that risks no more than this is as good as wanted.
const LEAST_RISK: f32 = 0.1;
/// How much it counts that a mover turns back now, that one out of sight went on, and that it turned back when it was last seen.
const TURNS_BACK: f32 = 0.15;
const WENT_ON: f32 = 0.125;
const CAME_BACK: f32 = 0.15;
/// A mover out of sight is taken for no farther than this from where it was last seen, metres.
const LONGEST_LANE_M: f32 = 5.0;

/// Speeds that are tried, as parts of the cruise speed (backward only over what was just flown), and yaw outputs, as parts of the greatest.
const SPEEDS: [f32; 7] = [1.0, 0.75, 0.5, 0.25, 0.0, -0.3, -0.6];
const YAWS: [f32; 7] = [0.0, -0.33, 0.33, -0.67, 0.67, -1.0, 1.0];

/// Places at which movers may be, at most.
const MOST_GUESSES: usize = 24;

/// Where a mover may be and go to, and how much that counts.
#[derive(Debug, Clone, Copy)]
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
    /// Of movers whose places are `age_s` old. `sees_past` tells that nothing can be at a place.
    pub fn new<'a>(
        movers: impl Iterator<Item = &'a Track>,
        age_s: f32,
        sees_past: impl Fn(f32, f32, f32) -> bool,
    ) -> Self {
        const NOBODY: Guess = Guess {
            north_m: 0.0,
            east_m: 0.0,
            north_m_s: 0.0,
            east_m_s: 0.0,
            radius_m: 0.0,
            turns_after_s: f32::INFINITY,
            weight: 0.0,
        };
        let mut all = Self {
            guesses: [NOBODY; MOST_GUESSES],
            used: 0,
        };
        for m in movers {
            let mut add = |(north_m, east_m): (f32, f32), direction: f32, turns_after_s: f32, weight| {
                if let Some(guess) = all.guesses.get_mut(all.used) {
                    *guess = Guess {
                        north_m,
                        east_m,
                        north_m_s: direction * m.north_m_s,
                        east_m_s: direction * m.east_m_s,
                        radius_m: m.radius_m,
                        turns_after_s,
                        weight,
                    };
                    all.used += 1;
                }
            };
            if m.is_located() {
                let turns_after_s = m.turns_after_s() - age_s;
                add(m.position_after(age_s), 1.0, turns_after_s, 1.0);
                if !turns_after_s.is_finite() {
                    add(m.position_after(age_s), -1.0, f32::INFINITY, TURNS_BACK);
                }
            } else {
                for (direction, weight) in [(1.0, WENT_ON), (-1.0, CAME_BACK)] {
                    let place = m.gone_on(direction, LONGEST_LANE_M);
                    if !sees_past(place.0, place.1, m.radius_m) {
                        add(place, direction, f32::INFINITY, weight);
                        add(place, -direction, f32::INFINITY, weight);
                    }
                }
            }
        }
        all
    }

    fn all(&self) -> &[Guess] {
        self.guesses.get(..self.used).unwrap_or(&[])
    }
}

/// What a way of flying on leads to.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    /// What it may meet, in metres of way.
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

/// The wanted action where it meets no mover, otherwise the best of those that are tried.
pub fn evade<'a>(
    motion: &Motion,
    wanted: Action,
    cruise_m_s: f32,
    waypoint: NedVector,
    movers: impl Iterator<Item = &'a Track> + Clone,
    guesses: &Guesses,
    memory: &OccupancyGrid,
) -> Action {
    let outcome = |action: Action| fly_on(motion, action, movers.clone(), guesses, memory);
    let first = outcome(wanted);
    if first.risk < LEAST_RISK {
        return wanted;
    }
    let cost = |o: &Outcome| {
        let standing = o.standing_at.map_or(0.0, |at| STANDING_COST * early(at));
        let to_waypoint = waypoint - o.end_ned_m;
        let off_rad = vigil_types::wrap_pi(libm::atan2f(to_waypoint.y, to_waypoint.x) - o.end_yaw_rad);
        o.risk + standing + to_waypoint.horizontal_norm() + HEADING_COST * off_rad.abs()
    };
    let mut best = (cost(&first), wanted);
    for speed in SPEEDS {
        for yaw in YAWS {
            let action = Action {
                forward_m_s: speed * cruise_m_s,
                yaw: yaw * ACTION_LIMIT,
            };
            let cost = cost(&outcome(action));
            if cost < best.0 {
                best = (cost, action);
            }
        }
    }
    best.1
}

/// Flies an action on and compares with what moves and what stands.
fn fly_on<'a>(
    motion: &Motion,
    action: Action,
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
        action.yaw * YAW_RATE_PER_UNIT_RAD_S,
    );
    let keep = memory.clearance_squared_at(start.x, start.y).min(KEEP_SQUARED_CELLS);
    let mut standing_at = None;
    // Of each guess the least squared distance, and the step at which it is met.
    let mut least = [(f32::INFINITY, HORIZON_STEPS); MOST_GUESSES];
    for step in 0..HORIZON_STEPS {
        if step < TURN_STEPS {
            vehicle.turn();
        }
        vehicle.advance(action.forward_m_s);
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
    extern crate std;

    use super::*;
    use crate::geometric::movers::tests::{Scene, track};
    use std::boxed::Box;
    use vigil_types::HeadingVector;

    const WANTED: Action = Action {
        forward_m_s: 1.5,
        yaw: 0.0,
    };

    fn decide(scene: &Scene, wanted: Action) -> Action {
        let tracker = track(scene, 30);
        let guesses = Guesses::new(tracker.movers(), 0.0, |_, _, _| false);
        let motion = Motion {
            position_ned_m: NedVector::ZERO,
            yaw_rad: 0.0,
            velocity_m_s: HeadingVector::new(wanted.forward_m_s, 0.0, 0.0),
            yaw_rate_rad_s: 0.0,
        };
        let memory = Box::new(OccupancyGrid::new());
        let waypoint = NedVector::new(4.0, 0.0, 0.0);
        evade(&motion, wanted, 1.5, waypoint, tracker.movers(), &guesses, &memory)
    }

    /// Flies an action on beside the scene's own motion; the least distance between the vehicle's edge and the mover's.
    fn least_m(scene: &Scene, action: Action) -> f32 {
        let (mut north_m, mut east_m, mut v, mut yaw) = (0.0_f32, 0.0_f32, WANTED.forward_m_s, 0.0_f32);
        let mut least_m = f32::INFINITY;
        for i in 0..30 {
            let at_s = 30.0 * 0.05 + i as f32 * 0.1;
            if i < 10 {
                yaw += action.yaw * YAW_RATE_PER_UNIT_RAD_S * 0.1;
            }
            v += (action.forward_m_s - v) * 0.133;
            north_m += v * libm::cosf(yaw) * 0.1;
            east_m += v * libm::sinf(yaw) * 0.1;
            let (n, e) = scene.at(at_s);
            least_m = least_m.min(libm::hypotf(n - north_m, e - east_m) - scene.radius_m - VEHICLE_M);
        }
        least_m
    }

    #[test]
    fn what_would_be_met_is_evaded() {
        // It comes from the left and is before the vehicle when the vehicle is there.
        for speed_m_s in [0.4, 0.6, 0.8] {
            let scene = Scene {
                start_m: (3.0, -1.5 * speed_m_s - 2.0 * speed_m_s),
                velocity_m_s: (0.0, speed_m_s),
                radius_m: 0.3,
            };
            let action = decide(&scene, WANTED);
            assert!(least_m(&scene, WANTED) < 0.1, "the test's own: it would be met");
            assert!(least_m(&scene, action) > 0.2, "{speed_m_s} m/s: {action:?}");
        }
    }

    #[test]
    fn what_passes_far_off_changes_nothing() {
        let scene = Scene {
            start_m: (4.5, 2.5),
            velocity_m_s: (0.6, 0.3),
            radius_m: 0.3,
        };
        assert_eq!(decide(&scene, WANTED), WANTED);
    }

    #[test]
    fn the_vehicle_does_not_wait_on_a_movers_lane() {
        // Out of the view it has gone to the right, along a line through the vehicle, and will come back.
        let scene = Scene {
            start_m: (0.9, -1.2),
            velocity_m_s: (-0.2, 0.7),
            radius_m: 0.3,
        };
        let waiting = Action {
            forward_m_s: 0.0,
            yaw: 0.0,
        };
        assert!(decide(&scene, waiting) != waiting);
    }
}
