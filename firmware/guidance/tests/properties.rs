//! What holds for any sequence of inputs, however mad.

mod common;

use common::{QUIET, Story};
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::RngSeed;
use vigil_guidance::{AlarmPolicy, AtGoal, EngagePolicy, FrameStatus, Geofence, GuidanceConfig};
use vigil_types::{
    Action, AlarmResponse, GuidanceState, HandoverProgress, NedVector, OperatorRequest, Reason, Reasons, STEP_NS,
    VehicleMode, VelocitySetpoint, Verdict,
};

/// What a recovery pilot wants that has nothing to complain about.
const RECOVERY: Action = Action {
    forward_m_s: 0.6,
    yaw: 0.1,
};

fn number() -> impl Strategy<Value = f32> {
    prop_oneof![6 => -30.0f32..30.0, 1 => any::<f32>(), 1 => Just(f32::NAN), 1 => Just(f32::INFINITY)]
}

fn mode() -> impl Strategy<Value = VehicleMode> {
    use VehicleMode::{External, Hold, Land, Other, Unknown};
    select(&[External, External, External, Hold, Land, Unknown, Other][..])
}

fn handover() -> impl Strategy<Value = HandoverProgress> {
    use HandoverProgress::{Done, Failed, Idle, InProgress};
    let in_progress = [false, true].map(|stream_setpoints| InProgress { stream_setpoints });
    select([&in_progress[..], &[Idle, Failed, Done]].concat())
}

fn action() -> impl Strategy<Value = Option<Action>> {
    option::of([number(), number()].prop_map(|[forward_m_s, yaw]| Action { forward_m_s, yaw }))
}

fn verdict() -> impl Strategy<Value = Option<Verdict>> {
    use Verdict::{Attack, Clean, Unknown};
    select(&[Some(Attack), Some(Attack), Some(Unknown), Some(Clean), None][..])
}

fn sensor_faults() -> impl Strategy<Value = Reasons> {
    let (blind, frozen) = (Reasons::of(Reason::BlindSensor), Reasons::of(Reason::FrozenSensor));
    select(vec![Reasons::NONE, blind, frozen])
}

fn request() -> impl Strategy<Value = OperatorRequest> {
    use OperatorRequest::{Disengage, Engage, Goal, Land};
    let goal = |(north_m, east_m, height_m)| Goal {
        north_m,
        east_m,
        height_m,
    };
    let goals = (number(), number(), option::of(number())).prop_map(goal);
    prop_oneof![3 => select(&[Engage, Disengage, Land][..]), 1 => goals]
}

/// What may happen to a story: how often, what it holds and where that is from, and what it changes.
macro_rules! events {
    ($($weight:literal $name:ident($held:ty): $from:expr, |$s:ident, $value:pat_param| $change:expr;)+) => {
        #[derive(Debug, Clone)]
        enum Event {
            $($name($held),)+
            Steps(usize),
        }

        fn event() -> impl Strategy<Value = Event> {
            prop_oneof![$($weight => $from.prop_map(Event::$name),)+ 6 => (1usize..45).prop_map(Event::Steps)]
        }

        /// Steps that follow.
        fn apply(story: &mut Story, event: &Event) -> usize {
            match *event {
                $(Event::$name($value) => {
                    let $s = story;
                    $change;
                    1
                })+
                Event::Steps(steps) => steps,
            }
        }
    };
}

events! {
    2 Mode(VehicleMode): mode(), |s, mode| s.mode = mode;
    1 Armed(bool): any::<bool>(), |s, armed| s.armed = armed;
    1 Failsafe(bool): any::<bool>(), |s, failsafe| s.failsafe = failsafe;
    2 Position([f32; 3]): [number(), number(), number()], |s, [x, y, z]| s.position_ned_m = NedVector::new(x, y, z);
    1 Battery(Option<f32>): option::of(0.0f32..1.0), |s, battery| s.battery = battery;
    2 Frame((Option<u64>, bool)): (option::of(0u64..500_000_000), any::<bool>()),
        |s, frame| (s.frame.age_ns, s.frame.refused) = frame;
    2 SensorFaults(Reasons): sensor_faults(), |s, sensor_faults| s.frame.sensor_faults = sensor_faults;
    1 TelemetryAge(u64): (0u64..600_000_000), |s, age_ns| s.telemetry_age_ns = age_ns;
    1 HeartbeatAge(Option<u64>): option::of(0u64..3_000_000_000), |s, age_ns| s.heartbeat_age_ns = age_ns;
    3 Action(Option<Action>): action(), |s, action| s.action = action;
    2 Recovery(Option<Action>): action(), |s, action| s.recovery = action;
    4 Verdict(Option<Verdict>): verdict(), |s, verdict| s.verdict = verdict;
    2 CollisionCourse(bool): any::<bool>(), |s, course| s.risk.collision_course = course;
    1 RecoveryCourse(bool): any::<bool>(), |s, course| s.risk.recovery_course = course;
    1 SpeedAlongPath(f32): number(), |s, speed| s.risk.speed_along_path_m_s = speed;
    1 Velocity([f32; 3]): [number(), number(), number()], |s, [x, y, z]| s.velocity_ned_m_s = NedVector::new(x, y, z);
    2 Handover(HandoverProgress): handover(), |s, handover| s.vehicle.handover = handover;
    1 Slips(u64): (0u64..9), |s, slips| s.timing.slips += slips;
    1 Restart(()): Just(()), |s, ()| s.vehicle.restarts += 1;
    3 Request(OperatorRequest): request(), |s, request| _ = s.ask(request);
    8 Good(()): Just(()), |s, ()| good(s);
}

fn config() -> impl Strategy<Value = GuidanceConfig> {
    let engage = select(&[EngagePolicy::Command, EngagePolicy::Auto][..]);
    let at_goal = select(&[AtGoal::Hold, AtGoal::Land][..]);
    let policy = select(&[AlarmPolicy::Ignore, AlarmPolicy::Stop, AlarmPolicy::Recover][..]);
    (engage, at_goal, any::<bool>(), any::<bool>(), policy).prop_map(|(engage, at_goal, fence, limit, policy)| {
        let mut config = GuidanceConfig {
            engage,
            at_goal,
            geofence: fence.then_some(Geofence {
                radius_m: 50.0,
                min_height_m: 0.5,
                max_height_m: 20.0,
            }),
            time_limit_ns: limit.then_some(5_000_000_000),
            ..Default::default()
        };
        config.alarm.policy = policy;
        config
    })
}

/// Makes every input good again, in the air.
fn good(s: &mut Story) {
    s.hand_over();
    s.position_ned_m = NedVector::new(5.0, 0.0, -3.0);
    s.frame = FrameStatus {
        age_ns: Some(STEP_NS),
        ..FrameStatus::default()
    };
    (s.telemetry_age_ns, s.heartbeat_age_ns, s.battery) = (0, Some(0), Some(0.9));
    s.action = Some(Action::new(1.2, -0.7));
    s.recovery = Some(RECOVERY);
    s.verdict = Some(Verdict::Clean);
    s.risk = QUIET;
    s.velocity_ned_m_s = NedVector::ZERO;
}

/// Every condition that must stop motion, derived anew from the inputs, without the state machine's code.
fn something_is_wrong(s: &Story) -> bool {
    let t = s.telemetry();
    let p = s.position_ned_m;
    s.frame.refused
        || !s.frame.sensor_faults.is_empty()
        || s.frame.age_ns.is_none_or(|age| age > 250_000_000)
        || s.telemetry_age_ns > 300_000_000
        || s.heartbeat_age_ns.is_none_or(|age| age > 1_500_000_000)
        || !(p.x.is_finite() && p.y.is_finite() && p.z.is_finite())
        || t.heartbeat
            .is_none_or(|h| !h.armed || h.failsafe || h.mode != VehicleMode::External)
        || s.battery.is_some_and(|b| b < 0.15)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn motion_needs_guided_and_guided_needs_every_input(config in config(), flying in any::<bool>(), events in proptest::collection::vec(event(), 1..80)) {
        let mut s = if flying { Story::guided(config) } else { Story::begin(config) };
        prop_assert_eq!(s.step().setpoint.is_some_and(|v| v != VelocitySetpoint::HOLD), flying);
        for event in &events {
            for _ in 0..apply(&mut s, event) {
                let out = s.step();
                prop_assert_eq!(out.state, s.guidance.state());
                if let Some(v) = out.setpoint {
                    prop_assert!(v.is_finite());
                    prop_assert!(v.velocity_m_s.x.abs() <= 1.5 && v.velocity_m_s.y == 0.0 && v.velocity_m_s.z.abs() <= 0.5);
                    prop_assert!(v.yaw_rate_rad_s.to_degrees().abs() <= 45.001);
                    if v != VelocitySetpoint::HOLD {
                        prop_assert_eq!(out.state, GuidanceState::Guided);
                        prop_assert!(!something_is_wrong(&s), "moves although {:?}", out.reasons);
                        // Who moves it: the recovery pilot exactly while it recovers, and never an action that is not finite.
                        let recovers = out.reasons.contains(Reason::Recovering);
                        let moved_by = if recovers { s.recovery } else { s.action };
                        let forward_m_s = moved_by.expect("somebody decides").clipped().forward_m_s;
                        // Far from the goal's height nobody moves it ahead.
                        let off_m = s.guidance.goal().map_or(0.0, |goal| (goal.position_ned_m.z - s.position_ned_m.z).abs());
                        let most_m_s = if off_m > 1.0 { 0.0 } else { forward_m_s.abs() };
                        prop_assert!(v.velocity_m_s.x.abs() <= most_m_s);
                        prop_assert!(off_m > 0.5 || v.velocity_m_s.x == forward_m_s);
                        prop_assert!(moved_by.is_some_and(Action::is_finite));
                        for stops in [Reason::Attack, Reason::NoVerdict, Reason::CollisionCourse, Reason::LedAstray, Reason::Disagreement, Reason::RoughPicture] {
                            prop_assert!(!out.reasons.contains(stops));
                        }
                        let answered = out.alarm.is_none_or(|alarm| alarm.response != AlarmResponse::Stop);
                        prop_assert!(answered, "moves although it should stop");
                    }
                }
                match out.state {
                    GuidanceState::Standby | GuidanceState::Ready => prop_assert!(out.setpoint.is_none()),
                    GuidanceState::Guided | GuidanceState::Hold => prop_assert!(out.setpoint.is_some()),
                    GuidanceState::Engaging | GuidanceState::Land => {}
                }
                if out.state == GuidanceState::Hold && out.transition.is_some() {
                    prop_assert!(!out.reasons.is_empty(), "a hold names its reason");
                }
            }
        }
    }

    /// The same inputs give the same outputs: the machine holds nothing but its own state.
    #[test]
    fn the_same_story_has_the_same_end(config in config(), events in proptest::collection::vec(event(), 1..60)) {
        let (mut a, mut b) = (Story::begin(config), Story::begin(config));
        for event in &events {
            for _ in 0..apply(&mut a, event) {
                a.step();
            }
            for _ in 0..apply(&mut b, event) {
                b.step();
            }
            // As text: an action that is not a number equals itself there.
            prop_assert_eq!(format!("{:?}", a.last), format!("{:?}", b.last));
        }
    }

    /// Whatever happened before: with good inputs and an operator's goal and engage, guidance flies again within a minute.
    #[test]
    fn no_history_locks_guidance_up(config in config(), events in proptest::collection::vec(event(), 1..60)) {
        // The vehicle of this story stays where it is.
        let mut s = Story::begin(GuidanceConfig { time_limit_ns: None, no_progress_limit_ns: None, ..config });
        for event in &events {
            for _ in 0..apply(&mut s, event) {
                s.step();
            }
        }
        good(&mut s);
        for n in 0..1200 {
            if n % 20 == 0 {
                s.ask(common::GOAL);
                s.ask(OperatorRequest::Engage);
            }
            if s.step().state == GuidanceState::Guided {
                break;
            }
        }
        prop_assert_eq!(s.guidance.state(), GuidanceState::Guided, "{:?}", s.last);
        // Forty, doubled with each alarm that ended, six times at the most.
        prop_assert_eq!(s.run(5 + (40 << 6)).reasons, Reasons::NONE, "and the alarm ends with clean verdicts");
        prop_assert!(!s.last.is_some_and(|o| o.reasons.contains(Reason::Operator)));
    }
}
