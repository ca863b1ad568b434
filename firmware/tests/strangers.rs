//! Strangers flood the vehicle's link, before the vehicle appears and in flight: each setpoint goes out in its step, and the
//! link is never lost.
//!
//! Sockets are real, time is not: 20 steps are a second, however long they take.

mod common;

use common::{Random, TestVehicle, arrived, config, socket, step_over};
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use vigil_firmware::step::Firmware;
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::router::RoutedLinks;
use vigil_mavlink::common::*;
use vigil_mavlink::framing::{FramingCounters, StreamFramer, encode};
use vigil_mavlink::message;
use vigil_types::{GuidanceState, Nanos, Reason, STEP_NS};

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

/// The strangers' ends and the vehicle's.
trait Network {
    /// Sends as a stranger; what the system does not take is lost.
    fn shout(&mut self, stranger: usize, bytes: &[u8]);
    /// The vehicle comes.
    fn appear(&mut self) {}
    /// Sends as the vehicle.
    fn tell(&mut self, bytes: &[u8]);
    /// The packets that the vehicle got.
    fn heard(&mut self) -> Vec<Vec<u8>>;
}

struct Udp {
    link: SocketAddr,
    strangers: Vec<UdpSocket>,
    vehicle: UdpSocket,
}

impl Udp {
    fn new(link: SocketAddr) -> Self {
        Self {
            link,
            strangers: (0..STRANGERS).map(|_| socket()).collect(),
            vehicle: socket(),
        }
    }
}

impl Network for Udp {
    fn shout(&mut self, stranger: usize, bytes: &[u8]) {
        let _ = self.strangers[stranger].send_to(bytes, self.link);
    }

    fn tell(&mut self, bytes: &[u8]) {
        self.vehicle.send_to(bytes, self.link).unwrap();
    }

    fn heard(&mut self) -> Vec<Vec<u8>> {
        arrived(&self.vehicle)
    }
}

struct Tcp {
    link: SocketAddr,
    strangers: Vec<Option<TcpStream>>,
    /// Two who call and say nothing.
    silent: Vec<TcpStream>,
    vehicle: Option<TcpStream>,
    framer: StreamFramer,
}

impl Tcp {
    fn new(link: SocketAddr) -> Self {
        Self {
            link,
            strangers: (0..STRANGERS).map(|_| None).collect(),
            silent: (0..2).map(|_| TcpStream::connect(link).unwrap()).collect(),
            vehicle: None,
            framer: StreamFramer::default(),
        }
    }

    fn call(&self) -> TcpStream {
        let socket = TcpStream::connect(self.link).unwrap();
        socket.set_nonblocking(true).unwrap();
        socket.set_nodelay(true).unwrap();
        socket
    }
}

impl Network for Tcp {
    /// Who was hung up on calls again.
    fn shout(&mut self, stranger: usize, bytes: &[u8]) {
        if let Some(socket) = &mut self.strangers[stranger] {
            match socket.write(bytes) {
                Err(e) if e.kind() != ErrorKind::WouldBlock => self.strangers[stranger] = None,
                _ => {}
            }
        } else {
            self.strangers[stranger] = Some(self.call());
        }
    }

    fn appear(&mut self) {
        assert_eq!(self.silent.len(), 2);
        self.vehicle = Some(self.call());
    }

    /// A vehicle calls again when it is hung up on.
    fn tell(&mut self, bytes: &[u8]) {
        let socket = self.vehicle.as_mut().unwrap();
        if socket.write_all(bytes).is_err() {
            self.appear();
        }
    }

    fn heard(&mut self) -> Vec<Vec<u8>> {
        let Some(socket) = &mut self.vehicle else {
            return Vec::new();
        };
        let mut buffer = [0; 4096];
        let mut got = Vec::new();
        let mut counters = FramingCounters::default();
        while let Ok(len @ 1..) = socket.read(&mut buffer) {
            self.framer
                .feed(&buffer[..len], &mut counters, |p| got.push(p.raw().to_vec()));
        }
        got
    }
}

struct Flight<N: Network> {
    network: N,
    links: RoutedLinks,
    firmware: Firmware,
    vehicle: TestVehicle,
    content: Vec<Vec<u8>>,
    step: u64,
}

impl<N: Network> Flight<N> {
    fn new(scheme: &str, network: impl FnOnce(SocketAddr) -> N, content: Vec<Vec<u8>>) -> Self {
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let vehicle = format!("{scheme}://127.0.0.1:{port},system=1").parse().unwrap();
        let gate = SigningGate::new(None, AllowUnsigned::Loopback);
        let links = RoutedLinks::open(&vehicle, &[], gate).unwrap();
        Self {
            links,
            network: network(([127, 0, 0, 1], port).into()),
            firmware: Firmware::of(&config()).unwrap(),
            vehicle: TestVehicle::hovering(2.5),
            content,
            step: 0,
        }
    }

    /// One step: half of the flood, the vehicle, the other half. What guidance's state is and whether it misses the link.
    fn step(&mut self, vehicle_is_there: bool) -> (GuidanceState, bool) {
        self.step += 1;
        let now_ns: Nanos = self.step * STEP_NS;
        for i in 0..PER_STEP {
            if i == PER_STEP / 2 && vehicle_is_there {
                for (_, datagram) in self.vehicle.telemetry().iter() {
                    self.network.tell(datagram);
                }
            }
            let bytes = &self.content[i % self.content.len()];
            self.network.shout(i % STRANGERS, bytes);
        }
        let frame = self.vehicle.frame(now_ns);
        let report = step_over(&mut self.firmware, &mut self.links, (now_ns, self.step), Some(&frame));
        for packet in self.network.heard() {
            self.vehicle.hear(&packet);
        }
        self.vehicle.advance();
        let lost = [Reason::LinkLost, Reason::StaleTelemetry];
        (report.state, report.reasons.iter().any(|reason| lost.contains(&reason)))
    }
}

fn survives<N: Network>(what: &str, mut flight: Flight<N>) {
    // Two seconds of strangers alone.
    (0..40).for_each(|_| {
        flight.step(false);
    });
    assert!(flight.vehicle.heard.is_empty(), "{what}: nobody is answered");
    flight.network.appear();
    let waited = (0..100).find(|_| flight.step(true).0 == GuidanceState::Guided);
    assert!(waited.is_some(), "{what}: the vehicle does not get in");
    // Ten seconds of flight.
    let before = flight.vehicle.setpoints.len();
    for step in 0..200 {
        let setpoints = flight.vehicle.setpoints.len();
        let (_, is_lost) = flight.step(true);
        assert!(!is_lost, "{what}: the link is lost in step {step}");
        assert_eq!(flight.vehicle.setpoints.len(), setpoints + 1, "{what}: step {step}");
    }
    assert_eq!(flight.vehicle.setpoints.len() - before, 200);
    assert_eq!(flight.vehicle.bad_packets, 0);
    let last = flight.vehicle.setpoints.last().unwrap();
    assert!(last.vx > 0.3, "{what}: it flies");
}

#[test]
fn a_flood_of_datagrams_delays_no_setpoint_and_takes_nobodys_place() {
    for (what, content) in contents() {
        survives(what, Flight::new("udpin", Udp::new, content));
    }
}

#[test]
fn a_flood_over_tcp_delays_no_setpoint_and_takes_nobodys_place() {
    for (what, content) in contents() {
        survives(what, Flight::new("tcpin", Tcp::new, content));
    }
}
