//! Whose setpoints are flown, and what follows when they stop.

use crate::testing::*;
use vigil_types::HeadingVector;

fn owner_in_telemetry(b: &Bench) -> f32 {
    let owner = b.last::<NAMED_VALUE_FLOAT_DATA>(GCS);
    assert_eq!(owner.name.to_str(), Ok("sp_owner"));
    owner.value
}

/// The velocity that is commanded.
fn flown(b: &Bench) -> HeadingVector {
    let ControlCommand::VelocityHeading(velocity_m_s, _) = b.command else {
        panic!("{:?}", b.command);
    };
    velocity_m_s
}

#[test]
fn offboard_needs_a_stream() {
    let mut b = Bench::airborne();
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), REJECTED);
    b.assert_said("offboard denied: no setpoints");
    assert_eq!(b.status().mode, FlightMode::Hold);
    // One that stopped long ago is none.
    b.send_velocity(API, SCRIPT, [0.0; 3]);
    b.run_ms(1_100);
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), REJECTED);
    b.send_velocity(API, SCRIPT, [0.0; 3]);
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
}

#[test]
fn a_ground_station_hands_the_vehicle_to_the_only_stream() {
    let mut b = Bench::airborne();
    b.stream(ONBOARD, COMPANION, [1.0, 0.0, 0.0]);
    b.run_ms(1_000);
    assert!(b.position_m()[0].abs() < 0.05, "a stream alone moves nothing");
    assert_eq!(b.set_mode(GCS, STATION, 6, 0), ACCEPTED);
    b.run_ms(2_000);
    assert_eq!(b.status().setpoint_owner, Some(COMPANION));
    assert_eq!(owner_in_telemetry(&b), 256.0 + 191.0);
    assert!(b.position_m()[0] > 1.0);
    assert_eq!(b.set_mode(GCS, STATION, 4, 3), ACCEPTED);
    b.run_ms(5);
    assert_eq!(b.status().setpoint_owner, None);
    assert_eq!(owner_in_telemetry(&b), 0.0);
}

#[test]
fn two_sources_never_mix() {
    let mut b = Bench::airborne();
    b.stream(ONBOARD, COMPANION, [1.0, 0.0, 0.0]);
    b.stream(API, SCRIPT, [-1.0, 0.0, 0.0]);
    b.run_ms(500);
    // Neither is the commander: nobody gets it, and a text names both.
    assert_eq!(b.set_mode(GCS, STATION, 6, 0), REJECTED);
    b.assert_said("1/191, 245/190");
    // The commander who streams gets it.
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
    for _ in 0..200 {
        b.run_ms(10);
        assert_eq!(flown(&b).x, -1.0);
    }
    let status = b.status();
    assert_eq!(status.setpoint_owner, Some(SCRIPT));
    assert!(status.refusals.setpoint_foreign >= 39, "{status:?}");
    let is_said = |text: &&String| text.contains("setpoints of 1/191 ignored");
    assert_eq!(b.texts().iter().filter(is_said).count(), 1, "said once");
    // The companion cannot take over what the script owns; after Hold it can.
    assert_eq!(b.set_mode(ONBOARD, COMPANION, 6, 0), REJECTED);
    assert_eq!(b.status().setpoint_owner, Some(SCRIPT));
    assert_eq!(b.set_mode(GCS, STATION, 4, 3), ACCEPTED);
    assert_eq!(b.set_mode(ONBOARD, COMPANION, 6, 0), ACCEPTED);
    assert_eq!(b.status().setpoint_owner, Some(COMPANION));
}

/// Who claims to be the owner, on another link or from another end of the owner's own.
#[test]
fn an_owners_identity_claimed_elsewhere_is_somebody_else() {
    for (link, peer) in [(API, 0), (GCS, 3), (ONBOARD, 7)] {
        let mut b = Bench::airborne();
        b.fly(ONBOARD, COMPANION, [1.0, 0.0, 0.0], 200);
        b.run_ms(200);
        let claim = |b: &mut Bench| {
            b.run_ms(10);
            b.peer = peer;
            b.send_velocity(link, COMPANION, [-5.0, 0.0, 0.0]);
            b.peer = 0;
        };
        let before = b.status().refusals;
        for _ in 0..200 {
            claim(&mut b);
            b.run_ms(1);
            assert_eq!(flown(&b).x, 1.0, "the owner's");
        }
        b.peer = peer;
        assert_eq!(b.set_mode(link, COMPANION, 6, 0), REJECTED, "nor does it take over");
        b.peer = 0;
        let after = b.status().refusals;
        assert_eq!(after.setpoint_foreign - before.setpoint_foreign, 200);
        assert_eq!(after.command_denied - before.command_denied, 1);
        let text = format!("setpoints of a second 1/191 on link {} ignored", link.0);
        assert_eq!(b.texts().iter().filter(|t| **t == text).count(), 1, "{:?}", b.texts());
        // A claimant does not keep a dead owner alive.
        b.stop_stream(COMPANION);
        (0..60).for_each(|_| claim(&mut b));
        assert_eq!(b.status().failsafe, Some(Failsafe::SetpointLost));
    }
}

#[test]
fn a_flood_of_made_up_claimants_neither_fills_the_links_with_texts_nor_keeps_the_companion_from_owning() {
    let mut b = Bench::airborne();
    b.stream(ONBOARD, COMPANION, [1.0, 0.0, 0.0]);
    b.run_ms(200);
    for step in 0..40 {
        for claimant in 0..20 {
            b.peer = 1000 + step * 20 + claimant;
            b.send_velocity(API, COMPANION, [-5.0, 0.0, 0.0]);
        }
        b.peer = 0;
        b.run_ms(50);
        if step == 10 {
            assert_eq!(b.set_mode(ONBOARD, COMPANION, 6, 0), ACCEPTED);
        }
    }
    assert_eq!(b.status().setpoint_owner, Some(COMPANION));
    let said = b.texts().iter().filter(|t| t.contains("ignored")).count();
    assert!((1..=2).contains(&said), "{said} texts in 1.5 s");
}

#[test]
fn a_lost_stream_means_hold_within_half_a_second_until_it_comes_again() {
    let mut b = Bench::airborne();
    b.fly(ONBOARD, COMPANION, [1.5, 0.0, 0.0], 1_000);
    // Somebody else's stream neither keeps a dead owner alive nor brings OFFBOARD back; its own does, as with PX4.
    b.stream(API, SCRIPT, [0.5, 0.0, 0.0]);
    b.run_ms(2_000);
    b.stop_stream(COMPANION);
    b.run_ms(380);
    assert_eq!(b.status().mode, FlightMode::Offboard, "a few lost packets are no loss");
    b.sent.clear();
    b.run_ms(80);
    let status = b.status();
    let lost = (FlightMode::Hold, Some(Failsafe::SetpointLost));
    assert_eq!((status.mode, status.failsafe), lost);
    b.assert_said("setpoint lost: hold");
    let heartbeat = b.last::<HEARTBEAT_DATA>(ONBOARD);
    assert_eq!(heartbeat.system_status, MavState::MAV_STATE_CRITICAL);
    assert_eq!(heartbeat.custom_mode, FlightMode::Hold.custom_mode());
    b.run_ms(3_000);
    assert!(b.velocity_m_s().norm() < 0.05);
    assert_eq!(b.status().mode, FlightMode::Hold);
    b.stream(ONBOARD, COMPANION, [0.5, 0.0, 0.0]);
    b.run_ms(100);
    let status = b.status();
    assert_eq!((status.mode, status.failsafe), (FlightMode::Offboard, None));
    assert_eq!(status.setpoint_owner, Some(COMPANION));
    assert_eq!(
        b.last::<HEARTBEAT_DATA>(ONBOARD).system_status,
        MavState::MAV_STATE_ACTIVE
    );
    // Not after a mode command.
    b.stop_stream(COMPANION);
    b.run_ms(500);
    assert_eq!(b.status().failsafe, Some(Failsafe::SetpointLost));
    assert_eq!(b.set_mode(API, SCRIPT, 4, 3), ACCEPTED);
    b.stream(ONBOARD, COMPANION, [0.5, 0.0, 0.0]);
    b.run_ms(1_000);
    assert_eq!(b.status().mode, FlightMode::Hold);
}

#[test]
fn offboard_on_the_ground_idles_until_the_setpoint_goes_up() {
    let mut b = Bench::new();
    b.fly(API, SCRIPT, [1.0, 0.0, 0.0], 500);
    b.arm();
    b.run_ms(500);
    assert_eq!(b.command, ControlCommand::Idle);
    b.stream(API, SCRIPT, [0.0, 0.0, -1.0]);
    b.run_ms(2_000);
    assert!(b.height_m() > 1.0);
}

#[test]
fn speeds_beyond_the_limits_are_limited_and_keep_their_direction() {
    let mut config = EndpointConfig::default();
    config.parameters.insert("MPC_XY_VEL_MAX".into(), 2.0);
    let mut b = Bench::with(config);
    b.take_off();
    b.fly(API, SCRIPT, [30.0, 40.0, -50.0], 100);
    b.run_ms(100);
    let v = flown(&b);
    let is_limited = (v.x - 1.2).abs() < 1e-5 && (v.y - 1.6).abs() < 1e-5 && v.z == -2.5;
    assert!(is_limited, "{v:?}");
}
