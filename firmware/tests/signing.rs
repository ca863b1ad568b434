//! MAVLink signing on the firmware's link: who has the key is heard, nobody else, also after a restart.

use std::net::{SocketAddr, UdpSocket};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use vigil_firmware::config::{FirmwareConfig, SigningConfig};
use vigil_firmware::link_url::LinkUrl;
use vigil_firmware::ports::Link;
use vigil_firmware::ports::gate::{AllowUnsigned, SigningGate};
use vigil_firmware::ports::links::{PeerRule, UdpLink};
use vigil_mavlink::MavHeader;
use vigil_mavlink::common::{HEARTBEAT_DATA, MavMessage};
use vigil_mavlink::framing::{FramingCounters, MAX_PACKET_LEN, packets, serialize};
use vigil_mavlink::signing::{
    SIGNATURE_LEN, Signing, SigningKey, SigningMemory, Timestamp, UNITS_PER_SECOND, timestamp_of_unix_ns,
};
use vigil_types::{Datagrams, Nanos};

const SECOND: Nanos = 1_000_000_000;
const KEY: [u8; 32] = [0x5A; 32];

fn now() -> Timestamp {
    timestamp_of_unix_ns(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64)
}

fn signer(key: [u8; 32]) -> Signing {
    Signing::new(SigningKey(key), 0, SigningMemory::default())
}

fn unsigned(sequence: u8) -> Vec<u8> {
    let header = MavHeader {
        system_id: 1,
        component_id: 1,
        sequence,
    };
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize(header, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT), &mut out).unwrap();
    out[..len].to_vec()
}

fn signed(signer: &mut Signing, at: Timestamp, sequence: u8) -> Vec<u8> {
    let mut out = [0; MAX_PACKET_LEN + SIGNATURE_LEN];
    let len = signer.sign(at, &unsigned(sequence), &mut out).unwrap();
    out[..len].to_vec()
}

fn key_file(folder: &Path) -> PathBuf {
    let path = folder.join("vigil.key");
    std::fs::write(&path, KEY).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    path
}

fn link(key_file: &Path) -> UdpLink {
    let config = FirmwareConfig {
        signing: SigningConfig {
            key_file: Some(key_file.to_owned()),
            allow_unsigned: AllowUnsigned::Never,
            ..SigningConfig::default()
        },
        ..FirmwareConfig::default()
    };
    let rule = PeerRule::Vehicle { system: Some(1) };
    UdpLink::open(&LinkUrl::UdpIn(loopback()), rule, config.gate().unwrap()).unwrap()
}

fn loopback() -> SocketAddr {
    ([127, 0, 0, 1], 0).into()
}

fn caller(link: &UdpLink) -> UdpSocket {
    let socket = UdpSocket::bind(loopback()).unwrap();
    socket.connect(link.local_address().unwrap()).unwrap();
    socket.set_nonblocking(true).unwrap();
    socket
}

/// What passes of one datagram.
fn heard(link: &mut UdpLink, from: &UdpSocket, now_ns: Nanos, datagram: &[u8]) -> usize {
    from.send(datagram).unwrap();
    let mut received = Datagrams::default();
    link.receive(now_ns, &mut received);
    received.len()
}

#[test]
fn of_a_thousand_packets_each_only_the_rightly_signed_pass() {
    let folder = tempfile::tempdir().unwrap();
    let mut link = link(&key_file(folder.path()));
    let vehicle = caller(&link);
    let (mut right, mut other) = (signer(KEY), signer([0xA5; 32]));
    let mut kept = Vec::new();
    let mut passed = [0; 5];
    for i in 0..1000 {
        let at = now();
        let ahead = at + 61 * UNITS_PER_SECOND;
        let packet = signed(&mut right, at, i as u8);
        kept.push(packet.clone());
        let all = [
            packet,
            unsigned(i as u8),
            signed(&mut other, at, i as u8),
            signed(&mut signer(KEY), ahead, i as u8),
            kept[i / 2].clone(),
        ];
        for (count, datagram) in passed.iter_mut().zip(&all) {
            *count += heard(&mut link, &vehicle, SECOND, datagram);
        }
    }
    assert_eq!(passed, [1000, 0, 0, 0, 0]);
    let counters = link.statistics().signing;
    assert_eq!(
        (counters.signed, counters.unsigned, counters.wrong_signature),
        (1000, 1000, 1000)
    );
    assert_eq!((counters.from_the_future, counters.replayed), (1000, 1000));
}

#[test]
fn who_cannot_sign_neither_becomes_the_peer_nor_is_answered() {
    let folder = tempfile::tempdir().unwrap();
    let mut link = link(&key_file(folder.path()));
    let (attacker, vehicle) = (caller(&link), caller(&link));
    assert_eq!(heard(&mut link, &attacker, SECOND, &unsigned(0)), 0);
    let mut right = signer(KEY);
    assert_eq!(heard(&mut link, &vehicle, SECOND, &signed(&mut right, now(), 0)), 1);
    let mut sent = Datagrams::default();
    sent.push(0, &unsigned(7));
    link.send(&sent);
    let mut buffer = [0; 300];
    assert!(attacker.recv(&mut buffer).is_err());
    let len = vehicle.recv(&mut buffer).unwrap();

    // What the vehicle gets is signed with the key, and is otherwise what was sent.
    let mut counters = FramingCounters::default();
    let packet = packets(&buffer[..len], &mut counters).next().unwrap();
    assert_eq!(signer(KEY).verify(now(), &packet, false), Ok(()));
    assert!(signer([1; 32]).verify(now(), &packet, false).is_err());
    assert_eq!((packet.sequence(), packet.message_id()), (7, 0));
}

#[test]
fn packets_of_before_a_restart_do_not_pass_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let key_file = key_file(folder.path());
    let mut right = signer(KEY);
    let captured: Vec<_> = (0..100).map(|i| signed(&mut right, now(), i)).collect();
    {
        let mut link = link(&key_file);
        let vehicle = caller(&link);
        for packet in &captured {
            assert_eq!(heard(&mut link, &vehicle, SECOND, packet), 1);
        }
    }
    let mut restarted = link(&key_file);
    let attacker = caller(&restarted);
    for packet in &captured {
        assert_eq!(heard(&mut restarted, &attacker, SECOND, packet), 0);
    }
    assert_eq!(restarted.statistics().signing.replayed, 100);
    let vehicle = caller(&restarted);
    assert_eq!(
        heard(&mut restarted, &vehicle, SECOND, &signed(&mut right, now(), 101)),
        1,
        "and the vehicle goes on"
    );
}

#[test]
fn a_key_file_that_others_can_read_keeps_the_link_closed() {
    let folder = tempfile::tempdir().unwrap();
    let path = key_file(folder.path());
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    let error = SigningGate::with_key_file(&path, "0", AllowUnsigned::Never)
        .err()
        .unwrap();
    assert!(error.to_string().contains("chmod 600"), "{error}");
    assert!(!folder.path().join("vigil.key.0.state").exists(), "nothing was begun");
}
