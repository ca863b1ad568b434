//! Strangers flood the vehicle's link, before the vehicle appears and in flight: each setpoint goes out in its step, and the
//! link is never lost.
//!
//! Sockets are real, time is not: 20 steps are a second, however long they take.

mod common;

use common::{Random, TestVehicle, config, socket, step_over};
use std::io::{ErrorKind, Read, Result, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use vigil_firmware::step::Firmware;
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::router::RoutedLinks;
use vigil_mavlink::common::*;
use vigil_mavlink::framing::{FramingCounters, Packet, StreamFramer, encode};
use vigil_mavlink::message;
use vigil_types::{GuidanceState, Nanos, Reason, STEP_NS, StepReport};

/// 20 000 datagrams a second.
const PER_STEP: usize = 1000;
/// Ends of strangers that send in turn.
const STRANGERS: usize = 12;

fn packet(from: (u8, u8), message: &MavMessage) -> Vec<u8> {
    encode(from, 0, message)
}

/// What strangers send: one byte, garbage, MAVLink of no vehicle, heartbeats of another vehicle's autopilot.
fn contents() -> [(&'static str, Vec<Vec<u8>>); 4] {
    let mut random = Random(0x9E37_79B9_7F4A_7C15);
    let mut byte = || (random.next() >> 56) as u8;
    let garbage = (0..64)
        .map(|i| (0..20 + 4 * i).map(|_| byte()).chain([0xFD, 0xFE]).rev().collect())
        .collect();
    let heartbeat = |autopilot| message!(HEARTBEAT, autopilot, mavlink_version = 3);
    let (command, target_system, target_component) = (MavCmd::MAV_CMD_NAV_LAND, 1, 191);
    let land = message!(COMMAND_LONG, command, target_system, target_component);
    let stations = vec![
        packet((255, 190), &heartbeat(MavAutopilot::MAV_AUTOPILOT_INVALID)),
        packet((255, 190), &land),
        packet((1, 50), &MavMessage::STATUSTEXT(STATUSTEXT_DATA::DEFAULT)),
        packet((1, 1), &MavMessage::STATUSTEXT(STATUSTEXT_DATA::DEFAULT)),
    ];
    let others = (2..60)
        .map(|system| packet((system, 1), &heartbeat(MavAutopilot::MAV_AUTOPILOT_PX4)))
        .collect();
    [
        ("one byte", vec![vec![0xFD]]),
        ("garbage", garbage),
        ("MAVLink of no vehicle", stations),
        ("another vehicle's heartbeats", others),
    ]
}

/// An end that speaks to the link.
trait End: Sized {
    const SCHEME: &str;
    fn open(link: SocketAddr) -> Self;
    fn put(&mut self, bytes: &[u8]) -> Result<usize>;
    fn take(&mut self, buffer: &mut [u8]) -> Result<usize>;
}

/// Not connected: who is not listened to does not learn it.
impl End for (UdpSocket, SocketAddr) {
    const SCHEME: &str = "udpin";

    fn open(link: SocketAddr) -> Self {
        (socket(), link)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<usize> {
        self.0.send_to(bytes, self.1)
    }

    fn take(&mut self, buffer: &mut [u8]) -> Result<usize> {
        self.0.recv(buffer)
    }
}

impl End for TcpStream {
    const SCHEME: &str = "tcpin";

    fn open(link: SocketAddr) -> Self {
        let socket = TcpStream::connect(link).unwrap();
        socket.set_nonblocking(true).unwrap();
        socket.set_nodelay(true).unwrap();
        socket
    }

    fn put(&mut self, bytes: &[u8]) -> Result<usize> {
        self.write(bytes)
    }

    fn take(&mut self, buffer: &mut [u8]) -> Result<usize> {
        self.read(buffer)
    }
}

struct Flight<E: End> {
    address: SocketAddr,
    strangers: [Option<E>; STRANGERS],
    /// Two who call and say nothing.
    _silent: [E; 2],
    end: Option<E>,
    framer: StreamFramer,
    counters: FramingCounters,
    links: RoutedLinks,
    firmware: Firmware,
    vehicle: TestVehicle,
    content: Vec<Vec<u8>>,
    step: u64,
}

impl<E: End> Flight<E> {
    fn new(content: Vec<Vec<u8>>) -> Self {
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let vehicle = format!("{}://{address},system=1", E::SCHEME).parse().unwrap();
        let gate = SigningGate::new(None, AllowUnsigned::Loopback);
        let links = RoutedLinks::open(&vehicle, &[], gate).unwrap();
        Self {
            address,
            strangers: [(); STRANGERS].map(|()| None),
            _silent: [(); 2].map(|()| E::open(address)),
            end: None,
            framer: StreamFramer::default(),
            counters: FramingCounters::default(),
            links,
            firmware: Firmware::of(&config()).unwrap(),
            vehicle: TestVehicle::hovering(2.5),
            content,
            step: 0,
        }
    }

    /// Sends as a stranger: who was hung up on calls again; what the system does not take is lost.
    fn shout(&mut self, number: usize) {
        let stranger = &mut self.strangers[number % STRANGERS];
        let Some(end) = stranger else {
            *stranger = Some(E::open(self.address));
            return;
        };
        match end.put(&self.content[number % self.content.len()]) {
            Err(e) if e.kind() != ErrorKind::WouldBlock => *stranger = None,
            _ => {}
        }
    }

    /// One step: half of the flood, the vehicle, the other half.
    fn step(&mut self, vehicle_is_there: bool) -> StepReport {
        self.step += 1;
        let now_ns: Nanos = self.step * STEP_NS;
        for i in 0..PER_STEP {
            if i == PER_STEP / 2 && vehicle_is_there {
                for (_, datagram) in self.vehicle.telemetry().iter() {
                    let end = self.end.get_or_insert_with(|| E::open(self.address));
                    // A vehicle calls again when it is hung up on.
                    if end.put(datagram).ok() != Some(datagram.len()) {
                        self.end = None;
                        self.framer = StreamFramer::default();
                    }
                }
            }
            self.shout(i);
        }
        let frame = self.vehicle.frame(now_ns);
        let report = step_over(&mut self.firmware, &mut self.links, (now_ns, self.step), Some(&frame));
        let mut buffer = [0; 4096];
        while let Some(Ok(len @ 1..)) = self.end.as_mut().map(|end| end.take(&mut buffer)) {
            let hear = |packet: &Packet<'_>| self.vehicle.hear(packet.raw());
            self.framer.feed(&buffer[..len], &mut self.counters, hear);
        }
        self.vehicle.advance();
        report
    }
}

fn survives<E: End>() {
    for (what, content) in contents() {
        let mut flight = Flight::<E>::new(content);
        // Two seconds of strangers alone.
        for _ in 0..40 {
            let report = flight.step(false);
            let is_heard = !report.reasons.contains(Reason::LinkLost) || report.telemetry != Default::default();
            assert!(!is_heard, "{what}: taken for a vehicle");
        }
        let mut ends = flight.strangers.iter_mut().flatten();
        let is_answered = ends.any(|end| matches!(end.take(&mut [0; 64]), Ok(1..)));
        assert!(!is_answered, "{what}: nobody is answered");
        let waited = (0..100).find(|_| flight.step(true).state == GuidanceState::Guided);
        assert!(waited.is_some(), "{what}: the vehicle does not get in");
        // Ten seconds of flight.
        let before = flight.vehicle.setpoints.len();
        for step in 0..200 {
            let reasons = flight.step(true).reasons;
            let is_lost = reasons.contains(Reason::LinkLost) || reasons.contains(Reason::StaleTelemetry);
            assert!(!is_lost, "{what}: the link is lost in step {step}");
            assert_eq!(flight.vehicle.setpoints.len(), before + step + 1, "{what}: step {step}");
        }
        assert_eq!((flight.counters.garbage_bytes, flight.counters.bad_crc), (0, 0));
        let last = flight.vehicle.setpoints.last().unwrap();
        assert!(last.vx > 0.3, "{what}: it flies");
    }
}

#[test]
fn a_flood_of_datagrams_delays_no_setpoint_and_takes_nobodys_place() {
    survives::<(UdpSocket, SocketAddr)>();
}

#[test]
fn a_flood_over_tcp_delays_no_setpoint_and_takes_nobodys_place() {
    survives::<TcpStream>();
}
