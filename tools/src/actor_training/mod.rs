//! Trains the actor in the simulator: DDPG with prioritised replay and the paper's potential field.
//!
//! `docs/learning.md` describes the method.

pub mod adam;
mod checkpoint;
mod collector;
mod config;
mod evaluation;
mod files;
mod flight;
mod learner;
mod limits;
mod networks;
mod noise;
mod priorities;
mod progress;
mod replay_buffer;
mod result;
pub mod reward;
pub mod value;

pub use config::ConfigError;
pub use evaluation::{EvaluatedActor, EvaluationResult, EvaluationSpec, RolloutError, evaluate};
pub use flight::Flight;
pub use learner::UpdateError;
pub use progress::FlightLine;
pub use result::FlightCount;
