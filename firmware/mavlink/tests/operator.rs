//! What an operator asks of the guidance computer, and what it says of itself.

mod common;

use common::peer::Peer;
use common::{
    Bench, Flight, GROUND_STATION, ME, VEHICLE, bytes_of, command_long, heartbeat, messages, named_values, raw_command,
    report, reposition, texts,
};
use vigil_mavlink::common::MavResult::{
    MAV_RESULT_ACCEPTED as ACCEPTED, MAV_RESULT_COMMAND_INT_ONLY as INT_ONLY,
    MAV_RESULT_COMMAND_UNSUPPORTED_MAV_FRAME as NO_FRAME, MAV_RESULT_DENIED as DENIED,
    MAV_RESULT_TEMPORARILY_REJECTED as LATER,
};
use vigil_mavlink::common::*;
use vigil_mavlink::framing::CommandForm;
use vigil_mavlink::{Flavour, MavHeader, MavMessage, message};
use vigil_types::GuidanceState::{Engaging, Guided, Hold, Land, Ready, Standby};
use vigil_types::{
    Action, Datagrams, GoalRelative, HeadingVector, OperatorRequest, Reason, Reasons, RequestOutcome, STEP_NS,
    StepReport, StepTiming, VehicleRequest, VelocitySetpoint,
};

/// The acknowledgements of a step: command, result, addressee.
fn acks(sent: &Datagrams) -> Vec<(u16, MavResult, (u8, u8))> {
    only!(messages(sent), COMMAND_ACK)
        .map(|a| (a.command as u16, a.result, (a.target_system, a.target_component)))
        .collect()
}

/// The answers to what a ground station says.
fn say(f: &mut Flight, message: &MavMessage) -> Vec<(u16, MavResult, (u8, u8))> {
    f.hear(GROUND_STATION, message);
    f.step();
    acks(&f.sent)
}

fn idle(bench: &mut Bench) -> Vec<(MavHeader, MavMessage)> {
    bench.step(Standby, Reasons::NONE, VehicleRequest::None)
}

/// A ground station's wish that guidance flies (1) or does not (0).
fn enable(target: (u8, u8), on: f32) -> MavMessage {
    command_long(MavCmd::MAV_CMD_NAV_GUIDED_ENABLE, target, on)
}

/// What the companion makes of a message: the request it hands to guidance, or its answer.
fn asked(bench: &mut Bench, message: &MavMessage) -> Result<OperatorRequest, MavResult> {
    bench.hear(GROUND_STATION, message);
    match bench.companion.take_request() {
        Some(pending) => Ok(pending.request()),
        None => {
            idle(bench);
            Err(acks(&bench.sent).first().expect("an answer").1)
        }
    }
}

#[test]
fn a_ground_station_commands_a_whole_flight() {
    let mut f = Flight::on_command(Flavour::Px4, Peer::on_the_ground(Flavour::Px4));
    let engage = enable(ME, 1.0);
    assert_eq!(say(&mut f, &engage), [(92, LATER, (255, 190))], "not ready yet");
    f.until(Ready);
    let goal = reposition(MavFrame::MAV_FRAME_LOCAL_NED, 80_000, 0, -3.0);
    assert_eq!(say(&mut f, &goal), [(192, ACCEPTED, (255, 190))]);
    assert_eq!(say(&mut f, &engage), [(92, ACCEPTED, (255, 190))]);
    f.until(Guided);
    f.until(Hold);
    assert!((f.peer.north_m - 7.0).abs() < 0.3, "{}", f.peer.north_m);
    let land = command_long(MavCmd::MAV_CMD_NAV_LAND, ME, 0.0);
    assert_eq!(say(&mut f, &land), [(21, ACCEPTED, (255, 190))]);
    assert_eq!(say(&mut f, &enable(ME, 0.0)), [(92, LATER, (255, 190))], "it lands on");
    f.assert_said("disengage refused in land (goal reached, operator)");
    f.until(Standby);
    assert!(!f.peer.armed);
    let states = f.texts.iter().filter_map(|t| t.strip_prefix("guidance: "));
    assert_eq!(
        states.map(|t| t.split(' ').next().unwrap()).collect::<Vec<_>>(),
        ["standby", "ready", "engaging", "guided", "hold", "land", "standby"]
    );
}

#[test]
fn commands_become_requests_and_what_is_none_is_answered_by_what_is_wrong_with_it() {
    let mut b = Bench::new(Flavour::Px4);
    let (north_m, east_m) = (20.0, -5.5);
    let goal = |height_m| {
        Ok(OperatorRequest::Goal {
            north_m,
            east_m,
            height_m,
        })
    };
    let local = |z| reposition(MavFrame::MAV_FRAME_LOCAL_NED, 200_000, -55_000, z);
    let of = |command| command_long(command, ME, 0.0);
    for (message, expected) in [
        (enable(ME, 1.0), Ok(OperatorRequest::Engage)),
        (enable(ME, 0.0), Ok(OperatorRequest::Disengage)),
        (enable(ME, f32::NAN), Err(DENIED)),
        (of(MavCmd::MAV_CMD_NAV_LAND), Ok(OperatorRequest::Land)),
        (local(-3.0), goal(Some(3.0))),
        (local(f32::NAN), goal(None)),
        (of(MavCmd::MAV_CMD_DO_REPOSITION), Err(INT_ONLY)),
        (reposition(MavFrame::MAV_FRAME_BODY_FRD, 1, 1, 0.0), Err(NO_FRAME)),
        (reposition(MavFrame::MAV_FRAME_LOCAL_NED, i32::MAX, 1, 0.0), Err(DENIED)),
    ] {
        assert_eq!(asked(&mut b, &message), expected, "{message:?}");
    }
    assert_eq!(b.companion.counters().commands_refused, 4);
}

#[test]
#[allow(deprecated)] // older clients use the frames with _INT
fn a_goal_on_the_globe_becomes_local_once_the_origin_is_known() {
    let mut b = Bench::new(Flavour::Px4);
    // 20 m north, 5 m east of the origin: 1e-7 degrees are 11.12 mm north, 7.527 mm east at this latitude.
    let (lat, lon) = (473_977_420 + 1799, 85_455_940 + 664);
    let global = |frame, z| reposition(frame, lat, lon, z);
    assert_eq!(
        asked(&mut b, &global(MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT, 4.0)),
        Err(LATER)
    );
    b.hear(VEHICLE, &heartbeat(MavAutopilot::MAV_AUTOPILOT_PX4));
    let (latitude, longitude, altitude) = (473_977_420, 85_455_940, 488_000);
    let origin = message!(GPS_GLOBAL_ORIGIN, latitude, longitude, altitude);
    b.hear(VEHICLE, &origin);
    // Home is 2 m above the origin.
    b.hear(VEHICLE, &message!(HOME_POSITION, z = -2.0));
    for (frame, z, height) in [
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT, 4.0, 6.0),
        (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 4.0, 6.0),
        (MavFrame::MAV_FRAME_GLOBAL, 491.5, 3.5),
        (MavFrame::MAV_FRAME_GLOBAL_INT, 491.5, 3.5),
    ] {
        let Ok(OperatorRequest::FixedGoal {
            north_m,
            east_m,
            height_m: Some(height_m),
        }) = asked(&mut b, &global(frame, z))
        else {
            panic!("{frame:?} is a goal");
        };
        assert!(
            (north_m - 20.0).abs() < 0.02 && (east_m - 5.0).abs() < 0.02,
            "{north_m} {east_m}"
        );
        assert!((height_m - height).abs() < 1e-3, "{height_m}");
    }
}

#[test]
fn unknown_commands_are_unsupported_and_those_for_others_are_not_answered() {
    let mut b = Bench::new(Flavour::Px4);
    for form in [
        CommandForm::Long { confirmation: 0 },
        CommandForm::Int { frame: 0, x: 0, y: 0 },
    ] {
        b.companion.receive(b.now_ns, 3, &raw_command(54_321, [0.0; 7], form));
    }
    b.now_ns += STEP_NS;
    b.emit(&report(b.now_ns, Standby), VehicleRequest::None);
    // The crate's parser has no such number: read the acknowledgements raw.
    let mut counters = Default::default();
    let answers: Vec<_> = b.sent.iter().filter(|(link, _)| *link == 3).collect();
    assert_eq!(answers.len(), 2, "they go back on the link that the question came from");
    for (_, datagram) in answers {
        let packet = vigil_mavlink::framing::packets(datagram, &mut counters).next().unwrap();
        let ack = packet.command_ack().unwrap();
        assert_eq!((ack.command, ack.result), (54_321, 3));
        assert_eq!((ack.target_system, ack.target_component), (255, 190));
    }

    for target in [(1, 1), (1, 0), (0, 0), (2, 191), (1, 190)] {
        b.hear(GROUND_STATION, &enable(target, 1.0));
        assert!(b.companion.take_request().is_none(), "{target:?}");
        idle(&mut b);
        assert_eq!(acks(&b.sent), [], "{target:?}");
    }
}

#[test]
fn a_flood_of_commands_is_answered_as_far_as_there_is_room_and_the_rest_counted() {
    let mut b = Bench::new(Flavour::Px4);
    for _ in 0..200 {
        b.hear(GROUND_STATION, &enable(ME, 1.0));
    }
    let mut taken = 0;
    while let Some(pending) = b.companion.take_request() {
        b.companion.answer(&pending, RequestOutcome::Accepted);
        taken += 1;
    }
    idle(&mut b);
    let answered = acks(&b.sent).len() as u64;
    assert_eq!((taken, answered), (32, 128));
    assert_eq!(b.companion.counters().replies_dropped, 200 - answered);
    b.hear(GROUND_STATION, &enable(ME, 1.0));
    assert!(b.companion.take_request().is_some(), "the next one is heard");
}

#[test]
fn time_questions_are_answered_to_the_asker() {
    let mut b = Bench::new(Flavour::Px4);
    b.hear(GROUND_STATION, &message!(TIMESYNC, ts1 = 123_456_789));
    b.hear(GROUND_STATION, &message!(TIMESYNC, tc1 = 5, ts1 = 1));
    #[allow(deprecated)]
    b.hear(GROUND_STATION, &message!(PING, time_usec = 77, seq = 3));
    let asked_ns = b.now_ns;
    let sent = idle(&mut b);
    let answers: Vec<_> = sent.iter().map(|(_, m)| m).collect();
    let (target_system, target_component) = GROUND_STATION;
    let (tc1, ts1) = (asked_ns as i64, 123_456_789);
    let time = message!(TIMESYNC, tc1, ts1, target_system, target_component);
    assert!(answers.contains(&&time));
    assert_eq!(
        answers.iter().filter(|m| matches!(m, MavMessage::TIMESYNC(_))).count(),
        1,
        "an answer is not answered"
    );
    #[allow(deprecated)]
    let ping = message!(PING, time_usec = 77, seq = 3, target_system, target_component);
    assert!(answers.contains(&&ping));
}

#[test]
fn the_heartbeat_is_a_companions_at_1_hz_and_shows_health() {
    let mut b = Bench::new(Flavour::Px4);
    let (stale, goal) = (Reasons::of(Reason::StaleFrame), Reasons::of(Reason::GoalReached));
    let slow = Reasons::of(Reason::SlowTelemetry);
    for (state, reasons, health) in [
        (Standby, stale, MavState::MAV_STATE_BOOT),
        (Ready, Reasons::NONE, MavState::MAV_STATE_STANDBY),
        (Engaging, Reasons::NONE, MavState::MAV_STATE_ACTIVE),
        (Guided, Reasons::NONE, MavState::MAV_STATE_ACTIVE),
        (Hold, goal, MavState::MAV_STATE_ACTIVE),
        (Hold, slow.union(goal), MavState::MAV_STATE_ACTIVE),
        (Hold, stale.union(goal), MavState::MAV_STATE_CRITICAL),
        (Land, goal, MavState::MAV_STATE_ACTIVE),
    ] {
        let sent: Vec<_> = (0..20)
            .flat_map(|_| b.step(state, reasons, VehicleRequest::None))
            .collect();
        assert!(sent.iter().all(|(h, _)| (h.system_id, h.component_id) == (1, 191)));
        let heartbeats: Vec<_> = only!(sent, HEARTBEAT).collect();
        let [h] = &heartbeats[..] else {
            panic!("one a second, not {}", heartbeats.len());
        };
        assert_eq!((h.mavtype as u8, h.autopilot as u8), (18, 8));
        assert_eq!((h.base_mode.bits(), h.mavlink_version), (0, 3));
        assert_eq!(h.system_status, health, "{}", state.name());
    }
}

#[test]
fn rates_hold_although_steps_begin_late() {
    let mut b = Bench::new(Flavour::Px4);
    let begin_ns = b.now_ns;
    let (mut heartbeats, mut values) = (0, 0);
    for n in 0..1200u64 {
        // Up to 3 ms late, in no order.
        b.now_ns = begin_ns + n * STEP_NS + n * 7_919_000 % 3_000_000;
        b.emit(&report(b.now_ns, Standby), VehicleRequest::None);
        heartbeats += only!(messages(&b.sent), HEARTBEAT).count();
        values += usize::from(!named_values(&b.sent).is_empty());
    }
    assert_eq!((heartbeats, values), (60, 240), "one and four a second for a minute");
}

#[test]
fn every_packet_has_the_next_sequence_number() {
    let mut b = Bench::new(Flavour::Px4);
    let numbers: Vec<u8> = (0..600)
        .flat_map(|_| idle(&mut b))
        .map(|(header, _)| header.sequence)
        .collect();
    assert!(numbers.len() > 256);
    assert!(numbers.windows(2).all(|w| w[1] == w[0].wrapping_add(1)));
}

#[test]
fn a_setpoint_is_sent_as_it_was_decided() {
    let mut b = Bench::new(Flavour::Px4);
    b.hear(VEHICLE, &heartbeat(MavAutopilot::MAV_AUTOPILOT_PX4));
    let decided = StepReport {
        action: Some(Action::new(1.25, -0.5)),
        setpoint: Some(VelocitySetpoint {
            velocity_m_s: HeadingVector::new(1.25, 0.0, -0.125),
            yaw_rate_rad_s: -0.25,
        }),
        ..report(b.now_ns, Guided)
    };
    b.emit(&decided, VehicleRequest::None);
    let sent: Vec<_> = only!(messages(&b.sent), SET_POSITION_TARGET_LOCAL_NED).collect();
    let [s] = &sent[..] else { panic!("one setpoint") };
    assert_eq!((s.vx, s.vy, s.vz, s.yaw_rate), (1.25, 0.0, -0.125, -0.25));
    assert_eq!((s.coordinate_frame as u8, s.type_mask.bits()), (8, 0x5C7));
    assert_eq!((s.target_system, s.target_component, s.time_boot_ms), (1, 1, 7000));
}

#[test]
fn values_are_named_and_come_four_times_a_second_and_at_once_on_change() {
    let mut b = Bench::new(Flavour::Px4);
    let full = |now_ns| StepReport {
        timing: StepTiming {
            step: 5,
            previous_execution_ns: 250_000,
            wake_late_ns: 30_000,
            slips: 2,
        },
        goal_relative: Some(GoalRelative::new(12.5, core::f32::consts::FRAC_PI_2)),
        frame_age_ns: Some(20_000_000),
        frames_refused: 3,
        reasons: Reasons::of(Reason::StaleFrame).with_if(true, Reason::Slip),
        ..report(now_ns, Hold)
    };
    let mut damaged = bytes_of(VEHICLE, &message!(ATTITUDE));
    damaged[5] ^= 1;
    b.companion.receive(b.now_ns, 0, &damaged);
    b.emit(&full(b.now_ns), VehicleRequest::None);
    let expected = [
        ("gd_state", 4.0),
        ("gd_reason", 129.0),
        ("gd_reason2", 0.0),
        ("goal_m", 12.5),
        ("goal_deg", 90.0),
        ("frame_ms", 20.0),
        ("step_us", 250.0),
        ("late_us", 30.0),
        ("slips", 2.0),
        ("refused", 3.0),
        ("rx_bad", 1.0),
    ];
    let got = named_values(&b.sent);
    assert_eq!(got.len(), expected.len());
    for ((name, value), (expected_name, expected_value)) in got.iter().zip(expected) {
        assert_eq!(name, expected_name);
        assert!((value - expected_value).abs() < 1e-3, "{name} {value}");
    }
    assert_eq!(texts(&b.sent), ["guidance: hold (stale frame, slip)"]);

    let mut b = Bench::new(Flavour::Px4);
    let counts: Vec<usize> = (0..20)
        .map(|_| {
            b.step(Hold, Reasons::NONE, VehicleRequest::None);
            named_values(&b.sent).len()
        })
        .collect();
    assert_eq!(counts.iter().filter(|n| **n > 0).count(), 4, "{counts:?}");
    b.step(Hold, Reasons::NONE, VehicleRequest::None);
    b.step(Hold, Reasons::of(Reason::BadFrame), VehicleRequest::None);
    let changed = [("gd_state", 4.0), ("gd_reason", 2.0), ("gd_reason2", 0.0)];
    assert_eq!(
        named_values(&b.sent),
        changed.map(|(name, value)| (name.to_owned(), value))
    );
    assert!(texts(&b.sent).is_empty(), "a text only when the state changes");
}

#[test]
fn before_it_ends_it_sends_zeros_if_it_was_streaming() {
    let mut f = Flight::new(Flavour::ArduPilot, Peer::in_the_air(Flavour::ArduPilot));
    f.engage_and_fly();
    f.run(20);
    let mut last = Datagrams::default();
    f.companion.shutdown(f.now_ns, &mut last);
    let zeros = only!(messages(&last), SET_POSITION_TARGET_LOCAL_NED)
        .filter(|s| [s.vx, s.vy, s.vz, s.yaw_rate] == [0.0; 4])
        .count();
    assert_eq!((zeros, texts(&last)), (3, vec!["guidance: shut down".to_owned()]));

    let mut b = Bench::new(Flavour::Px4);
    idle(&mut b);
    let mut last = Datagrams::default();
    b.companion.shutdown(b.now_ns, &mut last);
    assert_eq!(messages(&last).len(), 2, "nothing to stop: heartbeat and text");
}

#[test]
fn reasons_beyond_what_a_float_holds_are_reported_beside_the_others_and_their_end_too() {
    let mut bench = Bench::new(Flavour::Px4);
    let stuck = Reasons::of(Reason::NoProgress).with_if(true, Reason::StaleFrame);
    let said = |bench: &mut Bench, reasons: Reasons| {
        bench.step(Hold, reasons, VehicleRequest::None);
        let values = named_values(&bench.sent).into_iter();
        values
            .filter(|(name, _)| name.starts_with("gd_reason"))
            .collect::<Vec<_>>()
    };
    let value = |name: &str, value: f32| (name.to_owned(), value);
    assert_eq!(
        said(&mut bench, stuck),
        [value("gd_reason", 1.0), value("gd_reason2", 1.0)]
    );
    let after = said(&mut bench, Reasons::of(Reason::StaleFrame));
    assert_eq!(after, [value("gd_reason", 1.0), value("gd_reason2", 0.0)]);
    // And again with the others, for a link that swallowed it.
    let again = (0..20).map(|_| said(&mut bench, Reasons::of(Reason::StaleFrame)));
    assert_eq!(again.filter(|values| *values == after).count(), 4);
}
