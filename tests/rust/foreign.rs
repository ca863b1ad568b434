//! Vehicles that are not ours, of either autopilot, on our courses: scripted ones over UDP, in real time.

use std::net::UdpSocket;
use std::path::Path;
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use vigil_mavlink::Flavour;
use vigil_mavlink::framing::{FramingCounters, packets};
use vigil_sim::foreign::PoseState;
use vigil_tests::peer::{Mode, Peer};
use vigil_tests::{Running, has, refused, run_line, said, straight_course, text};
use vigil_types::{Nanos, STEP_NS};

/// Step of the scripted ArduPilot in which somebody changes it to GUIDED.
const GIVEN_AWAY_STEP: u32 = 400;

/// A scripted vehicle that runs in real time and speaks to a port of this machine.
struct Vehicle {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Peer>,
}

impl Vehicle {
    /// `script` is shown the vehicle before each step; what is left out of the sent messages is `silenced`.
    fn start(
        mut peer: Peer,
        port: u16,
        silenced: &'static [u32],
        mut script: impl FnMut(&mut Peer) + Send + 'static,
    ) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
            socket.set_nonblocking(true).expect("can be");
            let begun = Instant::now();
            let (mut step, mut buffer, mut counters) = (0_u32, [0; 2048], FramingCounters::default());
            while !ends.load(Ordering::Relaxed) {
                let now_ns = 60_000_000_000 + Nanos::from(step) * STEP_NS;
                while let Ok(len) = socket.recv(&mut buffer) {
                    for packet in packets(&buffer[..len], &mut counters) {
                        // The sensor's questions are not the guidance computer's.
                        if packet.component_id() == 191 {
                            peer.receive(now_ns, packet.raw());
                        }
                    }
                }
                script(&mut peer);
                for datagram in peer.step(now_ns) {
                    let mut found = packets(&datagram, &mut counters);
                    if found.next().is_some_and(|p| !silenced.contains(&p.message_id())) {
                        // Nobody may listen yet.
                        let _ = socket.send_to(&datagram, ("127.0.0.1", port));
                    }
                }
                step += 1;
                std::thread::sleep((Duration::from_nanos(STEP_NS) * step).saturating_sub(begun.elapsed()));
            }
            peer
        });
        Self { stop, thread }
    }

    fn end(self) -> Peer {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("it did not fail")
    }
}

/// Flies a scripted vehicle to a goal 6 m ahead; exit code and what was said.
fn fly(flavour: Flavour, instance: u16, script: impl FnMut(&mut Peer) + Send + 'static) -> (Option<i32>, String) {
    let folder = tempfile::tempdir().expect("a folder");
    let port = 15_100 + instance;
    let vehicle = Vehicle::start(Peer::on_the_ground(flavour), port, &[], script);
    let name = flavour.name().to_lowercase();
    let course = straight_course(folder.path(), 6.0, "");
    let course = text(&course);
    let output = run_line(&format!(
        "fly --vehicle {name} --link udpin://127.0.0.1:{port} --course {course} --seed 1 --pilot geometric \
         --instance {instance} --log {}",
        text(folder.path())
    ));
    let peer = vehicle.end();
    let text = said(&output);
    if output.status.code() == Some(0) {
        assert!(!peer.armed && peer.height_m == 0.0, "it landed and disarmed: {text}");
        assert!(!peer.disturbed_takeoff);
    }
    (output.status.code(), text)
}

#[test]
fn a_vehicle_that_already_runs_flies_our_course_whichever_autopilot_it_has() {
    let flights = [(Flavour::Px4, 71), (Flavour::ArduPilot, 72)].map(|(flavour, instance)| {
        // An ArduPilot starts in a pilot's mode: somebody changes it once the flight is ready, and has waited long enough to be asked to.
        let mut steps = 0;
        let gives_it_away = move |peer: &mut Peer| {
            steps += 1;
            if flavour == Flavour::ArduPilot && steps == GIVEN_AWAY_STEP {
                peer.mode = Mode::External;
            }
        };
        std::thread::spawn(move || fly(flavour, instance, gives_it_away))
    });
    for (flight, waits) in flights.into_iter().zip([false, true]) {
        let (code, text) = flight.join().expect("it did not fail");
        assert_eq!(text.contains("in its pilot's mode"), waits, "{text}");
        assert_eq!(code, Some(0), "{text}");
        let lines = ["success after", "on straight", "landed, disarmed", "report    "];
        has(&text, &lines);
    }
}

#[test]
fn a_position_that_jumps_in_flight_ends_it_without_a_verdict() {
    let (code, text) = fly(Flavour::Px4, 73, |peer| {
        // In the middle of the way, once.
        if (2.0..3.0).contains(&peer.north_m) {
            peer.north_m += 10.0;
        }
    });
    assert_eq!(code, Some(13), "{text}");
    let jumped = format!("no verdict: {}", PoseState::Jumped.name());
    has(&text, &[&jumped, "flown anew"]);
}

/// `vigil sensor render` on an instance.
fn sensor(instance: u16, course: &Path, further: &str, diagnostics: Stdio) -> Running {
    let (port, course) = (15_100 + instance, text(course));
    let line =
        format!("sensor render --pose udpin://127.0.0.1:{port} --instance {instance} --course {course} --seed 1 ");
    Running::start_saying(&(line + further), diagnostics)
}

#[test]
fn a_vehicle_that_never_reports_its_position_is_named_and_gets_no_frames_and_another_sender_is_named() {
    const HEARTBEAT: u32 = 0;
    const LOCAL_POSITION_NED: u32 = 32;
    let folder = tempfile::tempdir().expect("a folder");
    let course = straight_course(folder.path(), 6.0, "");
    let sensor = sensor(74, &course, "--status", Stdio::piped());
    let silent = sensor.wait_for_status("a first status", |_| true);
    assert_eq!(silent.pose.as_deref(), Some(PoseState::Silent.name()));
    let start = |silenced| Vehicle::start(Peer::on_the_ground(Flavour::Px4), 15_174, silenced, |_| {});
    let other = start(&[HEARTBEAT]);
    sensor.wait_for_status("half a second later", |s| s.time_s > silent.time_s + 0.5);
    let vehicle = start(&[LOCAL_POSITION_NED]);
    sensor.wait_for_words("pose       others beside system 1 send to udpin://127.0.0.1:15174, unheard: name one");
    sensor.wait_for_status("the missing position", |s| {
        s.pose.as_deref() == Some(PoseState::NoPosition.name())
    });
    // `vigil doctor` is for what is then to be done; it listens on a link of its own.
    vehicle.end();
    other.end();
}

#[test]
fn a_vehicle_that_flies_itself_into_a_column_is_judged_and_a_second_sensor_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let column = "[[column]]\nnorth_m = 5.0\neast_m = 0.0\nradius_m = 0.5\nheight_m = 5.0\n";
    let course = straight_course(folder.path(), 15.0, column);
    let mut flight = sensor(75, &course, "--status --end-after 0", Stdio::inherit());
    flight.wait_for_status("a first status", |_| true);
    let line = "sensor render --pose udpin://127.0.0.1:15199 --instance 75 --course";
    refused(&run_line(&format!("{line} {}", text(&course))), &["already"]);

    let vehicle = Vehicle::start(Peer::in_the_air(Flavour::Px4), 15_175, &[], |peer| {
        peer.mode = Mode::Loiter;
        peer.north_m += 0.1;
    });
    assert_eq!(flight.wait(), Some(10));
    let last = flight.rest().pop().expect("a last status");
    assert!(last.contains("\"outcome\":\"collision\""), "{last}");
    vehicle.end();
}
