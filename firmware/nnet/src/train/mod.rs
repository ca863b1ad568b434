//! What training needs besides gradients: first weights, target networks, priorities.
//!
//! Randomness comes from the caller's generator, so the same seed gives the same bits.

mod initial;
mod soft_update;
mod sum_tree;

pub use soft_update::soft_update;
pub use sum_tree::SumTree;
