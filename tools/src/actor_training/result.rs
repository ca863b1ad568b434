//! What a run came to: `result.json`, from which `vigil report training` makes tables and pictures.

use crate::actor_training::evaluation::{EvaluationResult, EvaluationSpec};
use crate::statistics::wilson_95;
use serde::{Deserialize, Serialize};
use vigil_world::Outcome;

/// A finished run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Its seed.
    pub seed: u64,
    /// Share of the training flights with the field.
    pub apf_share: f64,
    /// Decisions, those of the warm-up included.
    pub decisions: u64,
    /// Steps of 0.05 s that these took, at most.
    pub steps: u64,
    /// Training flights that ended.
    pub flights: usize,
    /// Updates.
    pub updates: u64,
    /// Time spent, seconds, interruptions left out.
    pub elapsed_s: f64,
    /// Threads.
    pub threads: usize,
    /// Updates after which the frozen actor was taken.
    pub frozen_after: u64,
    /// The flights by which it was chosen.
    pub chosen_by: FlightCount,
    /// The flights that tested it, once it was chosen.
    pub test: FlightCount,
}

/// Flights without noise and field, and how they ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightCount {
    /// Family of the courses.
    pub family: String,
    /// First seed.
    pub first_seed: u64,
    /// How many.
    pub flights: usize,
    /// At the goal.
    pub successes: usize,
    /// Hit something.
    pub collisions: usize,
    /// Out of time.
    pub time_outs: usize,
    /// Share at the goal.
    pub completion: f64,
    /// Its 95 % interval (Wilson).
    pub wilson_95: (f64, f64),
}

impl FlightCount {
    /// Counts a result's flights.
    pub fn new(what: &EvaluationSpec, result: &EvaluationResult) -> Self {
        let (flights, successes) = (result.flights.len(), result.successes());
        Self {
            family: what.family.to_string(),
            first_seed: what.first_seed,
            flights,
            successes,
            collisions: result.count(Outcome::Collision),
            time_outs: result.count(Outcome::TimeOut),
            completion: result.completion(),
            wilson_95: wilson_95(successes, flights),
        }
    }
}
