//! What the test of a run came to, from which `vigil report` makes table I.

use serde::{Deserialize, Serialize};

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
