//! Where an actor is led outside of the flight stack, step by step as in it.

use vigil_policy::{LedBy, PilotInput, RecoveryPilot};
use vigil_types::GoalRelative;

/// The goal as it is, or the path planned over what the frames have shown. To be asked once in every step.
#[derive(Debug, Clone)]
pub enum Lead {
    /// The goal.
    Goal,
    /// The path.
    Path(Box<RecoveryPilot>),
}

impl Lead {
    /// What has seen nothing.
    pub fn new(by: LedBy) -> Self {
        match by {
            LedBy::Goal => Self::Goal,
            LedBy::Path => Self::Path(Box::default()),
        }
    }

    /// Where it leads now.
    pub fn goal(&mut self, input: &PilotInput<'_>) -> GoalRelative {
        match self {
            Self::Goal => input.goal,
            Self::Path(planner) => {
                planner.observe(input, true);
                planner.lead(input)
            }
        }
    }
}
