//! Telemetry beyond what flying needs: motors, scaled readings, estimator, flight information.

use crate::testing::*;

#[test]
fn motor_pulses_show_what_each_motor_is_sent() {
    let mut b = Bench::new();
    let pulses = |b: &mut Bench| {
        let s = b.request::<SERVO_OUTPUT_RAW_DATA>();
        [s.servo1_raw, s.servo2_raw, s.servo3_raw, s.servo4_raw]
    };
    assert_eq!(pulses(&mut b), [900; 4]);
    b.take_off();
    b.run_ms(2_000);
    let hover = pulses(&mut b);
    assert!(hover.iter().all(|p| (1400..1900).contains(p)), "{hover:?}");
    let a = b.request::<ACTUATOR_OUTPUT_STATUS_DATA>();
    assert_eq!(a.active, 0b1111);
    for (output, pulse) in a.actuator.iter().zip(hover) {
        assert!((output - f32::from(pulse)).abs() <= 60.0, "{a:?} {hover:?}");
    }
    assert!(a.actuator[4..].iter().all(|output| *output == 0.0));
    // A turn to the right needs more of the counter-clockwise pair, 1 and 2.
    let turn = attitude_setpoint(0x80, 0.0, 2.0, 0.5);
    b.send(API, SCRIPT, &turn);
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
    b.run_ms(30);
    b.send(API, SCRIPT, &turn);
    let turning = pulses(&mut b);
    assert!(turning[0] + turning[1] > turning[2] + turning[3] + 40, "{turning:?}");
}

/// As PX4 streams them: its controllers' targets, in whatever mode.
#[test]
fn what_is_flown_to_is_sent_on_the_ground_and_in_hold() {
    let mut b = Bench::new();
    let target = b.request::<POSITION_TARGET_LOCAL_NED_DATA>();
    assert_eq!((target.type_mask.bits(), target.vz), (0xDC7, 0.0));
    b.take_off();
    b.run_ms(2_000);
    let target = b.request::<ATTITUDE_TARGET_DATA>();
    assert!(target.type_mask.is_empty() && target.thrust > 0.3, "{target:?}");
    assert!((target.q[0] - b.view().estimate.attitude.w).abs() < 0.01, "{target:?}");
}

#[test]
fn a_hovering_vehicle_feels_one_gravity_upwards() {
    let mut b = Bench::airborne();
    b.run_ms(2_000);
    let s = b.request::<SCALED_IMU_DATA>();
    assert!((-1200..-800).contains(&s.zacc), "{s:?}");
    let is_level = s.xacc.abs() < 200 && s.yacc.abs() < 200;
    assert!(is_level && s.temperature == 2000, "{s:?}");
    let r = b.request::<RAW_IMU_DATA>();
    assert_eq!((r.xmag, r.ymag, r.zmag), (s.xmag, s.ymag, s.zmag));
    let e = b.request::<ESTIMATOR_STATUS_DATA>();
    assert!(e.flags.contains(EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_ABS));
}

#[test]
fn flight_information_has_the_times_of_the_flight() {
    let mut b = Bench::new();
    let information = Bench::request::<FLIGHT_INFORMATION_DATA>;
    let before = information(&mut b);
    assert_eq!((before.flight_uuid, before.arming_time_utc), (0, 0));
    b.take_off();
    let flying = information(&mut b);
    assert_eq!((flying.flight_uuid, flying.landing_time), (1, 0));
    assert!(flying.arming_time_utc >= u64::from(before.time_boot_ms) * 1000);
    assert!(flying.takeoff_time_utc > flying.arming_time_utc);
    assert_eq!(b.command_long(API, SCRIPT, 21, [f32::NAN; 7]), ACCEPTED);
    b.run_until(30, "landing", |b| !b.status().armed);
    let landed = information(&mut b);
    assert_eq!(landed.takeoff_time_utc, flying.takeoff_time_utc);
    assert!(landed.landing_time > flying.time_boot_ms && landed.landing_time <= landed.time_boot_ms);
    b.run_ms(50);
    assert_eq!(b.arm(), ACCEPTED);
    b.run_ms(50);
    let again = information(&mut b);
    let times = (again.flight_uuid, again.takeoff_time_utc, again.landing_time);
    assert_eq!(times, (2, 0, 0));
}

#[test]
fn what_streams_is_marked_as_telemetry_but_heartbeats_and_answers_are_not() {
    let mut b = Bench::new();
    let (version, heartbeat) = (AUTOPILOT_VERSION_DATA::ID, HEARTBEAT_DATA::ID);
    let ask = command(SCRIPT, 512, [version as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], LONG);
    b.endpoint.receive_from(b.now_ns, API, 0, &ask);
    b.endpoint.step(b.now_ns + 1_000_000_000, &b.view());
    let mut sent = [Vec::new(), Vec::new()];
    b.endpoint.transmit(|_, is_telemetry, datagram| {
        let id = u32::from_le_bytes([datagram[7], datagram[8], datagram[9], 0]);
        sent[usize::from(is_telemetry)].push(id);
    });
    let [others, telemetry] = sent;
    for answer in [COMMAND_ACK_DATA::ID, version, heartbeat] {
        assert!(others.contains(&answer) && !telemetry.contains(&answer), "{answer}");
    }
    assert!(telemetry.contains(&ATTITUDE_DATA::ID), "{telemetry:?}");
}

#[test]
fn no_battery_fault_and_no_recovery_system_are_reported() {
    let mut b = Bench::new();
    assert!(b.request::<BATTERY_STATUS_DATA>().fault_bitmask.is_empty());
    let s = b.request::<SYS_STATUS_DATA>();
    let extended = s.onboard_control_sensors_present_extended | s.onboard_control_sensors_enabled_extended;
    assert!((extended | s.onboard_control_sensors_health_extended).is_empty());
}

#[test]
fn a_sensor_that_is_not_there_may_be_given_a_rate_and_never_sends() {
    let mut b = Bench::new();
    for id in [
        RC_CHANNELS_DATA::ID,
        DISTANCE_SENSOR_DATA::ID,
        ACTUATOR_CONTROL_TARGET_DATA::ID,
    ] {
        assert_eq!(b.ask(511, &[id as f32, 1e5]), ACCEPTED);
        assert_eq!(b.ask(512, &[id as f32]), DENIED);
        b.run_ms(300);
        assert_eq!(b.count(API, id), 0);
    }
}
