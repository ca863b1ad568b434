//! Goals at a distance, or spread over a range of them.

use crate::campaign::spread;
use serde::{Deserialize, Serialize};
use vigil_sim::world::LONG_GOAL_M;

/// How far away the goals are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct GoalDistance {
    from_m: f32,
    to_m: f32,
}

impl GoalDistance {
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let (from, to) = text.split_once("..").unwrap_or((text, text));
        let length = |text: &str| match text.trim().parse::<f32>() {
            Ok(length_m) if LONG_GOAL_M.contains(&length_m) => Ok(length_m),
            _ => Err(format!(
                "a distance is a number from {} to {} metres, a range two of them: 150 or 30..300",
                LONG_GOAL_M.start(),
                LONG_GOAL_M.end()
            )),
        };
        let (from_m, to_m) = (length(from)?, length(to)?);
        if from_m > to_m {
            return Err(format!("the range {text} is empty: the nearer distance comes first"));
        }
        Ok(Self { from_m, to_m })
    }

    /// The distance of a flight.
    pub(super) fn of(self, seed: u64) -> f32 {
        self.from_m + (self.to_m - self.from_m) * spread(seed) as f32
    }
}
