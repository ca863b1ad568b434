//! Detector and guard: what raises the alarm, and what is refused.

use super::*;

#[test]
fn an_attacked_actor_is_stopped_and_replaced_and_reported_and_gets_its_place_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut flight = Flight::guided_by(&monitored_config(folder.path()));
    let alarms = |flight: &Flight| texts(&flight.vehicle, "alarm");
    flight.fastest_m_s(1);
    let judgement = flight.last.judgement.unwrap();
    assert_eq!((judgement.verdict, judgement.score), (Verdict::Clean, Some(0.5)));
    assert_eq!(values(&flight.vehicle, "dt_state").last(), Some(&1.0));
    assert_eq!(values(&flight.vehicle, "dt_score").last(), Some(&0.5));
    for contribution in ["dt_img", "dt_bear", "dt_dist"] {
        let last = values(&flight.vehicle, contribution).pop();
        assert!(last.is_some_and(|v| v.is_finite()));
    }

    flight.vehicle.heard.clear();
    assert_eq!(flight.set("DT_THRESH", 0.4, MavParamType::MAV_PARAM_TYPE_REAL32), 0.4);
    assert_eq!(flight.last.judgement.unwrap().verdict, Verdict::Attack);
    assert_eq!(values(&flight.vehicle, "dt_state"), [2.0], "at once");
    for _ in 0..3 {
        assert_eq!(flight.step().alarm, None);
    }
    let alarm = flight.step();
    assert_eq!(
        (alarm.state, alarm.reasons),
        (GuidanceState::Hold, Reasons::of(Reason::Attack))
    );
    assert_eq!(flight.velocity(), [0.0; 4]);
    assert_eq!(alarms(&flight), [(2, "alarm: attack, stopping".to_owned())]);

    flight.until(GuidanceState::Guided, 5.0);
    assert_eq!(flight.last.reasons, Reasons::of(Reason::Recovering));
    let before_m = flight.vehicle.position_ned_m.x;
    flight.fastest_m_s(5);
    assert!(
        flight.vehicle.position_ned_m.x > before_m + 1.5,
        "the recovery pilot flies on"
    );
    assert_eq!(alarms(&flight).last().unwrap().1, "alarm: attack, recovery pilot flies");

    flight.set("DT_THRESH", 0.6, MavParamType::MAV_PARAM_TYPE_REAL32);
    for _ in 0..38 {
        assert!(flight.step().reasons.contains(Reason::Recovering));
    }
    assert_eq!(flight.step().alarm, None);
    assert_eq!(alarms(&flight).last().unwrap(), &(6, "alarm: clear".to_owned()));
}

#[test]
fn an_operator_sets_policy_and_threshold_and_values_out_of_range_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut flight = Flight::guided_by(&monitored_config(folder.path()));
    let integer = |value: u32| f32::from_bits(value);
    assert_eq!(flight.set("DT_THRESH", 1.5, MavParamType::MAV_PARAM_TYPE_REAL32), 0.6);
    let policy = flight.set("DT_ALARM", integer(3), MavParamType::MAV_PARAM_TYPE_INT32);
    assert_eq!(policy.to_bits(), 2);
    let policy = flight.set("DT_ALARM", integer(0), MavParamType::MAV_PARAM_TYPE_INT32);
    assert_eq!(policy.to_bits(), 0);
    flight.set("DT_THRESH", 0.4, MavParamType::MAV_PARAM_TYPE_REAL32);
    flight.fastest_m_s(2);
    assert!(flight.last.alarm.is_some());
    assert_eq!(flight.last.state, GuidanceState::Guided, "said, and not acted upon");
    flight.set("DT_ALARM", integer(1), MavParamType::MAV_PARAM_TYPE_INT32);
    assert_eq!(flight.last.state, GuidanceState::Hold);
}

#[test]
fn a_gap_in_the_frames_means_hold_and_leaves_the_verdict_unknown_until_ten_explanations_are_there_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut flight = Flight::guided_by(&monitored_config(folder.path()));
    for _ in 0..8 {
        let telemetry = flight.vehicle.telemetry();
        flight.step_with(None, &telemetry);
    }
    assert_eq!((flight.last.judgement, flight.last.state), (None, GuidanceState::Hold));
    assert!(flight.last.reasons.contains(Reason::StaleFrame), "within half a second");
    assert_eq!((flight.velocity(), flight.last.action), ([0.0; 4], None));
    for _ in 0..9 {
        assert_eq!(flight.step().judgement.unwrap().verdict, Verdict::Unknown);
    }
    assert_eq!(flight.step().judgement.unwrap().verdict, Verdict::Clean);
    flight.until(GuidanceState::Guided, 5.0);
}

#[test]
fn odometry_that_jumps_makes_the_actor_forget_what_it_saw_and_people_read_it_once() {
    let folder = tempfile::tempdir().unwrap();
    // With the check of frames, those of a pose that jumps are refused for half a second: the actor sees the jump after it.
    for (plausibility, jump_m) in [(false, 30.0), (true, 5.0)] {
        let config = FirmwareConfig {
            plausibility,
            ..monitored_config(folder.path())
        };
        let mut flight = Flight::guided_by(&config);
        let jumps = |flight: &Flight| texts(&flight.vehicle, "the position jumped").len();
        assert_eq!(jumps(&flight), 0);
        flight.vehicle.position_ned_m.y += jump_m;
        flight.fastest_m_s(1);
        assert_eq!(jumps(&flight), 1, "{jump_m} m");
    }
}

#[test]
fn a_detector_that_cannot_judge_the_actor_is_refused_by_name_before_anything_flies() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = monitored_config(folder.path());
    let file = config.detector.file.clone().unwrap();
    let refused = |why: &str| {
        let error = LockstepFirmware::new(&config).err().unwrap().to_string();
        assert!(
            error.contains("undecided.safetensors") && error.contains(why),
            "{error}"
        );
    };

    let mut other = undecided_detector();
    other.actor_sha256 = "0123".to_owned();
    other.save(&file).unwrap();
    refused("0123");

    undecided_detector().save(&file).unwrap();
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&file, &bytes).unwrap();
    refused("altered");

    std::fs::write(&file, &bytes[..middle]).unwrap();
    refused("truncated");

    config.detector.enabled = Some(false);
    assert!(LockstepFirmware::new(&config).is_ok());
}

/// What raises the alarm in so many steps in which a vehicle in full flight is carried north at so many m/s, whatever it is
/// sent, with a wall so many metres ahead.
fn alarm_while_carried(
    config: &FirmwareConfig,
    (north_m_s, wall_ahead_m, steps): (f32, f32, usize),
) -> Option<AlarmCause> {
    let mut flight = Flight::guided_by(config);
    flight.fastest_m_s(3);
    assert!(flight.velocity()[0] > 1.2, "{:?}", flight.velocity());
    let carried_m_s = NedVector::new(north_m_s, 0.0, 0.0);
    let wall_north_m = flight.vehicle.position_ned_m.x + wall_ahead_m;
    (0..steps).find_map(|_| {
        flight.vehicle.velocity_ned_m_s = carried_m_s;
        let (from, yaw_rad) = (flight.vehicle.position_ned_m, flight.vehicle.yaw_rad);
        let frame = flight.vehicle.frame_with_wall(flight.now_ns, wall_north_m);
        let telemetry = flight.vehicle.telemetry();
        let alarm = flight.step_with(Some(&frame), &telemetry).alarm;
        (flight.vehicle.position_ned_m, flight.vehicle.yaw_rad) = (from + carried_m_s * STEP_S, yaw_rad);
        alarm.map(|alarm| alarm.cause)
    })
}

#[test]
fn the_guard_stops_an_actor_before_a_wall_or_off_its_way_with_and_without_the_detector_and_either_can_be_off() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = monitored_config(folder.path());
    // A wall that was not there a moment ago is no plausible picture.
    config.plausibility = false;
    // A gust carries it to a wall, where it would be after 29 steps; or away from its goal over open ground, for 22 seconds.
    let to_wall = ((1.5, 2.2, 28), AlarmCause::CollisionCourse);
    let away = ((-0.5, f32::INFINITY, 450), AlarmCause::LedAstray);
    for (detector, guard, is_raised) in [
        (false, Some(true), true),
        (true, Some(true), true),
        (true, None, true),
        (true, Some(false), false),
        (false, Some(false), false),
        (false, None, false),
    ] {
        config.detector.enabled = Some(detector);
        config.detector.guard = guard;
        for (carried, cause) in [to_wall, away] {
            let raised = alarm_while_carried(&config, carried);
            let expected = is_raised.then_some(cause);
            assert_eq!(raised, expected, "detector {detector}, guard {guard:?}, {carried:?}");
        }
    }

    // The detector alone: its verdict raises the alarm without any wall.
    config.detector.enabled = Some(true);
    config.detector.guard = Some(false);
    config.detector.threshold = Some(0.4);
    let mut flight = Flight::guided_by(&config);
    let cause = (0..40).find_map(|_| flight.step().alarm.map(|alarm| alarm.cause));
    assert_eq!(cause, Some(AlarmCause::Attack));
}

#[test]
fn a_guard_without_an_actor_to_watch_is_refused_by_name() {
    let mut config = config();
    config.detector.guard = Some(true);
    let error = LockstepFirmware::new(&config).err().unwrap().to_string();
    assert!(
        error.contains("the guard is on") && error.contains("geometric pilot"),
        "{error}"
    );
}
