//! Seeded randomness that gives the same bits on every machine.

use crate::vehicle::math::Vec3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A number of mean 0 and standard deviation 1, within ±3.46, from 64 random bits: the sum of four uniform numbers (Irwin-Hall). It
/// needs no logarithm or sine, so it is cheap and exact everywhere.
pub fn normal_of(bits: u64) -> f64 {
    /// √3 / 65536: four uniform u16 have the variance 4 · 65536² / 12.
    const SCALE: f64 = 1.732_050_807_568_877_2 / 65_536.0;
    let sum = (bits & 0xffff) + ((bits >> 16) & 0xffff) + ((bits >> 32) & 0xffff) + (bits >> 48);
    (sum as f64 - 131_070.0) * SCALE
}

/// A stream of approximately normal numbers.
#[derive(Debug, Clone)]
pub(crate) struct Noise {
    rng: ChaCha8Rng,
}

impl Noise {
    /// Streams of one seed do not overlap, so what one part of the model draws never changes what another gets.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream);
        Self { rng }
    }

    /// Mean 0, standard deviation 1.
    pub(crate) fn normal(&mut self) -> f64 {
        normal_of(self.rng.next_u64())
    }

    /// Uniform from 0 to 1.
    pub(crate) fn uniform(&mut self) -> f64 {
        (self.rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Three independent ones.
    pub(crate) fn normal3(&mut self) -> Vec3 {
        [(); 3].map(|()| self.normal()).into()
    }

    /// How much of the stream was used: with the seed, the generator's whole state.
    pub(crate) fn position(&self) -> u64 {
        self.rng.get_word_pos() as u64
    }
}

/// An Ornstein-Uhlenbeck process (first-order Gauss-Markov), sampled exactly at a fixed interval.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OrnsteinUhlenbeck {
    pub(crate) value: Vec3,
    deviation: Vec3,
    keep: f64,
    kick: f64,
}

impl OrnsteinUhlenbeck {
    /// Starts from the stationary distribution with these standard deviations per axis.
    pub(crate) fn new(deviation: Vec3, time_s: f64, interval_s: f64, noise: &mut Noise) -> Self {
        let keep = libm::exp(-interval_s / time_s);
        let mut process = Self {
            value: Vec3::zeros(),
            deviation,
            keep,
            kick: libm::sqrt(1.0 - keep * keep),
        };
        process.redraw(noise);
        process
    }

    /// A fresh draw from the stationary distribution.
    pub(crate) fn redraw(&mut self, noise: &mut Noise) {
        self.value = self.deviation.component_mul(&noise.normal3());
    }

    /// One interval later.
    pub(crate) fn advance(&mut self, noise: &mut Noise) {
        self.value = self.value * self.keep + self.deviation.component_mul(&noise.normal3()) * self.kick;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_mean_zero_and_variance_one() {
        let mut noise = Noise::new(1, 0);
        let n = 100_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..n {
            let x = noise.normal();
            sum += x;
            squares += x * x;
        }
        let (mean, variance) = (sum / f64::from(n), squares / f64::from(n));
        // Four standard errors.
        assert!(mean.abs() < 0.013, "{mean}");
        assert!((variance - 1.0).abs() < 0.02, "{variance}");
    }

    #[test]
    fn streams_of_one_seed_differ_and_equal_streams_repeat() {
        let draw = |seed, stream| Noise::new(seed, stream).normal3();
        assert_eq!(draw(7, 1), draw(7, 1));
        assert_ne!(draw(7, 1), draw(7, 2));
        assert_ne!(draw(7, 1), draw(8, 1));
    }

    #[test]
    fn a_wander_keeps_its_deviation_and_forgets_in_its_correlation_time() {
        let mut noise = Noise::new(3, 0);
        let mut process = OrnsteinUhlenbeck::new(Vec3::new(2.0, 2.0, 0.0), 0.1, 0.01, &mut noise);
        let (mut squares, mut lagged, n) = (0.0, 0.0, 50_000);
        let mut history = [0.0; 10];
        for i in 0..n {
            process.advance(&mut noise);
            let x = process.value.x;
            squares += x * x;
            lagged += x * history[i % 10];
            history[i % 10] = x;
            assert_eq!(process.value.z, 0.0);
        }
        let variance = squares / n as f64;
        assert!((variance - 4.0).abs() < 0.4, "{variance}");
        // Ten steps are one correlation time: 1/e.
        let correlation = lagged / squares;
        assert!((correlation - 0.368).abs() < 0.06, "{correlation}");
    }
}
