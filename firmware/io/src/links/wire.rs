//! What carries a link's bytes, and the gate that they pass: one link's own, or one that several share.

use super::{LINK, LinkStatistics};
use crate::Link;
use crate::gate::{AllowUnsigned, SigningGate};
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
    /// Appends to `received` what may pass, and tells whether anything did. `is_local`: the sender is on this machine.
    pub fn admit(&mut self, is_local: bool, datagram: &[u8], received: &mut Datagrams) -> bool {
        let (policy, link) = (self.allow_unsigned, self.link);
        self.gate.admit_by(policy, is_local, link, datagram, received)
    }
}

/// What carries a link's bytes, whoever's gate they pass.
pub trait Wire {
    /// The wire itself finds the packets in what it reads; of datagrams the gate does.
    const IS_STREAM: bool;

    /// Appends what arrived and may pass. Never waits; what does not fit stays for the next call.
    fn receive(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams);

    /// Sends each datagram, sealed by the gate. Never waits; what cannot be sent is lost and counted.
    fn send(&mut self, gate: &mut SigningGate, sent: &Datagrams);

    /// What was not taken or could not be delivered; nothing of the gate's.
    fn statistics(&self) -> LinkStatistics;
}

/// A link with a gate of its own.
pub struct Gated<W: Wire> {
    pub(super) wire: W,
    pub(super) gate: SigningGate,
}

impl<W: Wire> Gated<W> {
    /// What was not taken or delivered.
    pub fn statistics(&self) -> LinkStatistics {
        let statistics = self.wire.statistics();
        LinkStatistics {
            framing: match W::IS_STREAM {
                true => statistics.framing,
                false => self.gate.framing(),
            },
            signing: self.gate.counters(),
            ..statistics
        }
    }
}

impl<W: Wire> Link for Gated<W> {
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
