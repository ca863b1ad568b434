//! Numbers and serialises what the guidance computer says.

use crate::framing::{Command, MAX_PACKET_LEN, SerializeError, serialize, serialize_payload};
use crate::report::heartbeat;
use mavlink::MavHeader;
use mavlink::dialects::common::{MavMessage, MavState, MavType};
use vigil_types::Datagrams;

/// Who speaks, and its packet counter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sender {
    /// Its system.
    pub system_id: u8,
    /// Its component.
    pub component_id: u8,
    sequence: u8,
}

impl Sender {
    /// One that has said nothing yet.
    pub fn new(system_id: u8, component_id: u8) -> Self {
        Self {
            system_id,
            component_id,
            sequence: 0,
        }
    }

    /// Says a message.
    pub fn message(&mut self, out: &mut Datagrams, link: u8, message: &MavMessage) {
        self.push(out, link, |header, buffer| serialize(header, message, buffer));
    }

    /// Says a command.
    pub fn command(&mut self, out: &mut Datagrams, link: u8, command: &Command) {
        self.push(out, link, |header, buffer| command.serialize(header, buffer));
    }

    pub(crate) fn payload(&mut self, out: &mut Datagrams, link: u8, message_id: u32, payload: &[u8]) {
        self.push(out, link, |header, buffer| {
            serialize_payload(header, message_id, payload, buffer)
        });
    }

    /// The heartbeat of one who listens and asks, and commands nothing.
    pub fn listener_heartbeat(&mut self, out: &mut Datagrams, link: u8) {
        self.message(
            out,
            link,
            &heartbeat(MavType::MAV_TYPE_GENERIC, MavState::MAV_STATE_ACTIVE),
        );
    }

    /// One packet is one datagram. What does not fit is counted by `out`.
    fn push(
        &mut self,
        out: &mut Datagrams,
        link: u8,
        serialize: impl FnOnce(MavHeader, &mut [u8]) -> Result<usize, SerializeError>,
    ) {
        let header = MavHeader {
            system_id: self.system_id.into(),
            component_id: self.component_id,
            sequence: self.sequence,
        };
        let mut buffer = [0; MAX_PACKET_LEN];
        // Cannot fail: the buffer holds any packet, the messages are the dialect's, the system id is a byte.
        if let Ok(len) = serialize(header, &mut buffer) {
            self.sequence = self.sequence.wrapping_add(1);
            out.push(link, buffer.get(..len).unwrap_or_default());
        }
    }
}
