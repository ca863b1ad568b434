//! An alarm: stop, recovery, and the way back to the actor.

use super::*;

/// What the recovery pilot wants in these stories; the actor wants 1.0 m/s.
const RECOVERY: Action = Action {
    forward_m_s: 0.6,
    yaw: -0.25,
};

/// A flight at 1 m/s under a detector.
fn monitored(policy: AlarmPolicy) -> Story {
    let mut s = Story::guided(auto());
    s.reconfigure(|config| config.alarm.policy = policy);
    s.recovery = Some(RECOVERY);
    s.verdict = Some(Verdict::Clean);
    s.velocity_ned_m_s.x = 1.0;
    assert_eq!(sent_m_s(s.run(seconds(1.0))), 1.0, "the actor flies");
    s
}

/// The same, and the guard raises the alarm when the actor falls 6 m behind.
fn monitored_for_leading_astray() -> Story {
    let mut s = monitored(AlarmPolicy::Recover);
    s.reconfigure(|config| config.alarm.astray_limit_m = 6.0);
    s
}

/// The vehicle stops, and then the recovery pilot flies on.
#[track_caller]
fn recovers(s: &mut Story) -> GuidanceOutput {
    s.velocity_ned_m_s.x = 0.0;
    s.until(Guided);
    let out = s.last.unwrap();
    let expected = (Reasons::of(Reason::Recovering), s.recovery);
    assert_eq!((out.reasons, out.action), expected);
    out
}

#[test]
fn an_attacked_vehicle_stops_then_the_recovery_pilot_flies_and_the_actor_gets_it_back_when_the_attack_is_over() {
    let mut s = monitored(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    let fourth = s.run(4);
    assert_eq!(
        (fourth.state, fourth.alarm),
        (Guided, None),
        "four verdicts are not an alarm"
    );
    let alarm = s.step();
    assert_holds(alarm, Reason::Attack);
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

    // An operator who trusts the actor does not end what the verdict raised.
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
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
    assert_eq!(sent_m_s(s.run(39)), 0.6, "unknown is not clean");
    let over = s.step();
    assert_eq!((over.alarm, over.reasons), (None, Reasons::NONE));
    assert_eq!(sent_m_s(over), 1.0, "the actor flies again");
}

#[test]
fn with_the_policy_stop_the_vehicle_stays_until_the_verdict_is_clean() {
    let mut s = monitored(AlarmPolicy::Stop);
    s.verdict = Some(Verdict::Attack);
    s.run(5);
    s.velocity_ned_m_s.x = 0.0;
    assert_eq!(s.ends(seconds(60.0)), (Hold, Reasons::of(Reason::Attack)));
    s.verdict = Some(Verdict::Clean);
    // Forty clean verdicts, and with the last of them the first of ten steps without a condition.
    assert_eq!(s.until(Guided), 49);
    assert_eq!(sent_m_s(s.last.unwrap()), 1.0);
}

#[test]
fn with_the_policy_ignore_the_alarm_is_reported_and_the_flight_is_not_touched() {
    let mut s = monitored(AlarmPolicy::Ignore);
    s.verdict = Some(Verdict::Attack);
    let out = s.run(seconds(5.0));
    assert_eq!((out.state, out.reasons), (Guided, Reasons::NONE));
    assert_eq!(out.alarm.unwrap().response, AlarmResponse::Ignored);
    assert_eq!(sent_m_s(out), 1.0);
}

#[test]
fn an_actor_without_a_verdict_is_not_trusted_for_longer_than_half_a_second() {
    let mut s = monitored(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Unknown);
    assert_eq!(s.run(10).alarm, None);
    assert_holds(s.step(), Reason::NoVerdict);
    recovers(&mut s);
    assert_eq!(sent_m_s(s.run(seconds(10.0))), 0.6);
    s.verdict = Some(Verdict::Attack);
    assert_eq!(s.run(5).alarm.unwrap().cause, AlarmCause::Attack);
    assert_eq!(s.last.unwrap().state, Guided, "the recovery pilot need not stop for it");
}

#[test]
fn an_actor_about_to_fly_into_something_is_stopped_although_every_verdict_is_clean() {
    let mut s = monitored(AlarmPolicy::Recover);
    s.risk.collision_course = true;
    assert_eq!(s.run(3).alarm, None, "a few steps may be noise");
    assert_holds(s.step(), Reason::CollisionCourse);
    recovers(&mut s);

    // The clean verdicts that brought it here do not give it back: rough pictures are no clean steps.
    s.risk.collision_course = false;
    s.smooth_share = Some(0.3);
    let flying = s.run(seconds(60.0));
    assert_eq!(
        (flying.reasons, sent_m_s(flying)),
        (Reasons::of(Reason::Recovering), 0.6)
    );
    s.verdict = Some(Verdict::Attack);
    assert_eq!(s.run(5).alarm.unwrap().cause, AlarmCause::CollisionCourse);
    (s.verdict, s.smooth_share) = (Some(Verdict::Clean), Some(0.9));

    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    let trusted = s.step();
    assert_eq!((trusted.alarm, sent_m_s(trusted)), (None, 1.0));

    // What it was about to meet passes by: the second time, and the third, it waits twice as long as the time before.
    for clean_steps in [80, 160] {
        s.risk.collision_course = true;
        assert_eq!(s.run(4).alarm.unwrap().cause, AlarmCause::CollisionCourse);
        s.risk.collision_course = false;
        assert!(s.run(clean_steps - 1).alarm.is_some());
        assert_eq!(s.step().alarm, None);
    }
}

#[test]
fn with_the_policy_stop_a_vehicle_that_the_guard_stopped_waits_for_an_operator() {
    let mut s = monitored(AlarmPolicy::Stop);
    s.risk.collision_course = true;
    s.run(4);
    s.risk.collision_course = false;
    assert_eq!(s.ends(seconds(300.0)), (Hold, Reasons::of(Reason::CollisionCourse)));
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    s.until(Guided);
    assert_eq!(sent_m_s(s.last.unwrap()), 1.0);
}

#[test]
fn an_actor_that_goes_away_from_the_guard_s_way_is_stopped_although_every_verdict_is_clean() {
    let mut s = monitored_for_leading_astray();
    s.risk.speed_along_path_m_s = 0.8;
    assert_eq!(s.run(seconds(30.0)).alarm, None, "it gets on");
    // Astray, away from the way.
    s.risk.speed_along_path_m_s = -1.0;
    s.velocity_ned_m_s.x = 1.0;
    let flown = s.until(Hold);
    assert!((80..90).contains(&flown), "6 m at 1.5 m/s, found after {flown} steps");
    let stop = s.last.unwrap();
    assert_holds(stop, Reason::LedAstray);
    assert_eq!(stop.alarm.unwrap().cause, AlarmCause::LedAstray);
    recovers(&mut s);
    s.risk.speed_along_path_m_s = 0.6;
    assert_eq!(s.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
    assert_eq!(s.step().alarm, None, "the operator trusts it again");
}

#[test]
fn an_actor_that_waits_or_flies_round_something_or_is_held_is_not_taken_for_one_that_goes_astray() {
    let mut s = monitored_for_leading_astray();
    for speed_m_s in [0.0, 0.8, -0.3, 0.8, 0.0, 1.2] {
        s.risk.speed_along_path_m_s = speed_m_s;
        assert_eq!(s.run(seconds(3.0)).alarm, None, "{speed_m_s}");
    }
    // A hold is not the actor's doing.
    s.risk.speed_along_path_m_s = 0.0;
    s.frame.age_ns = Some(1_000_000_000);
    assert_eq!(s.run(seconds(30.0)).alarm, None);
}

#[test]
fn an_actor_that_goes_on_turning_the_other_way_than_the_planner_is_stopped_although_it_gets_on() {
    let mut s = monitored(AlarmPolicy::Recover);
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
    assert!((70..72).contains(&s.until(Hold)));
    let stop = s.last.unwrap();
    assert_holds(stop, Reason::Disagreement);
    assert_eq!(stop.alarm.unwrap().cause, AlarmCause::Disagreement);
    // The clean steps before it do not count.
    assert!(recovers(&mut s).alarm.is_some());
}

#[test]
fn without_the_guard_a_collision_course_raises_nothing_and_an_actor_may_go_as_far_astray_as_it_likes() {
    let mut s = monitored_for_leading_astray();
    s.reconfigure(|config| config.alarm = config.alarm.without_guard());
    (s.risk.collision_course, s.risk.speed_along_path_m_s) = (true, -1.0);
    assert_eq!(s.run(seconds(60.0)).alarm, None);
}

#[test]
fn the_recovery_pilot_is_stopped_before_what_it_would_fly_into_and_begins_anew_from_there() {
    let mut s = monitored(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    s.run(5);
    recovers(&mut s);
    s.velocity_ned_m_s.x = 0.6;
    s.risk.recovery_course = true;
    assert_eq!(s.step().state, Guided, "one step may be noise");
    assert_holds(s.step(), Reason::CollisionCourse);
    s.risk.recovery_course = false;
    let again = recovers(&mut s);
    // Its own error says nothing of the actor: the alarm is still the verdict's, and ends as such.
    assert_eq!(again.alarm.unwrap().cause, AlarmCause::Attack);
    s.verdict = Some(Verdict::Clean);
    s.run(40);
    assert_eq!(s.last.unwrap().alarm, None);
}

#[test]
fn a_recovery_pilot_without_an_action_leaves_the_vehicle_holding() {
    let mut s = monitored(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    s.recovery = None;
    s.velocity_ned_m_s.x = 0.0;
    let out = s.run(seconds(10.0));
    assert_eq!(out.state, Hold);
    assert!(out.reasons.contains(Reason::NotFinite) && out.reasons.contains(Reason::Recovering));
}

#[test]
fn an_operator_changes_the_policy_in_flight() {
    let mut s = monitored(AlarmPolicy::Stop);
    s.verdict = Some(Verdict::Attack);
    s.velocity_ned_m_s.x = 0.0;
    assert_eq!(s.run(seconds(5.0)).state, Hold);
    s.reconfigure(|config| config.alarm.policy = AlarmPolicy::Recover);
    s.until(Guided);
    assert_eq!(sent_m_s(s.last.unwrap()), 0.6);
}

#[test]
fn an_alarm_lasts_no_longer_than_its_flight() {
    let mut s = monitored(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    assert!(s.run(seconds(1.0)).alarm.is_some());
    s.armed = false;
    assert_eq!(s.until(Standby), 1);
    assert_eq!(s.run(50).alarm, None, "what is scored on the ground raises nothing");

    let mut s = monitored(AlarmPolicy::Recover);
    (s.verdict, s.risk.collision_course, s.frame.refused) = (Some(Verdict::Attack), true, true);
    assert_eq!(s.run(50).alarm, None, "nor does what is scored while the vehicle holds");
}

#[test]
fn four_verdicts_of_six_raise_nothing_and_five_do() {
    use Verdict::{Attack, Clean, Unknown};
    let raised_at = |verdicts: &[Verdict]| {
        let mut s = monitored(AlarmPolicy::Recover);
        verdicts.iter().position(|verdict| {
            s.verdict = Some(*verdict);
            s.step().alarm.is_some()
        })
    };
    let four = [
        Attack, Attack, Clean, Attack, Attack, Clean, Attack, Attack, Unknown, Attack,
    ];
    assert_eq!(raised_at(&four), None);
    assert_eq!(raised_at(&[Attack, Attack, Unknown, Attack, Attack, Attack]), Some(5));
}

#[test]
fn a_vehicle_that_gusts_keep_moving_is_handed_to_the_recovery_pilot_all_the_same() {
    let mut s = monitored(AlarmPolicy::Recover);
    s.verdict = Some(Verdict::Attack);
    let response = |out: GuidanceOutput| out.alarm.unwrap().response;
    assert_eq!(response(s.run(64)), AlarmResponse::Stop);
    assert_eq!(response(s.step()), AlarmResponse::Recovery, "3 s after the alarm");
}

/// Steps, before each of which `change` is given the next of these values, over and over, until the one that raises the alarm for this cause.
fn steps_until(cause: AlarmCause, mut s: Story, values: &[f32], change: impl Fn(&mut Story, f32)) -> Option<usize> {
    s.reconfigure(|config| config.no_progress_limit_ns = None);
    (0..2400).find(|&i| {
        change(&mut s, values[i % values.len()]);
        s.step().alarm.map(|alarm| alarm.cause) == Some(cause)
    })
}

#[test]
fn pictures_that_are_rough_again_and_again_raise_the_alarm_for_good_and_single_ones_do_not() {
    let steps_until_rough = |smooth_shares: &[f32], limit: f32| {
        let mut s = monitored(AlarmPolicy::Recover);
        s.reconfigure(|config| config.alarm.smooth_share = limit);
        steps_until(AlarmCause::RoughPicture, s, smooth_shares, |s, share| {
            s.smooth_share = Some(share)
        })
    };
    assert_eq!(steps_until_rough(&[0.3], ROUGH_BELOW), Some(4));
    assert_eq!(steps_until_rough(&[0.3, 0.3, 0.8], ROUGH_BELOW), None);
    assert_eq!(steps_until_rough(&[0.65], ROUGH_BELOW), None, "a crowded hall");
    assert_eq!(steps_until_rough(&[f32::NAN], ROUGH_BELOW), None);
    assert_eq!(steps_until_rough(&[0.0], 0.0), None);
    assert!(AlarmCause::RoughPicture.is_of_guard());
}

#[test]
fn a_vehicle_turned_away_is_found_in_seconds_one_turned_in_circles_later_and_one_that_gets_on_never() {
    let steps_until_astray = |speeds_m_s: &[f32]| {
        let mut s = monitored(AlarmPolicy::Recover);
        s.reconfigure(|config| (config.alarm.astray_limit_m, config.alarm.path_speed_m_s) = (3.0, 0.3));
        steps_until(AlarmCause::LedAstray, s, speeds_m_s, |s, m_s| {
            s.risk.speed_along_path_m_s = m_s
        })
    };
    let away = steps_until_astray(&[-1.2]);
    assert!(
        away.is_some_and(|steps| (39..=40).contains(&steps)),
        "3 m at 1.5 m/s: two seconds"
    );
    let in_circles = steps_until_astray(&[1.2, -1.2]);
    assert!(
        in_circles.is_some_and(|steps| (180..240).contains(&steps)),
        "3 m at 0.3 m/s: ten seconds"
    );
    assert_eq!(steps_until_astray(&[0.4]), None);
    // Round something, away for a second and on for two.
    let detour: Vec<f32> = (0..60).map(|i| if i < 20 { -0.5 } else { 1.2 }).collect();
    assert_eq!(steps_until_astray(&detour), None);
    assert_eq!(steps_until_astray(&[f32::NAN]), None);
}

#[test]
fn pilots_that_turn_apart_more_often_than_not_raise_the_alarm_and_those_that_differ_now_and_then_do_not() {
    let steps_until_disagreement = |apart: &[f32]| {
        let s = monitored(AlarmPolicy::Recover);
        steps_until(AlarmCause::Disagreement, s, apart, |s, apart| {
            s.action.as_mut().unwrap().yaw = -1.5;
            s.recovery.as_mut().unwrap().yaw = apart - 1.5;
        })
    };
    assert!(steps_until_disagreement(&[3.0, 3.0, 0.0]).is_some_and(|steps| (200..220).contains(&steps)));
    assert_eq!(steps_until_disagreement(&[3.0, 0.0]), None);
    assert_eq!(steps_until_disagreement(&[1.9]), None, "a swerve");
    assert_eq!(steps_until_disagreement(&[f32::NAN]), None);
}
