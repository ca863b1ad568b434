//! The learned pilot: the actor's network, its file, and the pilot that flies it with or without the potential field.

#[cfg(feature = "actor-file")]
mod file;
mod network;
mod pilot;

#[cfg(feature = "actor-file")]
pub use file::FrozenActor;
pub use network::{
    ACTOR_FRAMES, ACTOR_HIDDEN, ACTOR_LIMIT, ACTOR_OUTPUTS, ACTOR_POSITIONAL, Actor, ActorParams, ActorSpec,
    FRAMES_IN_A_ROW, FRAMES_SPREAD,
};
pub use pilot::{
    ActorInputs, ActorPilot, BEARING_SCALE_RAD, DISTANCE_SCALE_M, FARTHEST_KNOWN_M, FlightPilot, LedBy,
    positional_inputs,
};
