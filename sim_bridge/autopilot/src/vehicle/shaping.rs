//! Setpoint shaping: from wanted velocity or yaw rate, which may jump, to a reference with limited acceleration and jerk.
//!
//! This is ArduPilot's scheme (`AP_Math/control.cpp`: `shape_vel_accel`, `sqrt_controller`): the wanted acceleration is
//! proportional to a small velocity error, and for a large one it is what a constant jerk can still take back.

use crate::vehicle::math::Vec3;

/// `gain · error` near zero; further out the square-root law whose own derivative stays within `limit`: the speed with
/// which to close an error so that braking never exceeds `limit`. For an error known to be positive.
pub(crate) fn square_root_law(error: f64, gain_per_s: f64, limit: f64) -> f64 {
    let linear = limit / (gain_per_s * gain_per_s);
    if error > linear {
        (2.0 * limit * (error - 0.5 * linear)).sqrt()
    } else {
        gain_per_s * error
    }
}

/// Limits of one shaped quantity.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Limits {
    /// Of the first derivative.
    pub(crate) accel: f64,
    /// Of the second derivative.
    pub(crate) jerk: f64,
    /// How fast small errors are closed, 1/s.
    pub(crate) gain_per_s: f64,
}

/// One shaped number and its derivative.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Shaped {
    pub(crate) value: f64,
    pub(crate) slope: f64,
}

impl Shaped {
    /// Moves towards the target for `dt_s`.
    pub(crate) fn advance(&mut self, target: f64, limits: &Limits, dt_s: f64) {
        let error = target - self.value;
        let magnitude = square_root_law(error.abs(), limits.gain_per_s, limits.jerk).min(limits.accel);
        let wanted = if error < 0.0 { -magnitude } else { magnitude };
        let step = limits.jerk * dt_s;
        self.slope += (wanted - self.slope).clamp(-step, step);
        self.value += self.slope * dt_s;
    }
}

/// The same for a horizontal vector: direction and size are limited together.
pub(crate) fn advance_horizontal(
    velocity: &mut Vec3,
    acceleration: &mut Vec3,
    target: (f64, f64),
    limits: &Limits,
    dt_s: f64,
) {
    let (ex, ey) = (target.0 - velocity.x, target.1 - velocity.y);
    let error = (ex * ex + ey * ey).sqrt();
    let wanted = square_root_law(error, limits.gain_per_s, limits.jerk).min(limits.accel);
    let scale = if error > 0.0 { wanted / error } else { 0.0 };
    let (dx, dy) = (ex * scale - acceleration.x, ey * scale - acceleration.y);
    let change = (dx * dx + dy * dy).sqrt();
    let step = limits.jerk * dt_s;
    let share = if change > step { step / change } else { 1.0 };
    acceleration.x += dx * share;
    acceleration.y += dy * share;
    velocity.x += acceleration.x * dt_s;
    velocity.y += acceleration.y * dt_s;
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.004;
    const LIMITS: Limits = Limits {
        accel: 2.5,
        jerk: 5.0,
        gain_per_s: 2.2,
    };

    #[test]
    fn a_step_keeps_the_limits_and_does_not_overshoot() {
        for target in [0.5, -1.5, 3.0, 10.0] {
            let mut v = Shaped::default();
            let mut slope = 0.0;
            for _ in 0..3_000 {
                v.advance(target, &LIMITS, DT_S);
                assert!(v.slope.abs() <= LIMITS.accel + 1e-12);
                assert!((v.slope - slope).abs() <= LIMITS.jerk * DT_S + 1e-12);
                assert!(v.value.abs() <= target.abs() * 1.01);
                slope = v.slope;
            }
            assert!((v.value - target).abs() < 1e-3);
        }
    }

    #[test]
    fn a_vector_along_one_axis_moves_as_a_number_does() {
        let mut number = Shaped::default();
        let (mut velocity, mut acceleration) = (Vec3::zeros(), Vec3::zeros());
        for _ in 0..500 {
            number.advance(-3.0, &LIMITS, DT_S);
            advance_horizontal(&mut velocity, &mut acceleration, (0.0, -3.0), &LIMITS, DT_S);
            assert!((velocity.y - number.value).abs() < 1e-9);
            assert_eq!(velocity.x, 0.0);
        }
    }

    #[test]
    fn a_closing_speed_can_be_braked_within_the_distance() {
        for distance_m in [0.01, 0.5, 2.0, 50.0] {
            let speed = square_root_law(distance_m, 1.0, 1.25);
            assert!(speed * speed / (2.0 * 1.25) <= distance_m);
        }
    }
}
