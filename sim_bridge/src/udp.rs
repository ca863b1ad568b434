//! The vehicle's UDP links, on the ports of PX4's software in the loop.
//!
//! Each link has a local port and one peer that is sent to unasked; whoever else sends to the local port becomes a peer
//! too, until it has been silent for [`PEER_TIMEOUT`]. docs/mavlink.md has the table of ports.

use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::time::{Duration, Instant};
use vigil_endpoint::LinkId;

/// A peer that was learned is forgotten after this silence; MAVLink's heartbeat comes every second.
const PEER_TIMEOUT: Duration = Duration::from_secs(10);
/// Peers learned per link; the one that was silent longest gives way.
const MAX_LEARNED: usize = 8;
/// Datagrams taken from one link in one call: a flood on a link must not hold up the simulation.
const MAX_PER_CALL: usize = 128;
/// Highest instance whose peer port on the API and GCS links is its own, as in PX4; those above share it. Beyond it the
/// numbers of one instance would be those of another.
const LAST_OWN_PEER: u32 = 9;

/// Ports of a link at instance 0: local and peer.
const PORTS: [(LinkId, u16, u16); 3] = [
    (LinkId::ONBOARD, 14280, 14030),
    (LinkId::API, 14580, 14540),
    (LinkId::GCS, 18570, 14550),
];

/// Why the links cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum UdpError {
    /// Somebody else has the port.
    #[error(
        "UDP port {port} is in use: another simulator with --instance {instance}? Stop it, or choose another number with \
         --instance"
    )]
    InUse {
        /// The port.
        port: u16,
        /// The instance it belongs to.
        instance: u32,
    },
    /// The socket cannot be opened.
    #[error("cannot open UDP port {port}: {source}")]
    Open {
        /// The port.
        port: u16,
        /// What the system said.
        source: std::io::Error,
    },
}

struct Learned {
    address: SocketAddr,
    heard: Instant,
}

struct UdpLink {
    id: LinkId,
    socket: UdpSocket,
    peer: SocketAddr,
    learned: Vec<Learned>,
}

/// The three links of one vehicle, on the loopback interface.
pub struct UdpLinks {
    links: Vec<UdpLink>,
    buffer: Vec<u8>,
}

impl std::fmt::Debug for UdpLinks {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list()
            .entries(self.links.iter().map(|l| (l.id, l.peer, l.learned.len())))
            .finish()
    }
}

/// Local and peer port of a link of an instance.
fn ports(link: LinkId, local: u16, peer: u16, instance: u32) -> (u16, u16) {
    let own_peer = if link == LinkId::ONBOARD {
        instance
    } else {
        instance.min(LAST_OWN_PEER)
    };
    // Instances end at 99: the sums fit.
    (local + instance as u16, peer + own_peer as u16)
}

impl UdpLinks {
    /// Opens the links of `instance` (0 to 99).
    ///
    /// # Errors
    /// A port is in use, or the system refuses the socket.
    pub fn bind(instance: u32) -> Result<Self, UdpError> {
        let mut links = Vec::with_capacity(PORTS.len());
        for (id, local, peer) in PORTS {
            let (port, peer_port) = ports(id, local, peer, instance);
            let socket = open(port).map_err(|source| match source.kind() {
                ErrorKind::AddrInUse => UdpError::InUse { port, instance },
                _ => UdpError::Open { port, source },
            })?;
            links.push(UdpLink {
                id,
                socket,
                peer: loopback(peer_port),
                learned: Vec::new(),
            });
        }
        Ok(Self {
            links,
            buffer: vec![0; 65_536],
        })
    }

    /// Hands over every datagram that has come, without waiting.
    pub fn receive(&mut self, mut on_datagram: impl FnMut(LinkId, &[u8])) {
        for link in &mut self.links {
            for _ in 0..MAX_PER_CALL {
                match link.socket.recv_from(&mut self.buffer) {
                    Ok((len, from)) => {
                        link.learn(from);
                        on_datagram(link.id, self.buffer.get(..len).unwrap_or_default());
                    }
                    // Nothing more, or an error of a datagram sent before (a peer that is gone): neither is ours to mend.
                    Err(_) => break,
                }
            }
        }
    }

    /// Sends a datagram to every peer of a link. A datagram that the system does not take is lost, as on any UDP link.
    pub fn send(&mut self, link: LinkId, datagram: &[u8]) {
        let Some(link) = self.links.iter_mut().find(|l| l.id == link) else {
            return;
        };
        link.learned.retain(|l| l.heard.elapsed() < PEER_TIMEOUT);
        let learned = link.learned.iter().map(|l| l.address);
        for address in std::iter::once(link.peer).chain(learned) {
            // A peer that does not listen is no error of the vehicle's.
            let _ = link.socket.send_to(datagram, address);
        }
    }
}

impl UdpLink {
    fn learn(&mut self, from: SocketAddr) {
        if from == self.peer {
            return;
        }
        let heard = Instant::now();
        if let Some(known) = self.learned.iter_mut().find(|l| l.address == from) {
            known.heard = heard;
            return;
        }
        let new = Learned { address: from, heard };
        if self.learned.len() < MAX_LEARNED {
            self.learned.push(new);
        } else if let Some(oldest) = self.learned.iter_mut().min_by_key(|l| l.heard) {
            *oldest = new;
        }
    }
}

fn loopback(port: u16) -> SocketAddr {
    SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::LOCALHOST, port))
}

fn open(port: u16) -> std::io::Result<UdpSocket> {
    let socket = UdpSocket::bind(loopback(port))?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wait_for(links: &mut UdpLinks, count: usize) -> Vec<(LinkId, Vec<u8>)> {
        let mut got = Vec::new();
        // Loopback delivers at once; the turns only bridge the scheduler.
        for _ in 0..1000 {
            links.receive(|link, datagram| got.push((link, datagram.to_vec())));
            if got.len() >= count {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        got
    }

    #[test]
    fn the_peer_hears_unasked_and_strangers_are_answered_once_they_spoke() {
        let mut links = UdpLinks::bind(97).expect("instance 97 is free");
        // Above instance 9 the API peer port is shared, so listen on the companion's.
        let companion = UdpSocket::bind(loopback(14030 + 97)).expect("free port");
        let stranger = UdpSocket::bind(loopback(0)).expect("free port");
        for socket in [&companion, &stranger] {
            socket
                .set_read_timeout(Some(Duration::from_secs(5)))
                .expect("a time-out can be set");
        }
        let mut buffer = [0; 16];

        links.send(LinkId::ONBOARD, b"one");
        assert_eq!(companion.recv(&mut buffer).expect("heard"), 3);

        stranger.send_to(b"hello", loopback(14280 + 97)).expect("sent");
        stranger.send_to(b"", loopback(14280 + 97)).expect("sent");
        let got = wait_for(&mut links, 2);
        assert_eq!(
            got,
            [(LinkId::ONBOARD, b"hello".to_vec()), (LinkId::ONBOARD, Vec::new())]
        );
        links.send(LinkId::ONBOARD, b"two");
        assert_eq!(companion.recv(&mut buffer).expect("heard"), 3);
        assert_eq!(stranger.recv(&mut buffer).expect("heard"), 3);
        // Each got it once.
        stranger.set_nonblocking(true).expect("can be set");
        assert!(stranger.recv(&mut buffer).is_err());
    }

    #[test]
    fn a_port_in_use_is_named_with_what_to_do() {
        let _first = UdpLinks::bind(98).expect("instance 98 is free");
        let error = UdpLinks::bind(98).err().map(|e| e.to_string()).unwrap_or_default();
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
    }

    #[test]
    fn strangers_cannot_grow_the_list_of_peers() {
        let mut links = UdpLinks::bind(96).expect("instance 96 is free");
        for _ in 0..20 {
            let stranger = UdpSocket::bind(loopback(0)).expect("free port");
            stranger.send_to(b"x", loopback(14580 + 96)).expect("sent");
            assert_eq!(wait_for(&mut links, 1).len(), 1);
        }
        let api = links
            .links
            .iter()
            .find(|l| l.id == LinkId::API)
            .expect("there is an API link");
        assert_eq!(api.learned.len(), MAX_LEARNED);
    }
}
