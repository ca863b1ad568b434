//! FOLLOW_TARGET: where the target of follow mode is. <https://mavlink.io/en/messages/common.html#FOLLOW_TARGET>

use crate::geo;
use crate::service::prelude::*;
use crate::services::actions::MAX_DISTANCE_M;
use vigil_mavlink::Allowance;
use vigil_types::NedVector;

/// Bit of `est_capabilities`: the velocity is given.
const HAS_VELOCITY: u8 = 1 << 1;
/// Faster targets are mistakes.
const ABSURD_VELOCITY_M_S: f32 = 100.0;

/// The same refusal is said again after this time.
const REPEATED_NS: Nanos = 5_000_000_000;

#[derive(Default)]
pub(crate) struct Follow {
    said: Allowance,
}

impl Service for Follow {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        let Some(m) = core.read::<FOLLOW_TARGET_DATA>(packet) else {
            return;
        };
        let (lat, lon) = (f64::from(m.lat) * 1e-7, f64::from(m.lon) * 1e-7);
        let (x, y) = geo::to_local(&core.home, lat, lon);
        let down_m = (core.home.altitude_m - f64::from(m.alt)) as f32;
        let position = NedVector::new(x, y, down_m);
        let [vx, vy, vz] = m.vel;
        let velocity = (m.est_capabilities & HAS_VELOCITY != 0).then(|| NedVector::new(vx, vy, vz));
        let is_place = lat.abs() <= 90.0 && lon.abs() <= 180.0 && m.alt.is_finite();
        let is_near = position.horizontal_norm() <= MAX_DISTANCE_M && down_m.abs() <= MAX_DISTANCE_M;
        let is_slow = velocity.is_none_or(|v| v.norm() <= ABSURD_VELOCITY_M_S);
        let defect = match (is_place, is_near, is_slow) {
            (true, true, true) => return core.see_target(position, velocity),
            (false, ..) => "lat, lon or alt is no place",
            (_, false, _) => "too far from home",
            _ => "vel is NaN or absurd",
        };
        // A vehicle that waits for its target would otherwise not tell why.
        core.refusals.setpoint_value += 1;
        if self.said.takes(core.now_ns, REPEATED_NS, 1) {
            core.warn(&format!("target of {}: {defect}", source.id));
        }
    }
}
