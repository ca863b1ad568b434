//! What a vehicle's reported heading lacks of where its nose points.
//!
//! An estimator that corrects its heading by GNSS turns it in flight though the vehicle does not turn. PX4's (SIH, as shipped) wanders
//! by 4° (standard deviation, correlated over 8 s; up to 16° in a flight of half a minute), while its yaw rates, summed up from the
//! ground on, are within 1° of the truth (docs/vehicle.md). A frame is seen from where the nose points, so it is laid onto the map, and
//! a velocity is asked for, by the sum of the rates; the reported heading draws that sum back slowly.

use vigil_types::{Attitude, FrdVector, wrap_pi};

/// Time in which the reported heading draws back the sum of the rates, seconds: a gyroscope's offset of 1° a minute makes 1°.
const TIME_S: f32 = 60.0;
/// An estimator that was never off by more than the first agrees with itself, and nothing is corrected; one that was off by the second, all
/// is: radians (2.2°, 3.2°). Where only what exceeds a limit is corrected, the heading turns by twice the limit as the error changes its side.
const AGREES_RAD: f32 = 0.038;
const ERRS_RAD: f32 = 0.056;
/// Time in which it is forgotten that an estimator was off, seconds.
const FORGOTTEN_S: f32 = 30.0;
/// Who lacks more than this (30°) errs otherwise, or was set anew: it is believed, and the sum begins anew. Less is not: PX4 set its
/// heading anew in flight by 13° to the truth once, and once by 21° away from it.
const GREATEST_RAD: f32 = 0.52;
/// Reports farther apart, seconds, say nothing of how the vehicle turned.
const GAP_S: f32 = 0.3;

/// Sum of what the heading lacked.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct HeadingError {
    last: Option<(u32, f32, f32)>,
    sum_rad: f32,
    /// The greatest of late.
    greatest_rad: f32,
}

impl HeadingError {
    /// A report with its time since boot. On the ground the heading is the compass's, and right.
    pub fn take(&mut self, boot_ms: u32, attitude: Attitude, rates_frd_rad_s: FrdVector, is_airborne: bool) {
        let (yaw_rad, rate_rad_s) = (attitude.yaw_rad(), yaw_rate_rad_s(attitude, rates_frd_rad_s));
        let last = self.last.replace((boot_ms, yaw_rad, rate_rad_s));
        // Rates of exactly 0 are a field that is not filled.
        let is_filled = rates_frd_rad_s != FrdVector::new(0.0, 0.0, 0.0);
        let Some((last_ms, last_rad, last_rad_s)) = last.filter(|_| is_airborne && is_filled) else {
            self.sum_rad = if is_airborne { self.sum_rad } else { 0.0 };
            return;
        };
        let since_s = boot_ms.wrapping_sub(last_ms) as f32 * 1e-3;
        if since_s > 0.0 && since_s <= GAP_S {
            let lacks_rad = (last_rad_s + rate_rad_s) * 0.5 * since_s - wrap_pi(yaw_rad - last_rad);
            let sum_rad = (self.sum_rad + lacks_rad) * (1.0 - since_s / TIME_S);
            // False for what is not finite.
            self.sum_rad = if sum_rad.abs() < GREATEST_RAD { sum_rad } else { 0.0 };
            let faded_rad = self.greatest_rad * (1.0 - since_s / FORGOTTEN_S);
            self.greatest_rad = faded_rad.max(self.sum_rad.abs());
        }
    }

    /// What to add to the reported heading, radians.
    pub fn lacks_rad(&self) -> f32 {
        self.sum_rad * ((self.greatest_rad - AGREES_RAD) / (ERRS_RAD - AGREES_RAD)).clamp(0.0, 1.0)
    }
}

/// How fast the heading turns at these rates of the body.
fn yaw_rate_rad_s(attitude: Attitude, rates_frd_rad_s: FrdVector) -> f32 {
    let (roll_rad, pitch_rad) = (attitude.roll_rad(), attitude.pitch_rad());
    let turn_rad_s = rates_frd_rad_s.y * libm::sinf(roll_rad) + rates_frd_rad_s.z * libm::cosf(roll_rad);
    // A vehicle on its nose has no heading.
    turn_rad_s / libm::cosf(pitch_rad).max(0.2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds of reports at 50 Hz: the heading that is reported turns so fast, the rates say so much.
    fn after(error: &mut HeadingError, seconds: f32, reported_rad_s: f32, turns_rad_s: f32) -> f32 {
        let (mut at_ms, mut yaw_rad, _) = error.last.unwrap_or((0, 3.0, 0.0));
        for _ in 0..(seconds * 50.0) as u32 {
            at_ms += 20;
            yaw_rad = wrap_pi(yaw_rad + reported_rad_s * 0.02);
            let rates = FrdVector::new(1e-4, 0.0, turns_rad_s);
            error.take(at_ms, Attitude::from_euler_rad(0.0, 0.0, yaw_rad), rates, true);
        }
        error.lacks_rad()
    }

    fn near(rad: f32, degrees: f32) -> bool {
        (rad.to_degrees() - degrees).abs() < 0.3
    }

    #[test]
    fn a_heading_that_turns_without_a_turn_is_found_out_and_one_that_turns_with_the_vehicle_is_not() {
        let mut error = HeadingError::default();
        assert_eq!(after(&mut error, 10.0, -0.5, -0.5), 0.0);
        // 12° in four seconds, while the vehicle turns the other way.
        let lacks_rad = after(&mut error, 4.0, 0.0523 - 0.5, -0.5);
        assert!(near(lacks_rad, -11.6), "{lacks_rad}");
        // As it comes back, so does the correction.
        assert!(near(after(&mut error, 4.0, -0.0523, 0.0), 0.5));
        // And as it goes on to the other side: there is no span in which nothing is corrected.
        assert!(near(after(&mut error, 0.5, -0.0523, 0.0), 2.0));
    }

    #[test]
    fn what_a_gyroscope_is_off_by_makes_little() {
        let mut error = HeadingError::default();
        // 2° a minute, for ten minutes.
        let lacks_rad = after(&mut error, 600.0, 0.0, 2f32.to_radians() / 60.0);
        assert!(lacks_rad.abs() < 0.3f32.to_radians(), "{lacks_rad}");
    }

    #[test]
    fn on_the_ground_the_compass_is_believed_and_rates_that_are_not_filled_say_nothing() {
        let turned = |yaw_rad| Attitude::from_euler_rad(0.0, 0.0, yaw_rad);
        let still = FrdVector::new(0.0, 0.0, 0.0);
        let mut error = HeadingError::default();
        for step in 0..200_u32 {
            error.take(step * 20, turned(0.01 * step as f32), still, true);
        }
        assert_eq!(error.lacks_rad(), 0.0);
        assert!(near(after(&mut error, 4.0, 0.0523, 0.0), -11.6));
        let (at_ms, yaw_rad, _) = error.last.unwrap();
        error.take(at_ms + 20, turned(yaw_rad), FrdVector::new(1e-4, 0.0, 0.0), false);
        assert_eq!(error.lacks_rad(), 0.0);
    }

    #[test]
    fn a_heading_that_is_set_anew_by_much_is_believed_and_a_gap_says_nothing() {
        let mut error = HeadingError::default();
        let lacks_rad = after(&mut error, 4.0, 0.0523, 0.0);
        let (at_ms, yaw_rad, _) = error.last.unwrap();
        let rates = FrdVector::new(1e-4, 0.0, 0.0);
        let later = Attitude::from_euler_rad(0.0, 0.0, yaw_rad + 0.5);
        let mut by_little = error;
        by_little.take(
            at_ms + 20,
            Attitude::from_euler_rad(0.0, 0.0, yaw_rad + 0.2),
            rates,
            true,
        );
        assert!(near(by_little.lacks_rad() - lacks_rad, -11.5));
        let mut after_gap = error;
        after_gap.take(at_ms + 1_000, later, rates, true);
        assert_eq!(after_gap.lacks_rad(), lacks_rad);
        error.take(at_ms + 20, later, rates, true);
        assert_eq!(error.lacks_rad(), 0.0);
        // And so is one that is not a number.
        after(&mut error, 4.0, 0.0523, 0.0);
        let (at_ms, ..) = error.last.unwrap();
        error.take(at_ms + 20, Attitude::from_euler_rad(0.0, 0.0, f32::NAN), rates, true);
        error.take(at_ms + 40, Attitude::from_euler_rad(0.0, 0.0, 1.0), rates, true);
        assert_eq!(error.lacks_rad(), 0.0);
    }

    #[test]
    fn who_lacks_more_than_an_estimator_errs_by_is_not_corrected() {
        let mut error = HeadingError::default();
        for _ in 0..100 {
            let lacks_rad = after(&mut error, 0.1, 0.0, 1.0);
            assert!(lacks_rad <= GREATEST_RAD, "{lacks_rad}");
        }
    }
}
