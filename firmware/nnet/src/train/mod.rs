//! What training needs besides gradients: first weights, Adam, gradient clipping, target networks, prioritised replay.
//!
//! Randomness comes from the caller's generator, so the same seed gives the same bits.

mod adam;
mod initial;
mod replay;

pub use adam::{Adam, clip_norm, soft_update};
pub use replay::{PrioritizedReplay, ReplayConfig, Sampled, SumTree};
