//! What carries a link's bytes, and the gate that they pass: one link's own, or one that several share.

use super::{LINK, LinkError, LinkStatistics, PeerRule, SerialWire, TcpWire, UdpPeers, UdpWire};
use crate::Link;
use crate::gate::{AllowUnsigned, SigningGate};
use crate::link_url::LinkUrl;
use std::io::ErrorKind;
use std::net::SocketAddr;
use vigil_types::{Datagrams, Nanos};

/// A gate as one link meets it.
pub struct LinkAdmission<'a> {
    /// The gate.
    pub gate: &'a mut SigningGate,
    /// The link's policy.
    pub allow_unsigned: AllowUnsigned,
    /// The link's number in [`Datagrams`].
    pub link: u8,
}

impl LinkAdmission<'_> {
    /// Appends to `received` what may pass, and returns whether anything did. `is_local`: the sender is on this machine.
    pub fn admit(&mut self, is_local: bool, datagram: &[u8], received: &mut Datagrams) -> bool {
        let (policy, link) = (self.allow_unsigned, self.link);
        self.gate.admit_by(policy, is_local, link, datagram, received)
    }
}

/// What carries a link's bytes, whoever's gate they pass.
pub trait Wire: Send {
    /// Appends what arrived and may pass. Never waits; what does not fit stays for the next call.
    fn receive(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams);

    /// Hands over each datagram that arrived and may pass, with a number for the end of the link that sent it. Never waits.
    /// `buffer` is overwritten.
    fn receive_each(
        &mut self,
        now_ns: Nanos,
        admission: &mut LinkAdmission<'_>,
        buffer: &mut Datagrams,
        on_datagram: &mut dyn FnMut(u64, &[u8]),
    ) {
        buffer.clear();
        self.receive(now_ns, admission, buffer);
        // Whoever connects anew is somebody else.
        let sender = self.statistics().0.connections;
        buffer.iter().for_each(|(_, passed)| on_datagram(sender, passed));
    }

    /// Sends each datagram to every peer, sealed by the gate. Never waits; what cannot be sent is lost and counted.
    fn send(&mut self, gate: &mut SigningGate, sent: &Datagrams);

    /// What was not taken or could not be delivered, nothing of the gate's; and whether the wire itself finds the packets in
    /// what it reads: of datagrams the gate does.
    fn statistics(&self) -> (LinkStatistics, bool);

    /// The address on which it listens.
    ///
    /// # Errors
    /// What the system says; a TCP client and a serial line have none.
    fn local_address(&self) -> std::io::Result<SocketAddr> {
        Err(ErrorKind::NotConnected.into())
    }
}

/// Opens a link's socket or device. With [`PeerRule::Anyone`] a UDP link has several peers, with a vehicle that one. A TCP peer
/// may come later; a serial device must be there.
///
/// # Errors
/// [`LinkError`], naming the link.
pub fn open_wire(url: &LinkUrl, rule: PeerRule) -> Result<Box<dyn Wire>, LinkError> {
    open(url, rule, rule == PeerRule::Anyone).map_err(|source| LinkError::of(url, source))
}

/// `has_peers`: by UDP there may be several.
fn open(url: &LinkUrl, rule: PeerRule, has_peers: bool) -> std::io::Result<Box<dyn Wire>> {
    let udp = |local, peer| -> std::io::Result<Box<dyn Wire>> {
        Ok(match has_peers {
            true => Box::new(UdpPeers::open(local, peer)?),
            false => Box::new(UdpWire::open(local, peer, rule)?),
        })
    };
    Ok(match *url {
        LinkUrl::UdpIn(local) => udp(local, None)?,
        LinkUrl::UdpOut(peer @ SocketAddr::V4(_)) => udp(([0, 0, 0, 0], 0).into(), Some(peer))?,
        LinkUrl::UdpOut(peer @ SocketAddr::V6(_)) => udp(([0_u16; 8], 0).into(), Some(peer))?,
        LinkUrl::TcpIn(local) => Box::new(TcpWire::listening(local, rule)?),
        LinkUrl::TcpOut(peer) => Box::new(TcpWire::calling(peer, rule)),
        LinkUrl::Serial { ref device, baud } => Box::new(SerialWire::open(device, baud)?),
        LinkUrl::Unknown(_) => return Err(std::io::Error::other("the host is not known")),
    })
}

/// A link of one peer, with a gate of its own.
pub struct Gated {
    wire: Box<dyn Wire>,
    gate: SigningGate,
}

impl Gated {
    /// Opens the link.
    ///
    /// # Errors
    /// [`LinkError`], naming the link.
    pub fn open(url: &LinkUrl, rule: PeerRule, gate: SigningGate) -> Result<Self, LinkError> {
        let wire = open(url, rule, false).map_err(|source| LinkError::of(url, source))?;
        Ok(Self { wire, gate })
    }

    /// The address on which it listens.
    ///
    /// # Errors
    /// What the system says; a TCP client and a serial line have none.
    pub fn local_address(&self) -> std::io::Result<SocketAddr> {
        self.wire.local_address()
    }

    /// What was not taken or delivered.
    pub fn statistics(&self) -> LinkStatistics {
        self.gate.statistics(self.wire.statistics())
    }
}

impl Link for Gated {
    fn receive(&mut self, now_ns: Nanos, received: &mut Datagrams) {
        self.gate.begin(now_ns);
        let mut admission = LinkAdmission {
            allow_unsigned: self.gate.allow_unsigned(),
            gate: &mut self.gate,
            link: LINK,
        };
        self.wire.receive(now_ns, &mut admission, received);
    }

    fn send(&mut self, sent: &Datagrams) {
        self.wire.send(&mut self.gate, sent);
    }
}
