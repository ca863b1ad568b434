//! The vehicle's three UDP links, on the ports of PX4's software in the loop. docs/mavlink.md has the table of ports.

use anyhow::anyhow;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr};
use vigil_autopilot::LinkId;
use vigil_io::links::UdpPeers;

/// A link's id, who is on it, its local and its peer port at instance 0, and the highest instance whose peer port is its own,
/// as in PX4; those above share it. Beyond it the numbers of one instance would be those of another. Ground stations listen on
/// one port to all vehicles.
type Ports = (LinkId, &'static str, u16, u16, u32);

const PORTS: [Ports; 3] = [
    (LinkId::ONBOARD, "guidance computer", 14280, 14030, 99),
    (LinkId::API, "scripts", 14580, 14540, 9),
    (LinkId::GCS, "ground stations", 18570, 14550, 0),
];

/// Local and peer port of a link of an instance.
fn ports((_, _, local, peer, last_own): Ports, instance: u32) -> (u16, u16) {
    // Instances end at 99: the sums fit.
    (local + instance as u16, peer + instance.min(last_own) as u16)
}

/// The ports of `instance` as a person reads them.
pub(crate) fn ports_in_words(instance: u32) -> String {
    let of = |link: Ports| {
        let (local, peer) = ports(link, instance);
        format!("{} {local} (sends to {peer})", link.1)
    };
    PORTS.map(of).join(", ")
}

/// Opens the three links of `instance` (0 to 99) on the loopback interface.
///
/// # Errors
/// A port is in use, or the system refuses the socket.
pub(crate) fn onboard_api_gcs(instance: u32) -> anyhow::Result<Vec<(LinkId, UdpPeers)>> {
    let loopback = |port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let open = |of: Ports| {
        let (port, peer_port) = ports(of, instance);
        let link = UdpPeers::open(loopback(port), Some(loopback(peer_port))).map_err(|source| match source.kind() {
            ErrorKind::AddrInUse => anyhow!(
                "UDP port {port} is in use: another simulator with --instance {instance}? Stop it, or choose another number \
                 with --instance"
            ),
            _ => anyhow!("cannot open UDP port {port}: {source}"),
        })?;
        Ok((of.0, link))
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
        let all = (0..100).flat_map(|instance| PORTS.map(|link| ports(link, instance)));
        let (mut locals, peers): (Vec<_>, Vec<_>) = all.unzip();
        let count = locals.len();
        locals.sort_unstable();
        locals.dedup();
        assert_eq!(locals.len(), count);
        assert!(peers.iter().all(|p| locals.binary_search(p).is_err()));
        assert_eq!(ports(PORTS[1], 3), (14583, 14543));
        assert_eq!(ports(PORTS[2], 3), (18573, 14550));
    }
}
