//! SIGKILL to either process in flight: the other reaches a named safe state within half a second, and the pair recovers
//! when the killed one is started again. Times are those of the stack's own clock and log, not of the test's.

use rustix::process::Signal;
use std::net::UdpSocket;
use std::time::Duration;
use vigil_sim::vehicle::VehicleModel;
use vigil_sim::world::Family;
use vigil_tests::ground::{Request, STATION, packet, set_auto_mode};
use vigil_tests::{Pair, Running, only_log, read_log, text};
use vigil_types::{EngagePolicy, GuidanceState, Nanos, Reason, StepReport};

const HALF_A_SECOND_NS: Nanos = 500_000_000;

fn simulator() -> Running {
    Running::start("sim --status --airborne --instance 85 --seed 11 --family training")
}

fn wait_for_guided_flight(simulator: &Running) {
    simulator.wait_for_status("guided flight", |s| {
        s.guidance.as_deref() == Some("guided") && s.speed_m_s > 0.5
    });
}

#[test]
fn a_killed_simulator_makes_the_firmware_hold_and_its_return_resumes_the_flight() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = simulator();
    let log = text(folder.path());
    let flight = "firmware --instance 85 --engage auto --goal 18,4 --height 1.5";
    let mut firmware = Running::start(&format!("{flight} --log {log}"));
    wait_for_guided_flight(&first);
    drop(first);

    // The vehicle's end of the link is free now: whoever listens there sees what the firmware says without a vehicle.
    let socket = UdpSocket::bind(("127.0.0.1", 14280 + 85)).expect("the port of a killed simulator is free");
    let limited = socket.set_read_timeout(Some(Duration::from_secs(5)));
    limited.expect("a timeout");
    let mut heard = vigil_sim::CompanionView::default();
    let mut buffer = [0; 2048];
    for _ in 0..1000 {
        let length = socket.recv(&mut buffer).expect("the firmware goes on talking");
        heard.observe(&buffer[..length]);
        if heard.state_code.is_some_and(|code| code != GuidanceState::Guided as u8) {
            break;
        }
    }
    let state = heard.state_code.and_then(GuidanceState::from_code);
    assert!(
        matches!(state, Some(GuidanceState::Hold | GuidanceState::Standby)),
        "telemetry says {state:?}"
    );
    drop(socket);

    let second = simulator();
    wait_for_guided_flight(&second);
    firmware.signal(Signal::TERM);
    assert_eq!(firmware.wait(), Some(0));

    // In the log: from the last frame of the first simulator to the first step that was not guided any more.
    let mut steps = Vec::new();
    read_log(&only_log(folder.path()), |record| {
        let frame_ns = record.frame().map(|frame| frame.header.stamp_ns);
        steps.push((frame_ns, record.now_ns, record.report));
    });
    let is_guided = |report: &StepReport| report.state == GuidanceState::Guided;
    let until = |is: bool, from| (from..steps.len()).find(|i| is_guided(&steps[*i].2) == is);
    let left = until(true, 0).and_then(|guided| until(false, guided));
    let (before, since) = steps.split_at(left.expect("the firmware left guided flight"));
    let ((_, left_ns, report), last_frame_ns) = (since[0], before.iter().filter_map(|s| s.0).next_back());
    let forward_m_s = report.setpoint.map_or(0.0, |s| s.velocity_m_s.x);
    assert_eq!(forward_m_s, 0.0, "no forward motion is asked for");
    let (reasons, delay_ns) = (report.reasons, left_ns - last_frame_ns.expect("a frame"));
    println!(
        "{} ms from the last frame to {:?}",
        delay_ns / 1_000_000,
        reasons.iter().collect::<Vec<_>>()
    );
    assert!(delay_ns <= HALF_A_SECOND_NS, "{delay_ns} ns");
    assert!(
        reasons.contains(Reason::StaleFrame) || reasons.contains(Reason::StaleTelemetry),
        "{reasons:?}"
    );
}

/// Guidance computer, vehicle and a ground station, in lockstep.
struct Card {
    pair: Pair,
    sequence: u8,
}

impl Card {
    fn on(model: VehicleModel) -> Self {
        let pair = Pair::with(Family::Training, 11, |simulation, firmware| {
            (simulation.vehicle, firmware.engage) = (model.params(), EngagePolicy::Command);
        });
        Self { pair, sequence: 0 }
    }

    /// Steps until it is so, at most 20 s; what an operator asks is asked once a second until then.
    fn until(&mut self, what: &str, asked: Option<Request>, is_so: impl Fn(&StepReport, &str) -> bool) {
        for step in 0..400 {
            self.pair.simulate();
            if let (Some(request), 0) = (asked, step % 20) {
                self.sequence += 1;
                let request = packet(STATION, self.sequence, &request.message(1));
                assert!(self.pair.to_firmware.push(0, &request), "no room");
            }
            let report = self.pair.decide(true);
            if is_so(&report, self.pair.simulator.status().mode.name()) {
                return;
            }
        }
        panic!("{what}: never");
    }

    fn flies(report: &StepReport, mode: &str) -> bool {
        report.state == GuidanceState::Guided && mode == "offboard"
    }
}

/// PX4's test card for modes that another computer flies: engage, leave, engage again, let go, engage again, kill.
#[test]
fn the_test_card_of_an_external_mode_passes_on_every_model_and_a_silent_firmware_is_noticed_within_half_a_second() {
    for model in VehicleModel::ALL {
        let mut card = Card::on(model);
        card.until("engaged", Some(Request::Engage), Card::flies);
        // A ground station's Hold: guidance leaves, and leaves it at that.
        card.pair.to_vehicle(&packet(STATION, 0, &set_auto_mode(3.0)));
        card.until("lost", None, |report, _| report.reasons.contains(Reason::ModeLost));
        card.until("left", None, |report, mode| {
            report.setpoint.is_none() && report.reasons.contains(Reason::PilotInCommand) && mode == "hold"
        });
        for _ in 0..200 {
            card.pair.simulate();
            let report = card.pair.decide(true);
            assert_eq!(
                (report.setpoint, report.reasons.contains(Reason::PilotInCommand)),
                (None, true)
            );
            assert_eq!(card.pair.simulator.status().mode.name(), "hold");
        }
        card.until("engaged again", Some(Request::Engage), Card::flies);
        // Let go: it is still sent zeros until it holds by itself.
        card.until("let go", Some(Request::LetGo), |report, mode| {
            assert!(report.setpoint.is_some() || mode == "hold", "{mode}");
            mode == "hold" && !report.has_vehicle()
        });
        assert!(card.pair.simulator.status().failsafe.is_none(), "no failsafe held it");
        card.until("engaged a third time", Some(Request::Engage), Card::flies);
        card.until("moves", None, |report, _| {
            let speed_m_s = |k: vigil_types::Kinematics| k.velocity_ned_m_s.horizontal_norm();
            report.telemetry.kinematics.is_some_and(|k| speed_m_s(k) > 0.5)
        });
        let changed = card.pair.simulator.endpoint.saved().parameters;
        assert!(
            changed.is_empty(),
            "COM_OF_LOSS_T holds for whoever comes next: {changed:?}"
        );
        card.pair.silence();
        let silent_since_ns = card.pair.simulator.now_ns();
        while card.pair.simulator.status().mode.name() == "offboard" {
            card.pair.simulate();
            let silent_ns = card.pair.simulator.now_ns() - silent_since_ns;
            assert!(silent_ns <= HALF_A_SECOND_NS, "{} still waits", model.name());
        }
        assert!(card.pair.simulator.status().failsafe.is_some(), "and says why");
        for _ in 0..200 {
            card.pair.simulate();
        }
        assert_eq!(card.pair.simulator.status().mode.name(), "hold", "{}", model.name());
        let speed_m_s = card.pair.speed_m_s();
        assert!(speed_m_s < 0.3, "{} {speed_m_s}", model.name());
    }
}
