//! What training needs besides gradients: first weights, the optimiser, target networks, priorities.
//!
//! Randomness comes from the caller's generator, so the same seed gives the same bits.

pub mod adam;
mod initial;
mod soft_update;
mod sum_tree;

pub use adam::Adam;
pub use soft_update::soft_update;
pub use sum_tree::SumTree;
