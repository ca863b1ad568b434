//! What a run reports: rows of the learning curve, and how far it has come.

use crate::actor_training::collector::FlightReport;
use crate::actor_training::learner::UpdateReport;
use crate::report::{decimals, maybe_decimals, to_csv};
use serde::{Deserialize, Serialize};
use vigil_world::Outcome;

/// Updates that a row of the learning curve sums up.
pub const UPDATES_PER_ROW: u64 = 50;

/// One row of the learning curve: the training flights that ended and the updates made since the row before.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Row {
    /// Updates so far.
    pub updates: u64,
    /// Decisions so far.
    pub decisions: u64,
    /// Time spent, seconds, interruptions left out.
    pub elapsed_s: f64,
    /// Training flights that ended; warm-up flights count in the first row.
    pub flights: usize,
    /// Those that reached the goal.
    pub successes: usize,
    /// Those that hit something.
    pub collisions: usize,
    /// Their mean sum of rewards.
    pub reward: f32,
    /// Means over the updates.
    pub update: UpdateReport,
    /// Completion of the judging flights without the field, if there were any at this row.
    pub completion: Option<f64>,
}

/// A training flight that ended, in the order of their ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightRow {
    /// Updates made when it ended.
    pub updates: u64,
    /// How it ended, and what it brought.
    pub flight: FlightReport,
}

/// Collects a row.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RowSum {
    flights: Vec<FlightReport>,
    update: UpdateReport,
    updates: u32,
}

impl RowSum {
    /// Counts a flight.
    pub fn add_flight(&mut self, flight: FlightReport) {
        self.flights.push(flight);
    }

    /// Counts an update.
    pub fn add_update(&mut self, update: &UpdateReport) {
        self.update = self.update.plus(update);
        self.updates += 1;
    }

    /// The row; begins the next.
    pub fn finish(&mut self, updates: u64, decisions: u64, elapsed_s: f64) -> Row {
        let sum = core::mem::take(self);
        let count = |outcome| sum.flights.iter().filter(|f| f.outcome == Some(outcome)).count();
        let reward: f32 = sum.flights.iter().map(|f| f.reward).sum();
        Row {
            updates,
            decisions,
            elapsed_s,
            flights: sum.flights.len(),
            successes: count(Outcome::Success),
            collisions: count(Outcome::Collision),
            reward: reward / sum.flights.len().max(1) as f32,
            update: sum.update.scaled(1.0 / sum.updates.max(1) as f32),
            completion: None,
        }
    }
}

/// A line of `curves.csv`.
#[derive(Serialize)]
struct CurveLine {
    updates: u64,
    decisions: u64,
    #[serde(serialize_with = "decimals::<1, _, _>")]
    elapsed_s: f64,
    flights: usize,
    successes: usize,
    collisions: usize,
    #[serde(serialize_with = "decimals::<4, _, _>")]
    reward: f32,
    #[serde(serialize_with = "decimals::<6, _, _>")]
    critic_loss: f32,
    #[serde(serialize_with = "decimals::<6, _, _>")]
    imitation_loss: f32,
    #[serde(serialize_with = "decimals::<5, _, _>")]
    value: f32,
    #[serde(serialize_with = "decimals::<4, _, _>")]
    saturated: f32,
    #[serde(serialize_with = "decimals::<3, _, _>")]
    agreement: f32,
    #[serde(serialize_with = "decimals::<5, _, _>")]
    critic_norm: f32,
    #[serde(serialize_with = "decimals::<5, _, _>")]
    actor_norm: f32,
    #[serde(serialize_with = "maybe_decimals::<4, _, _>")]
    completion: Option<f64>,
}

impl From<&Row> for CurveLine {
    fn from(r: &Row) -> Self {
        let u = &r.update;
        Self {
            updates: r.updates,
            decisions: r.decisions,
            elapsed_s: r.elapsed_s,
            flights: r.flights,
            successes: r.successes,
            collisions: r.collisions,
            reward: r.reward,
            critic_loss: u.critic_loss,
            imitation_loss: u.imitation_loss,
            value: u.value,
            saturated: u.saturated,
            agreement: u.agreement,
            critic_norm: u.critic_norm,
            actor_norm: u.actor_norm,
            completion: r.completion,
        }
    }
}

/// The learning curve as comma-separated values.
pub fn csv(rows: &[Row]) -> String {
    to_csv(rows.iter().map(CurveLine::from))
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

/// How far a run has come.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress<'a> {
    /// Decisions flown.
    pub decisions: u64,
    /// Decisions of the whole run.
    pub all_decisions: u64,
    /// Updates made.
    pub updates: u64,
    /// Updates of the whole run.
    pub all_updates: u64,
    /// Time left, seconds, at the pace of this session; `None` before the first update.
    pub left_s: Option<f64>,
    /// The row that has just been finished.
    pub row: Option<&'a Row>,
}
