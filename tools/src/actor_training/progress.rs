//! What a run reports: rows of the learning curve, and how far it has come.

use crate::actor_training::collector::FlightReport;
use crate::actor_training::learner::UpdateReport;
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
    /// What became of it.
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

const COLUMNS: &str = "updates,decisions,elapsed_s,flights,successes,collisions,reward,critic_loss,imitation_loss,value,\
    saturated,agreement,critic_norm,actor_norm,completion";

/// The learning curve as comma-separated values.
pub fn csv(rows: &[Row]) -> String {
    let mut text = format!("{COLUMNS}\n");
    for r in rows {
        let u = &r.update;
        let completion = r.completion.map_or(String::new(), |c| format!("{c:.4}"));
        text += &format!(
            "{},{},{:.1},{},{},{},{:.4},{:.6},{:.6},{:.5},{:.4},{:.3},{:.5},{:.5},{completion}\n",
            r.updates,
            r.decisions,
            r.elapsed_s,
            r.flights,
            r.successes,
            r.collisions,
            r.reward,
            u.critic_loss,
            u.imitation_loss,
            u.value,
            u.saturated,
            u.agreement,
            u.critic_norm,
            u.actor_norm
        );
    }
    text
}

/// The training flights as comma-separated values: the data of the paper's figures 9 and 10.
pub fn flights_csv(rows: &[FlightRow]) -> String {
    let mut text = String::from("flight,updates,warm_up,field,outcome,decisions,reward\n");
    for (number, FlightRow { updates, flight }) in (1..).zip(rows) {
        let outcome = flight.outcome.map_or(String::new(), |o| o.to_string());
        text += &format!(
            "{number},{updates},{},{},{outcome},{},{:.4}\n",
            u8::from(flight.warm_up),
            u8::from(flight.with_apf),
            flight.decisions,
            flight.reward
        );
    }
    text
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
