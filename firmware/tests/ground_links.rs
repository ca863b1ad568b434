//! Several links at once: the vehicle's and those of ground stations.

mod common;

use common::{PseudoTerminal, SENSOR_ID, TestVehicle, config};
use std::io::{Read, Write};
use std::net::UdpSocket;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use vigil_firmware::FirmwareConfig;
use vigil_firmware::config::{SigningConfig, StateConfig};
use vigil_firmware::ports::Link;
use vigil_firmware::ports::gate::{AllowUnsigned, SigningGate};
use vigil_firmware::ports::handed::{HandedClock, HandedFrame};
use vigil_firmware::ports::router::RoutedLinks;
use vigil_firmware::step::Firmware;
use vigil_mavlink::MavHeader;
use vigil_mavlink::common::*;
use vigil_mavlink::framing::{FramingCounters, MAX_PACKET_LEN, StreamFramer, packets, serialize, serialize_payload};
use vigil_mavlink::signing::{
    SIGNATURE_LEN, Signing, SigningKey, SigningMemory, UNITS_PER_SECOND, timestamp_of_unix_ns,
};
use vigil_types::{Datagrams, EngagePolicy, Nanos, STEP_NS, StepTiming};

const VEHICLE: (u8, u8) = (1, 1);
const ME: (u8, u8) = (1, 191);
const STATION: (u8, u8) = (255, 190);
const OTHER_STATION: (u8, u8) = (254, 190);

fn packet(from: (u8, u8), message: &MavMessage) -> Vec<u8> {
    let header = MavHeader {
        system_id: from.0.into(),
        component_id: from.1,
        sequence: 0,
    };
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize(header, message, &mut out).unwrap();
    out[..len].to_vec()
}

fn heartbeat(from: (u8, u8)) -> Vec<u8> {
    packet(from, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT))
}

fn command(from: (u8, u8), target: (u8, u8), number: MavCmd) -> Vec<u8> {
    let command = MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        command: number,
        target_system: target.0,
        target_component: target.1,
        ..COMMAND_LONG_DATA::DEFAULT
    });
    packet(from, &command)
}

/// Sender and number of a message.
type Seen = ((u8, u8), u32);

fn seen_in(bytes: &[u8]) -> Vec<Seen> {
    let mut counters = FramingCounters::default();
    packets(bytes, &mut counters)
        .map(|p| ((p.system_id(), p.component_id()), p.message_id()))
        .collect()
}

const HEARTBEAT: u32 = 0;
const COMMAND_LONG: u32 = 76;

/// Somebody at the far end of a UDP link that the links call.
struct Far(UdpSocket);

impl Far {
    fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_nonblocking(true).unwrap();
        Self(socket)
    }

    fn url(&self) -> String {
        format!("udpout://{}", self.0.local_addr().unwrap())
    }

    /// On the loopback interface a datagram has arrived when its sending returns.
    fn raw(&self) -> Vec<Vec<u8>> {
        let mut buffer = [0; 2048];
        let mut got = Vec::new();
        while let Ok((len, from)) = self.0.recv_from(&mut buffer) {
            if self.0.peer_addr().is_err() {
                self.0.connect(from).unwrap();
            }
            got.push(buffer[..len].to_vec());
        }
        got
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
        // The guidance computer's first heartbeat tells all where it is.
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
        let mut sent = Datagrams::default();
        said.iter().for_each(|packet| assert!(sent.push(0, packet)));
        self.links.send(&sent);
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

fn ack_for(target: (u8, u8)) -> MavMessage {
    MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
        command: MavCmd::MAV_CMD_NAV_LAND,
        target_system: target.0,
        target_component: target.1,
        ..COMMAND_ACK_DATA::DEFAULT
    })
}

#[test]
fn nobody_on_a_ground_link_is_taken_for_the_vehicle_and_nobody_at_all_for_the_guidance_computer() {
    let mut rig = Rig::unsigned();
    rig.introduce();
    rig.stations[0].say(&heartbeat(VEHICLE));
    rig.stations[0].say(&heartbeat(ME));
    rig.vehicle.say(&heartbeat(ME));
    assert!(rig.step().is_empty());
    assert!(rig.vehicle.heard().is_empty() && rig.stations[1].heard().is_empty());
    assert_eq!(rig.links.routing().impostors, 3);
    // Nor do the vehicle's commands go to the impostor.
    rig.own(&[command(ME, VEHICLE, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM)]);
    assert!(rig.stations[0].heard().is_empty());
    assert_eq!(rig.vehicle.heard(), [(ME, COMMAND_LONG)]);
}

/// SETUP_SIGNING of the first station.
fn setup(target: (u8, u8), key: [u8; 32]) -> Vec<u8> {
    let message = MavMessage::SETUP_SIGNING(SETUP_SIGNING_DATA {
        target_system: target.0,
        target_component: target.1,
        secret_key: key,
        ..SETUP_SIGNING_DATA::DEFAULT
    });
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

/// A configuration that keeps its state there and hears signed packets only on the first ground link.
fn with_state(folder: &Path) -> FirmwareConfig {
    FirmwareConfig {
        state: StateConfig {
            directory: Some(folder.join("state")),
            ..StateConfig::default()
        },
        ..FirmwareConfig::default()
    }
}

/// The texts in what somebody heard, and whether each packet was signed.
fn texts(far: &Far) -> Vec<(String, bool)> {
    let mut counters = FramingCounters::default();
    let mut found = Vec::new();
    for bytes in far.raw() {
        for packet in packets(&bytes, &mut counters) {
            if let Ok(MavMessage::STATUSTEXT(m)) = packet.message() {
                found.push((m.text.to_str().unwrap().to_owned(), packet.is_signed()));
            }
        }
    }
    found
}

#[test]
fn a_first_key_from_setup_signing_is_in_force_at_once_kept_for_the_next_start_and_changed_by_whoever_has_it() {
    const KEY: [u8; 32] = [0xC3; 32];
    let folder = tempfile::tempdir().unwrap();
    let mut config = with_state(folder.path());
    let key_file = folder.path().join("state/firmware0.key");
    let land = command(STATION, ME, MavCmd::MAV_CMD_NAV_LAND);
    let captured = signed(KEY, 0, &land);
    {
        // Who did not ask for it gets no key from the link.
        let mut rig = Rig::new(["", ""], config.gate().unwrap());
        rig.stations[0].say(&setup(ME, KEY));
        assert!(rig.step().is_empty());
        let told = [("signing key refused: see --accept-first-key".to_owned(), false)];
        assert_eq!(texts(&rig.stations[0]), told);
        assert_eq!(rig.links.statistics().signing.unsigned_key, 1);
    }
    config.signing.accept_first_key = true;
    {
        let mut rig = Rig::new(["", ""], config.gate().unwrap());
        assert!(!key_file.exists(), "nothing is signed yet");
        rig.stations[0].say(&setup(ME, KEY));
        assert!(rig.step().is_empty(), "the flight stack and its log do not see the key");
        for far in [&rig.vehicle, &rig.stations[0], &rig.stations[1]] {
            assert_eq!(texts(far), [("signing key accepted".to_owned(), true)]);
        }
        for (bytes, passes) in [
            (&captured, true),
            (&captured, false),
            (&signed([1; 32], 1, &land), false),
            (&signed(KEY, 120, &land), false),
            (&signed(KEY, 2, &land), true),
        ] {
            rig.stations[1].say(bytes);
            assert_eq!(!rig.step().is_empty(), passes);
        }
        // Now only who has it changes it. A command of before comes again with another key, and then with the same: it
        // stays refused.
        rig.stations[0].say(&setup(ME, [5; 32]));
        rig.step();
        for (present, next) in [(KEY, [5; 32]), ([5; 32], KEY)] {
            rig.stations[0].say(&signed(present, 5, &setup(ME, next)));
            rig.step();
            rig.stations[1].say(&captured);
            assert!(rig.step().is_empty());
        }
        assert_eq!(rig.links.statistics().signing.unsigned_key, 1);
    }
    let mode = std::fs::metadata(&key_file).unwrap().permissions().mode() & 0o777;
    let folder_mode = std::fs::metadata(key_file.parent().unwrap())
        .unwrap()
        .permissions()
        .mode()
        & 0o777;
    assert_eq!((mode, folder_mode), (0o600, 0o700));
    let mut rig = Rig::new(["", ""], config.gate().unwrap());
    for (bytes, passes) in [(&captured, false), (&signed(KEY, 10, &land), true)] {
        rig.stations[0].say(bytes);
        assert_eq!(!rig.step().is_empty(), passes, "after the restart");
    }
}

/// A configuration whose key is in a file of the user's own.
fn with_key(folder: &Path, key: [u8; 32]) -> (FirmwareConfig, PathBuf) {
    let path = folder.join("vigil.key");
    std::fs::write(&path, key).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    let signing = SigningConfig {
        key_file: Some(path.clone()),
        ..SigningConfig::default()
    };
    let config = FirmwareConfig {
        signing,
        ..FirmwareConfig::default()
    };
    (config, path)
}

#[test]
fn only_a_packet_signed_with_the_present_key_sets_another_and_zeros_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let (config, path) = with_key(folder.path(), [7; 32]);
    {
        // This machine's packets need no signature here; a key does.
        let mut rig = Rig::new(["", ""], config.gate().unwrap());
        rig.stations[0].say(&setup(ME, [1; 32]));
        rig.step();
        let refused = "signing key refused: not signed with present one";
        assert_eq!(texts(&rig.stations[0]), [(refused.to_owned(), true)]);
        rig.stations[0].say(&signed([1; 32], 0, &setup(ME, [1; 32])));
        rig.vehicle.say(&setup(ME, [1; 32]));
        rig.step();
        assert_eq!(texts(&rig.stations[0]), [], "told once in a while");
        rig.stations[0].say(&signed([7; 32], 0, &setup(ME, [0; 32])));
        rig.step();
        let zeros = "signing key refused: all zeros";
        assert_eq!(texts(&rig.stations[0]), [(zeros.to_owned(), true)]);
        assert_eq!(std::fs::read(&path).unwrap(), [7; 32]);
        // Who has the key may set another, which takes the place of the one in the file.
        rig.stations[0].say(&signed([7; 32], 1, &setup(ME, [8; 32])));
        rig.step();
        rig.hush();
        rig.stations[0].say(&signed([8; 32], 2, &heartbeat(STATION)));
        rig.step();
        assert_eq!(rig.vehicle.heard().last(), Some(&(STATION, HEARTBEAT)));
    }
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "08".repeat(32));
}

/// A hundred thousand packets each that are right as MAVLink and made of random bytes, each tenth a SETUP_SIGNING to the
/// guidance computer, unsigned or signed with random keys.
#[test]
fn random_valid_packets_change_no_key() {
    for has_key in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let (with_key, path) = with_key(folder.path(), [7; 32]);
        let without = with_state(folder.path());
        let config = if has_key { with_key } else { without };
        let mut rig = Rig::new(["", ""], config.gate().unwrap());
        let mut random = Random(0x9E37_79B9_7F4A_7C15);
        for _ in 0..2000 {
            for i in 0..50 {
                let packet = random.packet(i % 10 == 0);
                let from = if i % 2 == 0 { &rig.vehicle } else { &rig.stations[0] };
                from.say(&packet);
            }
            rig.step();
            rig.hush();
        }
        let signing = rig.links.statistics().signing;
        assert!(signing.unsigned_key > 5000, "{signing:?}");
        assert_eq!(signing.signed, 0);
        // The present key, or none, is in force as before.
        rig.own(&[heartbeat(ME)]);
        let heard = rig.stations[1].raw();
        let right = signed([7; 32], 1, &heartbeat(STATION));
        assert!(heard.iter().all(|bytes| (bytes[2] & 1 == 1) == has_key));
        rig.stations[1].say(&right);
        rig.step();
        assert_eq!(rig.links.statistics().signing.signed, u64::from(has_key));
        drop(rig);
        assert_eq!(std::fs::read(&path).unwrap(), [7; 32]);
        assert!(!folder.path().join("state/firmware0.key").exists());
    }
}

/// A generator whose stream never changes (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// A packet with a right checksum; or a SETUP_SIGNING to the guidance computer with a random key.
    fn packet(&mut self, is_setup: bool) -> Vec<u8> {
        let bytes: Vec<u8> = (0..32).flat_map(|_| self.next().to_le_bytes()).collect();
        let header = MavHeader {
            system_id: u32::from(bytes[250]),
            component_id: bytes[251],
            sequence: bytes[252],
        };
        let mut out = [0; MAX_PACKET_LEN];
        let len = if is_setup {
            let message = MavMessage::SETUP_SIGNING(SETUP_SIGNING_DATA {
                initial_timestamp: self.next(),
                target_system: ME.0,
                target_component: ME.1,
                secret_key: bytes[..32].try_into().unwrap(),
            });
            serialize(header, &message, &mut out).unwrap()
        } else {
            let mut write = || {
                let id = (self.next() % 450) as u32;
                serialize_payload(header, id, &bytes[..usize::from(bytes[253])], &mut out).ok()
            };
            // Not every number is a message's.
            std::iter::repeat_with(&mut write).flatten().next().unwrap()
        };
        match bytes[254] % 4 {
            0 => signed(bytes[200..232].try_into().unwrap(), 0, &out[..len]),
            _ => out[..len].to_vec(),
        }
    }
}

#[test]
fn a_ground_stations_serial_line_that_disappears_and_returns_is_served_again_and_the_flight_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let device = folder.path().join("ttyStation");
    let vehicle = Far::new();
    let mut line = PseudoTerminal::open();
    symlink(&line.device, &device).unwrap();
    let ground = format!("serial://{}:57600,unsigned=always", device.display());
    let gate = SigningGate::new(None, AllowUnsigned::Loopback);
    let mut links = RoutedLinks::open(&vehicle.url().parse().unwrap(), &[ground.parse().unwrap()], gate).unwrap();
    let mut sent = Datagrams::default();
    sent.push(0, &heartbeat(ME));
    let mut step = |at_step: Nanos| {
        let mut received = Datagrams::default();
        links.receive(at_step * STEP_NS, &mut received);
        links.send(&sent);
        received.len()
    };
    let land = command(STATION, ME, MavCmd::MAV_CMD_NAV_LAND);
    line.master.write_all(&land).unwrap();
    assert_eq!((1..100).map(&mut step).sum::<usize>(), 1);
    assert_eq!(vehicle.heard().len(), 99);

    drop(line);
    std::fs::remove_file(&device).unwrap();
    (100..200).for_each(|at| assert_eq!(step(at), 0));
    assert_eq!(vehicle.heard().len(), 100, "each setpoint goes out");

    line = PseudoTerminal::open();
    symlink(&line.device, &device).unwrap();
    // It is looked for once a second.
    (200..230).for_each(|at| assert_eq!(step(at), 0));
    line.master.write_all(&land).unwrap();
    assert_eq!((230..330).map(&mut step).sum::<usize>(), 1);
    let mut bytes = [0; 4096];
    let len = line.master.read(&mut bytes).unwrap();
    assert!(seen_in(&bytes[..len]).contains(&(ME, HEARTBEAT)), "and hears again");
}

#[test]
fn a_signing_key_is_passed_on_to_nobody_and_is_not_in_the_log() {
    let gate = SigningGate::new(None, AllowUnsigned::Loopback).accepting_first_key(true);
    let mut rig = Rig::new(["", ""], gate);
    rig.introduce();
    for target in [VEHICLE, (0, 0), (254, 190)] {
        rig.stations[0].say(&setup(target, [9; 32]));
        // On the vehicle's link, behind something that may pass.
        rig.vehicle.say(&[heartbeat((1, 50)), setup(target, [9; 32])].concat());
        assert_eq!(rig.step(), [(0, ((1, 50), HEARTBEAT))]);
        assert!(rig.vehicle.heard().is_empty());
        assert!(rig.stations[1].heard().iter().all(|(_, id)| *id == HEARTBEAT));
    }
}

#[test]
fn a_flood_on_one_link_starves_none_of_the_others() {
    // 50 Mbit/s: 312 KB in a step. Commands for the vehicle and for the guidance computer, of senders made up by the
    // hundred, on the first station's link.
    const STEPS: usize = 100;
    let mut rig = Rig::unsigned();
    rig.introduce();
    let mut from_other = [0, 0];
    let mut from_flood = 0;
    let (mut to_vehicle, mut own_at_vehicle, mut at_other, mut of_vehicle) = (0, 0, 0, 0);
    for step in 0..STEPS {
        let mut flooded = 0;
        let mut made_up = step as u8;
        while flooded < 312_000 {
            made_up = made_up.wrapping_add(1);
            let target = if made_up.is_multiple_of(2) { VEHICLE } else { ME };
            let mut datagram = Vec::new();
            while datagram.len() < 1400 {
                datagram.extend(command((made_up | 2, made_up), target, MavCmd::MAV_CMD_NAV_LAND));
            }
            flooded += datagram.len();
            // The socket's queue is full at some time; the rest is lost, as on any network.
            let _ = rig.stations[0].0.send(&datagram);
        }
        rig.vehicle.say(&heartbeat(VEHICLE));
        rig.stations[1].say(&command(OTHER_STATION, VEHICLE, MavCmd::MAV_CMD_NAV_TAKEOFF));
        rig.stations[1].say(&command(OTHER_STATION, ME, MavCmd::MAV_CMD_NAV_GUIDED_ENABLE));
        for (link, (from, _)) in rig.own(&[command(ME, VEHICLE, MavCmd::MAV_CMD_DO_SET_MODE)]) {
            match (link, from) {
                (0, VEHICLE) => of_vehicle += 1,
                (2, OTHER_STATION) => from_other[1] += 1,
                _ => from_flood += 1,
            }
        }
        for (from, _) in rig.vehicle.heard() {
            match from {
                ME => own_at_vehicle += 1,
                OTHER_STATION => from_other[0] += 1,
                _ => to_vehicle += 1,
            }
        }
        at_other += rig.stations[1]
            .heard()
            .iter()
            .filter(|(from, _)| *from == VEHICLE)
            .count();
        rig.stations[0].raw();
    }
    assert_eq!(own_at_vehicle, STEPS, "each setpoint goes out");
    assert_eq!(from_other, [STEPS, STEPS], "each command of the other station arrives");
    assert_eq!(
        (of_vehicle, at_other),
        (STEPS, STEPS),
        "and the vehicle's telemetry everywhere"
    );
    assert!(
        from_flood <= 8 * STEPS,
        "{from_flood} packets of the flood reached the flight stack"
    );
    assert!(to_vehicle > STEPS, "what there is room for is passed on");
    assert!(rig.links.routing().crowded_out > 1000);
}

#[test]
fn on_a_slow_line_to_the_vehicle_the_setpoints_go_first() {
    let line = PseudoTerminal::open();
    let station = Far::new();
    let vehicle = format!("serial://{}:57600,unsigned=always", line.device)
        .parse()
        .unwrap();
    let gate = SigningGate::new(None, AllowUnsigned::Loopback);
    let mut links = RoutedLinks::open(&vehicle, &[station.url().parse().unwrap()], gate).unwrap();
    let mut sent = Datagrams::default();
    sent.push(0, &heartbeat(ME));
    links.send(&sent);
    station.raw();
    let mut framer = StreamFramer::default();
    let mut counters = FramingCounters::default();
    let (mut own, mut others, mut sequences) = (0, 0, Vec::new());
    for step in 1..=100 {
        for _ in 0..60 {
            let _ = station.0.send(&heartbeat(STATION));
        }
        links.receive(step * STEP_NS, &mut Datagrams::default());
        links.send(&sent);
        let mut bytes = [0; 65_536];
        while let Ok(len) = (&line.master).read(&mut bytes) {
            framer.feed(&bytes[..len], &mut counters, |p| {
                match (p.system_id(), p.component_id()) {
                    ME => {
                        own += 1;
                        sequences.push(p.sequence());
                    }
                    _ => others += 1,
                }
            });
        }
    }
    assert_eq!((own, counters.bad_crc), (101, 0));
    assert!(sequences.is_sorted_by(|a, b| a.wrapping_add(1) == *b), "{sequences:?}");
    // 5760 bytes per second in 5 s, of which the setpoints take 101 times 21.
    let passed = others * heartbeat(STATION).len();
    assert!((20_000..28_800).contains(&passed), "{passed} bytes of the station's");
}

#[test]
fn a_ground_link_carries_no_more_than_its_rate() {
    let mut rig = Rig::new([",rate=2000", ""], SigningGate::new(None, AllowUnsigned::Loopback));
    let mut heard = [0, 0];
    for _ in 0..200 {
        for _ in 0..40 {
            rig.vehicle.say(&heartbeat(VEHICLE));
        }
        rig.own(&[heartbeat(ME)]);
        for (count, station) in heard.iter_mut().zip(&rig.stations) {
            *count += station.raw().iter().map(Vec::len).sum::<usize>();
        }
    }
    assert!((18_000..21_500).contains(&heard[0]), "{} bytes in 10 s", heard[0]);
    assert!(heard[1] > 150_000, "the other has no limit: {} bytes", heard[1]);
}

#[test]
fn each_link_has_its_own_signing_policy_and_what_was_taken_from_one_is_no_good_on_another() {
    let folder = tempfile::tempdir().unwrap();
    let key_file = folder.path().join("vigil.key");
    std::fs::write(&key_file, [7; 32]).unwrap();
    std::fs::set_permissions(&key_file, std::fs::Permissions::from_mode(0o600)).unwrap();
    let signing = SigningConfig {
        key_file: Some(key_file),
        ..SigningConfig::default()
    };
    let gate = FirmwareConfig {
        signing,
        ..FirmwareConfig::default()
    }
    .gate()
    .unwrap();
    let mut rig = Rig::new([",unsigned=never", ""], gate);
    let land = command(STATION, ME, MavCmd::MAV_CMD_NAV_LAND);
    for station in &rig.stations {
        station.say(&land);
    }
    assert_eq!(
        rig.step(),
        [(2, (STATION, COMMAND_LONG))],
        "the first hears signed packets only"
    );
    let signed = signed([7; 32], 0, &land);
    rig.stations[0].say(&signed);
    assert_eq!(rig.step(), [(1, (STATION, COMMAND_LONG))]);
    rig.stations[1].say(&signed);
    assert!(rig.step().is_empty());
    assert_eq!(rig.links.statistics().signing.replayed, 1);
    // Everything that leaves is signed.
    rig.hush();
    rig.own(&[heartbeat(ME)]);
    assert!(rig.stations[1].raw().iter().all(|bytes| bytes[2] & 1 == 1));
}

#[test]
fn a_ground_link_on_which_nobody_would_be_heard_is_not_opened_and_there_are_four_at_most() {
    let open = |links: &[&str]| {
        let ground: Vec<_> = links.iter().map(|link| link.parse().unwrap()).collect();
        let vehicle = "udpout://127.0.0.1:14999".parse().unwrap();
        RoutedLinks::open(&vehicle, &ground, SigningGate::new(None, AllowUnsigned::Loopback))
            .err()
            .map(|e| e.to_string())
            .unwrap_or_default()
    };
    assert!(open(&["serial:///dev/null:57600"]).contains("nobody would be heard"));
    assert!(open(&["udpout://127.0.0.1:14998,unsigned=never"]).contains("--signing-key"));
    assert!(open(&["udpout://127.0.0.1:14998"; 5]).contains("at most 4"));
    assert_eq!(open(&["udpout://127.0.0.1:14998"]), "");
}

/// The whole flight stack behind the links.
struct Flight {
    rig: Rig,
    firmware: Firmware,
    vehicle: TestVehicle,
    step: u64,
}

impl Flight {
    fn new() -> Self {
        let config = FirmwareConfig {
            engage: EngagePolicy::Command,
            sensor_id: SENSOR_ID,
            ..config()
        };
        let mut flight = Self {
            rig: Rig::unsigned(),
            firmware: Firmware::of(&config, None).unwrap(),
            vehicle: TestVehicle::hovering(2.5),
            step: 0,
        };
        flight.steps(20);
        flight
    }

    fn steps(&mut self, count: usize) {
        for _ in 0..count {
            let now_ns = self.rig.now_ns + STEP_NS;
            self.rig.now_ns = now_ns;
            let frame = self.vehicle.frame(now_ns);
            for (_, datagram) in self.vehicle.telemetry().iter() {
                self.rig.vehicle.say(datagram);
            }
            let timing = StepTiming {
                step: self.step,
                ..StepTiming::default()
            };
            self.firmware.step(
                timing,
                &mut HandedClock(now_ns),
                &mut HandedFrame::new(Some(&frame)),
                &mut self.rig.links,
            );
            for bytes in self.rig.vehicle.raw() {
                self.vehicle.hear(&bytes);
            }
            self.vehicle.advance();
            self.step += 1;
        }
    }

    /// What a station hears in the next two steps of the guidance computer's messages.
    fn heard_by(&mut self, station: usize) -> Vec<MavMessage> {
        self.steps(2);
        let mut counters = FramingCounters::default();
        let mut messages = Vec::new();
        for bytes in self.rig.stations[station].raw() {
            for packet in packets(&bytes, &mut counters) {
                if (packet.system_id(), packet.component_id()) == ME {
                    messages.push(packet.message().unwrap());
                }
            }
        }
        messages
    }
}

#[test]
fn two_ground_stations_at_once_each_get_their_answers_and_both_see_what_the_other_changed() {
    let mut flight = Flight::new();
    flight.rig.stations[0].say(&heartbeat(STATION));
    flight.rig.stations[1].say(&heartbeat(OTHER_STATION));
    flight.steps(2);
    flight.rig.hush();
    let set = MavMessage::PARAM_SET(PARAM_SET_DATA {
        target_system: 1,
        target_component: 191,
        param_id: "GD_SPEED_LIM".into(),
        param_value: 0.75,
        param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
    });
    flight.rig.stations[0].say(&packet(STATION, &set));
    flight.rig.stations[1].say(&command(OTHER_STATION, ME, MavCmd::MAV_CMD_DO_SET_HOME));
    let first = flight.heard_by(0);
    let told = |messages: &[MavMessage]| {
        messages
            .iter()
            .any(|m| matches!(m, MavMessage::PARAM_VALUE(m) if m.param_value == 0.75))
    };
    let acks = |messages: &[MavMessage]| {
        let mut results = Vec::new();
        for message in messages {
            if let MavMessage::COMMAND_ACK(m) = message {
                results.push((m.command, m.result, m.target_system));
            }
        }
        results
    };
    assert!(told(&first) && acks(&first).is_empty());
    let second = flight.heard_by(1);
    assert!(told(&second), "the other station's value is told to both");
    let unsupported = (
        MavCmd::MAV_CMD_DO_SET_HOME,
        MavResult::MAV_RESULT_UNSUPPORTED,
        OTHER_STATION.0,
    );
    assert_eq!(acks(&second), [unsupported]);

    // One engages, the other stops the flight: the last word counts, whoever's it is.
    let guided = |on: f32, from| {
        let command = MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            command: MavCmd::MAV_CMD_NAV_GUIDED_ENABLE,
            target_system: 1,
            target_component: 191,
            param1: on,
            ..COMMAND_LONG_DATA::DEFAULT
        });
        packet(from, &command)
    };
    flight.rig.stations[0].say(&guided(1.0, STATION));
    flight.steps(60);
    let speed = |vehicle: &TestVehicle| vehicle.setpoints.last().map_or(0.0, |s| s.vx);
    assert!(speed(&flight.vehicle) > 0.3, "it flies");
    assert!(speed(&flight.vehicle) <= 0.75, "and keeps the speed that was set");
    flight.rig.stations[1].say(&guided(0.0, OTHER_STATION));
    flight.steps(60);
    assert_eq!(speed(&flight.vehicle), 0.0, "it stopped");
}
