//! Sensors that are switched off.

use crate::testing::*;
use crate::tests::scenarios::{current_item, start_mission, upload_square, wait_until_disarmed};

const GPS: f32 = 4.0;
const BAROMETER: f32 = 3.0;
const MAGNETOMETER: f32 = 2.0;

fn inject(b: &mut Bench, unit: f32, kind: f32) -> u8 {
    b.ask(420, &[unit, kind])
}

fn enable(b: &mut Bench) {
    b.set_parameter("SYS_FAILURE_EN", ParameterValue::Integer(1));
}

fn health(b: &Bench) -> MavSysStatusSensor {
    b.last::<SYS_STATUS_DATA>(API).onboard_control_sensors_health
}

#[test]
fn failures_are_obeyed_only_where_they_are_enabled_and_modelled() {
    let mut b = Bench::airborne();
    assert_eq!(inject(&mut b, GPS, 1.0), DENIED);
    b.assert_said("SYS_FAILURE_EN");
    enable(&mut b);
    assert_eq!(inject(&mut b, GPS, 2.0), UNSUPPORTED, "stuck");
    assert_eq!(inject(&mut b, 101.0, 1.0), UNSUPPORTED, "a motor");
    assert_eq!(b.ask(420, &[GPS, 1.0, 3.0]), DENIED, "a third receiver");
    b.run_ms(8_000);
    assert_eq!(b.status().mode, FlightMode::Hold);
}

#[test]
fn without_gps_the_vehicle_lands_and_is_not_armed_again() {
    let mut b = Bench::airborne();
    enable(&mut b);
    assert_eq!(inject(&mut b, GPS, 1.0), ACCEPTED);
    b.run_ms(3_000);
    let fix = b.last::<GPS_RAW_INT_DATA>(API);
    let has = (fix.fix_type, fix.satellites_visible);
    assert_eq!(has, (GpsFixType::GPS_FIX_TYPE_NO_GPS, 0));
    assert!(!health(&b).contains(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_GPS));
    assert_eq!(b.status().mode, FlightMode::Hold, "the position is still known");
    b.run_ms(2_500);
    assert_eq!(b.status().mode, FlightMode::Land);
    assert_eq!(b.status().failsafe, Some(Failsafe::PositionLost));
    b.assert_said("position lost: land");
    assert_eq!(b.set_mode(API, SCRIPT, 4, 3), REJECTED, "nowhere to hold");
    for (number, command) in [(192, "reposition"), (22, "take-off"), (34, "orbit")] {
        let answer = b.ask(number, &[-1.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, f32::NAN]);
        assert!(answer != ACCEPTED && b.status().failsafe.is_some(), "{command}");
    }
    b.run_until(30, "landed", |b| {
        b.status().landed == LandedState::OnGround && !b.status().armed
    });
    assert_eq!(b.arm(), REJECTED);
    b.assert_said("GPS lost");
    assert_eq!(inject(&mut b, GPS, 0.0), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
}

/// PX4's own flight test too: a mission goes on without them and with readings that are stuck.
#[test]
fn without_barometer_or_compass_it_flies_on_and_does_not_arm() {
    use MavSysStatusSensor as Sensor;
    for (unit, bit, name) in [
        (BAROMETER, Sensor::MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE, "barometer"),
        (MAGNETOMETER, Sensor::MAV_SYS_STATUS_SENSOR_3D_MAG, "compass"),
    ] {
        let mut b = Bench::new();
        upload_square(&mut b);
        assert_eq!(b.arm(), ACCEPTED);
        enable(&mut b);
        start_mission(&mut b);
        b.run_until(60, "the first item", |b| current_item(b) == Some(1));
        assert_eq!(inject(&mut b, unit, 1.0), ACCEPTED);
        b.sent.clear();
        b.run_ms(4_000);
        assert_eq!((b.status().mode, b.status().failsafe), (FlightMode::Mission, None));
        assert!(!health(&b).contains(bit));
        assert_eq!(b.arm(), ACCEPTED, "as it is armed already");
        if name == "barometer" {
            assert_eq!(b.count(API, SCALED_PRESSURE_DATA::ID), 0);
        }
        // Stuck: readings again, always the same, and still not healthy.
        assert_eq!(inject(&mut b, unit, 2.0), ACCEPTED);
        b.sent.clear();
        b.run_ms(3_000);
        assert!(!health(&b).contains(bit));
        let imu = b.all::<HIGHRES_IMU_DATA>(API);
        let readings: Vec<_> = match name {
            "barometer" => imu.iter().map(|m| [m.abs_pressure, 0.0, 0.0]).collect(),
            _ => imu.iter().map(|m| [m.xmag, m.ymag, m.zmag]).collect(),
        };
        assert!(readings.len() > 50 && readings.iter().all(|reading| *reading == readings[0]));
        b.run_until(90, "the return", |b| b.status().mode == FlightMode::Return);
        wait_until_disarmed(&mut b, 120);
        assert!(b.is_at((0.0, 0.0), 0.0, 2.0), "{:?}", b.position_m());
        assert_eq!(inject(&mut b, unit, 0.0), ACCEPTED);
        b.run_ms(2_000);
        assert!(health(&b).contains(bit));
        let mut b = Bench::new();
        enable(&mut b);
        assert_eq!(inject(&mut b, unit, 1.0), ACCEPTED);
        assert_eq!(b.arm(), REJECTED);
        b.assert_said(name);
    }
}
