//! What a learned pilot decides from beside frames and memory: the low-dimensional observation of our actor, or distance and bearing of the
//! goal for a policy of others.

use crate::actor::memory::{ActorMemory, Odometry, SCAN};
use crate::{PilotInput, smaller};
use core::f32::consts::PI;
use vigil_types::{ACTION_LIMIT, Action, GoalRelative, HeadingVector, wrap_pi};

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

/// A goal farther away looks as if it were this far: the courses of training have their goals 20.6 m away, metres.
const FARTHEST_GOAL_M: f32 = 21.0;
const SPEED_M_S: f32 = 1.5;
const TURN_RAD_S: f32 = PI / 4.0;

/// Distance that an imported policy's first positional input counts as 1, metres.
pub const DISTANCE_SCALE_M: f32 = 20.0;
/// A goal farther away looks to an imported policy as if it were this far, metres.
pub const FARTHEST_KNOWN_M: f32 = 21.0;
/// Bearing that its second positional input counts as 1, radians.
pub const BEARING_SCALE_RAD: f32 = 1.0;
/// Positional inputs of an imported policy: distance and bearing.
pub const GOAL_INPUTS: usize = 2;

/// A learned pilot's inputs beside frames and memory: 2 values of an imported policy ([`Self::of_goal`]), 8 of our actor
/// ([`LOW_DIM`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LowDim {
    values: [f32; LOW_DIM],
    len: usize,
}

impl LowDim {
    /// Of an imported policy: distance and bearing of the goal.
    pub fn of_goal(goal: GoalRelative) -> Self {
        [
            smaller(goal.distance_m, FARTHEST_KNOWN_M) / DISTANCE_SCALE_M,
            goal.bearing_rad / BEARING_SCALE_RAD,
        ]
        .into()
    }

    /// Those of a record, as they were given to a pilot; `None` for a number of values that no pilot has.
    pub fn from_values(recorded: &[f32]) -> Option<Self> {
        if let Ok(own) = <[f32; LOW_DIM]>::try_from(recorded) {
            return Some(own.into());
        }
        <[f32; GOAL_INPUTS]>::try_from(recorded).ok().map(Self::from)
    }
}

impl From<[f32; LOW_DIM]> for LowDim {
    fn from(values: [f32; LOW_DIM]) -> Self {
        Self { values, len: LOW_DIM }
    }
}

impl From<[f32; GOAL_INPUTS]> for LowDim {
    fn from([distance, bearing]: [f32; GOAL_INPUTS]) -> Self {
        let values = [distance, bearing, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        Self {
            values,
            len: GOAL_INPUTS,
        }
    }
}

impl core::ops::Deref for LowDim {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        self.values.get(..self.len).unwrap_or_default()
    }
}

/// What an actor observes from step to step beside its scan: what it remembers, and what it knows of its own motion. In
/// flight and in training alike.
pub type Senses = ActorMemory;

impl Senses {
    /// Takes a step's scan; `odometry` is what the memory goes by, `last` the action before. Returns the low-dimensional
    /// observation.
    pub fn observe(
        &mut self,
        scan: &[f32; SCAN],
        odometry: Odometry,
        input: &PilotInput<'_>,
        last: Action,
    ) -> [f32; LOW_DIM] {
        self.remember(scan, odometry);
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
}

/// An actor's low-dimensional observation ([`LOW_DIM`]).
fn low_dim(goal: GoalRelative, velocity_m_s: HeadingVector, rate_rad_s: f32, last: Action) -> [f32; LOW_DIM] {
    let distance_m = smaller(FARTHEST_GOAL_M, goal.distance_m);
    [
        libm::logf(1.0 + distance_m) / libm::logf(1.0 + FARTHEST_GOAL_M),
        libm::sinf(goal.bearing_rad),
        libm::cosf(goal.bearing_rad),
        velocity_m_s.x / SPEED_M_S,
        velocity_m_s.y / SPEED_M_S,
        rate_rad_s / TURN_RAD_S,
        last.forward_m_s / ACTION_LIMIT,
        last.yaw / ACTION_LIMIT,
    ]
}
