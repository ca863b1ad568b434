//! Whom the simulated vehicle hears on links that others open.

use std::io::Write;
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::time::Duration;
use vigil_autopilot::LinkId;
use vigil_mavlink::common::{HEARTBEAT_DATA, MavMessage};
use vigil_mavlink::framing::{MAX_PACKET_LEN, serialize};
use vigil_mavlink::mavlink::MavHeader;
use vigil_sim::vehicle_links::{LinksConfig, VehicleLinks};

#[test]
fn a_tcp_link_on_all_addresses_without_a_key_hears_callers_of_this_machine() {
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = free.local_addr().unwrap().port();
    drop(free);
    let config = LinksConfig {
        instance: 87,
        extra: vec![format!("tcpin://0.0.0.0:{port}").parse().unwrap()],
        ..LinksConfig::default()
    };
    let mut links = VehicleLinks::open(&config).unwrap();
    let mut packet = [0; MAX_PACKET_LEN];
    let header = MavHeader {
        system_id: 255,
        component_id: 190,
        sequence: 0,
    };
    let len = serialize(header, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT), &mut packet).unwrap();
    let mut station = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
    station.write_all(&packet[..len]).unwrap();
    let mut heard = Vec::new();
    for _ in 0..500 {
        links.receive(1_000_000_000, |link, _, datagram| heard.push((link, datagram.to_vec())));
        if !heard.is_empty() {
            break;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    assert_eq!(heard, [(LinkId(3), packet[..len].to_vec())]);
}
