//! Steps in parameter space.

use crate::error::{ShapeError, expect};
use alloc::vec;
use alloc::vec::Vec;

/// Adam (Kingma and Ba, "Adam: A Method for Stochastic Optimization", 2015, algorithm 1), as PyTorch computes it. All
/// state is public, so that a checkpoint can keep it and a run resume exactly.
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    /// Decay of the mean, usually 0.9.
    pub beta1: f32,
    /// Decay of the mean square, usually 0.999.
    pub beta2: f32,
    /// Added to the root of the mean square, usually 1e-8.
    pub epsilon: f32,
    /// Steps taken.
    pub steps: u64,
    /// Decaying mean of each gradient.
    pub mean: Vec<f32>,
    /// Decaying mean of each squared gradient.
    pub square: Vec<f32>,
}

impl Adam {
    /// For this many parameters, with the usual constants.
    pub fn new(params: usize) -> Self {
        Self {
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-8,
            steps: 0,
            mean: vec![0.0; params],
            square: vec![0.0; params],
        }
    }

    /// Moves the parameters against the gradient.
    ///
    /// # Errors
    /// Slices of other lengths.
    pub fn step(&mut self, rate: f32, gradient: &[f32], params: &mut [f32]) -> Result<(), ShapeError> {
        expect("gradient", gradient, self.mean.len())?;
        expect("parameters", params, self.mean.len())?;
        expect("Adam's mean square", &self.square, self.mean.len())?;
        self.steps += 1;
        // In float64: 0.999^t is close to 1 for long.
        let correction = |beta: f32| 1.0 - libm::pow(f64::from(beta), self.steps as f64);
        let rate = (f64::from(rate) / correction(self.beta1)) as f32;
        let root_correction = libm::sqrt(correction(self.beta2)) as f32;
        let (beta1, beta2, epsilon) = (self.beta1, self.beta2, self.epsilon);
        let moments = self.mean.iter_mut().zip(&mut self.square);
        for ((param, g), (mean, square)) in params.iter_mut().zip(gradient).zip(moments) {
            *mean += (1.0 - beta1) * (g - *mean);
            *square = beta2 * *square + (1.0 - beta2) * g * g;
            *param -= rate * *mean / (libm::sqrtf(*square) / root_correction + epsilon);
        }
        Ok(())
    }
}

/// Scales the gradient so that its Euclidean norm is at most `limit`; returns the norm it had. A norm that is not finite
/// leaves the gradient as it is: the caller has to stop.
pub fn clip_norm(limit: f32, gradient: &mut [f32]) -> f32 {
    let squares = gradient.iter().map(|g| f64::from(*g) * f64::from(*g)).sum();
    let norm = libm::sqrt(squares) as f32;
    if norm > limit && norm.is_finite() {
        let scale = limit / norm;
        for g in gradient {
            *g *= scale;
        }
    }
    norm
}

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
