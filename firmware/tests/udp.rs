//! The vehicle's link over UDP: who is heard, who is answered.

use std::net::{SocketAddr, UdpSocket};
use vigil_firmware::link_url::LinkUrl;
use vigil_firmware::ports::Link;
use vigil_firmware::ports::gate::Gate;
use vigil_firmware::ports::links::{LinkError, UdpLink};
use vigil_types::{Datagrams, Nanos};

const SECOND: Nanos = 1_000_000_000;

fn loopback() -> SocketAddr {
    ([127, 0, 0, 1], 0).into()
}

fn listening() -> UdpLink {
    UdpLink::open(&LinkUrl::UdpIn(loopback()), Gate::open()).unwrap()
}

/// A sender that is connected to the link.
fn caller(link: &UdpLink) -> UdpSocket {
    let socket = UdpSocket::bind(loopback()).unwrap();
    socket.connect(link.local_address().unwrap()).unwrap();
    socket.set_nonblocking(true).unwrap();
    socket
}

fn heard(link: &mut UdpLink, now_ns: Nanos) -> Vec<Vec<u8>> {
    let mut received = Datagrams::default();
    link.receive(now_ns, &mut received);
    received.iter().map(|(_, datagram)| datagram.to_vec()).collect()
}

fn say(link: &mut UdpLink, datagram: &[u8]) {
    let mut sent = Datagrams::default();
    assert!(sent.push(0, datagram));
    link.send(&sent);
}

fn answer(socket: &UdpSocket) -> Option<Vec<u8>> {
    let mut buffer = [0; 64];
    socket.recv(&mut buffer).ok().map(|len| buffer[..len].to_vec())
}

#[test]
fn the_first_caller_is_the_peer_and_a_stranger_is_neither_heard_nor_answered() {
    let mut link = listening();
    say(&mut link, b"to nobody");
    assert_eq!(link.statistics().unsent, 1);
    let (vehicle, stranger) = (caller(&link), caller(&link));
    vehicle.send(b"vehicle").unwrap();
    stranger.send(b"stranger").unwrap();
    assert_eq!(heard(&mut link, SECOND), [b"vehicle"]);
    assert_eq!(link.statistics().foreign, 1);
    say(&mut link, b"setpoint");
    assert_eq!(answer(&vehicle).as_deref(), Some(&b"setpoint"[..]));
    assert_eq!(answer(&stranger), None);
}

#[test]
fn a_vehicle_that_comes_back_from_another_port_is_taken_after_a_silence() {
    let mut link = listening();
    let (before, after) = (caller(&link), caller(&link));
    before.send(b"before").unwrap();
    heard(&mut link, SECOND);
    after.send(b"early").unwrap();
    assert!(heard(&mut link, 2 * SECOND).is_empty());
    after.send(b"after").unwrap();
    assert_eq!(heard(&mut link, 4 * SECOND), [b"after"]);
    say(&mut link, b"setpoint");
    assert!(answer(&after).is_some() && answer(&before).is_none());
}

#[test]
fn a_calling_link_hears_only_whom_it_calls() {
    let vehicle = UdpSocket::bind(loopback()).unwrap();
    let mut link = UdpLink::open(&LinkUrl::UdpOut(vehicle.local_addr().unwrap()), Gate::open()).unwrap();
    say(&mut link, b"hello");
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
fn a_flood_is_taken_in_bounded_portions_and_nothing_of_it_is_lost_or_reordered() {
    let mut link = listening();
    let vehicle = caller(&link);
    for i in 0..200u8 {
        vehicle.send(&[i; 40]).unwrap();
    }
    let mut all = Vec::new();
    let mut portions = 0;
    loop {
        let portion = heard(&mut link, SECOND);
        if portion.is_empty() {
            break;
        }
        portions += 1;
        all.extend(portion);
    }
    assert!(portions > 1);
    assert!(all.iter().map(|datagram| datagram[0]).eq(0..200));
}

#[test]
fn a_peer_that_closed_its_port_does_not_disturb_the_link() {
    let mut link = listening();
    let vehicle = caller(&link);
    vehicle.send(b"1").unwrap();
    heard(&mut link, SECOND);
    drop(vehicle);
    for _ in 0..10 {
        // The system tells of the closed port in one of the next calls.
        say(&mut link, b"setpoint");
        assert!(heard(&mut link, SECOND).is_empty());
    }
    let again = caller(&link);
    again.send(b"2").unwrap();
    assert_eq!(heard(&mut link, 10 * SECOND), [b"2"]);
}

#[test]
fn a_port_in_use_is_named() {
    let link = listening();
    let url = LinkUrl::UdpIn(link.local_address().unwrap());
    let error = UdpLink::open(&url, Gate::open()).err().unwrap();
    assert!(matches!(error, LinkError::InUse { .. }));
    assert!(error.to_string().contains(&url.to_string()), "{error}");
}
