//! Exponential and its kin in float32, written so that loops over them vectorise and give the same bits on every
//! instruction set (no fused operations, no table).

/// `exp(x) − 1` for `x ≤ 0`, accurate near zero as well. NaN stays NaN.
///
/// `x` in units of ln 2 is split into its nearest integer n and a rest f; `2^f − 1` is `f` times a polynomial (least
/// maximum error on ±½: 1.1e-8, relative), so the small difference is never formed from large terms. Rounding `x` to
/// units of ln 2 costs a relative error of `exp(x)` that grows with |x|, but of `exp(x) − 1` at most 5e-8.
#[inline(always)]
pub(crate) fn exp_m1_negative(x: f32) -> f32 {
    // Adding 1.5 · 2^23 leaves the nearest integer in the low mantissa bits.
    const ROUND: f32 = 12_582_912.0;
    // Below this the result is −1 in float32, and 2^n would leave the normal range.
    let x = if x < -80.0 { -80.0 } else { x };
    let t = x * core::f32::consts::LOG2_E;
    let rounded = t + ROUND;
    let f = t - (rounded - ROUND);
    let mut p = 1.546_973_5e-4;
    p = p * f + 1.339_086_7e-3;
    p = p * f + 9.618_031e-3;
    p = p * f + 5.550_357e-2;
    p = p * f + 2.402_265e-1;
    p = p * f + core::f32::consts::LN_2;
    let scale = f32::from_bits((rounded.to_bits() << 23).wrapping_add(0x3f80_0000));
    scale * (p * f) + (scale - 1.0)
}

/// Hyperbolic tangent.
#[inline(always)]
pub(crate) fn tanh(x: f32) -> f32 {
    let t = exp_m1_negative(-2.0 * x.abs());
    (-t / (t + 2.0)).copysign(x)
}

/// `1 / (1 + exp(−x))`.
#[inline(always)]
pub(crate) fn sigmoid(x: f32) -> f32 {
    let e = 1.0 + exp_m1_negative(-x.abs());
    let small = e / (1.0 + e);
    if x < 0.0 { small } else { 1.0 / (1.0 + e) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_agrees_with_libm_in_float64() {
        let mut worst: f64 = 0.0;
        for i in 0..200_000 {
            let x = -(i as f32) * 1e-7 * (1.0 + i as f32 * 0.02);
            let exact = libm::expm1(f64::from(x));
            let error = (f64::from(exp_m1_negative(x)) - exact).abs() / exact.abs().max(1e-30);
            worst = worst.max(error);
        }
        assert!(worst < 2.5e-7, "relative error {worst:e}");
    }

    #[test]
    fn tanh_and_sigmoid_agree_with_libm_and_saturate() {
        for i in -3000..=3000 {
            let x = i as f32 * 0.01;
            assert!((f64::from(tanh(x)) - libm::tanh(f64::from(x))).abs() < 2e-7);
            let exact = 1.0 / (1.0 + libm::exp(-f64::from(x)));
            assert!((f64::from(sigmoid(x)) - exact).abs() < 2e-7);
        }
        assert_eq!(tanh(f32::INFINITY), 1.0);
        assert_eq!(tanh(f32::NEG_INFINITY), -1.0);
        assert_eq!(sigmoid(f32::INFINITY), 1.0);
        assert!(sigmoid(f32::NEG_INFINITY) < 1e-30);
    }

    #[test]
    fn what_is_not_a_number_stays_so() {
        assert!(exp_m1_negative(f32::NAN).is_nan());
        assert!(tanh(f32::NAN).is_nan());
        assert!(sigmoid(f32::NAN).is_nan());
    }
}
