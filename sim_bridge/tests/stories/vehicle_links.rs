//! The links of the simulated vehicle.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpStream, UdpSocket};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::Duration;
use vigil_autopilot::{Endpoint, EndpointConfig, LinkId, SigningSetup};
use vigil_io::gate::AllowUnsigned;
use vigil_mavlink::framing::{MAX_PACKET_LEN, encode, encode_payload};
use vigil_mavlink::message;
use vigil_mavlink::signing::{Signing, SigningKey, SigningMemory, Timestamp, timestamp_of_unix_ns};
use vigil_sim::vehicle_links::{LinksConfig, VehicleLinks};
use vigil_types::Nanos;

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
    std::fs::write(&file, KEY).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
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

/// Links of a vehicle with these further ones.
fn config(instance: u32, extra: &[String]) -> LinksConfig {
    LinksConfig {
        instance,
        extra: extra.iter().map(|link| link.parse().unwrap()).collect(),
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
        ..config(95, &extra)
    };
    let mut links = VehicleLinks::open(&config).unwrap();
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
    let mut links = VehicleLinks::open(&config).unwrap();
    say(strict, &right);
    assert!(passing(&mut links, 3 * SECOND).is_empty());

    let mut client = TcpStream::connect((Ipv4Addr::LOCALHOST, tcp)).unwrap();
    client.write_all(&packet(5)).unwrap();
    assert_eq!(passing(&mut links, 4 * SECOND), [(LinkId(4), packet(5))]);
    links.send(LinkId(4), false, &packet(6));
    client.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    assert!(client.read(&mut heard).unwrap() > packet(6).len());
}

#[test]
fn a_serial_line_that_disappears_and_returns_is_heard_again_and_the_other_links_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let device = folder.path().join("tty");
    let plug = || {
        let (master, path) = pseudo_terminal();
        let _ = std::fs::remove_file(&device);
        std::os::unix::fs::symlink(path, &device).unwrap();
        master
    };
    let mut line = plug();
    let serial = format!("serial://{}:57600,unsigned=always", device.display());
    let mut links = VehicleLinks::open(&config(90, &[serial])).unwrap();
    let station = station();
    let say_by_udp = |bytes: &[u8]| station.send_to(bytes, (Ipv4Addr::LOCALHOST, 14580 + 90)).unwrap();
    line.write_all(&packet(1)).unwrap();
    assert_eq!(passing(&mut links, SECOND), [(LinkId(3), packet(1))]);

    drop(line);
    std::fs::remove_file(&device).unwrap();
    say_by_udp(&packet(2));
    assert_eq!(passing(&mut links, 2 * SECOND), [(LinkId::API, packet(2))]);
    links.send(LinkId(3), false, &packet(0));

    line = plug();
    // It is looked for once a second, and what was written before it was opened is not its.
    passing(&mut links, 4 * SECOND);
    line.write_all(&packet(3)).unwrap();
    assert_eq!(passing(&mut links, 5 * SECOND), [(LinkId(3), packet(3))]);
}

/// The end of a cable and the device at its other end.
fn pseudo_terminal() -> (std::fs::File, String) {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let path = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    (master.into(), path)
}

#[test]
fn a_key_from_setup_signing_is_in_force_at_once_and_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let key_file = key_file(&folder);
    let config = LinksConfig {
        instance: 94,
        signing_key: Some(key_file),
        allow_unsigned: AllowUnsigned::Never,
        ..LinksConfig::default()
    };
    let setup = SigningSetup {
        key: [8; 32],
        initial_timestamp: 0,
    };
    let station = station();
    let mut links = VehicleLinks::open(&config).unwrap();
    links.set_key(&setup);
    for restarted in [false, true] {
        if restarted {
            drop(links);
            links = VehicleLinks::open(&config).unwrap();
        }
        for key in [KEY, setup.key] {
            // Beyond what the stored state is ahead by.
            let bytes = signed(key, if restarted { 500_000 } else { 0 }, &packet(0));
            station.send_to(&bytes, (Ipv4Addr::LOCALHOST, 14580 + 94)).unwrap();
        }
        assert_eq!(passing(&mut links, SECOND).len(), 1, "restarted: {restarted}");
    }
}

fn setup(key: [u8; 32]) -> Vec<u8> {
    let (target_system, target_component) = (1, 1);
    let message = message!(SETUP_SIGNING, target_system, target_component, secret_key = key);
    encode(STATION, 0, &message)
}

/// A packet with a right checksum of random content, if it is one.
fn random_packet(random: &mut impl FnMut() -> u8) -> Option<Vec<u8>> {
    let from = (random(), random());
    let id = u32::from(random()) + u32::from(random());
    let payload: Vec<u8> = (0..random()).map(|_| random()).collect();
    encode_payload(from, 0, id, &payload).ok()
}

/// A hundred thousand packets with right checksums and random content, each tenth a SETUP_SIGNING for the vehicle, on a
/// link that takes what is not signed.
#[test]
fn random_valid_packets_change_no_key_and_only_a_signed_one_does() {
    for has_key in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let key_file = key_file(&folder);
        let config = LinksConfig {
            instance: 89,
            signing_key: has_key.then(|| key_file.clone()),
            ..LinksConfig::default()
        };
        let mut links = VehicleLinks::open(&config).unwrap();
        let mut vehicle = Endpoint::new(EndpointConfig::default()).unwrap();
        let station = station();
        let mut setups = 0;
        let say = |bytes: &[u8]| station.send_to(bytes, (Ipv4Addr::LOCALHOST, 14580 + 89)).unwrap();
        let mut hear = |links: &mut VehicleLinks, at_ns: Nanos| {
            links.receive(at_ns, |link, peer, datagram| {
                vehicle.receive_from(at_ns, link, peer, datagram);
            });
            vehicle.transmit(|_, _| {});
            let setup = vehicle.take_signing_setup();
            setups += u32::from(setup.is_some());
            setup.iter().for_each(|setup| links.set_key(setup));
            setups
        };
        let mut state = 0x9E37_79B9_7F4A_7C15_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) as u8
        };
        for i in 0..100_000_u64 {
            let key: [u8; 32] = std::array::from_fn(|_| random());
            let mut bytes = match i % 10 {
                0 => setup(key),
                _ => match random_packet(&mut random) {
                    Some(bytes) => bytes,
                    None => continue,
                },
            };
            let is_signed = random() % 4 == 0;
            if is_signed {
                bytes = signed(key, 0, &bytes);
            }
            say(&bytes);
            hear(&mut links, SECOND + i * 1_000_000);
        }
        let refusal = links.refused_key().unwrap();
        assert!(refusal.starts_with("signing key refused"), "{refusal}");
        assert_eq!(links.refused_key(), None, "once");
        say(&setup([0; 32]));
        say(&signed(KEY, 0, &setup([0; 32])));
        // Stamps count ten microseconds, and of two packets with one stamp the second is a replay.
        std::thread::sleep(Duration::from_millis(1));
        say(&signed(KEY, 0, &setup([9; 32])));
        // A busy machine hands a datagram over late: as long as one is missing, and a moment more for one too many.
        let expected = u32::from(has_key);
        let mut moments_left = 20;
        for _ in 0..2500 {
            std::thread::sleep(Duration::from_millis(2));
            if hear(&mut links, 200 * SECOND) >= expected {
                moments_left -= 1;
            }
            if moments_left == 0 {
                break;
            }
        }
        let counters = links.signing();
        drop(links);
        assert_eq!(setups, expected, "the one that is signed with the present key");
        assert!(counters.unsigned_key > 5000, "{counters:?}");
        let kept = std::fs::read(&key_file).unwrap();
        match has_key {
            true => assert_eq!(kept, "09".repeat(32).into_bytes()),
            false => assert_eq!(kept, KEY),
        }
    }
}

#[test]
fn a_first_key_is_taken_where_that_was_asked_for() {
    let config = LinksConfig {
        instance: 88,
        accept_first_key: true,
        ..LinksConfig::default()
    };
    let mut links = VehicleLinks::open(&config).unwrap();
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
    let mut links = VehicleLinks::open(&config(87, &[format!("tcpin://0.0.0.0:{port}")])).unwrap();
    let mut station = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
    station.write_all(&packet(0)).unwrap();
    assert_eq!(passing(&mut links, SECOND), [(LinkId(3), packet(0))]);
}

#[test]
fn a_link_sends_no_faster_than_its_rate_and_answers_find_room_between_telemetry() {
    let port = free_port();
    let slow = format!("udpout://127.0.0.1:{port},rate=2000");
    let mut links = VehicleLinks::open(&config(93, &[slow])).unwrap();
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
        let opened = VehicleLinks::open(&config(92, &[link.to_owned()]));
        opened.map_or_else(|e| e.to_string(), |_| String::new())
    };
    assert!(open("udpout://10.1.2.3:14550").contains("--signing-key"));
    assert!(open("tcpout://10.1.2.3:5799").contains("nobody would be heard"));
    assert!(open("udpout://127.0.0.1:14999,system=3").contains("leave them out"));
    assert_eq!(open("udpout://127.0.0.1:14999"), "");
}
