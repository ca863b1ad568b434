//! The frame header's pose against the telemetry's at the same time.

use super::Fault;
use super::motion::{Pose, alike};
use core::mem::replace;
use vigil_types::{Attitude, AttitudeSample, FrdVector, Kinematics, Nanos, NedVector};

/// How far the header's position and attitude may be from the telemetry's, and by how much the difference may change in 10 frames.
const POSE_M: f32 = 2.0;
const POSE_COS_HALF: f32 = 0.991_445; // 15°
const POSE_DRIFT_M: f32 = 0.4;
const POSE_FRAMES: usize = 10;
const BAD_POSES: u8 = 2;
/// A position this far from where the velocity brought it since the last one has jumped; the second allows for each second between them.
const JUMP_M: f32 = 1.0;
const JUMP_M_S: f32 = 10.0;
/// Telemetry is extrapolated to the frame's stamp by no more than this, seconds.
const MOST_EXTRAPOLATION_S: f32 = 0.3;

/// By what the last poses were off, and whether they can be believed.
#[derive(Debug, Clone, Default)]
pub(super) struct PoseCheck {
    errors: [NedVector; POSE_FRAMES],
    poses: usize,
    pub(super) fault: Fault,
    /// What the vehicle reported when the frame before was checked.
    kinematics_before: Option<Kinematics>,
}

/// Whether the vehicle reports to be where it cannot have come to since it reported its position before: more than 1 m, and 10 m for each
/// second between the two, from where its velocity brought it.
pub fn has_jumped(before: &Kinematics, now: &Kinematics) -> bool {
    let passed_s = now.at_ns.saturating_sub(before.at_ns) as f32 * 1e-9;
    let led_to_ned_m = before.position_ned_m + before.velocity_ned_m_s * passed_s;
    (now.position_ned_m - led_to_ned_m).norm() > JUMP_M + JUMP_M_S * passed_s
}

impl PoseCheck {
    /// A frame's pose, and the telemetry to which it belongs.
    pub(super) fn note(
        &mut self,
        pose: &Pose,
        stamp_ns: Nanos,
        (kinematics, attitude): (Kinematics, AttitudeSample),
        in_flight: bool,
    ) {
        let lead_s = |at_ns: Nanos| {
            let lead_ns = stamp_ns as i64 - at_ns as i64;
            (lead_ns as f32 * 1e-9).clamp(-MOST_EXTRAPOLATION_S, MOST_EXTRAPOLATION_S)
        };
        let position_ned_m = kinematics.position_ned_m + kinematics.velocity_ned_m_s * lead_s(kinematics.at_ns);
        let attitude = turned_by(attitude.attitude, attitude.rates_frd_rad_s * lead_s(attitude.at_ns));
        let error = pose.position_ned_m - position_ned_m;
        let slot = self.poses % POSE_FRAMES;
        let earlier = self.errors.get_mut(slot).map(|earlier| replace(earlier, error));
        let earlier = earlier.filter(|_| self.poses >= POSE_FRAMES);
        let drift_m = earlier.map_or(0.0, |earlier| (error - earlier).norm());
        // Counts on from 10 to 19 and back to 10, so that it never wraps.
        let is_last = self.poses + 1 == 2 * POSE_FRAMES;
        self.poses = if is_last { POSE_FRAMES } else { self.poses + 1 };
        // Written so that NaN is bad.
        let good = error.norm() <= POSE_M && drift_m <= POSE_DRIFT_M && alike(pose.attitude, attitude) >= POSE_COS_HALF;
        self.fault.note(!good, BAD_POSES, POSE_FRAMES as u8);
        let before = self.kinematics_before.replace(kinematics);
        if in_flight && before.is_some_and(|before| has_jumped(&before, &kinematics)) {
            // Whatever was seen lies elsewhere now, and nobody knows which of the two positions is right.
            (self.fault.is_raised, self.fault.good) = (true, 0);
        }
    }
}

/// The attitude after a small turn, radians about the body's axes.
fn turned_by(attitude: Attitude, turn: FrdVector) -> Attitude {
    let (a, b, c) = (0.5 * turn.x, 0.5 * turn.y, 0.5 * turn.z);
    let Attitude { w, x, y, z } = attitude;
    let (nw, nx, ny, nz) = (
        w - a * x - b * y - c * z,
        x + a * w + c * y - b * z,
        y + b * w + a * z - c * x,
        z + c * w + b * x - a * y,
    );
    let scale = 1.0 / libm::sqrtf(nw * nw + nx * nx + ny * ny + nz * nz);
    Attitude {
        w: nw * scale,
        x: nx * scale,
        y: ny * scale,
        z: nz * scale,
    }
}
