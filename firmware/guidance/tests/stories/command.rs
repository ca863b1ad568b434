//! Who has the vehicle: guidance, an operator, a person at the sticks, or its own failsafe.

use super::*;

#[test]
fn with_policy_auto_guidance_takes_the_vehicle_back_after_a_failsafe_hold() {
    let mut s = Story::guided(auto());
    // A step was missed, so the vehicle missed setpoints and holds by itself; it says so.
    s.timing.slips += 1;
    (s.mode, s.failsafe, s.vehicle.handover) = (VehicleMode::Hold, true, HandoverProgress::Idle);
    let hold = s.step();
    assert_eq!(
        hold.reasons,
        Reasons::of(Reason::ModeLost).with_if(true, Reason::VehicleFailsafe)
    );
    assert_eq!(
        (hold.setpoint, hold.request),
        (Some(VelocitySetpoint::HOLD), VehicleRequest::None)
    );
    assert_eq!(s.until(Engaging), 10);
    assert_eq!(
        s.last.unwrap().request,
        VehicleRequest::FlyExternal { takeoff_height_m: 3.0 }
    );
    s.hand_over();
    assert_eq!(s.until(Guided), 1);
}

#[test]
fn a_failsafe_hold_is_not_regained_while_frames_are_still_missing() {
    let mut s = Story::guided(auto());
    s.timing.slips += 1;
    (s.mode, s.failsafe, s.frame.age_ns) = (VehicleMode::Hold, true, Some(5_000_000_000));
    s.action = None;
    assert_eq!(s.run(seconds(20.0)).state, Hold);
    s.frame.age_ns = Some(STEP_NS);
    s.action = Some(Action::HOVER);
    assert_eq!(s.until(Engaging), 10);
}

/// A fence, a battery, sticks that were lost: the vehicle has its reasons, and no setpoint of ours was missing.
#[test]
fn a_failsafe_hold_that_lost_setpoints_are_not_the_reason_of_stays_until_an_operator_engages() {
    let mut s = Story::guided(auto());
    (s.mode, s.failsafe, s.vehicle.handover) = (VehicleMode::Hold, true, HandoverProgress::Idle);
    s.until(Standby);
    let out = s.run(seconds(60.0));
    assert_eq!((out.state, out.setpoint), (Ready, None));
    assert!(out.reasons.contains(Reason::VehicleFailsafe) && out.reasons.contains(Reason::PilotInCommand));
    assert_eq!(s.engages(), Engaging);
}

#[test]
fn a_person_who_changes_the_mode_keeps_the_vehicle() {
    for mode in [
        VehicleMode::Hold,
        VehicleMode::Land,
        VehicleMode::Return,
        VehicleMode::Mission,
        VehicleMode::Other,
    ] {
        let mut s = Story::guided(auto());
        (s.mode, s.vehicle.handover) = (mode, HandoverProgress::Idle);
        // Zeros before silence.
        assert_holds(s.step(), Reason::ModeLost);
        assert_eq!(s.until(Standby), 10);
        let out = s.run(seconds(20.0));
        assert_eq!(
            (out.state, out.setpoint, out.reasons),
            (Ready, None, Reasons::of(Reason::PilotInCommand))
        );
        assert_eq!(s.engages(), Engaging);
    }
}

#[test]
fn with_policy_command_even_a_failsafe_hold_waits_for_an_operator() {
    let mut s = Story::guided(GuidanceConfig::default());
    (s.mode, s.failsafe) = (VehicleMode::Hold, true);
    s.step();
    assert_eq!(
        s.ask(OperatorRequest::Engage),
        RequestOutcome::TemporarilyRejected,
        "guidance still lets go"
    );
    s.until(Ready);
    assert_eq!(s.run(seconds(20.0)).state, Ready);
    assert_eq!(s.engages(), Engaging);
}

#[test]
fn a_mode_that_comes_back_by_itself_is_flown_again() {
    let mut s = Story::guided(GuidanceConfig::default());
    s.mode = VehicleMode::Hold;
    s.run(5);
    s.mode = VehicleMode::External;
    assert_eq!(s.until(Guided), 10);
}

#[test]
fn disarming_ends_the_flight_and_nothing_arms_again_by_itself() {
    let mut s = Story::guided(auto());
    (s.armed, s.mode, s.vehicle.handover) = (false, VehicleMode::Hold, HandoverProgress::Idle);
    let out = s.step();
    assert_eq!((out.state, out.setpoint), (Standby, None));
    assert!(out.reasons.contains(Reason::Disarmed));
    assert_eq!(s.ends(seconds(60.0)), (Ready, Reasons::of(Reason::PilotInCommand)));
}

#[test]
fn a_simulator_that_is_killed_and_started_again_is_flown_again() {
    let mut s = Story::guided(auto());
    for n in 1..=40u64 {
        s.frame.age_ns = Some(n * STEP_NS);
        s.telemetry_age_ns = n * STEP_NS;
        s.heartbeat_age_ns = Some(n * STEP_NS);
        if n > 5 {
            s.action = None;
        }
        let out = s.step();
        assert_eq!(out.state, if n > 5 { Hold } else { Guided }, "0.25 s without a frame");
        assert_eq!(out.setpoint == Some(VelocitySetpoint::HOLD), n > 5);
    }
    assert!(s.last.unwrap().reasons.contains(Reason::LinkLost));

    begin_again(&mut s);
    // Its heartbeat says disarmed one step before its clock is seen to have started anew.
    assert_eq!(s.step().state, Standby);
    s.vehicle.restarts += 1;
    s.step();
    s.until(Engaging);
    s.hand_over();
    s.until(Guided);
}

#[test]
fn at_the_goal_it_lands_when_configured_and_is_silent_once_the_vehicle_lands_by_itself() {
    let mut s = Story::guided(GuidanceConfig {
        at_goal: AtGoal::Land,
        ..auto()
    });
    s.position_ned_m = NedVector::new(20.3, 4.8, -3.0);
    assert_eq!(s.step().state, Hold);
    assert_eq!(s.until(Land), 40, "hovers for two seconds first");
    let land = s.last.unwrap();
    assert_eq!(
        (land.request, land.setpoint),
        (VehicleRequest::Land, Some(VelocitySetpoint::HOLD))
    );
    s.mode = VehicleMode::Land;
    assert_silent(s.step(), Land);
    s.run(seconds(8.0));
    s.armed = false;
    assert_eq!(s.step().state, Standby);
    assert_eq!(
        s.run(seconds(60.0)).state,
        Ready,
        "one flight; the next needs an operator"
    );
}

#[test]
fn an_operator_lands_it_goes_around_and_lands_again() {
    let mut s = Story::guided(GuidanceConfig::default());
    assert_eq!(s.ask(OperatorRequest::Land), RequestOutcome::Accepted);
    assert_eq!(s.ends(1), (Land, Reasons::of(Reason::Operator)));
    assert_eq!(s.ask(OperatorRequest::Disengage), RequestOutcome::TemporarilyRejected);
    // Who asks to go around may think better of it.
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    assert_eq!(s.ask(OperatorRequest::Disengage), RequestOutcome::Accepted);
    assert_eq!(s.ends(1).0, Land);
    s.mode = VehicleMode::Land;
    s.run(5);
    s.vehicle.handover = HandoverProgress::Idle;
    assert_eq!(s.engages(), Engaging);
    s.hand_over();
    s.until(Guided);
    assert_eq!(s.ask(OperatorRequest::Land), RequestOutcome::Accepted);
    assert_eq!(s.until(Land), 1);
    s.mode = VehicleMode::Land;
    s.run(3);
    s.mode = VehicleMode::Other;
    assert_eq!(s.until(Standby), 1, "a pilot took the landing over");
}

#[test]
fn low_battery_and_the_time_limit_land_the_vehicle_and_an_engage_does_not_lift_that() {
    let limit = GuidanceConfig {
        time_limit_ns: Some(10_000_000_000),
        ..Default::default()
    };
    let mut s = Story::guided(limit);
    assert_eq!(s.run(seconds(10.0)).state, Guided);
    assert_eq!(s.ends(1), (Land, Reasons::of(Reason::TimeLimit)));
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::TemporarilyRejected);

    let mut s = Story::guided(GuidanceConfig::default());
    s.frame.refused = true;
    s.battery = Some(0.1);
    let out = s.step();
    assert_eq!(out.state, Land, "landing comes before hold");
    assert!(out.reasons.contains(Reason::LowBattery) && out.reasons.contains(Reason::BadFrame));
    s.battery = Some(0.2);
    assert_eq!(s.run(20).state, Land, "a landing that began goes on");
}

#[test]
fn a_failed_hand_over_is_tried_again_by_policy_auto_after_a_pause_and_never_by_policy_command() {
    for (config, tries) in [(auto(), true), (GuidanceConfig::default(), false)] {
        let mut s = Story::begin(config);
        s.until(Ready);
        assert_eq!(s.engages(), Engaging);
        s.vehicle.handover = HandoverProgress::Failed;
        let out = s.step();
        assert_eq!((out.state, out.request), (Standby, VehicleRequest::None));
        assert!(out.reasons.contains(Reason::HandoverFailed));
        s.vehicle.handover = HandoverProgress::Idle;
        assert_eq!(s.run(seconds(4.0)).state, Ready);
        assert_eq!(s.run(seconds(2.0)).state, if tries { Engaging } else { Ready });
        if !tries {
            assert_eq!(s.engages(), Engaging);
        }
    }
}

#[test]
fn a_hand_over_that_never_ends_fails_after_a_minute_and_a_second_a_metre() {
    for height_m in [3.0, 100.0] {
        let mut s = Story::begin(auto());
        assert_eq!(s.ask(goal(20.0, 5.0, Some(height_m))), RequestOutcome::Accepted);
        s.until(Engaging);
        (s.armed, s.mode) = (true, VehicleMode::Takeoff);
        s.vehicle.handover = HandoverProgress::InProgress { stream_setpoints: true };
        assert_eq!(s.run(seconds(60.0 + f64::from(height_m)) - 1).state, Engaging);
        assert!(s.until(Standby) <= 2, "{height_m} m");
    }
}

#[test]
fn an_operator_who_disengages_during_the_hand_over_gets_a_hovering_vehicle() {
    let mut s = Story::begin(auto());
    s.until(Engaging);
    s.vehicle.handover = HandoverProgress::InProgress { stream_setpoints: true };
    (s.armed, s.mode) = (true, VehicleMode::Takeoff);
    s.run(10);
    assert_eq!(s.ask(OperatorRequest::Disengage), RequestOutcome::Accepted);
    let out = s.step();
    assert_eq!(
        (out.state, out.setpoint, out.request),
        (Hold, Some(VelocitySetpoint::HOLD), VehicleRequest::None)
    );
    s.until(Standby);
    assert_eq!(
        s.run(seconds(30.0)).state,
        Ready,
        "the policy auto does not overrule a person"
    );
}

/// All but guidance, and what goes on counting, is as at the beginning.
fn begin_again(s: &mut Story) {
    let mut fresh = Story::begin(auto());
    (fresh.guidance, fresh.now_ns, fresh.timing) = (s.guidance, s.now_ns, s.timing);
    fresh.vehicle.restarts = s.vehicle.restarts;
    *s = fresh;
}

/// The autopilot starts anew, on the ground.
fn reboot(s: &mut Story) {
    s.heartbeat_age_ns = Some(3_000_000_000);
    s.telemetry_age_ns = 3_000_000_000;
    s.run(seconds(2.0));
    begin_again(s);
    s.vehicle.restarts += 1;
}

/// Somebody puts the vehicle into this mode, and guidance lets go of it.
fn leaves(s: &mut Story, mode: VehicleMode) {
    (s.mode, s.vehicle.handover) = (mode, HandoverProgress::Idle);
    s.until(Standby);
}

#[test]
fn a_vehicle_that_a_person_took_is_not_taken_again_after_the_autopilot_restarted_until_an_operator_engages() {
    type Takes = fn(&mut Story);
    let stories: [(Takes, &str); 5] = [
        (|s| leaves(s, VehicleMode::Land), "landed by a ground station"),
        (|s| leaves(s, VehicleMode::Other), "flown by sticks"),
        (
            |s| {
                s.armed = false;
                s.until(Standby);
            },
            "disarmed",
        ),
        (
            |s| {
                assert_eq!(s.ask(OperatorRequest::Land), RequestOutcome::Accepted);
                s.until(Land);
                s.mode = VehicleMode::Land;
                s.run(20);
                s.armed = false;
                s.until(Standby);
            },
            "landed by an operator",
        ),
        (
            |s| {
                assert_eq!(s.ask(OperatorRequest::Disengage), RequestOutcome::Accepted);
                s.run(20);
            },
            "disengaged by an operator",
        ),
    ];
    for (takes, how) in stories {
        let mut s = Story::guided(auto());
        s.run(20);
        takes(&mut s);
        for _ in 0..2 {
            reboot(&mut s);
            let later = s.run(seconds(60.0));
            assert_eq!((later.state, later.request), (Ready, VehicleRequest::None), "{how}");
            assert_eq!(later.reasons, Reasons::of(Reason::PilotInCommand), "{how}");
            assert!(s.guidance.taken_over(), "{how}: to be kept over restarts");
        }
        assert_eq!((s.engages(), s.guidance.taken_over()), (Engaging, false), "{how}");
        s.hand_over();
        s.until(Guided);
    }
}

#[test]
fn a_flight_that_ended_on_the_ground_is_not_repeated_because_the_autopilot_restarts() {
    let mut s = Story::guided(GuidanceConfig {
        at_goal: AtGoal::Land,
        ..auto()
    });
    s.position_ned_m = NedVector::new(20.0, 5.0, -3.0);
    s.until(Land);
    s.mode = VehicleMode::Land;
    s.run(20);
    s.armed = false;
    s.until(Standby);
    // An ArduPilot stays in its landing mode.
    assert_eq!(s.ends(seconds(60.0)), (Ready, Reasons::NONE));
    reboot(&mut s);
    assert_eq!(s.ends(seconds(60.0)), (Ready, Reasons::NONE));
    assert!(!s.guidance.taken_over(), "nobody took it");
}

#[test]
fn a_vehicle_that_was_landed_while_the_link_was_lost_is_not_taken_when_it_is_heard_again() {
    let mut s = Story::guided(auto());
    s.heartbeat_age_ns = Some(20_000_000_000);
    s.telemetry_age_ns = 20_000_000_000;
    s.action = None;
    assert_eq!(s.run(seconds(20.0)).state, Hold);
    let fresh = Story::begin(auto());
    (s.armed, s.mode, s.vehicle.handover) = (false, VehicleMode::Hold, HandoverProgress::Idle);
    (s.telemetry_age_ns, s.heartbeat_age_ns, s.action) = (fresh.telemetry_age_ns, fresh.heartbeat_age_ns, fresh.action);
    // Its clock goes on: it is not a restart that disarmed it.
    assert_eq!(s.run(seconds(5.0)).reasons, Reasons::of(Reason::PilotInCommand));
    s.vehicle.restarts += 1;
    assert_eq!(s.run(seconds(30.0)).state, Ready);
}

#[test]
fn a_take_over_of_an_earlier_run_is_kept_until_an_operator_engages() {
    let mut s = Story::begin(GuidanceConfig {
        taken_over: true,
        ..auto()
    });
    assert_eq!(s.ends(seconds(60.0)), (Ready, Reasons::of(Reason::PilotInCommand)));
    assert_eq!(s.engages(), Engaging);
    assert!(!s.guidance.taken_over());
}

/// `docs/guidance.md`, "Where auto engages": a firmware that just started judges by what it sees.
#[test]
fn auto_engages_only_from_where_it_is_allowed_to() {
    use VehicleMode::{External, Hold as Own, Land as Landing, Mission, Other, Return, Takeoff};
    let height_m = |landed| if landed == Landed::InAir { -3.0 } else { 0.0 };
    let minutes = 600_000_000_000;
    for (armed, landed, mode, failsafe, up_ns, takes) in [
        (false, Landed::OnGround, Own, false, minutes, true),
        (false, Landed::OnGround, External, false, minutes, true),
        (false, Landed::OnGround, Other, false, minutes, false),
        (false, Landed::OnGround, Landing, false, minutes, false),
        (false, Landed::OnGround, Return, false, minutes, false),
        (false, Landed::OnGround, Mission, false, minutes, false),
        (true, Landed::OnGround, Own, false, minutes, false),
        (true, Landed::InAir, External, false, minutes, true),
        (true, Landed::InAir, Own, true, minutes, true),
        (true, Landed::InAir, Own, false, minutes, false),
        (true, Landed::InAir, Own, false, 5_000_000_000, true),
        (true, Landed::OnGround, Own, false, 5_000_000_000, false),
        (true, Landed::InAir, Other, false, 5_000_000_000, false),
        (true, Landed::InAir, Other, true, minutes, false),
        (true, Landed::InAir, Takeoff, false, minutes, false),
        (true, Landed::InAir, Return, true, minutes, false),
        (true, Landed::InAir, Mission, false, minutes, false),
        (true, Landed::InAir, Landing, false, minutes, false),
    ] {
        let mut s = Story::begin(auto());
        (s.armed, s.landed, s.mode, s.failsafe) = (armed, landed, mode, failsafe);
        (s.vehicle.up_ns, s.position_ned_m.z) = (Some(up_ns), height_m(landed));
        let out = s.run(seconds(20.0));
        let says_so = out.reasons.contains(Reason::PilotInCommand);
        let story = format!("armed {armed}, {landed:?}, {mode:?}, failsafe {failsafe}, up {up_ns}");
        assert_eq!(
            (out.state, says_so),
            if takes { (Engaging, false) } else { (Ready, true) },
            "{story}"
        );
        if !takes {
            assert_eq!(s.engages(), Engaging, "an operator may: {story}");
            assert!(!s.last.unwrap().reasons.contains(Reason::PilotInCommand), "{story}");
        }
    }
}

#[test]
fn auto_gives_a_vehicle_on_the_ground_time_to_report_its_home() {
    for (comes, steps) in [(true, seconds(1.0)), (false, seconds(2.5))] {
        let mut s = Story::begin(auto());
        s.until(Ready);
        assert_eq!(s.run(seconds(1.0) - 1).state, Ready);
        s.vehicle.home_ned_m = comes.then_some(NedVector::new(0.0, 0.0, 22.5));
        assert_eq!(seconds(1.0) - 1 + s.until(Engaging), steps, "{comes}");
    }
}

#[test]
fn auto_engages_when_the_pilot_gives_the_vehicle_by_its_mode() {
    let mut s = Story::begin(auto());
    (s.armed, s.mode, s.position_ned_m.z) = (true, VehicleMode::Other, -3.0);
    assert_eq!(s.run(seconds(20.0)).state, Ready);
    s.mode = VehicleMode::External;
    assert_eq!(s.step().state, Engaging);
}

#[test]
fn a_glitch_on_the_ground_does_not_renew_the_wish_to_fly_that_a_person_ended() {
    let mut s = Story::guided(auto());
    assert_eq!(s.ask(OperatorRequest::Disengage), RequestOutcome::Accepted);
    s.run(5);
    (s.mode, s.vehicle.handover) = (VehicleMode::Land, HandoverProgress::Idle);
    s.until(Ready);
    s.frame.refused = true;
    assert_eq!(s.run(3).state, Standby);
    s.frame.refused = false;
    assert_eq!(s.run(seconds(60.0)).state, Ready);
}

#[test]
fn a_disengaged_vehicle_hovers_until_it_is_engaged_again() {
    let mut s = Story::guided(auto());
    assert_eq!(s.ask(OperatorRequest::Disengage), RequestOutcome::Accepted);
    assert_eq!(s.run(seconds(60.0)).state, Hold);
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    assert_eq!(s.until(Guided), 10);
}

#[test]
fn an_engage_that_was_accepted_is_not_kept_when_an_input_fails_before_it_takes_effect() {
    let mut s = Story::begin(GuidanceConfig::default());
    s.until(Ready);
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    s.frame.refused = true;
    assert_eq!(s.step().state, Standby);
    s.frame.refused = false;
    assert_eq!(s.run(seconds(60.0)).state, Ready);
}

#[test]
fn who_disarms_or_takes_a_vehicle_while_it_is_being_taken_keeps_it() {
    use VehicleMode::{External, Hold as Own, Land as Landing, Mission, Other, Return, Takeoff};
    for (before, disarms, after, keeps) in [
        (Takeoff, false, Other, true),
        (Takeoff, false, Return, true),
        (External, false, Own, true),
        (External, false, Landing, true),
        (Takeoff, true, Takeoff, true),
        // The way of every hand-over.
        (Other, false, Takeoff, false),
        (Mission, false, Takeoff, false),
        (Takeoff, false, Own, false),
        (Own, false, External, false),
    ] {
        let mut s = Story::begin(auto());
        s.until(Engaging);
        (s.armed, s.mode) = (true, before);
        s.step();
        (s.armed, s.mode) = (!disarms, after);
        let out = s.run(seconds(5.0));
        let story = format!("{before:?} to {after:?}, disarmed {disarms}");
        assert_eq!(out.reasons.contains(Reason::PilotInCommand), keeps, "{story}");
        assert_eq!(out.state == Engaging, !keeps, "{story}");
    }
}

#[test]
fn a_vehicle_that_is_given_back_was_not_taken_over() {
    for gives_back in [false, true] {
        let mut s = Story::guided(GuidanceConfig::default());
        if gives_back {
            s.guidance.hands_back();
        }
        s.mode = VehicleMode::Mission;
        s.until(Ready);
        assert_eq!(s.guidance.taken_over(), !gives_back);
    }
}
