//! What an actor observes from step to step: its memory, the goal, and its own motion.

use crate::actor::memory::{ActorMemory, CONTEXT, Odometry, SCAN};
use crate::{PilotInput, smaller};
use alloc::boxed::Box;
use core::f32::consts::PI;
use vigil_types::{ACTION_LIMIT, Action, GoalRelative, HeadingVector, Nanos, wrap_pi};

/// What an actor decides from beside frames and memory: the goal and itself.
///
/// | Values | |
/// | --- | --- |
/// | 0 | ln(1 + distance / 1 m) / ln 22, a goal beyond 21 m as one at 21 m |
/// | 1, 2 | sine and cosine of the goal's bearing |
/// | 3, 4 | own velocity forward and right in level axes along the heading / 1.5 m/s |
/// | 5 | yaw rate / 45 °/s |
/// | 6, 7 | the last action / 1.5 |
pub const LOW_DIM: usize = 8;

/// What an actor observes from step to step beside its scan: what it remembers, and what it knows of its own motion. In flight and in
/// training alike.
#[derive(Debug, Clone, Default)]
pub struct Senses {
    memory: Box<ActorMemory>,
    /// Heading of the step before.
    yaw_before: Option<(Nanos, f32)>,
}

impl Senses {
    /// Takes a step's scan; `odometry` is what the memory goes by, `last` the action before. Returns the low-dimensional observation.
    pub fn observe(
        &mut self,
        scan: &[f32; SCAN],
        odometry: Odometry,
        input: &PilotInput<'_>,
        last: Action,
    ) -> [f32; LOW_DIM] {
        self.memory.observe(scan, odometry);
        let yaw_rad = input.attitude.yaw_rad();
        let before = self.yaw_before.replace((input.now_ns, yaw_rad));
        // 0 without a time between them.
        let rate_rad_s = before.map_or(0.0, |(before_ns, before_rad)| {
            let waited_s = input.now_ns.saturating_sub(before_ns) as f32 * 1e-9;
            let turned_rad = wrap_pi(yaw_rad - before_rad);
            if waited_s > 1e-3 { turned_rad / waited_s } else { 0.0 }
        });
        low_dim(input.goal, input.velocity_m_s, rate_rad_s, last)
    }

    /// The memory's values, as of the last scan.
    pub fn context(&self) -> &[f32; CONTEXT] {
        self.memory.context()
    }

    /// How often everything was forgotten because the odometry jumped.
    pub fn forgotten(&self) -> u32 {
        self.memory.forgotten()
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.memory.reset();
        self.pause();
    }

    /// Forgets its own motion; what is remembered of places ages.
    pub fn pause(&mut self) {
        self.yaw_before = None;
    }

    /// Takes over what another has observed, without allocating.
    pub fn copy_from(&mut self, other: &Self) {
        self.memory.copy_from(&other.memory);
        self.yaw_before = other.yaw_before;
    }
}

/// A goal farther away looks as if it were this far: the courses of training have their goals 20.6 m away, metres.
const FARTHEST_GOAL_M: f32 = 21.0;
const SPEED_M_S: f32 = 1.5;
const TURN_RAD_S: f32 = PI / 4.0;

/// The low-dimensional observation ([`LOW_DIM`]).
fn low_dim(goal: GoalRelative, velocity_m_s: HeadingVector, yaw_rate_rad_s: f32, last: Action) -> [f32; LOW_DIM] {
    let distance_m = smaller(FARTHEST_GOAL_M, goal.distance_m);
    [
        libm::logf(1.0 + distance_m) / libm::logf(1.0 + FARTHEST_GOAL_M),
        libm::sinf(goal.bearing_rad),
        libm::cosf(goal.bearing_rad),
        velocity_m_s.x / SPEED_M_S,
        velocity_m_s.y / SPEED_M_S,
        yaw_rate_rad_s / TURN_RAD_S,
        last.forward_m_s / ACTION_LIMIT,
        last.yaw / ACTION_LIMIT,
    ]
}
