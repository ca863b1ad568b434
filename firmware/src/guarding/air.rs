//! What drag and wind do to a guarded vehicle (docs/just-stop.md).

use super::STANDING_M_S;
use vigil_guidance::just_stop::Gain;
use vigil_types::{Kinematics, Nanos, NedVector};

/// Drag and wind are followed as an observer of second order of this frequency, rad/s, and a damping of 0.8; of a lower one where
/// velocities come so seldom that it would not be stable.
const OBSERVER_RAD_S: f32 = 4.0;
const OBSERVER_PER_STEP: f32 = 0.8;
/// The growth of the gain is the mean of about this time, seconds.
const GROWTH_S: f32 = 0.15;
/// What the wind takes away is learnt within about this time of standing, seconds.
const WIND_S: f32 = 1.0;
/// The most that they are believed to take away, metres per second squared.
const GREATEST_LOSS_M_S2: f32 = 4.0;
/// After a gap so long between two velocities it begins anew, seconds.
const OBSERVER_GAP_S: f32 = 0.5;

/// What drag and wind take off the acceleration that the tilt gives: a steady tilt against them is no gain of speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Air {
    at_ns: Nanos,
    /// Followed velocity, NED.
    velocity_ned_m_s: NedVector,
    /// Taken away, NED.
    loss_ned_m_s2: NedVector,
    /// What is left, and how fast it grows.
    pub gain_ned_m_s2: NedVector,
    growth_ned_m_s3: NedVector,
    /// The fastest that it has grown.
    shown_m_s3: f32,
    /// Taken away while it stands, by the wind alone: the mean of about [`WIND_S`].
    pub wind_m_s2: f32,
}

impl Air {
    /// One that knows of no drag yet, which errs to the careful side.
    pub fn new(now: &Kinematics, lean_ned_m_s2: NedVector) -> Self {
        Self {
            at_ns: now.at_ns,
            velocity_ned_m_s: now.velocity_ned_m_s,
            loss_ned_m_s2: NedVector::ZERO,
            gain_ned_m_s2: lean_ned_m_s2,
            growth_ned_m_s3: NedVector::ZERO,
            shown_m_s3: 0.0,
            wind_m_s2: 0.0,
        }
    }

    /// Up to this velocity, with this acceleration by the tilt since the last one.
    pub fn follow(self, now: &Kinematics, lean_ned_m_s2: NedVector) -> Self {
        let dt_s = now.at_ns.saturating_sub(self.at_ns) as f32 * 1e-9;
        if dt_s > OBSERVER_GAP_S {
            return Self::new(now, lean_ned_m_s2);
        }
        if dt_s <= 0.0 {
            return self;
        }
        let rad_s = OBSERVER_RAD_S.min(OBSERVER_PER_STEP / dt_s);
        let predicted = self.velocity_ned_m_s + (lean_ned_m_s2 - self.loss_ned_m_s2) * dt_s;
        let error = now.velocity_ned_m_s - predicted;
        let loss = self.loss_ned_m_s2 - error * (rad_s * rad_s * dt_s);
        let size = loss.horizontal_norm();
        let share = if size > GREATEST_LOSS_M_S2 {
            GREATEST_LOSS_M_S2 / size
        } else {
            1.0
        };
        let loss_ned_m_s2 = NedVector::new(loss.x * share, loss.y * share, 0.0);
        let gain_ned_m_s2 = lean_ned_m_s2 - loss_ned_m_s2;
        let growth = (gain_ned_m_s2 - self.gain_ned_m_s2) * (1.0 / dt_s);
        let growth_ned_m_s3 = self.growth_ned_m_s3 + (growth - self.growth_ned_m_s3) * (dt_s / (dt_s + GROWTH_S));
        let stands = now.velocity_ned_m_s.horizontal_norm() < STANDING_M_S;
        let learns = if stands { dt_s / (dt_s + WIND_S) } else { 0.0 };
        Self {
            at_ns: now.at_ns,
            velocity_ned_m_s: predicted + error * (1.6 * rad_s * dt_s),
            loss_ned_m_s2,
            gain_ned_m_s2,
            growth_ned_m_s3,
            shown_m_s3: self.shown_m_s3.max(growth_ned_m_s3.horizontal_norm()),
            wind_m_s2: self.wind_m_s2 + (loss_ned_m_s2.horizontal_norm() - self.wind_m_s2) * learns,
        }
    }

    /// What it gains along this velocity.
    pub fn gain_along(&self, velocity: NedVector) -> Gain {
        let speed_m_s = velocity.horizontal_norm();
        let along = |v: NedVector| (v.x * velocity.x + v.y * velocity.y) / speed_m_s;
        if speed_m_s > 0.0 {
            Gain {
                gain_m_s2: along(self.gain_ned_m_s2),
                growth_m_s3: along(self.growth_ned_m_s3),
                shown_m_s3: self.shown_m_s3,
                wind_m_s2: self.wind_m_s2,
            }
        } else {
            Gain::default()
        }
    }
}
