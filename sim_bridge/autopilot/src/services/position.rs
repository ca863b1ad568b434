//! Where the vehicle is, how it lies and how fast it moves: local, global, height, heads-up display, attitude, odometry; what
//! is flown; and where it truly is.

use crate::flight::{FlightMode, attitude_target, position_target};
use crate::plan::MissionItem;
use crate::service::prelude::*;
use crate::services::sensors::STANDARD_GRAVITY_M_S2;
use crate::{LinkRole, geo};
use vigil_types::NedVector;

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(LOCAL_POSITION_NED_DATA::ID, [50.0, 30.0, 10.0], local_position),
    Produced::from(GLOBAL_POSITION_INT_DATA::ID, [5.0, 10.0, 5.0], global_position),
    Produced::from(VFR_HUD_DATA::ID, [0.0, 5.0, 5.0], heads_up_display),
    Produced::from(ALTITUDE_DATA::ID, [0.0, 5.0, 2.0], altitude),
    Produced::from(ODOMETRY_DATA::ID, [0.0, 10.0, 0.0], odometry),
    Produced::from(POSITION_TARGET_LOCAL_NED_DATA::ID, [0.0, 5.0, 2.0], position_target),
    Produced::from(POSITION_TARGET_GLOBAL_INT_DATA::ID, [0.0; 3], global_target),
    Produced::from(ATTITUDE_DATA::ID, [50.0, 50.0, 20.0], attitude),
    Produced::from(ATTITUDE_QUATERNION_DATA::ID, [50.0, 20.0, 10.0], attitude_quaternion),
    Produced::from(ATTITUDE_TARGET_DATA::ID, [0.0, 5.0, 2.0], attitude_target),
];

/// A direction in degrees, 0 to 360.
pub(super) fn bearing_deg(bearing_rad: f32) -> f32 {
    let deg = bearing_rad.to_degrees();
    let deg = if deg < 0.0 { deg + 360.0 } else { deg };
    // A hair left of north the sum rounds to 360.
    if deg < 360.0 { deg } else { 0.0 }
}

fn local_position(core: &Core) -> Option<MavMessage> {
    let (mut m, e) = (LOCAL_POSITION_NED_DATA::default(), &core.view.estimate);
    [m.x, m.y, m.z] = e.position_ned_m.to_array();
    [m.vx, m.vy, m.vz] = e.velocity_ned_m_s.to_array();
    m.time_boot_ms = core.time_boot_ms();
    Some(MavMessage::LOCAL_POSITION_NED(m))
}

fn global_position(core: &Core) -> Option<MavMessage> {
    let e = &core.view.estimate;
    let (lat, lon, alt_m) = geo::to_global(e.position_ned_m);
    let [vx, vy, vz] = e.velocity_ned_m_s.to_array().map(|m_s| (m_s * 100.0) as i16);
    Some(message!(
        GLOBAL_POSITION_INT,
        time_boot_ms = core.time_boot_ms(),
        lat,
        lon,
        alt = (alt_m * 1e3) as i32,
        relative_alt = (-e.position_ned_m.z * 1e3) as i32,
        vx,
        vy,
        vz,
        hdg = (bearing_deg(e.attitude.yaw_rad()) * 100.0) as u16
    ))
}

fn heads_up_display(core: &Core) -> Option<MavMessage> {
    let e = &core.view.estimate;
    Some(MavMessage::VFR_HUD(VFR_HUD_DATA {
        airspeed: e.velocity_ned_m_s.norm(),
        groundspeed: e.velocity_ned_m_s.horizontal_norm(),
        alt: (geo::ORIGIN.altitude_m - f64::from(e.position_ned_m.z)) as f32,
        climb: -e.velocity_ned_m_s.z,
        heading: bearing_deg(e.attitude.yaw_rad()) as i16,
        throttle: (core.view.sensors.throttle * 100.0) as u16,
    }))
}

fn altitude(core: &Core) -> Option<MavMessage> {
    let height_m = -core.view.estimate.position_ned_m.z;
    let amsl_m = (geo::ORIGIN.altitude_m + f64::from(height_m)) as f32;
    Some(MavMessage::ALTITUDE(ALTITUDE_DATA {
        time_usec: core.time_boot_us(),
        altitude_monotonic: amsl_m,
        altitude_amsl: amsl_m,
        altitude_local: height_m,
        altitude_relative: height_m,
        altitude_terrain: f32::NAN,
        bottom_clearance: f32::NAN,
    }))
}

fn odometry(core: &Core) -> Option<MavMessage> {
    let e = &core.view.estimate;
    let mut unknown_covariance = [0.0; 21];
    unknown_covariance[0] = f32::NAN;
    let mut m = ODOMETRY_DATA {
        time_usec: core.time_boot_us(),
        q: [e.attitude.w, e.attitude.x, e.attitude.y, e.attitude.z],
        pose_covariance: unknown_covariance,
        velocity_covariance: unknown_covariance,
        frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
        child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
        estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_AUTOPILOT,
        quality: 100,
        ..Default::default()
    };
    [m.x, m.y, m.z] = e.position_ned_m.to_array();
    [m.vx, m.vy, m.vz] = e.attitude.to_frd(e.velocity_ned_m_s).to_array();
    [m.rollspeed, m.pitchspeed, m.yawspeed] = e.rates_frd_rad_s.to_array();
    Some(MavMessage::ODOMETRY(m))
}

/// Where the vehicle flies to, as PX4 sends its current position setpoint: the place of the mission's leg, of a go-to, a hold, a return,
/// a take-off or a landing; nothing where it flies to no place.
fn global_target(core: &Core) -> Option<MavMessage> {
    let here = core.view.estimate.position_ned_m;
    let place = match core.plans.mission.item() {
        Some(MissionItem::Leg(leg)) if core.commander.mode == FlightMode::Mission => {
            let (north_m, east_m) = leg.place.north_east_m?;
            NedVector::new(north_m, east_m, leg.place.height_m.map_or(here.z, |height_m| -height_m))
        }
        _ => core.place_flown_to()?,
    };
    let (lat_int, lon_int, alt_m) = geo::to_global(place);
    Some(message!(
        POSITION_TARGET_GLOBAL_INT,
        time_boot_ms = core.time_boot_ms(),
        lat_int,
        lon_int,
        alt = alt_m as f32,
        // A position alone.
        type_mask = PositionTargetTypemask::from_bits_truncate(0xDF8),
        coordinate_frame = MavFrame::MAV_FRAME_GLOBAL
    ))
}

fn attitude(core: &Core) -> Option<MavMessage> {
    let (mut m, a) = (ATTITUDE_DATA::default(), core.view.estimate.attitude);
    [m.roll, m.pitch, m.yaw] = [a.roll_rad(), a.pitch_rad(), a.yaw_rad()];
    [m.rollspeed, m.pitchspeed, m.yawspeed] = core.view.estimate.rates_frd_rad_s.to_array();
    m.time_boot_ms = core.time_boot_ms();
    Some(MavMessage::ATTITUDE(m))
}

fn attitude_quaternion(core: &Core) -> Option<MavMessage> {
    let (mut m, a) = (ATTITUDE_QUATERNION_DATA::default(), core.view.estimate.attitude);
    [m.q1, m.q2, m.q3, m.q4] = [a.w, a.x, a.y, a.z];
    [m.rollspeed, m.pitchspeed, m.yawspeed] = core.view.estimate.rates_frd_rad_s.to_array();
    m.time_boot_ms = core.time_boot_ms();
    Some(MavMessage::ATTITUDE_QUATERNION(m))
}

/// HIL_STATE_QUATERNION: where the simulated vehicle truly is, as clients of PX4's simulation know it. On request only, and
/// never on an onboard link: whoever guides the vehicle must not know.
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
        let (lat, lon, altitude_m) = geo::to_global(truth.position_ned_m);
        let mut m = HIL_STATE_QUATERNION_DATA {
            time_usec: core.time_boot_us(),
            attitude_quaternion: [truth.attitude.w, truth.attitude.x, truth.attitude.y, truth.attitude.z],
            lat,
            lon,
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

#[cfg(test)]
mod tests {
    use super::bearing_deg;

    #[test]
    fn a_bearing_is_below_360_degrees() {
        assert_eq!([-1e-7_f32, 0.0].map(bearing_deg), [0.0; 2]);
        assert!((bearing_deg(-1.0) - 302.704).abs() < 0.001);
    }
}
