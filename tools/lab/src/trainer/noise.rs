//! Exploration noise.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use vigil_types::Action;

/// Standard normal deviate (Box and Muller 1958).
pub fn normal(rng: &mut impl Rng) -> f32 {
    // 1 − u lies in (0, 1], so the logarithm is finite.
    let u: f32 = rng.random_range(0.0..1.0);
    let v: f32 = rng.random_range(0.0..1.0);
    libm::sqrtf(-2.0 * libm::logf(1.0 - u)) * libm::cosf(core::f32::consts::TAU * v)
}

/// An Ornstein-Uhlenbeck process for each output, with a stationary standard deviation of 1.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct OrnsteinUhlenbeck {
    state: [f32; 2],
}

impl OrnsteinUhlenbeck {
    /// A draw of the stationary distribution.
    pub fn start(rng: &mut impl Rng) -> Self {
        Self {
            state: [normal(rng), normal(rng)],
        }
    }

    /// The next step, in which the share `theta` decays and as much variance is added.
    pub fn step(&mut self, theta: f32, rng: &mut impl Rng) {
        let kept = 1.0 - theta;
        let fresh = libm::sqrtf(1.0 - kept * kept);
        for x in &mut self.state {
            *x = kept * *x + fresh * normal(rng);
        }
    }

    /// The noise at a standard deviation.
    pub fn at(&self, sigma: f32) -> Action {
        Action {
            forward_m_s: sigma * self.state[0],
            yaw: sigma * self.state[1],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_wander_keeps_its_deviation_and_its_memory() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut noise = OrnsteinUhlenbeck::start(&mut rng);
        let (mut square, mut lagged, mut last) = (0.0, 0.0, 0.0);
        const N: usize = 200_000;
        for _ in 0..N {
            noise.step(0.15, &mut rng);
            let x = noise.at(2.0).yaw;
            square += x * x;
            lagged += x * last;
            last = x;
        }
        let variance = square / N as f32;
        assert!((variance - 4.0).abs() < 0.2, "{variance}");
        assert!((lagged / square - 0.85).abs() < 0.01, "{}", lagged / square);
    }
}
