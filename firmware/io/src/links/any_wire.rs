//! The one enum of what a link may be: [`LinkUrl`] says which, [`AnyWire`] is it, opened.

use super::{LinkAdmission, LinkError, LinkStatistics, PeerRule, SerialWire, TcpWire, UdpPeers, UdpWire, Wire};
use crate::gate::SigningGate;
use crate::link_url::LinkUrl;
use vigil_types::{Datagrams, Nanos};

/// Any link's socket or device, for whoever has a gate to hold before it.
pub enum AnyWire {
    /// Datagrams of one peer.
    Udp(UdpWire),
    /// Datagrams of several peers.
    Peers(UdpPeers),
    /// A connection.
    Tcp(TcpWire),
    /// A line.
    Serial(SerialWire),
}

impl AnyWire {
    /// Opens the link. With [`PeerRule::Anyone`] a UDP link has several peers, with a vehicle that one. A TCP peer may come
    /// later; a serial device must be there.
    ///
    /// # Errors
    /// [`LinkError`], naming the link.
    pub fn open(url: &LinkUrl, rule: PeerRule) -> Result<Self, LinkError> {
        let of = |source| LinkError::of(url, source);
        match (url, rule) {
            (LinkUrl::UdpIn(local), PeerRule::Anyone) => UdpPeers::listening(*local).map(Self::Peers).map_err(of),
            (LinkUrl::UdpOut(peer), PeerRule::Anyone) => UdpPeers::calling(*peer).map(Self::Peers).map_err(of),
            (LinkUrl::UdpIn(_) | LinkUrl::UdpOut(_), _) => UdpWire::open(url, rule).map(Self::Udp),
            (LinkUrl::TcpIn(_) | LinkUrl::TcpOut(_), _) => TcpWire::open(url, rule).map(Self::Tcp),
            (LinkUrl::Serial { .. }, _) => SerialWire::open(url).map(Self::Serial),
        }
    }

    /// Appends to `received` what arrived and may pass. Never waits.
    pub fn receive(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        match self {
            Self::Udp(wire) => wire.receive(now_ns, admission, received),
            Self::Peers(wire) => Wire::receive(wire, now_ns, admission, received),
            Self::Tcp(wire) => wire.receive(now_ns, admission, received),
            Self::Serial(wire) => wire.receive(now_ns, admission, received),
        }
    }

    /// Hands over each datagram that arrived and may pass, with a number for the end of the link that sent it. Never waits.
    /// `buffer` is overwritten.
    pub fn receive_each(
        &mut self,
        now_ns: Nanos,
        admission: &mut LinkAdmission<'_>,
        buffer: &mut Datagrams,
        mut on_datagram: impl FnMut(u64, &[u8]),
    ) {
        if let Self::Peers(wire) = self {
            wire.receive(now_ns, |sender, datagram| {
                buffer.clear();
                let passes = admission.admit(sender.is_local, datagram, buffer);
                buffer.iter().for_each(|(_, passed)| on_datagram(sender.number, passed));
                passes
            });
            return;
        }
        buffer.clear();
        self.receive(now_ns, admission, buffer);
        // Whoever connects anew is somebody else.
        let sender = self.statistics().0.connections;
        buffer.iter().for_each(|(_, passed)| on_datagram(sender, passed));
    }

    /// Sends each datagram to every peer, sealed by the gate. What cannot be sent is lost and counted.
    pub fn send(&mut self, gate: &mut SigningGate, sent: &Datagrams) {
        match self {
            Self::Udp(wire) => wire.send(gate, sent),
            Self::Peers(wire) => Wire::send(wire, gate, sent),
            Self::Tcp(wire) => wire.send(gate, sent),
            Self::Serial(wire) => wire.send(gate, sent),
        }
    }

    /// What was not taken or could not be delivered, and whether the wire finds packets itself.
    pub fn statistics(&self) -> (LinkStatistics, bool) {
        match self {
            Self::Udp(wire) => (wire.statistics(), UdpWire::IS_STREAM),
            Self::Peers(wire) => (wire.statistics(), UdpPeers::IS_STREAM),
            Self::Tcp(wire) => (wire.statistics(), TcpWire::IS_STREAM),
            Self::Serial(wire) => (wire.statistics(), SerialWire::IS_STREAM),
        }
    }
}

impl From<UdpPeers> for AnyWire {
    fn from(peers: UdpPeers) -> Self {
        Self::Peers(peers)
    }
}
