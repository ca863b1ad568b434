//! Ports of a real flight: monotonic clock, frames from shared memory, MAVLink over UDP.

use super::{Clock, FrameSource, Link};
use crate::link_url::LinkUrl;
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use rustix::time::{Timespec, clock_gettime};
use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use vigil_transport::{BorrowedFrame, FrameSubscriber};
use vigil_types::{Datagrams, DepthFrame, Nanos};

/// The machine's monotonic clock, which all processes on it share.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now_ns(&mut self) -> Nanos {
        let now = clock_gettime(ClockId::Monotonic);
        // Both parts are positive on the monotonic clock.
        now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
    }
}

impl MonotonicClock {
    /// Sleeps until `deadline_ns`; signals do not shorten it.
    pub fn sleep_until(&self, deadline_ns: Nanos) {
        let deadline = Timespec {
            tv_sec: (deadline_ns / 1_000_000_000) as i64,
            tv_nsec: (deadline_ns % 1_000_000_000) as i64,
        };
        while clock_nanosleep_absolute(ClockId::Monotonic, &deadline).is_err_and(|e| e == rustix::io::Errno::INTR) {}
    }
}

/// Frames from the shared-memory service.
pub struct SharedFrames {
    subscriber: FrameSubscriber,
    borrowed: Option<BorrowedFrame>,
    failures: u64,
}

impl SharedFrames {
    /// Reads from `subscriber`.
    pub fn new(subscriber: FrameSubscriber) -> Self {
        Self {
            subscriber,
            borrowed: None,
            failures: 0,
        }
    }

    /// How often the transport failed to receive; each shows as a missing frame.
    pub fn failures(&self) -> u64 {
        self.failures
    }
}

impl FrameSource for SharedFrames {
    fn newest(&mut self) -> Option<&DepthFrame> {
        self.borrowed = None;
        match self.subscriber.newest() {
            Ok(frame) => self.borrowed = frame,
            Err(_) => self.failures += 1,
        }
        self.borrowed.as_deref()
    }
}

/// Why a link could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The port is taken.
    #[error("{url}: the port is in use by another process: stop it, or choose another --link or --instance")]
    InUse {
        /// The link.
        url: LinkUrl,
    },
    /// Any other refusal by the system.
    #[error("{url}: {source}")]
    Io {
        /// The link.
        url: LinkUrl,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Who is answered: another sender takes over a listening link only when the present one was silent this long.
const PEER_SILENCE_NS: Nanos = 2_000_000_000;

/// Longest UDP datagram accepted; MAVLink's longest packet is 280 bytes, senders may put several into one datagram.
const MAX_DATAGRAM_BYTES: usize = 2048;

/// Datagrams taken from the socket in one step at most; bounds the step.
const MAX_DATAGRAMS_PER_STEP: usize = 128;

/// MAVLink over one UDP socket, as link 0. It speaks with one peer: who called first, or who is called.
#[derive(Debug)]
pub struct UdpLink {
    socket: UdpSocket,
    peer: Option<SocketAddr>,
    peer_heard_ns: Nanos,
    calling: bool,
    foreign: u64,
    unsent: u64,
    buffer: Box<[u8; MAX_DATAGRAM_BYTES]>,
}

impl UdpLink {
    /// Opens the link's socket.
    ///
    /// # Errors
    /// [`LinkError::InUse`] and others, each naming the link.
    pub fn open(url: LinkUrl) -> Result<Self, LinkError> {
        let (local, peer) = match url {
            LinkUrl::UdpIn(local) => (local, None),
            LinkUrl::UdpOut(peer) => {
                let any: SocketAddr = match peer {
                    SocketAddr::V4(_) => ([0, 0, 0, 0], 0).into(),
                    SocketAddr::V6(_) => ([0u16; 8], 0).into(),
                };
                (any, Some(peer))
            }
        };
        let error = |source: std::io::Error| match source.kind() {
            ErrorKind::AddrInUse => LinkError::InUse { url },
            _ => LinkError::Io { url, source },
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

    /// The local address.
    ///
    /// # Errors
    /// What the system says.
    pub fn local_address(&self) -> std::io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// Datagrams of others than the peer, which are not read.
    pub fn foreign(&self) -> u64 {
        self.foreign
    }

    /// Datagrams that could not be sent (no peer yet, or the system refused).
    pub fn unsent(&self) -> u64 {
        self.unsent
    }

    /// Whether a datagram of `from` is to be read; the first sender becomes the peer.
    fn accepts(&mut self, from: SocketAddr, now_ns: Nanos) -> bool {
        let silent = now_ns.saturating_sub(self.peer_heard_ns) > PEER_SILENCE_NS;
        if !self.calling && (self.peer.is_none() || silent) {
            self.peer = Some(from);
        }
        if self.peer != Some(from) {
            self.foreign += 1;
            return false;
        }
        self.peer_heard_ns = now_ns;
        true
    }
}

impl Link for UdpLink {
    fn receive(&mut self, now_ns: Nanos, received: &mut Datagrams) {
        for _ in 0..MAX_DATAGRAMS_PER_STEP {
            if received.len() >= Datagrams::MAX_COUNT || received.free_bytes() < MAX_DATAGRAM_BYTES {
                return;
            }
            match self.socket.recv_from(self.buffer.as_mut_slice()) {
                Ok((len, from)) => {
                    if self.accepts(from, now_ns)
                        && let Some(datagram) = self.buffer.get(..len)
                    {
                        received.push(0, datagram);
                    }
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                // An earlier datagram met a closed port (ICMP); what arrived is still to be read.
                Err(_) => {}
            }
        }
    }

    fn send(&mut self, sent: &Datagrams) {
        for (_, datagram) in sent.iter() {
            let gone = self.peer.map(|peer| self.socket.send_to(datagram, peer));
            if !matches!(gone, Some(Ok(_))) {
                self.unsent += 1;
            }
        }
    }
}
