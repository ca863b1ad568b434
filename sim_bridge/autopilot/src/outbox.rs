//! What waits to be sent: packets with their link, one packet per datagram.

use crate::LinkId;
use crate::config::Source;
use vigil_mavlink::MavMessage;
use vigil_mavlink::framing::{MAX_PACKET_LEN, serialize, serialize_payload};
use vigil_mavlink::mavlink::{MavHeader, Message};

/// Bytes that may wait between two calls of `transmit`; more is dropped and counted.
const CAPACITY_BYTES: usize = 256 * 1024;

/// Packets and bytes since start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Traffic {
    pub packets: u64,
    pub bytes: u64,
}

/// The queue. It keeps its memory, so that a steady flow allocates nothing.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    pub system_id: u8,
    /// Whether what is queued now is telemetry: on a slow link it gives way to everything else.
    pub is_telemetry: bool,
    bytes: Vec<u8>,
    /// (link, whether it is telemetry, end offset) of each packet.
    marks: Vec<(u8, bool, u32)>,
    /// Sequence per link, as PX4 counts.
    sequences: Vec<u8>,
    /// What was queued on each link.
    sent: Vec<Traffic>,
    /// Packets dropped because nobody took them.
    pub dropped: u64,
}

impl Outbox {
    pub fn new(system_id: u8, links: usize) -> Self {
        Self {
            system_id,
            bytes: Vec::with_capacity(16 * 1024),
            marks: Vec::with_capacity(256),
            sequences: vec![0; links],
            sent: vec![Traffic::default(); links],
            ..Self::default()
        }
    }

    /// Number of links.
    pub fn links(&self) -> usize {
        self.sequences.len()
    }

    /// What was queued on a link.
    pub fn sent(&self, link: LinkId) -> Traffic {
        self.sent.get(usize::from(link.0)).copied().unwrap_or_default()
    }

    /// Queues a message of the vehicle on one link.
    pub fn send(&mut self, link: LinkId, message: &MavMessage) {
        self.build(link, |header, out| serialize(header, message, out).ok());
    }

    /// Queues a message of the vehicle on the link of the component that it then names as its target.
    pub fn send_to(&mut self, to: Source, mut message: MavMessage) {
        if let Some(system) = message.target_system_id_mut() {
            *system = to.id.system;
        }
        if let Some(component) = message.target_component_id_mut() {
            *component = to.id.component;
        }
        self.send(to.link, &message);
    }

    /// Queues a message of the vehicle whose payload is given: for what the crate's types cannot hold.
    pub fn send_payload(&mut self, link: LinkId, message_id: u32, payload: &[u8]) {
        self.build(link, |header, out| {
            serialize_payload(header, message_id, payload, out).ok()
        });
    }

    /// Queues a message of the vehicle on all links.
    pub fn send_all(&mut self, message: &MavMessage) {
        for link in 0..self.links() as u8 {
            self.send(LinkId(link), message);
        }
    }

    /// Queues what is written behind this header.
    pub fn build(&mut self, link: LinkId, write: impl FnOnce(MavHeader, &mut [u8]) -> Option<usize>) {
        let Some(sequence) = self.sequences.get_mut(usize::from(link.0)) else {
            return;
        };
        let header = MavHeader {
            system_id: u32::from(self.system_id),
            component_id: 1,
            sequence: *sequence,
        };
        let mut packet = [0; MAX_PACKET_LEN];
        if let Some(packet) = write(header, &mut packet).and_then(|len| packet.get(..len)) {
            *sequence = sequence.wrapping_add(1);
            self.push(link.0, packet);
        }
    }

    /// Queues a packet as it is.
    pub fn push(&mut self, link: u8, packet: &[u8]) {
        if self.bytes.len() + packet.len() > CAPACITY_BYTES {
            self.dropped += 1;
            return;
        }
        if let Some(sent) = self.sent.get_mut(usize::from(link)) {
            sent.packets += 1;
            sent.bytes += packet.len() as u64;
        }
        self.bytes.extend_from_slice(packet);
        self.marks.push((link, self.is_telemetry, self.bytes.len() as u32));
    }

    /// Hands out what waits, in order and whether it is telemetry, and forgets it.
    pub fn drain(&mut self, mut send: impl FnMut(LinkId, bool, &[u8])) {
        let mut start = 0;
        for (link, is_telemetry, end) in self.marks.drain(..) {
            let end = end as usize;
            if let Some(packet) = self.bytes.get(start..end) {
                send(LinkId(link), is_telemetry, packet);
            }
            start = end;
        }
        self.bytes.clear();
    }
}
