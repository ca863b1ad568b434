//! What a vehicle's reported velocity lacks of the rate at which its reported position changes.
//!
//! An estimator that hangs on GNSS is corrected in its position sooner than in its velocity: PX4's (SIH, as shipped) reports a
//! velocity that is 0.2 m/s off (standard deviation per axis, correlated over seconds; up to 0.5 m/s and, in a flight of 1.2 m/s, 25°),
//! and as it is that velocity which follows the setpoint, the vehicle drifts by so much in a hold and beside its nose in flight.
//! Flying by what the position does halves the error (0.22 to 0.12 m/s against the truth, docs/vehicle.md).

use vigil_types::NedVector;

/// Time constant of the mean, seconds.
const TIME_S: f32 = 0.5;
/// Below this an estimator agrees with itself and nothing is corrected, metres per second; above, what exceeds it counts.
const AGREES_M_S: f32 = 0.05;
/// No more than this is corrected: beyond it something else is wrong.
const GREATEST_M_S: f32 = 0.6;
/// Reports farther apart, seconds, say nothing of a velocity.
const GAP_S: f32 = 0.5;
/// A position that is so much faster than its velocity jumped, metres per second.
const JUMP_M_S: f32 = 5.0;

/// Mean of what the velocity lacked.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct VelocityError {
    last: Option<(u32, NedVector, NedVector)>,
    mean_m_s: NedVector,
}

impl VelocityError {
    /// A report with its time since boot; what to add to its velocity, NED, metres per second.
    pub fn take(&mut self, boot_ms: u32, position_ned_m: NedVector, velocity_ned_m_s: NedVector) -> NedVector {
        if let Some((last_ms, last_m, last_m_s)) = self.last.replace((boot_ms, position_ned_m, velocity_ned_m_s)) {
            let since_s = boot_ms.wrapping_sub(last_ms) as f32 * 1e-3;
            if since_s > 0.0 && since_s <= GAP_S {
                let moved_m_s = (position_ned_m - last_m) * (1.0 / since_s);
                let lacks_m_s = NedVector::new(
                    beyond(moved_m_s.x, last_m_s.x, velocity_ned_m_s.x),
                    beyond(moved_m_s.y, last_m_s.y, velocity_ned_m_s.y),
                    beyond(moved_m_s.z, last_m_s.z, velocity_ned_m_s.z),
                );
                // False for what is not finite.
                if lacks_m_s.norm() < JUMP_M_S {
                    self.mean_m_s = self.mean_m_s + (lacks_m_s - self.mean_m_s) * (since_s / (TIME_S + since_s));
                }
            }
        }
        self.lacks_m_s()
    }

    /// What the velocity lacks now, NED, metres per second.
    pub fn lacks_m_s(&self) -> NedVector {
        let norm_m_s = self.mean_m_s.norm();
        if norm_m_s <= AGREES_M_S {
            return NedVector::ZERO;
        }
        self.mean_m_s * ((norm_m_s - AGREES_M_S).min(GREATEST_M_S) / norm_m_s)
    }
}

/// By how much a rate lies beyond the two velocities between which it was measured.
fn beyond(rate_m_s: f32, before_m_s: f32, after_m_s: f32) -> f32 {
    let (low_m_s, high_m_s) = if before_m_s < after_m_s {
        (before_m_s, after_m_s)
    } else {
        (after_m_s, before_m_s)
    };
    rate_m_s - rate_m_s.max(low_m_s).min(high_m_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reports at 30 Hz of a vehicle that moves at `moves_m_s` and says `says_m_s`, for so long; what is added at the end.
    fn after(error: &mut VelocityError, seconds: f32, moves_m_s: NedVector, says_m_s: NedVector) -> NedVector {
        let (mut at_ms, mut at_m, _) = error.last.unwrap_or((0, NedVector::ZERO, NedVector::ZERO));
        for _ in 0..(seconds * 30.0) as u32 {
            at_ms += 33;
            at_m = at_m + moves_m_s * 0.033;
            error.take(at_ms, at_m, says_m_s);
        }
        error.lacks_m_s()
    }

    const STANDS: NedVector = NedVector::ZERO;
    const DRIFTS: NedVector = NedVector::new(0.3, -0.2, 0.0);

    #[test]
    fn a_vehicle_that_drifts_and_says_that_it_stands_is_found_out_within_two_seconds() {
        let mut error = VelocityError::default();
        assert!((after(&mut error, 2.0, DRIFTS, STANDS) - DRIFTS).norm() < 0.06);
        assert_eq!(
            after(&mut error, 3.0, STANDS, STANDS),
            NedVector::ZERO,
            "and when it is over, forgotten"
        );
        // One that stands and says that it moves.
        assert!((after(&mut error, 2.0, STANDS, DRIFTS) + DRIFTS).norm() < 0.06);
    }

    #[test]
    fn an_estimator_that_agrees_with_itself_is_left_alone() {
        let mut error = VelocityError::default();
        let flies = NedVector::new(1.5, 0.0, -0.5);
        assert_eq!(after(&mut error, 3.0, flies, flies), NedVector::ZERO);
        // Across jumps, gaps and what is not finite too.
        let (at_ms, at_m, _) = error.last.expect("reports");
        let elsewhere_m = at_m + NedVector::new(2.0, 0.0, 0.0);
        assert_eq!(error.take(at_ms + 33, elsewhere_m, flies), NedVector::ZERO);
        assert_eq!(error.take(at_ms + 3_033, elsewhere_m, flies), NedVector::ZERO);
        assert_eq!(
            error.take(at_ms + 3_066, NedVector::new(f32::NAN, 0.0, 0.0), flies),
            NedVector::ZERO
        );
        assert_eq!(error.take(at_ms + 3_099, elsewhere_m, flies), NedVector::ZERO);
    }

    #[test]
    fn no_more_is_corrected_than_an_estimator_errs_by() {
        let mut error = VelocityError::default();
        let lacks_m_s = after(&mut error, 5.0, NedVector::new(0.0, 3.0, 0.0), STANDS);
        assert!((lacks_m_s.norm() - GREATEST_M_S).abs() < 1e-5, "{lacks_m_s:?}");
    }
}
