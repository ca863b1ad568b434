//! Exploration noise.

use rand::{Rng, RngExt};

/// Ornstein–Uhlenbeck noise with step 1: `x += θ (0 − x) + σ · normal`. It wanders, so that a vehicle is pushed one way
/// for some time instead of trembling.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrnsteinUhlenbeck {
    /// Pull towards zero per step, 0 to 1.
    pub theta: f32,
    /// The present value.
    pub value: f32,
}

impl OrnsteinUhlenbeck {
    /// At zero.
    pub fn new(theta: f32) -> Self {
        Self { theta, value: 0.0 }
    }

    /// The next value. `sigma` may shrink while training goes on.
    pub fn step(&mut self, rng: &mut impl Rng, sigma: f32) -> f32 {
        self.value += sigma * normal(rng) - self.theta * self.value;
        self.value
    }
}

/// A standard normal value (Box and Muller), the same bits on every machine.
pub fn normal(rng: &mut impl Rng) -> f32 {
    // In (0, 1], so that the logarithm is finite.
    let radius = libm::sqrt(-2.0 * libm::log(1.0 - rng.random::<f64>()));
    (radius * libm::cos(core::f64::consts::TAU * rng.random::<f64>())) as f32
}
