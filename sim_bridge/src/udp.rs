//! The vehicle's three UDP links, on the ports of PX4's software in the loop. docs/mavlink.md has the table of ports.

use anyhow::anyhow;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr};
use vigil_autopilot::LinkId;
use vigil_io::links::UdpPeers;

/// Highest instance whose peer port on the API link is its own, as in PX4; those above share it. Beyond it the numbers of one
/// instance would be those of another. Ground stations listen on one port to all vehicles.
const LAST_OWN_PEER: u32 = 9;

/// Ports of a link at instance 0: local and peer.
const PORTS: [(LinkId, u16, u16); 3] = [
    (LinkId::ONBOARD, 14280, 14030),
    (LinkId::API, 14580, 14540),
    (LinkId::GCS, 18570, 14550),
];

/// Local and peer port of a link of an instance.
fn ports(link: LinkId, local: u16, peer: u16, instance: u32) -> (u16, u16) {
    let own_peer = match link {
        LinkId::ONBOARD => instance,
        LinkId::API => instance.min(LAST_OWN_PEER),
        _ => 0,
    };
    // Instances end at 99: the sums fit.
    (local + instance as u16, peer + own_peer as u16)
}

/// The ports of `instance` as a person reads them.
pub(crate) fn ports_in_words(instance: u32) -> String {
    let of = |(id, local, peer)| {
        let who = match id {
            LinkId::ONBOARD => "guidance computer",
            LinkId::API => "scripts",
            _ => "ground stations",
        };
        let (local, peer) = ports(id, local, peer, instance);
        format!("{who} {local} (sends to {peer})")
    };
    PORTS.map(of).join(", ")
}

/// Opens the three links of `instance` (0 to 99) on the loopback interface.
///
/// # Errors
/// A port is in use, or the system refuses the socket.
pub(crate) fn onboard_api_gcs(instance: u32) -> anyhow::Result<Vec<(LinkId, UdpPeers)>> {
    let loopback = |port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let open = |(id, local, peer)| {
        let (port, peer_port) = ports(id, local, peer, instance);
        let link = UdpPeers::open(loopback(port), Some(loopback(peer_port))).map_err(|source| match source.kind() {
            ErrorKind::AddrInUse => anyhow!(
                "UDP port {port} is in use: another simulator with --instance {instance}? Stop it, or choose another number \
                 with --instance"
            ),
            _ => anyhow!("cannot open UDP port {port}: {source}"),
        })?;
        Ok((id, link))
    };
    PORTS.into_iter().map(open).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_in_use_is_named_with_what_to_do() {
        let _first = onboard_api_gcs(98).expect("instance 98 is free");
        let error = onboard_api_gcs(98).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("14378") && error.contains("--instance"), "{error}");
    }

    #[test]
    fn no_two_instances_share_a_local_port_and_no_peer_port_is_a_local_one() {
        let mut locals = Vec::new();
        let mut peers = Vec::new();
        for instance in 0..100 {
            for (link, local, peer) in PORTS {
                let (local, peer) = ports(link, local, peer, instance);
                locals.push(local);
                peers.push(peer);
            }
        }
        let count = locals.len();
        locals.sort_unstable();
        locals.dedup();
        assert_eq!(locals.len(), count);
        assert!(peers.iter().all(|p| locals.binary_search(p).is_err()));
        assert_eq!(ports(LinkId::API, 14580, 14540, 3), (14583, 14543));
        assert_eq!(ports(LinkId::GCS, 18570, 14550, 3), (18573, 14550));
    }
}
