//! How a vehicle answers the velocities asked for, and what it has to be asked for so that it answers as pilots expect.
//!
//! Pilots, governor and guard reckon with a vehicle that has gone 63 % of the way to a new velocity after 0.77 s (docs/vehicle.md). One
//! with strong drag, whose autopilot follows a velocity that errs (PX4's SIH as shipped), drifts, slips sideways for seconds after a turn
//! and stops late: a real one collided so in most of its collisions. Such a vehicle is asked for more, by what it lacks.

use libm::sqrtf;
use vigil_types::{Nanos, NedVector};

/// The expected answer: three lags of this one behind another, seconds.
const LAG_S: f32 = 0.25;
/// Share of what it lacks that it is asked for beside. With twice as much PX4's velocity swings.
const SHARE: f32 = 0.5;
/// No more than this is added, metres per second.
const MOST_M_S: f32 = 0.6;
/// What it lacks on average over this time says how it answers, seconds.
const TIME_S: f32 = 10.0;
/// From the first on, on average, metres per second, it is helped, from the second on by the whole share.
const LACKS_M_S: (f32, f32) = (0.14, 0.18);
/// After so long without a setpoint its velocity is where the expected answer begins.
const GAP_NS: Nanos = 300_000_000;

/// What was asked for and what came of it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Answer {
    last_ns: Option<Nanos>,
    expected_m_s: [NedVector; 3],
    squared_m2_s2: f32,
}

impl Answer {
    /// What to ask for beside the velocity that is wanted now, both NED, for a vehicle with this velocity; level.
    pub fn beside(&mut self, now_ns: Nanos, wanted_m_s: NedVector, velocity_m_s: NedVector) -> NedVector {
        let level = |v: NedVector| NedVector::new(v.x, v.y, 0.0);
        let (wanted_m_s, velocity_m_s) = (level(wanted_m_s), level(velocity_m_s));
        let since_ns = self
            .last_ns
            .replace(now_ns)
            .map(|last_ns| now_ns.saturating_sub(last_ns));
        let Some(since_ns) = since_ns.filter(|since_ns| *since_ns <= GAP_NS) else {
            self.expected_m_s = [velocity_m_s; 3];
            return NedVector::ZERO;
        };
        let since_s = since_ns as f32 * 1e-9;
        let mut towards_m_s = wanted_m_s;
        for expected_m_s in &mut self.expected_m_s {
            *expected_m_s = *expected_m_s + (towards_m_s - *expected_m_s) * (since_s / (LAG_S + since_s));
            towards_m_s = *expected_m_s;
        }
        let lacks_m_s = towards_m_s - velocity_m_s;
        let (from_m_s, whole_m_s) = LACKS_M_S;
        let helped = ((sqrtf(self.squared_m2_s2) - from_m_s) / (whole_m_s - from_m_s)).clamp(0.0, 1.0);
        let asked_m_s = lacks_m_s * (SHARE * helped);
        // Unhelped it would lack as much more.
        let squared_m2_s2 = (lacks_m_s + asked_m_s).norm() * (lacks_m_s + asked_m_s).norm();
        if squared_m2_s2.is_finite() {
            self.squared_m2_s2 += (squared_m2_s2 - self.squared_m2_s2) * (since_s / TIME_S);
        } else {
            *self = Self::default();
            return NedVector::ZERO;
        }
        let asked_norm_m_s = asked_m_s.norm();
        if asked_norm_m_s <= MOST_M_S {
            asked_m_s
        } else {
            asked_m_s * (MOST_M_S / asked_norm_m_s)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: Nanos = 50_000_000;

    /// How fast a vehicle moves, east, after so many seconds at this wanted velocity: it answers with one lag, and something carries it
    /// aside by so much.
    fn after(answer: &mut Answer, seconds: u64, wanted_m_s: f32, carried_m_s: f32) -> (f32, f32) {
        let (mut velocity_m_s, mut beside_m_s) = (0.0, 0.0);
        let from_ns = answer.last_ns.unwrap_or(0);
        for step in 1..=seconds * 20 {
            let ned = |east_m_s| NedVector::new(0.0, east_m_s, 0.3);
            beside_m_s = answer
                .beside(from_ns + step * STEP_NS, ned(wanted_m_s), ned(velocity_m_s))
                .y;
            velocity_m_s += (wanted_m_s + beside_m_s + carried_m_s - velocity_m_s) * 0.06;
        }
        (velocity_m_s, beside_m_s)
    }

    #[test]
    fn what_carries_a_vehicle_aside_is_flown_against_once_it_is_known() {
        let mut answer = Answer::default();
        let (drifts_m_s, _) = after(&mut answer, 2, 0.0, 0.3);
        assert!(drifts_m_s > 0.25, "not before: {drifts_m_s}");
        let (drifts_m_s, beside_m_s) = after(&mut answer, 20, 0.0, 0.3);
        assert!(
            (drifts_m_s - 0.2).abs() < 0.02 && (beside_m_s + 0.1).abs() < 0.02,
            "{drifts_m_s}"
        );
    }

    #[test]
    fn a_vehicle_that_answers_as_expected_is_asked_for_nothing_else() {
        for wanted_m_s in [1.5, 0.2, 1.0, -1.5] {
            let mut answer = Answer::default();
            assert_eq!(after(&mut answer, 2, wanted_m_s, 0.0).1, 0.0);
            assert_eq!(
                after(
                    &mut Answer {
                        last_ns: None,
                        ..answer
                    },
                    20,
                    wanted_m_s,
                    0.0
                )
                .1,
                0.0
            );
        }
    }

    #[test]
    fn no_more_is_asked_for_than_that_and_after_a_gap_all_begins_anew() {
        let mut answer = Answer::default();
        let (_, beside_m_s) = after(&mut answer, 30, 0.0, 3.0);
        assert!((beside_m_s + MOST_M_S).abs() < 1e-5, "{beside_m_s}");
        let later_ns = 40_000_000_000;
        let asked = |answer: &mut Answer, at_ns, velocity_m_s| answer.beside(at_ns, NedVector::ZERO, velocity_m_s);
        let drifts = NedVector::new(0.0, 3.0, 0.0);
        assert_eq!(asked(&mut answer, later_ns, drifts), NedVector::ZERO);
        assert!(asked(&mut answer, later_ns + STEP_NS, drifts).y < 0.0);
        let not_finite = NedVector::new(f32::NAN, 0.0, 0.0);
        assert_eq!(asked(&mut answer, later_ns + 2 * STEP_NS, not_finite), NedVector::ZERO);
        assert_eq!(answer, Answer::default());
    }
}
