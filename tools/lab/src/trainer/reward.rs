//! The reward of a decision: a sum of named terms.
//!
//! A new term is a row of `TERMS`, its weight in [`RewardConfig`], and a row of the table in
//! docs/training.md, which a test asks for.

use crate::trainer::config::RewardConfig;
use vigil_sim::world::Outcome;

/// What [`RewardConfig::near`](crate::trainer::config::RewardConfig) counts begins at this distance of the vehicle's middle from an obstacle and is whole at 0, metres.
pub const NEAR_M: f32 = 1.0;

/// What a decision brought about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DecisionResult {
    /// Metres nearer to the goal, along the straight line or the shortest free path.
    pub progress_m: f32,
    /// Checkpoints passed before it.
    pub checkpoints_before: usize,
    /// Checkpoints passed now.
    pub checkpoints: usize,
    /// Checkpoints of the course.
    pub all_checkpoints: usize,
    /// Distance of the vehicle's middle from the nearest obstacle, metres.
    pub obstacle_distance_m: f32,
    /// How the flight ended, if it did.
    pub outcome: Option<Outcome>,
}

/// A term of the sum: its name, as in docs/training.md and, where it has a weight, the configuration's key; and its value.
type Term = (&'static str, fn(&RewardConfig, &DecisionResult) -> f32);

/// All terms, in the order in which they are added.
const TERMS: [Term; 6] = [
    ("progress", |_, d| d.progress_m),
    ("decision", |w, _| w.decision),
    ("checkpoint", checkpoint),
    ("near", |w, d| {
        w.near * (1.0 - d.obstacle_distance_m / NEAR_M).max(0.0).powi(2)
    }),
    ("success", |w, d| match d.outcome {
        Some(Outcome::Success) => w.success,
        _ => 0.0,
    }),
    ("dead", |w, d| match d.outcome {
        Some(Outcome::Collision | Outcome::OutOfBounds) => w.dead,
        // A flight that was cut off goes on as far as the value is concerned.
        Some(Outcome::Success | Outcome::TimeOut) | None => 0.0,
    }),
];

fn checkpoint(w: &RewardConfig, d: &DecisionResult) -> f32 {
    let bonus = |number: usize| w.checkpoint * (1.0 + number as f32 / d.all_checkpoints as f32);
    (d.checkpoints_before + 1..=d.checkpoints).map(bonus).sum()
}

/// The reward of a decision.
pub fn reward(weights: &RewardConfig, result: &DecisionResult) -> f32 {
    TERMS.iter().map(|(_, value)| value(weights, result)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHTS: RewardConfig = RewardConfig {
        along: crate::trainer::config::Along::Path,
        success: 5.0,
        dead: -2.0,
        decision: -0.5,
        checkpoint: 2.0,
        near: -0.5,
    };
    const RESULT: DecisionResult = DecisionResult {
        progress_m: 0.25,
        checkpoints_before: 1,
        checkpoints: 1,
        all_checkpoints: 4,
        obstacle_distance_m: f32::INFINITY,
        outcome: None,
    };

    #[test]
    fn what_a_decision_brought_about_is_rewarded_term_by_term() {
        let given = |result| reward(&WEIGHTS, &result);
        assert_eq!(given(RESULT), 0.25 - 0.5);
        let two = DecisionResult {
            checkpoints: 3,
            ..RESULT
        };
        assert_eq!(given(two), 0.25 - 0.5 + 2.0 * 1.5 + 2.0 * 1.75);
        for (obstacle_distance_m, near) in [(NEAR_M, 0.0), (0.75, -0.031_25), (0.0, -0.5)] {
            let result = DecisionResult {
                obstacle_distance_m,
                ..RESULT
            };
            assert_eq!(given(result), 0.25 - 0.5 + near, "{obstacle_distance_m} m");
        }
        for (outcome, ended) in [
            (Outcome::Success, 5.0),
            (Outcome::Collision, -2.0),
            (Outcome::OutOfBounds, -2.0),
            (Outcome::TimeOut, 0.0),
        ] {
            let result = DecisionResult {
                outcome: Some(outcome),
                ..RESULT
            };
            assert_eq!(given(result), 0.25 - 0.5 + ended, "{outcome}");
        }
    }

    #[test]
    fn every_term_has_its_row_in_the_documentation() {
        let page = include_str!("../../../../docs/training.md");
        let (_, section) = page
            .split_once("## Reward")
            .expect("docs/training.md has a section on the reward");
        let (section, _) = section.split_once("\n## ").unwrap_or((section, ""));
        let rows: Vec<&str> = section
            .lines()
            .filter_map(|line| line.strip_prefix("| `")?.split_once('`'))
            .map(|(name, _)| name)
            .collect();
        assert_eq!(rows, TERMS.map(|(name, _)| name));
    }
}
