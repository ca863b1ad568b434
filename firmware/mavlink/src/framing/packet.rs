//! The scanner that finds packets, and what a packet shows before it is parsed.

use crate::framing::{Command, CommandAck, extra_crc};
use mavlink::dialects::common::{HEARTBEAT_DATA, MavMessage};
use mavlink::error::ParserError;
use mavlink::{MAV_STX, MAV_STX_V2, MavHeader, MavlinkVersion, Message, MessageData, calculate_crc};

const V1_HEADER_LEN: usize = 6;
const V2_HEADER_LEN: usize = 10;
const CRC_LEN: usize = 2;
const SIGNATURE_LEN: usize = 13;
/// The autopilot's component.
pub const AUTOPILOT: u8 = 1;
/// MAV_AUTOPILOT_INVALID: not a vehicle.
const NO_AUTOPILOT: u8 = 8;

/// Whether a MAV_TYPE is no vehicle's: a tracking antenna's, ground station's, controller's, gimbal's, receiver's or another part's.
const fn is_equipment(mav_type: u8) -> bool {
    matches!(mav_type, 5 | 6 | 18 | 26 | 27 | 30..=34 | 36..=42 | 44 | 48 | 49)
}

/// The one incompatibility flag that a receiver of ours understands; a packet with any other must be discarded.
const INCOMPATIBILITY_SIGNED: u8 = 0x01;

/// What the scanner refused, since start. Counters never wrap in practice (u64).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FramingCounters {
    /// Packets yielded, those of unknown messages included.
    pub packets: u64,
    /// Packets whose checksum does not fit.
    pub bad_crc: u64,
    /// Packets of a message that the dialect does not know; yielded raw, their checksum cannot be verified.
    pub unknown_message: u64,
    /// Packets that end behind the end of their datagram.
    pub truncated: u64,
    /// Packets with an incompatibility flag that is not known; discarded, as the protocol demands.
    pub incompatible: u64,
    /// Bytes skipped because no packet was found in them (those of refused packets included).
    pub garbage_bytes: u64,
}

macro_rules! packet {
    ($($(#[$doc:meta])+ $name:ident: $type:ty,)+) => {
        /// One packet with a valid checksum (or of an unknown message), borrowed from the bytes it came in.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub struct Packet<'a> {
            $($name: $type,)+
        }

        impl<'a> Packet<'a> {
            $($(#[$doc])+
            pub fn $name(&self) -> $type {
                self.$name
            })+
        }
    };
}

packet! {
    /// All bytes, from the start marker to the checksum or signature.
    raw: &'a [u8],
    /// The payload as sent; MAVLink 2 cuts trailing zeros.
    payload: &'a [u8],
    /// Protocol version of the packet.
    version: MavlinkVersion,
    /// The sender's system.
    system_id: u8,
    /// The sender's component.
    component_id: u8,
    /// The sender's packet counter.
    sequence: u8,
    /// The message's number.
    message_id: u32,
    /// Whether the packet carries a signature (which is not verified here).
    is_signed: bool,
    /// Whether the dialect knows the message, so that its checksum was verified.
    is_known: bool,
}

impl Packet<'_> {
    /// The sender as the crate's header type.
    pub fn header(&self) -> MavHeader {
        MavHeader {
            system_id: u32::from(self.system_id),
            component_id: self.component_id,
            sequence: self.sequence,
        }
    }

    /// The parsed message.
    ///
    /// # Errors
    /// The message is unknown or holds an enum value that the dialect does not have. A command can still be read with
    /// [`Packet::command`].
    pub fn message(&self) -> Result<MavMessage, ParserError> {
        MavMessage::parse(self.version, self.message_id, self.payload)
    }

    /// The command of a COMMAND_LONG or COMMAND_INT, whatever its number; `None` for any other message.
    pub fn command(&self) -> Option<Command> {
        Command::from_payload(self.message_id, self.payload)
    }

    /// The acknowledgement of a COMMAND_ACK, whatever its command and result; `None` for any other message.
    pub fn command_ack(&self) -> Option<CommandAck> {
        CommandAck::from_payload(self.message_id, self.payload)
    }

    /// Whether this is the heartbeat of a vehicle's autopilot: of component 1, naming a MAV_AUTOPILOT. Ground stations, cameras and
    /// companions name none (MAV_AUTOPILOT_INVALID), or are of a MAV_TYPE that no vehicle has, as routers that gomavlib made.
    pub fn is_autopilots_heartbeat(&self) -> bool {
        // Type and autopilot.
        let &[_, _, _, _, mav_type, autopilot, ..] = self.payload else {
            return false;
        };
        self.is_known
            && self.message_id == HEARTBEAT_DATA::ID
            && self.component_id == AUTOPILOT
            && self.system_id != 0
            && autopilot != NO_AUTOPILOT
            && !is_equipment(mav_type)
    }

    /// Whether the autopilot of `system` sent it. While no system is known, the first heartbeat of an autopilot names it.
    pub fn is_of_autopilot(&self, system: &mut Option<u8>) -> bool {
        if self.is_autopilots_heartbeat() {
            system.get_or_insert(self.system_id);
        }
        self.component_id == AUTOPILOT && *system == Some(self.system_id)
    }

    /// The (system, component) that the message is addressed to; 0 is everybody. `None` when the message has no target
    /// fields or its target cannot be known (unknown message): by the routing rules that is a broadcast.
    pub fn target(&self) -> Option<(u8, u8)> {
        if let Some(command) = self.command() {
            return Some((command.target_system, command.target_component));
        }
        if let Some(ack) = self.command_ack() {
            return Some((ack.target_system, ack.target_component));
        }
        if let Ok(message) = self.message() {
            return Some((message.target_system_id()?, message.target_component_id().unwrap_or(0)));
        }
        self.target_by_layout()
    }

    /// The target of a message that does not parse, read where the dialect puts the target fields: the offsets show when
    /// a default message is serialised with the fields set.
    fn target_by_layout(&self) -> Option<(u8, u8)> {
        let mut message = MavMessage::default_message_from_id(self.message_id)?;
        let plain = serialized_payload(&message);
        *message.target_system_id_mut()? ^= 0xFF;
        let with_system = serialized_payload(&message);
        if let Some(component) = message.target_component_id_mut() {
            *component ^= 0xFF;
        }
        let with_component = serialized_payload(&message);
        let at = |a: &[u8; 255], b: &[u8; 255]| {
            let offset = a.iter().zip(b).position(|(x, y)| x != y)?;
            Some(self.payload.get(offset).copied().unwrap_or(0))
        };
        Some((
            at(&plain, &with_system)?,
            at(&with_system, &with_component).unwrap_or(0),
        ))
    }
}

/// The payload of a message, zeros behind it.
pub(super) fn serialized_payload(message: &MavMessage) -> [u8; 255] {
    let mut payload = [0; 255];
    message.ser(MavlinkVersion::V2, &mut payload);
    payload
}

/// Walks over bytes. Bytes of a packet that was refused are searched again for a start marker, because the marker found
/// may have been garbage; what is found in them is not counted as another refusal.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Scanner {
    pub at: usize,
    /// End of the span of the last refused packet.
    refused_until: usize,
}

enum Candidate<'a> {
    Whole(Packet<'a>),
    Short,
    BadCrc { len: usize },
    Incompatible { len: usize },
}

impl Scanner {
    /// Finds the next packet. With `whole`, nothing follows after `data`: a packet without its end is truncated. Else the scanner stays
    /// where one may begin whose end is not here yet.
    pub fn next<'a>(&mut self, data: &'a [u8], whole: bool, counters: &mut FramingCounters) -> Option<Packet<'a>> {
        while let Some(rest) = data.get(self.at..) {
            let Some(marker) = rest.iter().position(|b| *b == MAV_STX || *b == MAV_STX_V2) else {
                break;
            };
            counters.garbage_bytes += marker as u64;
            self.at += marker;
            let rest = rest.get(marker..).unwrap_or_default();
            let fresh = self.at >= self.refused_until;
            let (refused, len) = match candidate(rest) {
                // Its checksum is unknown: only where a packet is expected, and where another one or nothing follows.
                Candidate::Whole(p) if !(p.is_known || fresh && is_boundary(rest, p.raw.len())) => {
                    self.refuse(1, counters);
                    continue;
                }
                Candidate::Whole(p) => {
                    self.at += p.raw.len();
                    counters.packets += 1;
                    counters.unknown_message += u64::from(!p.is_known);
                    return Some(p);
                }
                Candidate::Short if !whole => return None,
                Candidate::Short => (&mut counters.truncated, rest.len()),
                Candidate::BadCrc { len } => (&mut counters.bad_crc, len),
                Candidate::Incompatible { len } => (&mut counters.incompatible, len),
            };
            *refused += u64::from(fresh);
            self.refuse(len, counters);
        }
        counters.garbage_bytes += data.len().saturating_sub(self.at) as u64;
        self.at = data.len();
        None
    }

    fn refuse(&mut self, len: usize, counters: &mut FramingCounters) {
        self.refused_until = self.refused_until.max(self.at + len);
        counters.garbage_bytes += 1;
        self.at += 1;
    }

    /// The first `n` bytes were dropped from the data.
    pub fn shift(&mut self, n: usize) {
        self.at = self.at.saturating_sub(n);
        self.refused_until = self.refused_until.saturating_sub(n);
    }
}

fn is_boundary(rest: &[u8], len: usize) -> bool {
    matches!(rest.get(len), None | Some(&(MAV_STX | MAV_STX_V2)))
}

/// Reads a packet that begins at the first byte, which is a start marker.
fn candidate(bytes: &[u8]) -> Candidate<'_> {
    let (version, header_len, signature_len, known_flags) = match *bytes {
        [MAV_STX_V2, _, flags, ..] => (
            MavlinkVersion::V2,
            V2_HEADER_LEN,
            SIGNATURE_LEN * usize::from(flags & INCOMPATIBILITY_SIGNED),
            flags & !INCOMPATIBILITY_SIGNED == 0,
        ),
        [MAV_STX, ..] => (MavlinkVersion::V1, V1_HEADER_LEN, 0, true),
        _ => return Candidate::Short,
    };
    let payload_len = usize::from(bytes.get(1).copied().unwrap_or(0));
    let crc_at = header_len + payload_len;
    let len = crc_at + CRC_LEN + signature_len;
    let (Some(raw), Some(checked), Some(payload), Some(&[crc_low, crc_high])) = (
        bytes.get(..len),
        bytes.get(1..crc_at),
        bytes.get(header_len..crc_at),
        bytes.get(crc_at..crc_at + CRC_LEN),
    ) else {
        return Candidate::Short;
    };
    if !known_flags {
        return Candidate::Incompatible { len };
    }
    let (sequence, system_id, component_id, message_id) = match *bytes {
        [MAV_STX, _, sequence, system, component, id, ..] => (sequence, system, component, u32::from(id)),
        [_, _, _, _, sequence, system, component, id0, id1, id2, ..] => {
            (sequence, system, component, u32::from_le_bytes([id0, id1, id2, 0]))
        }
        _ => return Candidate::Short,
    };
    let extra_crc = extra_crc(message_id);
    let crc = u16::from_le_bytes([crc_low, crc_high]);
    if extra_crc.is_some_and(|extra_crc| crc != calculate_crc(checked, extra_crc)) {
        return Candidate::BadCrc { len };
    }
    Candidate::Whole(Packet {
        raw,
        payload,
        version,
        system_id,
        component_id,
        sequence,
        message_id,
        is_signed: signature_len > 0,
        is_known: extra_crc.is_some(),
    })
}

/// Finds the packets of one datagram, in order: MAVLink 2 and 1, garbage skipped, everything refused counted.
/// A packet may not continue in the next datagram; for a byte stream use [`StreamFramer`](crate::framing::StreamFramer).
pub fn packets<'a>(datagram: &'a [u8], counters: &mut FramingCounters) -> impl Iterator<Item = Packet<'a>> {
    let mut scanner = Scanner::default();
    core::iter::from_fn(move || scanner.next(datagram, true, counters))
}
