//! Whole flights against scripted vehicles of both flavours.

mod common;

use common::Flight;
use common::peer::{HOME_ALTITUDE_M, Mode, Peer, longest_gap_ns};
use vigil_guidance::{AtGoal, EngagePolicy, GuidanceConfig};
use vigil_mavlink::Flavour::{ArduPilot, Px4};
use vigil_mavlink::common::{MavLandedState, MavResult};
use vigil_mavlink::message;
use vigil_types::GuidanceState::{Engaging, Guided, Hold, Land, Ready, Standby};
use vigil_types::{Reason, Reasons, STEP_NS};

const SECOND: u64 = 1_000_000_000;

fn is_zero(v: &[f32; 4]) -> bool {
    v.iter().all(|x| *x == 0.0)
}

#[test]
fn a_px4_on_the_ground_is_armed_taken_off_and_flown_to_the_goal() {
    let mut f = Flight::new(Px4, Peer::on_the_ground(Px4));
    f.until(Guided);
    assert_eq!(f.peer.flight_commands(), [400, 22, 176]);
    let of = |number| f.peer.got(number)[0];
    assert_eq!(of(400).params[..2], [1.0, 0.0]);
    assert_eq!(of(22).params[6], HOME_ALTITUDE_M + 3.0, "above sea level");
    assert!(of(22).params[4].is_nan());
    assert_eq!(of(176).params[..3], [129.0, 6.0, 0.0]);
    let first_ns = f.peer.setpoints[0].0;
    assert!(
        of(176).at_ns - first_ns >= SECOND,
        "a second of setpoints before OFFBOARD"
    );
    assert!(
        f.peer.setpoints[..f.peer.setpoints.len() - 1]
            .iter()
            .all(|(_, v)| is_zero(v)),
        "zeros until guided"
    );
    assert!(f.peer.height_m > 2.6);

    f.until(Hold);
    assert!(f.last.unwrap().reasons.contains(Reason::GoalReached));
    assert!((f.peer.north_m - 11.0).abs() < 0.3, "{}", f.peer.north_m);
    assert!((f.peer.height_m - 3.0).abs() < 0.15, "{}", f.peer.height_m);
    assert_eq!(longest_gap_ns(&f.peer.setpoints, first_ns), STEP_NS);
    f.run(100);
    assert_eq!((f.peer.mode, f.peer.failsafe), (Mode::External, false));
}

#[test]
fn an_ardupilot_on_the_ground_is_flown_lands_at_the_goal_and_gets_zeros_before_silence() {
    let config = GuidanceConfig {
        engage: EngagePolicy::Auto,
        at_goal: AtGoal::Land,
        ..Default::default()
    };
    let mut f = Flight::of(Some(ArduPilot), Peer::on_the_ground(ArduPilot), config);
    f.engage_and_fly();
    assert_eq!(f.peer.flight_commands(), [176, 400, 22]);
    let of = |number| f.peer.got(number)[0];
    assert_eq!(of(176).params, [1.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(of(22).params[6], 3.0, "above home");
    assert!(!f.peer.disturbed_takeoff, "a setpoint would have ended the take-off");
    assert_eq!(f.peer.setpoints.len(), 1, "no setpoint before guided");
    let wanted: Vec<f32> = f.peer.got(511).iter().map(|c| c.params[0]).collect();
    assert_eq!(
        wanted,
        [32.0, 30.0, 245.0, 1.0, 242.0],
        "an ArduPilot sends what is asked for"
    );

    f.until(Land);
    f.until(Standby);
    assert!(!f.peer.armed && f.peer.height_m <= 0.0);
    let after_land: Vec<_> = f.peer.setpoints.iter().rev().take(20).collect();
    assert!(
        after_land.iter().all(|(_, v)| is_zero(v)),
        "at least a second of zeros at the end"
    );
    assert_eq!(f.run(1200).state, Ready, "it does not take off again");
    f.assert_said("the flight is over: engage guidance for another");
    assert_eq!(said(&f, "a person has the vehicle").len(), 1, "before its flight");
}

#[test]
fn a_vehicle_in_the_air_only_gets_the_change_of_mode() {
    for flavour in [Px4, ArduPilot] {
        let mut f = Flight::new(flavour, Peer::in_the_air(flavour));
        f.engage_and_fly();
        assert_eq!(f.peer.flight_commands(), [176], "{}", flavour.name());
    }
}

#[test]
fn a_vehicle_that_already_obeys_is_not_commanded_at_all() {
    let peer = Peer {
        mode: Mode::External,
        ..Peer::in_the_air(ArduPilot)
    };
    let mut f = Flight::new(ArduPilot, peer);
    f.until(Guided);
    assert!(f.peer.flight_commands().is_empty());
}

#[test]
fn a_vehicle_that_does_not_tell_whether_it_landed_is_judged_by_its_height() {
    for flavour in [Px4, ArduPilot] {
        let silent = |peer| {
            let mut f = Flight::new(flavour, peer);
            f.peer.tells_landed = false;
            f.engage_and_fly();
            f
        };
        let f = silent(Peer::on_the_ground(flavour));
        assert!(f.peer.flight_commands().contains(&22) && !f.peer.disturbed_takeoff);
        let f = silent(Peer::in_the_air(flavour));
        assert_eq!(f.peer.flight_commands(), [176]);
    }
}

#[test]
fn a_command_that_is_refused_not_answered_or_without_effect_fails_the_hand_over_with_its_result() {
    use MavResult::*;
    for (flavour, command, answer, why, attempts) in [
        (Px4, 400, Some(MAV_RESULT_DENIED), "arming refused: DENIED", 1),
        (ArduPilot, 22, Some(MAV_RESULT_FAILED), "take-off refused: FAILED", 1),
        // For now is asked again, and so is silence.
        (
            ArduPilot,
            176,
            Some(MAV_RESULT_TEMPORARILY_REJECTED),
            "change of mode refused: TEMPORARILY_REJECTED",
            4,
        ),
        (Px4, 400, None, "arming not answered", 4),
        (
            Px4,
            400,
            Some(MAV_RESULT_ACCEPTED),
            "arming accepted, but without effect",
            4,
        ),
    ] {
        let mut f = Flight::on_command(flavour, Peer::on_the_ground(flavour));
        f.peer.answer(command, answer, 9);
        f.engage();
        f.until(Engaging);
        f.until(Standby);
        let texts = said(&f, "hand-over:");
        assert_eq!(texts.first(), Some(&format!("hand-over: {why}")));
        let got = f.peer.got(command);
        assert_eq!(got.len(), attempts, "{why}");
        assert!(command != 400 || !f.peer.armed);
        if answer.is_none() {
            assert!((0..).zip(&got).all(|(number, c)| c.confirmation == number));
            assert!(got.windows(2).all(|w| w[1].at_ns - w[0].at_ns == SECOND / 2));
        }
    }
}

#[test]
fn a_px4_that_accepts_the_take_off_and_stays_on_the_ground_is_not_put_into_offboard() {
    let high = Peer {
        height_m: 6.0,
        tells_landed: false,
        ..Peer::on_the_ground(Px4)
    };
    let mut f = Flight::on_command(Px4, high);
    f.peer.answer(22, Some(MavResult::MAV_RESULT_ACCEPTED), 9);
    f.engage();
    let landed_state = MavLandedState::MAV_LANDED_STATE_ON_GROUND;
    f.hear((1, 1), &message!(EXTENDED_SYS_STATE, landed_state));
    f.run(40);
    f.peer.mode = Mode::Takeoff;
    f.until(Standby);
    assert_eq!((f.peer.flight_commands(), f.peer.got(22).len()), (vec![400, 22], 4));
    f.assert_said("hand-over: take-off accepted, but without effect");
}

#[test]
fn lost_and_delayed_answers_do_not_stop_the_hand_over() {
    for answer in [None, Some(MavResult::MAV_RESULT_TEMPORARILY_REJECTED)] {
        for flavour in [Px4, ArduPilot] {
            let mut f = Flight::new(flavour, Peer::on_the_ground(flavour));
            for command in [400, 22, 176] {
                f.peer.answer(command, answer, 2);
            }
            f.engage_and_fly();
        }
    }
}

#[test]
fn in_progress_extends_the_patience() {
    let mut f = Flight::new(Px4, Peer::on_the_ground(Px4));
    f.peer.answer(400, Some(MavResult::MAV_RESULT_IN_PROGRESS), 1);
    f.until(Engaging);
    f.run(150);
    assert_eq!(f.peer.got(400).len(), 1, "waits longer than four attempts last");
    f.until(Guided);
}

#[test]
fn a_failsafe_hold_of_the_vehicle_is_regained_with_the_mode_alone() {
    let mut f = Flight::new(Px4, Peer::on_the_ground(Px4));
    f.until(Guided);
    f.run(20);
    f.peer.commands.clear();
    // The line was dead for a while, both ways: the vehicle holds by itself.
    f.hears = false;
    f.until(Hold);
    (f.peer.mode, f.peer.failsafe, f.hears) = (Mode::Loiter, true, true);
    // Its mode is sent once a second.
    f.run(30);
    f.until(Guided);
    assert_eq!(f.peer.flight_commands(), [176]);
    assert!(!f.peer.failsafe);
}

#[test]
fn a_pilot_who_takes_the_sticks_is_left_alone() {
    for flavour in [Px4, ArduPilot] {
        let mut f = Flight::new(flavour, Peer::on_the_ground(flavour));
        f.engage_and_fly();
        f.run(20);
        f.peer.commands.clear();
        f.peer.mode = Mode::Manual;
        f.until(Standby);
        f.run(600);
        assert!(f.peer.flight_commands().is_empty() && f.peer.mode == Mode::Manual);
    }
}

#[test]
fn a_vehicle_that_restarts_is_handed_over_anew_unless_it_comes_back_in_a_pilots_mode() {
    for flavour in [Px4, ArduPilot] {
        let mut f = Flight::new(flavour, Peer::on_the_ground(flavour));
        f.engage_and_fly();
        f.run(40);
        f.hears = false;
        f.run(30);
        assert_eq!(f.last.unwrap().state, Hold);
        let now_ns = f.now_ns;
        f.peer.reboot(now_ns);
        f.peer.commands.clear();
        f.hears = true;
        f.until(Standby);
        if flavour == ArduPilot {
            // It starts in STABILIZE.
            assert_eq!(f.ends(400), (Ready, Reasons::of(Reason::PilotInCommand)));
            assert!(f.peer.flight_commands().is_empty());
            f.peer.mode = Mode::External;
        }
        f.until(Guided);
        f.assert_said("the vehicle's autopilot restarted");
        assert!(f.peer.flight_commands().contains(&22), "{}", flavour.name());
    }
}

#[test]
fn a_refused_landing_is_asked_for_again() {
    let mut f = Flight::new(Px4, Peer::in_the_air(Px4));
    f.peer.answer(21, Some(MavResult::MAV_RESULT_DENIED), 3);
    f.engage_and_fly();
    f.guidance.request(vigil_types::OperatorRequest::Land);
    f.until(Land);
    f.until(Standby);
    assert!(!f.peer.armed);
    assert_eq!(said(&f, "hand-over: landing refused: DENIED").len(), 3);
    let lands: Vec<u64> = f.peer.got(21).iter().map(|c| c.at_ns).collect();
    assert!(lands.windows(2).all(|w| w[1] - w[0] >= 2 * SECOND), "{lands:?}");
}

fn said(f: &Flight, begin: &str) -> Vec<String> {
    f.texts.iter().filter(|text| text.starts_with(begin)).cloned().collect()
}

/// A flight of such a vehicle, five seconds after it was handed over.
fn flown(peer: Peer) -> Flight {
    let mut f = Flight::new(peer.flavour, peer);
    f.engage_and_fly();
    f.run(100);
    f
}

#[test]
fn a_vehicle_that_would_fly_on_for_seconds_is_ordered_not_to_and_stops_when_the_firmware_dies() {
    for (flavour, name, before) in [(ArduPilot, "GUID_TIMEOUT", "3"), (Px4, "COM_OF_LOSS_T", "1")] {
        let mut f = flown(Peer::on_the_ground(flavour));
        assert_eq!(said(&f, name), [format!("{name} was {before} s, set to 0.5 s")]);
        assert_eq!((f.peer.setpoint_timeout_s, f.peer.parameters_set.len()), (0.5, 1));
        assert_eq!(f.peer.parameters_read, 1);
        // Killed: nothing comes from now on.
        let killed_m = f.peer.north_m;
        for _ in 0..100 {
            f.now_ns += STEP_NS;
            f.peer.step(f.now_ns);
        }
        let blind_m = f.peer.north_m - killed_m;
        assert!(
            (0.3..=0.56).contains(&blind_m),
            "{} flew on for {blind_m} m",
            flavour.name()
        );
    }
}

#[test]
fn a_short_setpoint_timeout_is_left_as_it_is() {
    let f = flown(Peer {
        setpoint_timeout_s: 0.4,
        ..Peer::in_the_air(Px4)
    });
    assert_eq!(said(&f, "COM_OF_LOSS_T"), ["COM_OF_LOSS_T is 0.4 s"]);
    assert!(f.peer.parameters_set.is_empty());
}

#[test]
fn a_vehicle_with_a_timeout_for_the_guidance_computer_alone_keeps_the_one_for_everybody() {
    for (own_s, text) in [
        (0.4, "VGL_OF_LOSS_T is 0.4 s"),
        (2.0, "VGL_OF_LOSS_T was 2 s, set to 0.5 s"),
    ] {
        let f = flown(Peer {
            own_timeout_s: Some(own_s),
            ..Peer::in_the_air(Px4)
        });
        assert_eq!(said(&f, "VGL_OF_LOSS_T"), [text]);
        assert_eq!(f.peer.own_timeout_s, Some(own_s.min(0.5)));
        assert_eq!(
            (f.peer.setpoint_timeout_s, f.peer.parameters_read),
            (1.0, 0),
            "not even asked for"
        );
    }
}

#[test]
fn a_vehicle_that_does_not_tell_or_not_set_its_timeout_is_flown_and_people_read_it() {
    for flavour in [ArduPilot, Px4] {
        let f = flown(Peer {
            reports_parameters: false,
            ..Peer::in_the_air(flavour)
        });
        assert_eq!(f.peer.parameters_read, 4, "asked a few times, and not for ever");
        f.assert_said("is not reported by the vehicle");

        let f = flown(Peer {
            sets_parameters: false,
            ..Peer::in_the_air(flavour)
        });
        assert_eq!(f.peer.parameters_set, [0.5; 4]);
        f.assert_said("s, wanted 0.5 s");
        assert_eq!(f.last.unwrap().state, Guided);
    }
}

#[test]
fn a_companion_ordered_to_leave_the_timeout_alone_neither_asks_nor_sets() {
    let mut f = Flight::new(ArduPilot, Peer::in_the_air(ArduPilot));
    f.companion = vigil_mavlink::Companion::new(vigil_mavlink::CompanionConfig {
        flavour: Some(ArduPilot),
        setpoint_timeout_s: None,
        ..Default::default()
    });
    f.engage_and_fly();
    f.run(100);
    assert_eq!((f.peer.parameters_read, f.peer.parameters_set.len()), (0, 0));
}

#[test]
fn a_copter_whose_home_lies_below_the_local_origin_climbs_to_the_goals_height_and_is_flown() {
    let peer = Peer {
        height_m: -10.0,
        tells_landed: true,
        home_ned_m: [0.0, 0.0, 10.0],
        ..Peer::on_the_ground(ArduPilot)
    };
    let mut f = Flight::on_command(ArduPilot, peer);
    f.run(160);
    f.engage();
    f.until(Guided);
    assert!((f.peer.height_m + 7.0).abs() < 0.4, "{}", f.peer.height_m);
}
