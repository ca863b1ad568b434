//! MAVLink over one UDP socket with several peers: a link for ground stations.
//!
//! A link may have one peer that is sent to unasked; whoever else sends to the local port MAVLink that passes the gate
//! becomes a peer too, until it has been silent for [`PEER_TIMEOUT_NS`]. All peers hear the same. While a flood comes, the
//! kernel lets in what known peers send, and little of anything else.

use super::peer_rule::PeerRule;
use super::socket_filter::{FloodWatch, SocketFilter};
use super::{LinkAdmission, LinkStatistics, Wire, is_local};
use crate::gate::{MAX_DATAGRAM_BYTES, SigningGate};
use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use vigil_types::{Datagrams, Nanos};

/// A peer that was learned is forgotten after this silence; MAVLink's heartbeat comes every second.
const PEER_TIMEOUT_NS: Nanos = 10_000_000_000;
/// Peers learned per link.
const MAX_LEARNED: usize = 8;
/// When there are that many, one that missed three heartbeats gives way to a newcomer, others do not: strangers cannot
/// push out who is heard.
const GIVES_WAY_NS: Nanos = 3_000_000_000;
/// Datagrams taken in one call: a flood on a link must not hold up who calls.
const MAX_PER_CALL: usize = 128;
/// A learned peer of which more than this is read in a second is let in as newcomers are while a flood comes.
const LOUD_PER_S: u32 = 150;
/// How often is looked who is loud and who is silent.
const LOOK_NS: Nanos = 1_000_000_000;

struct Learned {
    address: SocketAddr,
    heard_ns: Nanos,
    /// Datagrams since the last look.
    count: u32,
    is_loud: bool,
}

/// Another number for another address.
fn number_of(address: SocketAddr) -> u64 {
    // FNV-1a, which is the same in every process.
    let mix = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01B3);
    let begin = address.port().to_le_bytes().iter().fold(0xCBF2_9CE4_8422_2325, mix);
    match address.ip().to_canonical() {
        IpAddr::V4(ip) => ip.octets().iter().fold(begin, mix),
        IpAddr::V6(ip) => ip.octets().iter().fold(begin, mix),
    }
}

/// One UDP socket with its peers.
pub struct UdpPeers {
    socket: UdpSocket,
    /// Sent to unasked.
    peer: Option<SocketAddr>,
    learned: Vec<Learned>,
    filter: SocketFilter,
    flood: FloodWatch,
    next_look_ns: Nanos,
    statistics: LinkStatistics,
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
        let mut link = Self {
            socket,
            peer,
            learned: Vec::with_capacity(MAX_LEARNED),
            filter: SocketFilter::new(),
            flood: FloodWatch::default(),
            next_look_ns: 0,
            statistics: LinkStatistics::default(),
            buffer: Box::new([0; MAX_DATAGRAM_BYTES]),
            now_ns: 0,
        };
        link.set_filter();
        Ok(link)
    }

    fn set_filter(&mut self) {
        let quiet = self.learned.iter().filter(|l| !l.is_loud).map(|l| l.address);
        let peers = self.peer.into_iter().chain(quiet);
        let flooded = self.flood.is_flooded(self.now_ns);
        self.filter.set(&self.socket, peers, Some(PeerRule::Anyone), flooded);
    }

    /// Once a second: who is loud, who is silent.
    fn look(&mut self) {
        if self.now_ns < self.next_look_ns {
            return;
        }
        let now_ns = self.now_ns;
        self.next_look_ns = now_ns + LOOK_NS;
        self.learned
            .retain(|l| now_ns.saturating_sub(l.heard_ns) < PEER_TIMEOUT_NS);
        for learned in &mut self.learned {
            // What the kernel let in of a loud one is a part of what it sends.
            let limit = if learned.is_loud { LOUD_PER_S / 16 } else { LOUD_PER_S };
            learned.is_loud = std::mem::take(&mut learned.count) > limit;
        }
        if self.flood.is_flooded(now_ns) {
            self.filter.peers_changed();
        }
    }

    /// Hands over every datagram that has come and may be MAVLink, without waiting, and who sent it. `admit` says whether
    /// any of it was taken: only then the sender becomes a peer.
    fn read(&mut self, now_ns: Nanos, mut admit: impl FnMut(SocketAddr, &[u8]) -> bool) {
        self.now_ns = now_ns;
        self.look();
        self.set_filter();
        let (mut read, mut of_newcomers) = (0, 0);
        while read < MAX_PER_CALL {
            match self.socket.recv_from(self.buffer.as_mut_slice()) {
                Ok((len, from)) => {
                    read += 1;
                    let datagram = self.buffer.get(..len).unwrap_or_default();
                    let is_taken = admit(from, datagram) && PeerRule::Anyone.is_heard_in(datagram);
                    if !self.note(from, is_taken) {
                        of_newcomers += 1;
                    }
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                // An earlier datagram met a closed port (ICMP); what arrived is still to be read.
                Err(_) => read += 1,
            }
        }
        self.flood.note(now_ns, of_newcomers, read == MAX_PER_CALL);
    }

    /// Sends a datagram to every peer. One that the system does not take is lost, as on any UDP link.
    fn tell(&mut self, datagram: &[u8]) {
        for address in self.peer.into_iter().chain(self.learned.iter().map(|l| l.address)) {
            // A peer that does not listen is no error of ours.
            let _ = self.socket.send_to(datagram, address);
        }
    }

    /// Notes who sent a datagram, and learns him if it was taken and there is room. Returns whether he is a peer that the
    /// kernel lets in whatever else comes.
    fn note(&mut self, from: SocketAddr, is_taken: bool) -> bool {
        if self.peer == Some(from) {
            return true;
        }
        let now_ns = self.now_ns;
        if let Some(known) = self.learned.iter_mut().find(|l| l.address == from) {
            known.count += 1;
            // Who is refused does not stay a peer.
            if is_taken {
                known.heard_ns = now_ns;
            }
            return !known.is_loud;
        }
        if !is_taken {
            return false;
        }
        let new = Learned {
            address: from,
            heard_ns: now_ns,
            count: 1,
            is_loud: false,
        };
        if self.learned.len() < MAX_LEARNED {
            self.learned.push(new);
        } else if let Some(silent) = self
            .learned
            .iter_mut()
            .filter(|l| now_ns.saturating_sub(l.heard_ns) > GIVES_WAY_NS)
            .min_by_key(|l| l.heard_ns)
        {
            *silent = new;
        } else {
            self.statistics.foreign += 1;
            return false;
        }
        self.filter.peers_changed();
        false
    }
}

impl Wire for UdpPeers {
    fn receive(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        // What finds no room is dropped and counted by `received`: it is this link's own share.
        self.read(now_ns, |sender, datagram| {
            admission.admit(is_local(sender), datagram, received)
        });
    }

    fn receive_each(
        &mut self,
        now_ns: Nanos,
        admission: &mut LinkAdmission<'_>,
        buffer: &mut Datagrams,
        on_datagram: &mut dyn FnMut(u64, &[u8]),
    ) {
        self.read(now_ns, |sender, datagram| {
            buffer.clear();
            let passes = admission.admit(is_local(sender), datagram, buffer);
            let number = number_of(sender);
            buffer.iter().for_each(|(_, passed)| on_datagram(number, passed));
            passes
        });
    }

    fn send(&mut self, gate: &mut SigningGate, sent: &Datagrams) {
        for (_, datagram) in sent.iter() {
            self.tell(gate.seal(datagram));
        }
    }

    fn statistics(&self) -> (LinkStatistics, bool) {
        (self.statistics, false)
    }

    fn local_address(&self) -> std::io::Result<SocketAddr> {
        self.socket.local_addr()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_mavlink::common::{HEARTBEAT_DATA, MavMessage};
    use vigil_mavlink::framing::encode;

    fn loopback(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    fn socket() -> UdpSocket {
        let socket = UdpSocket::bind(loopback(0)).unwrap();
        socket.set_nonblocking(true).unwrap();
        socket
    }

    /// A ground station's heartbeat.
    fn hello(system: u8) -> Vec<u8> {
        encode((system, 190), 0, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT))
    }

    const REFUSED: u8 = 66;

    /// What comes, all of it admitted unless it is of [`REFUSED`]. On the loopback interface a datagram has arrived when
    /// its sending returns.
    fn heard(link: &mut UdpPeers, now_ns: Nanos) -> Vec<Vec<u8>> {
        let mut got = Vec::new();
        link.read(now_ns, |sender, datagram| {
            assert!(is_local(sender));
            got.push(datagram.to_vec());
            datagram != hello(REFUSED)
        });
        got
    }

    #[test]
    fn the_peer_hears_unasked_and_strangers_are_answered_once_they_spoke_until_they_are_silent() {
        let (companion, stranger, refused) = (socket(), socket(), socket());
        let mut link = UdpPeers::open(loopback(0), Some(companion.local_addr().unwrap())).unwrap();
        let here = link.local_address().unwrap();
        let mut buffer = [0; 16];
        link.tell(b"one");
        assert_eq!(companion.recv(&mut buffer).unwrap(), 3);

        companion.send_to(b"what the peer sends is let in", here).unwrap();
        stranger.send_to(&hello(255), here).unwrap();
        stranger.send_to(b"no MAVLink, so the kernel drops it", here).unwrap();
        refused.send_to(&hello(REFUSED), here).unwrap();
        assert_eq!(
            heard(&mut link, 1),
            [b"what the peer sends is let in".to_vec(), hello(255), hello(REFUSED)]
        );
        link.tell(b"two");
        assert_eq!(companion.recv(&mut buffer).unwrap(), 3);
        assert_eq!(stranger.recv(&mut buffer).unwrap(), 3);
        assert!(stranger.recv(&mut buffer).is_err(), "each gets it once");
        assert!(refused.recv(&mut buffer).is_err(), "who is refused hears nothing");

        assert!(heard(&mut link, 1 + PEER_TIMEOUT_NS).is_empty());
        link.tell(b"three");
        assert_eq!(companion.recv(&mut buffer).unwrap(), 5);
        assert!(stranger.recv(&mut buffer).is_err(), "it was silent for too long");
    }

    #[test]
    fn strangers_can_neither_grow_the_list_of_peers_nor_push_out_who_is_heard() {
        let mut link = UdpPeers::open(loopback(0), None).unwrap();
        let here = link.local_address().unwrap();
        let callers: Vec<_> = (0..20).map(|_| socket()).collect();
        for (now_ns, caller) in (0..).zip(&callers) {
            caller
                .send_to(b"\xFDgarbage, with a packet's first byte", here)
                .unwrap();
            caller.send_to(&hello(255), here).unwrap();
            assert_eq!(heard(&mut link, now_ns).len(), 2);
        }
        let answered = |link: &mut UdpPeers| -> Vec<usize> {
            link.tell(b"!");
            (0..20).filter(|i| callers[*i].recv(&mut [0; 4]).is_ok()).collect()
        };
        assert_eq!(answered(&mut link), (0..8).collect::<Vec<_>>(), "the first");
        // One that misses three heartbeats gives way.
        for second in 1..5 {
            for caller in &callers[1..] {
                caller.send_to(&hello(255), here).unwrap();
            }
            heard(&mut link, second * 1_000_000_000);
        }
        assert_eq!(answered(&mut link), (1..9).collect::<Vec<_>>());
        assert!(link.statistics.foreign > 12);
    }

    #[test]
    fn in_a_flood_of_strangers_who_speak_mavlink_each_packet_of_a_known_peer_arrives() {
        let mut link = UdpPeers::open(loopback(0), None).unwrap();
        let here = link.local_address().unwrap();
        let station = socket();
        let strangers: Vec<_> = (0..10).map(|_| socket()).collect();
        station.send_to(&hello(1), here).unwrap();
        heard(&mut link, 0);
        let (mut of_station, mut of_strangers) = (0, 0);
        // 20 000 a second for 10 s; the link is looked at 20 times a second.
        for step in 1..=200_u64 {
            for i in 0..1000 {
                if i == 500 {
                    station.send_to(&hello(1), here).unwrap();
                }
                // The queue may be full.
                let _ = strangers[i % 10].send_to(&hello(255), here);
            }
            for datagram in heard(&mut link, step * 50_000_000) {
                match datagram == hello(1) {
                    true => of_station += 1,
                    false => of_strangers += 1,
                }
            }
        }
        // Until the first look shows who is loud, after a second.
        assert!(of_station >= 180, "{of_station} of 200");
        assert!((200..20_000).contains(&of_strangers), "{of_strangers} of 200 000");
        station.send_to(&hello(1), here).unwrap();
        let newcomer = socket();
        for second in 11..16 {
            heard(&mut link, second * 1_000_000_000);
        }
        newcomer.send_to(&hello(9), here).unwrap();
        assert_eq!(
            heard(&mut link, 17_000_000_000),
            [hello(9)],
            "and when it is over, newcomers"
        );
    }
}
