//! What training needs besides gradients: first weights, the optimiser, target networks, priorities.
//!
//! Randomness comes from the caller's generator, so the same seed gives the same bits.

pub mod adam;
mod sum_tree;

pub use adam::Adam;
pub use sum_tree::SumTree;

use crate::shape::{ShapeError, expect};

/// Target network: `target += tau · (source − target)`.
///
/// # Errors
/// Slices of different lengths.
pub fn soft_update(tau: f32, source: &[f32], target: &mut [f32]) -> Result<(), ShapeError> {
    expect("target parameters", target, source.len())?;
    for (target, source) in target.iter_mut().zip(source) {
        *target += tau * (source - *target);
    }
    Ok(())
}
