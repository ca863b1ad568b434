//! MAVLink over one UDP socket with several peers: a link for ground stations.
//!
//! A link may have one peer that is sent to unasked; whoever else sends to the local port something that passes the gate
//! becomes a peer too, until it has been silent for [`PEER_TIMEOUT_NS`]. All peers hear the same.

use super::{Door, LinkStatistics, Wire, is_local};
use crate::gate::{Gate, MAX_DATAGRAM_BYTES};
use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use vigil_types::{Datagrams, Nanos};

/// A peer that was learned is forgotten after this silence; MAVLink's heartbeat comes every second.
const PEER_TIMEOUT_NS: Nanos = 10_000_000_000;
/// Peers learned per link; the one that was silent longest gives way.
const MAX_LEARNED: usize = 8;
/// Datagrams taken in one call: a flood on a link must not hold up who calls.
const MAX_PER_CALL: usize = 128;

struct Learned {
    address: SocketAddr,
    heard_ns: Nanos,
}

/// One UDP socket with its peers.
pub struct UdpPeers {
    socket: UdpSocket,
    /// Sent to unasked.
    peer: Option<SocketAddr>,
    learned: Vec<Learned>,
    buffer: Box<[u8; MAX_DATAGRAM_BYTES]>,
    now_ns: Nanos,
}

impl UdpPeers {
    /// A socket at `local` that sends to `peer` unasked.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(local: SocketAddr, peer: Option<SocketAddr>) -> std::io::Result<Self> {
        let socket = UdpSocket::bind(local)?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            peer,
            learned: Vec::with_capacity(MAX_LEARNED),
            buffer: Box::new([0; MAX_DATAGRAM_BYTES]),
            now_ns: 0,
        })
    }

    /// Answers whoever speaks.
    ///
    /// # Errors
    /// What the system says.
    pub fn listening(local: SocketAddr) -> std::io::Result<Self> {
        Self::open(local, None)
    }

    /// Sends to `peer` unasked.
    ///
    /// # Errors
    /// What the system says.
    pub fn calling(peer: SocketAddr) -> std::io::Result<Self> {
        let any = match peer {
            SocketAddr::V4(_) => SocketAddr::from(([0, 0, 0, 0], 0)),
            SocketAddr::V6(_) => SocketAddr::from(([0_u16; 8], 0)),
        };
        Self::open(any, Some(peer))
    }

    /// Hands over every datagram that has come, without waiting, and whether its sender is on this machine. `admit` tells
    /// whether any of it was taken: only then the sender becomes a peer.
    pub fn receive(&mut self, now_ns: Nanos, mut admit: impl FnMut(bool, &[u8]) -> bool) {
        self.now_ns = now_ns;
        for _ in 0..MAX_PER_CALL {
            match self.socket.recv_from(self.buffer.as_mut_slice()) {
                Ok((len, from)) => {
                    if admit(is_local(from), self.buffer.get(..len).unwrap_or_default()) {
                        self.learn(from);
                    }
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                // An earlier datagram met a closed port (ICMP); what arrived is still to be read.
                Err(_) => {}
            }
        }
    }

    /// Sends a datagram to every peer. One that the system does not take is lost, as on any UDP link.
    pub fn send(&mut self, datagram: &[u8]) {
        let now_ns = self.now_ns;
        self.learned
            .retain(|l| now_ns.saturating_sub(l.heard_ns) < PEER_TIMEOUT_NS);
        for address in self.peer.into_iter().chain(self.learned.iter().map(|l| l.address)) {
            // A peer that does not listen is no error of ours.
            let _ = self.socket.send_to(datagram, address);
        }
    }

    /// The local address.
    ///
    /// # Errors
    /// What the system says.
    pub fn local_address(&self) -> std::io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    fn learn(&mut self, from: SocketAddr) {
        if self.peer == Some(from) {
            return;
        }
        let new = Learned {
            address: from,
            heard_ns: self.now_ns,
        };
        if let Some(known) = self.learned.iter_mut().find(|l| l.address == from) {
            *known = new;
        } else if self.learned.len() < MAX_LEARNED {
            self.learned.push(new);
        } else if let Some(oldest) = self.learned.iter_mut().min_by_key(|l| l.heard_ns) {
            *oldest = new;
        }
    }
}

impl Wire for UdpPeers {
    const IS_STREAM: bool = false;

    fn receive(&mut self, now_ns: Nanos, door: &mut Door<'_>, received: &mut Datagrams) {
        // What finds no room is dropped and counted by `received`: it is this link's own share.
        self.receive(now_ns, |is_local, datagram| door.admit(is_local, datagram, received));
    }

    fn send(&mut self, gate: &mut Gate, sent: &Datagrams) {
        for (_, datagram) in sent.iter() {
            self.send(gate.seal(datagram));
        }
    }

    fn statistics(&self) -> LinkStatistics {
        LinkStatistics::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loopback(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    fn socket() -> UdpSocket {
        let socket = UdpSocket::bind(loopback(0)).unwrap();
        socket.set_nonblocking(true).unwrap();
        socket
    }

    /// What comes, all of it admitted unless it begins with `x`. On the loopback interface a datagram has arrived when
    /// its sending returns.
    fn heard(link: &mut UdpPeers, now_ns: Nanos) -> Vec<Vec<u8>> {
        let mut got = Vec::new();
        link.receive(now_ns, |is_local, datagram| {
            assert!(is_local);
            got.push(datagram.to_vec());
            !datagram.starts_with(b"x")
        });
        got
    }

    #[test]
    fn the_peer_hears_unasked_and_strangers_are_answered_once_they_spoke_until_they_are_silent() {
        let (companion, stranger, refused) = (socket(), socket(), socket());
        let mut link = UdpPeers::open(loopback(0), Some(companion.local_addr().unwrap())).unwrap();
        let here = link.local_address().unwrap();
        let mut buffer = [0; 16];
        link.send(b"one");
        assert_eq!(companion.recv(&mut buffer).unwrap(), 3);

        stranger.send_to(b"hello", here).unwrap();
        stranger.send_to(b"", here).unwrap();
        refused.send_to(b"xyz", here).unwrap();
        assert_eq!(heard(&mut link, 1), [b"hello".to_vec(), Vec::new(), b"xyz".to_vec()]);
        link.send(b"two");
        assert_eq!(companion.recv(&mut buffer).unwrap(), 3);
        assert_eq!(stranger.recv(&mut buffer).unwrap(), 3);
        assert!(stranger.recv(&mut buffer).is_err(), "each gets it once");
        assert!(refused.recv(&mut buffer).is_err(), "who is refused hears nothing");

        assert!(heard(&mut link, 1 + PEER_TIMEOUT_NS).is_empty());
        link.send(b"three");
        assert_eq!(companion.recv(&mut buffer).unwrap(), 5);
        assert!(stranger.recv(&mut buffer).is_err(), "it was silent for too long");
    }

    #[test]
    fn strangers_cannot_grow_the_list_of_peers() {
        let mut link = UdpPeers::listening(loopback(0)).unwrap();
        let here = link.local_address().unwrap();
        let strangers: Vec<_> = (0..20).map(|_| socket()).collect();
        for (now_ns, stranger) in (0..).zip(&strangers) {
            stranger.send_to(b"!", here).unwrap();
            assert_eq!(heard(&mut link, now_ns).len(), 1);
        }
        link.send(b"!");
        let answered: Vec<_> = (0..20).filter(|i| strangers[*i].recv(&mut [0; 4]).is_ok()).collect();
        assert_eq!(answered, (12..20).collect::<Vec<_>>(), "the newest");
    }
}
