//! The learned pilot: the actor's network, what it remembers, its file, and the pilot that flies it with or without the potential field.

#[cfg(feature = "actor-file")]
mod file;
pub mod memory;
mod network;
mod pilot;
pub mod senses;

#[cfg(feature = "actor-file")]
pub use file::{FrozenActor, SLOWEST_M_S};
pub use memory::{CONTEXT, SCAN};
pub use network::{
    ACTOR_HIDDEN, ACTOR_LIMIT, ACTOR_OUTPUTS, Actor, ActorParams, ActorSpec, FrameEncoder, LOW_UNITS, TRUNK,
};
pub use pilot::{Decider, FlightPilot, LearnedPilot};
pub use senses::{BEARING_SCALE_RAD, DISTANCE_SCALE_M, FARTHEST_KNOWN_M, GOAL_INPUTS, LOW_DIM, LowDim};
