//! HIL_STATE_QUATERNION: where the simulated vehicle truly is, as clients of PX4's simulation know it. On request only, and
//! never on an onboard link: whoever guides the vehicle must not know.

use crate::service::prelude::*;
use crate::services::sensors::STANDARD_GRAVITY_M_S2;
use crate::{LinkRole, geo};

pub(crate) struct GroundTruth;

impl Service for GroundTruth {
    fn messages(&self) -> &'static [Produced] {
        const { &[Produced::stateful(HIL_STATE_QUATERNION_DATA::ID, [0.0; 3])] }
    }

    fn produce(&self, _message_id: u32, link: LinkId, core: &Core) -> Option<MavMessage> {
        if core.roles.get(usize::from(link.0)) == Some(&LinkRole::Onboard) {
            return None;
        }
        let truth = core.truth?;
        let (lat, lon, altitude_m) = geo::to_global(&core.home, truth.position_ned_m);
        let mut m = HIL_STATE_QUATERNION_DATA {
            time_usec: core.time_boot_us(),
            attitude_quaternion: [truth.attitude.w, truth.attitude.x, truth.attitude.y, truth.attitude.z],
            lat: geo::deg_e7(lat),
            lon: geo::deg_e7(lon),
            alt: (altitude_m * 1e3) as i32,
            // There is no wind that the telemetry knows of.
            ind_airspeed: (truth.velocity_ned_m_s.norm() * 100.0) as u16,
            ..Default::default()
        };
        m.true_airspeed = m.ind_airspeed;
        [m.rollspeed, m.pitchspeed, m.yawspeed] = truth.rates_frd_rad_s.to_array();
        [m.vx, m.vy, m.vz] = truth.velocity_ned_m_s.to_array().map(|m_s| (m_s * 100.0) as i16);
        let accelerations = core.view.sensors.accelerometer_frd_m_s2.to_array();
        [m.xacc, m.yacc, m.zacc] = accelerations.map(|m_s2| (m_s2 / STANDARD_GRAVITY_M_S2 * 1e3) as i16);
        Some(MavMessage::HIL_STATE_QUATERNION(m))
    }
}
