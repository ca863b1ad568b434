//! UDP links of the vehicle: the three on the ports of PX4's software in the loop, and others by URL.
//!
//! A link may have one peer that is sent to unasked; whoever else sends to the local port something that passes the gate
//! becomes a peer too, until it has been silent for [`PEER_TIMEOUT`]. docs/mavlink.md has the table of ports.

use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::time::{Duration, Instant};
use vigil_endpoint::LinkId;

/// A peer that was learned is forgotten after this silence; MAVLink's heartbeat comes every second.
const PEER_TIMEOUT: Duration = Duration::from_secs(10);
/// Peers learned per link; the one that was silent longest gives way.
const MAX_LEARNED: usize = 8;
/// Longest datagram that is read; MAVLink's longest packet is 293 bytes, senders may put several into one datagram.
const MAX_DATAGRAM_BYTES: usize = 65_536;
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

/// One UDP socket with its peers.
pub(crate) struct UdpLink {
    socket: UdpSocket,
    /// Sent to unasked.
    peer: Option<SocketAddr>,
    learned: Vec<Learned>,
    buffer: Vec<u8>,
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

/// Opens the three links of `instance` (0 to 99) on the loopback interface.
///
/// # Errors
/// A port is in use, or the system refuses the socket.
pub(crate) fn onboard_api_gcs(instance: u32) -> Result<Vec<(LinkId, UdpLink)>, UdpError> {
    let open = |(id, local, peer)| {
        let (port, peer_port) = ports(id, local, peer, instance);
        let link = UdpLink::open(loopback(port), Some(loopback(peer_port))).map_err(|source| match source.kind() {
            ErrorKind::AddrInUse => UdpError::InUse { port, instance },
            _ => UdpError::Open { port, source },
        })?;
        Ok((id, link))
    };
    PORTS.into_iter().map(open).collect()
}

impl UdpLink {
    fn open(local: SocketAddr, peer: Option<SocketAddr>) -> std::io::Result<Self> {
        let socket = UdpSocket::bind(local)?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            peer,
            learned: Vec::new(),
            buffer: vec![0; MAX_DATAGRAM_BYTES],
        })
    }

    /// Answers whoever speaks.
    pub fn listening(local: SocketAddr) -> std::io::Result<Self> {
        Self::open(local, None)
    }

    /// Sends to `peer` unasked.
    pub fn calling(peer: SocketAddr) -> std::io::Result<Self> {
        let any = match peer {
            SocketAddr::V4(_) => SocketAddr::from(([0, 0, 0, 0], 0)),
            SocketAddr::V6(_) => SocketAddr::from(([0_u16; 8], 0)),
        };
        Self::open(any, Some(peer))
    }

    /// Hands over every datagram that has come, without waiting, and whether its sender is on this machine. `admit` tells
    /// whether any of it was taken: only then the sender becomes a peer.
    pub fn receive(&mut self, mut admit: impl FnMut(bool, &[u8]) -> bool) {
        for _ in 0..MAX_PER_CALL {
            match self.socket.recv_from(&mut self.buffer) {
                Ok((len, from)) => {
                    let is_local = from.ip().to_canonical().is_loopback();
                    if admit(is_local, self.buffer.get(..len).unwrap_or_default()) {
                        self.learn(from);
                    }
                }
                // Nothing more, or an error of a datagram sent before (a peer that is gone): neither is ours to mend.
                Err(_) => return,
            }
        }
    }

    /// Sends a datagram to every peer. One that the system does not take is lost, as on any UDP link.
    pub fn send(&mut self, datagram: &[u8]) {
        self.learned.retain(|l| l.heard.elapsed() < PEER_TIMEOUT);
        for address in self.peer.into_iter().chain(self.learned.iter().map(|l| l.address)) {
            // A peer that does not listen is no error of the vehicle's.
            let _ = self.socket.send_to(datagram, address);
        }
    }

    fn learn(&mut self, from: SocketAddr) {
        if self.peer == Some(from) {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn onboard(instance: u32) -> UdpLink {
        let mut links = onboard_api_gcs(instance).expect("the instance is free");
        links.remove(0).1
    }

    /// What comes, all of it admitted unless it begins with `x`.
    fn wait_for(link: &mut UdpLink, count: usize) -> Vec<Vec<u8>> {
        let mut got = Vec::new();
        // Loopback delivers at once; the turns only bridge the scheduler.
        for _ in 0..1000 {
            link.receive(|is_local, datagram| {
                assert!(is_local);
                got.push(datagram.to_vec());
                !datagram.starts_with(b"x")
            });
            if got.len() >= count {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        got
    }

    #[test]
    fn the_peer_hears_unasked_and_strangers_are_answered_once_they_spoke() {
        let mut link = onboard(97);
        // Above instance 9 the API peer port is shared, so listen on the companion's.
        let companion = UdpSocket::bind(loopback(14030 + 97)).expect("free port");
        let stranger = UdpSocket::bind(loopback(0)).expect("free port");
        let refused = UdpSocket::bind(loopback(0)).expect("free port");
        for socket in [&companion, &stranger] {
            socket
                .set_read_timeout(Some(Duration::from_secs(5)))
                .expect("a time-out can be set");
        }
        let mut buffer = [0; 16];

        link.send(b"one");
        assert_eq!(companion.recv(&mut buffer).expect("heard"), 3);

        stranger.send_to(b"hello", loopback(14280 + 97)).expect("sent");
        stranger.send_to(b"", loopback(14280 + 97)).expect("sent");
        refused.send_to(b"xyz", loopback(14280 + 97)).expect("sent");
        let got = wait_for(&mut link, 3);
        assert_eq!(got, [b"hello".to_vec(), Vec::new(), b"xyz".to_vec()]);
        link.send(b"two");
        assert_eq!(companion.recv(&mut buffer).expect("heard"), 3);
        assert_eq!(stranger.recv(&mut buffer).expect("heard"), 3);
        for (socket, why) in [
            (&stranger, "each gets it once"),
            (&refused, "who is refused hears nothing"),
        ] {
            socket.set_nonblocking(true).expect("can be set");
            assert!(socket.recv(&mut buffer).is_err(), "{why}");
        }
    }

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
    }

    #[test]
    fn strangers_cannot_grow_the_list_of_peers() {
        let mut link = onboard(96);
        for _ in 0..20 {
            let stranger = UdpSocket::bind(loopback(0)).expect("free port");
            stranger.send_to(b"!", loopback(14280 + 96)).expect("sent");
            assert_eq!(wait_for(&mut link, 1).len(), 1);
        }
        assert_eq!(link.learned.len(), MAX_LEARNED);
    }
}
