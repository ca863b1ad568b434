//! Arm, fly, land: what a script does.

use crate::testing::*;
use crate::vehicle::ControlCommand;
use crate::{FlightMode, HomePosition, LandedState, ParameterValue};
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::*;
use vigil_types::NedVector;

#[test]
fn a_script_arms_takes_off_hovers_lands_and_finds_it_disarmed() {
    let mut b = Bench::new();
    assert_eq!(b.command, ControlCommand::MotorsOff);
    assert_eq!(b.heartbeat(API).system_status, MavState::MAV_STATE_STANDBY);
    b.take_off();
    b.run_ms(2000);
    assert!((b.height_m() - 2.5).abs() < 0.2, "{}", b.height_m());
    assert!(
        b.heartbeat(GCS)
            .base_mode
            .contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED)
    );
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
fn a_high_take_off_climbs_at_its_rate_and_does_not_overshoot() {
    let mut b = Bench::new();
    b.arm();
    let mut params = [f32::NAN; 7];
    params[6] = 488.0 + 12.0;
    assert_eq!(b.command_long(API, SCRIPT, 22, params), ACCEPTED);
    let mut fastest_m_s: f32 = 0.0;
    let mut highest_m: f32 = 0.0;
    for _ in 0..1500 {
        b.run_ms(10);
        fastest_m_s = fastest_m_s.max(-b.view().estimate.velocity_ned_m_s.z);
        highest_m = highest_m.max(b.height_m());
    }
    assert!((fastest_m_s - 1.5).abs() < 0.2, "{fastest_m_s}");
    assert!((highest_m - 12.0).abs() < 0.2, "{highest_m}");
    assert_eq!(b.status().mode, FlightMode::Hold);
}

#[test]
fn taking_off_first_and_arming_later_flies_too() {
    let mut b = Bench::new();
    assert_eq!(b.set_mode(API, SCRIPT, 4, 2), ACCEPTED);
    b.run_ms(1000);
    assert_eq!(b.command, ControlCommand::MotorsOff);
    assert_eq!(b.arm(), ACCEPTED);
    b.run_until(20, "take-off", |b| b.status().mode == FlightMode::Hold);
    assert!((b.height_m() - 2.5).abs() < 0.4);
}

#[test]
fn the_height_of_a_take_off_is_above_sea_level() {
    let mut b = Bench::new();
    b.arm();
    let mut params = [f32::NAN; 7];
    params[6] = 488.0 + 6.0;
    assert_eq!(b.command_long(API, SCRIPT, 22, params), ACCEPTED);
    b.run_until(20, "take-off", |b| b.status().mode == FlightMode::Hold);
    assert!((b.height_m() - 6.0).abs() < 0.4, "{}", b.height_m());
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
fn only_the_kill_code_disarms_in_the_air() {
    let mut b = Bench::airborne();
    assert_eq!(b.disarm(0.0), REJECTED);
    assert_eq!(b.disarm(21195.0), REJECTED);
    assert!(b.status().armed);
    assert!(b.texts().iter().any(|t| t.contains("not landed")));
    assert_eq!(b.disarm(21196.0), ACCEPTED);
    b.run_ms(1);
    assert_eq!(b.command, ControlCommand::MotorsOff);
}

#[test]
fn termination_stops_the_motors_until_a_reboot() {
    let mut b = Bench::airborne();
    assert_eq!(
        b.command_long(API, SCRIPT, 185, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ACCEPTED
    );
    b.run_ms(1);
    assert_eq!(b.command, ControlCommand::MotorsOff);
    assert_eq!(b.heartbeat(API).system_status, MavState::MAV_STATE_FLIGHT_TERMINATION);
    b.run_ms(5_000);
    assert_eq!(b.arm(), REJECTED);
    let mut reboot = [0.0; 7];
    reboot[0] = 1.0;
    assert_eq!(b.command_long(API, SCRIPT, 246, reboot), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
}

#[test]
fn hold_stops_first_and_stays_where_it_stopped() {
    let mut b = Bench::airborne();
    b.stream(API, SCRIPT, [1.5, 0.0, 0.0]);
    b.run_ms(100);
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
    b.run_ms(3_000);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 3), ACCEPTED);
    b.stop_stream(SCRIPT);
    b.run_ms(1_500);
    let stopped = b.position_m();
    b.run_ms(3_000);
    let later = b.position_m();
    assert!((stopped[0] - later[0]).abs() < 0.05 && (stopped[2] - later[2]).abs() < 0.05);
    assert!(stopped[0] > 3.0);
}

#[test]
fn goto_flies_to_the_place_and_holds_there() {
    let mut b = Bench::airborne();
    let home = crate::HomePosition::default();
    let (lat, lon, _) = crate::geo::to_global(&home, vigil_types::NedVector::new(12.0, -7.0, 0.0));
    assert_eq!(
        b.reposition(MavFrame::MAV_FRAME_GLOBAL, lat, lon, 488.0 + 4.0, 1.0),
        ACCEPTED
    );
    b.run_ms(12_000);
    let [x, y, z] = b.position_m();
    assert!(
        (x - 12.0).abs() < 0.2 && (y + 7.0).abs() < 0.2 && (z + 4.0).abs() < 0.2,
        "{x} {y} {z}"
    );
    assert!((b.view().estimate.attitude.yaw_rad() - 1.0).abs() < 0.01);
    assert_eq!(b.status().mode, FlightMode::Hold);
    // Above sea level in frame 6 too, as PX4 reads it.
    assert_eq!(
        b.reposition(MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, lat, lon, 490.0, f32::NAN),
        ACCEPTED
    );
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
    assert!(b.texts().contains(&"already higher than take-off altitude".to_owned()));
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
        let text = format!("arming denied: not in {name}, change the mode");
        assert!(b.texts().contains(&text), "{:?}", b.texts());
    }
    assert_eq!(b.set_mode(API, SCRIPT, 4, 3), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
}

/// PX4's RTL_CONE_ANG of 45 degrees.
#[test]
fn a_return_from_near_home_climbs_no_higher_than_it_is_away() {
    for (north_m, height_m) in [(7.0, 7.0), (3.0, 4.0), (1.0, 3.0)] {
        let mut b = Bench::airborne();
        let (lat, lon, _) = crate::geo::to_global(&HomePosition::default(), NedVector::new(north_m, 0.0, 0.0));
        assert_eq!(
            b.reposition(MavFrame::MAV_FRAME_GLOBAL, lat, lon, 491.0, f32::NAN),
            ACCEPTED
        );
        b.run_ms(8_000);
        assert_eq!(b.set_mode(API, SCRIPT, 4, 5), ACCEPTED);
        let mut highest_m: f32 = 0.0;
        for _ in 0..600 {
            b.run_ms(100);
            highest_m = highest_m.max(b.height_m());
        }
        assert!((highest_m - height_m).abs() < 0.4, "{north_m}: {highest_m}");
        assert!(
            !b.status().armed && b.position_m()[0].abs() < 0.7,
            "{:?}",
            b.position_m()
        );
    }
}

#[test]
fn goto_is_refused_on_the_ground_far_away_and_in_a_foreign_frame() {
    let mut b = Bench::new();
    assert_eq!(
        b.reposition(MavFrame::MAV_FRAME_GLOBAL, 47.3977, 8.5455, 490.0, 0.0),
        REJECTED
    );
    let mut b = Bench::airborne();
    for (frame, lat, alt) in [
        (MavFrame::MAV_FRAME_GLOBAL, 12.0, 490.0),
        (MavFrame::MAV_FRAME_GLOBAL, 47.3977, 9000.0),
        (MavFrame::MAV_FRAME_GLOBAL, 47.3977, f32::INFINITY),
        (MavFrame::MAV_FRAME_BODY_FRD, 47.3977, 490.0),
    ] {
        assert_eq!(
            b.reposition(frame, lat, 8.5455, alt, 0.0),
            DENIED,
            "{frame:?} {lat} {alt}"
        );
    }
    // A place at no height is one of its frame too, and whoever means another frame is told.
    for (frame, alt) in [
        (MavFrame::MAV_FRAME_LOCAL_NED, f32::NAN),
        (MavFrame::MAV_FRAME_MISSION, f32::NAN),
        (MavFrame::MAV_FRAME_GLOBAL_TERRAIN_ALT, 5.0),
    ] {
        b.sent.clear();
        assert_eq!(b.reposition(frame, 47.3977, 8.5455, alt, 0.0), DENIED, "{frame:?}");
        let told = format!("denied: frame {} is not flown, 0, 3, 5 and 6 are", frame as u8);
        assert!(b.texts().contains(&told), "{:?}", b.texts());
    }
}

#[test]
fn home_can_be_moved_and_return_flies_there() {
    const SET_HOME: u16 = 179;
    let mut b = Bench::airborne();
    let origin = crate::HomePosition::default();
    let (lat, lon, alt) = crate::geo::to_global(&origin, vigil_types::NedVector::new(8.0, -6.0, 0.0));
    let place = |use_current: f32, lat: f64, alt: f32| [use_current, 0.0, 0.0, 0.0, lat as f32, lon as f32, alt];
    for refused in [
        place(0.0, f64::NAN, 488.0),
        place(0.0, 12.0, 488.0),
        place(0.0, lat, 520.0),
        place(0.5, lat, 488.0),
    ] {
        assert_eq!(b.command_long(API, SCRIPT, SET_HOME, refused), DENIED, "{refused:?}");
    }
    let told = |b: &Bench| {
        let mut homes = b.messages(API).filter_map(|m| match m {
            MavMessage::HOME_POSITION(m) => Some((m.x, m.y, m.z, m.latitude)),
            _ => None,
        });
        homes.next_back().unwrap()
    };
    b.run_ms(2_500);
    assert_eq!(told(&b), (0.0, 0.0, 0.0, (origin.latitude_deg * 1e7).round() as i32));

    // A COMMAND_LONG holds a latitude to less than half a metre.
    assert_eq!(
        b.command_long(API, SCRIPT, SET_HOME, place(0.0, lat, alt as f32)),
        ACCEPTED
    );
    b.run_ms(100);
    let (x, y, z, latitude) = told(&b);
    assert!(
        (x - 8.0).abs() < 0.5 && (y + 6.0).abs() < 0.5 && z == 0.0,
        "{x} {y} {z}"
    );
    assert!((f64::from(latitude) - lat * 1e7).abs() < 50.0);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 5), ACCEPTED);
    b.run_until(90, "landed at the new home", |b| {
        b.status().landed == LandedState::OnGround
    });
    let [north, east, _] = b.position_m();
    assert!((north - x).abs() < 0.7 && (east - y).abs() < 0.7, "{north} {east}");

    // As MAVSDK sends it: a COMMAND_INT with an altitude above sea level in a frame that is relative to home.
    let command = MavMessage::COMMAND_INT(COMMAND_INT_DATA {
        command: MavCmd::MAV_CMD_DO_SET_HOME,
        frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
        target_system: 1,
        target_component: 1,
        x: (lat * 1e7).round() as i32,
        y: (lon * 1e7).round() as i32,
        z: 488.0,
        ..Default::default()
    });
    b.send(API, SCRIPT, &command);
    b.run_ms(100);
    let (x, y, ..) = told(&b);
    assert!((x - 8.0).abs() < 0.02 && (y + 6.0).abs() < 0.02, "{x} {y}");

    // The heights' reference and the local origin are what they were; here is home now.
    let last_origin = b.messages(API).rev().find_map(|m| match m {
        MavMessage::GPS_GLOBAL_ORIGIN(m) => Some(m.latitude),
        _ => None,
    });
    assert_eq!(last_origin, Some((origin.latitude_deg * 1e7).round() as i32));
    assert_eq!(
        b.command_long(API, SCRIPT, SET_HOME, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ACCEPTED
    );
    b.run_ms(100);
    let (x, y, ..) = told(&b);
    assert!((north - x).abs() < 0.3 && (east - y).abs() < 0.3, "{x} {y}");
}

#[test]
fn return_climbs_flies_home_and_lands() {
    let mut config = crate::EndpointConfig::default();
    config.parameters.insert("RTL_RETURN_ALT".into(), 6.0);
    let mut b = Bench::with(config);
    b.take_off();
    let (lat, lon, _) = crate::geo::to_global(
        &crate::HomePosition::default(),
        vigil_types::NedVector::new(15.0, 5.0, 0.0),
    );
    assert_eq!(
        b.reposition(MavFrame::MAV_FRAME_GLOBAL_INT, lat, lon, 491.0, f32::NAN),
        ACCEPTED
    );
    b.run_ms(10_000);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 5), ACCEPTED);
    b.run_until(10, "climb", |b| b.height_m() > 5.6);
    assert!(b.position_m()[0] > 14.0, "climbs before it travels");
    b.run_until(30, "home", |b| b.status().landed == LandedState::OnGround);
    let [x, y, _] = b.position_m();
    assert!(x.abs() < 0.7 && y.abs() < 0.7, "{x} {y}");
    b.run_until(5, "disarms", |b| !b.status().armed);
}

#[test]
fn manual_modes_and_missions_are_refused_with_a_reason() {
    let mut b = Bench::airborne();
    assert_eq!(b.set_mode(API, SCRIPT, 3, 0), REJECTED);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 4), REJECTED);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 77), DENIED);
    assert_eq!(b.status().mode, FlightMode::Hold);
    let texts = b.texts().join("|");
    assert!(
        texts.contains("no manual control") && texts.contains("no mission"),
        "{texts}"
    );
}

#[test]
fn a_campaign_starts_in_the_air_and_holds_its_height() {
    let mut b = Bench::airborne();
    assert!(b.status().armed);
    assert_eq!(b.status().landed, LandedState::InAir);
    b.run_ms(3_000);
    assert!((b.height_m() - 3.0).abs() < 0.2, "{}", b.height_m());
}

#[test]
fn the_height_alone_can_be_changed() {
    const CHANGE_ALTITUDE: u16 = 186;
    let mut b = Bench::airborne();
    let change = |b: &mut Bench, altitude: f32, frame: f32| {
        b.command_long(API, SCRIPT, CHANGE_ALTITUDE, [altitude, frame, 0.0, 0.0, 0.0, 0.0, 0.0])
    };
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
    let home = HomePosition::default();
    let (lat, lon, _) = crate::geo::to_global(&home, NedVector::new(5.0, 0.0, 0.0));
    let altitude = |b: &mut Bench, altitude_m: f32, frame: f32| {
        b.command_long(API, SCRIPT, 186, [altitude_m, frame, 0.0, 0.0, 0.0, 0.0, 0.0])
    };
    let orbit = |b: &mut Bench, altitude_m: f32| {
        b.command_long(
            API,
            SCRIPT,
            34,
            [3.0, 1.0, 0.0, 0.0, lat as f32, lon as f32, altitude_m],
        )
    };
    for (frame, height_m, below_m) in [
        (MavFrame::MAV_FRAME_GLOBAL_INT, 5.0, 483),
        (MavFrame::MAV_FRAME_GLOBAL, 5.0, 483),
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 8.0, 480),
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT, 8.0, 480),
    ] {
        let mut b = Bench::airborne();
        assert_eq!(b.reposition(frame, lat, lon, height_m, f32::NAN), DENIED, "{frame:?}");
        let told = format!("denied: {below_m} m below home");
        assert!(b.texts().iter().any(|text| text.starts_with(&told)), "{:?}", b.texts());
        b.sent.clear();
        assert_eq!(altitude(&mut b, height_m, f32::from(frame as u8)), DENIED);
        assert!(b.texts().iter().any(|text| text.starts_with(&told)), "{:?}", b.texts());
        b.run_ms(5_000);
        assert!((b.height_m() - 3.0).abs() < 0.3, "it stays where it is");
    }
    let mut b = Bench::airborne();
    assert_eq!(orbit(&mut b, 300.0), DENIED, "a circle below home");
    assert_eq!(
        b.reposition(MavFrame::MAV_FRAME_GLOBAL_INT, lat, lon, 493.0, f32::NAN),
        ACCEPTED
    );
    b.run_until(20, "5 m above home", |b| {
        (b.height_m() - 5.0).abs() < 0.3 && b.position_m()[0] > 4.5
    });
}

/// Whatever sends the vehicle down, it is on the ground slower than what breaks it, and ends as a landing does.
#[test]
fn what_leads_into_the_ground_ends_on_it_softly() {
    let place = |mask: u16, z: f32, vz: f32| {
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
            x: 6.0,
            z,
            vz,
            type_mask: PositionTargetTypemask::from_bits_retain(mask),
            target_system: 1,
            target_component: 1,
            coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
            ..Default::default()
        })
    };
    let global = MavMessage::SET_POSITION_TARGET_GLOBAL_INT(SET_POSITION_TARGET_GLOBAL_INT_DATA {
        lat_int: (HomePosition::default().latitude_deg * 1e7) as i32,
        lon_int: (HomePosition::default().longitude_deg * 1e7) as i32,
        alt: 5.0,
        type_mask: PositionTargetTypemask::from_bits_retain(0xDF8),
        target_system: 1,
        target_component: 1,
        coordinate_frame: MavFrame::MAV_FRAME_GLOBAL_INT,
        ..Default::default()
    });
    let acceleration = MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
        afz: 5.0,
        type_mask: PositionTargetTypemask::from_bits_retain(0xC3F),
        target_system: 1,
        target_component: 1,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..Default::default()
    });
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
        b.set_parameter("MPC_Z_VEL_MAX_DN", ParameterValue::Real32(4.0));
        b.set_parameter("MPC_LAND_SPEED", ParameterValue::Real32(1.5));
        b.set_parameter("COM_DISARM_LAND", ParameterValue::Real32(0.5));
        let mut fastest_m_s = 0.0_f32;
        for i in 0..600 {
            b.send(API, SCRIPT, &message);
            if i == 0 {
                assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
            }
            b.run_ms(50);
            if b.height_m() < 0.3 {
                fastest_m_s = fastest_m_s.max(b.view().estimate.velocity_ned_m_s.z);
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

/// How QGroundControl pauses: it stops where it can, not where it was told.
#[test]
fn a_go_to_without_a_place_stops_the_vehicle_where_it_is() {
    let home = HomePosition::default();
    let (lat, lon, _) = crate::geo::to_global(&home, NedVector::new(60.0, 0.0, 0.0));
    let mut b = Bench::airborne();
    let frame = MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT;
    assert_eq!(b.reposition(frame, lat, lon, 491.0, f32::NAN), ACCEPTED);
    b.run_until(10, "under way", |b| b.view().estimate.velocity_ned_m_s.x > 3.0);
    let told_at_m = b.position_m()[0];
    let nan = f32::NAN;
    assert_eq!(
        b.command_long(API, SCRIPT, 192, [-1.0, 1.0, 0.0, nan, nan, nan, nan]),
        ACCEPTED
    );
    let mut back_m_s = 0.0_f32;
    for _ in 0..600 {
        b.run_ms(10);
        back_m_s = back_m_s.max(-b.view().estimate.velocity_ned_m_s.x);
    }
    assert!(
        b.position_m()[0] > told_at_m + 1.0 && back_m_s < 0.25,
        "it does not fly back: {back_m_s}"
    );
    assert!(b.view().estimate.velocity_ned_m_s.norm() < 0.2);
    assert_eq!(b.status().mode, FlightMode::Hold);
}
