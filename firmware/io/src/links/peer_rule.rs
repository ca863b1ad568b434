//! Who may become the peer of a link that listens, and stay it.

use vigil_mavlink::common::HEARTBEAT_DATA;
use vigil_mavlink::framing::{AUTOPILOT, FramingCounters, Packet, packets};
use vigil_mavlink::mavlink::MessageData;

/// By what a caller shows that it may be the peer. What it sends must also pass the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PeerRule {
    /// The vehicle: by an autopilot's heartbeat, of `system` if one is given. Where packets are signed, any other packet of the
    /// autopilot does that is signed with the key.
    Vehicle {
        /// The vehicle's system; `None` takes the first that calls.
        system: Option<u8>,
    },
    /// Anybody who speaks MAVLink: by a packet with a right checksum.
    Anyone,
}

impl PeerRule {
    /// Whether a packet shows that its sender may become the peer. `has_key`: the gate verifies signatures.
    pub(super) fn introduces(self, packet: &Packet<'_>, has_key: bool) -> bool {
        match self {
            Self::Anyone => packet.is_known(),
            Self::Vehicle { system } => {
                // A router's heartbeat may be signed as well.
                let is_other = packet.component_id() == AUTOPILOT && packet.message_id() != HEARTBEAT_DATA::ID;
                let is_signed = has_key && packet.is_signed() && is_other;
                system.is_none_or(|system| system == packet.system_id())
                    && (packet.is_autopilots_heartbeat() || is_signed)
            }
        }
    }

    /// The same for any of the packets of a datagram.
    pub(super) fn introduces_any(self, datagram: &[u8], has_key: bool) -> bool {
        packets(datagram, &mut FramingCounters::default()).any(|packet| self.introduces(&packet, has_key))
    }

    /// Who passed the gate with `datagram` is the peer: the first vehicle that calls is the only one from then on, as whoever
    /// reads the link knows no other.
    pub(super) fn keep_to(&mut self, datagram: &[u8], has_key: bool) {
        let (rule, mut counters) = (*self, FramingCounters::default());
        let first = packets(datagram, &mut counters).find(|packet| rule.introduces(packet, has_key));
        if let (Self::Vehicle { system }, Some(first)) = (self, first) {
            system.get_or_insert(first.system_id());
        }
    }

    /// The system of a vehicle that calls and is not the link's.
    pub(super) fn other_system(self, packet: &Packet<'_>) -> Option<u8> {
        let is_other = match self {
            Self::Vehicle { system: Some(system) } => packet.is_autopilots_heartbeat() && packet.system_id() != system,
            _ => false,
        };
        is_other.then_some(packet.system_id())
    }

    /// The same of the packets of a datagram.
    pub(super) fn other_system_in(self, datagram: &[u8]) -> Option<u8> {
        packets(datagram, &mut FramingCounters::default()).find_map(|packet| self.other_system(&packet))
    }

    /// Whether a packet keeps its sender from being taken for silent: the vehicle is there as long as its autopilot is.
    pub(super) fn is_heard_by(self, packet: &Packet<'_>) -> bool {
        let may_be = match self {
            Self::Anyone => true,
            Self::Vehicle { system } => {
                packet.component_id() == AUTOPILOT && system.is_none_or(|system| system == packet.system_id())
            }
        };
        may_be && packet.is_known()
    }

    /// The same for any of the packets of a datagram.
    pub(super) fn is_heard_in(self, datagram: &[u8]) -> bool {
        packets(datagram, &mut FramingCounters::default()).any(|packet| self.is_heard_by(&packet))
    }

    /// Whether a connection is served before its other end said anything, as long as nobody else has: ground stations
    /// may listen only, a vehicle never does.
    pub(super) fn serves_the_silent(self) -> bool {
        self == Self::Anyone
    }
}
