//! Trains the actor in the simulator: DDPG with prioritised replay and the paper's potential field.
//!
//! `docs/learning.md` describes the method, `docs/experiments` what was measured.

pub mod adam;
mod checkpoint;
mod collector;
mod config;
mod curves;
mod decider;
mod evaluation;
mod files;
mod flight;
mod learner;
mod limits;
mod networks;
mod noise;
mod priorities;
mod progress;
mod recurrent;
mod rehearsal;
mod replay_buffer;
mod result;
pub mod reward;
pub mod robust;
mod shard;
mod training_run;
pub mod value;
mod weights;

pub use config::{ConfigError, TrainConfig};
pub use evaluation::{EvaluatedActor, EvaluationResult, EvaluationSpec, KnownMovers, RolloutError, evaluate};
pub use flight::Flight;
pub use learner::{UpdateError, UpdateReport};
pub use progress::{FlightLine, Progress, Row};
pub use rehearsal::{Example, KeptState, Rehearsal};
pub use result::{FlightCount, RunResult};
pub use training_run::{RunEnd, RunOptions, TrainError, run};
