//! MAVLink over TCP, as client or server, reconnecting.

use super::packet_stream::PacketStream;
use super::{LinkAdmission, LinkStatistics, PEER_SILENCE_NS, PeerRule, RETRY_NS, Wire, is_local};
use crate::gate::SigningGate;
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, socket_with};
use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener, TcpStream};
use vigil_mavlink::framing::{FramingCounters, StreamFramer};
use vigil_types::{Datagrams, Nanos};

/// A call that is not answered is given up after this.
const CONNECT_NS: Nanos = 5_000_000_000;
/// A peer that was called and is silent this long is called anew: the network may have lost it without a word.
const LOST_NS: Nanos = 10_000_000_000;
/// Callers taken in one step at most; bounds the step. Fewer while there is a peer, who is what counts then.
const MAX_CALLERS_PER_STEP: usize = 16;
const MAX_CALLERS_BESIDE_PEER: usize = 4;
/// Callers who wait at once. More are hung up on: they call again.
const MAX_CALLERS: usize = 32;
/// Time to show who one is: two heartbeats.
const INTRODUCTION_NS: Nanos = 2_000_000_000;
/// Bytes that are no packet: more than what joining a stream in its middle costs.
const MAX_GARBAGE: u64 = 1024;

enum Role {
    Server(TcpListener),
    Client { peer: SocketAddr, next_call_ns: Nanos },
}

/// The peer's, or that of somebody who called and has a moment to show that he may be.
struct Connection {
    socket: TcpStream,
    is_local: bool,
    framer: StreamFramer,
    /// What came before the introduction.
    garbage: FramingCounters,
    /// The peer has answered the call.
    is_up: bool,
    /// The peer has shown that it may be: others must wait until it is silent.
    is_introduced: bool,
    /// When the peer was heard, or the connection began.
    heard_ns: Nanos,
}

impl Connection {
    fn of(socket: TcpStream, from: SocketAddr, now_ns: Nanos) -> Self {
        Self {
            socket,
            is_local: is_local(from),
            framer: StreamFramer::default(),
            garbage: FramingCounters::default(),
            is_up: true,
            is_introduced: false,
            heard_ns: now_ns,
        }
    }
}

/// One TCP connection at a time.
pub struct TcpWire {
    role: Role,
    rule: PeerRule,
    connection: Option<Connection>,
    /// Who called and did not show yet that he may be the peer.
    callers: Vec<Connection>,
    stream: PacketStream,
}

impl TcpWire {
    pub(crate) fn listening(local: SocketAddr, rule: PeerRule) -> std::io::Result<Self> {
        let listener = TcpListener::bind(local)?;
        listener.set_nonblocking(true)?;
        Ok(Self::of(Role::Server(listener), rule))
    }

    pub(crate) fn calling(peer: SocketAddr, rule: PeerRule) -> Self {
        Self::of(Role::Client { peer, next_call_ns: 0 }, rule)
    }

    fn of(role: Role, rule: PeerRule) -> Self {
        Self {
            role,
            rule,
            connection: None,
            callers: Vec::with_capacity(MAX_CALLERS),
            stream: PacketStream::new(),
        }
    }

    /// Whether the connection is a peer's who showed that it may be, and is heard.
    fn is_taken(&self, now_ns: Nanos) -> bool {
        let heard = |c: &Connection| c.is_introduced && now_ns.saturating_sub(c.heard_ns) <= PEER_SILENCE_NS;
        self.connection.as_ref().is_some_and(heard)
    }

    fn accept(&self) -> Option<(TcpStream, SocketAddr)> {
        match &self.role {
            Role::Server(listener) => listener.accept().ok(),
            Role::Client { .. } => None,
        }
    }

    /// Answers who calls, or calls.
    fn connect(&mut self, now_ns: Nanos) {
        if let Role::Client { peer, next_call_ns } = &mut self.role
            && self.connection.is_none()
            && now_ns >= *next_call_ns
        {
            *next_call_ns = now_ns + RETRY_NS;
            self.connection = call(*peer, now_ns);
        }
        let taken = self.is_taken(now_ns);
        let most = if taken {
            MAX_CALLERS_BESIDE_PEER
        } else {
            MAX_CALLERS_PER_STEP
        };
        for _ in 0..most {
            let Some((socket, from)) = self.accept() else { return };
            if taken || socket.set_nonblocking(true).is_err() {
                self.stream.statistics.foreign += 1;
                continue;
            }
            // Without it packets only go later.
            let _ = socket.set_nodelay(true);
            let caller = Connection::of(socket, from, now_ns);
            if self.rule.serves_the_silent() && self.connection.is_none() {
                self.begin(caller);
            } else if self.callers.len() < MAX_CALLERS {
                self.callers.push(caller);
            } else {
                self.stream.statistics.foreign += 1;
            }
        }
    }

    fn begin(&mut self, connection: Connection) {
        self.stream.begin();
        self.connection = Some(connection);
    }

    /// Makes the first caller the peer who shows that he may be, if the place is free.
    fn admit_a_caller(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        if !self.is_taken(now_ns) {
            let before = received.len();
            let Some(caller) = self.introduced(now_ns, admission, received) else {
                return;
            };
            let introduction = received.iter().nth(before).map(|(_, packet)| packet);
            let has_key = admission.gate.has_key();
            self.rule.keep_to(introduction.unwrap_or_default(), has_key);
            self.begin(Connection {
                is_introduced: true,
                heard_ns: now_ns,
                ..caller
            });
        }
        self.stream.statistics.foreign += self.callers.len() as u64;
        self.callers.clear();
    }

    /// Listens to all who called. The first who shows that he may be the peer is returned; what he said is in `received`.
    /// Who takes too long or talks something else is hung up on and counted as foreign.
    fn introduced(
        &mut self,
        now_ns: Nanos,
        admission: &mut LinkAdmission<'_>,
        received: &mut Datagrams,
    ) -> Option<Connection> {
        let mut i = 0;
        while let Some(caller) = self.callers.get_mut(i) {
            let from = (&mut caller.framer, &mut caller.garbage);
            let with = (self.rule, &mut *admission, caller.is_local);
            let heard = self
                .stream
                .receive_introduction(&mut &caller.socket, from, with, received);
            match heard {
                Ok(true) => return Some(self.callers.swap_remove(i)),
                Ok(false)
                    if caller.garbage.garbage_bytes <= MAX_GARBAGE
                        && now_ns.saturating_sub(caller.heard_ns) <= INTRODUCTION_NS =>
                {
                    i += 1;
                }
                _ => {
                    self.stream.statistics.foreign += 1;
                    self.callers.swap_remove(i);
                }
            }
        }
        None
    }

    /// Reads what the peer sent.
    fn read(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        if let Some(connection) = self.connection.as_mut().filter(|c| c.is_up) {
            let with = (self.rule, admission, connection.is_local);
            let framer = &mut connection.framer;
            match self.stream.receive(&mut &connection.socket, framer, with, received) {
                Ok(true) => {
                    connection.heard_ns = now_ns;
                    connection.is_introduced = true;
                }
                Ok(false) => {}
                Err(_) => self.connection = None,
            }
        }
    }

    /// Looks whether the call was answered, and gives up what is lost.
    fn watch(&mut self, now_ns: Nanos) {
        let Some(connection) = &mut self.connection else {
            return;
        };
        if !connection.is_up {
            let failed = !matches!(connection.socket.take_error(), Ok(None));
            if !failed && connection.socket.peer_addr().is_ok() {
                connection.is_up = true;
                connection.heard_ns = now_ns;
                self.stream.begin();
            } else if failed || now_ns.saturating_sub(connection.heard_ns) > CONNECT_NS {
                self.connection = None;
            }
        } else if matches!(self.role, Role::Client { .. }) && now_ns.saturating_sub(connection.heard_ns) > LOST_NS {
            self.connection = None;
        }
    }
}

/// Begins to call; the answer comes later.
fn call(peer: SocketAddr, now_ns: Nanos) -> Option<Connection> {
    let family = match peer {
        SocketAddr::V4(_) => AddressFamily::INET,
        SocketAddr::V6(_) => AddressFamily::INET6,
    };
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let socket = socket_with(family, SocketType::STREAM, flags, None).ok()?;
    match rustix::net::connect(&socket, &peer) {
        Ok(()) | Err(Errno::INPROGRESS) => {}
        Err(_) => return None,
    }
    let socket = TcpStream::from(socket);
    // Without it packets only go later.
    let _ = socket.set_nodelay(true);
    Some(Connection {
        is_up: false,
        ..Connection::of(socket, peer, now_ns)
    })
}

impl Wire for TcpWire {
    fn receive(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        // First whether the peer is still there: who hangs up and calls again at once is no second caller.
        self.read(now_ns, admission, received);
        let before = self.stream.statistics.connections;
        self.connect(now_ns);
        self.watch(now_ns);
        self.admit_a_caller(now_ns, admission, received);
        if self.stream.statistics.connections != before {
            self.read(now_ns, admission, received);
        }
    }

    fn send(&mut self, gate: &mut SigningGate, sent: &Datagrams) {
        let Some(connection) = self.connection.as_ref().filter(|c| c.is_up) else {
            self.stream.discard(sent);
            return;
        };
        let mut socket = &connection.socket;
        if self.stream.send(&mut socket, gate, sent).is_err() {
            self.connection = None;
        }
    }

    fn statistics(&self) -> (LinkStatistics, bool) {
        (self.stream.statistics, true)
    }

    fn local_address(&self) -> std::io::Result<SocketAddr> {
        match &self.role {
            Role::Server(listener) => listener.local_addr(),
            Role::Client { .. } => Err(ErrorKind::NotConnected.into()),
        }
    }
}
