//! What the sensor makes of a true range: noise, dropouts, limits.
//!
//! Every beam's noise is a function of seed, frame and beam alone, so it does not depend on the order or the thread in which
//! beams are computed.

use super::LidarConfig;
use super::simd::vectorised;
use super::tiles::TILE_FIRINGS;

/// Standard deviation of the sum of four independent integers from 0 to 65535.
const SIGMA_OF_SUM: f32 = 37_837.2;
/// Mean of that sum.
const MEAN_OF_SUM: f32 = 2.0 * 65_535.0;

/// What a beam's number is multiplied by before a key is added.
pub(super) const SPREAD: u32 = 0x9E37_79B9;

/// Three keys that differ from frame to frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NoiseKeys([u32; 3]);

impl NoiseKeys {
    pub(crate) fn new(seed: u64, sequence: u64) -> Self {
        let a = split_mix(seed ^ split_mix(sequence));
        let b = split_mix(a);
        Self([a as u32, (a >> 32) as u32, b as u32])
    }

    /// A number that is close to a standard normal one (Irwin–Hall of four: at most 3.46 in size), of a beam's number times [`SPREAD`].
    #[inline(always)]
    pub(crate) fn normal(self, spread: u32) -> f32 {
        let (u, v) = (mix(spread, self.0[0]), mix(spread, self.0[1]));
        let sum = (u & 0xFFFF) + (u >> 16) + (v & 0xFFFF) + (v >> 16);
        // The sum is below 2^18, so it is exact as i32 and f32.
        (sum as i32 as f32 - MEAN_OF_SUM) * (1.0 / SIGMA_OF_SUM)
    }

    #[inline(always)]
    pub(crate) fn uniform(self, spread: u32) -> u32 {
        mix(spread, self.0[2])
    }
}

/// 64 bits that look random from a seed (SplitMix64; Steele, Lea and Flood 2014).
pub fn split_mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

/// Wellons' `lowbias32` over a beam times [`SPREAD`] and a key: 32-bit multiplications only, so it vectorises.
#[inline(always)]
fn mix(spread: u32, key: u32) -> u32 {
    let x = spread.wrapping_add(key);
    let x = (x ^ (x >> 16)).wrapping_mul(0x7FEB_352D);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846C_A68B);
    x ^ (x >> 16)
}

vectorised! {
    /// Turns true ranges into the reciprocals of measured ranges, in 1/m; 0 where there was no return.
    pub(crate) fn measure(config: &LidarConfig, keys: NoiseKeys, ranges: &[f32], inverse: &mut [f32]) = measure_body;
}

#[inline(always)]
fn measure_body(config: &LidarConfig, keys: NoiseKeys, ranges: &[f32], inverse: &mut [f32]) {
    let sigma_m = config.range_noise_sigma_m;
    let (min_m, max_m) = (config.min_range_m, config.max_range_m);
    // Probabilities are within 0..=1; the cast saturates at 1.
    let dropped_below = (f64::from(config.dropout_probability) * 4_294_967_296.0) as u32;
    let measured = |spread: u32, true_m: f32| {
        let measured_m = true_m + sigma_m * keys.normal(spread);
        let measured_m = if measured_m > min_m { measured_m } else { min_m };
        let returned = (true_m <= max_m) & (keys.uniform(spread) >= dropped_below);
        if returned { 1.0 / measured_m } else { 0.0 }
    };
    let (ranges, _) = ranges.as_chunks::<TILE_FIRINGS>();
    let (inverse, _) = inverse.as_chunks_mut::<TILE_FIRINGS>();
    for (first, (ranges, inverse)) in ranges.iter().zip(inverse).enumerate() {
        // Where nothing is, nothing is measured: much of a view is sky.
        if ranges.iter().fold(true, |all, range_m| all & (*range_m > max_m)) {
            *inverse = [0.0; TILE_FIRINGS];
            continue;
        }
        let spread = ((first * TILE_FIRINGS) as u32).wrapping_mul(SPREAD);
        for k in 0..TILE_FIRINGS {
            // A sum where the beam's own product would be a multiplication more.
            inverse[k] = measured(spread.wrapping_add((k as u32).wrapping_mul(SPREAD)), ranges[k]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::LIDAR_BEAMS;
    use super::*;

    fn samples(seed: u64, sequence: u64) -> Vec<f64> {
        let keys = NoiseKeys::new(seed, sequence);
        (0..LIDAR_BEAMS as u32)
            .map(|b| f64::from(keys.normal(b.wrapping_mul(SPREAD))))
            .collect()
    }

    #[test]
    fn noise_is_standard_normal_in_its_first_moments() {
        let mut all = Vec::new();
        for sequence in 0..20 {
            all.extend(samples(7, sequence));
        }
        let n = all.len() as f64;
        let mean = all.iter().sum::<f64>() / n;
        let moment = |p: i32| all.iter().map(|x| (x - mean).powi(p)).sum::<f64>() / n;
        // Standard errors at n = 327 680: mean 0.0017, variance 0.0023, skewness 0.004.
        assert!(mean.abs() < 0.009, "{mean}");
        assert!((moment(2) - 1.0).abs() < 0.012, "{}", moment(2));
        assert!(moment(3).abs() < 0.02, "{}", moment(3));
        // Irwin–Hall of four has a kurtosis of 2.7.
        assert!((moment(4) - 2.7).abs() < 0.05, "{}", moment(4));
    }

    #[test]
    fn noise_of_neighbouring_beams_rings_and_frames_is_uncorrelated() {
        let limit = 5.0 / (LIDAR_BEAMS as f64).sqrt();
        let a = samples(1, 100);
        for (other, what) in [
            (samples(1, 101), "next frame"),
            (samples(2, 100), "next seed"),
            ([&a[1..], &a[..1]].concat(), "next beam"),
            ([&a[256..], &a[..256]].concat(), "next ring"),
        ] {
            let c = a.iter().zip(&other).map(|(x, y)| x * y).sum::<f64>() / a.len() as f64;
            assert!(c.abs() < limit, "{what}: {c}");
        }
    }
}
