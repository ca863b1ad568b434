//! TCP and serial links: peers and devices that go, return, or stop reading.

mod common;

use common::{PseudoTerminal, SECOND, VEHICLE, heard, loopback, say};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::symlink;
use std::time::Duration;
use vigil_firmware::link_url::LinkUrl;
use vigil_io::Link;
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::links::{Gated, LinkError, PeerRule};
use vigil_io::router::RoutedLinks;
use vigil_mavlink::common::MavAutopilot;
use vigil_mavlink::framing::{FramingCounters, StreamFramer, encode};
use vigil_mavlink::message;
use vigil_types::Nanos;

fn packet(sequence: u8) -> Vec<u8> {
    packet_of(1, sequence)
}

fn packet_of(system: u8, sequence: u8) -> Vec<u8> {
    let autopilot = MavAutopilot::MAV_AUTOPILOT_PX4;
    let message = message!(HEARTBEAT, autopilot, mavlink_version = 3);
    encode((system, 1), sequence, &message)
}

/// What is heard once something is; the turns only bridge the system's own pace.
fn heard_soon(link: &mut impl Link, now_ns: Nanos) -> Vec<Vec<u8>> {
    for _ in 0..5000 {
        let got = heard(link, now_ns);
        if !got.is_empty() {
            return got;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("nothing was heard");
}

fn server() -> Gated {
    Gated::open(&LinkUrl::TcpIn(loopback()), VEHICLE, SigningGate::open()).unwrap()
}

fn caller(link: &Gated) -> TcpStream {
    TcpStream::connect(link.local_address().unwrap()).unwrap()
}

#[test]
fn a_server_serves_one_peer_and_the_next_when_that_one_is_gone_or_silent() {
    let mut link = server();
    say(&mut link, &[packet(0)]);
    assert_eq!(link.statistics().unsent, 1, "nobody is there");
    let mut first = caller(&link);
    first.write_all(&packet(1)).unwrap();
    assert_eq!(heard_soon(&mut link, SECOND), [packet(1)]);

    let mut stranger = caller(&link);
    stranger.write_all(&packet(66)).unwrap();
    assert!(heard(&mut link, 2 * SECOND).is_empty());
    assert_eq!(link.statistics().foreign, 1);
    assert!(
        stranger.read(&mut [0; 8]).is_ok_and(|n| n == 0) || stranger.write(&[0]).is_err(),
        "hung up on"
    );

    drop(first);
    let mut second = caller(&link);
    second.write_all(&packet(2)).unwrap();
    assert_eq!(heard_soon(&mut link, 2 * SECOND), [packet(2)], "at once");
    let mut other_vehicle = caller(&link);
    other_vehicle.write_all(&packet_of(2, 0)).unwrap();
    let mut third = caller(&link);
    third.write_all(&packet(3)).unwrap();
    assert_eq!(heard_soon(&mut link, 9 * SECOND), [packet(3)], "the second was silent");
    say(&mut link, &[packet(9)]);
    let mut buffer = vec![0; packet(9).len()];
    third.read_exact(&mut buffer).unwrap();
    assert_eq!(buffer, packet(9));
}

#[test]
fn a_client_waits_for_its_peer_and_finds_it_again() {
    // A port that is free at this moment.
    let address = TcpListener::bind(loopback()).unwrap().local_addr().unwrap();
    let mut link = Gated::open(&LinkUrl::TcpOut(address), VEHICLE, SigningGate::open()).unwrap();
    for second in 1..4 {
        assert!(heard(&mut link, second * SECOND).is_empty());
        say(&mut link, &[packet(0)]);
    }
    assert_eq!((link.statistics().unsent, link.statistics().connections), (3, 0));

    let listener = TcpListener::bind(address).unwrap();
    heard(&mut link, 5 * SECOND);
    let (mut peer, _) = listener.accept().unwrap();
    // Half a packet, and then the peer is killed: the half must not spoil what comes after.
    peer.write_all(&packet(1)[..9]).unwrap();
    heard(&mut link, 6 * SECOND);
    drop(peer);
    let mut now_ns = 7 * SECOND;
    while link.statistics().connections < 2 {
        heard(&mut link, now_ns);
        say(&mut link, &[packet(0)]);
        now_ns += SECOND;
        assert!(now_ns < 60 * SECOND);
    }
    let (mut again, _) = listener.accept().unwrap();
    again.write_all(&packet(2)).unwrap();
    assert_eq!(heard_soon(&mut link, now_ns), [packet(2)]);
    assert_eq!(link.statistics().framing.bad_crc, 0);
}

#[test]
fn a_client_calls_anew_when_the_network_lost_its_peer_without_a_word() {
    let listener = TcpListener::bind(loopback()).unwrap();
    let url = LinkUrl::TcpOut(listener.local_addr().unwrap());
    let mut link = Gated::open(&url, VEHICLE, SigningGate::open()).unwrap();
    heard(&mut link, SECOND);
    let (_silent, _) = listener.accept().unwrap();
    for second in 2..20 {
        heard(&mut link, second * SECOND);
    }
    assert_eq!(link.statistics().connections, 2);
}

#[test]
fn a_peer_that_does_not_read_costs_packets_and_neither_time_nor_the_framing() {
    let mut link = server();
    let mut peer = caller(&link);
    peer.write_all(&packet(0)).unwrap();
    heard_soon(&mut link, SECOND);
    let step: Vec<_> = (0..40).map(packet).collect();
    let mut steps = 0;
    while link.statistics().unsent < 100 {
        say(&mut link, &step);
        steps += 1;
        assert!(steps < 100_000);
    }
    // Then it reads: whole packets, nothing else.
    peer.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let (mut framer, mut counters) = (StreamFramer::default(), FramingCounters::default());
    let mut buffer = vec![0; 65_536];
    let mut found = 0;
    while let Ok(len) = peer.read(&mut buffer) {
        framer.feed(&buffer[..len], &mut counters, |_| found += 1);
        say(&mut link, &[b""; 0]);
    }
    assert_eq!(counters.garbage_bytes, 0);
    assert_eq!(found + link.statistics().unsent, steps * 40);
}

#[test]
fn a_port_in_use_is_named() {
    for listen in [LinkUrl::UdpIn, LinkUrl::TcpIn] {
        let link = Gated::open(&listen(loopback()), VEHICLE, SigningGate::open()).unwrap();
        let url = listen(link.local_address().unwrap());
        let error = Gated::open(&url, VEHICLE, SigningGate::open()).err().unwrap();
        assert!(matches!(error, LinkError::InUse { .. }));
        assert!(error.to_string().contains(&url.to_string()), "{error}");
    }
}

#[test]
fn a_serial_device_that_disappears_and_returns_is_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let device = folder.path().join("ttyVehicle");
    let mut line = PseudoTerminal::open();
    symlink(&line.device, &device).unwrap();
    let url = format!("serial://{}:921600", device.display()).parse().unwrap();
    let mut link = Gated::open(&url, PeerRule::Anyone, SigningGate::open()).unwrap();
    line.master.write_all(&packet(1)).unwrap();
    assert_eq!(heard_soon(&mut link, SECOND), [packet(1)]);

    // Half a packet, then somebody pulls the plug.
    line.master.write_all(&packet(2)[..11]).unwrap();
    drop(line);
    std::fs::remove_file(&device).unwrap();
    for tenth in 11..50 {
        assert!(heard(&mut link, tenth * SECOND / 10).is_empty());
        say(&mut link, &[packet(0)]);
    }
    assert!(link.statistics().unsent > 30);
    assert_eq!(link.statistics().connections, 1);

    let mut back = PseudoTerminal::open();
    symlink(&back.device, &device).unwrap();
    heard(&mut link, 6 * SECOND);
    assert_eq!(link.statistics().connections, 2);
    back.master.write_all(&packet(3)).unwrap();
    assert_eq!(heard_soon(&mut link, 7 * SECOND), [packet(3)]);
    assert_eq!(link.statistics().framing.bad_crc, 0);

    // And in the other direction: bytes pass unchanged, whatever a terminal would make of them.
    say(&mut link, &[packet(10), packet(13), packet(4)]);
    let expected = [packet(10), packet(13), packet(4)].concat();
    let mut got: Vec<u8> = Vec::new();
    for _ in 0..5000 {
        let mut buffer = [0; 256];
        match back.master.read(&mut buffer) {
            Ok(len) => got.extend(&buffer[..len]),
            Err(_) => std::thread::sleep(Duration::from_millis(1)),
        }
        if got.len() >= expected.len() {
            break;
        }
    }
    assert_eq!(got, expected);
}

#[test]
fn a_device_that_is_not_there_or_no_line_is_named() {
    for device in ["/dev/no-such-line", "/dev/null"] {
        let url = format!("serial://{device}:57600").parse().unwrap();
        let error = Gated::open(&url, PeerRule::Anyone, SigningGate::open())
            .err()
            .unwrap()
            .to_string();
        assert!(error.contains(device), "{error}");
    }
}

#[test]
fn a_link_on_which_nobody_would_be_heard_is_not_opened() {
    for (url, policy, opens) in [
        ("udpin://127.0.0.1:14995", AllowUnsigned::Loopback, true),
        ("udpin://0.0.0.0:14995", AllowUnsigned::Loopback, true),
        ("udpin://127.0.0.1:14995", AllowUnsigned::Never, false),
        ("udpout://192.0.2.1:14995", AllowUnsigned::Loopback, false),
        ("udpout://192.0.2.1:14995", AllowUnsigned::Always, true),
        ("tcpout://192.0.2.1:14995", AllowUnsigned::Loopback, false),
        ("tcpout://127.0.0.1:14995", AllowUnsigned::Loopback, true),
        ("serial:///dev/null:57600", AllowUnsigned::Loopback, false),
    ] {
        let opened = RoutedLinks::open(&url.parse().unwrap(), &[], SigningGate::new(None, policy));
        match opened {
            Ok(_) => assert!(opens, "{url}"),
            Err(error) => {
                let text = error.to_string();
                assert!(!opens && matches!(error, LinkError::NobodyHeard { .. }), "{text}");
                assert!(
                    text.contains("--signing-key") && text.contains("--allow-unsigned always"),
                    "{text}"
                );
            }
        }
    }
}
