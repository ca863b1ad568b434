//! The vehicle's link over UDP: who is heard, who is answered.

mod common;

use common::{SECOND, VEHICLE, heard, loopback, say};
use std::net::{SocketAddr, UdpSocket};
use vigil_firmware::link_url::LinkUrl;
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::links::{Gated, PeerRule};
use vigil_mavlink::common::{COMMAND_LONG_DATA, HEARTBEAT_DATA, MavAutopilot, MavMessage, MavType};
use vigil_mavlink::framing::encode as packet;
use vigil_mavlink::message;

fn listening() -> Gated {
    Gated::open(&LinkUrl::UdpIn(loopback()), VEHICLE, SigningGate::open()).unwrap()
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
fn caller(link: &Gated) -> UdpSocket {
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

#[test]
fn the_first_vehicle_is_the_peer_and_a_stranger_is_neither_heard_nor_answered() {
    let mut link = listening();
    say(&mut link, &[b"to nobody"]);
    assert_eq!(link.statistics().unsent, 1);
    let (vehicle_end, stranger) = (caller(&link), caller(&link));
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
        // A heartbeat with a checksum that does not fit.
        [&vehicle(0)[..20], b"x"].concat(),
    ];
    for (rule, system) in &mut rules {
        let mut link = Gated::open(&LinkUrl::UdpIn(loopback()), rule, SigningGate::open()).unwrap();
        let (stranger, vehicle_end) = (caller(&link), caller(&link));
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
    let stranger = caller(&link);
    stranger.send(&vehicle(0)).unwrap();
    assert!(heard(&mut link, SECOND).is_empty());
    say(&mut link, &[b"setpoint"]);
    assert_eq!(answer(&stranger), None);
}

#[test]
fn a_vehicle_that_comes_back_from_another_port_is_taken_after_a_silence() {
    let mut link = listening();
    let (before, after) = (caller(&link), caller(&link));
    before.send(&vehicle(0)).unwrap();
    heard(&mut link, SECOND);
    after.send(&vehicle(1)).unwrap();
    assert!(heard(&mut link, 2 * SECOND).is_empty());
    after.send(&vehicle(2)).unwrap();
    assert!(heard(&mut link, 3 * SECOND).is_empty());
    heard(&mut link, 4 * SECOND);
    let other_vehicle = caller(&link);
    other_vehicle.send(&autopilot((2, 1), 0)).unwrap();
    after.send(&vehicle(3)).unwrap();
    assert_eq!(heard(&mut link, 4 * SECOND), [vehicle(3)]);
    say(&mut link, &[b"setpoint"]);
    assert!(answer(&after).is_some() && answer(&before).is_none());
}

#[test]
fn a_vehicle_that_was_silent_goes_on_with_any_packet_and_a_peer_that_talks_garbage_is_silent() {
    let mut link = listening();
    let (vehicle_end, other) = (caller(&link), caller(&link));
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
    let (vehicle_end, stranger) = (caller(&link), caller(&link));
    vehicle_end.send(&vehicle(0)).unwrap();
    assert_eq!(heard(&mut link, SECOND), [vehicle(0)]);
    stranger.send(&vehicle(66)).unwrap();
    vehicle_end.send(b"anything").unwrap();
    assert_eq!(heard(&mut link, SECOND), [b"anything"]);
    assert_eq!(link.statistics().foreign, 0, "the kernel kept it out");
}

#[test]
fn a_flood_of_the_vehicles_is_taken_in_bounded_portions_and_nothing_of_it_is_lost_or_reordered() {
    let mut link = listening();
    let vehicle_end = caller(&link);
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
    let mut link = listening();
    let first = caller(&link);
    first.send(&vehicle(1)).unwrap();
    heard(&mut link, SECOND);
    drop(first);
    for _ in 0..10 {
        // The system reports the closed port in one of the next calls.
        say(&mut link, &[b"setpoint"]);
        assert!(heard(&mut link, SECOND).is_empty());
    }
    heard(&mut link, 10 * SECOND);
    let again = caller(&link);
    again.send(&vehicle(2)).unwrap();
    assert_eq!(heard(&mut link, 10 * SECOND), [vehicle(2)]);
}
