//! Adam (Kingma and Ba 2015), and a limit for gradients.

use alloc::vec;
use alloc::vec::Vec;

/// Adam's two running moments for a parameter slice; β₁ = 0.9, β₂ = 0.999, ε = 1e-8.
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    /// Running mean of the gradient.
    pub mean: Vec<f32>,
    /// Running mean of its square.
    pub square: Vec<f32>,
    /// Steps taken.
    pub steps: u64,
}

const BETA_MEAN: f32 = 0.9;
const BETA_SQUARE: f32 = 0.999;
const EPSILON: f32 = 1e-8;

impl Adam {
    /// At rest, for so many parameters.
    pub fn new(len: usize) -> Self {
        Self {
            mean: vec![0.0; len],
            square: vec![0.0; len],
            steps: 0,
        }
    }

    /// One step down `factor` times the gradient, which is zero afterwards: the next is added up in it.
    pub fn step(&mut self, rate: f32, factor: f32, params: &mut [f32], gradient: &mut [f32]) {
        self.step_by_shares(rate, &[], factor, params, gradient);
    }

    /// The same, each parameter at its own share of the rate; those without a share at the whole.
    pub fn step_by_shares(&mut self, rate: f32, shares: &[f32], factor: f32, params: &mut [f32], gradient: &mut [f32]) {
        self.steps += 1;
        let bias = |beta: f32| 1.0 - f64::from(beta).powf(self.steps as f64);
        let rate = (f64::from(rate) / bias(BETA_MEAN)) as f32;
        let unbias = (1.0 / bias(BETA_SQUARE)) as f32;
        let moments = self.mean.iter_mut().zip(&mut self.square);
        for (((p, slot), share), (m, s)) in params
            .iter_mut()
            .zip(gradient)
            .zip(shares.iter().chain(core::iter::repeat(&1.0)))
            .zip(moments)
        {
            let g = *slot * factor;
            *slot = 0.0;
            *m += (1.0 - BETA_MEAN) * (g - *m);
            *s += (1.0 - BETA_SQUARE) * (g * g - *s);
            *p -= rate * share * *m / ((*s * unbias).sqrt() + EPSILON);
        }
    }
}

/// Length of a gradient.
pub fn norm(gradient: &[f32]) -> f64 {
    let squares = gradient.iter().map(|g| f64::from(*g) * f64::from(*g));
    squares.sum::<f64>().sqrt()
}

/// The factor that shortens a gradient of length `norm` to `limit`; 1 if it is not longer.
pub fn shortening(norm: f64, limit: f32) -> f32 {
    if norm > f64::from(limit) {
        (f64::from(limit) / norm) as f32
    } else {
        1.0
    }
}
