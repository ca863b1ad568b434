//! Target networks.

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
