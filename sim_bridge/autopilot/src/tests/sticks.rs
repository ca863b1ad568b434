//! Modes that are flown by sticks.

use crate::testing::*;

/// (main mode, mode): altitude, stabilized, manual, acro, position.
const MODES: [(u8, FlightMode); 5] = [
    (2, FlightMode::Altitude),
    (7, FlightMode::Stabilized),
    (1, FlightMode::Manual),
    (5, FlightMode::Acro),
    (3, FlightMode::Position),
];

fn sticks(x: i16, y: i16, z: i16, r: i16) -> MavMessage {
    // 0 is every system.
    message!(MANUAL_CONTROL, target = 0, x, y, z, r)
}

fn channels(pulses: [u16; 4]) -> MavMessage {
    let [chan1_raw, chan2_raw, chan3_raw, chan4_raw] = pulses;
    message!(
        RC_CHANNELS_OVERRIDE,
        chan1_raw,
        chan2_raw,
        chan3_raw,
        chan4_raw,
        target_system = 1,
        target_component = 1
    )
}

fn hold(b: &mut Bench, message: &MavMessage, ms: u64) {
    b.hold(GCS, STATION, message, ms);
}

#[test]
fn a_mode_can_be_chosen_on_the_ground_and_arming_waits_for_the_sticks() {
    for (main, mode) in MODES {
        let mut b = Bench::new();
        assert_eq!(b.set_mode(GCS, STATION, main, 0), ACCEPTED);
        assert_eq!(b.status().mode, mode);
        assert_eq!(b.arm(), REJECTED);
        b.assert_said("no manual control");
        for (throttle, is_low) in [(650, false), (500, matches!(main, 2 | 3))] {
            hold(&mut b, &sticks(0, 0, throttle, 0), 200);
            let answer = if is_low { ACCEPTED } else { REJECTED };
            assert_eq!(b.arm(), answer, "{mode:?} at {throttle}");
        }
        b.assert_said("arming denied: throttle is up");
        hold(&mut b, &sticks(0, 0, 0, 0), 200);
        assert_eq!(b.arm(), ACCEPTED);
        hold(&mut b, &sticks(0, 0, 0, 0), 1_000);
        assert_eq!((b.status().mode, b.status().landed), (mode, LandedState::OnGround));
        hold(&mut b, &sticks(0, 0, 700, 0), 3_000);
        assert!(b.height_m() > 0.8, "{mode:?}: {}", b.height_m());
        assert_eq!(b.status().mode, mode);
    }
}

#[test]
fn altitude_mode_tilts_by_the_stick_and_holds_its_height() {
    let mut b = Bench::airborne();
    hold(&mut b, &sticks(0, 0, 500, 0), 100);
    assert_eq!(b.set_mode(GCS, STATION, 2, 0), ACCEPTED);
    hold(&mut b, &sticks(0, 300, 500, 0), 2_000);
    let e = b.view().estimate;
    // (0.3 − 0.05) / 0.95 of 35 degrees.
    let roll_rad = e.attitude.roll_rad();
    assert!((roll_rad - 0.161).abs() < 0.03, "{roll_rad}");
    assert!(e.velocity_ned_m_s.y > 1.5, "and flies that way");
    hold(&mut b, &sticks(0, 0, 500, 0), 3_000);
    assert!((b.height_m() - 3.0).abs() < 0.3, "{}", b.height_m());
    hold(&mut b, &sticks(0, 0, 1000, 0), 2_000);
    assert!((b.velocity_m_s().z + 2.5).abs() < 0.3);
}

#[test]
fn a_throttle_that_is_pulled_back_lands_softly_whatever_the_parameters_say() {
    for main in [2, 3] {
        let mut b = Bench::airborne();
        b.set_parameter("MPC_Z_VEL_MAX_DN", ParameterValue::Real(4.0));
        b.set_parameter("MPC_LAND_SPEED", ParameterValue::Real(1.5));
        hold(&mut b, &sticks(0, 0, 1000, 0), 100);
        assert_eq!(b.set_mode(GCS, STATION, main, 0), ACCEPTED);
        hold(&mut b, &sticks(0, 0, 1000, 0), 4_000);
        let mut fastest_m_s = 0.0_f32;
        for _ in 0..400 {
            hold(&mut b, &sticks(0, 0, 0, 0), 50);
            if b.height_m() < 0.3 {
                fastest_m_s = fastest_m_s.max(b.velocity_m_s().z);
            }
        }
        assert!(fastest_m_s < 1.3, "mode {main}: {fastest_m_s}");
        assert!(!b.status().armed, "mode {main}: {}", b.height_m());
    }
}

#[test]
fn stabilized_and_manual_hold_a_tilt_and_acro_a_rate() {
    for (main, _) in [(7, FlightMode::Stabilized), (1, FlightMode::Manual)] {
        let mut b = Bench::airborne();
        hold(&mut b, &sticks(0, 0, 500, 0), 100);
        assert_eq!(b.set_mode(GCS, STATION, main, 0), ACCEPTED);
        hold(&mut b, &sticks(400, 0, 530, 400), 1_000);
        let pitch_rad = b.view().estimate.attitude.pitch_rad();
        assert!((pitch_rad + 0.225).abs() < 0.04, "{pitch_rad}");
        assert!(b.yaw_rad() > 0.25, "{}", b.yaw_rad());
    }
    let mut b = Bench::airborne();
    hold(&mut b, &sticks(0, 0, 500, 0), 100);
    assert_eq!(b.set_mode(GCS, STATION, 5, 0), ACCEPTED);
    hold(&mut b, &sticks(0, 200, 550, 0), 400);
    assert!((b.view().estimate.rates_frd_rad_s.x - 0.276).abs() < 0.06);
    // Let go of: hold takes over, from that attitude.
    b.run_ms(4_000);
    assert_eq!(b.status().mode, FlightMode::Hold);
    assert!(b.velocity_m_s().norm() < 0.3);
}

/// As in PX4: whoever has sticks is missed when they stop, unless the mode is excepted; not where nobody ever had any.
#[test]
fn sticks_that_are_lost_end_modes_that_fly_without_them_too() {
    let velocity = local_setpoint(0xDC7, |m| m.vx = 0.3);
    for (main, sub, exception, other) in [(4, 3, 2, 5), (6, 0, 4, 3), (4, 6, 0, 0)] {
        for excepted in [false, true] {
            let mut b = Bench::airborne();
            let except = if excepted { exception } else { other };
            b.set_parameter("COM_RCL_EXCEPT", ParameterValue::Integer(except));
            b.hold(API, SCRIPT, &velocity, 200);
            assert_eq!(b.set_mode(API, SCRIPT, main, sub), ACCEPTED);
            b.hold(API, SCRIPT, &velocity, 1_000);
            assert_eq!(b.status().failsafe, None, "nobody had sticks");
            b.send(GCS, STATION, &sticks(0, 0, 500, 0));
            b.hold(API, SCRIPT, &velocity, 800);
            let is_lost = !excepted && exception != 0;
            assert_eq!(b.status().failsafe.is_some(), is_lost, "{main} {sub} {except}");
            b.hold(API, SCRIPT, &velocity, 5_500);
            assert_eq!(b.status().mode == FlightMode::Return, is_lost, "{main} {sub} {except}");
        }
    }
}

#[test]
fn overridden_channels_are_sticks() {
    let mut b = Bench::airborne();
    hold(&mut b, &channels([1500; 4]), 200);
    assert_eq!(b.set_mode(GCS, STATION, 3, 0), ACCEPTED);
    // Pitch stick forward: the lower pulse.
    hold(&mut b, &channels([1500, 1300, 1500, u16::MAX]), 3_000);
    assert!(b.position_m()[0] > 2.0, "{:?}", b.position_m());
    hold(&mut b, &channels([1500, 1500, 1900, 0]), 2_000);
    assert!(b.height_m() > 4.0, "{}", b.height_m());
    // No pulse or axis at all is a mistake, and channels given back are let go of.
    hold(&mut b, &channels([1500, 20, 1500, 1500]), 100);
    hold(&mut b, &sticks(i16::MAX, i16::MAX, i16::MAX, i16::MAX), 50);
    assert_eq!(b.status().refusals.setpoint_value, 3);
    hold(&mut b, &channels([0, u16::MAX, 0, 0]), 600);
    assert_eq!(b.status().mode, FlightMode::Hold);
}

#[test]
fn sticks_fly_the_vehicle_until_they_are_let_go_of_or_lost() {
    let mut b = Bench::airborne();
    hold(&mut b, &sticks(0, 0, 500, 0), 200);
    assert_eq!(b.set_mode(GCS, STATION, 3, 0), ACCEPTED);
    // A joystick of one axis.
    hold(&mut b, &sticks(400, i16::MAX, i16::MAX, i16::MAX), 3_000);
    let there = b.position_m()[0];
    assert!((2.0..6.0).contains(&there), "flew {there} m north");
    // Somebody else's sticks are not mixed in.
    for _ in 0..60 {
        b.send(GCS, STATION, &sticks(0, 0, 500, 0));
        b.send(API, SCRIPT, &sticks(-1000, 0, 1000, 0));
        b.run_ms(50);
    }
    assert!(b.position_m()[0] > there && (b.height_m() - 3.0).abs() < 0.4);
    // They take over where the first fall silent, and keep the vehicle until they do.
    b.hold(API, SCRIPT, &sticks(0, 0, 1000, 0), 1_500);
    assert_eq!((b.status().mode, b.status().failsafe), (FlightMode::Position, None));
    assert!(b.velocity_m_s().z < -0.2, "{:?}", b.velocity_m_s());
    hold(&mut b, &sticks(0, 0, 1000, 0), 3_000);
    assert!(b.height_m() > 3.5, "climbs with the throttle up");
    assert_eq!(b.status().mode, FlightMode::Position);
    b.run_ms(1_000);
    assert_eq!(b.status().mode, FlightMode::Hold);
    assert!(b.status().failsafe.is_some() && b.texts().join("|").contains("manual control lost: hold"));
    assert_eq!(b.set_mode(GCS, STATION, 3, 0), REJECTED);
    b.assert_said("position denied: no manual control");
    b.run_ms(4_000);
    assert_eq!(b.status().mode, FlightMode::Hold);
    b.run_ms(1_000);
    assert_eq!(b.status().mode, FlightMode::Return);
    b.assert_said("manual control lost: return");
    // Not where somebody has taken the vehicle meanwhile.
    hold(&mut b, &sticks(0, 0, 500, 0), 200);
    assert_eq!(b.set_mode(GCS, STATION, 3, 0), ACCEPTED);
    b.run_ms(1_000);
    assert_eq!(b.set_mode(GCS, STATION, 4, 3), ACCEPTED);
    b.run_ms(6_000);
    assert_eq!(b.status().mode, FlightMode::Hold);
}
