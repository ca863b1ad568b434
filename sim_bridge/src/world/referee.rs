//! When a flight ends, and how.

use crate::world::World;
use crate::world::course::{Checkpoint, Course};
use crate::world::solid::radians;
use crate::world::vehicle::VEHICLE;
use serde::{Deserialize, Serialize};
use vigil_types::{Attitude, Nanos, NedVector, named};

/// Touching the ground faster than this, downwards, is a crash. A quadcopter's landing descends at 0.3 to 0.7 m/s.
pub const GROUND_CRASH_SPEED_M_S: f32 = 1.5;
/// The same of a vehicle whose motors were stopped: its feet take a drop of half a metre.
const DROP_CRASH_SPEED_M_S: f32 = 3.2;
/// Touching the ground tilted more than this (60°) is a crash: the propellers hit it. This is the cosine.
const GROUND_CRASH_COS_TILT: f32 = 0.5;
/// The way between two truths is tested at least this often. The vehicle is 0.6 m wide, so no wall can slip through.
const SWEEP_STEP_M: f32 = 0.1;
/// A way longer than this many sweep steps between two truths is not a flight.
const MAX_SWEEP_STEPS: usize = 1000;

named! {
    /// How a flight ended.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Outcome {
        /// The vehicle came within the goal's radius.
        Success => "success",
        /// The vehicle touched an obstacle or the ceiling, or hit the ground.
        Collision => "collision",
        /// The vehicle left the bounds, or its position was not a number.
        #[serde(rename = "out of bounds")]
        OutOfBounds => "out of bounds",
        /// The time limit passed.
        TimeOut => "time-out",
    }
}

impl core::fmt::Display for Outcome {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

/// Watches the true motion and says when the flight is over. The first end counts; what is hit later breaks the vehicle all the same.
#[derive(Debug, Clone, Default)]
pub struct Referee {
    pub(crate) goal_ned_m: NedVector,
    goal_radius_m: f32,
    /// How far the vehicle's estimate is from the truth from now on. A goal is a place in that estimate, so arriving is decided by it;
    /// collisions and bounds are decided by the truth.
    pub estimate_error_ned_m: NedVector,
    /// Whether the motors run from now on: what falls without them hits the ground as a drop.
    pub motors_run: bool,
    time_limit_ns: Nanos,
    bounds: crate::world::course::Bounds,
    /// With cosine and sine of their headings.
    checkpoints: Vec<(Checkpoint, [f32; 2])>,
    passed: usize,
    pub(crate) started_ns: Option<Nanos>,
    pub(crate) last_ned_m: Option<NedVector>,
    /// The world's time at the last truth.
    last_world_ns: Option<Nanos>,
    /// As long as the vehicle stays within `free_radius_m` of `free_centre_ned_m`, no obstacle can be touched: its way from there
    /// and the fastest mover's way since `free_since_ns` together have to be longer than that.
    free_centre_ned_m: NedVector,
    free_since_ns: Nanos,
    free_radius_m: f32,
    outcome: Option<Outcome>,
    ended_ns: Nanos,
    collided: bool,
}

impl Referee {
    /// A referee for one flight over a course. The clock starts with the first truth it is shown.
    pub fn new(course: &Course) -> Self {
        Self {
            goal_ned_m: course.goal_ned_m(),
            goal_radius_m: course.goal_radius_m,
            motors_run: true,
            // Checked to be at most an hour, so the product fits.
            time_limit_ns: (f64::from(course.time_limit_s) * 1e9) as Nanos,
            bounds: course.bounds,
            checkpoints: (course.checkpoints.iter())
                .map(|c| (*c, [libm::cosf, libm::sinf].map(|f| f(radians(c.heading_deg)))))
                .collect(),
            free_radius_m: -1.0,
            ..Self::default()
        }
    }

    /// Shows the referee the truth at `at_ns`, with the world at the same moment ([`World::set_time_ns`], whose clock may have
    /// another zero); returns the outcome once there is one. Of several ends in one step, collision
    /// comes before out of bounds, success and time-out.
    pub fn observe(
        &mut self,
        world: &World,
        at_ns: Nanos,
        position_ned_m: NedVector,
        attitude: Attitude,
        velocity_ned_m_s: NedVector,
    ) -> Option<Outcome> {
        let started_ns = *self.started_ns.get_or_insert(at_ns);
        let from = self.last_ned_m.replace(position_ned_m).unwrap_or(position_ned_m);
        let finite = position_ned_m.is_finite() && attitude.is_valid() && velocity_ned_m_s.is_finite();
        let collides = finite
            && (self.touches(world, from, position_ned_m, attitude)
                || self.crashed_into_ground(position_ned_m, attitude, velocity_ned_m_s));
        self.collided |= collides;
        if self.outcome.is_some() {
            return self.outcome;
        }
        self.outcome = if !finite {
            Some(Outcome::OutOfBounds)
        } else if collides {
            Some(Outcome::Collision)
        } else if !self.bounds.contains(position_ned_m) {
            Some(Outcome::OutOfBounds)
        } else if (position_ned_m + self.estimate_error_ned_m - self.goal_ned_m).norm() <= self.goal_radius_m {
            Some(Outcome::Success)
        } else if at_ns.saturating_sub(started_ns) >= self.time_limit_ns {
            Some(Outcome::TimeOut)
        } else {
            None
        };
        if self.outcome.is_some() {
            self.ended_ns = at_ns;
        }
        self.count_checkpoints(position_ned_m);
        self.outcome
    }

    /// How the flight ended, if it has.
    pub fn outcome(&self) -> Option<Outcome> {
        self.outcome
    }

    /// Whether the vehicle hit something, be it after the end.
    pub fn has_collided(&self) -> bool {
        self.collided
    }

    /// From the first truth to the end, in seconds; `None` while the flight lasts.
    pub fn duration_s(&self) -> Option<f64> {
        self.duration_ns().map(|lasted_ns| lasted_ns as f64 * 1e-9)
    }

    pub(crate) fn duration_ns(&self) -> Option<Nanos> {
        self.outcome
            .and(self.started_ns)
            .map(|started_ns| self.ended_ns - started_ns)
    }

    /// Checkpoints passed so far; they count in order.
    pub fn checkpoints_passed(&self) -> usize {
        self.passed
    }

    /// Whether the vehicle touches the ground faster or more tilted than a landing does. It touches when its lowest point is at
    /// or below the ground.
    fn crashed_into_ground(&self, position_ned_m: NedVector, attitude: Attitude, velocity_ned_m_s: NedVector) -> bool {
        // Turned any way it does not reach as low.
        if -position_ned_m.z > VEHICLE.radius_m + VEHICLE.height_m {
            return false;
        }
        let lowest_m = -position_ned_m.z - VEHICLE.vertical_reach_m(attitude);
        let cos_tilt = 1.0 - 2.0 * (attitude.x * attitude.x + attitude.y * attitude.y);
        let limit_m_s = if self.motors_run {
            GROUND_CRASH_SPEED_M_S
        } else {
            DROP_CRASH_SPEED_M_S
        };
        lowest_m <= 0.0 && (velocity_ned_m_s.z > limit_m_s || cos_tilt < GROUND_CRASH_COS_TILT)
    }

    /// Whether the vehicle touches anything on the way between two positions, while the movers go theirs.
    fn touches(&mut self, world: &World, from: NedVector, to: NedVector, attitude: Attitude) -> bool {
        let now_ns = world.now_ns;
        let since_ns = self.last_world_ns.replace(now_ns).unwrap_or(now_ns);
        let between_ns = now_ns.saturating_sub(since_ns);
        let way = to - from;
        let both_m = way.norm() + world.fastest_mover_m_s * seconds(between_ns);
        let steps = match both_m <= SWEEP_STEP_M {
            true => 1,
            false => ((both_m / SWEEP_STEP_M).ceil() as usize).clamp(1, MAX_SWEEP_STEPS),
        };
        (1..=steps).any(|k| {
            // Mostly there is one step, and its division would be most of what a millisecond costs here.
            let before_ns = match steps - k {
                0 => 0,
                left => between_ns / steps as Nanos * left as Nanos,
            };
            self.touches_at(
                world,
                now_ns - before_ns,
                from + way * (k as f32 / steps as f32),
                attitude,
            )
        })
    }

    fn touches_at(&mut self, world: &World, at_ns: Nanos, position_ned_m: NedVector, attitude: Attitude) -> bool {
        let nearer_m = (position_ned_m - self.free_centre_ned_m).norm()
            + world.fastest_mover_m_s * seconds(at_ns.abs_diff(self.free_since_ns));
        if nearer_m < self.free_radius_m {
            return false;
        }
        self.free_centre_ned_m = position_ned_m;
        self.free_since_ns = at_ns;
        // 1 mm for rounding.
        self.free_radius_m = world.clearance_at_m(at_ns, position_ned_m) - VEHICLE.bounding_radius_m() - 1e-3;
        self.free_radius_m <= 0.0 && world.collides_at(at_ns, position_ned_m, attitude)
    }

    fn count_checkpoints(&mut self, position_ned_m: NedVector) {
        while let Some((c, [cos, sin])) = self.checkpoints.get(self.passed) {
            let beyond_m = (position_ned_m.x - c.north_m) * cos + (position_ned_m.y - c.east_m) * sin;
            if beyond_m < 0.0 {
                break;
            }
            self.passed += 1;
        }
    }
}

fn seconds(ns: Nanos) -> f32 {
    ns as f32 * 1e-9
}
