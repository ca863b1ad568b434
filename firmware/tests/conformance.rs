//! One suite over every way to drive a step: over links and shared memory as the live loop does, lockstep in one process, in two, replay.

mod common;

use common::instance::Instance;
use common::{PATIENCE, PseudoTerminal, TestVehicle, VEHICLE, arrived, config, loopback, socket, step_over};
use rustix::io::ioctl_fionread;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::fd::OwnedFd;
use std::sync::mpsc::channel;
use std::time::Duration;
use vigil_firmware::link_url::LinkUrl;
use vigil_firmware::step::Firmware;
use vigil_firmware::{LockstepFirmware, lockstep, replay};
use vigil_io::Link;
use vigil_io::clock::monotonic_ns;
use vigil_io::gate::SigningGate;
use vigil_io::links::{Gated, PeerRule};
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FramePublisher, FrameSubscriber, LockstepClient};
use vigil_log::TickRecord;
use vigil_mavlink::framing::{FramingCounters, StreamFramer};
use vigil_types::{Datagrams, DepthFrame, GuidanceState, Nanos, Reason, STEP_NS, StepReport, StepTiming};

/// What every implementation owes the flight stack. `step` has it run a step at a time of the clock, with these frames and datagrams put
/// at its far end before; the report, and the datagrams that arrived at the far end.
fn suite(
    mut clock: impl FnMut() -> Nanos,
    mut step: impl FnMut(Nanos, &[Box<DepthFrame>], &Datagrams) -> (StepReport, Vec<Vec<u8>>),
) {
    let mut vehicle = TestVehicle::hovering(2.5);
    let nothing = Datagrams::default();

    // Nothing came: nothing is known, and that is said.
    let (first, _) = step(clock(), &[], &nothing);
    assert_eq!(first.state, GuidanceState::Standby);
    assert!(first.reasons.contains(Reason::StaleFrame) && first.reasons.contains(Reason::LinkLost));
    assert_eq!((first.frame_sequence, first.frames_refused), (None, 0));

    // A frame arrives, once.
    let now_ns = clock();
    let (second, _) = step(now_ns, &[vehicle.frame(now_ns)], &nothing);
    assert_eq!((second.frame_sequence, second.frames_refused), (Some(0), 0));
    assert!(second.now_ns >= first.now_ns, "time does not go back");
    let (third, _) = step(clock(), &[], &nothing);
    assert_eq!(
        (third.frame_sequence, third.frames_refused),
        (Some(0), 0),
        "given once, then only older"
    );
    let aged_ns = third.frame_age_ns.unwrap() - second.frame_age_ns.unwrap();
    assert_eq!(aged_ns, third.now_ns - second.now_ns);

    // Of two frames the newest wins; the one before is not seen at all.
    let now_ns = clock();
    let frames = [now_ns, now_ns + 1].map(|stamp_ns| vehicle.frame(stamp_ns));
    let (fourth, _) = step(now_ns, &frames, &nothing);
    assert_eq!((fourth.frame_sequence, fourth.frames_refused), (Some(2), 0));

    // A bad frame reaches the stack as it is, which refuses it.
    let now_ns = clock();
    let mut torn = vehicle.frame(now_ns + 2);
    torn.depth[1000] = 0.25;
    let (fifth, _) = step(now_ns, &[torn], &nothing);
    assert_eq!((fifth.frame_sequence, fifth.frames_refused), (Some(2), 1));
    assert!(fifth.reasons.contains(Reason::BadFrame));

    // Datagrams arrive whole and in order: of two positions the later one counts.
    let mut both = vehicle.telemetry();
    vehicle.position_ned_m.x = 3.25;
    for (link, datagram) in vehicle.telemetry().iter() {
        assert!(both.push(link, datagram));
    }
    let (sixth, mut arrived) = step(clock(), &[], &both);
    assert_eq!(sixth.telemetry.kinematics.unwrap().position_ned_m.x, 3.25);
    assert_eq!(sixth.telemetry.kinematics.unwrap().at_ns, sixth.now_ns);
    assert!(sixth.telemetry.heartbeat.unwrap().armed);
    assert!(!sixth.reasons.contains(Reason::LinkLost));
    let (seventh, more) = step(clock(), &[], &nothing);
    assert_eq!(seventh.telemetry, sixth.telemetry, "each datagram is given once");
    arrived.extend(more);

    // What is sent arrives whole, in order, nothing twice: the packets' own sequence numbers say so.
    for _ in 0..20 {
        let now_ns = clock();
        let (_, more) = step(now_ns, &[vehicle.frame(now_ns)], &vehicle.telemetry());
        arrived.extend(more);
    }
    assert!(!arrived.is_empty());
    let sequences: Vec<u8> = arrived.iter().map(|datagram| datagram[4]).collect();
    assert!(sequences.is_sorted_by(|a, b| a.wrapping_add(1) == *b), "{sequences:?}");
    for datagram in &arrived {
        vehicle.hear(datagram);
    }
    assert_eq!(vehicle.bad_packets, 0);
    let mut heard = vehicle.heard.iter();
    assert!(heard.all(|(from, _)| (from.system_id, from.component_id) == (1, 191)));
    let texts = only!(&vehicle.heard, STATUSTEXT);
    assert!(texts.count() >= 1, "its states are sent");
}

/// Over shared memory and a link on this machine. What `send` gives to the link has arrived when it returns; `receive` gives the packets
/// that came.
fn live(number: u32, mut link: impl Link, mut send: impl FnMut(&[u8]), mut receive: impl FnMut() -> Vec<Vec<u8>>) {
    let (_instance, domain) = Instance::joined(number);
    let mut firmware = Firmware::of(&config()).unwrap();
    let mut subscriber = FrameSubscriber::create(&domain, DEPTH_TOPIC).unwrap();
    let mut publisher = FramePublisher::create(&domain, DEPTH_TOPIC).unwrap();
    let mut steps = 0;
    suite(monotonic_ns, |now_ns, frames, datagrams| {
        for frame in frames {
            publisher.publish(frame).unwrap();
        }
        datagrams.iter().for_each(|(_, datagram)| send(datagram));
        let frame = subscriber.newest().unwrap();
        let report = step_over(&mut firmware, &mut link, (now_ns, steps), frame.as_deref());
        steps += 1;
        (report, receive())
    });
}

/// The same over a byte stream. `waiting` knows how many bytes wait at the link's end, where they take a moment to arrive.
fn live_stream<W>(number: u32, link: Gated, wire: &W, waiting: Option<OwnedFd>)
where
    for<'a> &'a W: Read + Write,
{
    let count = || waiting.as_ref().map(|fd| ioctl_fionread(fd).unwrap());
    let send = |datagram: &[u8]| {
        let before = count();
        (&mut &*wire).write_all(datagram).unwrap();
        while count() != before.map(|n| n + datagram.len() as u64) {
            std::thread::yield_now();
        }
    };
    let mut framer = StreamFramer::default();
    let receive = || {
        let (mut arrived, mut buffer, mut quiet) = (Vec::new(), [0; 2048], 0);
        // A pseudo-terminal hands on in the background.
        while quiet < 20 {
            if let Ok(len) = (&mut &*wire).read(&mut buffer) {
                let mut counters = FramingCounters::default();
                framer.feed(&buffer[..len], &mut counters, |p| arrived.push(p.raw().to_vec()));
                assert_eq!(counters.garbage_bytes, 0);
                quiet = 0;
            } else {
                std::thread::sleep(Duration::from_millis(1));
                quiet += 1;
            }
        }
        arrived
    };
    live(number, link, send, receive);
}

/// In lockstep and replay; `step` runs one step: time, frame, datagrams in, datagrams out.
fn driven(mut step: impl FnMut(Nanos, Option<&DepthFrame>, &Datagrams, &mut Datagrams) -> StepReport) {
    let (mut now_ns, mut sent) = (0, Datagrams::default());
    let clock = || {
        now_ns += STEP_NS;
        now_ns
    };
    suite(clock, |now_ns, frames, received| {
        let report = step(now_ns, frames.last().map(|frame| &**frame), received, &mut sent);
        (report, sent.iter().map(|(_, datagram)| datagram.to_vec()).collect())
    });
}

/// The firmware behind shared memory, as in another process.
#[test]
fn lockstep_in_two_processes_conforms() {
    let (instance, domain) = Instance::joined(1);
    let number = instance.0;
    let (sender, reports) = channel();
    let firmware = std::thread::spawn(move || {
        let domain = Domain::open(number, "test-firmware").unwrap();
        let mut firmware = LockstepFirmware::new(&config()).unwrap();
        let observe = |report: &StepReport| sender.send(*report).unwrap();
        lockstep::serve(&mut firmware, &domain, PATIENCE, || false, observe).unwrap();
    });
    let mut client = LockstepClient::connect(&domain, PATIENCE, || false).unwrap();
    let mut steps = 0;
    driven(|now_ns, frame, received, sent| {
        client.exchange(steps, now_ns, frame, received, sent).unwrap();
        steps += 1;
        reports.recv_timeout(PATIENCE).unwrap()
    });
    client.finish(steps).unwrap();
    firmware.join().unwrap();
}

#[test]
fn a_udp_link_conforms() {
    let link = Gated::open(&LinkUrl::UdpIn(loopback()), VEHICLE, SigningGate::open()).unwrap();
    let vehicle = socket();
    vehicle.connect(link.local_address().unwrap()).unwrap();
    // On the loopback interface a datagram has arrived when its sending returns.
    let send = |datagram: &[u8]| assert!(vehicle.send(datagram).is_ok());
    live(0, link, send, || arrived(&vehicle));
}

/// Where the vehicle's socket has been connected.
fn live_tcp(number: u32, link: Gated, socket: &TcpStream) {
    socket.set_nonblocking(true).unwrap();
    socket.set_nodelay(true).unwrap();
    live_stream(number, link, socket, None);
}

#[test]
fn a_tcp_server_conforms() {
    let link = Gated::open(&LinkUrl::TcpIn(loopback()), VEHICLE, SigningGate::open()).unwrap();
    let vehicle = TcpStream::connect(link.local_address().unwrap()).unwrap();
    live_tcp(2, link, &vehicle);
}

#[test]
fn a_tcp_client_conforms() {
    let vehicle = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = LinkUrl::TcpOut(vehicle.local_addr().unwrap());
    let mut link = Gated::open(&url, VEHICLE, SigningGate::open()).unwrap();
    // The first step's receiving calls.
    link.receive(monotonic_ns(), &mut Datagrams::default());
    let (socket, _) = vehicle.accept().unwrap();
    live_tcp(3, link, &socket);
}

#[test]
fn a_serial_line_conforms() {
    let line = PseudoTerminal::open();
    let url = format!("serial://{}:57600", line.device).parse().unwrap();
    let waiting = line.other_end();
    let link = Gated::open(&url, PeerRule::Anyone, SigningGate::open()).unwrap();
    live_stream(4, link, &line.master, Some(waiting));
}

#[test]
fn lockstep_in_one_process_conforms() {
    let mut firmware = LockstepFirmware::new(&config()).unwrap();
    driven(|now_ns, frame, received, sent| *firmware.step(now_ns, frame, received, sent));
}

#[test]
fn replay_conforms() {
    let mut firmware = Firmware::of(&config()).unwrap();
    let mut record = Box::<TickRecord>::default();
    let mut timing = StepTiming::default();
    driven(|now_ns, frame, received, sent| {
        let (nothing, report) = (Datagrams::default(), StepReport::default());
        record.fill(now_ns, timing, frame, received, &nothing, &report);
        timing.step += 1;
        *replay::step_again(&mut firmware, &record, sent)
    });
}
