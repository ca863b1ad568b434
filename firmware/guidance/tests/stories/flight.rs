//! A flight to its goal: what it needs, where it may go, and when it is given up.

use super::*;

#[test]
fn an_operator_engages_and_the_vehicle_flies_to_the_goal_and_hovers_there() {
    let mut s = Story::begin(GuidanceConfig::default());
    // Not before half a second of good inputs.
    assert_silent(s.step(), Standby);
    assert_eq!(s.until(Ready) + 1, 10);
    assert_silent(s.run(seconds(30.0)), Ready);

    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    let engaging = s.step();
    assert_eq!(engaging.state, Engaging);
    assert_eq!(engaging.request, VehicleRequest::FlyExternal { takeoff_height_m: 3.0 });
    s.vehicle.handover = HandoverProgress::InProgress {
        stream_setpoints: false,
    };
    assert_eq!(
        s.run(seconds(5.0)).setpoint,
        None,
        "an ArduPilot that climbs must not get setpoints"
    );
    s.vehicle.handover = HandoverProgress::InProgress { stream_setpoints: true };
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
    assert_holds(s.step(), Reason::GoalReached);
    s.position_ned_m.x = 17.0;
    assert_eq!(
        s.run(seconds(60.0)).state,
        Hold,
        "a gust that moves it away does not start it again"
    );

    assert_eq!(s.ask(goal(-5.0, 0.0, None)), RequestOutcome::Accepted);
    assert_eq!(
        s.guidance.goal().unwrap().position_ned_m,
        NedVector::new(-5.0, 0.0, -3.0)
    );
    assert_eq!(s.until(Guided), 10);
}

#[test]
fn goals_and_the_fence_are_counted_from_home_which_the_autopilot_sets_anew_when_it_is_armed() {
    let geofence = fence(30.0);
    let mut s = Story::begin(GuidanceConfig { geofence, ..auto() });
    let goal_m = |s: &Story| s.guidance.goal().unwrap().position_ned_m;
    s.step();
    assert_eq!(
        goal_m(&s),
        NedVector::new(20.0, 5.0, -3.0),
        "home is not known: the local origin"
    );
    s.vehicle.home_ned_m = Some(NedVector::new(12.0, 3.0, -1.0));
    s.position_ned_m = NedVector::new(12.0, 3.0, -1.0);
    s.until(Engaging);
    assert_eq!(goal_m(&s), NedVector::new(32.0, 8.0, -4.0));
    assert_eq!(
        s.last.unwrap().request,
        VehicleRequest::FlyExternal { takeoff_height_m: 4.0 }
    );
    // Armed: home is where it stands now.
    s.vehicle.home_ned_m = Some(NedVector::new(13.0, 3.0, -1.0));
    s.step();
    assert_eq!(goal_m(&s), NedVector::new(33.0, 8.0, -4.0));

    s.hand_over();
    s.position_ned_m = NedVector::new(13.0, 3.0, -4.0);
    s.until(Guided);
    s.vehicle.home_ned_m = Some(NedVector::ZERO);
    s.run(20);
    assert_eq!(
        goal_m(&s),
        NedVector::new(33.0, 8.0, -4.0),
        "in flight the goal does not move off"
    );

    assert_eq!(s.ask(goal(28.0, 0.0, None)), RequestOutcome::Accepted);
    assert_eq!(goal_m(&s), NedVector::new(41.0, 3.0, -4.0));
    assert_eq!(
        s.ask(goal(29.6, 0.0, None)),
        RequestOutcome::Denied,
        "the fence is around home"
    );
    s.position_ned_m = NedVector::new(42.8, 3.0, -4.0);
    assert!(!s.step().reasons.contains(Reason::Geofence));
    s.position_ned_m = NedVector::new(43.2, 3.0, -4.0);
    assert!(s.step().reasons.contains(Reason::Geofence));

    // A place on the globe stays where it is.
    let fixed = |north_m, east_m| OperatorRequest::FixedGoal {
        north_m,
        east_m,
        height_m: Some(3.0),
    };
    assert_eq!(s.ask(fixed(20.0, 5.0)), RequestOutcome::Accepted);
    assert_eq!(goal_m(&s), NedVector::new(20.0, 5.0, -3.0));
    assert_eq!(s.ask(fixed(-18.0, 3.0)), RequestOutcome::Denied, "31 m from home");
}

#[test]
fn a_home_that_is_reported_only_in_flight_counts_once() {
    let mut s = Story::guided(auto());
    s.vehicle.home_ned_m = Some(NedVector::new(12.0, 3.0, 0.0));
    s.step();
    let goal = s.guidance.goal().unwrap().position_ned_m;
    assert_eq!(goal, NedVector::new(32.0, 8.0, -3.0));
}

#[test]
fn telemetry_with_little_margin_is_reported_and_flown_all_the_same() {
    let mut s = Story::guided(auto());
    s.vehicle.telemetry_interval_ns = Some(150_000_000);
    assert_eq!(s.run(20).reasons, Reasons::NONE, "half of the age that is stale");
    s.vehicle.telemetry_interval_ns = Some(250_000_000);
    let slow = s.run(20);
    assert_eq!((slow.state, slow.reasons), (Guided, Reasons::of(Reason::SlowTelemetry)));
    assert_eq!(sent_m_s(slow), 1.0);
}

#[test]
fn a_stale_frame_means_hold_in_the_same_step_and_flight_goes_on_half_a_second_after_the_frames() {
    let mut s = Story::guided(GuidanceConfig::default());
    s.frame.age_ns = Some(250_000_000);
    assert_eq!(s.step().state, Guided, "the limit itself is not stale");
    s.frame.age_ns = Some(250_000_001);
    s.action = None;
    assert_holds(s.step(), Reason::StaleFrame);

    s.frame.age_ns = Some(STEP_NS);
    s.action = Some(Action::HOVER);
    s.run(9);
    s.frame.age_ns = Some(300_000_000);
    assert_eq!(s.step().state, Hold);
    s.frame.age_ns = Some(STEP_NS);
    assert_eq!(s.until(Guided), 10, "the steps must be consecutive");
}

/// How an input is spoiled, so that guidance gives this reason.
type Spoil = fn(&mut Story, Reason);

/// The newest frame shows a fault of the sensor.
fn is_seen(s: &mut Story, fault: Reason) {
    s.frame.sensor_faults = Reasons::of(fault);
}

#[test]
fn every_bad_input_is_a_hold_with_its_name_within_one_step() {
    let stories: [(Spoil, Reason); 16] = [
        (|s, _| s.frame.age_ns = None, Reason::StaleFrame),
        (|s, _| s.frame.refused = true, Reason::BadFrame),
        (is_seen, Reason::BlindSensor),
        (is_seen, Reason::FrozenSensor),
        (is_seen, Reason::ImplausiblePose),
        (is_seen, Reason::InconsistentPicture),
        (|s, _| s.telemetry_age_ns = 300_000_001, Reason::StaleTelemetry),
        (|s, _| s.heartbeat_age_ns = Some(1_500_000_001), Reason::LinkLost),
        (|s, _| s.position_ned_m.x = f32::NAN, Reason::NotFinite),
        (
            |s, _| s.action = Some(Action::new(f32::INFINITY, 0.0)),
            Reason::NotFinite,
        ),
        (|s, _| s.action = Some(Action::new(0.0, f32::NAN)), Reason::NotFinite),
        (|s, _| s.action = None, Reason::NotFinite),
        (|s, _| s.mode = VehicleMode::Hold, Reason::ModeLost),
        (|s, _| s.timing.slips += 3, Reason::Slip),
        (|s, _| s.failsafe = true, Reason::VehicleFailsafe),
        (
            |s, _| assert_eq!(s.ask(OperatorRequest::Disengage), RequestOutcome::Accepted),
            Reason::Operator,
        ),
    ];
    for (spoil, reason) in stories {
        let mut s = Story::guided(GuidanceConfig::default());
        spoil(&mut s, reason);
        assert_holds(s.step(), reason);
    }
}

#[test]
fn nothing_is_sent_and_nothing_engages_while_an_input_is_missing() {
    let stories: [(Spoil, Reason); 9] = [
        (|s, _| s.frame.age_ns = None, Reason::StaleFrame),
        (|s, _| s.frame.refused = true, Reason::BadFrame),
        (is_seen, Reason::BlindSensor),
        (is_seen, Reason::ImplausiblePose),
        (|s, _| s.telemetry_age_ns = 2_000_000_000, Reason::StaleTelemetry),
        (|s, _| s.heartbeat_age_ns = None, Reason::LinkLost),
        (|s, _| s.position_ned_m.y = f32::INFINITY, Reason::NotFinite),
        (|s, _| s.action = Some(Action::new(f32::NAN, 0.0)), Reason::NotFinite),
        (|s, _| s.battery = Some(0.14), Reason::LowBattery),
    ];
    for (spoil, reason) in stories {
        let mut s = Story::begin(auto());
        spoil(&mut s, reason);
        for _ in 0..100 {
            let out = s.step();
            assert_silent(out, Standby);
            assert!(out.reasons.contains(reason), "{}", reason.name());
        }
        assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::TemporarilyRejected);
    }
}

#[test]
fn two_missed_steps_are_borne_three_within_a_second_are_not() {
    let mut s = Story::guided(GuidanceConfig::default());
    s.timing.slips += 2;
    assert_eq!(s.run(seconds(1.1)).state, Guided);
    s.timing.slips += 2;
    assert_eq!(s.step().state, Guided, "the first two are more than a second ago");
    s.timing.slips += 1;
    assert_eq!(s.step().state, Hold);
    assert_eq!(s.until(Guided), 29, "the window passes, then ten clear steps");
}

#[test]
fn slips_before_the_first_step_are_not_held_against_the_flight() {
    let mut s = Story::begin(GuidanceConfig::default());
    s.timing.slips = 500;
    assert!(!s.step().reasons.contains(Reason::Slip));
}

#[test]
fn the_fence_holds_the_vehicle_and_refuses_goals_outside() {
    let config = GuidanceConfig {
        geofence: fence(25.0),
        ..Default::default()
    };
    let mut s = Story::guided(config);
    for (north_m, height_m) in [(24.8, 3.0), (5.0, 5.8), (5.0, 0.9), (f32::NAN, 3.0), (5.0, -1.0)] {
        let bad = goal(north_m, 0.0, Some(height_m));
        assert_eq!(s.ask(bad), RequestOutcome::Denied, "{bad:?}");
    }
    assert_eq!(s.ask(goal(5.0, 0.0, Some(3.0))), RequestOutcome::Accepted);
    for (x, height, inside) in [
        (24.9, 3.0, true),
        (25.1, 3.0, false),
        (10.0, 6.1, false),
        (10.0, 0.7, false),
    ] {
        let mut s = Story::guided(config);
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

#[test]
fn on_the_ground_the_least_height_of_the_fence_does_not_count() {
    let mut s = Story::begin(GuidanceConfig {
        geofence: fence(25.0),
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
fn actions_beyond_the_limits_are_clipped() {
    let mut s = Story::guided(GuidanceConfig::default());
    s.action = Some(Action::new(-9.0, 4.0));
    let v = s.step().setpoint.unwrap();
    assert_eq!((v.velocity_m_s.x, v.velocity_m_s.y), (-1.5, 0.0));
    assert!((v.yaw_rate_rad_s.to_degrees() - 45.0).abs() < 1e-4);
    // An operator may set another limit while it flies.
    for speed_limit_m_s in [0.7, 3.0] {
        s.reconfigure(|config| config.speed_limit_m_s = speed_limit_m_s);
        assert_eq!(sent_m_s(s.step()), -speed_limit_m_s);
    }
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
    assert_eq!(s.ends(40), (Standby, Reasons::of(Reason::NoGoal)));
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
    let speed = refused(GuidanceConfig {
        speed_limit_m_s: 3.5,
        ..d
    });
    assert!(speed.contains("limits.speed_m_s is 3.5"), "{speed}");
    assert!(refused(GuidanceConfig { slip_limit: 9, ..d }).contains("limits.slips is 9"));
    assert!(
        refused(GuidanceConfig {
            frame_age_limit_ns: 0,
            ..d
        })
        .contains("limits.frame_age_s is 0")
    );
    let geofence = fence(0.0);
    assert!(refused(GuidanceConfig { geofence, ..d }).contains("geofence"));
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
    assert_holds(s.last.unwrap(), Reason::NoProgress);
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
    let too_far = RequestOutcome::TooFar {
        distance_m: 501,
        limit_m: 500,
    };
    assert_eq!(s.ask(goal(-300.0, 400.5, None)), too_far);
    assert_eq!(s.guidance.goal(), before);
    assert_eq!(s.ask(goal(-300.0, 400.0, None)), RequestOutcome::Accepted);
    s.reconfigure(|config| config.goal_limit_m = 1000.0);
    assert_eq!(s.ask(goal(-300.0, 400.5, None)), RequestOutcome::Accepted);
}

#[test]
fn a_landing_that_was_due_is_not_ordered_over_who_has_just_taken_the_vehicle() {
    let mut s = Story::guided(GuidanceConfig {
        at_goal: AtGoal::Land,
        ..auto()
    });
    s.position_ned_m = NedVector::new(20.0, 5.0, -3.0);
    s.run(seconds(1.8));
    s.mode = VehicleMode::Other;
    let states: Vec<_> = (0..seconds(3.0)).map(|_| s.step()).collect();
    assert!(
        states
            .iter()
            .all(|out| out.state != Land && out.request == VehicleRequest::None)
    );
    assert!(s.guidance.taken_over());
}
