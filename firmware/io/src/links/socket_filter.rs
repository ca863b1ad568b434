//! What the kernel lets into a UDP socket's queue: a classic BPF program, so that a flood of strangers neither fills the
//! queue nor uses up a step's reads. It only sheds load. Who is heard is decided where datagrams are read.
//! <https://docs.kernel.org/networking/filter.html>

use super::peer_rule::PeerRule;
use socket2::{SockFilter, SockRef};
use std::net::{IpAddr, SocketAddr, UdpSocket};
use vigil_mavlink::framing::AUTOPILOT;
use vigil_types::{Nanos, STEP_NS};

/// Instructions of a program: enough for ten peers by IPv6.
const CAPACITY: usize = 128;
/// Of newcomers one in this many passes while a link is flooded.
const THINNED_TO_ONE_IN: u32 = 16;

/// The kernel's offset of the IP header, and of what it computes itself (`SKF_NET_OFF`, `SKF_AD_OFF`).
const IP_HEADER: u32 = -0x10_0000_i32 as u32;
const COMPUTED: u32 = -0x1000_i32 as u32;
/// A random word (`SKF_AD_RANDOM`).
const RANDOM: u32 = COMPUTED + 56;
/// A UDP socket's program sees the UDP header first: source port at 0, payload at 8.
const SOURCE_PORT: u32 = 0;
const PAYLOAD: u32 = 8;

const LOAD_BYTE: u16 = 0x30;
const LOAD_HALF: u16 = 0x28;
const LOAD_WORD: u16 = 0x20;
const JUMP_IF_EQUAL: u16 = 0x15;
const JUMP_IF_ANY_BIT: u16 = 0x45;
const RETURN: u16 = 0x06;
const ALL: u32 = u32::MAX;
const NOTHING: u32 = 0;

const MAGIC_V1: u32 = 0xFE;
const MAGIC_V2: u32 = 0xFD;
/// Bytes of the shortest packet.
const SHORTEST: u32 = 8;

/// Builds programs without allocating, and attaches them when they changed.
pub(super) struct SocketFilter {
    program: Vec<SockFilter>,
    in_force: Option<(Option<PeerRule>, bool)>,
}

impl SocketFilter {
    pub fn new() -> Self {
        Self {
            program: Vec::with_capacity(CAPACITY),
            in_force: None,
        }
    }

    /// The peers are others than at the last call of [`SocketFilter::set`].
    pub fn peers_changed(&mut self) {
        self.in_force = None;
    }

    /// Lets in everything from `peers` and, of `newcomers`, what begins like a packet of whom they may be; only some while the
    /// link is `flooded`. Where a system is given, of another vehicle's few: so that somebody can hear of it.
    pub fn set(
        &mut self,
        socket: &UdpSocket,
        peers: impl Iterator<Item = SocketAddr>,
        newcomers: Option<PeerRule>,
        flooded: bool,
    ) {
        if self.in_force == Some((newcomers, flooded)) {
            return;
        }
        self.in_force = Some((newcomers, flooded));
        self.program.clear();
        for peer in peers {
            self.let_in_peer(peer);
        }
        self.let_in_newcomers(newcomers, flooded);
        // A kernel that refuses lets everything in: then strangers cost reads, and are refused where they are read.
        let _ = SockRef::from(socket).attach_filter(&self.program);
    }

    fn push(&mut self, code: u16, if_true: u8, if_false: u8, value: u32) {
        self.program.push(SockFilter::new(code, if_true, if_false, value));
    }

    /// Returns if the sender is that one, else goes on behind.
    fn let_in_peer(&mut self, peer: SocketAddr) {
        // Source address in the header of IPv4 and IPv6; each word compared, each difference leads behind the block.
        let mut compare = |at: u32, address: &[u8]| {
            let words = address.len() / 4;
            for (i, word) in address.chunks_exact(4).enumerate() {
                let value = word.iter().fold(0, |sum, byte| sum << 8 | u32::from(*byte));
                let behind = 2 * (words - i - 1) + 3;
                self.push(LOAD_WORD, 0, 0, IP_HEADER + at + 4 * i as u32);
                self.push(JUMP_IF_EQUAL, 0, behind as u8, value);
            }
        };
        match peer.ip().to_canonical() {
            IpAddr::V4(address) => compare(12, &address.octets()),
            IpAddr::V6(address) => compare(8, &address.octets()),
        }
        self.push(LOAD_HALF, 0, 0, SOURCE_PORT);
        self.push(JUMP_IF_EQUAL, 0, 1, peer.port().into());
        self.push(RETURN, 0, 0, ALL);
    }

    fn let_in_newcomers(&mut self, newcomers: Option<PeerRule>, flooded: bool) {
        let Some(newcomers) = newcomers else {
            self.push(RETURN, 0, 0, NOTHING);
            return;
        };
        // The vehicle that is asked for is let in whatever else comes.
        if flooded && !matches!(newcomers, PeerRule::Vehicle { system: Some(_) }) {
            self.push(LOAD_WORD, 0, 0, RANDOM);
            self.push(JUMP_IF_ANY_BIT, 0, 1, THINNED_TO_ONE_IN - 1);
            self.push(RETURN, 0, 0, NOTHING);
        }
        // Loading beyond the datagram's end refuses it.
        self.push(LOAD_BYTE, 0, 0, PAYLOAD + SHORTEST - 1);
        self.push(LOAD_BYTE, 0, 0, PAYLOAD);
        match newcomers {
            PeerRule::Vehicle { system } => {
                // Of MAVLink 1 and 2: where system and component stand.
                for (magic, at) in [(MAGIC_V1, 3), (MAGIC_V2, 5)] {
                    // Behind the block the marker is compared with the other; what was loaded in between is none.
                    self.push(JUMP_IF_EQUAL, 0, if system.is_some() { 8 } else { 4 }, magic);
                    self.push(LOAD_BYTE, 0, 0, PAYLOAD + at + 1);
                    self.push(JUMP_IF_EQUAL, 0, if system.is_some() { 5 } else { 1 }, AUTOPILOT.into());
                    if let Some(system) = system {
                        self.push(LOAD_BYTE, 0, 0, PAYLOAD + at);
                        self.push(JUMP_IF_EQUAL, 2, 0, system.into());
                        self.push(LOAD_WORD, 0, 0, RANDOM);
                        let refused = if flooded { u32::MAX } else { THINNED_TO_ONE_IN - 1 };
                        self.push(JUMP_IF_ANY_BIT, 1, 0, refused);
                    }
                    self.push(RETURN, 0, 0, ALL);
                    self.push(RETURN, 0, 0, NOTHING);
                }
            }
            PeerRule::Anyone => {
                self.push(JUMP_IF_EQUAL, 1, 0, MAGIC_V1);
                self.push(JUMP_IF_EQUAL, 0, 1, MAGIC_V2);
                self.push(RETURN, 0, 0, ALL);
            }
        }
        self.push(RETURN, 0, 0, NOTHING);
    }
}

/// Time over which newcomers' datagrams are counted: a step.
const WINDOW_NS: Nanos = STEP_NS;
/// So many of them in that time are a flood; ground stations and scripts send a tenth of it.
pub(super) const FLOOD: usize = 128;
/// How long a link counts as flooded after it was, so that the program is not changed in every step.
const FLOODED_NS: Nanos = 1_000_000_000;

/// Whether newcomers flood a link.
#[derive(Debug, Default)]
pub(super) struct FloodWatch {
    until_ns: Nanos,
    window_end_ns: Nanos,
    read: usize,
}

impl FloodWatch {
    pub fn is_flooded(&self, now_ns: Nanos) -> bool {
        now_ns < self.until_ns
    }

    /// Takes how many datagrams of newcomers one call read, and whether it had to leave others.
    pub fn note(&mut self, now_ns: Nanos, read: usize, left_some: bool) {
        if now_ns >= self.window_end_ns {
            self.window_end_ns = now_ns + WINDOW_NS;
            self.read = 0;
        }
        let sent = match self.is_flooded(now_ns) {
            true => read * THINNED_TO_ONE_IN as usize,
            false => read,
        };
        self.read += sent;
        if left_some || self.read >= FLOOD {
            self.until_ns = now_ns + FLOODED_NS;
        }
    }
}
