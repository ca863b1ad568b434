//! The actor that looks and remembers: no planner leads it and no tracker tells it of movers (docs/learning.md).

#[cfg(feature = "actor-file")]
mod file;
pub mod memory;
mod network;
mod pilot;

#[cfg(feature = "actor-file")]
pub use file::{FORMAT as SEEING_FORMAT, FrozenSeeing};
pub use memory::{CONTEXT, LOW_DIM, SCAN};
pub use network::{HEAD, LOW_UNITS, SeeingActor, SeeingParams, SeeingSpec, TRUNK};
pub use pilot::SeeingPilot;
