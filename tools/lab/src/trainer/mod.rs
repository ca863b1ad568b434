//! Trains the actor by value: deterministic policy gradient on frames and memory, from nothing and without a teacher.
//!
//! The encoder learns first, from single frames, and is frozen; then environment workers fly, and an actor and twin critics learn from
//! what they stored. `docs/learning.md` describes the method and what was measured.

mod actor_net;
pub mod config;
mod encoder;
pub mod evaluation;
mod learner;
mod mlp;
mod noise;
pub mod observation;
pub mod probe;
mod replay;
pub mod reward;
pub mod run;
mod store;
pub mod worker;
