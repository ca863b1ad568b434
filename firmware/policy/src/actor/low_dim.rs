//! What a learned pilot decides from beside frames and memory: the low-dimensional observation of our actor, or distance and bearing of the
//! goal for a policy of others.

use crate::actor::senses::LOW_DIM;
use crate::smaller;
use vigil_types::GoalRelative;

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
