//! The learned pilot: the actor's network, its file, and the pilot that flies it with or without the potential field.

#[cfg(feature = "actor-file")]
mod file;
mod lead;
mod network;
mod pilot;
mod positional;

#[cfg(feature = "actor-file")]
pub use file::FrozenActor;
pub use lead::Lead;
pub use network::{
    ACTOR_FRAMES, ACTOR_HIDDEN, ACTOR_LIMIT, ACTOR_OUTPUTS, Actor, ActorParams, ActorSpec, FRAMES_IN_A_ROW,
    FRAMES_SPREAD,
};
pub use pilot::{ActorInputs, ActorPilot, FlightPilot, LedBy};
pub use positional::{
    BEARING_SCALE_RAD, DISTANCE_SCALE_M, FARTHEST_KNOWN_M, GOAL_INPUTS, PositionalInputs, PositionalSense, WITH_MOVERS,
    goal_inputs,
};
