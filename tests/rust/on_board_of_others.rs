//! What goes wrong on board of others: each is a named state, and none is flown on with.
//!
//! A mission that leads through a wall, and the same for a guarded vehicle: `just_stop/`; for a rendered sensor: `foreign.rs`.

use vigil_mavlink::MavMessage;
use vigil_mavlink::common::{MavAutopilot, MavType};
use vigil_mavlink::framing::{self, FramingCounters};
use vigil_mavlink::message;
use vigil_sim::world::Family;
use vigil_tests::Pair;
use vigil_tests::ground::{Request, STATION, packet, set_auto_mode};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, Datagrams, DepthFrame, GuidanceState, Reason, Reasons, STEP_NS, StepReport};

const SEED: u64 = 4203;
/// The fault begins after so many steps of guided flight: 4 s.
const ONSET: usize = 80;

/// On its way for 4 s.
fn guided() -> Pair {
    let mut pair = Pair::new(Family::Validation, SEED);
    pair.fly_guided(ONSET);
    pair
}

/// What came of some steps.
struct Flown {
    last: StepReport,
    reasons: Reasons,
    texts: Vec<String>,
    guided: usize,
}

/// Steps in which `spoil` has its hand between vehicle, sensor and firmware; it says whether the frame arrives.
fn run(pair: &mut Pair, steps: usize, mut spoil: impl FnMut(&mut Pair, u64) -> bool) -> Flown {
    let mut texts = Vec::new();
    let reports = pair.fly(steps, |pair, step| {
        texts.extend(pair.texts());
        spoil(pair, step as u64)
    });
    texts.extend(pair.texts());
    assert_eq!((reports.len(), pair.outcome()), (steps, None), "it ended");
    Flown {
        last: reports[steps - 1],
        reasons: reports.iter().fold(Reasons::NONE, |all, r| all.union(r.reasons)),
        texts,
        guided: reports.iter().filter(|r| r.state == GuidanceState::Guided).count(),
    }
}

impl Flown {
    #[track_caller]
    fn assert_said(&self, part: &str) {
        let texts = &self.texts;
        assert!(texts.iter().any(|text| text.contains(part)), "not `{part}`: {texts:?}");
    }

    fn names(&self) -> Vec<&'static str> {
        self.reasons.iter().map(Reason::name).collect()
    }
}

/// Frames as `spoil` leaves them hold the vehicle by this name, and it stands. With good frames it flies on, where `ends`.
fn frames_hold(what: &str, name: Reason, ends: bool, mut spoil: impl FnMut(&mut DepthFrame, u64, u64) -> bool) {
    let mut pair = guided();
    let held = run(&mut pair, 160, |pair, step| {
        let now_ns = pair.simulator.now_ns();
        let arrives = spoil(&mut pair.frame, step, now_ns);
        pair.frame.seal();
        arrives
    });
    let names = held.names();
    assert!(held.reasons.contains(name), "{what}: {names:?}");
    assert_eq!(held.last.state, GuidanceState::Hold, "{what}: {names:?}");
    let speed_m_s = pair.speed_m_s();
    assert!(speed_m_s < 0.2, "{what}: {speed_m_s} m/s");
    if ends {
        let goes_on = run(&mut pair, 30, |_, _| true);
        assert_eq!(goes_on.last.state, GuidanceState::Guided, "{what}: {names:?}");
    }
}

/// The same of frames that all arrive.
fn altered_frames_hold(what: &str, name: Reason, ends: bool, alter: impl Fn(&mut DepthFrame, u64, u64)) {
    frames_hold(what, name, ends, |frame, step, now_ns| {
        alter(frame, step, now_ns);
        true
    });
}

#[test]
fn frames_of_another_size_are_bad_frames() {
    altered_frames_hold("64 rows", Reason::BadFrame, true, |frame, _, _| frame.header.rows = 64);
    altered_frames_hold("512 columns", Reason::BadFrame, true, |frame, _, _| {
        frame.header.cols = 512
    });
}

/// The picture of a camera that sees `across` and `down` of ours: stretched over the whole image, or in the middle of it with nothing
/// around.
fn through_a_camera(frame: &mut DepthFrame, across: f32, down: f32, stretched: bool) {
    let whole = frame.depth;
    let source = |pixel: usize, of: usize, share: f32| {
        let middle = (of - 1) as f32 / 2.0;
        let away = (pixel as f32 - middle) * if stretched { share } else { 1.0 };
        (away.abs() <= share * of as f32 / 2.0).then_some((middle + away).round() as usize)
    };
    for row in 0..DEPTH_ROWS {
        for column in 0..DEPTH_COLS {
            let from = source(row, DEPTH_ROWS, down).zip(source(column, DEPTH_COLS, across));
            frame.depth[row * DEPTH_COLS + column] = from.map_or(1.0, |(r, c)| whole[r * DEPTH_COLS + c]);
        }
    }
}

#[test]
fn frames_of_another_field_of_view_are_a_blind_sensor_or_an_inconsistent_picture() {
    // One depth camera, 87° by 58°, in the middle of our 120° by 60°.
    altered_frames_hold("a narrow view", Reason::BlindSensor, true, |frame, _, _| {
        through_a_camera(frame, 87.0 / 120.0, 58.0 / 60.0, false);
    });
    // The same, taken for the whole.
    altered_frames_hold("a stretched view", Reason::InconsistentPicture, false, |frame, _, _| {
        through_a_camera(frame, 87.0 / 120.0, 58.0 / 60.0, true);
    });
}

#[test]
fn frames_of_another_rate_are_flown_with_until_they_are_stale() {
    frames_hold("2.5 Hz", Reason::StaleFrame, true, |_, step, _| step % 8 == 0);
    let flight = run(&mut guided(), 100, |_, step| step % 4 == 0);
    assert_eq!((flight.guided, flight.names()), (100, vec![]), "5 Hz");
}

#[test]
fn frames_of_another_clock_are_bad_or_stale_frames() {
    const SECOND_NS: u64 = 1_000_000_000;
    const WALL_NS: u64 = 1_700_000_000 * SECOND_NS;
    use Reason::{BadFrame, StaleFrame};
    // From the frame's own stamp, the time since the fault began, and the time.
    type Stamp = fn(u64, u64, u64) -> u64;
    let cases: [(&str, Reason, Stamp); 5] = [
        ("a second ahead", BadFrame, |stamp_ns, _, _| stamp_ns + SECOND_NS),
        ("the wall clock", BadFrame, |stamp_ns, _, _| stamp_ns + WALL_NS),
        ("a clock of its own, from its start", StaleFrame, |_, run_ns, _| run_ns),
        ("a clock that is fast by 5 %", BadFrame, |_, run_ns, now_ns| {
            now_ns + run_ns / 20
        }),
        ("a clock that is slow by 5 %", StaleFrame, |_, run_ns, now_ns| {
            now_ns - run_ns / 20
        }),
    ];
    for (what, name, stamp) in cases {
        altered_frames_hold(what, name, true, |frame, step, now_ns| {
            frame.header.stamp_ns = stamp(frame.header.stamp_ns, step * STEP_NS, now_ns);
        });
    }
}

/// What the vehicle says, with its position as `alter` leaves it; `None` leaves it out.
fn with_position(said: &Datagrams, alter: impl Fn(f32) -> Option<f32>) -> Box<Datagrams> {
    let mut altered = Box::<Datagrams>::default();
    for (link, datagram) in said.iter() {
        let mut counters = FramingCounters::default();
        for heard in framing::packets(datagram, &mut counters) {
            let Ok(mut message) = heard.message() else { continue };
            if let MavMessage::LOCAL_POSITION_NED(position) = &mut message {
                let Some(x) = alter(position.x) else { continue };
                position.x = x;
            }
            let from = (heard.system_id(), heard.component_id());
            assert!(altered.push(link, &packet(from, heard.sequence(), &message)), "no room");
        }
    }
    altered
}

#[test]
fn a_pose_that_jumps_is_implausible_and_is_flown_on_from_only_when_poses_fit_again() {
    let mut pair = guided();
    // Telemetry and the frames' poses agree: a vehicle whose estimator was set anew.
    let mut set_anew = |pair: &mut Pair, _| {
        pair.to_firmware = with_position(&pair.to_firmware, |north_m| Some(north_m + 3.0));
        pair.frame.header.position_ned_m.x += 3.0;
        pair.frame.seal();
        true
    };
    let held_by = |flown: &Flown| (flown.last.state, flown.names(), flown.guided);
    let by_pose = (GuidanceState::Hold, vec![Reason::ImplausiblePose.name()], 0);
    assert_eq!(held_by(&run(&mut pair, 8, &mut set_anew)), by_pose);
    let goes_on = run(&mut pair, 40, &mut set_anew);
    assert_eq!(goes_on.last.state, GuidanceState::Guided, "{:?}", goes_on.names());

    // A sensor with an estimator of its own does not follow: nothing fits as long as they differ.
    let mut pair = guided();
    let held = run(&mut pair, 100, |pair, _| {
        pair.to_firmware = with_position(&pair.to_firmware, |north_m| Some(north_m + 3.0));
        true
    });
    assert_eq!(held_by(&held), by_pose);
    let speed_m_s = pair.speed_m_s();
    assert!(speed_m_s < 0.2, "{speed_m_s} m/s");
}

#[test]
fn a_vehicle_that_never_reports_its_position_is_not_flown_and_an_operator_learns_why() {
    // Hovering, before guidance has taken it.
    let mut pair = Pair::new(Family::Validation, SEED);
    let engage = packet(STATION, 0, &Request::Engage.message(1));
    let flight = run(&mut pair, 200, |pair, step| {
        pair.to_firmware = with_position(&pair.to_firmware, |_| None);
        if step == 100 {
            assert!(pair.to_firmware.push(0, &engage));
        }
        true
    });
    let last = flight.last;
    assert_eq!((last.state, last.setpoint), (GuidanceState::Standby, None));
    assert!(last.reasons.contains(Reason::StaleTelemetry), "{:?}", flight.names());
    assert_eq!(flight.guided, 0);
    flight.assert_said("missing: LOCAL_POSITION_NED");
    flight.assert_said("engage refused in standby (stale telemetry)");
}

#[test]
fn two_companions_are_named_and_the_second_is_not_obeyed() {
    let mavtype = MavType::MAV_TYPE_ONBOARD_CONTROLLER;
    let heartbeat = message!(HEARTBEAT, mavtype, autopilot = MavAutopilot::MAV_AUTOPILOT_INVALID);
    let flight = run(&mut guided(), 100, |pair, step| {
        if step % 20 == 0 {
            let second = packet((1, 191), step as u8, &heartbeat);
            assert!(pair.to_firmware.push(0, &second));
        }
        true
    });
    flight.assert_said("another guidance computer 1/191");
    assert_eq!(flight.guided, 100, "{:?}", flight.names());
}

#[test]
fn a_ground_station_that_takes_over_has_the_vehicle_until_an_operator_engages() {
    let mut pair = guided();
    // As QGroundControl's "Hold".
    pair.to_vehicle(&packet(STATION, 0, &set_auto_mode(3.0)));
    let left = run(&mut pair, 100, |_, _| true);
    assert!(left.reasons.contains(Reason::ModeLost), "{:?}", left.names());
    assert!(left.last.reasons.contains(Reason::PilotInCommand), "{:?}", left.names());
    assert_eq!(left.last.setpoint, None, "nobody else's setpoints");
    assert_eq!(run(&mut pair, 200, |_, _| true).guided, 0, "it is not taken back");

    let engage = packet(STATION, 1, &Request::Engage.message(1));
    let engaged = run(&mut pair, 60, |pair, step| {
        if step == 0 {
            assert!(pair.to_firmware.push(0, &engage), "no room");
        }
        true
    });
    assert_eq!(engaged.last.state, GuidanceState::Guided, "{:?}", engaged.texts);
}
