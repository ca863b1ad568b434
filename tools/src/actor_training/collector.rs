//! What every training flight reports, and where its seeds begin.

use serde::{Deserialize, Serialize};
use vigil_nnet::ShapeError;
use vigil_vehicle::ParamsError;
use vigil_world::Outcome;

/// Seeds of training flights begin here; those below are for judging.
pub const FIRST_TRAINING_SEED: u64 = 1_000_000;

/// Why a decision could not be flown.
#[derive(Debug, thiserror::Error)]
pub enum CollectError {
    /// The vehicle.
    #[error(transparent)]
    Vehicle(#[from] ParamsError),
    /// The networks.
    #[error(transparent)]
    Network(#[from] ShapeError),
}

/// A training flight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FlightReport {
    /// How it ended; `None` while it lasts.
    #[serde(with = "outcome_name")]
    pub outcome: Option<Outcome>,
    /// Sum of rewards, not discounted.
    pub reward: f32,
    /// Decisions.
    pub decisions: u32,
    /// The field was added.
    pub with_apf: bool,
    /// It was part of the warm-up.
    pub warm_up: bool,
}

mod outcome_name {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use vigil_world::Outcome;

    pub fn serialize<S: Serializer>(outcome: &Option<Outcome>, s: S) -> Result<S::Ok, S::Error> {
        outcome.map(|o| o.to_string()).serialize(s)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Option<Outcome>, D::Error> {
        let name = Option::<String>::deserialize(d)?;
        let outcome = name.map(|name| name.parse()).transpose();
        outcome.map_err(serde::de::Error::custom)
    }
}
