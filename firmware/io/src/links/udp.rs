//! MAVLink over one UDP socket.

use super::{Door, Gated, LinkError, LinkStatistics, PEER_SILENCE_NS, Wire, is_local};
use crate::gate::{Gate, MAX_DATAGRAM_BYTES};
use crate::link_url::LinkUrl;
use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use vigil_types::{Datagrams, Nanos};

/// Datagrams taken from the socket in one step at most; bounds the step.
const MAX_DATAGRAMS_PER_STEP: usize = 128;

/// MAVLink over one UDP socket. It speaks with one peer: who called first with something that passed the gate, or who is
/// called.
pub type UdpLink = Gated<UdpWire>;

/// The socket of one peer.
pub struct UdpWire {
    socket: UdpSocket,
    peer: Option<SocketAddr>,
    peer_heard_ns: Nanos,
    calling: bool,
    foreign: u64,
    unsent: u64,
    buffer: Box<[u8; MAX_DATAGRAM_BYTES]>,
}

impl UdpLink {
    /// Opens the link's socket; `url` must be one of UDP.
    ///
    /// # Errors
    /// [`LinkError::InUse`] and others, each naming the link.
    pub fn open(url: &LinkUrl, gate: Gate) -> Result<Self, LinkError> {
        let wire = UdpWire::open(url)?;
        Ok(Self { wire, gate })
    }

    /// The local address.
    ///
    /// # Errors
    /// What the system says.
    pub fn local_address(&self) -> std::io::Result<SocketAddr> {
        self.wire.socket.local_addr()
    }
}

impl UdpWire {
    pub(crate) fn open(url: &LinkUrl) -> Result<Self, LinkError> {
        let error = |source| LinkError::of(url, source);
        let (local, peer) = match *url {
            LinkUrl::UdpIn(local) => (local, None),
            LinkUrl::UdpOut(peer) => {
                let any: SocketAddr = match peer {
                    SocketAddr::V4(_) => ([0, 0, 0, 0], 0).into(),
                    SocketAddr::V6(_) => ([0u16; 8], 0).into(),
                };
                (any, Some(peer))
            }
            _ => return Err(error(ErrorKind::InvalidInput.into())),
        };
        let socket = UdpSocket::bind(local).map_err(error)?;
        socket.set_nonblocking(true).map_err(error)?;
        Ok(Self {
            socket,
            peer,
            peer_heard_ns: 0,
            calling: peer.is_some(),
            foreign: 0,
            unsent: 0,
            buffer: Box::new([0; MAX_DATAGRAM_BYTES]),
        })
    }

    /// Whether `from` is the peer, or may become it.
    fn is_welcome(&self, from: SocketAddr, now_ns: Nanos) -> bool {
        let silent = now_ns.saturating_sub(self.peer_heard_ns) > PEER_SILENCE_NS;
        self.peer == Some(from) || !self.calling && (self.peer.is_none() || silent)
    }
}

impl Wire for UdpWire {
    const IS_STREAM: bool = false;

    fn receive(&mut self, now_ns: Nanos, door: &mut Door<'_>, received: &mut Datagrams) {
        for _ in 0..MAX_DATAGRAMS_PER_STEP {
            if received.len() >= Datagrams::MAX_COUNT || received.free_bytes() < MAX_DATAGRAM_BYTES {
                return;
            }
            match self.socket.recv_from(self.buffer.as_mut_slice()) {
                Ok((_, from)) if !self.is_welcome(from, now_ns) => self.foreign += 1,
                Ok((len, from)) => {
                    let datagram = self.buffer.get(..len).unwrap_or_default();
                    // Who is refused at the gate neither becomes the peer nor stays it.
                    if door.admit(is_local(from), datagram, received) {
                        self.peer = Some(from);
                        self.peer_heard_ns = now_ns;
                    }
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                // An earlier datagram met a closed port (ICMP); what arrived is still to be read.
                Err(_) => {}
            }
        }
    }

    fn send(&mut self, gate: &mut Gate, sent: &Datagrams) {
        for (_, datagram) in sent.iter() {
            let gone = self.peer.map(|peer| self.socket.send_to(gate.seal(datagram), peer));
            if !matches!(gone, Some(Ok(_))) {
                self.unsent += 1;
            }
        }
    }

    fn statistics(&self) -> LinkStatistics {
        LinkStatistics {
            foreign: self.foreign,
            unsent: self.unsent,
            ..LinkStatistics::default()
        }
    }
}
