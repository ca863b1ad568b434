//! Sensor readings: IMU, pressure, GPS.

use crate::geo;
use crate::service::prelude::*;
use crate::services::position::bearing_deg;
use vigil_mavlink::common::HighresImuUpdatedFlags as Updated;
use vigil_types::FrdVector;

/// Earth's field at home in gauss, NED: about what the world magnetic model gives for the default home.
const FIELD_NED_GAUSS: [f32; 3] = [0.215, 0.012, 0.430];
/// Air temperature that the readings report.
const TEMPERATURE_C: f32 = 20.0;
const TEMPERATURE_CENTIDEG: i16 = (TEMPERATURE_C * 100.0) as i16;
pub(super) const STANDARD_GRAVITY_M_S2: f32 = 9.806_65;

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(HIGHRES_IMU_DATA::ID, [0.0, 20.0, 0.0], imu),
    Produced::from(SCALED_PRESSURE_DATA::ID, [0.0, 1.0, 1.0], pressure),
    Produced::from(SCALED_IMU_DATA::ID, [0.0; 3], scaled_imu),
    Produced::from(RAW_IMU_DATA::ID, [0.0; 3], raw_imu),
    Produced::from(GPS_RAW_INT_DATA::ID, [1.0, 5.0, 1.0], gps),
];

/// Pressure of the standard atmosphere in hPa at a height above sea level.
fn pressure_hpa(altitude_m: f64) -> f32 {
    (1013.25 * libm::pow(1.0 - 2.255_77e-5 * altitude_m, 5.255_88)) as f32
}

/// What the barometer reports, as metres above sea level; `None` where it is off.
fn barometric_altitude_m(core: &Core) -> Option<f64> {
    let (fault, measured_m) = (core.lost_sensors.barometer, core.view.sensors.barometer_height_m);
    Some(core.home.altitude_m + f64::from(fault.unwrap_or(Some(measured_m))?))
}

/// The earth's field about the vehicle in gauss.
pub(super) fn field_gauss(core: &Core) -> FrdVector {
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
    let altitude_m = barometric_m.unwrap_or(core.home.altitude_m);
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
    let (lat, lon, alt_m) = geo::to_global(&core.home, s.gps_position_ned_m);
    let v = s.gps_velocity_ned_m_s;
    let course_deg = bearing_deg(libm::atan2f(v.y, v.x));
    Some(MavMessage::GPS_RAW_INT(GPS_RAW_INT_DATA {
        time_usec: core.time_boot_us(),
        lat: geo::deg_e7(lat),
        lon: geo::deg_e7(lon),
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
