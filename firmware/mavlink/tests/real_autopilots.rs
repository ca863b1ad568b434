//! What real autopilots, their ground stations and their pilots do to a guidance computer.

mod common;

use common::peer::{Mode, Peer};
use common::{
    Bench, Flight, GROUND_STATION, ME, VEHICLE, bytes_of, command_long, heartbeat, messages, named_values, report,
    reposition, texts,
};
use vigil_guidance::{EngagePolicy, GuidanceConfig};
use vigil_mavlink::Flavour::{self, ArduPilot, Px4};
use vigil_mavlink::common::{MavAutopilot, MavCmd, MavFrame, MavMessage, MavResult};
use vigil_mavlink::{Companion, CompanionConfig, message};
use vigil_types::GuidanceState::{Engaging, Guided, Hold, Ready, Standby};
use vigil_types::ObstacleReports;
use vigil_types::{
    Datagrams, NedVector, OperatorRequest, Reason, Reasons, RequestOutcome, STEP_NS, StepReport, VehicleMode,
    VehicleRequest,
};

fn seconds(s: f64) -> usize {
    (s / 0.05).round() as usize
}

/// A flight under way whose goal is far.
fn far_flight(flavour: Flavour) -> Flight {
    let mut f = Flight::on_command(flavour, Peer::on_the_ground(flavour));
    let goal = OperatorRequest::Goal {
        north_m: 500.0,
        east_m: 0.0,
        height_m: Some(3.0),
    };
    assert_eq!(f.guidance.request(goal), RequestOutcome::Accepted);
    f.engage_and_fly();
    f.run(seconds(5.0));
    f
}

#[test]
fn streams_that_a_ground_station_slows_to_2_hz_are_asked_for_again_and_the_flight_goes_on() {
    for flavour in [Px4, ArduPilot] {
        let mut f = far_flight(flavour);
        f.peer.commands.clear();
        f.texts.clear();
        f.peer.slowed_to_steps = Some(10);
        f.until(Hold);
        assert!(f.last.unwrap().reasons.contains(Reason::StaleTelemetry));
        let held_ns = f.now_ns;
        f.until(Guided);
        assert!(f.now_ns - held_ns < 2_000_000_000, "{} ns", f.now_ns - held_ns);
        let asked: Vec<f32> = f.peer.got(511).iter().map(|c| c.params[0]).collect();
        assert_eq!(asked, [32.0], "the first of the two brought both back");
        f.assert_said("slow: LOCAL_POSITION_NED at ");
        f.assert_said(" Hz, asked for 30 Hz");
        assert_eq!(f.companion.counters().slow_streams, 1);
        // A ground station that insists is answered each time.
        for n in 2..=6 {
            f.run(seconds(10.0));
            f.peer.slowed_to_steps = Some(10);
            f.run(seconds(3.0));
            assert_eq!(f.last.unwrap().state, Guided);
            assert_eq!(f.companion.counters().slow_streams, n);
        }
    }
}

#[test]
fn streams_that_stay_slow_are_asked_for_less_and_less_often_and_at_4_hz_the_small_margin_is_reported() {
    let mut f = far_flight(ArduPilot);
    f.peer.commands.clear();
    (f.peer.slowed_to_steps, f.peer.keeps_slow) = (Some(5), true);
    let mut values = Vec::new();
    for _ in 0..seconds(4.0) {
        f.step();
        values.extend(named_values(&f.sent));
        f.peer.slowed_to_steps = Some(5);
    }
    let slow = f.last.unwrap();
    assert_eq!((slow.state, slow.reasons), (Guided, Reasons::of(Reason::SlowTelemetry)));
    f.assert_said("slow telemetry: ");
    let interval = values.iter().rev().find(|(name, _)| name == "tlm_ms").expect("sent").1;
    assert_eq!(interval, 250.0);
    for _ in 0..seconds(116.0) {
        f.step();
        f.peer.slowed_to_steps = Some(5);
    }
    let positions = f.peer.got(511).iter().filter(|c| c.params[0] == 32.0).count();
    assert!((3..=8).contains(&positions), "{positions}");
    let streams: Vec<u8> = f.peer.streams_asked.iter().map(|(stream, _)| *stream).collect();
    assert!(
        streams.contains(&6) && streams.contains(&10),
        "in the old way too: {streams:?}"
    );
    assert!(f.texts.iter().filter(|t| t.starts_with("slow: ")).count() <= 20);
}

#[test]
fn an_ardupilot_without_message_intervals_is_asked_by_data_streams() {
    let mut f = far_flight(ArduPilot);
    f.peer.answer(511, Some(MavResult::MAV_RESULT_UNSUPPORTED), u32::MAX);
    f.peer.slowed_to_steps = Some(10);
    f.until(Hold);
    f.until(Guided);
    assert_eq!(f.peer.streams_asked.first(), Some(&(6, 30)));
}

#[test]
fn a_goal_is_from_home_wherever_home_is() {
    for flavour in [Px4, ArduPilot] {
        for home_on_globe_only in [false, true] {
            // The second flight: the vehicle stands 12 m north, 3 m east and 1 m above the place where its estimator began.
            let peer = Peer {
                north_m: 12.0,
                east_m: 3.0,
                height_m: 1.0,
                tells_landed: true,
                home_ned_m: if flavour == Px4 { [12.0, 3.0, -1.0] } else { [0.0; 3] },
                home_on_globe_only,
                ..Peer::on_the_ground(flavour)
            };
            let mut f = Flight::on_command(flavour, peer);
            f.run(seconds(8.0));
            f.peer.armed = false;
            let story = format!("{} {home_on_globe_only}", flavour.name());
            f.peer.height_m = 0.0;
            f.peer.home_ned_m[2] = 0.0;
            f.engage_and_fly();
            f.run(seconds(3.0));
            let goal = f.guidance.goal().unwrap().position_ned_m;
            // 12 m north of home, 3 m above it; 1e-7 degrees of the globe are 11 mm.
            let expected = NedVector::new(24.0, 3.0, -3.0);
            assert!((goal - expected).norm() < 0.03, "{story}: {goal:?}");
            f.assert_said("home: 12.0 m north, 3.0 m east");
            f.until(Hold);
            assert!((f.peer.north_m - 23.0).abs() < 0.3, "{story}: {}", f.peer.north_m);

            // An operator's goal too, and the height.
            let reached = reposition(MavFrame::MAV_FRAME_LOCAL_NED, 200_000, 10_000, -2.5);
            f.hear(GROUND_STATION, &reached);
            f.step();
            let goal = f.guidance.goal().unwrap().position_ned_m;
            assert!(
                (goal - NedVector::new(32.0, 4.0, -2.5)).norm() < 0.03,
                "{story}: {goal:?}"
            );
        }
    }
}

#[test]
fn a_take_off_is_as_high_above_home_as_asked_wherever_home_is() {
    let height_m = |flavour: Flavour| {
        let peer = Peer {
            home_ned_m: [0.0, 0.0, -7.0],
            ..Peer::on_the_ground(flavour)
        };
        let mut f = Flight::on_command(flavour, peer);
        f.run(seconds(8.0));
        f.engage();
        f.until(Engaging);
        f.run(seconds(3.0));
        f.peer.commands.iter().find(|c| c.command == 22).unwrap().params[6]
    };
    assert_eq!(height_m(ArduPilot), 3.0, "above home");
    assert_eq!(height_m(Px4), common::peer::HOME_ALTITUDE_M + 10.0, "above sea level");
}

#[test]
fn a_vehicle_that_never_reports_its_home_is_flown_from_its_origin_and_that_is_reported() {
    let mut f = Flight::on_command(ArduPilot, Peer::on_the_ground(ArduPilot));
    for command in [511, 512] {
        f.peer.answer(command, Some(MavResult::MAV_RESULT_DENIED), u32::MAX);
    }
    f.peer.wanted_messages = vec![30, 32, 245];
    f.engage();
    f.until(Engaging);
    f.assert_said("home is unknown: goals are from the local origin");
    assert_eq!(
        f.guidance.goal().unwrap().position_ned_m,
        NedVector::new(12.0, 0.0, -3.0)
    );
}

#[test]
fn the_autopilot_is_recognised_from_its_heartbeat() {
    for flavour in [Px4, ArduPilot] {
        let mut f = Flight::of(None, Peer::on_the_ground(flavour), GuidanceConfig::default());
        f.engage_and_fly();
        assert_eq!(f.companion.vehicle().flavour(), flavour);
        let own = match flavour {
            Px4 => [400, 22, 176],
            ArduPilot => [176, 400, 22],
        };
        assert_eq!(f.peer.flight_commands(), own);
        f.assert_said(&format!("vehicle 1: {}", flavour.name()));
    }
    // One that is not known is flown as a PX4, and that is said.
    let mut b = Bench::new(Px4);
    b.companion = Companion::new(CompanionConfig::default());
    b.hear(VEHICLE, &heartbeat(MavAutopilot::MAV_AUTOPILOT_GENERIC));
    b.step(Standby, Reasons::NONE, VehicleRequest::None);
    assert!(texts(&b.sent).contains(&"vehicle 1: autopilot 0 is not known, flown as PX4".to_owned()));
}

#[test]
fn what_flies_is_not_taken_for_another_autopilot_in_flight() {
    let mut f = Flight::of(None, Peer::on_the_ground(Px4), GuidanceConfig::default());
    f.engage_and_fly();
    let other = heartbeat(MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA);
    f.hear(VEHICLE, &other);
    assert_eq!(f.companion.vehicle().flavour(), Px4);
    assert_eq!(f.companion.telemetry().heartbeat.unwrap().mode, VehicleMode::Unknown);
}

#[test]
fn a_wrong_vehicle_is_named_at_once_and_again_every_half_minute_and_never_commanded() {
    for (configured, actual) in [(Px4, ArduPilot), (ArduPilot, Px4)] {
        let (set, is) = (configured.name(), actual.name());
        let text = format!("vehicle is {is}, but set is {set}: it is not flown; use --vehicle auto");
        let mut f = Flight::new(configured, Peer::in_the_air(actual));
        f.step();
        f.assert_said(&text);
        f.run(seconds(61.0));
        assert_eq!(f.texts.iter().filter(|t| **t == text).count(), 3);
        let is_still = f.peer.setpoints.iter().all(|(_, setpoint)| *setpoint == [0.0; 4]);
        assert!(f.peer.commands.is_empty() && is_still, "{:?}", f.peer.commands);
        // A PX4 streams unprompted, so that guidance becomes ready; an ArduPilot is not even asked to.
        if actual == Px4 {
            f.assert_said("hand-over: vehicle is PX4, not ArduPilot");
        }
    }
}

#[test]
fn a_second_guidance_computer_behind_the_vehicle_is_named_at_once_and_again_every_half_minute() {
    let warning = "another guidance computer 1/191 is on the link: stop one";
    let mut f = Flight::on_command(Px4, Peer::on_the_ground(Px4));
    f.run(seconds(3.0));
    assert!(!f.texts.iter().any(|text| text == warning));
    // The autopilot passes on what it hears on its other links.
    for _ in 0..61 {
        let heartbeat = heartbeat(MavAutopilot::MAV_AUTOPILOT_INVALID);
        f.hear(ME, &heartbeat);
        f.run(seconds(1.0));
    }
    assert_eq!(f.texts.iter().filter(|t| *t == warning).count(), 3);
    assert!(f.peer.flight_commands().is_empty());
}

#[test]
fn missing_inputs_are_named_one_by_one_with_their_age() {
    let mut b = Bench::new(Px4);
    let step = |b: &mut Bench, seconds: f64, missing: Reasons, change: &dyn Fn(&mut StepReport)| {
        let mut lines = Vec::new();
        for _ in 0..(seconds / 0.05).round() as u32 {
            b.now_ns += STEP_NS;
            let mut report = StepReport {
                reasons: missing,
                telemetry: *b.companion.telemetry(),
                ..report(b.now_ns, Standby)
            };
            change(&mut report);
            b.emit(&report, VehicleRequest::None);
            lines.extend(texts(&b.sent).into_iter().filter(|t| t.starts_with("missing")));
        }
        lines
    };
    let all = Reasons::of(Reason::StaleFrame)
        .with_if(true, Reason::StaleTelemetry)
        .with_if(true, Reason::LinkLost);
    let none_came = [
        "missing: HEARTBEAT of a vehicle, none came",
        "missing: LOCAL_POSITION_NED, none came",
        "missing: ATTITUDE, none came",
        "missing: depth frames, none came",
    ];
    assert!(step(&mut b, 1.0, all, &|_| {}).is_empty(), "a start takes a moment");
    assert_eq!(step(&mut b, 0.1, all, &|_| {}), none_came);
    assert!(step(&mut b, 9.8, all, &|_| {}).is_empty());
    assert_eq!(
        step(&mut b, 0.2, all, &|_| {}),
        none_came,
        "again after 10 s, then less and less often"
    );
    assert_eq!(step(&mut b, 120.0, all, &|_| {}).len(), 3 * 4);

    // The vehicle is there; its attitude came, its position did not; the frames ended 5 s ago.
    b.hear(VEHICLE, &heartbeat(MavAutopilot::MAV_AUTOPILOT_PX4));
    b.hear(VEHICLE, &message!(ATTITUDE));
    assert!(step(&mut b, 0.1, Reasons::NONE, &|_| {}).is_empty());
    let some = Reasons::of(Reason::StaleFrame).with_if(true, Reason::StaleTelemetry);
    let said = step(&mut b, 1.1, some, &|report| report.frame_age_ns = Some(5_000_000_000));
    assert_eq!(
        said,
        [
            "missing: LOCAL_POSITION_NED, none came",
            "missing: depth frames, for 5.0 s"
        ]
    );
}

#[test]
fn a_hand_over_that_is_not_done_in_time_names_what_it_waited_for() {
    let mut f = Flight::on_command(ArduPilot, Peer::on_the_ground(ArduPilot));
    f.engage();
    f.until(Engaging);
    // It accepts the take-off and climbs half a metre.
    for _ in 0..seconds(65.0) {
        f.step();
        if f.peer.height_m > 0.5 {
            f.peer.target_height_m = Some(0.6);
        }
    }
    f.assert_said("hand-over: not done in time, waiting for: climb to the take-off height");
}

#[test]
fn a_refused_request_is_answered_with_its_reason() {
    let mut f = Flight::on_command(Px4, Peer::on_the_ground(Px4));
    f.sees = false;
    f.run(seconds(2.0));
    let say = |f: &mut Flight, message: &MavMessage| {
        f.hear(GROUND_STATION, message);
        f.step();
        let acks: Vec<_> = only!(messages(&f.sent), COMMAND_ACK)
            .map(|ack| (ack.result as u8, ack.result_param2))
            .collect();
        let refused = texts(&f.sent).into_iter().find(|t| t.contains("refused"));
        f.run(seconds(1.0));
        (acks, refused.unwrap_or_default())
    };
    let engage = command_long(MavCmd::MAV_CMD_NAV_GUIDED_ENABLE, ME, 1.0);
    let later = MavResult::MAV_RESULT_TEMPORARILY_REJECTED as u8;
    assert_eq!(
        say(&mut f, &engage),
        (vec![(later, 1)], "engage refused in standby (stale frame)".to_owned()),
        "the answer has the reasons' bits"
    );
    let land = command_long(MavCmd::MAV_CMD_NAV_LAND, ME, 0.0);
    let goal = |frame, z| reposition(frame, 0, 0, z);
    let far = reposition(MavFrame::MAV_FRAME_LOCAL_NED, 8_000_000, 1_000_000, -3.0);
    let denied = vec![(MavResult::MAV_RESULT_DENIED as u8, 0)];
    let too_far = (denied, "goal refused: 807 m from home, at most 500 m".to_owned());
    assert_eq!(say(&mut f, &far), too_far);
    let long = command_long(MavCmd::MAV_CMD_DO_REPOSITION, ME, 0.0);
    for (message, refused) in [
        (&land, "landing refused in standby: guidance does not have the vehicle"),
        (
            &goal(MavFrame::MAV_FRAME_LOCAL_NED, 5.0),
            "goal refused: outside the fence, too far, or at or below the ground",
        ),
        (
            &goal(MavFrame::MAV_FRAME_BODY_FRD, -5.0),
            "goal refused: frames LOCAL_NED, GLOBAL and GLOBAL_RELATIVE_ALT are known",
        ),
        (
            &long,
            "goal refused: send it as COMMAND_INT, a float does not hold a latitude",
        ),
    ] {
        assert_eq!(say(&mut f, message).1, refused);
    }

    // A flood is answered; it does not become a flood of texts.
    f.texts.clear();
    for _ in 0..20 {
        for _ in 0..8 {
            f.hear(GROUND_STATION, &land);
        }
        f.step();
    }
    let said = f.texts.iter().filter(|t| t.contains("refused")).count();
    assert!((1..=8).contains(&said), "{said} in a second");
}

#[test]
fn what_was_reported_before_the_vehicle_was_there_reaches_it() {
    let mut b = Bench::new(Px4);
    b.step(Standby, Reasons::of(Reason::LinkLost), VehicleRequest::None);
    let first = texts(&b.sent);
    assert_eq!(first, ["guidance: standby (link lost)"]);
    for _ in 0..seconds(100.0) {
        b.step(Standby, Reasons::of(Reason::LinkLost), VehicleRequest::None);
    }
    b.hear(VEHICLE, &heartbeat(MavAutopilot::MAV_AUTOPILOT_PX4));
    b.step(Standby, Reasons::NONE, VehicleRequest::None);
    let said = texts(&b.sent);
    assert_eq!(said.first(), first.first(), "{said:?}");
    b.step(Standby, Reasons::NONE, VehicleRequest::None);
    assert!(texts(&b.sent).is_empty(), "once");
    // A ground station that comes later gets the state.
    let ping = command_long(MavCmd::MAV_CMD_DO_SET_MODE, (9, 9), 0.0);
    for _ in 0..2 {
        b.companion.receive(b.now_ns, 2, &bytes_of(GROUND_STATION, &ping));
    }
    b.step(Standby, Reasons::NONE, VehicleRequest::None);
    assert_eq!(texts(&b.sent), ["guidance: standby"]);
}

/// The OBSTACLE_DISTANCE messages that a vehicle gets in so many steps: how many, and how many of them hold a distance.
fn obstacles_sent(obstacles: ObstacleReports, peer: Peer) -> (usize, usize) {
    let mut f = Flight::on_command(ArduPilot, peer);
    f.companion = Companion::new(CompanionConfig {
        obstacles,
        ..CompanionConfig::default()
    });
    f.run(seconds(2.0));
    let (mut said, mut seen) = (0, 0);
    for _ in 0..seconds(2.0) {
        f.step();
        let mut sent = Datagrams::default();
        let sectors = [(0.0, 0.14)].into_iter();
        f.companion.emit_obstacles(f.now_ns, Some(sectors), &mut sent);
        for m in only!(messages(&sent), OBSTACLE_DISTANCE) {
            said += 1;
            seen += usize::from(m.distances.iter().any(|d| *d != u16::MAX));
        }
    }
    (said, seen)
}

#[test]
fn what_the_sensor_sees_of_the_ground_is_not_reported_as_obstacles() {
    use ObstacleReports::{Flight as InFlight, KeepAlive, Off};
    for (obstacles, on_ground, in_air) in [
        (Off, (0, 0), (0, 0)),
        (InFlight, (0, 0), (8, 8)),
        (KeepAlive, (8, 0), (8, 8)),
    ] {
        let counts =
            [Peer::on_the_ground(ArduPilot), Peer::in_the_air(ArduPilot)].map(|p| obstacles_sent(obstacles, p));
        assert_eq!(counts, [on_ground, in_air], "{obstacles:?}");
    }
    assert_eq!(ObstacleReports::default(), InFlight);
}

#[test]
fn a_pilots_loiter_is_not_taken_by_a_firmware_that_starts() {
    let auto = GuidanceConfig {
        engage: EngagePolicy::Auto,
        ..Default::default()
    };
    let mut f = Flight::of(None, Peer::in_the_air(ArduPilot), auto);
    assert_eq!(f.ends(seconds(60.0)), (Ready, Reasons::of(Reason::PilotInCommand)));
    assert!(f.peer.flight_commands().is_empty() && f.peer.mode == Mode::Loiter);
    f.assert_said("a person has the vehicle: engage guidance, or if nobody took it over, change to GUIDED");
    // The pilot gives it by the mode.
    f.peer.mode = Mode::External;
    f.until(Guided);
}

#[test]
fn a_landed_vehicle_whose_autopilot_restarts_is_never_armed_by_auto() {
    for (flavour, parked) in [(Px4, Mode::Loiter), (ArduPilot, Mode::External)] {
        let peer = Peer {
            mode: parked,
            ..Peer::on_the_ground(flavour)
        };
        let mut f = Flight::new(flavour, peer);
        f.until(Guided);
        f.run(seconds(1.0));
        // An operator lands it from the ground station, and restarts the autopilot.
        f.peer.mode = Mode::Land;
        f.until(Standby);
        f.run(seconds(10.0));
        assert!(!f.peer.armed);
        for _ in 0..2 {
            f.hears = false;
            f.run(seconds(5.0));
            let now_ns = f.now_ns;
            f.peer.reboot(now_ns);
            f.peer.mode = parked;
            f.peer.commands.clear();
            f.hears = true;
            let later = f.run(seconds(60.0));
            assert_eq!((later.state, f.peer.armed), (Ready, false), "{}", flavour.name());
            assert!(f.peer.flight_commands().is_empty(), "{}", flavour.name());
        }
        f.engage_and_fly();
    }
}
