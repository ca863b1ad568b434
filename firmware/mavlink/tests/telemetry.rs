//! What the companion makes of the vehicle's messages, good and bad.

mod common;

use common::{Bench, GROUND_STATION, bytes_of, messages, report};
use core::f32::consts::FRAC_PI_2;
use vigil_mavlink::common::*;
use vigil_mavlink::framing::encode_payload;
use vigil_mavlink::{Companion, CompanionConfig, Flavour, MavMessage, message};
use vigil_types::GuidanceState::{Hold, Standby};
use vigil_types::{Landed, NedVector, Reasons, STEP_NS, StepReport, VehicleMode, VehicleRequest, VelocitySetpoint};

/// The autopilot of a system.
const fn vehicle(system: u8) -> (u8, u8) {
    (system, 1)
}

/// An attitude of this heading.
fn attitude(time_boot_ms: u32, yaw: f32) -> MavMessage {
    message!(ATTITUDE, time_boot_ms, yaw)
}

fn heartbeat(custom_mode: u32, autopilot: MavAutopilot, base_mode: u8) -> MavMessage {
    message!(
        HEARTBEAT,
        custom_mode,
        mavtype = MavType::MAV_TYPE_QUADROTOR,
        autopilot,
        base_mode = MavModeFlag::from_bits_retain(base_mode),
        system_status = MavState::MAV_STATE_ACTIVE,
        mavlink_version = 3
    )
}

fn px4() -> MavMessage {
    heartbeat(6 << 16, MavAutopilot::MAV_AUTOPILOT_PX4, 0x81)
}

fn position(time_boot_ms: u32, x: f32) -> MavMessage {
    message!(LOCAL_POSITION_NED, time_boot_ms, x, vy = 0.5)
}

/// A companion that knows its vehicle.
fn acquainted() -> Bench {
    let mut b = Bench::new(Flavour::Px4);
    b.hear(vehicle(1), &px4());
    b
}

fn north_m(b: &Bench) -> Option<f32> {
    b.companion.telemetry().kinematics.map(|k| k.position_ned_m.x)
}

#[test]
fn the_vehicles_messages_become_telemetry() {
    let mut b = acquainted();
    b.hear(vehicle(1), &position(1000, 4.0));
    let turning = message!(
        ATTITUDE,
        time_boot_ms = 1000,
        roll = 0.1,
        pitch = -0.2,
        yaw = 2.0,
        rollspeed = 0.01,
        pitchspeed = 0.02,
        yawspeed = 0.03
    );
    b.hear(vehicle(1), &turning);
    let landed_state = MavLandedState::MAV_LANDED_STATE_IN_AIR;
    b.hear(vehicle(1), &message!(EXTENDED_SYS_STATE, landed_state));
    b.hear(vehicle(1), &message!(SYS_STATUS, battery_remaining = 63));
    let t = *b.companion.telemetry();
    let (h, k, a) = (t.heartbeat.unwrap(), t.kinematics.unwrap(), t.attitude.unwrap());
    assert_eq!(
        (h.at_ns, h.armed, h.mode, h.failsafe),
        (b.now_ns, true, VehicleMode::External, false)
    );
    assert_eq!((k.at_ns, k.position_ned_m), (b.now_ns, NedVector::new(4.0, 0.0, 0.0)));
    assert_eq!(k.velocity_ned_m_s, NedVector::new(0.0, 0.5, 0.0));
    assert!((a.attitude.roll_rad() - 0.1).abs() < 1e-5 && (a.attitude.pitch_rad() + 0.2).abs() < 1e-5);
    assert!((a.attitude.yaw_rad() - 2.0).abs() < 1e-5);
    assert_eq!(a.rates_frd_rad_s.to_array(), [0.01, 0.02, 0.03]);
    assert_eq!((t.landed, t.battery_remaining), (Landed::InAir, Some(0.63)));
    assert!(t.is_finite());

    // A quaternion says the same: yaw 2 rad alone is (cos 1, 0, 0, sin 1).
    let (q1, q4) = (1f32.cos(), 1f32.sin());
    let quaternion = message!(ATTITUDE_QUATERNION, time_boot_ms = 1001, q1, q4);
    b.hear(vehicle(1), &quaternion);
    let yaw_rad = b.companion.telemetry().attitude.unwrap().attitude.yaw_rad();
    assert!((yaw_rad - 2.0).abs() < 1e-5);
    b.hear(vehicle(1), &message!(SYS_STATUS, battery_remaining = -1));
    assert_eq!(b.companion.telemetry().battery_remaining, None, "-1 is not known");
}

#[test]
fn the_first_autopilot_heard_is_the_vehicle_and_nobody_else_is() {
    let mut b = Bench::new(Flavour::Px4);
    b.hear((1, 195), &heartbeat(0, MavAutopilot::MAV_AUTOPILOT_INVALID, 0));
    b.hear(GROUND_STATION, &heartbeat(0, MavAutopilot::MAV_AUTOPILOT_INVALID, 0));
    // As routers and programs that gomavlib made, which name an autopilot: stations, controllers, gimbals.
    for mav_type in [6, 18, 26] {
        let packet = encode_payload(vehicle(125), 0, 0, &[0, 0, 0, 0, mav_type, 0, 0, 4, 3]).unwrap();
        b.companion.receive(b.now_ns, 0, &packet);
    }
    b.hear(vehicle(3), &position(1, 9.0));
    assert_eq!((b.companion.system_id(), north_m(&b)), (None, None));
    b.hear(vehicle(7), &px4());
    b.hear(vehicle(3), &px4());
    b.hear(vehicle(3), &position(1, 9.0));
    b.hear((7, 2), &position(1, 8.0));
    assert_eq!((b.companion.system_id(), north_m(&b)), (Some(7), None));
    b.hear(vehicle(7), &position(1, 1.5));
    assert_eq!(north_m(&b), Some(1.5));
    let sent = b.step(Standby, Reasons::NONE, VehicleRequest::None);
    assert!(
        sent.iter().all(|(h, _)| (h.system_id, h.component_id) == (7, 191)),
        "it takes the vehicle's system"
    );
}

#[test]
fn the_vehicle_is_heard_on_its_own_link_only_and_a_configured_system_is_the_only_one() {
    for (system_id, other_link) in [(None, 1), (Some(3), 0)] {
        let mut c = Companion::new(CompanionConfig {
            system_id,
            ..Default::default()
        });
        c.receive(1, other_link, &bytes_of(vehicle(7), &px4()));
        assert_eq!((c.system_id(), c.telemetry().heartbeat), (system_id, None));
        c.receive(1, 0, &bytes_of(vehicle(3), &px4()));
        assert!(c.system_id() == Some(3) && c.telemetry().heartbeat.is_some());
        c.receive(1, 0, &bytes_of(vehicle(3), &position(10, 5.0)));
        c.receive(2, 1, &bytes_of(vehicle(3), &position(20, 9.0)));
        assert_eq!(c.telemetry().kinematics.unwrap().position_ned_m.x, 5.0);
    }
}

#[test]
fn a_vehicle_of_unknown_type_and_state_is_still_heard() {
    let mut b = Bench::new(Flavour::Px4);
    // custom_mode OFFBOARD, type 250, autopilot PX4, armed | custom, state 5 and 77, version 3.
    for (state, failsafe) in [(5u8, true), (77, false)] {
        let payload = [0, 0, 6, 0, 250, 12, 0x81, state, 3];
        let packet = encode_payload(vehicle(1), 0, 0, &payload).unwrap();
        b.companion.receive(b.now_ns, 0, &packet);
        let h = b.companion.telemetry().heartbeat.unwrap();
        assert_eq!((h.armed, h.mode, h.failsafe), (true, VehicleMode::External, failsafe));
    }
}

#[test]
fn packets_out_of_order_are_dropped_and_counted() {
    let mut b = acquainted();
    b.hear(vehicle(1), &position(5000, 1.0));
    let first_ns = b.now_ns;
    b.now_ns += 1;
    b.hear(vehicle(1), &position(4990, 2.0));
    assert_eq!((north_m(&b), b.companion.counters().late), (Some(1.0), 1));
    assert_eq!(
        b.companion.telemetry().kinematics.unwrap().at_ns,
        first_ns,
        "it does not count as fresh"
    );
    b.hear(vehicle(1), &position(5010, 3.0));
    assert_eq!(north_m(&b), Some(3.0));
    // However old, twice, and with what else is old after what is new.
    for (time_boot_ms, x) in [(3000, 4.0), (3000, 4.0), (5020, 5.0), (3050, 6.0)] {
        b.hear(vehicle(1), &position(time_boot_ms, x));
    }
    assert_eq!((north_m(&b), b.companion.counters().late), (Some(5.0), 4));
    assert_eq!(b.companion.vehicle_status().restarts, 0);
}

#[test]
fn a_clock_that_starts_anew_is_a_restart_and_what_was_known_is_forgotten() {
    let mut b = acquainted();
    b.hear(vehicle(1), &attitude(60_000, 0.0));
    b.hear(vehicle(1), &position(60_000, 1.0));
    b.hear(vehicle(1), &position(100, 2.0));
    b.hear(vehicle(1), &position(133, 2.0));
    assert_eq!((b.companion.vehicle_status().restarts, north_m(&b)), (1, Some(2.0)));
    assert!(b.companion.telemetry().attitude.is_none());
    b.hear(vehicle(1), &attitude(110, 0.0));
    assert_eq!(b.companion.vehicle_status().restarts, 1, "one restart is counted once");
}

#[test]
fn the_end_of_the_clocks_32_bits_is_no_restart() {
    let mut b = acquainted();
    b.hear(vehicle(1), &position(u32::MAX - 10, 3.0));
    b.hear(vehicle(1), &position(20, 4.0));
    assert_eq!((b.companion.vehicle_status().restarts, north_m(&b)), (0, Some(4.0)));
}

#[test]
fn values_that_are_not_finite_arrive_as_such() {
    let mut b = acquainted();
    b.hear(vehicle(1), &message!(ATTITUDE));
    b.hear(vehicle(1), &position(10, f32::NAN));
    assert!(!b.companion.telemetry().is_finite() && north_m(&b).unwrap().is_nan());
    b.hear(vehicle(1), &position(20, 1.0));
    assert!(b.companion.telemetry().is_finite());
    b.hear(vehicle(1), &attitude(0, f32::INFINITY));
    assert!(!b.companion.telemetry().is_finite());
}

/// The message requests of 30 s.
fn requests(b: &mut Bench, mut each: impl FnMut(&mut Bench, u32)) -> Vec<(u16, f32, f32)> {
    let mut found = Vec::new();
    for n in 0..600 {
        each(b, n);
        let sent = b.step(Standby, Reasons::NONE, VehicleRequest::None);
        found.extend(only!(sent, COMMAND_LONG).map(|c| (c.command as u16, c.param1, c.param2)));
    }
    found
}

#[test]
fn a_px4_that_streams_is_not_asked_except_for_its_origin_and_home() {
    let mut b = Bench::new(Flavour::Px4);
    let asked = requests(&mut b, |b, n| {
        b.hear(vehicle(1), &px4());
        b.hear(vehicle(1), &position(n * 50, 0.0));
        b.hear(vehicle(1), &attitude(n * 50, 0.0));
        b.hear(vehicle(1), &message!(EXTENDED_SYS_STATE));
        b.hear(vehicle(1), &message!(SYS_STATUS));
        if n == 50 {
            b.hear(vehicle(1), &message!(GPS_GLOBAL_ORIGIN));
        }
        if n == 55 {
            b.hear(vehicle(1), &message!(HOME_POSITION));
        }
    });
    assert_eq!(
        asked.iter().map(|(command, id, _)| (*command, *id)).collect::<Vec<_>>(),
        [(512, 49.0), (512, 242.0)]
    );
}

#[test]
fn what_a_vehicle_does_not_send_is_asked_for_again_and_a_silent_vehicle_is_not_asked() {
    let mut b = Bench::new(Flavour::ArduPilot);
    assert!(requests(&mut b, |_, _| {}).is_empty());
    let copter = heartbeat(4, MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA, 0x81);
    let asked = requests(&mut b, |b, n| {
        if n.is_multiple_of(20) {
            b.hear(vehicle(1), &copter);
        }
    });
    let intervals: Vec<_> = asked.iter().filter(|(command, ..)| *command == 511).collect();
    assert_eq!(
        intervals[..4],
        [
            &(511, 32.0, 33_333.0),
            &(511, 30.0, 20_000.0),
            &(511, 245.0, 200_000.0),
            &(511, 1.0, 1_000_000.0)
        ]
    );
    let position_asked = intervals.iter().filter(|(_, id, _)| *id == 32.0).count();
    assert!(
        (4..=6).contains(&position_asked),
        "after 3 s, 2 s, 4 s, 8 s…: {position_asked}"
    );
}

#[test]
fn a_ground_station_learns_every_five_seconds_how_busy_the_guidance_computer_is() {
    let mut b = Bench::new(Flavour::Px4);
    let mut found = Vec::new();
    for n in 0..220 {
        b.now_ns += STEP_NS;
        // A tenth of the step, and from a second before the second message on half of it.
        let mut report = report(b.now_ns, Standby);
        report.timing.previous_execution_ns = if n > 80 { STEP_NS / 2 } else { STEP_NS / 10 };
        b.emit(&report, VehicleRequest::None);
        found.extend(only!(messages(&b.sent), ONBOARD_COMPUTER_STATUS));
    }
    let busy: Vec<_> = found.iter().map(|status| status.cpu_combined).collect();
    assert_eq!(busy, [[0, 0, 0, 0, 0, 0, 0, 0, 0, 5], [50; 10], [50; 10]]);
    assert!(
        found
            .iter()
            .all(|status| status.ram_usage == u32::MAX && status.cpu_cores == [u8::MAX; 8])
    );
}

#[test]
fn a_vehicle_that_drifts_and_says_that_it_stands_is_ordered_to_go_against_it() {
    let mut b = acquainted();
    // North by 0.3 m/s, its nose to the east.
    for step in 1..80_u16 {
        b.now_ns += STEP_NS;
        let time_boot_ms = u32::from(step) * 50;
        b.hear(vehicle(1), &attitude(time_boot_ms, FRAC_PI_2));
        let position = message!(LOCAL_POSITION_NED, time_boot_ms, x = 0.015 * f32::from(step));
        b.hear(vehicle(1), &position);
    }
    let known = b.companion.telemetry().kinematics.expect("reports");
    assert!((known.velocity_ned_m_s.x - 0.25).abs() < 0.02, "{known:?}");
    let sent_m_s = |b: &mut Bench| {
        let hold = StepReport {
            setpoint: Some(VelocitySetpoint::HOLD),
            ..common::report(b.now_ns, Hold)
        };
        b.emit(&hold, VehicleRequest::None);
        only!(common::messages(&b.sent), SET_POSITION_TARGET_LOCAL_NED)
            .map(|s| (s.vx, s.vy))
            .next()
    };
    let (forward_m_s, right_m_s) = sent_m_s(&mut b).expect("a setpoint");
    assert!(forward_m_s.abs() < 0.01 && (right_m_s - 0.25).abs() < 0.02);
    // What is no longer heard is not answered.
    b.now_ns += 20 * STEP_NS;
    assert_eq!(sent_m_s(&mut b), Some((0.0, 0.0)));
}
