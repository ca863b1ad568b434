//! HIL_STATE_QUATERNION: where the simulated vehicle truly is, as clients of PX4's simulation know it. On request only, and
//! never on an onboard link: whoever guides the vehicle must not know.

use crate::service::prelude::*;
use crate::services::sensors::STANDARD_GRAVITY_M_S2;
use crate::{LinkRole, geo};

#[derive(Default)]
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
        let hundredths = |m_s: f32| (m_s * 100.0) as i16;
        let thousandths_g = |m_s2: f32| (m_s2 / STANDARD_GRAVITY_M_S2 * 1e3) as i16;
        let (v, a) = (truth.velocity_ned_m_s, core.view.sensors.accelerometer_frd_m_s2);
        // There is no wind that the telemetry knows of.
        let airspeed = (v.norm() * 100.0) as u16;
        Some(MavMessage::HIL_STATE_QUATERNION(HIL_STATE_QUATERNION_DATA {
            time_usec: core.time_boot_us(),
            attitude_quaternion: [truth.attitude.w, truth.attitude.x, truth.attitude.y, truth.attitude.z],
            rollspeed: truth.rates_frd_rad_s.x,
            pitchspeed: truth.rates_frd_rad_s.y,
            yawspeed: truth.rates_frd_rad_s.z,
            lat: geo::deg_e7(lat),
            lon: geo::deg_e7(lon),
            alt: (altitude_m * 1e3) as i32,
            vx: hundredths(v.x),
            vy: hundredths(v.y),
            vz: hundredths(v.z),
            ind_airspeed: airspeed,
            true_airspeed: airspeed,
            xacc: thousandths_g(a.x),
            yacc: thousandths_g(a.y),
            zacc: thousandths_g(a.z),
        }))
    }
}
