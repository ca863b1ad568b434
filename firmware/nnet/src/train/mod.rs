//! What training needs besides gradients: first weights, Adam, gradient clipping, target networks, prioritised replay,
//! exploration noise.
//!
//! Randomness comes from the caller's generator, so the same seed gives the same bits.

mod adam;
mod initial;
mod noise;
mod replay;

pub use adam::{Adam, clip_norm, soft_update};
pub use noise::{OrnsteinUhlenbeck, normal};
pub use replay::{PrioritizedReplay, ReplayConfig, Sampled, SumTree};
