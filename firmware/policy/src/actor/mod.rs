//! The learned pilot: the frozen actor's file, and the pilot that flies it with or without the potential field.

#[cfg(feature = "actor-file")]
mod file;
mod pilot;

#[cfg(feature = "actor-file")]
pub use file::FrozenActor;
pub use pilot::{
    ActorInputs, ActorPilot, BEARING_SCALE_RAD, DISTANCE_SCALE_M, FARTHEST_KNOWN_M, FlightPilot, LedBy,
    positional_inputs,
};
