//! The training flights of a run: `flights.csv`.

use crate::actor_training::collector::FlightReport;
use crate::report::{decimals, to_csv};
use serde::{Deserialize, Serialize};

/// A training flight that ended, in the order of their ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightRow {
    /// Updates made when it ended.
    pub updates: u64,
    /// How it ended, and what it brought.
    pub flight: FlightReport,
}

/// A line of `flights.csv`: the data of the paper's figures 9 and 10.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightLine {
    /// Number of the flight, from 1 on.
    pub flight: usize,
    /// Updates made when it ended.
    pub updates: u64,
    /// 1 if it was part of the warm-up.
    pub warm_up: u8,
    /// 1 if the field was added.
    pub field: u8,
    /// How it ended.
    pub outcome: String,
    /// Decisions.
    pub decisions: u32,
    /// Sum of rewards, not discounted.
    #[serde(serialize_with = "decimals::<4, _, _>")]
    pub reward: f64,
}

/// The training flights as comma-separated values.
pub fn flights_csv(rows: &[FlightRow]) -> String {
    to_csv(
        (1..)
            .zip(rows)
            .map(|(number, FlightRow { updates, flight })| FlightLine {
                flight: number,
                updates: *updates,
                warm_up: flight.warm_up.into(),
                field: flight.with_apf.into(),
                outcome: flight.outcome.map_or(String::new(), |o| o.to_string()),
                decisions: flight.decisions,
                reward: flight.reward.into(),
            }),
    )
}
