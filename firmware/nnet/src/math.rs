//! Exponential and its kin in float32, written so that loops over them vectorise (no table, no branch). `FUSED` as in
//! [`crate::kernels::Task`].

use crate::kernels::mul_add;

/// `exp(x) − 1` for `x ≤ 0`, accurate near zero as well. NaN stays NaN.
///
/// `x` in units of ln 2 is split into its nearest integer n and a rest f; `2^f − 1` is `f` times a polynomial (least
/// maximum error on ±½: 1.1e-8, relative), so the small difference is never formed from large terms. Rounding `x` to
/// units of ln 2 costs a relative error of `exp(x)` that grows with |x|, but of `exp(x) − 1` at most 5e-8.
#[inline(always)]
pub(crate) fn exp_m1_negative<const FUSED: bool>(x: f32) -> f32 {
    // Adding 1.5 · 2^23 leaves the nearest integer in the low mantissa bits.
    const ROUND: f32 = 12_582_912.0;
    // Below this the result is −1 in float32, and 2^n would leave the normal range.
    let x = if x < -80.0 { -80.0 } else { x };
    let fma = mul_add::<FUSED>;
    let rounded = fma(x, core::f32::consts::LOG2_E, ROUND);
    let f = fma(x, core::f32::consts::LOG2_E, ROUND - rounded);
    let mut p = 1.546_973_5e-4;
    p = fma(p, f, 1.339_086_7e-3);
    p = fma(p, f, 9.618_031e-3);
    p = fma(p, f, 5.550_357e-2);
    p = fma(p, f, 2.402_265e-1);
    p = fma(p, f, core::f32::consts::LN_2);
    let scale = f32::from_bits((rounded.to_bits() << 23).wrapping_add(0x3f80_0000));
    fma(scale, p * f, scale - 1.0)
}

/// Hyperbolic tangent.
#[inline(always)]
pub(crate) fn tanh<const FUSED: bool>(x: f32) -> f32 {
    let t = exp_m1_negative::<FUSED>(-2.0 * x.abs());
    (-t / (t + 2.0)).copysign(x)
}

/// `1 / (1 + exp(−x))`.
#[inline(always)]
pub(crate) fn sigmoid<const FUSED: bool>(x: f32) -> f32 {
    let e = 1.0 + exp_m1_negative::<FUSED>(-x.abs());
    let small = e / (1.0 + e);
    if x < 0.0 { small } else { 1.0 / (1.0 + e) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without fused multiply-add and with it.
    type Both = [fn(f32) -> f32; 2];
    const EXP_M1: Both = [exp_m1_negative::<false>, exp_m1_negative::<true>];
    const TANH: Both = [tanh::<false>, tanh::<true>];
    const SIGMOID: Both = [sigmoid::<false>, sigmoid::<true>];

    fn each(of: Both, x: f32, check: impl Fn(f64)) {
        of.into_iter().for_each(|f| check(f64::from(f(x))));
    }

    #[test]
    fn the_exponential_agrees_with_libm_in_float64() {
        for i in 1..200_000 {
            let x = -(i as f32) * 1e-7 * (1.0 + i as f32 * 0.02);
            let exact = libm::expm1(f64::from(x));
            each(EXP_M1, x, |y| {
                let error = (y - exact).abs() / exact.abs();
                assert!(error < 2.5e-7, "relative error {error:e} at {x}");
            });
        }
    }

    #[test]
    fn tanh_and_sigmoid_agree_with_libm_and_saturate() {
        for i in -3000..=3000 {
            let x = i as f32 * 0.01;
            each(TANH, x, |y| {
                assert!((y - libm::tanh(f64::from(x))).abs() < 2e-7);
            });
            let exact = 1.0 / (1.0 + libm::exp(-f64::from(x)));
            each(SIGMOID, x, |y| assert!((y - exact).abs() < 2e-7));
        }
        each(TANH, f32::INFINITY, |y| assert_eq!(y, 1.0));
        each(TANH, f32::NEG_INFINITY, |y| assert_eq!(y, -1.0));
        each(SIGMOID, f32::INFINITY, |y| assert_eq!(y, 1.0));
        each(SIGMOID, f32::NEG_INFINITY, |y| assert!(y < 1e-30));
    }

    #[test]
    fn what_is_not_a_number_stays_so() {
        let check = |y: f64| assert!(y.is_nan());
        each(EXP_M1, f32::NAN, check);
        each(TANH, f32::NAN, check);
        each(SIGMOID, f32::NAN, check);
    }
}
