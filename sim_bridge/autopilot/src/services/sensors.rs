//! Sensor readings: IMU, pressure, GPS; for the guidance computer, OBSTACLE_DISTANCE of a sensor beside the depth camera:
//! <https://mavlink.io/en/messages/common.html#OBSTACLE_DISTANCE>; and INJECT_FAILURE: switching sensors off, letting them stick, and
//! making them whole again. <https://docs.px4.io/main/en/debug/failure_injection.html>
//!
//! What follows of a failure is flight's business: without GPS the vehicle lands when the position is no longer known.

use crate::core::ZoneRanges;
use crate::flight::SensorFault;
use crate::geo;
use crate::service::prelude::*;
use crate::services::position::bearing_deg;
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::common::HighresImuUpdatedFlags as Updated;
use vigil_types::{FrdVector, RANGE_SECTORS};

pub(super) const COMMANDS: &[(u16, Handler)] = &[(INJECT_FAILURE, inject)];

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(HIGHRES_IMU_DATA::ID, [0.0, 20.0, 0.0], imu),
    Produced::from(SCALED_PRESSURE_DATA::ID, [0.0, 1.0, 1.0], pressure),
    Produced::from(SCALED_IMU_DATA::ID, [0.0; 3], scaled_imu),
    Produced::from(RAW_IMU_DATA::ID, [0.0; 3], raw_imu),
    Produced::from(GPS_RAW_INT_DATA::ID, [1.0, 5.0, 1.0], gps),
    Produced::from(OBSTACLE_DISTANCE_DATA::ID, [15.0, 0.0, 0.0], |core| {
        core.ranges.as_ref().map(|ranges| obstacle_distance(core, ranges))
    }),
    absent(RC_CHANNELS_DATA::ID),
    absent(DISTANCE_SENSOR_DATA::ID),
    absent(ACTUATOR_CONTROL_TARGET_DATA::ID),
    absent(WIND_COV_DATA::ID),
    absent(ADSB_VEHICLE_DATA::ID),
    absent(SCALED_IMU2_DATA::ID),
    absent(SCALED_IMU3_DATA::ID),
    absent(SCALED_PRESSURE2_DATA::ID),
    absent(SCALED_PRESSURE3_DATA::ID),
    absent(OPTICAL_FLOW_RAD_DATA::ID),
    absent(LANDING_TARGET_DATA::ID),
    absent(RAW_RPM_DATA::ID),
    absent(ESC_INFO_DATA::ID),
    absent(ESC_STATUS_DATA::ID),
];

/// Earth's field at home in gauss, NED: about what the world magnetic model gives for the default home.
const FIELD_NED_GAUSS: [f32; 3] = [0.215, 0.012, 0.430];
/// Air temperature that the readings report.
const TEMPERATURE_C: f32 = 20.0;
const TEMPERATURE_CENTIDEG: i16 = (TEMPERATURE_C * 100.0) as i16;
pub(super) const STANDARD_GRAVITY_M_S2: f32 = 9.806_65;

/// Pressure of the standard atmosphere in hPa at a height above sea level.
fn pressure_hpa(altitude_m: f64) -> f32 {
    (1013.25 * libm::pow(1.0 - 2.255_77e-5 * altitude_m, 5.255_88)) as f32
}

/// What the barometer reports, as metres above sea level; `None` where it is off.
fn barometric_altitude_m(core: &Core) -> Option<f64> {
    let (fault, measured_m) = (core.lost_sensors.barometer, core.view.sensors.barometer_height_m);
    Some(geo::ORIGIN.altitude_m + f64::from(fault.unwrap_or(Some(measured_m))?))
}

/// The earth's field about the vehicle in gauss.
fn field_gauss(core: &Core) -> FrdVector {
    let [n, e, d] = FIELD_NED_GAUSS;
    core.view.estimate.attitude.to_frd(vigil_types::NedVector::new(n, e, d))
}

/// What the compass reports: zeros where it is off.
fn compass_gauss(core: &Core) -> FrdVector {
    let fault = core.lost_sensors.magnetometer;
    fault.unwrap_or_else(|| Some(field_gauss(core))).unwrap_or_default()
}

fn imu(core: &Core) -> Option<MavMessage> {
    let s = &core.view.sensors;
    let barometric_m = barometric_altitude_m(core);
    let altitude_m = barometric_m.unwrap_or(geo::ORIGIN.altitude_m);
    // All but differential pressure.
    let mut updated = Updated::from_bits_truncate(0x1BFF);
    if barometric_m.is_none() {
        updated &= !Updated::from_bits_truncate(0xA00);
    }
    if core.lost_sensors.magnetometer == Some(None) {
        updated &= !Updated::from_bits_truncate(0x1C0);
    }
    let mut m = HIGHRES_IMU_DATA {
        time_usec: core.time_boot_us(),
        abs_pressure: pressure_hpa(altitude_m),
        pressure_alt: altitude_m as f32,
        temperature: TEMPERATURE_C,
        fields_updated: updated,
        ..Default::default()
    };
    [m.xacc, m.yacc, m.zacc] = s.accelerometer_frd_m_s2.to_array();
    [m.xgyro, m.ygyro, m.zgyro] = s.gyroscope_frd_rad_s.to_array();
    [m.xmag, m.ymag, m.zmag] = compass_gauss(core).to_array();
    Some(MavMessage::HIGHRES_IMU(m))
}

/// Readings as whole numbers: thousandths of standard gravity, of a radian per second and of a gauss.
fn thousandths(core: &Core) -> [[i16; 3]; 3] {
    let s = &core.view.sensors;
    [
        (s.accelerometer_frd_m_s2, STANDARD_GRAVITY_M_S2),
        (s.gyroscope_frd_rad_s, 1.0),
        (compass_gauss(core), 1.0),
    ]
    .map(|(reading, unit)| reading.to_array().map(|value| libm::roundf(value / unit * 1e3) as i16))
}

fn scaled_imu(core: &Core) -> Option<MavMessage> {
    let mut m = SCALED_IMU_DATA::default();
    [
        [m.xacc, m.yacc, m.zacc],
        [m.xgyro, m.ygyro, m.zgyro],
        [m.xmag, m.ymag, m.zmag],
    ] = thousandths(core);
    (m.time_boot_ms, m.temperature) = (core.time_boot_ms(), TEMPERATURE_CENTIDEG);
    Some(MavMessage::SCALED_IMU(m))
}

/// The same numbers: the sensors are modelled behind their calibration.
fn raw_imu(core: &Core) -> Option<MavMessage> {
    let mut m = RAW_IMU_DATA::default();
    [
        [m.xacc, m.yacc, m.zacc],
        [m.xgyro, m.ygyro, m.zgyro],
        [m.xmag, m.ymag, m.zmag],
    ] = thousandths(core);
    (m.time_usec, m.temperature) = (core.time_boot_us(), TEMPERATURE_CENTIDEG);
    Some(MavMessage::RAW_IMU(m))
}

fn pressure(core: &Core) -> Option<MavMessage> {
    let altitude_m = barometric_altitude_m(core)?;
    Some(message!(
        SCALED_PRESSURE,
        time_boot_ms = core.time_boot_ms(),
        press_abs = pressure_hpa(altitude_m),
        temperature = TEMPERATURE_CENTIDEG
    ))
}

fn gps(core: &Core) -> Option<MavMessage> {
    if core.lost_sensors.gps_since_ns.is_some() {
        return Some(message!(
            GPS_RAW_INT,
            time_usec = core.time_boot_us(),
            eph = u16::MAX,
            epv = u16::MAX,
            vel = u16::MAX,
            cog = u16::MAX,
            fix_type = GpsFixType::GPS_FIX_TYPE_NO_GPS
        ));
    }
    let s = &core.view.sensors;
    let (lat, lon, alt_m) = geo::to_global(s.gps_position_ned_m);
    let v = s.gps_velocity_ned_m_s;
    let course_deg = bearing_deg(libm::atan2f(v.y, v.x));
    Some(MavMessage::GPS_RAW_INT(GPS_RAW_INT_DATA {
        time_usec: core.time_boot_us(),
        lat,
        lon,
        alt: (alt_m * 1e3) as i32,
        eph: 80,
        epv: 120,
        vel: (v.horizontal_norm() * 100.0) as u16,
        cog: (course_deg * 100.0) as u16,
        fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
        satellites_visible: 12,
        alt_ellipsoid: (alt_m * 1e3) as i32,
        h_acc: 500,
        v_acc: 800,
        vel_acc: 200,
        ..Default::default()
    }))
}

const UNKNOWN: u16 = u16::MAX;
const LEAST_CM: u16 = 1;

fn obstacle_distance(core: &Core, ranges: &ZoneRanges) -> MavMessage {
    let farthest_cm = (ranges.farthest_m * 100.0) as u16;
    let mut distances = [UNKNOWN; RANGE_SECTORS];
    for (distance, range_m) in distances.iter_mut().zip(ranges.range_m).take(ranges.columns) {
        *distance = match range_m <= ranges.farthest_m {
            true => ((range_m * 100.0).round() as u16).clamp(LEAST_CM, farthest_cm),
            false => farthest_cm + 1,
        };
    }
    let step_deg = (ranges.fov_rad / ranges.columns as f32).to_degrees();
    MavMessage::OBSTACLE_DISTANCE(OBSTACLE_DISTANCE_DATA {
        time_usec: core.time_boot_us(),
        distances,
        min_distance: LEAST_CM,
        max_distance: farthest_cm,
        sensor_type: MavDistanceSensor::MAV_DISTANCE_SENSOR_LASER,
        // Whole degrees cannot tell it; the extension fields do.
        increment: 0,
        increment_f: step_deg,
        angle_offset: 0.5 * (step_deg - ranges.fov_rad.to_degrees()),
        frame: MavFrame::MAV_FRAME_BODY_FRD,
    })
}

/// A message that PX4 knows and this vehicle has nothing to put into: there is no pilot's receiver, no range finder
/// and no transponder, the mixer's inputs are not modelled, and the estimator knows no wind. A client may set its rate, as it
/// may with PX4 where the sensor is missing; none is ever sent, and a request for one is DENIED.
const fn absent(id: u32) -> Produced {
    Produced::from(id, [0.0; 3], |_| None)
}

const LOOK_NS: Nanos = 10_000_000;
/// Weight of a look in the mean: about a quarter of a second.
const WEIGHT: f32 = 0.04;

/// VIBRATION: how much the accelerometer's readings change from one look to the next.
#[derive(Debug, Default)]
pub(crate) struct Vibration {
    /// Mean change of the acceleration between two looks, by axis.
    mean_m_s2: [f32; 3],
    due_ns: Nanos,
    last_m_s2: Option<[f32; 3]>,
}

impl Service for Vibration {
    fn messages(&self) -> &'static [Produced] {
        const { &[Produced::stateful(VIBRATION_DATA::ID, [0.0, 0.5, 0.5])] }
    }

    fn produce(&self, _message_id: u32, _link: LinkId, core: &Core) -> Option<MavMessage> {
        let [vibration_x, vibration_y, vibration_z] = self.mean_m_s2;
        // The modelled accelerometer does not clip.
        Some(message!(
            VIBRATION,
            time_usec = core.time_boot_us(),
            vibration_x,
            vibration_y,
            vibration_z
        ))
    }

    fn due_ns(&self) -> Nanos {
        self.due_ns
    }

    fn step(&mut self, core: &mut Core) {
        self.due_ns = core.now_ns + LOOK_NS;
        let reading = core.view.sensors.accelerometer_frd_m_s2.to_array();
        let last = self.last_m_s2.unwrap_or(reading);
        for (mean, (now, last)) in self.mean_m_s2.iter_mut().zip(reading.into_iter().zip(last)) {
            *mean += WEIGHT * ((now - last).abs() - *mean);
        }
        self.last_m_s2 = Some(reading);
    }
}

const INJECT_FAILURE: u16 = 420;
/// FAILURE_UNIT_SENSOR_*.
const MAGNETOMETER: f32 = 2.0;
const BAROMETER: f32 = 3.0;
const GPS: f32 = 4.0;
/// FAILURE_TYPE_*.
const OK: f32 = 0.0;
const OFF: f32 = 1.0;
const STUCK: f32 = 2.0;

fn inject(command: &Command, _source: Source, core: &mut Core) -> Answer {
    if core.param(ParamId::FailureEnabled) != 1.0 {
        return Err(Refusal::DENIED.saying("failure injection denied: set SYS_FAILURE_EN to 1"));
    }
    let Some(kind @ (OK | OFF | STUCK)) = command.param(2) else {
        // Wrong, slow or noisy readings are not modelled.
        return Err(Refusal::UNSUPPORTED);
    };
    // 0 is all of a kind, and there is one of each.
    if !matches!(command.param(3), None | Some(0.0 | 1.0)) {
        return Err(Refusal::DENIED);
    }
    let name = match command.param(1) {
        Some(GPS) if matches!(kind, OK | OFF) => {
            let now_ns = core.now_ns;
            let since_ns = core.lost_sensors.gps_since_ns;
            core.lost_sensors.gps_since_ns = matches!(kind, OFF).then(|| since_ns.unwrap_or(now_ns));
            "GPS"
        }
        Some(BAROMETER) => {
            core.lost_sensors.barometer = fault(kind, core.view.sensors.barometer_height_m);
            "barometer"
        }
        Some(MAGNETOMETER) => {
            core.lost_sensors.magnetometer = fault(kind, field_gauss(core));
            "compass"
        }
        _ => return Err(Refusal::UNSUPPORTED),
    };
    let (severity, what) = match kind {
        OK => (MavSeverity::MAV_SEVERITY_INFO, "back"),
        STUCK => (MavSeverity::MAV_SEVERITY_WARNING, "stuck"),
        _ => (MavSeverity::MAV_SEVERITY_WARNING, "lost"),
    };
    core.text(severity, &format!("{name} {what}"));
    Ok(())
}

fn fault<T>(kind: f32, reading: T) -> SensorFault<T> {
    match kind {
        OFF => Some(None),
        STUCK => Some(Some(reading)),
        _ => None,
    }
}
