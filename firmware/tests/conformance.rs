//! One suite over every way to drive a step: over links and shared memory as the live loop does, lockstep in one process, in two, replay.

mod common;

use common::instance::Instance;
use common::{PATIENCE, PseudoTerminal, TestVehicle, VEHICLE, config, loopback, socket, step_over};
use rustix::io::ioctl_fionread;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::os::fd::OwnedFd;
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
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
use vigil_mavlink::framing::{FramingCounters, Packet, StreamFramer};
use vigil_types::{Datagrams, DepthFrame, GuidanceState, Nanos, Reason, STEP_NS, StepReport, StepTiming};

/// The far end: the suite puts things there, lets the firmware step, and looks at what came out.
trait Rig {
    /// Time as the firmware's clock will show it at the next step, at the latest.
    fn now_ns(&mut self) -> Nanos;
    fn put_frame(&mut self, frame: &DepthFrame);
    fn put_datagrams(&mut self, datagrams: &Datagrams);
    fn step(&mut self) -> StepReport;
    /// The datagrams that arrived at the far end since the last call.
    fn arrived(&mut self) -> Vec<Vec<u8>>;
}

/// What every implementation owes the flight stack.
fn suite(mut rig: impl Rig) {
    let mut vehicle = TestVehicle::hovering(2.5);

    // Nothing came: nothing is known, and that is said.
    let first = rig.step();
    assert_eq!(first.state, GuidanceState::Standby);
    assert!(first.reasons.contains(Reason::StaleFrame) && first.reasons.contains(Reason::LinkLost));
    assert_eq!((first.frame_sequence, first.frames_refused), (None, 0));

    // A frame arrives, once.
    let now_ns = rig.now_ns();
    rig.put_frame(&vehicle.frame(now_ns));
    let second = rig.step();
    assert_eq!((second.frame_sequence, second.frames_refused), (Some(0), 0));
    assert!(second.now_ns >= first.now_ns, "time does not go back");
    let third = rig.step();
    assert_eq!(
        (third.frame_sequence, third.frames_refused),
        (Some(0), 0),
        "given once, then only older"
    );
    let aged_ns = third.frame_age_ns.unwrap() - second.frame_age_ns.unwrap();
    assert_eq!(aged_ns, third.now_ns - second.now_ns);

    // Of two frames the newest wins; the one before is not seen at all.
    let now_ns = rig.now_ns();
    rig.put_frame(&vehicle.frame(now_ns));
    rig.put_frame(&vehicle.frame(now_ns + 1));
    let fourth = rig.step();
    assert_eq!((fourth.frame_sequence, fourth.frames_refused), (Some(2), 0));

    // A bad frame reaches the stack as it is, which refuses it.
    let now_ns = rig.now_ns();
    let mut torn = vehicle.frame(now_ns + 2);
    torn.depth[1000] = 0.25;
    rig.put_frame(&torn);
    let fifth = rig.step();
    assert_eq!((fifth.frame_sequence, fifth.frames_refused), (Some(2), 1));
    assert!(fifth.reasons.contains(Reason::BadFrame));

    // Datagrams arrive whole and in order: of two positions the later one counts.
    rig.arrived();
    rig.put_datagrams(&vehicle.telemetry());
    vehicle.position_ned_m.x = 3.25;
    rig.put_datagrams(&vehicle.telemetry());
    let sixth = rig.step();
    assert_eq!(sixth.telemetry.kinematics.unwrap().position_ned_m.x, 3.25);
    assert_eq!(sixth.telemetry.kinematics.unwrap().at_ns, sixth.now_ns);
    assert!(sixth.telemetry.heartbeat.unwrap().armed);
    assert!(!sixth.reasons.contains(Reason::LinkLost));
    let seventh = rig.step();
    assert_eq!(seventh.telemetry, sixth.telemetry, "each datagram is given once");

    // What is sent arrives whole, in order, nothing twice: the packets' own sequence numbers say so.
    for _ in 0..20 {
        let now_ns = rig.now_ns();
        rig.put_frame(&vehicle.frame(now_ns));
        rig.put_datagrams(&vehicle.telemetry());
        rig.step();
    }
    let arrived = rig.arrived();
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

/// The vehicle's end of a link.
trait FarEnd {
    /// Gives a datagram to the link; it has arrived when this returns.
    fn send(&mut self, datagram: &[u8]);
    /// Appends the packets that came.
    fn receive(&mut self, arrived: &mut Vec<Vec<u8>>);
}

impl FarEnd for UdpSocket {
    fn send(&mut self, datagram: &[u8]) {
        // On the loopback interface a datagram has arrived when its sending returns.
        UdpSocket::send(self, datagram).unwrap();
    }

    fn receive(&mut self, arrived: &mut Vec<Vec<u8>>) {
        arrived.extend(common::arrived(self));
    }
}

/// The far end of a byte stream.
struct StreamEnd<W> {
    wire: W,
    framer: StreamFramer,
    /// How many bytes wait at the link's end, where they take a moment to arrive.
    waiting: Option<OwnedFd>,
}

impl<W: Read + Write> FarEnd for StreamEnd<W> {
    fn send(&mut self, datagram: &[u8]) {
        let count = |fd| ioctl_fionread(fd).unwrap();
        let before = self.waiting.as_ref().map(count);
        self.wire.write_all(datagram).unwrap();
        while self.waiting.as_ref().map(count) != before.map(|n| n + datagram.len() as u64) {
            std::thread::yield_now();
        }
    }

    fn receive(&mut self, arrived: &mut Vec<Vec<u8>>) {
        let mut buffer = [0; 2048];
        let mut quiet = 0;
        // A pseudo-terminal hands on in the background.
        while quiet < 20 {
            match self.wire.read(&mut buffer) {
                Ok(len) => {
                    let mut counters = FramingCounters::default();
                    let feed = |p: &Packet<'_>| arrived.push(p.raw().to_vec());
                    self.framer.feed(&buffer[..len], &mut counters, feed);
                    assert_eq!(counters.garbage_bytes, 0);
                    quiet = 0;
                }
                Err(_) => {
                    std::thread::sleep(Duration::from_millis(1));
                    quiet += 1;
                }
            }
        }
    }
}

/// Shared memory and a link on this machine.
struct Live<L, F> {
    firmware: Firmware,
    frames: FrameSubscriber,
    link: L,
    publisher: FramePublisher,
    vehicle: F,
    steps: u64,
    _instance: Instance,
}

impl<L: Link, F: FarEnd> Live<L, F> {
    fn new(number: u32, link: L, vehicle: F) -> Self {
        let (instance, domain) = Instance::joined(number);
        Self {
            firmware: Firmware::new(&config().stack()).unwrap(),
            frames: FrameSubscriber::create(&domain, DEPTH_TOPIC).unwrap(),
            publisher: FramePublisher::create(&domain, DEPTH_TOPIC).unwrap(),
            link,
            vehicle,
            steps: 0,
            _instance: instance,
        }
    }
}

impl<L: Link, F: FarEnd> Rig for Live<L, F> {
    fn now_ns(&mut self) -> Nanos {
        monotonic_ns()
    }

    fn put_frame(&mut self, frame: &DepthFrame) {
        self.publisher.publish(frame).unwrap();
    }

    fn put_datagrams(&mut self, datagrams: &Datagrams) {
        for (_, datagram) in datagrams.iter() {
            self.vehicle.send(datagram);
        }
    }

    fn step(&mut self) -> StepReport {
        let (at, frame) = ((monotonic_ns(), self.steps), self.frames.newest().unwrap());
        self.steps += 1;
        step_over(&mut self.firmware, &mut self.link, at, frame.as_deref())
    }

    fn arrived(&mut self) -> Vec<Vec<u8>> {
        let mut arrived = Vec::new();
        self.vehicle.receive(&mut arrived);
        arrived
    }
}

/// A driver's end of lockstep and replay: collects a step's input, remembers the output.
struct Driver<S> {
    now_ns: Nanos,
    frame: Option<Box<DepthFrame>>,
    received: Datagrams,
    sent: Datagrams,
    arrived: Vec<Vec<u8>>,
    step: S,
}

impl<S: FnMut(Nanos, Option<&DepthFrame>, &Datagrams, &mut Datagrams) -> StepReport> Driver<S> {
    /// `step` runs one step: time, frame, datagrams in, datagrams out.
    fn new(step: S) -> Self {
        Self {
            now_ns: 0,
            frame: None,
            received: Datagrams::default(),
            sent: Datagrams::default(),
            arrived: Vec::new(),
            step,
        }
    }
}

impl<S: FnMut(Nanos, Option<&DepthFrame>, &Datagrams, &mut Datagrams) -> StepReport> Rig for Driver<S> {
    fn now_ns(&mut self) -> Nanos {
        self.now_ns
    }

    fn put_frame(&mut self, frame: &DepthFrame) {
        self.frame = Some(Box::new(frame.clone()));
    }

    fn put_datagrams(&mut self, datagrams: &Datagrams) {
        for (link, datagram) in datagrams.iter() {
            assert!(self.received.push(link, datagram));
        }
    }

    fn step(&mut self) -> StepReport {
        let frame = self.frame.take();
        let report = (self.step)(self.now_ns, frame.as_deref(), &self.received, &mut self.sent);
        self.now_ns += STEP_NS;
        self.received.clear();
        self.arrived
            .extend(self.sent.iter().map(|(_, datagram)| datagram.to_vec()));
        report
    }

    fn arrived(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.arrived)
    }
}

/// The firmware behind shared memory, as in another process.
struct OtherProcess {
    client: Option<LockstepClient>,
    reports: Receiver<StepReport>,
    firmware: Option<JoinHandle<()>>,
    steps: u64,
    _instance: Instance,
}

impl OtherProcess {
    fn start() -> Self {
        let (instance, domain) = Instance::joined(1);
        let number = instance.0;
        let (sender, reports) = channel();
        let firmware = std::thread::spawn(move || {
            let domain = Domain::open(number, "test-firmware").unwrap();
            let mut firmware = LockstepFirmware::new(&config()).unwrap();
            lockstep::serve(
                &mut firmware,
                &domain,
                PATIENCE,
                || false,
                |report| sender.send(*report).unwrap(),
            )
            .unwrap();
        });
        Self {
            client: Some(LockstepClient::connect(&domain, PATIENCE, || false).unwrap()),
            reports,
            firmware: Some(firmware),
            steps: 0,
            _instance: instance,
        }
    }
}

impl Drop for OtherProcess {
    fn drop(&mut self) {
        let finished = self.client.take().map(|client| client.finish(self.steps));
        let ended = self.firmware.take().map(JoinHandle::join);
        // A panic of the suite itself says more than these.
        if !std::thread::panicking() {
            finished.unwrap().unwrap();
            ended.unwrap().unwrap();
        }
    }
}

#[test]
fn lockstep_in_two_processes_conforms() {
    let mut process = OtherProcess::start();
    suite(Driver::new(move |now_ns, frame, received, sent| {
        let process = &mut process;
        let client = process.client.as_mut().unwrap();
        client.exchange(process.steps, now_ns, frame, received, sent).unwrap();
        process.steps += 1;
        process.reports.recv_timeout(PATIENCE).unwrap()
    }));
}

#[test]
fn a_udp_link_conforms() {
    let link = Gated::open(&LinkUrl::UdpIn(loopback()), VEHICLE, SigningGate::open()).unwrap();
    let vehicle = socket();
    vehicle.connect(link.local_address().unwrap()).unwrap();
    suite(Live::new(0, link, vehicle));
}

fn tcp_end(socket: TcpStream) -> StreamEnd<TcpStream> {
    socket.set_nonblocking(true).unwrap();
    socket.set_nodelay(true).unwrap();
    StreamEnd {
        wire: socket,
        framer: StreamFramer::default(),
        waiting: None,
    }
}

#[test]
fn a_tcp_server_conforms() {
    let link = Gated::open(&LinkUrl::TcpIn(loopback()), VEHICLE, SigningGate::open()).unwrap();
    let vehicle = TcpStream::connect(link.local_address().unwrap()).unwrap();
    suite(Live::new(2, link, tcp_end(vehicle)));
}

#[test]
fn a_tcp_client_conforms() {
    let vehicle = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = LinkUrl::TcpOut(vehicle.local_addr().unwrap());
    let mut link = Gated::open(&url, VEHICLE, SigningGate::open()).unwrap();
    // The first step's receiving calls.
    link.receive(monotonic_ns(), &mut Datagrams::default());
    let (socket, _) = vehicle.accept().unwrap();
    suite(Live::new(3, link, tcp_end(socket)));
}

#[test]
fn a_serial_line_conforms() {
    let line = PseudoTerminal::open();
    let url = format!("serial://{}:57600", line.device).parse().unwrap();
    let waiting = line.other_end();
    let link = Gated::open(&url, PeerRule::Anyone, SigningGate::open()).unwrap();
    let vehicle = StreamEnd {
        wire: line.master,
        framer: StreamFramer::default(),
        waiting: Some(waiting),
    };
    suite(Live::new(4, link, vehicle));
}

#[test]
fn lockstep_in_one_process_conforms() {
    let mut firmware = LockstepFirmware::new(&config()).unwrap();
    suite(Driver::new(move |now_ns, frame, received, sent| {
        *firmware.step(now_ns, frame, received, sent)
    }));
}

#[test]
fn replay_conforms() {
    let mut firmware = Firmware::new(&config().stack()).unwrap();
    let mut record = Box::<TickRecord>::default();
    let mut timing = StepTiming::default();
    suite(Driver::new(move |now_ns, frame, received, sent| {
        let (nothing, report) = (Datagrams::default(), StepReport::default());
        record.fill(now_ns, timing, frame, received, &nothing, &report);
        timing.step += 1;
        *replay::step_again(&mut firmware, &record, sent)
    }));
}
