//! Offboard flight as scripts fly it: every kind of setpoint, streams that stall, landings by thrust.

use crate::testing::*;

/// Streams a setpoint at 20 Hz, entering OFFBOARD with the first.
fn fly(b: &mut Bench, message: &MavMessage, ms: u64) {
    for _ in 0..ms / 50 {
        b.send(API, SCRIPT, message);
        if b.status().mode != FlightMode::Offboard {
            assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
        }
        b.run_ms(50);
    }
}

#[test]
fn a_stream_may_be_as_slow_and_stall_as_long_as_with_px4() {
    let mut b = Bench::airborne();
    b.send_velocity(API, SCRIPT, [0.5, 0.0, 0.0]);
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
    for pause_ms in [400, 400, 400, 600, 950] {
        b.run_ms(pause_ms);
        assert_eq!(b.status().mode, FlightMode::Offboard, "silent for {pause_ms} ms");
        b.send_velocity(API, SCRIPT, [0.5, 0.0, 0.0]);
    }
    b.run_ms(990);
    assert_eq!(b.status().mode, FlightMode::Offboard);
    b.run_ms(20);
    assert_eq!(b.status().failsafe, Some(Failsafe::SetpointLost));
}

#[test]
fn a_changed_speed_holds_for_the_next_way_too() {
    const CHANGE_SPEED: u16 = 178;
    let mut b = Bench::airborne();
    let change = |b: &mut Bench, speed| b.ask(CHANGE_SPEED, &[1.0, speed, -1.0]);
    let fastest = |b: &mut Bench, north: f32| {
        assert_eq!(b.go_to((north, 0.0), 491.0), ACCEPTED);
        b.most(10_000, |b| b.velocity_m_s().horizontal_norm())
    };
    assert_eq!(change(&mut b, 1.5), ACCEPTED);
    let slow = fastest(&mut b, 12.0);
    assert!((slow - 1.5).abs() < 0.2, "{slow}");
    let slow = fastest(&mut b, 0.0);
    assert!((slow - 1.5).abs() < 0.2, "also the way after that: {slow}");
    assert_eq!(change(&mut b, -2.0), ACCEPTED);
    let normal = fastest(&mut b, 20.0);
    assert!(normal > 3.5, "{normal}");
}

#[test]
fn a_lost_stream_ends_as_com_obl_rc_act_says() {
    use crate::ParameterValue::Integer;
    let sticks = message!(MANUAL_CONTROL, target = 1, z = 500);
    for (action, has_sticks, mode) in [
        (0, false, FlightMode::Position),
        (1, false, FlightMode::Altitude),
        (2, false, FlightMode::Stabilized),
        (0, true, FlightMode::Position),
        (1, true, FlightMode::Altitude),
        (2, true, FlightMode::Stabilized),
        (3, false, FlightMode::Return),
        (4, false, FlightMode::Land),
        (5, true, FlightMode::Hold),
    ] {
        let mut b = Bench::airborne();
        b.set_parameter("COM_OBL_RC_ACT", Integer(action));
        fly(&mut b, &local_setpoint(0x9C7, |m| m.vx = 0.5), 1_000);
        for _ in 0..24 {
            if has_sticks {
                b.send(GCS, STATION, &sticks);
            }
            b.run_ms(50);
        }
        assert_eq!(b.status().mode, mode, "{action}");
        assert_eq!(b.status().failsafe, Some(Failsafe::SetpointLost));
        let is_low = mode != FlightMode::Land && b.height_m() < 2.5;
        assert!(!is_low, "{action}: {}", b.height_m());
        let mode_now = b.last::<CURRENT_MODE_DATA>(GCS);
        assert_eq!(mode_now.custom_mode, mode.custom_mode());
        assert_eq!(mode_now.intended_custom_mode, FlightMode::Offboard.custom_mode());
    }
    for (action, is_terminated) in [(6, true), (7, false)] {
        let mut b = Bench::airborne();
        b.set_parameter("COM_OBL_RC_ACT", Integer(action));
        fly(&mut b, &local_setpoint(0x9C7, |m| m.vx = 0.5), 1_000);
        b.run_ms(1_100);
        let status = b.status();
        assert_eq!((status.terminated, status.armed), (is_terminated, is_terminated));
        assert_eq!(b.command, ControlCommand::MotorsOff);
    }
}

/// Streams a setpoint that is not flown for 12 s at 20 Hz, asking for OFFBOARD in the middle of it: what is said.
fn refused(message: &MavMessage) -> Vec<String> {
    let mut b = Bench::airborne();
    for i in 0..240 {
        b.send(API, SCRIPT, message);
        if i == 120 {
            assert_eq!(b.set_mode(API, SCRIPT, 6, 0), REJECTED);
        }
        b.run_ms(50);
    }
    let refusals = b.status().refusals;
    assert_eq!(refusals.setpoint_form + refusals.setpoint_value, 240);
    b.texts()
}

/// As PX4 does, which takes them and cannot fly them.
#[test]
fn setpoints_that_leave_an_axis_out_keep_offboard_and_hold() {
    let nan = local_setpoint(0x9C7, |m| m.vx = f32::NAN);
    for (message, reason) in [
        (local_setpoint(0xDF7, |m| m.vx = 1.0), "mask 0xdf7 lacks axes: held"),
        (local_setpoint(0xDFE, |m| m.x = 5.0), "mask 0xdfe lacks axes: held"),
        (local_setpoint(0xCBF, |m| m.afy = 1.0), "mask 0xcbf lacks axes: held"),
        // A NaN is an axis that is left out.
        (nan, "mask 0x9c7 lacks axes: held"),
    ] {
        let mut b = Bench::airborne();
        fly(&mut b, &local_setpoint(0x9C7, |m| m.vx = 1.0), 3_000);
        let at_m = b.position_m()[0];
        fly(&mut b, &message, 4_000);
        assert_eq!(b.status().mode, FlightMode::Offboard, "{reason}");
        assert!((b.position_m()[0] - at_m).abs() < 1.5, "{reason}");
        assert!(b.velocity_m_s().norm() < 0.1, "{reason}");
        b.assert_said(&format!("setpoints of 245/190: {reason}"));
    }
}

/// PX4 flies frames 1 and 8; scripts written for others send 7, 9, 11, 12, positions in frame 8, or a heading alone, and hear
/// "no setpoints" while they send twenty a second.
#[test]
fn a_stream_that_is_refused_hears_which_frame_mask_or_field_is_wrong() {
    use MavFrame::*;
    let in_frame = |frame| local_setpoint(0x5C7, |m| m.coordinate_frame = frame);
    let global = |frame| global_setpoint(frame, (0.0, 0.0), 0.0);
    let place_in_body = local_setpoint(0x9F8, |m| m.coordinate_frame = MAV_FRAME_BODY_NED);
    let infinite = local_setpoint(0x9C7, |m| m.vy = f32::INFINITY);
    let actuators = message!(SET_ACTUATOR_CONTROL_TARGET, target_system = 1, target_component = 1);
    for (message, reason) in [
        (in_frame(MAV_FRAME_LOCAL_OFFSET_NED), "frame 7 is not flown"),
        (in_frame(MAV_FRAME_BODY_OFFSET_NED), "frame 9 is not flown"),
        (in_frame(MAV_FRAME_GLOBAL_TERRAIN_ALT_INT), "frame 11 is not flown"),
        (in_frame(MAV_FRAME_BODY_FRD), "frame 12 is not flown"),
        (place_in_body, "frame 8 has no positions"),
        (local_setpoint(0xBFF, |_| {}), "mask 0xbff is not flown"),
        (infinite, "vy is NaN or absurd"),
        (global(MAV_FRAME_LOCAL_NED), "frame 1 is not flown"),
        (global(MAV_FRAME_GLOBAL_TERRAIN_ALT), "frame 10 is not flown"),
        (actuators, "actuators are not flown"),
        (attitude_setpoint(0x47, 0.0, 0.0, 0.5), "mask 0x047 is not flown"),
        (attitude_setpoint(0x07, 0.0, 0.0, 1.5), "thrust is NaN or absurd"),
    ] {
        let texts = refused(&message);
        let refusal = format!("setpoints of 245/190: {reason}");
        let count = texts.iter().filter(|text| **text == refusal).count();
        assert_eq!(count, 3, "once in 5 s of 12: {texts:?}");
        let denial = format!("offboard denied: {reason}");
        assert_eq!(texts.iter().filter(|text| **text == denial).count(), 1, "{texts:?}");
    }
    // A frame that the protocol does not have cannot be read, and is named all the same.
    let mut b = Bench::airborne();
    let packet = b.packet(SCRIPT, &local_setpoint(0x5C7, |_| {}));
    let mut payload = packet[10..packet.len() - 2].to_vec();
    payload.resize(53, 0);
    payload[52] = 99;
    b.send_raw(API, &raw(SCRIPT, 84, &payload));
    assert_eq!(b.texts(), ["setpoints of 245/190: frame 99 is not flown"]);
    // Who mends his frame is flown, and hears nothing more.
    b.fly(API, SCRIPT, [0.5, 0.0, 0.0], 100);
    b.run_ms(6_000);
    let texts = b.texts();
    assert!(!texts[1..].iter().any(|text| text.contains("not flown")), "{texts:?}");
}
