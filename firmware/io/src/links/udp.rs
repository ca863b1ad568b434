//! MAVLink over one UDP socket.

use super::socket_filter::{FLOOD, FloodWatch, SocketFilter};
use super::{LinkAdmission, LinkStatistics, PEER_SILENCE_NS, PeerRule, Wire, is_local};
use crate::gate::{MAX_DATAGRAM_BYTES, SigningGate};
use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use vigil_types::{Datagrams, Nanos};

/// Datagrams taken from the peer in one step at most; bounds the step. What the vehicle passes on of others is among them.
const MAX_DATAGRAMS_PER_STEP: usize = 192;
/// Datagrams read in one step at most, those of strangers included, which are put aside unread: more than a socket's
/// queue holds by default.
const MAX_READS_PER_STEP: usize = 512;

/// A UDP socket that speaks with one peer: who called first and showed who it is, or who is called. The kernel lets in nobody
/// else while the peer is heard.
pub struct UdpWire {
    socket: UdpSocket,
    rule: PeerRule,
    peer: Option<SocketAddr>,
    peer_heard_ns: Nanos,
    calling: bool,
    filter: SocketFilter,
    flood: FloodWatch,
    statistics: LinkStatistics,
    /// Who called last without showing who it is, and how much of it is counted as foreign: a vehicle's own until its heartbeat.
    early: Option<(SocketAddr, u64)>,
    buffer: Box<[u8; MAX_DATAGRAM_BYTES]>,
}

impl UdpWire {
    /// A socket at `local`; `peer` is who is called.
    pub(crate) fn open(local: SocketAddr, peer: Option<SocketAddr>, rule: PeerRule) -> std::io::Result<Self> {
        let socket = UdpSocket::bind(local)?;
        socket.set_nonblocking(true)?;
        let mut wire = Self {
            socket,
            rule,
            peer,
            peer_heard_ns: 0,
            calling: peer.is_some(),
            filter: SocketFilter::new(),
            flood: FloodWatch::default(),
            statistics: LinkStatistics::default(),
            early: None,
            buffer: Box::new([0; MAX_DATAGRAM_BYTES]),
        };
        wire.set_filter(0);
        Ok(wire)
    }

    /// Whether somebody else may become the peer now.
    fn is_vacant(&self, now_ns: Nanos) -> bool {
        let silent = now_ns.saturating_sub(self.peer_heard_ns) > PEER_SILENCE_NS;
        !self.calling && (self.peer.is_none() || silent)
    }

    fn set_filter(&mut self, now_ns: Nanos) {
        let newcomers = self.is_vacant(now_ns).then_some(self.rule);
        let flooded = self.flood.is_flooded(now_ns);
        self.filter.set(&self.socket, self.peer.into_iter(), newcomers, flooded);
    }

    /// Takes a datagram of somebody else than the peer, who is the peer from now on if he shows that he may be.
    fn introduce(
        &mut self,
        len: usize,
        from: SocketAddr,
        now_ns: Nanos,
        admission: &mut LinkAdmission<'_>,
        received: &mut Datagrams,
    ) {
        let datagram = self.buffer.get(..len).unwrap_or_default();
        let has_key = admission.gate.has_key();
        let introduced = self.rule.introduces_any(datagram, has_key)
            && admission.admit(is_local(from), datagram, received)
            // What passed the gate, and not what came with it.
            && received.last().is_some_and(|passed| self.rule.introduces_any(passed, has_key));
        if !introduced {
            let other_system = &mut self.statistics.other_system;
            *other_system = self.rule.other_system_in(datagram).or(*other_system);
            let before = self.early.filter(|(address, _)| *address == from);
            self.early = Some((from, before.map_or(0, |(_, count)| count) + 1));
            self.statistics.foreign += 1;
        } else {
            if let Some((_, its_own)) = self.early.take().filter(|(address, _)| *address == from) {
                self.statistics.foreign -= its_own;
            }
            self.peer = Some(from);
            self.peer_heard_ns = now_ns;
            self.rule.keep_to(received.last().unwrap_or_default(), has_key);
            self.filter.peers_changed();
            self.set_filter(now_ns);
        }
    }
}

impl Wire for UdpWire {
    fn receive(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        self.set_filter(now_ns);
        let (mut taken, mut introductions) = (0, 0);
        for _ in 0..MAX_READS_PER_STEP {
            let no_room = received.len() >= Datagrams::MAX_COUNT || received.free_bytes() < MAX_DATAGRAM_BYTES;
            if no_room || taken >= MAX_DATAGRAMS_PER_STEP || introductions >= FLOOD {
                break;
            }
            match self.socket.recv_from(self.buffer.as_mut_slice()) {
                Ok((len, from)) if self.peer == Some(from) => {
                    taken += 1;
                    let datagram = self.buffer.get(..len).unwrap_or_default();
                    // Who is refused at the gate, or is no vehicle any more, does not stay the peer.
                    let passed = admission.admit(is_local(from), datagram, received);
                    if passed && received.last().is_some_and(|passed| self.rule.is_heard_in(passed)) {
                        self.peer_heard_ns = now_ns;
                    }
                }
                Ok((len, from)) if self.is_vacant(now_ns) => {
                    introductions += 1;
                    self.introduce(len, from, now_ns, admission, received);
                }
                Ok(_) => self.statistics.foreign += 1,
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                // An earlier datagram met a closed port (ICMP); what arrived is still to be read.
                Err(_) => {}
            }
        }
        self.flood.note(now_ns, introductions, false);
    }

    fn send(&mut self, gate: &mut SigningGate, sent: &Datagrams) {
        for (_, datagram) in sent.iter() {
            let gone = self.peer.map(|peer| self.socket.send_to(gate.seal(datagram), peer));
            if !matches!(gone, Some(Ok(_))) {
                self.statistics.unsent += 1;
            }
        }
    }

    fn statistics(&self) -> (LinkStatistics, bool) {
        (self.statistics, false)
    }

    fn local_address(&self) -> std::io::Result<SocketAddr> {
        self.socket.local_addr()
    }
}
