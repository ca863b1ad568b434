//! The vehicle's link over UDP, TCP and serial lines: who is heard, who is answered, peers and devices that go, return, or stop reading.

mod common;

use common::{PseudoTerminal, SECOND, VEHICLE, heard, loopback, say};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::os::unix::fs::symlink;
use std::time::Duration;
use vigil_firmware::link_url::LinkUrl;
use vigil_io::Link;
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::links::{Gated, LinkError, PeerRule};
use vigil_io::router::RoutedLinks;
use vigil_mavlink::common::{COMMAND_LONG_DATA, HEARTBEAT_DATA, MavAutopilot, MavMessage, MavType};
use vigil_mavlink::framing::{FramingCounters, StreamFramer, encode as packet};
use vigil_mavlink::message;
use vigil_types::Nanos;

fn listening(url: fn(SocketAddr) -> LinkUrl) -> Gated {
    Gated::open(&url(loopback()), VEHICLE, SigningGate::open()).unwrap()
}

/// A heartbeat as of this autopilot.
fn autopilot(from: (u8, u8), sequence: u8) -> Vec<u8> {
    let mavtype = MavType::MAV_TYPE_QUADROTOR;
    let autopilot = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;
    let heartbeat = message!(HEARTBEAT, mavtype, autopilot, mavlink_version = 3);
    packet(from, sequence, &heartbeat)
}

fn vehicle(sequence: u8) -> Vec<u8> {
    autopilot((1, 1), sequence)
}

/// A sender that is connected to the link.
fn udp_caller(link: &Gated) -> UdpSocket {
    let address = link.local_address().unwrap();
    let socket = UdpSocket::bind((address.ip(), 0)).unwrap();
    socket.connect(address).unwrap();
    socket.set_nonblocking(true).unwrap();
    socket
}

fn answer(socket: &UdpSocket) -> Option<Vec<u8>> {
    let mut buffer = [0; 64];
    socket.recv(&mut buffer).ok().map(|len| buffer[..len].to_vec())
}

fn tcp_caller(link: &Gated) -> TcpStream {
    TcpStream::connect(link.local_address().unwrap()).unwrap()
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

#[test]
fn the_first_vehicle_is_the_peer_and_a_stranger_is_neither_heard_nor_answered() {
    let mut link = listening(LinkUrl::UdpIn);
    say(&mut link, &[b"to nobody"]);
    assert_eq!(link.statistics().unsent, 1);
    let (vehicle_end, stranger) = (udp_caller(&link), udp_caller(&link));
    // What it sends before its first heartbeat is not a stranger's.
    let early = packet((1, 1), 0, &MavMessage::COMMAND_LONG(COMMAND_LONG_DATA::DEFAULT));
    vehicle_end.send(&early).unwrap();
    vehicle_end.send(&vehicle(1)).unwrap();
    stranger.send(&vehicle(66)).unwrap();
    assert_eq!(heard(&mut link, SECOND), [vehicle(1)]);
    assert_eq!(link.statistics().foreign, 1);
    // From now on the kernel keeps strangers out, and lets in whatever the vehicle sends.
    stranger.send(&vehicle(66)).unwrap();
    let of_gimbal = packet((1, 154), 0, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT));
    vehicle_end.send(&of_gimbal).unwrap();
    assert_eq!(heard(&mut link, SECOND), [of_gimbal]);
    assert_eq!(link.statistics().foreign, 1);
    say(&mut link, &[b"setpoint"]);
    assert_eq!(answer(&vehicle_end).as_deref(), Some(&b"setpoint"[..]));
    assert_eq!(answer(&stranger), None);
}

#[test]
fn who_is_no_vehicle_does_not_become_the_peer_whatever_he_sends() {
    let mut rules = [(VEHICLE, 1), (PeerRule::Vehicle { system: Some(3) }, 3)].into_iter();
    let no_vehicles = [
        b"\xFD".to_vec(),
        Vec::new(),
        vec![0xFD; 40],
        packet((1, 1), 0, &MavMessage::COMMAND_LONG(COMMAND_LONG_DATA::DEFAULT)),
        packet((255, 190), 0, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT)),
        autopilot((1, 190), 0),
        // A router's, as an autopilot's.
        packet(
            (125, 1),
            0,
            &message!(HEARTBEAT, mavtype = MavType::MAV_TYPE_GCS, mavlink_version = 3),
        ),
        // A heartbeat with a checksum that does not fit.
        [&vehicle(0)[..20], b"x"].concat(),
    ];
    for (rule, system) in &mut rules {
        let mut link = Gated::open(&LinkUrl::UdpIn(loopback()), rule, SigningGate::open()).unwrap();
        let (stranger, vehicle_end) = (udp_caller(&link), udp_caller(&link));
        for (second, datagram) in (1..).zip(&no_vehicles) {
            stranger.send(datagram).unwrap();
            assert!(heard(&mut link, second * SECOND).is_empty(), "{datagram:?}");
            say(&mut link, &[b"setpoint"]);
            assert_eq!(answer(&stranger), None, "{datagram:?}");
        }
        assert_eq!(link.statistics().other_system, None);
        if system == 3 {
            // The kernel lets in one in sixteen of them.
            for i in 0..200 {
                stranger.send(&vehicle(i)).unwrap();
            }
            assert!(heard(&mut link, 20 * SECOND).is_empty(), "another system");
            assert_eq!(link.statistics().other_system, Some(1), "can be reported");
        }
        // The vehicle's own may come behind another packet of its autopilot.
        let both = [
            packet((system, 1), 0, &MavMessage::COMMAND_LONG(COMMAND_LONG_DATA::DEFAULT)),
            autopilot((system, 1), 1),
        ];
        vehicle_end.send(&both.concat()).unwrap();
        assert_eq!(heard(&mut link, 20 * SECOND), [both.concat()]);
        say(&mut link, &[b"setpoint"]);
        assert!(answer(&vehicle_end).is_some());
    }
    // Where all must sign, who cannot is no vehicle.
    let gate = SigningGate::new(None, AllowUnsigned::Never);
    let mut link = Gated::open(&LinkUrl::UdpIn(loopback()), VEHICLE, gate).unwrap();
    let stranger = udp_caller(&link);
    stranger.send(&vehicle(0)).unwrap();
    assert!(heard(&mut link, SECOND).is_empty());
    say(&mut link, &[b"setpoint"]);
    assert_eq!(answer(&stranger), None);
}

#[test]
fn a_vehicle_that_comes_back_from_another_port_is_taken_after_a_silence() {
    let mut link = listening(LinkUrl::UdpIn);
    let (before, after) = (udp_caller(&link), udp_caller(&link));
    before.send(&vehicle(0)).unwrap();
    heard(&mut link, SECOND);
    after.send(&vehicle(1)).unwrap();
    assert!(heard(&mut link, 2 * SECOND).is_empty());
    after.send(&vehicle(2)).unwrap();
    assert!(heard(&mut link, 3 * SECOND).is_empty());
    heard(&mut link, 4 * SECOND);
    let other_vehicle = udp_caller(&link);
    other_vehicle.send(&autopilot((2, 1), 0)).unwrap();
    after.send(&vehicle(3)).unwrap();
    assert_eq!(heard(&mut link, 4 * SECOND), [vehicle(3)]);
    say(&mut link, &[b"setpoint"]);
    assert!(answer(&after).is_some() && answer(&before).is_none());
}

#[test]
fn a_vehicle_that_was_silent_goes_on_with_any_packet_and_a_peer_that_talks_garbage_is_silent() {
    let mut link = listening(LinkUrl::UdpIn);
    let (vehicle_end, other) = (udp_caller(&link), udp_caller(&link));
    vehicle_end.send(&vehicle(0)).unwrap();
    heard(&mut link, SECOND);
    heard(&mut link, 10 * SECOND);
    let position = packet((1, 1), 5, &MavMessage::COMMAND_LONG(COMMAND_LONG_DATA::DEFAULT));
    vehicle_end.send(&position).unwrap();
    assert_eq!(
        heard(&mut link, 10 * SECOND),
        [position],
        "who was the peer need not introduce itself"
    );
    for tenth in 101..140 {
        vehicle_end.send(b"another program on that port").unwrap();
        heard(&mut link, tenth * SECOND / 10);
    }
    other.send(&vehicle(7)).unwrap();
    assert_eq!(heard(&mut link, 14 * SECOND).last(), Some(&vehicle(7)));
    say(&mut link, &[b"setpoint"]);
    assert!(answer(&other).is_some());
}

#[test]
fn a_calling_link_hears_only_whom_it_calls() {
    let vehicle = UdpSocket::bind(loopback()).unwrap();
    let url = LinkUrl::UdpOut(vehicle.local_addr().unwrap());
    let mut link = Gated::open(&url, VEHICLE, SigningGate::open()).unwrap();
    say(&mut link, &[b"hello"]);
    let mut buffer = [0; 64];
    let (len, from) = vehicle.recv_from(&mut buffer).unwrap();
    assert_eq!(&buffer[..len], b"hello");
    let stranger = UdpSocket::bind(loopback()).unwrap();
    let port = link.local_address().unwrap().port();
    stranger.send_to(b"stranger", ("127.0.0.1", port)).unwrap();
    vehicle.send_to(b"vehicle", from).unwrap();
    // However long the vehicle was silent.
    assert_eq!(heard(&mut link, 100 * SECOND), [b"vehicle"]);
}

#[test]
fn the_same_by_ipv6() {
    let here: SocketAddr = ([0, 0, 0, 0, 0, 0, 0, 1], 0).into();
    let Ok(mut link) = Gated::open(&LinkUrl::UdpIn(here), VEHICLE, SigningGate::open()) else {
        // A machine without it.
        return;
    };
    let (vehicle_end, stranger) = (udp_caller(&link), udp_caller(&link));
    vehicle_end.send(&vehicle(0)).unwrap();
    assert_eq!(heard(&mut link, SECOND), [vehicle(0)]);
    stranger.send(&vehicle(66)).unwrap();
    vehicle_end.send(b"anything").unwrap();
    assert_eq!(heard(&mut link, SECOND), [b"anything"]);
    assert_eq!(link.statistics().foreign, 0, "the kernel kept it out");
}

#[test]
fn a_flood_of_the_vehicles_is_taken_in_bounded_portions_and_nothing_of_it_is_lost_or_reordered() {
    let mut link = listening(LinkUrl::UdpIn);
    let vehicle_end = udp_caller(&link);
    for i in 0..=250u8 {
        vehicle_end.send(&vehicle(i)).unwrap();
    }
    let portions = std::iter::repeat_with(|| heard(&mut link, SECOND));
    let portions: Vec<_> = portions.take_while(|portion| !portion.is_empty()).collect();
    assert!(portions.len() > 1);
    assert!(portions.iter().flatten().map(|datagram| datagram[4]).eq(0..=250));
}

#[test]
fn a_peer_that_closed_its_port_does_not_disturb_the_link() {
    let mut link = listening(LinkUrl::UdpIn);
    let first = udp_caller(&link);
    first.send(&vehicle(1)).unwrap();
    heard(&mut link, SECOND);
    drop(first);
    for _ in 0..10 {
        // The system reports the closed port in one of the next calls.
        say(&mut link, &[b"setpoint"]);
        assert!(heard(&mut link, SECOND).is_empty());
    }
    heard(&mut link, 10 * SECOND);
    let again = udp_caller(&link);
    again.send(&vehicle(2)).unwrap();
    assert_eq!(heard(&mut link, 10 * SECOND), [vehicle(2)]);
}

#[test]
fn a_server_serves_one_peer_and_the_next_when_that_one_is_gone_or_silent() {
    let mut link = listening(LinkUrl::TcpIn);
    say(&mut link, &[vehicle(0)]);
    assert_eq!(link.statistics().unsent, 1, "nobody is there");
    let mut first = tcp_caller(&link);
    first.write_all(&vehicle(1)).unwrap();
    assert_eq!(heard_soon(&mut link, SECOND), [vehicle(1)]);

    let mut stranger = tcp_caller(&link);
    stranger.write_all(&vehicle(66)).unwrap();
    assert!(heard(&mut link, 2 * SECOND).is_empty());
    assert_eq!(link.statistics().foreign, 1);
    assert!(
        stranger.read(&mut [0; 8]).is_ok_and(|n| n == 0) || stranger.write(&[0]).is_err(),
        "hung up on"
    );

    drop(first);
    let mut second = tcp_caller(&link);
    second.write_all(&vehicle(2)).unwrap();
    assert_eq!(heard_soon(&mut link, 2 * SECOND), [vehicle(2)], "at once");
    let mut other_vehicle = tcp_caller(&link);
    other_vehicle.write_all(&autopilot((2, 1), 0)).unwrap();
    let mut third = tcp_caller(&link);
    third.write_all(&vehicle(3)).unwrap();
    assert_eq!(heard_soon(&mut link, 9 * SECOND), [vehicle(3)], "the second was silent");
    say(&mut link, &[vehicle(9)]);
    let mut buffer = vec![0; vehicle(9).len()];
    third.read_exact(&mut buffer).unwrap();
    assert_eq!(buffer, vehicle(9));
}

#[test]
fn a_client_waits_for_its_peer_and_finds_it_again() {
    // A port that is free at this moment.
    let address = TcpListener::bind(loopback()).unwrap().local_addr().unwrap();
    let mut link = Gated::open(&LinkUrl::TcpOut(address), VEHICLE, SigningGate::open()).unwrap();
    for second in 1..4 {
        assert!(heard(&mut link, second * SECOND).is_empty());
        say(&mut link, &[vehicle(0)]);
    }
    assert_eq!((link.statistics().unsent, link.statistics().connections), (3, 0));

    let listener = TcpListener::bind(address).unwrap();
    heard(&mut link, 5 * SECOND);
    let (mut peer, _) = listener.accept().unwrap();
    // Half a packet, and then the peer is killed: the half must not spoil what comes after.
    peer.write_all(&vehicle(1)[..9]).unwrap();
    heard(&mut link, 6 * SECOND);
    drop(peer);
    let mut now_ns = 7 * SECOND;
    while link.statistics().connections < 2 {
        heard(&mut link, now_ns);
        say(&mut link, &[vehicle(0)]);
        now_ns += SECOND;
        assert!(now_ns < 60 * SECOND);
    }
    let (mut again, _) = listener.accept().unwrap();
    again.write_all(&vehicle(2)).unwrap();
    assert_eq!(heard_soon(&mut link, now_ns), [vehicle(2)]);
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
    let mut link = listening(LinkUrl::TcpIn);
    let mut peer = tcp_caller(&link);
    peer.write_all(&vehicle(0)).unwrap();
    heard_soon(&mut link, SECOND);
    let step: Vec<_> = (0..40).map(vehicle).collect();
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
    line.master.write_all(&vehicle(1)).unwrap();
    assert_eq!(heard_soon(&mut link, SECOND), [vehicle(1)]);

    // Half a packet, then somebody pulls the plug.
    line.master.write_all(&vehicle(2)[..11]).unwrap();
    drop(line);
    std::fs::remove_file(&device).unwrap();
    for tenth in 11..50 {
        assert!(heard(&mut link, tenth * SECOND / 10).is_empty());
        say(&mut link, &[vehicle(0)]);
    }
    assert!(link.statistics().unsent > 30);
    assert_eq!(link.statistics().connections, 1);

    let mut back = PseudoTerminal::open();
    symlink(&back.device, &device).unwrap();
    heard(&mut link, 6 * SECOND);
    assert_eq!(link.statistics().connections, 2);
    back.master.write_all(&vehicle(3)).unwrap();
    assert_eq!(heard_soon(&mut link, 7 * SECOND), [vehicle(3)]);
    assert_eq!(link.statistics().framing.bad_crc, 0);

    // And in the other direction: bytes pass unchanged, whatever a terminal would make of them.
    say(&mut link, &[vehicle(10), vehicle(13), vehicle(4)]);
    let expected = [vehicle(10), vehicle(13), vehicle(4)].concat();
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
fn a_link_on_which_nobody_would_be_heard_is_not_opened_and_of_ground_links_there_are_four_at_most() {
    use AllowUnsigned::{Always, Loopback, Never};
    const OF_VEHICLE: &str = "udpout://127.0.0.1:14999";
    const OF_GROUND: &str = "udpout://127.0.0.1:14998";
    let never = format!("{OF_GROUND},unsigned=never");
    let remedies = ["--signing-key", "--allow-unsigned always", "nobody would be heard"];
    for (url, ground, policy, refusal) in [
        ("udpin://127.0.0.1:14995", &[][..], Loopback, &[][..]),
        ("udpin://0.0.0.0:14995", &[], Loopback, &[]),
        ("udpin://127.0.0.1:14995", &[], Never, &remedies),
        ("udpout://192.0.2.1:14995", &[], Loopback, &remedies),
        ("udpout://192.0.2.1:14995", &[], Always, &[]),
        ("tcpout://192.0.2.1:14995", &[], Loopback, &remedies),
        ("tcpout://127.0.0.1:14995", &[], Loopback, &[]),
        ("serial:///dev/null:57600", &[], Loopback, &remedies),
        (OF_VEHICLE, &["serial:///dev/null:57600"], Loopback, &remedies),
        (OF_VEHICLE, &[&never], Loopback, &remedies[..1]),
        (OF_VEHICLE, &[OF_GROUND; 5], Loopback, &["at most 4"]),
        (OF_VEHICLE, &[OF_GROUND], Loopback, &[]),
    ] {
        let links: Vec<_> = ground.iter().map(|link| link.parse().unwrap()).collect();
        let opened = RoutedLinks::open(&url.parse().unwrap(), &links, SigningGate::new(None, policy));
        let said = opened.err().map(|error| error.to_string()).unwrap_or_default();
        assert_eq!(said.is_empty(), refusal.is_empty(), "{url} {ground:?}: {said}");
        assert!(
            refusal.iter().all(|words| said.contains(words)),
            "{url} {ground:?}: {said}"
        );
    }
}
