//! How a vehicle moves by what it sees: what its reported velocity is off by, from two pictures and the way between them.
//!
//! An estimator on GNSS says for seconds that the vehicle moves 0.1 to 0.3 m/s otherwise than it does (a PX4 in SIH, docs/vehicle.md), by
//! which it drifts into what it means to pass. Every surface of one picture has to be where the way since puts it in another one; the shift
//! that fits best is what the velocity, summed up between the two, is off by. The surfaces are found along the rays (projective data
//! association; Newcombe et al. 2011), in one step of Gauss and Newton.

use super::comparison::Anchor;
use super::drift::Pair;
use super::motion::{Map, Pose, samples};
use super::picture::{Directions, Picture};
use vigil_types::{Attitude, Kinematics, Nanos, NedVector};

/// How long ago the picture was taken that this one is compared with: rather so long, and within these, seconds.
const AGO_S: f32 = 0.25;
const LEAST_AGO_S: f32 = 0.09;
const MOST_AGO_S: f32 = 1.0;
/// What a velocity may be off by: this is as sure as that it is right, where the surfaces seen do not tell, metres and metres a second.
const MAY_BE_M: f32 = 0.02;
const MAY_BE_M_S: f32 = 0.5;
/// Time constant of the mean, seconds, and of forgetting it where nothing can be compared.
const MEAN_S: f32 = 0.15;
const FORGOTTEN_S: f32 = 1.0;
/// Below this the velocity is right, and more than this is not believed, metres per second: who shows other things than there are can let
/// the vehicle drift by no more.
const RIGHT_M_S: f32 = 0.03;
const GREATEST_M_S: f32 = 0.4;
/// Frames farther apart than this count as so far apart, seconds.
const GAP_S: f32 = 0.3;

/// The reported velocity summed up, and what it was off by.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Odometry {
    last: Option<(Nanos, Kinematics)>,
    /// From the last frame to this one, seconds.
    since_s: f32,
    /// The reported velocity summed up, metres.
    pub(super) path_ned_m: NedVector,
    error_m_s: NedVector,
}

impl Odometry {
    /// What the reported velocity is more than the vehicle's, NED, metres per second.
    pub(super) fn error_m_s(&self) -> NedVector {
        let norm_m_s = self.error_m_s.norm();
        if norm_m_s > RIGHT_M_S {
            self.error_m_s * ((norm_m_s - RIGHT_M_S).min(GREATEST_M_S) / norm_m_s)
        } else {
            NedVector::ZERO
        }
    }

    /// Nothing is known of the velocity.
    pub(super) fn forget(&mut self) {
        self.error_m_s = NedVector::ZERO;
    }

    /// A frame's stamp, and the newest report of the velocity.
    pub(super) fn advance(&mut self, stamp_ns: Nanos, now: Kinematics) {
        let Some((before_ns, before)) = self.last.replace((stamp_ns, now)) else {
            return;
        };
        let seconds = |from: Nanos, to: Nanos| (to as i64 - from as i64) as f32 * 1e-9;
        self.since_s = seconds(before_ns, stamp_ns).clamp(0.0, GAP_S);
        // The velocity in the middle between the frames.
        let ahead = (seconds(now.at_ns, stamp_ns) - 0.5 * self.since_s) / seconds(before.at_ns, now.at_ns).max(0.01);
        let change_m_s = (now.velocity_ned_m_s - before.velocity_ned_m_s) * ahead.clamp(-2.0, 1.0);
        self.path_ned_m = self.path_ned_m + (now.velocity_ned_m_s + change_m_s) * self.since_s;
    }

    /// Compares the picture of that frame, taken at this attitude, with one of those that were kept.
    pub(super) fn compare(
        &mut self,
        directions: &Directions,
        picture: &Picture,
        attitude: Attitude,
        kept: &[Anchor],
        phase: usize,
    ) {
        let Some((stamp_ns, _)) = self.last else { return };
        let ago_s = |anchor: &Anchor| stamp_ns.saturating_sub(anchor.stamp_ns) as f32 * 1e-9;
        let useful = kept
            .iter()
            .filter(|anchor| (LEAST_AGO_S..=MOST_AGO_S).contains(&ago_s(anchor)));
        let miss_s = |anchor: &&Anchor| (ago_s(anchor) - AGO_S).abs();
        let Some(anchor) = useful.min_by(|a, b| miss_s(a).total_cmp(&miss_s(b))) else {
            self.error_m_s = self.error_m_s * (1.0 - (self.since_s / FORGOTTEN_S).min(1.0));
            return;
        };
        let at = |position_ned_m, attitude| Pose {
            position_ned_m,
            attitude,
        };
        let map = Map::between(
            &at(self.path_ned_m, attitude),
            &at(anchor.path_ned_m, anchor.pose.attitude),
        );
        let pair = Pair {
            directions,
            from: picture,
            to: &anchor.picture,
            cells: samples(phase).chain(samples(phase + 4)),
        };
        let ago_s = ago_s(anchor);
        let shift = pair.drift(&map, MAY_BE_M + MAY_BE_M_S * ago_s);
        let error_m_s = anchor.pose.attitude.to_ned(shift) * (-1.0 / ago_s);
        self.error_m_s = self.error_m_s + (error_m_s - self.error_m_s) * (self.since_s / (MEAN_S + self.since_s));
    }
}
