//! Stories of flights, each told step by step.

mod common;

use common::{GOAL, Story};
use vigil_guidance::{
    AlarmConfig, AlarmPolicy, AtGoal, EngagePolicy, FenceShape, Geofence, GuidanceConfig, OnNoProgress,
};
use vigil_types::GuidanceState::{Engaging, Guided, Hold, Land, Ready, Standby};
use vigil_types::{
    Action, AlarmCause, AlarmResponse, HandoverProgress, Landed, NedVector, OperatorRequest, Reason, Reasons,
    RequestOutcome, STEP_NS, VehicleMode, VehicleRequest, VelocitySetpoint, Verdict,
};

fn auto() -> GuidanceConfig {
    GuidanceConfig {
        engage: EngagePolicy::Auto,
        ..Default::default()
    }
}

fn seconds(s: f64) -> usize {
    (s / 0.05).round() as usize
}

#[test]
fn an_operator_engages_and_the_vehicle_flies_to_the_goal_and_hovers_there() {
    let mut s = Story::begin(GuidanceConfig::default());
    let first = s.step();
    assert_eq!(
        (first.state, first.setpoint),
        (Standby, None),
        "not before half a second of good inputs"
    );
    assert_eq!(s.until(Ready) + 1, 10);
    let waiting = s.run(seconds(30.0));
    assert_eq!(
        (waiting.state, waiting.setpoint, waiting.request),
        (Ready, None, VehicleRequest::None)
    );

    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    let engaging = s.step();
    assert_eq!(engaging.state, Engaging);
    assert_eq!(engaging.request, VehicleRequest::FlyExternal { takeoff_height_m: 3.0 });
    s.handover = HandoverProgress::InProgress {
        stream_setpoints: false,
    };
    assert_eq!(
        s.run(seconds(5.0)).setpoint,
        None,
        "an ArduPilot that climbs must not get setpoints"
    );
    s.handover = HandoverProgress::InProgress { stream_setpoints: true };
    assert_eq!(
        s.step().setpoint,
        Some(VelocitySetpoint::HOLD),
        "a PX4 wants zeros before it changes its mode"
    );

    s.hand_over();
    s.position_ned_m = NedVector::new(0.0, 0.0, -2.5);
    let guided = s.step();
    assert_eq!((guided.state, guided.request), (Guided, VehicleRequest::None));
    let setpoint = guided.setpoint.unwrap();
    assert_eq!(setpoint.velocity_m_s.x, 1.0);
    assert!((setpoint.yaw_rate_rad_s.to_degrees() - 15.0).abs() < 1e-4);
    assert!(
        (setpoint.velocity_m_s.z + 0.4).abs() < 1e-6,
        "half a metre too low: climbs at 0.8 / s x 0.5 m"
    );

    s.position_ned_m = NedVector::new(19.2, 4.6, -3.0);
    let arrived = s.step();
    assert_eq!(
        (arrived.state, arrived.reasons),
        (Hold, Reasons::of(Reason::GoalReached))
    );
    assert_eq!(arrived.setpoint, Some(VelocitySetpoint::HOLD));
    s.position_ned_m.x = 17.0;
    assert_eq!(
        s.run(seconds(60.0)).state,
        Hold,
        "a gust that moves it away does not start it again"
    );

    let next = OperatorRequest::Goal {
        north_m: -5.0,
        east_m: 0.0,
        height_m: None,
    };
    assert_eq!(s.ask(next), RequestOutcome::Accepted);
    assert_eq!(
        s.guidance.goal().unwrap().position_ned_m,
        NedVector::new(-5.0, 0.0, -3.0)
    );
    assert_eq!(s.until(Guided), 10);
}

#[test]
fn goals_and_the_fence_are_counted_from_home_which_the_autopilot_sets_anew_when_it_is_armed() {
    let geofence = Some(Geofence {
        shape: FenceShape::Cylinder {
            center_m: [0.0, 0.0],
            radius_m: 30.0,
        },
        min_height_m: 0.8,
        max_height_m: 6.0,
    });
    let mut s = Story::begin(GuidanceConfig { geofence, ..auto() });
    let goal = |s: &Story| s.guidance.goal().unwrap().position_ned_m;
    s.step();
    assert_eq!(
        goal(&s),
        NedVector::new(20.0, 5.0, -3.0),
        "home is not known: the local origin"
    );
    s.home_ned_m = Some(NedVector::new(12.0, 3.0, -1.0));
    s.position_ned_m = NedVector::new(12.0, 3.0, -1.0);
    s.until(Engaging);
    assert_eq!(goal(&s), NedVector::new(32.0, 8.0, -4.0));
    assert_eq!(
        s.last.unwrap().request,
        VehicleRequest::FlyExternal { takeoff_height_m: 4.0 }
    );
    // Armed: home is where it stands now.
    s.home_ned_m = Some(NedVector::new(13.0, 3.0, -1.0));
    s.step();
    assert_eq!(goal(&s), NedVector::new(33.0, 8.0, -4.0));

    s.hand_over();
    s.position_ned_m = NedVector::new(13.0, 3.0, -4.0);
    s.until(Guided);
    s.home_ned_m = Some(NedVector::ZERO);
    s.run(20);
    assert_eq!(
        goal(&s),
        NedVector::new(33.0, 8.0, -4.0),
        "in flight the goal does not wander off"
    );

    let at = |north_m| OperatorRequest::Goal {
        north_m,
        east_m: 0.0,
        height_m: None,
    };
    assert_eq!(s.ask(at(28.0)), RequestOutcome::Accepted);
    assert_eq!(goal(&s), NedVector::new(41.0, 3.0, -4.0));
    assert_eq!(s.ask(at(29.6)), RequestOutcome::Denied, "the fence is around home");
    s.position_ned_m = NedVector::new(42.8, 3.0, -4.0);
    assert!(!s.step().reasons.contains(Reason::Geofence));
    s.position_ned_m = NedVector::new(43.2, 3.0, -4.0);
    assert!(s.step().reasons.contains(Reason::Geofence));

    // A place on the globe stays where it is.
    let fixed = OperatorRequest::FixedGoal {
        north_m: 20.0,
        east_m: 5.0,
        height_m: Some(3.0),
    };
    assert_eq!(s.ask(fixed), RequestOutcome::Accepted);
    assert_eq!(goal(&s), NedVector::new(20.0, 5.0, -3.0));
    assert_eq!(
        s.ask(OperatorRequest::FixedGoal {
            north_m: -18.0,
            east_m: 3.0,
            height_m: None
        }),
        RequestOutcome::Denied,
        "31 m from home"
    );
}

#[test]
fn a_home_that_is_told_only_in_flight_counts_once() {
    let mut s = Story::guided(auto());
    s.home_ned_m = Some(NedVector::new(12.0, 3.0, 0.0));
    s.step();
    let goal = s.guidance.goal().unwrap().position_ned_m;
    assert_eq!(goal, NedVector::new(32.0, 8.0, -3.0));
}

#[test]
fn telemetry_with_little_margin_is_told_and_flown_all_the_same() {
    let mut s = Story::guided(auto());
    s.interval_ns = Some(150_000_000);
    assert_eq!(s.run(20).reasons, Reasons::NONE, "half of the age that is stale");
    s.interval_ns = Some(250_000_000);
    let slow = s.run(20);
    assert_eq!((slow.state, slow.reasons), (Guided, Reasons::of(Reason::SlowTelemetry)));
    assert_eq!(slow.setpoint.unwrap().velocity_m_s.x, 1.0);
}

#[test]
fn a_stale_frame_means_hold_in_the_same_step_and_flight_goes_on_half_a_second_after_the_frames() {
    let mut s = Story::guided(GuidanceConfig::default());
    s.frame.age_ns = Some(250_000_000);
    assert_eq!(s.step().state, Guided, "the limit itself is not stale");
    s.frame.age_ns = Some(250_000_001);
    s.action = None;
    let hold = s.step();
    assert_eq!((hold.state, hold.reasons), (Hold, Reasons::of(Reason::StaleFrame)));
    assert_eq!(hold.setpoint, Some(VelocitySetpoint::HOLD));

    s.frame.age_ns = Some(STEP_NS);
    s.action = Some(Action::HOVER);
    s.run(9);
    s.frame.age_ns = Some(300_000_000);
    assert_eq!(s.step().state, Hold);
    s.frame.age_ns = Some(STEP_NS);
    assert_eq!(s.until(Guided), 10, "the steps must be consecutive");
}

#[test]
fn every_bad_input_is_a_hold_with_its_name_within_one_step() {
    type Spoil = fn(&mut Story);
    let stories: [(Spoil, Reason); 16] = [
        (|s| s.frame.age_ns = None, Reason::StaleFrame),
        (|s| s.frame.refused = true, Reason::BadFrame),
        (
            |s| s.frame.doubts = Reasons::of(Reason::BlindSensor),
            Reason::BlindSensor,
        ),
        (
            |s| s.frame.doubts = Reasons::of(Reason::FrozenSensor),
            Reason::FrozenSensor,
        ),
        (
            |s| s.frame.doubts = Reasons::of(Reason::ImplausiblePose),
            Reason::ImplausiblePose,
        ),
        (
            |s| s.frame.doubts = Reasons::of(Reason::InconsistentPicture),
            Reason::InconsistentPicture,
        ),
        (|s| s.telemetry_age_ns = 300_000_001, Reason::StaleTelemetry),
        (|s| s.heartbeat_age_ns = Some(1_500_000_001), Reason::LinkLost),
        (|s| s.position_ned_m.x = f32::NAN, Reason::NotFinite),
        (
            |s| {
                s.action = Some(Action {
                    forward_m_s: f32::INFINITY,
                    yaw: 0.0,
                })
            },
            Reason::NotFinite,
        ),
        (
            |s| {
                s.action = Some(Action {
                    forward_m_s: 0.0,
                    yaw: f32::NAN,
                })
            },
            Reason::NotFinite,
        ),
        (|s| s.action = None, Reason::NotFinite),
        (|s| s.mode = VehicleMode::Hold, Reason::ModeLost),
        (|s| s.slips += 3, Reason::Slip),
        (|s| s.failsafe = true, Reason::VehicleFailsafe),
        (
            |s| assert_eq!(s.ask(OperatorRequest::Disengage), RequestOutcome::Accepted),
            Reason::Operator,
        ),
    ];
    for (spoil, reason) in stories {
        let mut s = Story::guided(GuidanceConfig::default());
        spoil(&mut s);
        let out = s.step();
        assert_eq!(
            (out.state, out.reasons),
            (Hold, Reasons::of(reason)),
            "{}",
            reason.name()
        );
        assert_eq!(out.setpoint, Some(VelocitySetpoint::HOLD), "{}", reason.name());
    }
}

#[test]
fn nothing_is_sent_and_nothing_engages_while_an_input_is_missing() {
    type Spoil = fn(&mut Story);
    let stories: [(Spoil, Reason); 9] = [
        (|s| s.frame.age_ns = None, Reason::StaleFrame),
        (|s| s.frame.refused = true, Reason::BadFrame),
        (
            |s| s.frame.doubts = Reasons::of(Reason::BlindSensor),
            Reason::BlindSensor,
        ),
        (
            |s| s.frame.doubts = Reasons::of(Reason::ImplausiblePose),
            Reason::ImplausiblePose,
        ),
        (|s| s.telemetry_age_ns = 2_000_000_000, Reason::StaleTelemetry),
        (|s| s.heartbeat_age_ns = None, Reason::LinkLost),
        (|s| s.position_ned_m.y = f32::INFINITY, Reason::NotFinite),
        (
            |s| {
                s.action = Some(Action {
                    forward_m_s: f32::NAN,
                    yaw: 0.0,
                })
            },
            Reason::NotFinite,
        ),
        (|s| s.battery = Some(0.14), Reason::LowBattery),
    ];
    for (spoil, reason) in stories {
        let mut s = Story::begin(auto());
        spoil(&mut s);
        for _ in 0..100 {
            let out = s.step();
            assert_eq!(
                (out.state, out.setpoint, out.request),
                (Standby, None, VehicleRequest::None)
            );
            assert!(out.reasons.contains(reason), "{}", reason.name());
        }
        assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::TemporarilyRejected);
    }
}

#[test]
fn two_missed_steps_are_borne_three_within_a_second_are_not() {
    let mut s = Story::guided(GuidanceConfig::default());
    s.slips += 2;
    assert_eq!(s.run(seconds(1.1)).state, Guided);
    s.slips += 2;
    assert_eq!(s.step().state, Guided, "the first two are more than a second ago");
    s.slips += 1;
    assert_eq!(s.step().state, Hold);
    assert_eq!(s.until(Guided), 29, "the window passes, then ten clear steps");
}

#[test]
fn slips_before_the_first_step_are_not_held_against_the_flight() {
    let mut s = Story::begin(GuidanceConfig::default());
    s.slips = 500;
    assert!(!s.step().reasons.contains(Reason::Slip));
}

#[test]
fn with_policy_auto_guidance_takes_the_vehicle_back_after_a_failsafe_hold() {
    let mut s = Story::guided(auto());
    // A step was missed, so the vehicle missed setpoints and holds by itself; it says so.
    s.slips += 1;
    (s.mode, s.failsafe, s.handover) = (VehicleMode::Hold, true, HandoverProgress::Idle);
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
    s.slips += 1;
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
    (s.mode, s.failsafe, s.handover) = (VehicleMode::Hold, true, HandoverProgress::Idle);
    s.until(Standby);
    let out = s.run(seconds(60.0));
    assert_eq!((out.state, out.setpoint), (Ready, None));
    assert!(out.reasons.contains(Reason::VehicleFailsafe) && out.reasons.contains(Reason::PilotInCommand));
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    assert_eq!(s.step().state, Engaging);
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
        (s.mode, s.handover) = (mode, HandoverProgress::Idle);
        let hold = s.step();
        assert_eq!(
            (hold.state, hold.setpoint),
            (Hold, Some(VelocitySetpoint::HOLD)),
            "zeros before silence"
        );
        assert_eq!(s.until(Standby), 10);
        let out = s.run(seconds(20.0));
        assert_eq!(
            (out.state, out.setpoint, out.reasons),
            (Ready, None, Reasons::of(Reason::PilotInCommand))
        );
        assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
        assert_eq!(s.step().state, Engaging);
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
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    s.until(Engaging);
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
    (s.armed, s.mode, s.handover) = (false, VehicleMode::Hold, HandoverProgress::Idle);
    let out = s.step();
    assert_eq!((out.state, out.setpoint), (Standby, None));
    assert!(out.reasons.contains(Reason::Disarmed));
    let later = s.run(seconds(60.0));
    assert_eq!(
        (later.state, later.reasons),
        (Ready, Reasons::of(Reason::PilotInCommand))
    );
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

    let fresh = Story::begin(auto());
    (s.armed, s.mode, s.position_ned_m, s.handover) = (fresh.armed, fresh.mode, fresh.position_ned_m, fresh.handover);
    (s.frame, s.telemetry_age_ns, s.heartbeat_age_ns, s.action) = (
        fresh.frame,
        fresh.telemetry_age_ns,
        fresh.heartbeat_age_ns,
        fresh.action,
    );
    // Its heartbeat says disarmed one step before its clock is seen to have started anew.
    assert_eq!(s.step().state, Standby);
    s.restarts += 1;
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
    let landing = s.step();
    assert_eq!(
        (landing.state, landing.request, landing.setpoint),
        (Land, VehicleRequest::None, None)
    );
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
    let out = s.step();
    assert_eq!((out.state, out.reasons), (Land, Reasons::of(Reason::Operator)));
    s.mode = VehicleMode::Land;
    s.run(5);
    s.handover = HandoverProgress::Idle;
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    assert_eq!(s.step().state, Engaging);
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
    assert_eq!(
        (s.step().state, s.last.unwrap().reasons),
        (Land, Reasons::of(Reason::TimeLimit))
    );
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
        assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
        s.until(Engaging);
        s.handover = HandoverProgress::Failed;
        let out = s.step();
        assert_eq!((out.state, out.request), (Standby, VehicleRequest::None));
        assert!(out.reasons.contains(Reason::HandoverFailed));
        s.handover = HandoverProgress::Idle;
        assert_eq!(s.run(seconds(4.0)).state, Ready);
        assert_eq!(s.run(seconds(2.0)).state, if tries { Engaging } else { Ready });
        if !tries {
            assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
            assert_eq!(s.step().state, Engaging);
        }
    }
}

#[test]
fn a_hand_over_that_never_ends_fails_after_a_minute() {
    let mut s = Story::begin(GuidanceConfig::default());
    s.until(Ready);
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    s.until(Engaging);
    s.handover = HandoverProgress::InProgress { stream_setpoints: true };
    assert_eq!(s.run(seconds(60.0)).state, Engaging);
    assert_eq!(s.step().state, Standby);
}

#[test]
fn an_operator_who_disengages_during_the_hand_over_gets_a_hovering_vehicle() {
    let mut s = Story::begin(auto());
    s.until(Engaging);
    s.handover = HandoverProgress::InProgress { stream_setpoints: true };
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

/// The autopilot starts anew, on the ground.
fn reboot(s: &mut Story) {
    s.heartbeat_age_ns = Some(3_000_000_000);
    s.telemetry_age_ns = 3_000_000_000;
    s.run(seconds(2.0));
    let fresh = Story::begin(auto());
    (s.armed, s.failsafe, s.mode) = (false, false, fresh.mode);
    (s.position_ned_m, s.handover) = (fresh.position_ned_m, fresh.handover);
    (s.telemetry_age_ns, s.heartbeat_age_ns) = (fresh.telemetry_age_ns, fresh.heartbeat_age_ns);
    s.restarts += 1;
}

#[test]
fn a_vehicle_that_a_person_took_is_not_taken_again_after_the_autopilot_restarted_until_an_operator_engages() {
    type Takes = fn(&mut Story);
    let stories: [(Takes, &str); 5] = [
        (
            |s| {
                (s.mode, s.handover) = (VehicleMode::Land, HandoverProgress::Idle);
                s.until(Standby);
            },
            "landed by a ground station",
        ),
        (
            |s| {
                (s.mode, s.handover) = (VehicleMode::Other, HandoverProgress::Idle);
                s.until(Standby);
            },
            "flown by sticks",
        ),
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
        assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
        assert!(!s.guidance.taken_over());
        assert_eq!(s.step().state, Engaging, "{how}");
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
    reboot(&mut s);
    let later = s.run(seconds(60.0));
    assert_eq!((later.state, later.reasons), (Ready, Reasons::NONE));
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
    (s.armed, s.mode, s.handover) = (false, VehicleMode::Hold, HandoverProgress::Idle);
    (s.telemetry_age_ns, s.heartbeat_age_ns, s.action) = (fresh.telemetry_age_ns, fresh.heartbeat_age_ns, fresh.action);
    // Its clock goes on: it is not a restart that disarmed it.
    assert_eq!(s.run(seconds(5.0)).reasons, Reasons::of(Reason::PilotInCommand));
    s.restarts += 1;
    assert_eq!(s.run(seconds(30.0)).state, Ready);
}

#[test]
fn a_take_over_of_an_earlier_run_is_kept_until_an_operator_engages() {
    let mut s = Story::begin(GuidanceConfig {
        taken_over: true,
        ..auto()
    });
    let waiting = s.run(seconds(60.0));
    assert_eq!(
        (waiting.state, waiting.reasons),
        (Ready, Reasons::of(Reason::PilotInCommand))
    );
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    assert_eq!(s.step().state, Engaging);
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
        (s.up_ns, s.position_ned_m.z) = (Some(up_ns), height_m(landed));
        let out = s.run(seconds(20.0));
        let told = out.reasons.contains(Reason::PilotInCommand);
        let story = format!("armed {armed}, {landed:?}, {mode:?}, failsafe {failsafe}, up {up_ns}");
        assert_eq!(
            (out.state, told),
            if takes { (Engaging, false) } else { (Ready, true) },
            "{story}"
        );
        if !takes {
            assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted, "{story}");
            assert_eq!(s.step().state, Engaging, "an operator may: {story}");
        }
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
    (s.mode, s.handover) = (VehicleMode::Land, HandoverProgress::Idle);
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
fn the_fence_holds_the_vehicle_and_refuses_goals_outside() {
    let fence = |shape| GuidanceConfig {
        geofence: Some(Geofence {
            shape,
            min_height_m: 0.8,
            max_height_m: 6.0,
        }),
        ..Default::default()
    };
    for shape in [
        FenceShape::Box {
            min_m: [-5.0, -10.0],
            max_m: [25.0, 10.0],
        },
        FenceShape::Cylinder {
            center_m: [10.0, 0.0],
            radius_m: 15.0,
        },
    ] {
        let mut s = Story::guided(fence(shape));
        let goal = |north_m, height_m| OperatorRequest::Goal {
            north_m,
            east_m: 0.0,
            height_m: Some(height_m),
        };
        for bad in [
            goal(24.8, 3.0),
            goal(5.0, 5.8),
            goal(5.0, 0.9),
            goal(f32::NAN, 3.0),
            goal(5.0, -1.0),
        ] {
            assert_eq!(s.ask(bad), RequestOutcome::Denied, "{bad:?}");
        }
        assert_eq!(s.ask(goal(5.0, 3.0)), RequestOutcome::Accepted);
        for (x, height, inside) in [
            (24.9, 3.0, true),
            (25.1, 3.0, false),
            (10.0, 6.1, false),
            (10.0, 0.7, false),
        ] {
            let mut s = Story::guided(fence(shape));
            s.position_ned_m = NedVector::new(x, 0.0, -height);
            let out = s.step();
            assert_eq!(
                (out.state == Guided, out.reasons.contains(Reason::Geofence)),
                (inside, !inside),
                "{x} {height}"
            );
            s.position_ned_m = NedVector::new(24.7, 0.0, -3.0);
            assert_eq!(
                s.run(30).state,
                if inside { Guided } else { Hold },
                "clears half a metre inside"
            );
            s.position_ned_m = NedVector::new(24.0, 0.0, -3.0);
            assert_eq!(s.run(30).state, Guided);
        }
    }
}

#[test]
fn on_the_ground_the_least_height_of_the_fence_does_not_count() {
    let shape = FenceShape::Cylinder {
        center_m: [10.0, 0.0],
        radius_m: 15.0,
    };
    let geofence = Some(Geofence {
        shape,
        min_height_m: 0.8,
        max_height_m: 6.0,
    });
    let mut s = Story::begin(GuidanceConfig {
        geofence,
        ..Default::default()
    });
    assert_eq!(s.run(20).state, Ready);
}

#[test]
fn a_handed_over_vehicle_is_held_while_an_input_is_bad() {
    let mut s = Story::begin(auto());
    s.until(Engaging);
    s.hand_over();
    s.frame.age_ns = Some(1_000_000_000);
    s.action = None;
    assert_eq!(
        (s.step().state, s.last.unwrap().setpoint),
        (Hold, Some(VelocitySetpoint::HOLD))
    );
    s.frame.age_ns = Some(STEP_NS);
    s.action = Some(Action::HOVER);
    assert_eq!(s.until(Guided), 10);
}

#[test]
fn a_firmware_that_starts_in_the_air_takes_the_vehicle_over() {
    let mut s = Story::begin(auto());
    (s.armed, s.mode, s.failsafe, s.position_ned_m.z) = (true, VehicleMode::Hold, true, -3.0);
    assert_eq!(s.until(Engaging), 11);
    s.hand_over();
    assert_eq!(s.until(Guided), 1);
}

#[test]
fn actions_beyond_the_limits_are_clipped() {
    let mut s = Story::guided(GuidanceConfig::default());
    s.action = Some(Action {
        forward_m_s: -9.0,
        yaw: 4.0,
    });
    let v = s.step().setpoint.unwrap();
    assert_eq!((v.velocity_m_s.x, v.velocity_m_s.y), (-1.5, 0.0));
    assert!((v.yaw_rate_rad_s.to_degrees() - 45.0).abs() < 1e-4);
    // Far above its goal it descends where it is.
    s.position_ned_m.z = -30.0;
    let v = s.step().setpoint.unwrap();
    assert_eq!((v.velocity_m_s.x, v.velocity_m_s.y, v.velocity_m_s.z), (0.0, 0.0, 0.5));
}

#[test]
fn without_a_goal_there_is_no_flight() {
    let mut s = Story::begin(auto());
    s.guidance = vigil_guidance::Guidance::new(auto()).unwrap();
    s.action = None;
    let out = s.run(40);
    assert_eq!((out.state, out.reasons), (Standby, Reasons::of(Reason::NoGoal)));
    assert_eq!(s.ask(GOAL), RequestOutcome::Accepted);
    s.action = Some(Action::HOVER);
    s.until(Engaging);
}

#[test]
fn a_configuration_that_must_not_fly_is_refused_by_field() {
    let refused = |config: GuidanceConfig| vigil_guidance::Guidance::new(config).unwrap_err().to_string();
    let d = GuidanceConfig::default();
    let radius = refused(GuidanceConfig {
        goal_radius_m: f32::NAN,
        ..d
    });
    assert!(
        radius.contains("limits.goal_radius_m is NaN") && radius.contains("0.1 to 100"),
        "{radius}"
    );
    assert!(refused(GuidanceConfig { slip_limit: 9, ..d }).contains("limits.slips is 9"));
    assert!(
        refused(GuidanceConfig {
            frame_age_limit_ns: 0,
            ..d
        })
        .contains("limits.frame_age_s is 0")
    );
    let shape = FenceShape::Box {
        min_m: [5.0, 0.0],
        max_m: [5.0, 9.0],
    };
    let geofence = Some(Geofence {
        shape,
        min_height_m: 0.0,
        max_height_m: 9.0,
    });
    assert!(refused(GuidanceConfig { geofence, ..d }).contains("geofence"));
}

/// What the recovery pilot wants in these stories; the actor wants 1.0 m/s.
const RECOVERY: Action = Action {
    forward_m_s: 0.6,
    yaw: -0.25,
};

/// A flight at 1 m/s under a detector.
fn watched(policy: AlarmPolicy) -> Story {
    watched_with(AlarmConfig {
        policy,
        ..AlarmConfig::default()
    })
}

/// The same, and the guard raises the alarm when the actor falls 6 m behind.
fn watched_for_leading_astray() -> Story {
    watched_with(AlarmConfig {
        policy: AlarmPolicy::Recover,
        astray_limit_m: 6.0,
        ..AlarmConfig::default()
    })
}

fn watched_with(alarm: AlarmConfig) -> Story {
    let mut s = Story::guided(GuidanceConfig { alarm, ..auto() });
    s.recovery = Some(RECOVERY);
    s.verdict = Some(Verdict::Clean);
    s.velocity_ned_m_s.x = 1.0;
    assert_eq!(
        s.run(seconds(1.0)).setpoint.unwrap().velocity_m_s.x,
        1.0,
        "the actor flies"
    );
    s
}

#[test]
fn an_attacked_vehicle_stops_then_the_recovery_pilot_flies_and_the_actor_gets_it_back_when_the_attack_is_over() {
    let mut s = watched(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    let fourth = s.run(4);
    assert_eq!(
        (fourth.state, fourth.alarm),
        (Guided, None),
        "four verdicts are not an alarm"
    );
    let alarm = s.step();
    assert_eq!((alarm.state, alarm.reasons), (Hold, Reasons::of(Reason::Attack)));
    assert_eq!(alarm.setpoint, Some(VelocitySetpoint::HOLD));
    let raised = alarm.alarm.unwrap();
    assert_eq!(
        (raised.cause, raised.response),
        (AlarmCause::Attack, AlarmResponse::Stop)
    );

    s.velocity_ned_m_s.x = 0.25;
    let braking = s.run(seconds(1.0));
    assert_eq!((braking.state, braking.setpoint), (Hold, Some(VelocitySetpoint::HOLD)));
    s.velocity_ned_m_s.x = 0.1;
    assert_eq!(s.until(Guided), 10, "half a second of standing");
    let recovering = s.last.unwrap();
    assert_eq!(recovering.reasons, Reasons::of(Reason::Recovering));
    assert_eq!(recovering.action, Some(RECOVERY));

    s.velocity_ned_m_s.x = 0.6;
    assert_eq!(
        s.run(seconds(30.0)).setpoint.unwrap().velocity_m_s.x,
        0.6,
        "the attack goes on, and so does the flight"
    );

    s.verdict = Some(Verdict::Clean);
    s.run(39);
    s.verdict = Some(Verdict::Unknown);
    s.step();
    s.verdict = Some(Verdict::Clean);
    assert_eq!(s.run(39).setpoint.unwrap().velocity_m_s.x, 0.6, "unknown is not clean");
    let over = s.step();
    assert_eq!((over.alarm, over.reasons), (None, Reasons::NONE));
    assert_eq!(over.setpoint.unwrap().velocity_m_s.x, 1.0, "the actor flies again");
}

#[test]
fn with_the_policy_stop_the_vehicle_stays_until_the_verdict_is_clean() {
    let mut s = watched(AlarmPolicy::Stop);
    s.verdict = Some(Verdict::Attack);
    s.run(5);
    s.velocity_ned_m_s.x = 0.0;
    let standing = s.run(seconds(60.0));
    assert_eq!((standing.state, standing.reasons), (Hold, Reasons::of(Reason::Attack)));
    s.verdict = Some(Verdict::Clean);
    // Forty clean verdicts, and with the last of them the first of ten steps without a condition.
    assert_eq!(s.until(Guided), 49);
    assert_eq!(s.last.unwrap().setpoint.unwrap().velocity_m_s.x, 1.0);
}

#[test]
fn with_the_policy_ignore_the_alarm_is_told_and_the_flight_is_not_touched() {
    let mut s = watched(AlarmPolicy::Ignore);
    s.verdict = Some(Verdict::Attack);
    let out = s.run(seconds(5.0));
    assert_eq!((out.state, out.reasons), (Guided, Reasons::NONE));
    assert_eq!(out.alarm.unwrap().response, AlarmResponse::Ignored);
    assert_eq!(out.setpoint.unwrap().velocity_m_s.x, 1.0);
}

#[test]
fn an_actor_without_a_verdict_is_not_trusted_for_longer_than_half_a_second() {
    let mut s = watched(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Unknown);
    assert_eq!(s.run(10).alarm, None);
    let raised = s.step();
    assert_eq!((raised.state, raised.reasons), (Hold, Reasons::of(Reason::NoVerdict)));
    s.velocity_ned_m_s.x = 0.0;
    s.until(Guided);
    assert_eq!(s.run(seconds(10.0)).setpoint.unwrap().velocity_m_s.x, 0.6);
    s.verdict = Some(Verdict::Attack);
    assert_eq!(s.run(5).alarm.unwrap().cause, AlarmCause::Attack);
    assert_eq!(s.last.unwrap().state, Guided, "the recovery pilot need not stop for it");
}

#[test]
fn an_actor_about_to_fly_into_something_is_stopped_although_every_verdict_is_clean() {
    let mut s = watched(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Clean);
    s.risk.collision_course = true;
    assert_eq!(s.run(3).alarm, None, "a few steps may be noise");
    let alarm = s.step();
    assert_eq!(
        (alarm.state, alarm.reasons, alarm.setpoint),
        (Hold, Reasons::of(Reason::CollisionCourse), Some(VelocitySetpoint::HOLD))
    );
    s.velocity_ned_m_s.x = 0.0;
    s.until(Guided);
    assert_eq!(s.last.unwrap().action, Some(RECOVERY));

    // Clean verdicts and a way that looks free are what led it here.
    s.risk.collision_course = false;
    let flying = s.run(seconds(60.0));
    assert_eq!(
        (flying.reasons, flying.setpoint.unwrap().velocity_m_s.x),
        (Reasons::of(Reason::Recovering), 0.6)
    );
    s.verdict = Some(Verdict::Attack);
    assert_eq!(s.run(5).alarm.unwrap().cause, AlarmCause::CollisionCourse);
    s.verdict = Some(Verdict::Clean);

    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    let trusted = s.step();
    assert_eq!((trusted.alarm, trusted.setpoint.unwrap().velocity_m_s.x), (None, 1.0));

    s.risk.collision_course = true;
    assert_eq!(s.run(4).alarm.unwrap().cause, AlarmCause::CollisionCourse);
}

#[test]
fn with_the_policy_stop_a_vehicle_that_the_guard_stopped_waits_for_an_operator() {
    let mut s = watched(AlarmPolicy::Stop);
    s.verdict = Some(Verdict::Clean);
    s.risk.collision_course = true;
    s.run(4);
    s.risk.collision_course = false;
    let standing = s.run(seconds(300.0));
    assert_eq!(
        (standing.state, standing.reasons),
        (Hold, Reasons::of(Reason::CollisionCourse))
    );
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    s.until(Guided);
    assert_eq!(s.last.unwrap().setpoint.unwrap().velocity_m_s.x, 1.0);
}

#[test]
fn an_actor_that_is_led_away_from_the_guard_s_way_is_stopped_although_every_verdict_is_clean_and_does_not_come_back() {
    let mut s = watched_for_leading_astray();
    s.verdict = Some(Verdict::Clean);
    s.risk.speed_along_way_m_s = 0.8;
    assert_eq!(s.run(seconds(30.0)).alarm, None, "it gets on");
    // Astray, away from the way.
    s.risk.speed_along_way_m_s = -1.0;
    s.velocity_ned_m_s.x = 1.0;
    let flown = s.until(Hold);
    assert!((80..90).contains(&flown), "6 m at 1.5 m/s, found after {flown} steps");
    let stop = s.last.unwrap();
    assert_eq!(
        (stop.reasons, stop.setpoint, stop.alarm.unwrap().cause),
        (
            Reasons::of(Reason::LedAstray),
            Some(VelocitySetpoint::HOLD),
            AlarmCause::LedAstray
        )
    );
    s.velocity_ned_m_s.x = 0.0;
    s.until(Guided);
    s.risk.speed_along_way_m_s = 0.6;
    let flying = s.run(seconds(60.0));
    assert_eq!(
        (flying.reasons, flying.action),
        (Reasons::of(Reason::Recovering), Some(RECOVERY))
    );
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    assert_eq!(s.step().alarm, None, "the operator trusts it again");
}

#[test]
fn an_actor_that_waits_or_flies_round_something_or_is_held_is_not_taken_for_one_led_astray() {
    let mut s = watched_for_leading_astray();
    s.verdict = Some(Verdict::Clean);
    for speed_m_s in [0.0, 0.8, -0.3, 0.8, 0.0, 1.2] {
        s.risk.speed_along_way_m_s = speed_m_s;
        assert_eq!(s.run(seconds(3.0)).alarm, None, "{speed_m_s}");
    }
    // A hold is not the actor's doing.
    s.risk.speed_along_way_m_s = 0.0;
    s.frame.age_ns = Some(1_000_000_000);
    assert_eq!(s.run(seconds(30.0)).alarm, None);
}

#[test]
fn an_actor_that_goes_on_turning_the_other_way_than_the_planner_is_stopped_although_it_gets_on() {
    let mut s = watched(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Clean);
    let recovery_yaw = s.recovery.unwrap().yaw;
    let turn_apart = |s: &mut Story, apart: f32| s.action.as_mut().unwrap().yaw = recovery_yaw + apart;
    for _ in 0..20 {
        turn_apart(&mut s, 1.4);
        assert_eq!(s.run(seconds(1.5)).alarm, None, "a swerve");
        turn_apart(&mut s, 0.0);
        assert_eq!(s.run(seconds(1.5)).alarm, None);
    }
    s.recovery.as_mut().unwrap().yaw = 1.5;
    s.action.as_mut().unwrap().yaw = -1.5;
    assert!((50..52).contains(&s.until(Hold)));
    let stop = s.last.unwrap();
    assert_eq!(
        (stop.reasons, stop.alarm.unwrap().cause),
        (Reasons::of(Reason::Disagreement), AlarmCause::Disagreement)
    );
    s.velocity_ned_m_s.x = 0.0;
    s.until(Guided);
    s.action.as_mut().unwrap().yaw = 1.5;
    assert!(s.run(seconds(60.0)).alarm.is_some(), "final");
}

#[test]
fn an_actor_may_go_as_far_astray_as_it_likes_where_the_limit_is_zero() {
    let mut s = watched_for_leading_astray();
    let mut config = *s.guidance.config();
    config.alarm.astray_limit_m = 0.0;
    s.guidance.reconfigure(config).unwrap();
    s.verdict = Some(Verdict::Clean);
    s.risk.speed_along_way_m_s = -1.0;
    assert_eq!(s.run(seconds(60.0)).alarm, None);
}

#[test]
fn a_new_flight_begins_with_the_actor() {
    let mut s = watched(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Clean);
    s.risk.collision_course = true;
    assert!(s.run(4).alarm.is_some());
    s.risk.collision_course = false;
    s.armed = false;
    s.until(Standby);
    assert_eq!(s.step().alarm, None);
}

#[test]
fn the_recovery_pilot_is_stopped_before_what_it_would_fly_into_and_begins_anew_from_there() {
    let mut s = watched(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    s.run(5);
    s.velocity_ned_m_s.x = 0.0;
    s.until(Guided);
    s.velocity_ned_m_s.x = 0.6;
    s.risk.recovery_course = true;
    assert_eq!(s.step().state, Guided, "one step may be noise");
    let stop = s.step();
    assert_eq!(
        (stop.state, stop.reasons, stop.setpoint),
        (Hold, Reasons::of(Reason::CollisionCourse), Some(VelocitySetpoint::HOLD))
    );
    s.velocity_ned_m_s.x = 0.0;
    s.risk.recovery_course = false;
    s.until(Guided);
    let again = s.last.unwrap();
    assert_eq!(
        (again.reasons, again.action),
        (Reasons::of(Reason::Recovering), Some(RECOVERY))
    );
    // Its own error says nothing of the actor: the alarm is still the verdict's, and ends as such.
    assert_eq!(again.alarm.unwrap().cause, AlarmCause::Attack);
    s.verdict = Some(Verdict::Clean);
    s.run(40);
    assert_eq!(s.last.unwrap().alarm, None);
}

#[test]
fn without_the_guard_a_collision_course_raises_nothing() {
    let mut config = GuidanceConfig::default();
    config.alarm.guard_steps = 0;
    let mut s = Story::guided(config);
    s.verdict = Some(Verdict::Clean);
    s.risk.collision_course = true;
    assert_eq!(s.run(seconds(5.0)).alarm, None);
}

#[test]
fn a_recovery_pilot_without_an_action_leaves_the_vehicle_holding() {
    let mut s = watched(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    s.recovery = None;
    s.velocity_ned_m_s.x = 0.0;
    let out = s.run(seconds(10.0));
    assert_eq!(out.state, Hold);
    assert!(out.reasons.contains(Reason::NotFinite) && out.reasons.contains(Reason::Recovering));
}

#[test]
fn an_operator_changes_the_policy_in_flight() {
    let mut s = watched(AlarmPolicy::Stop);
    s.verdict = Some(Verdict::Attack);
    s.velocity_ned_m_s.x = 0.0;
    assert_eq!(s.run(seconds(5.0)).state, Hold);
    let mut config = *s.guidance.config();
    config.alarm.policy = AlarmPolicy::Recover;
    s.guidance.reconfigure(config).unwrap();
    s.until(Guided);
    assert_eq!(s.last.unwrap().setpoint.unwrap().velocity_m_s.x, 0.6);
}

#[test]
fn an_alarm_lasts_no_longer_than_its_flight() {
    let mut s = watched(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    assert!(s.run(seconds(1.0)).alarm.is_some());
    s.armed = false;
    assert_eq!(s.until(Standby), 1);
    assert_eq!(s.step().alarm, None, "what is judged on the ground raises nothing");
}

#[test]
fn a_vehicle_that_does_not_get_nearer_holds_by_that_name_after_two_minutes_and_then_lands() {
    let mut s = Story::guided(auto());
    // A detour: away from the goal and back again takes less than the time there is.
    for north_m in [5.0, -30.0, 5.0, 8.0] {
        s.position_ned_m.x = north_m;
        assert_eq!(s.run(seconds(39.0)).state, Guided, "at {north_m}");
    }
    // To and fro, never nearer than before.
    for n in 0..8 {
        s.position_ned_m.x = if n % 2 == 0 { -4.0 } else { 7.5 };
        assert_eq!(s.run(seconds(10.0)).state, Guided, "{n}");
    }
    assert!((1..=40).contains(&s.until(Hold)), "two minutes since it was nearest");
    let hold = s.last.unwrap();
    assert_eq!(hold.reasons, Reasons::of(Reason::NoProgress));
    assert_eq!(hold.setpoint, Some(VelocitySetpoint::HOLD));
    assert_eq!(s.run(seconds(9.9)).state, Hold);
    s.run(3);
    assert_eq!(s.last.unwrap().state, Land);
}

#[test]
fn what_the_vehicle_holds_for_is_no_lack_of_progress() {
    let mut s = Story::guided(auto());
    for _ in 0..5 {
        assert_eq!(s.run(seconds(20.0)).state, Guided);
        s.frame.age_ns = Some(400_000_000);
        assert_eq!(s.run(seconds(60.0)).reasons, Reasons::of(Reason::StaleFrame));
        s.frame.age_ns = Some(STEP_NS);
        s.until(Guided);
    }
}

#[test]
fn a_flight_without_progress_that_is_to_hold_goes_on_with_another_goal_or_an_operator_and_ends_where_none_is_wanted() {
    let config = GuidanceConfig {
        on_no_progress: OnNoProgress::Hold,
        ..auto()
    };
    let mut s = Story::guided(config);
    s.run(seconds(121.0));
    assert_eq!(s.run(seconds(600.0)).reasons, Reasons::of(Reason::NoProgress));
    assert_eq!(s.ask(GOAL), RequestOutcome::Accepted);
    assert_eq!(s.until(Guided), 10);
    s.run(seconds(121.0));
    assert_eq!(s.last.unwrap().state, Hold);
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    assert_eq!(s.until(Guided), 10);

    let mut landing = Story::guided(auto());
    landing.run(seconds(140.0));
    assert_eq!(landing.last.unwrap().state, Land);
    assert_eq!(
        landing.ask(OperatorRequest::Engage),
        RequestOutcome::Accepted,
        "an operator goes around"
    );
    landing.until(Guided);

    let never = GuidanceConfig {
        no_progress_limit_ns: None,
        ..auto()
    };
    assert_eq!(Story::guided(never).run(seconds(3600.0)).state, Guided);
}

#[test]
fn a_goal_farther_than_the_limit_is_refused_with_its_distance_and_the_one_before_stays() {
    let mut s = Story::guided(auto());
    let before = s.guidance.goal();
    let goal = |north_m, east_m| OperatorRequest::Goal {
        north_m,
        east_m,
        height_m: None,
    };
    let too_far = RequestOutcome::TooFar {
        distance_m: 501,
        limit_m: 500,
    };
    assert_eq!(s.ask(goal(-300.0, 400.5)), too_far);
    assert_eq!(s.guidance.goal(), before);
    assert_eq!(s.ask(goal(-300.0, 400.0)), RequestOutcome::Accepted);
    let farther = GuidanceConfig {
        goal_limit_m: 1000.0,
        ..auto()
    };
    s.guidance.reconfigure(farther).unwrap();
    assert_eq!(s.ask(goal(-300.0, 400.5)), RequestOutcome::Accepted);
}
