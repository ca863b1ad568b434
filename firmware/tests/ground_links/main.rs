//! Several links at once: the vehicle's and those of ground stations.

#[path = "../common/mod.rs"]
mod common;
mod sharing;
mod signing;

use common::{LOITER, PseudoTerminal, Random, TestVehicle, arrived, config, say, set_parameter, socket, step_over};
use std::io::{Read, Write};
use std::net::UdpSocket;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use vigil_firmware::FirmwareConfig;
use vigil_firmware::step::Firmware;
use vigil_io::Link;
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::router::RoutedLinks;
use vigil_mavlink::common::*;
use vigil_mavlink::framing::{FramingCounters, MAX_PACKET_LEN, StreamFramer, encode, encode_payload, packets};
use vigil_mavlink::message;
use vigil_mavlink::signing::{
    SIGNATURE_LEN, Signing, SigningKey, SigningMemory, UNITS_PER_SECOND, timestamp_of_unix_ns,
};
use vigil_types::{Datagrams, EngagePolicy, Nanos, STEP_NS};

const VEHICLE: (u8, u8) = (1, 1);
const ME: (u8, u8) = (1, 191);

const STATION: (u8, u8) = (255, 190);
const OTHER_STATION: (u8, u8) = (254, 190);

fn packet(from: (u8, u8), message: &MavMessage) -> Vec<u8> {
    encode(from, 0, message)
}

fn heartbeat(from: (u8, u8)) -> Vec<u8> {
    packet(from, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT))
}

fn command(from: (u8, u8), (target_system, target_component): (u8, u8), command: MavCmd) -> Vec<u8> {
    packet(from, &message!(COMMAND_LONG, command, target_system, target_component))
}

/// Sender and number of a message.
type Seen = ((u8, u8), u32);

fn seen_in(bytes: &[u8]) -> Vec<Seen> {
    packets(bytes, &mut FramingCounters::default())
        .map(|p| ((p.system_id(), p.component_id()), p.message_id()))
        .collect()
}

const HEARTBEAT: u32 = 0;
const COMMAND_LONG: u32 = 76;

/// Somebody at the far end of a UDP link that the links call.
struct Far(UdpSocket);

impl Far {
    fn new() -> Self {
        Self(socket())
    }

    fn url(&self) -> String {
        format!("udpout://{}", self.0.local_addr().unwrap())
    }

    /// What came; who called first is who is answered.
    fn raw(&self) -> Vec<Vec<u8>> {
        if self.0.peer_addr().is_err()
            && let Ok((_, from)) = self.0.peek_from(&mut [0])
        {
            self.0.connect(from).unwrap();
        }
        arrived(&self.0)
    }

    fn heard(&self) -> Vec<Seen> {
        self.raw().iter().flat_map(|bytes| seen_in(bytes)).collect()
    }

    fn say(&self, bytes: &[u8]) {
        self.0.send(bytes).unwrap();
    }
}

/// A vehicle, two ground stations, and the links between them.
struct Rig {
    vehicle: Far,
    stations: [Far; 2],
    links: RoutedLinks,
    now_ns: Nanos,
}

impl Rig {
    /// `options` are those of the two ground links.
    fn new(options: [&str; 2], gate: SigningGate) -> Self {
        let (vehicle, stations) = (Far::new(), [Far::new(), Far::new()]);
        let ground = [0, 1].map(|i| format!("{}{}", stations[i].url(), options[i]).parse().unwrap());
        let links = RoutedLinks::open(&vehicle.url().parse().unwrap(), &ground, gate).unwrap();
        let mut rig = Self {
            vehicle,
            stations,
            links,
            now_ns: 0,
        };
        // The guidance computer's first heartbeat shows all where it is.
        rig.own(&[heartbeat(ME)]);
        for far in [&rig.vehicle, &rig.stations[0], &rig.stations[1]] {
            assert_eq!(far.heard(), [(ME, HEARTBEAT)]);
        }
        rig
    }

    fn unsigned() -> Self {
        Self::new(["", ""], SigningGate::new(None, AllowUnsigned::Loopback))
    }

    /// One step in which the guidance computer says nothing; what it gets, with the link.
    fn step(&mut self) -> Vec<(u8, Seen)> {
        self.own(&[])
    }

    /// One step in which the guidance computer says this.
    fn own(&mut self, said: &[Vec<u8>]) -> Vec<(u8, Seen)> {
        self.now_ns += STEP_NS;
        let mut received = Datagrams::default();
        self.links.receive(self.now_ns, &mut received);
        say(&mut self.links, said);
        let seen = |(link, bytes)| seen_in(bytes).into_iter().map(move |seen| (link, seen));
        received.iter().flat_map(seen).collect()
    }

    /// Everybody says who he is, as everybody does once a second.
    fn introduce(&mut self) {
        self.vehicle.say(&heartbeat(VEHICLE));
        self.stations[0].say(&heartbeat(STATION));
        self.stations[1].say(&heartbeat(OTHER_STATION));
        self.step();
        self.hush();
    }

    /// Forgets what was heard so far.
    fn hush(&self) {
        for far in [&self.vehicle, &self.stations[0], &self.stations[1]] {
            far.raw();
        }
    }
}

#[test]
fn the_vehicle_and_the_guidance_computer_are_seen_on_every_link_and_commanded_from_every_link() {
    let mut rig = Rig::unsigned();
    rig.vehicle.say(&heartbeat(VEHICLE));
    let got = rig.own(&[heartbeat(ME)]);
    assert_eq!(got, [(0, (VEHICLE, HEARTBEAT))]);
    for station in &rig.stations {
        assert_eq!(station.heard(), [(ME, HEARTBEAT), (VEHICLE, HEARTBEAT)]);
    }
    assert_eq!(
        rig.vehicle.heard(),
        [(ME, HEARTBEAT)],
        "nothing goes back where it came from"
    );

    // A broadcast goes everywhere else.
    rig.stations[0].say(&heartbeat(STATION));
    assert!(rig.step().is_empty(), "the guidance computer has no use for it");
    assert_eq!(rig.vehicle.heard(), [(STATION, HEARTBEAT)]);
    assert_eq!(rig.stations[1].heard(), [(STATION, HEARTBEAT)]);

    // A command goes to its target only, and the guidance computer answers for nobody else.
    rig.stations[0].say(&command(STATION, VEHICLE, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM));
    assert!(rig.step().is_empty());
    assert_eq!(rig.vehicle.heard(), [(STATION, COMMAND_LONG)]);
    rig.stations[0].say(&command(STATION, ME, MavCmd::MAV_CMD_NAV_LAND));
    assert_eq!(rig.step(), [(1, (STATION, COMMAND_LONG))]);
    rig.stations[0].say(&command(STATION, (1, 154), MavCmd::MAV_CMD_NAV_LAND));
    rig.stations[0].say(&command(STATION, (7, 1), MavCmd::MAV_CMD_NAV_LAND));
    assert!(rig.step().is_empty());
    assert!(
        rig.vehicle.heard().is_empty() && rig.stations[1].heard().is_empty(),
        "nobody saw those"
    );

    // An answer goes to who asked.
    let ack = packet(VEHICLE, &ack_for(STATION));
    rig.vehicle.say(&ack);
    rig.step();
    assert_eq!(rig.stations[0].raw(), [ack], "byte for byte");
    assert!(rig.stations[1].heard().is_empty());
    rig.own(&[packet(ME, &ack_for(STATION))]);
    assert_eq!(rig.stations[0].heard(), [(ME, 77)]);
    assert!(rig.stations[1].heard().is_empty() && rig.vehicle.heard().is_empty());
}

fn ack_for((target_system, target_component): (u8, u8)) -> MavMessage {
    let command = MavCmd::MAV_CMD_NAV_LAND;
    message!(COMMAND_ACK, command, target_system, target_component)
}

#[test]
fn nobody_on_a_ground_link_is_taken_for_the_vehicle_and_nobody_at_all_for_the_guidance_computer() {
    let mut rig = Rig::unsigned();
    rig.introduce();
    rig.stations[0].say(&heartbeat(VEHICLE));
    rig.stations[0].say(&heartbeat(ME));
    let land = command(ME, ME, MavCmd::MAV_CMD_NAV_LAND);
    rig.vehicle.say(&[heartbeat(ME), land].concat());
    assert_eq!(rig.step(), [(0, (ME, HEARTBEAT))], "a person is warned of a second one");
    assert!(rig.vehicle.heard().is_empty() && rig.stations[1].heard().is_empty());
    assert_eq!(rig.links.routing().impostors, 4);
    // Nor do the vehicle's commands go to the impostor.
    rig.own(&[command(ME, VEHICLE, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM)]);
    assert!(rig.stations[0].heard().is_empty());
    assert_eq!(rig.vehicle.heard(), [(ME, COMMAND_LONG)]);
    // Nor to one who was there before the vehicle said which system it is.
    rig.stations[0].say(&heartbeat((2, 1)));
    rig.step();
    rig.hush();
    rig.own(&[command((2, 191), (2, 1), MavCmd::MAV_CMD_COMPONENT_ARM_DISARM)]);
    assert!(rig.stations[0].heard().is_empty());
    assert_eq!(rig.vehicle.heard(), [((2, 191), COMMAND_LONG)]);
}

impl Random {
    /// A packet with a right checksum; or a SETUP_SIGNING to the guidance computer with a random key.
    fn packet(&mut self, is_setup: bool) -> Vec<u8> {
        let bytes: Vec<u8> = (0..32).flat_map(|_| self.next().to_le_bytes()).collect();
        let (from, sequence) = ((bytes[250], bytes[251]), bytes[252]);
        let packet = if is_setup {
            let message = MavMessage::SETUP_SIGNING(SETUP_SIGNING_DATA {
                initial_timestamp: self.next(),
                target_system: ME.0,
                target_component: ME.1,
                secret_key: bytes[..32].try_into().unwrap(),
            });
            encode(from, sequence, &message)
        } else {
            let mut write = || {
                let id = (self.next() % 450) as u32;
                encode_payload(from, sequence, id, &bytes[..usize::from(bytes[253])]).ok()
            };
            // Not every number is a message's.
            std::iter::repeat_with(&mut write).flatten().next().unwrap()
        };
        match bytes[254] % 4 {
            0 => signed(bytes[200..232].try_into().unwrap(), 0, &packet),
            _ => packet,
        }
    }
}

/// SETUP_SIGNING of the first station.
fn setup((target_system, target_component): (u8, u8), secret_key: [u8; 32]) -> Vec<u8> {
    let message = message!(SETUP_SIGNING, target_system, target_component, secret_key);
    packet(STATION, &message)
}

/// A packet signed at this moment, or later by `ahead_s`.
fn signed(key: [u8; 32], ahead_s: u64, bytes: &[u8]) -> Vec<u8> {
    let unix = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap();
    let at = timestamp_of_unix_ns(unix.as_nanos() as u64) + ahead_s * UNITS_PER_SECOND;
    let mut out = [0; MAX_PACKET_LEN + SIGNATURE_LEN];
    let len = Signing::new(SigningKey(key), 0, SigningMemory::default())
        .sign(at, bytes, &mut out)
        .unwrap();
    out[..len].to_vec()
}
