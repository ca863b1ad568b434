//! SIGKILL to either process in flight: the other reaches a named safe state within half a second, and the pair recovers
//! when the killed one is started again. Times are those of the stack's own clock and log, not of the test's.

use rustix::process::Signal;
use std::net::UdpSocket;
use std::path::Path;
use std::time::Duration;
use vigil_firmware::FirmwareConfig;
use vigil_sim::vehicle::VehicleModel;
use vigil_sim::world::{Family, generate};
use vigil_tests::ground::{Request, STATION, packet, set_auto_mode};
use vigil_tests::{Pair, Running, airborne, only_log, read_log, text};
use vigil_types::{EngagePolicy, GuidanceState, Nanos, Reason, StepReport};

const HALF_A_SECOND_NS: Nanos = 500_000_000;

fn simulator(instance: &str) -> Running {
    Running::start_line(&format!(
        "sim --status --airborne --instance {instance} --seed 11 --family training"
    ))
}

fn firmware(instance: &str, log: Option<&Path>) -> Running {
    let log = log.map_or_else(String::new, |folder| format!("--log {}", text(folder)));
    Running::start_line(&format!(
        "firmware --instance {instance} --engage auto --goal 18,4 --height 1.5 {log}"
    ))
}

fn wait_for_guided_flight(simulator: &Running) {
    simulator.wait_for_status("guided flight", |s| {
        s.guidance.as_deref() == Some("guided") && s.speed_m_s > 0.5
    });
}

#[test]
fn a_killed_simulator_makes_the_firmware_hold_and_its_return_resumes_the_flight() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = simulator("85");
    let mut firmware = firmware("85", Some(folder.path()));
    wait_for_guided_flight(&first);
    first.kill();

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

    let second = simulator("85");
    wait_for_guided_flight(&second);
    firmware.signal(Signal::TERM);
    assert_eq!(firmware.wait(), Some(0));

    // In the log: from the last frame of the first simulator to the first step that was not guided any more.
    let (mut last_frame_ns, mut left_ns, mut reasons) = (0, None, Default::default());
    let mut guided = false;
    read_log(&only_log(folder.path()), |record| {
        let is_guided = record.report.state == GuidanceState::Guided;
        if guided && !is_guided && left_ns.is_none() {
            left_ns = Some(record.now_ns);
            reasons = record.report.reasons;
            assert_eq!(
                record.report.setpoint.map_or(0.0, |s| s.velocity_m_s.x),
                0.0,
                "no forward motion is asked for"
            );
        }
        if left_ns.is_none() {
            guided |= is_guided;
            if let Some(frame) = record.frame() {
                last_frame_ns = frame.header.stamp_ns;
            }
        }
    });
    let delay_ns = left_ns.expect("the firmware left guided flight") - last_frame_ns;
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

#[test]
fn a_flight_leaves_the_patience_with_scripts_as_it_was_and_a_silent_firmware_is_noticed_within_half_a_second() {
    let mut pair = Pair::new(Family::Training, 11);
    pair.fly_guided(100);
    let changed = pair.simulator.saved().parameters;
    assert!(
        changed.is_empty(),
        "COM_OF_LOSS_T holds for whoever comes next: {changed:?}"
    );
    // The same in lockstep, where the delay is exact.
    pair.silence();
    let silent_since_ns = pair.simulator.now_ns();
    while pair.simulator.status().mode.name() == "offboard" {
        pair.simulate();
        assert!(
            pair.simulator.now_ns() - silent_since_ns <= HALF_A_SECOND_NS,
            "the vehicle still waits"
        );
    }
    assert!(pair.simulator.status().failsafe.is_some(), "and says why");
}

/// Guidance computer, vehicle and a ground station, in lockstep.
struct Card {
    pair: Pair,
    sequence: u8,
}

impl Card {
    fn on(model: VehicleModel) -> Self {
        let mut simulation = airborne(generate(Family::Training, 11), 11);
        simulation.vehicle = model.params();
        let config = FirmwareConfig {
            engage: EngagePolicy::Command,
            ..FirmwareConfig::to_goal(simulation.course.goal_ned_m())
        };
        Self {
            pair: Pair::of(&simulation, &config),
            sequence: 0,
        }
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
fn the_test_card_of_an_external_mode_passes_on_every_vehicle_model() {
    for model in VehicleModel::ALL {
        let mut card = Card::on(model);
        card.until("engaged", Some(Request::Engage), Card::flies);
        // A ground station's Hold: guidance leaves, and leaves it at that.
        card.pair.to_vehicle(&packet(STATION, 0, &set_auto_mode(3.0)));
        card.until("left", None, |report, mode| report.setpoint.is_none() && mode == "hold");
        for _ in 0..200 {
            card.pair.simulate();
            assert_eq!(card.pair.decide(true).setpoint, None);
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
        card.pair.silence();
        for _ in 0..200 {
            card.pair.simulate();
        }
        assert_eq!(card.pair.simulator.status().mode.name(), "hold", "{}", model.name());
        let speed_m_s = card.pair.speed_m_s();
        assert!(speed_m_s < 0.3, "{} {speed_m_s}", model.name());
    }
}
