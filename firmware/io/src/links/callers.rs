//! Connections that are not the peer's: whoever calls has a moment to show that he may be.

use super::packet_stream::PacketStream;
use super::{LinkAdmission, PeerRule};
use std::net::TcpStream;
use vigil_mavlink::framing::{FramingCounters, StreamFramer};
use vigil_types::{Datagrams, Nanos};

/// Callers at once. More are hung up on: they call again.
const MAX_CALLERS: usize = 32;
/// Time to show who one is: two heartbeats.
const INTRODUCTION_NS: Nanos = 2_000_000_000;
/// Bytes that are no packet: more than what joining a stream in its middle costs.
const MAX_GARBAGE: u64 = 1024;

/// Somebody who called.
pub(super) struct Caller {
    pub socket: TcpStream,
    pub is_local: bool,
    pub framer: StreamFramer,
    garbage: FramingCounters,
    since_ns: Nanos,
}

/// Who called and did not show yet that he may be the peer.
pub(super) struct Callers {
    waiting: Vec<Caller>,
}

impl Callers {
    pub fn new() -> Self {
        Self {
            waiting: Vec::with_capacity(MAX_CALLERS),
        }
    }

    /// Takes a caller in; `false` hangs up on him, because too many wait.
    pub fn take(&mut self, socket: TcpStream, is_local: bool, now_ns: Nanos) -> bool {
        let has_room = self.waiting.len() < MAX_CALLERS;
        if has_room {
            self.waiting.push(Caller {
                socket,
                is_local,
                framer: StreamFramer::default(),
                garbage: FramingCounters::default(),
                since_ns: now_ns,
            });
        }
        has_room
    }

    /// Hangs up on all of them and returns how many they were.
    pub fn dismiss(&mut self) -> u64 {
        let count = self.waiting.len() as u64;
        self.waiting.clear();
        count
    }

    /// Listens to all of them. The first who shows that he may be the peer is returned; what he said is in `received`.
    /// Who takes too long or talks something else is hung up on and counted in `foreign`.
    pub fn listen(
        &mut self,
        now_ns: Nanos,
        (rule, admission): (PeerRule, &mut LinkAdmission<'_>),
        stream: &mut PacketStream,
        received: &mut Datagrams,
        foreign: &mut u64,
    ) -> Option<Caller> {
        let mut i = 0;
        while let Some(caller) = self.waiting.get_mut(i) {
            let mut socket = &caller.socket;
            let with = (rule, &mut *admission, caller.is_local);
            let heard =
                stream.receive_introduction(&mut socket, &mut caller.framer, &mut caller.garbage, with, received);
            match heard {
                Ok(true) => return Some(self.waiting.swap_remove(i)),
                Ok(false)
                    if caller.garbage.garbage_bytes <= MAX_GARBAGE
                        && now_ns.saturating_sub(caller.since_ns) <= INTRODUCTION_NS =>
                {
                    i += 1;
                }
                _ => {
                    *foreign += 1;
                    self.waiting.swap_remove(i);
                }
            }
        }
        None
    }
}
