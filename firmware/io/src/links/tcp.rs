//! MAVLink over TCP, as client or server, reconnecting.

use super::callers::Callers;
use super::packet_stream::PacketStream;
use super::{LinkAdmission, LinkError, LinkStatistics, PEER_SILENCE_NS, PeerRule, RETRY_NS, Wire, is_local};
use crate::gate::SigningGate;
use crate::link_url::LinkUrl;
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, socket_with};
use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener, TcpStream};
use vigil_types::{Datagrams, Nanos};

/// A call that is not answered is given up after this.
const CONNECT_NS: Nanos = 5_000_000_000;
/// A peer that was called and is silent this long is called anew: the network may have lost it without a word.
const LOST_NS: Nanos = 10_000_000_000;
/// Callers taken in one step at most; bounds the step. Fewer while there is a peer, who is what counts then.
const MAX_CALLERS_PER_STEP: usize = 16;
const MAX_CALLERS_BESIDE_PEER: usize = 4;

enum Role {
    Server(TcpListener),
    Client { peer: SocketAddr, next_call_ns: Nanos },
}

struct Connection {
    socket: TcpStream,
    is_local: bool,
    /// The peer has answered the call.
    is_up: bool,
    /// The peer has shown that it may be: others must wait until it is silent.
    is_introduced: bool,
    since_ns: Nanos,
    heard_ns: Nanos,
}

impl Connection {
    /// Of a peer who has shown that it may be.
    fn of(socket: TcpStream, is_local: bool, now_ns: Nanos) -> Self {
        Self {
            socket,
            is_local,
            is_up: true,
            is_introduced: true,
            since_ns: now_ns,
            heard_ns: now_ns,
        }
    }
}

/// One TCP connection at a time.
pub struct TcpWire {
    role: Role,
    rule: PeerRule,
    connection: Option<Connection>,
    callers: Callers,
    stream: PacketStream,
    foreign: u64,
    connections: u64,
}

impl TcpWire {
    pub(crate) fn open(url: &LinkUrl, rule: PeerRule) -> Result<Self, LinkError> {
        let error = |source| LinkError::of(url, source);
        let role = match *url {
            LinkUrl::TcpIn(local) => {
                let listener = TcpListener::bind(local).map_err(error)?;
                listener.set_nonblocking(true).map_err(error)?;
                Role::Server(listener)
            }
            LinkUrl::TcpOut(peer) => Role::Client { peer, next_call_ns: 0 },
            _ => return Err(error(ErrorKind::InvalidInput.into())),
        };
        Ok(Self {
            role,
            rule,
            connection: None,
            callers: Callers::new(),
            stream: PacketStream::new(),
            foreign: 0,
            connections: 0,
        })
    }

    /// Whether the connection is a peer's who showed that it may be, and is heard.
    fn is_taken(&self, now_ns: Nanos) -> bool {
        let heard = |c: &Connection| c.is_introduced && now_ns.saturating_sub(c.heard_ns) <= PEER_SILENCE_NS;
        self.connection.as_ref().is_some_and(heard)
    }

    /// Answers who calls, or calls.
    fn connect(&mut self, now_ns: Nanos) {
        let taken = self.is_taken(now_ns);
        match &mut self.role {
            Role::Server(listener) => {
                let most = if taken {
                    MAX_CALLERS_BESIDE_PEER
                } else {
                    MAX_CALLERS_PER_STEP
                };
                for _ in 0..most {
                    let Ok((socket, from)) = listener.accept() else {
                        return;
                    };
                    if taken || socket.set_nonblocking(true).is_err() {
                        self.foreign += 1;
                        continue;
                    }
                    // Without it packets only go later.
                    let _ = socket.set_nodelay(true);
                    if self.rule.serves_the_silent() && self.connection.is_none() {
                        self.stream.reset();
                        self.connections += 1;
                        self.connection = Some(Connection {
                            is_introduced: false,
                            ..Connection::of(socket, is_local(from), now_ns)
                        });
                    } else if !self.callers.take(socket, is_local(from), now_ns) {
                        self.foreign += 1;
                    }
                }
            }
            Role::Client { peer, next_call_ns } => {
                if self.connection.is_none() && now_ns >= *next_call_ns {
                    *next_call_ns = now_ns + RETRY_NS;
                    self.connection = call(*peer, now_ns);
                }
            }
        }
    }

    /// Makes the first caller the peer who shows that he may be, if the place is free.
    fn admit_a_caller(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        if self.is_taken(now_ns) {
            self.foreign += self.callers.dismiss();
            return;
        }
        let (before, with) = (received.len(), (self.rule, &mut *admission));
        let admitted = self
            .callers
            .listen(now_ns, with, &mut self.stream, received, &mut self.foreign);
        if let Some(caller) = admitted {
            let introduction = received.iter().nth(before).map(|(_, packet)| packet);
            let has_key = admission.gate.has_key();
            self.rule.keep_to(introduction.unwrap_or_default(), has_key);
            self.stream.continue_with(caller.framer);
            self.connections += 1;
            self.connection = Some(Connection::of(caller.socket, caller.is_local, now_ns));
            self.foreign += self.callers.dismiss();
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
                self.stream.reset();
                self.connections += 1;
            } else if failed || now_ns.saturating_sub(connection.since_ns) > CONNECT_NS {
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
        ..Connection::of(socket, is_local(peer), now_ns)
    })
}

impl Wire for TcpWire {
    fn receive(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        self.connect(now_ns);
        self.watch(now_ns);
        self.admit_a_caller(now_ns, admission, received);
        if let Some(connection) = self.connection.as_mut().filter(|c| c.is_up) {
            let mut socket = &connection.socket;
            let with = (self.rule, admission, connection.is_local);
            match self.stream.receive(&mut socket, with, received) {
                Ok(true) => {
                    connection.heard_ns = now_ns;
                    connection.is_introduced = true;
                }
                Ok(false) => {}
                Err(_) => self.connection = None,
            }
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
        let statistics = LinkStatistics {
            foreign: self.foreign,
            connections: self.connections,
            ..self.stream.statistics()
        };
        (statistics, true)
    }

    fn local_address(&self) -> std::io::Result<SocketAddr> {
        match &self.role {
            Role::Server(listener) => listener.local_addr(),
            Role::Client { .. } => Err(ErrorKind::NotConnected.into()),
        }
    }
}
