//! What goes wrong on board of others: each is a named state, and none is flown on with.
//!
//! A mission that leads through a wall, and the same for a guarded vehicle: `just_stop/`; for a rendered sensor: `foreign.rs`.

use vigil_mavlink::MavMessage;
use vigil_mavlink::common::{MavAutopilot, MavType};
use vigil_mavlink::framing::{self, FramingCounters};
use vigil_mavlink::message;
use vigil_sim::world::Family;
use vigil_tests::ground::{Request, STATION, packet};
use vigil_tests::{Pair, reasons};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, Datagrams, DepthFrame, GuidanceState, Reason, Reasons, STEP_NS, StepReport};

const SEED: u64 = 4203;
/// The fault begins after so many steps of guided flight: 4 s.
const ONSET: usize = 80;

/// On its way for 4 s.
fn guided() -> Pair {
    let mut pair = Pair::new(Family::Validation, SEED);
    let steps = pair.fly_guided(ONSET, 1200);
    assert!(steps < 1200 && pair.outcome().is_none(), "guided flight did not last");
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
        reasons: reasons(&reports),
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

/// The picture of one depth camera that sees 87° by 58° of our 120° by 60°: stretched over the whole image, or in the middle of it with
/// nothing around.
fn through_a_camera(frame: &mut DepthFrame, stretched: bool) {
    let (across, down) = (87.0 / 120.0, 58.0 / 60.0);
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
fn frames_of_another_size_field_of_view_rate_or_clock_hold_the_vehicle_by_name() {
    const SECOND_NS: u64 = 1_000_000_000;
    const WALL_NS: u64 = 1_700_000_000 * SECOND_NS;
    use Reason::{BadFrame, BlindSensor, InconsistentPicture, StaleFrame};
    // To a good frame, given the time since the fault began, and the time.
    type Alter = fn(&mut DepthFrame, u64, u64);
    // One in so many arrives.
    let cases: [(&str, Reason, u64, Alter); 10] = [
        ("64 rows", BadFrame, 1, |f, _, _| f.header.rows = 64),
        ("512 columns", BadFrame, 1, |f, _, _| f.header.cols = 512),
        ("a narrow view", BlindSensor, 1, |f, _, _| through_a_camera(f, false)),
        ("a stretched view", InconsistentPicture, 1, |f, _, _| {
            through_a_camera(f, true)
        }),
        ("2.5 Hz", StaleFrame, 8, |_, _, _| {}),
        ("a second ahead", BadFrame, 1, |f, _, _| f.header.stamp_ns += SECOND_NS),
        ("the wall clock", BadFrame, 1, |f, _, _| f.header.stamp_ns += WALL_NS),
        ("a clock of its own, from its start", StaleFrame, 1, |f, run_ns, _| {
            f.header.stamp_ns = run_ns
        }),
        ("a clock that is fast by 5 %", BadFrame, 1, |f, run_ns, now_ns| {
            f.header.stamp_ns = now_ns + run_ns / 20
        }),
        ("a clock that is slow by 5 %", StaleFrame, 1, |f, run_ns, now_ns| {
            f.header.stamp_ns = now_ns - run_ns / 20
        }),
    ];
    for (what, name, every, alter) in cases {
        let mut pair = guided();
        let held = run(&mut pair, 160, |pair, step| {
            let now_ns = pair.simulator.now_ns();
            alter(&mut pair.frame, step * STEP_NS, now_ns);
            pair.frame.seal();
            step % every == 0
        });
        let names = held.names();
        assert!(held.reasons.contains(name), "{what}: {names:?}");
        assert_eq!(held.last.state, GuidanceState::Hold, "{what}: {names:?}");
        let speed_m_s = pair.speed_m_s();
        assert!(speed_m_s < 0.2, "{what}: {speed_m_s} m/s");
        // With good frames it flies on, but for a picture that may stay in doubt.
        if name != InconsistentPicture {
            let goes_on = run(&mut pair, 30, |_, _| true);
            assert_eq!(goes_on.last.state, GuidanceState::Guided, "{what}: {names:?}");
        }
    }
}

#[test]
fn frames_at_5_hz_are_flown_with() {
    let flight = run(&mut guided(), 100, |_, step| step % 4 == 0);
    assert_eq!((flight.guided, flight.names()), (100, vec![]));
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
