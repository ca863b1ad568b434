//! Sensor readings: IMU, pressure, GPS.

use crate::flight::SensorFault;
use crate::geo;
use crate::service::prelude::*;
use crate::services::position::bearing_deg;
use vigil_mavlink::common::HighresImuUpdatedFlags as Updated;
use vigil_types::FrdVector;

/// Earth's field at home in gauss, NED: about what the world magnetic model gives for the default home.
const FIELD_NED_GAUSS: [f32; 3] = [0.215, 0.012, 0.430];
/// Air temperature that the readings report.
const TEMPERATURE_C: f32 = 20.0;
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
    let reading_m = core
        .lost_sensors
        .barometer
        .reading(core.view.sensors.barometer_height_m)?;
    Some(core.home.altitude_m + f64::from(reading_m))
}

/// The earth's field about the vehicle in gauss.
pub(super) fn field_gauss(core: &Core) -> FrdVector {
    let [n, e, d] = FIELD_NED_GAUSS;
    core.view.estimate.attitude.to_frd(vigil_types::NedVector::new(n, e, d))
}

/// What the compass reports: zeros where it is off.
fn compass_gauss(core: &Core) -> FrdVector {
    let reading = core.lost_sensors.magnetometer.reading(field_gauss(core));
    reading.unwrap_or(FrdVector::new(0.0, 0.0, 0.0))
}

fn imu(core: &Core) -> Option<MavMessage> {
    let s = &core.view.sensors;
    let field = compass_gauss(core);
    let barometric_m = barometric_altitude_m(core);
    let altitude_m = barometric_m.unwrap_or(core.home.altitude_m);
    // All but differential pressure.
    let mut updated = Updated::from_bits_truncate(0x1BFF);
    if barometric_m.is_none() {
        updated &= !Updated::from_bits_truncate(0xA00);
    }
    if core.lost_sensors.magnetometer == SensorFault::Off {
        updated &= !Updated::from_bits_truncate(0x1C0);
    }
    Some(MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA {
        time_usec: core.time_boot_us(),
        xacc: s.accelerometer_frd_m_s2.x,
        yacc: s.accelerometer_frd_m_s2.y,
        zacc: s.accelerometer_frd_m_s2.z,
        xgyro: s.gyroscope_frd_rad_s.x,
        ygyro: s.gyroscope_frd_rad_s.y,
        zgyro: s.gyroscope_frd_rad_s.z,
        xmag: field.x,
        ymag: field.y,
        zmag: field.z,
        abs_pressure: pressure_hpa(altitude_m),
        diff_pressure: 0.0,
        pressure_alt: altitude_m as f32,
        temperature: TEMPERATURE_C,
        fields_updated: updated,
        id: 0,
    }))
}

/// Readings as whole numbers: thousandths of standard gravity, of a radian per second and of a gauss, and hundredths of
/// a degree Celsius.
fn scaled_readings(core: &Core) -> SCALED_IMU_DATA {
    let s = &core.view.sensors;
    let thousandths = |v: FrdVector, unit: f32| [v.x, v.y, v.z].map(|value| libm::roundf(value / unit * 1e3) as i16);
    let [xacc, yacc, zacc] = thousandths(s.accelerometer_frd_m_s2, STANDARD_GRAVITY_M_S2);
    let [xgyro, ygyro, zgyro] = thousandths(s.gyroscope_frd_rad_s, 1.0);
    let [xmag, ymag, zmag] = thousandths(compass_gauss(core), 1.0);
    SCALED_IMU_DATA {
        time_boot_ms: core.time_boot_ms(),
        xacc,
        yacc,
        zacc,
        xgyro,
        ygyro,
        zgyro,
        xmag,
        ymag,
        zmag,
        temperature: (TEMPERATURE_C * 100.0) as i16,
    }
}

fn scaled_imu(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::SCALED_IMU(scaled_readings(core)))
}

/// The same numbers: the sensors are modelled behind their calibration.
fn raw_imu(core: &Core) -> Option<MavMessage> {
    let s = scaled_readings(core);
    Some(MavMessage::RAW_IMU(RAW_IMU_DATA {
        time_usec: core.time_boot_us(),
        xacc: s.xacc,
        yacc: s.yacc,
        zacc: s.zacc,
        xgyro: s.xgyro,
        ygyro: s.ygyro,
        zgyro: s.zgyro,
        xmag: s.xmag,
        ymag: s.ymag,
        zmag: s.zmag,
        id: 0,
        temperature: s.temperature,
    }))
}

fn pressure(core: &Core) -> Option<MavMessage> {
    let altitude_m = barometric_altitude_m(core)?;
    Some(message!(
        SCALED_PRESSURE,
        time_boot_ms = core.time_boot_ms(),
        press_abs = pressure_hpa(altitude_m),
        temperature = (TEMPERATURE_C * 100.0) as i16
    ))
}

fn gps(core: &Core) -> Option<MavMessage> {
    if core.lost_sensors.gps_since_ns.is_some() {
        return Some(MavMessage::GPS_RAW_INT(GPS_RAW_INT_DATA {
            time_usec: core.time_boot_us(),
            eph: u16::MAX,
            epv: u16::MAX,
            vel: u16::MAX,
            cog: u16::MAX,
            fix_type: GpsFixType::GPS_FIX_TYPE_NO_GPS,
            ..Default::default()
        }));
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
