//! Arm, fly, land: what a script does.

use crate::geo::ORIGIN;
use crate::testing::*;

#[test]
fn a_script_arms_takes_off_hovers_lands_and_finds_it_disarmed() {
    let mut b = Bench::with(EndpointConfig::default());
    assert_eq!(b.command, ControlCommand::MotorsOff);
    assert_eq!(b.last::<HEARTBEAT_DATA>(API).system_status, MavState::MAV_STATE_STANDBY);
    b.take_off();
    b.run_ms(2000);
    assert!((b.height_m() - 2.5).abs() < 0.2, "{}", b.height_m());
    let base_mode = b.last::<HEARTBEAT_DATA>(GCS).base_mode;
    assert!(base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED));
    assert_eq!(b.command_long(API, SCRIPT, 21, [f32::NAN; 7]), ACCEPTED);
    b.run_ms(500);
    assert_eq!(b.status().landed, LandedState::Landing);
    b.run_until(20, "landing", |b| b.status().landed == LandedState::OnGround);
    assert!(b.status().armed, "motors still idle");
    b.run_until(5, "disarms by itself", |b| !b.status().armed);
    assert_eq!(b.status().mode, FlightMode::Hold);
    assert_eq!(b.command, ControlCommand::MotorsOff);
}

#[test]
fn a_high_take_off_climbs_at_its_rate_to_a_height_above_sea_level_and_does_not_overshoot() {
    let mut b = Bench::new();
    b.arm();
    let mut params = [f32::NAN; 7];
    params[6] = 488.0 + 12.0;
    assert_eq!(b.command_long(API, SCRIPT, 22, params), ACCEPTED);
    let fastest_m_s = b.most(6_000, |b| -b.velocity_m_s().z);
    assert!((fastest_m_s - 1.5).abs() < 0.2, "{fastest_m_s}");
    let highest_m = b.most(9_000, Bench::height_m);
    assert!((highest_m - 12.0).abs() < 0.2, "{highest_m}");
    assert_eq!(b.status().mode, FlightMode::Hold);
}

#[test]
fn the_vehicle_disarms_itself_when_nobody_takes_off() {
    let mut b = Bench::new();
    b.arm();
    assert!(b.status().armed);
    b.run_ms(9_000);
    assert!(b.status().armed);
    assert_eq!(b.command, ControlCommand::Idle);
    b.run_ms(1_500);
    assert!(!b.status().armed);
}

#[test]
fn only_the_kill_code_disarms_in_the_air_and_a_killed_vehicle_has_no_owner() {
    let mut b = Bench::airborne();
    b.fly(ONBOARD, COMPANION, [0.0; 3], 200);
    assert_eq!(b.disarm(0.0), REJECTED);
    assert_eq!(b.disarm(21195.0), REJECTED);
    assert!(b.status().armed);
    b.assert_said("not landed");
    assert_eq!(b.disarm(21196.0), ACCEPTED);
    let status = b.status();
    assert_eq!((status.setpoint_owner, status.mode), (None, FlightMode::Hold));
    b.run_ms(1);
    assert_eq!(b.command, ControlCommand::MotorsOff);
}

#[test]
fn termination_stops_the_motors_until_a_reboot() {
    let mut b = Bench::airborne();
    assert_eq!((b.ask(246, &[1.0]), b.ask(246, &[2.0])), (DENIED, DENIED));
    b.assert_said("reboot denied: armed");
    b.assert_said("it reboots only");
    assert_eq!(b.ask(185, &[1.0]), ACCEPTED);
    b.run_ms(1);
    assert_eq!(b.command, ControlCommand::MotorsOff);
    let heartbeat = b.last::<HEARTBEAT_DATA>(API);
    assert_eq!(heartbeat.system_status, MavState::MAV_STATE_FLIGHT_TERMINATION);
    assert_eq!(heartbeat.custom_mode, 10 << 16);
    b.run_ms(5_000);
    assert_eq!(b.arm(), REJECTED);
    assert_eq!(b.ask(246, &[0.0]), ACCEPTED);
    assert_eq!(b.arm(), REJECTED, "0 asks for nothing");
    assert_eq!(b.ask(246, &[1.0]), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
}

#[test]
fn goto_flies_to_the_place_and_holds_there() {
    let mut b = Bench::airborne();
    let place = on_globe((12.0, -7.0));
    assert_eq!(b.reposition(MavFrame::MAV_FRAME_GLOBAL, place, 492.0, 1.0), ACCEPTED);
    b.run_ms(12_000);
    assert!(b.is_at((12.0, -7.0), 4.0, 0.2), "{:?}", b.position_m());
    assert!((b.yaw_rad() - 1.0).abs() < 0.01);
    assert_eq!(b.status().mode, FlightMode::Hold);
    // Above sea level in frame 6 too, as PX4 reads it.
    let frame = MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT;
    assert_eq!(b.reposition(frame, place, 490.0, f32::NAN), ACCEPTED);
    b.run_ms(6_000);
    assert!((b.height_m() - 2.0).abs() < 0.2);
}

/// In a climb, where it drops before it counts as in the air for long.
#[test]
fn a_vehicle_killed_at_a_low_height_flies_again() {
    for height_m in [0.15, 0.3, 0.6] {
        let mut b = Bench::new();
        assert_eq!(b.arm(), ACCEPTED);
        assert_eq!(b.command_long(API, SCRIPT, 22, [f32::NAN; 7]), ACCEPTED);
        b.run_until(10, "climbs", |b| b.height_m() > height_m);
        assert_eq!(b.disarm(21196.0), ACCEPTED);
        b.run_ms(3_000);
        assert_eq!(b.status().landed, LandedState::OnGround, "{height_m}");
        // The order of MAVSDK, and the other one, in which take-off waits for arming.
        b.take_off();
        assert_eq!(b.disarm(21196.0), ACCEPTED);
        b.run_ms(4_000);
        assert_eq!(b.command_long(API, SCRIPT, 22, [f32::NAN; 7]), ACCEPTED);
        assert_eq!(b.arm(), ACCEPTED);
        b.run_until(20, "flies again", |b| b.height_m() > 2.0);
    }
}

/// PX4 reads the height of NAV_TAKEOFF above sea level in every frame, and does not climb to one below the vehicle.
#[test]
fn a_take_off_to_a_height_below_the_vehicle_does_not_climb() {
    let nan = f32::NAN;
    let mut b = Bench::new();
    let take_off = [nan, nan, nan, nan, nan, nan, 5.0];
    assert_eq!(b.command_long(API, SCRIPT, 22, take_off), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
    b.run_ms(8_000);
    assert!(b.height_m() < 0.3 && b.status().armed, "{}", b.height_m());
    b.assert_said("already higher than take-off altitude");
    b.run_until(5, "disarms: no take-off", |b| !b.status().armed);
    // In the air it climbs to one above it, stays where it is for one below, and climbs by MIS_TAKEOFF_ALT without any.
    let mut b = Bench::airborne();
    for (altitude_m, height_m) in [(494.0, 6.0), (490.0, 6.0), (nan, 8.5)] {
        let up = [nan, nan, nan, nan, nan, nan, altitude_m];
        assert_eq!(b.command_long(API, SCRIPT, 22, up), ACCEPTED);
        b.run_ms(8_000);
        assert!((b.height_m() - height_m).abs() < 0.3, "{}", b.height_m());
    }
}

/// As PX4, whose modes that land are none to arm in.
#[test]
fn land_and_return_can_be_chosen_on_the_ground_and_not_armed_in() {
    let mut b = Bench::new();
    for (sub, name) in [(6, "land"), (5, "return"), (8, "follow")] {
        assert_eq!(b.set_mode(API, SCRIPT, 4, sub), ACCEPTED);
        assert_eq!(b.arm(), REJECTED);
        b.assert_said(&format!("arming denied: not in {name}, change the mode"));
    }
    assert_eq!(b.set_mode(API, SCRIPT, 4, 3), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
}

/// PX4's RTL_CONE_ANG of 45 degrees.
#[test]
fn a_return_from_near_home_climbs_no_higher_than_it_is_away_and_keeps_to_the_largest_speed() {
    for (north_m, height_m) in [(7.0, 7.0), (3.0, 4.0), (1.0, 3.0)] {
        let mut b = Bench::airborne();
        assert_eq!(b.go_to((north_m, 0.0), 491.0), ACCEPTED);
        b.run_ms(8_000);
        assert_eq!(b.set_mode(API, SCRIPT, 4, 5), ACCEPTED);
        b.set_parameter("MPC_XY_VEL_MAX", ParameterValue::Real(1.0));
        let highest_m = b.most(60_000, Bench::height_m);
        assert!((highest_m - height_m).abs() < 0.4, "{north_m}: {highest_m}");
        let home_m = b.position_m()[0].abs();
        assert!(!b.status().armed && home_m < 0.7, "{home_m}");
    }
}

#[test]
fn goto_is_refused_on_the_ground_far_away_and_in_a_foreign_frame() {
    assert_eq!(Bench::new().go_to((0.0, 0.0), 490.0), REJECTED);
    let mut b = Bench::airborne();
    for (frame, lat, alt) in [
        (MavFrame::MAV_FRAME_GLOBAL, 12.0, 490.0),
        (MavFrame::MAV_FRAME_GLOBAL, 47.3977, 9000.0),
        (MavFrame::MAV_FRAME_GLOBAL, 47.3977, f32::INFINITY),
        (MavFrame::MAV_FRAME_BODY_FRD, 47.3977, 490.0),
    ] {
        let answer = b.reposition(frame, (lat, 8.5455), alt, 0.0);
        assert_eq!(answer, DENIED, "{frame:?} {lat} {alt}");
    }
    b.run_ms(1_000);
    // A place at no height is one of its frame too, and whoever means another frame is answered so.
    for (frame, alt) in [
        (MavFrame::MAV_FRAME_LOCAL_NED, f32::NAN),
        (MavFrame::MAV_FRAME_MISSION, f32::NAN),
        (MavFrame::MAV_FRAME_GLOBAL_TERRAIN_ALT, 5.0),
    ] {
        b.sent.clear();
        assert_eq!(b.reposition(frame, (47.3977, 8.5455), alt, 0.0), DENIED, "{frame:?}");
        let text = format!("denied: frame {} is not flown, 0, 3, 5 and 6 are", frame as u8);
        b.assert_said(&text);
    }
}

#[test]
fn home_can_be_moved_and_return_flies_there() {
    const SET_HOME: u16 = 179;
    let mut b = Bench::airborne();
    let (lat, lon) = on_globe((8.0, -6.0));
    let place = |use_current: f32, lat: f64, alt: f32| [use_current, 0.0, 0.0, 0.0, lat as f32, lon as f32, alt];
    for (use_current, lat, alt) in [
        (0.0, f64::NAN, 488.0),
        (0.0, 12.0, 488.0),
        (0.0, lat, 520.0),
        (0.5, lat, 488.0),
    ] {
        let answer = b.ask(SET_HOME, &place(use_current, lat, alt));
        assert_eq!(answer, DENIED, "{use_current} {lat} {alt}");
    }
    let home_of = |b: &Bench| b.last::<HOME_POSITION_DATA>(API);
    b.run_ms(2_500);
    let before = home_of(&b);
    assert_eq!((before.x, before.y, before.z), (0.0, 0.0, 0.0));
    assert_eq!(before.latitude, (ORIGIN.latitude_deg * 1e7).round() as i32);

    // A COMMAND_LONG holds a latitude to less than half a metre.
    assert_eq!(b.ask(SET_HOME, &place(0.0, lat, 488.0)), ACCEPTED);
    b.run_ms(100);
    let home = home_of(&b);
    let is_there = (home.x - 8.0).abs() < 0.5 && (home.y + 6.0).abs() < 0.5 && home.z == 0.0;
    assert!(is_there, "{home:?}");
    assert!((f64::from(home.latitude) - lat * 1e7).abs() < 50.0);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 5), ACCEPTED);
    b.run_until(90, "landed at the new home", |b| {
        b.status().landed == LandedState::OnGround
    });
    assert!(b.is_at((home.x, home.y), 0.0, 0.7), "{:?}", b.position_m());

    // As MAVSDK sends it: a COMMAND_INT with an altitude above sea level in a frame that is relative to home.
    let frame = MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT;
    b.command_at(MavCmd::MAV_CMD_DO_SET_HOME, [0.0; 4], frame, (lat, lon), 488.0);
    b.run_ms(100);
    let home = home_of(&b);
    assert!((home.x - 8.0).abs() < 0.02 && (home.y + 6.0).abs() < 0.02, "{home:?}");

    // The heights' reference and the local origin are what they were, whoever sets another; here is home now.
    for (latitude, texts) in [(473_977_420, 0), (470_000_000, 1)] {
        b.sent.clear();
        let (longitude, altitude) = (85_455_940, 488_000);
        b.tell(message!(SET_GPS_GLOBAL_ORIGIN, latitude, longitude, altitude));
        assert_eq!(b.texts().len(), texts, "{latitude}");
    }
    let last_origin = b.last::<GPS_GLOBAL_ORIGIN_DATA>(API).latitude;
    assert_eq!(last_origin, (ORIGIN.latitude_deg * 1e7).round() as i32);
    assert_eq!(b.ask(SET_HOME, &[1.0]), ACCEPTED);
    b.run_ms(100);
    let home = home_of(&b);
    assert!(b.is_at((home.x, home.y), 0.0, 0.3), "{home:?}");
}

#[test]
fn the_height_alone_can_be_changed() {
    const CHANGE_ALTITUDE: u16 = 186;
    let mut b = Bench::airborne();
    let change = |b: &mut Bench, altitude: f32, frame: f32| b.ask(CHANGE_ALTITUDE, &[altitude, frame]);
    // Above sea level in either frame.
    for (altitude, frame) in [(494.0, 3.0), (492.0, 0.0)] {
        assert_eq!(change(&mut b, altitude, frame), ACCEPTED);
        b.run_ms(8_000);
        assert!((b.height_m() - (altitude - 488.0)).abs() < 0.3, "{}", b.height_m());
        assert!(b.position_m()[0].hypot(b.position_m()[1]) < 0.5);
    }
    assert_eq!(change(&mut b, f32::NAN, 3.0), DENIED);
    assert_eq!(change(&mut b, 5.0, 1.0), DENIED);
    assert_eq!(change(&mut b, 1000.0, 3.0), DENIED);
    assert_eq!(b.status().mode, FlightMode::Hold);
}

/// Home lies 488 m above sea level. A height that was meant above the ground is sent in a frame that counts from the sea.
#[test]
fn a_go_to_far_below_home_is_denied_with_what_its_height_means() {
    let (lat, lon) = on_globe((5.0, 0.0));
    for (frame, height_m, below_m) in [
        (MavFrame::MAV_FRAME_GLOBAL_INT, 5.0, 483),
        (MavFrame::MAV_FRAME_GLOBAL, 5.0, 483),
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 8.0, 480),
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT, 8.0, 480),
    ] {
        let mut b = Bench::airborne();
        assert_eq!(b.reposition(frame, (lat, lon), height_m, f32::NAN), DENIED, "{frame:?}");
        let text = format!("denied: {below_m} m below home");
        b.assert_said(&text);
        b.sent.clear();
        assert_eq!(b.ask(186, &[height_m, f32::from(frame as u8)]), DENIED);
        b.assert_said(&text);
        b.run_ms(5_000);
        assert!((b.height_m() - 3.0).abs() < 0.3, "it stays where it is");
    }
    let mut b = Bench::airborne();
    let orbit = [3.0, 1.0, 0.0, 0.0, lat as f32, lon as f32, 300.0];
    assert_eq!(b.ask(34, &orbit), DENIED, "a circle below home");
    assert_eq!(b.go_to((5.0, 0.0), 493.0), ACCEPTED);
    b.run_until(20, "5 m above home", |b| b.is_at((5.0, 0.0), 5.0, 0.3));
}

/// Whatever sends the vehicle down, it is on the ground slower than what breaks it, and ends as a landing does.
#[test]
fn what_leads_into_the_ground_ends_on_it_softly() {
    let place = |mask, z, vz| local_setpoint(mask, |m| (m.x, m.z, m.vz) = (6.0, z, vz));
    let global = global_setpoint(MavFrame::MAV_FRAME_GLOBAL_INT, on_globe((0.0, 0.0)), 5.0);
    let acceleration = local_setpoint(0xC3F, |m| m.afz = 5.0);
    for (message, below_home) in [
        (acceleration, false),
        (velocity_message([0.0, 0.0, 1.5]), false),
        (velocity_message([0.0, 0.0, 90.0]), false),
        (place(0xDF8, 40.0, 0.0), true),
        (place(0xDF8, 0.3, 0.0), false),
        (place(0xDE3, 40.0, 0.0), true),
        (place(0xDDC, 0.0, 1.5), false),
        (place(0xDC7, 0.0, 3.0), false),
        (global, true),
    ] {
        let mut b = Bench::airborne();
        b.set_parameter("MPC_Z_VEL_MAX_DN", ParameterValue::Real(4.0));
        b.set_parameter("MPC_LAND_SPEED", ParameterValue::Real(1.5));
        b.set_parameter("COM_DISARM_LAND", ParameterValue::Real(0.5));
        let mut fastest_m_s = 0.0_f32;
        for i in 0..600 {
            b.send(API, SCRIPT, &message);
            if i == 0 {
                assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
            }
            b.run_ms(50);
            if b.height_m() < 0.3 {
                fastest_m_s = fastest_m_s.max(b.velocity_m_s().z);
            }
            if !b.status().armed {
                break;
            }
        }
        assert!(fastest_m_s < 1.3, "{message:?}: {fastest_m_s}");
        assert!(!b.status().armed, "{message:?}: {:?} {}", b.status(), b.height_m());
        let warned = b.texts().iter().any(|text| text.contains("m below home"));
        assert_eq!(warned, below_home, "{message:?}: {:?}", b.texts());
    }
}

/// How QGroundControl pauses: it stops where it can, not where it was asked to.
#[test]
fn a_go_to_without_a_place_stops_the_vehicle_where_it_is() {
    let mut b = Bench::airborne();
    assert_eq!(b.go_to((60.0, 0.0), 491.0), ACCEPTED);
    b.run_until(10, "under way", |b| b.velocity_m_s().x > 3.0);
    let told_at_m = b.position_m()[0];
    let nan = f32::NAN;
    for flags in [0.0, 3.0, nan] {
        assert_eq!(b.ask(192, &[-1.0, flags, 0.0, nan, nan, nan, nan]), UNSUPPORTED);
    }
    assert_eq!(b.ask(192, &[-1.0, 1.0, 0.0, nan, nan, nan, nan]), ACCEPTED);
    let back_m_s = b.most(6_000, |b| -b.velocity_m_s().x);
    let went_m = b.position_m()[0] - told_at_m;
    assert!(went_m > 1.0 && back_m_s < 0.25, "it does not fly back: {back_m_s}");
    assert!(b.velocity_m_s().norm() < 0.2);
    // MAVSDK casts a place of NaN to the smallest integers.
    let (frame, cast) = (MavFrame::MAV_FRAME_GLOBAL, (f64::MIN, f64::MIN));
    assert_eq!(b.reposition(frame, cast, nan, nan), ACCEPTED);
    assert_eq!(b.reposition(frame, (95.0, 8.5), nan, nan), DENIED);
    b.assert_said("no such latitude");
    assert_eq!(b.status().mode, FlightMode::Hold);
    let (orbit, circle) = (MavCmd::MAV_CMD_DO_ORBIT, [5.0, 2.0, 0.0, 0.0]);
    assert_eq!(b.command_at(orbit, circle, frame, cast, nan), ACCEPTED);
}
