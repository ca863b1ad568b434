//! The links of the simulated vehicle.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpStream, UdpSocket};
use std::path::PathBuf;
use std::time::Duration;
use vigil_autopilot::{Endpoint, EndpointConfig, LinkId, SigningSetup};
use vigil_mavlink::framing::{MAX_PACKET_LEN, encode};
use vigil_mavlink::message;
use vigil_mavlink::signing::{Signing, SigningKey, SigningMemory, Timestamp, timestamp_of_unix_ns};
use vigil_sim::vehicle_links::{LinksConfig, VehicleLinks};
use vigil_types::Nanos;
use vigil_types::files::{Access, replace};

const SECOND: Nanos = 1_000_000_000;
const KEY: [u8; 32] = [3; 32];
const STATION: (u8, u8) = (255, 190);

/// A packet that differs from those of other numbers.
fn packet(number: u32) -> Vec<u8> {
    encode(STATION, 0, &message!(HEARTBEAT, custom_mode = number))
}

/// A file with the key.
fn key_file(folder: &tempfile::TempDir) -> PathBuf {
    let file = folder.path().join("vigil.key");
    replace(&file, &KEY, Access::Private).unwrap();
    file
}

fn now() -> Timestamp {
    timestamp_of_unix_ns(std::time::UNIX_EPOCH.elapsed().unwrap().as_nanos() as u64)
}

fn signed(key: [u8; 32], ahead: u64, packet: &[u8]) -> Vec<u8> {
    let mut out = [0; MAX_PACKET_LEN + 13];
    let mut signing = Signing::new(SigningKey(key), 0, SigningMemory::default());
    let len = signing.sign(now() + ahead, packet, &mut out).unwrap();
    out[..len].to_vec()
}

fn station() -> UdpSocket {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    socket
}

/// What passes within a moment, by link.
fn passing(links: &mut VehicleLinks, now_ns: Nanos) -> Vec<(LinkId, Vec<u8>)> {
    let mut got = Vec::new();
    for _ in 0..20 {
        std::thread::sleep(Duration::from_millis(2));
        links.receive(now_ns, |link, _, datagram| got.push((link, datagram.to_vec())));
    }
    got
}

/// With these further links.
fn config(extra: &[String]) -> LinksConfig {
    LinksConfig {
        link: extra.iter().map(|link| link.parse().unwrap()).collect(),
        ..LinksConfig::default()
    }
}

fn free_port() -> u16 {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    socket.local_addr().unwrap().port()
}

#[test]
fn with_a_key_each_of_several_links_has_its_policy_and_a_replay_is_refused_on_all() {
    let folder = tempfile::tempdir().unwrap();
    let key_file = key_file(&folder);
    let (strict, tcp) = (free_port(), free_port());
    let extra = [
        format!("udpin://127.0.0.1:{strict},unsigned=never"),
        format!("tcpin://127.0.0.1:{tcp}"),
    ];
    let config = LinksConfig {
        signing_key: Some(key_file),
        ..config(&extra)
    };
    let mut links = VehicleLinks::open(95, &config).unwrap();
    let (api, on_strict) = (14580 + 95, LinkId(3));
    let station = station();
    let say = |port: u16, bytes: &[u8]| station.send_to(bytes, (Ipv4Addr::LOCALHOST, port)).unwrap();

    say(api, &packet(0));
    say(strict, &packet(0));
    let passed = passing(&mut links, SECOND);
    assert_eq!(passed, [(LinkId::API, packet(0))], "unsigned on loopback by default");
    let right = signed(KEY, 0, &packet(0));
    let (wrong, of_the_future) = (signed([4; 32], 1, &packet(0)), signed(KEY, 120 * 100_000, &packet(0)));
    for bytes in [&right, &wrong, &of_the_future, &right] {
        say(strict, bytes);
    }
    assert_eq!(passing(&mut links, 2 * SECOND), [(on_strict, right.clone())]);
    say(api, &right);
    let passed = passing(&mut links, 2 * SECOND);
    assert!(passed.is_empty(), "on another link, which takes unsigned packets");
    let c = links.signing();
    assert_eq!((c.signed, c.unsigned, c.wrong_signature), (1, 1, 1));
    assert_eq!((c.replayed, c.from_the_future), (2, 1));

    // Who was admitted hears the vehicle, and everything is signed.
    links.send(on_strict, false, &packet(9));
    let mut heard = [0; 512];
    let (len, _) = station.recv_from(&mut heard).unwrap();
    assert_eq!((len, heard[2] & 1), (packet(9).len() + 13, 1));

    // The state is stored, so a restart does not make a replay good.
    drop(links);
    let mut links = VehicleLinks::open(95, &config).unwrap();
    say(strict, &right);
    assert!(passing(&mut links, 3 * SECOND).is_empty());

    let mut client = TcpStream::connect((Ipv4Addr::LOCALHOST, tcp)).unwrap();
    client.write_all(&packet(5)).unwrap();
    assert_eq!(passing(&mut links, 4 * SECOND), [(LinkId(4), packet(5))]);
    links.send(LinkId(4), false, &packet(6));
    client.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    assert!(client.read(&mut heard).unwrap() > packet(6).len());
}

fn setup(key: [u8; 32]) -> Vec<u8> {
    let (target_system, target_component) = (1, 1);
    let message = message!(SETUP_SIGNING, target_system, target_component, secret_key = key);
    encode(STATION, 0, &message)
}

/// The firmware's `random_valid_packets_change_no_key` is of the same gate.
#[test]
fn only_a_packet_signed_with_the_present_key_brings_another_which_is_in_force_at_once_and_after_a_restart() {
    for has_key in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let key_file = key_file(&folder);
        let config = LinksConfig {
            signing_key: has_key.then(|| key_file.clone()),
            ..LinksConfig::default()
        };
        let mut links = VehicleLinks::open(89, &config).unwrap();
        let mut vehicle = Endpoint::new(EndpointConfig::default()).unwrap();
        let station = station();
        let say = |bytes: &[u8]| station.send_to(bytes, (Ipv4Addr::LOCALHOST, 14580 + 89)).unwrap();
        let mut brought_by = |packets: &[Vec<u8>], links: &mut VehicleLinks| {
            for packet in packets {
                say(packet);
            }
            for (link, packet) in passing(links, SECOND) {
                vehicle.receive_from(SECOND, link, 0, &packet);
            }
            vehicle.take_signing_setup()
        };
        let (zeros, new) = ([0; 32], [9; 32]);
        let refused = [
            setup(new),
            setup(zeros),
            signed(KEY, 0, &setup(zeros)),
            signed(new, 0, &setup(new)),
        ];
        assert!(brought_by(&refused, &mut links).is_none());
        let refusal = links.refused_key().unwrap();
        assert!(refusal.starts_with("signing key refused"), "{refusal}");
        assert_eq!(links.refused_key(), None, "once");
        // Stamps count ten microseconds, and of two packets with one stamp the second is a replay.
        std::thread::sleep(Duration::from_millis(1));
        let brought = brought_by(&[signed(KEY, 0, &setup(new))], &mut links);
        assert_eq!(brought.is_some(), has_key, "signed with the present key");
        let Some(brought) = brought else {
            drop(links);
            assert_eq!(std::fs::read(&key_file).unwrap(), KEY);
            continue;
        };
        links.set_key(&brought);
        // After the restart beyond what the stored state is ahead by.
        for ahead in [0, 500_000] {
            for key in [KEY, new] {
                say(&signed(key, ahead, &packet(0)));
            }
            assert_eq!(passing(&mut links, SECOND).len(), 1, "ahead by {ahead}");
            drop(links);
            assert_eq!(std::fs::read(&key_file).unwrap(), "09".repeat(32).into_bytes());
            links = VehicleLinks::open(89, &config).unwrap();
        }
    }
}

#[test]
fn a_first_key_is_taken_where_that_was_asked_for() {
    let config = LinksConfig {
        accept_first_key: true,
        ..LinksConfig::default()
    };
    let mut links = VehicleLinks::open(88, &config).unwrap();
    let station = station();
    for (key, passes) in [([5; 32], 1), ([6; 32], 0)] {
        station.send_to(&setup(key), (Ipv4Addr::LOCALHOST, 14580 + 88)).unwrap();
        assert_eq!(passing(&mut links, SECOND).len(), passes);
        links.set_key(&SigningSetup {
            key,
            initial_timestamp: 0,
        });
    }
}

#[test]
fn a_tcp_link_on_all_addresses_without_a_key_hears_callers_of_this_machine() {
    let port = free_port();
    let mut links = VehicleLinks::open(87, &config(&[format!("tcpin://0.0.0.0:{port}")])).unwrap();
    let mut station = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
    station.write_all(&packet(0)).unwrap();
    assert_eq!(passing(&mut links, SECOND), [(LinkId(3), packet(0))]);
}

#[test]
fn a_link_sends_no_faster_than_its_rate_and_answers_find_room_between_telemetry() {
    let port = free_port();
    let slow = format!("udpout://127.0.0.1:{port},rate=2000");
    let mut links = VehicleLinks::open(93, &config(&[slow])).unwrap();
    let sent = packet(0);
    for millisecond in 0..10_000 {
        links.receive(millisecond * 1_000_000, |_, _, _| {});
        links.send(LinkId(3), true, &sent);
        if millisecond % 100 == 0 {
            let lost = links.over_budget();
            links.send(LinkId(3), false, &sent);
            assert_eq!(links.over_budget(), lost, "an answer");
        }
    }
    let passed = (10_100 - links.over_budget()) * sent.len() as u64;
    assert!((19_000..21_500).contains(&passed), "{passed} bytes in 10 s");
}

#[test]
fn a_link_on_which_nobody_would_be_heard_is_not_opened() {
    let open = |link: &str| {
        let opened = VehicleLinks::open(92, &config(&[link.to_owned()]));
        opened.map_or_else(|e| e.to_string(), |_| String::new())
    };
    assert!(open("udpout://10.1.2.3:14550").contains("--signing-key"));
    assert!(open("tcpout://10.1.2.3:5799").contains("nobody would be heard"));
    assert!(open("udpout://127.0.0.1:14999,system=3").contains("leave them out"));
    assert_eq!(open("udpout://127.0.0.1:14999"), "");
}
