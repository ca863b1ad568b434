//! From message to bytes, MAVLink 2.

use crate::framing::packet::serialized_payload;
use mavlink::dialects::common::MavMessage;
use mavlink::{MAV_STX_V2, MavHeader, Message, calculate_crc};

/// Length of the largest unsigned MAVLink 2 packet: a buffer of this size holds any message.
pub const MAX_PACKET_LEN: usize = 10 + 255 + 2;

/// Why a message was not serialised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SerializeError {
    /// The buffer is smaller than the packet.
    #[error("buffer holds {available} bytes, the packet needs {needed}: use one of MAX_PACKET_LEN bytes")]
    BufferTooSmall {
        /// Bytes of the packet.
        needed: usize,
        /// Bytes of the buffer.
        available: usize,
    },
    /// A MAVLink 2 payload has at most 255 bytes, this many are too many.
    #[error("payload of {0} bytes, at most 255 fit in a packet")]
    PayloadTooLong(usize),
    /// A system id above 255 does not fit in the header.
    #[error("system id {0} does not fit in a MAVLink 2 header")]
    SystemId(u32),
    /// The dialect does not have the message of this number, so its checksum is unknown.
    #[error("message {0} is not part of the dialect")]
    UnknownMessage(u32),
}

/// Writes `message` as an unsigned MAVLink 2 packet into `out` and returns its length.
///
/// # Errors
/// [`SerializeError`]; `out` may hold part of the packet then.
pub fn serialize(header: MavHeader, message: &MavMessage, out: &mut [u8]) -> Result<usize, SerializeError> {
    serialize_payload(header, message.message_id(), &serialized_payload(message), out)
}

/// The unsigned MAVLink 2 packet of `message` from `(system, component)`, in memory of its own; the loop uses [`serialize`].
#[cfg(feature = "std")]
pub fn encode(from: (u8, u8), sequence: u8, message: &MavMessage) -> std::vec::Vec<u8> {
    // Whatever the dialect has fits.
    encode_payload(from, sequence, message.message_id(), &serialized_payload(message)).unwrap_or_default()
}

/// The same of a raw payload, for what [`serialize_payload`] is for.
///
/// # Errors
/// [`SerializeError`].
#[cfg(feature = "std")]
pub fn encode_payload(
    (system, component_id): (u8, u8),
    sequence: u8,
    id: u32,
    payload: &[u8],
) -> Result<std::vec::Vec<u8>, SerializeError> {
    let header = MavHeader {
        system_id: system.into(),
        component_id,
        sequence,
    };
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize_payload(header, id, payload, &mut out)?;
    Ok(out.get(..len).unwrap_or_default().to_vec())
}

/// A message's part of its packets' checksum; `None` for one that the dialect does not have.
pub(crate) fn extra_crc(message_id: u32) -> Option<u8> {
    let extra_crc = MavMessage::extra_crc(message_id);
    // One message of the dialect has 0, which also stands for an unknown one.
    let is_known = extra_crc != 0 || MavMessage::default_message_from_id(message_id).is_some();
    is_known.then_some(extra_crc)
}

/// Writes the checksum of a MAVLink 2 packet into its last two bytes.
pub(crate) fn seal(packet: &mut [u8], extra_crc: u8) {
    if let Some((checked, crc)) = packet.split_last_chunk_mut::<2>() {
        *crc = calculate_crc(checked.get(1..).unwrap_or_default(), extra_crc).to_le_bytes();
    }
}

/// Gives an unsigned MAVLink 2 packet of a known message another sequence number: each link counts its own. Anything else
/// is left as it is.
pub fn renumber(packet: &mut [u8], sequence: u8) {
    let &[MAV_STX_V2, _, 0, _, _, _, _, id0, id1, id2, ..] = &*packet else {
        return;
    };
    let message_id = u32::from_le_bytes([id0, id1, id2, 0]);
    if let (Some(extra_crc), Some(slot)) = (extra_crc(message_id), packet.get_mut(4)) {
        *slot = sequence;
        seal(packet, extra_crc);
    }
}

/// Writes a packet of a raw payload: for what the crate's types cannot hold, such as the acknowledgement of a command
/// whose number the dialect does not have. Trailing zeros of the payload are cut, as MAVLink 2 demands.
///
/// # Errors
/// [`SerializeError`]; `out` may hold part of the packet then.
pub fn serialize_payload(
    header: MavHeader,
    message_id: u32,
    payload: &[u8],
    out: &mut [u8],
) -> Result<usize, SerializeError> {
    let system_id = u8::try_from(header.system_id).map_err(|_| SerializeError::SystemId(header.system_id))?;
    let extra_crc = extra_crc(message_id).ok_or(SerializeError::UnknownMessage(message_id))?;
    let significant = payload.iter().rposition(|b| *b != 0).map_or(1, |last| last + 1);
    let payload = payload.get(..significant).unwrap_or(payload);
    let payload_len = u8::try_from(payload.len()).map_err(|_| SerializeError::PayloadTooLong(payload.len()))?;
    let needed = 10 + payload.len() + 2;
    let available = out.len();
    let too_small = SerializeError::BufferTooSmall { needed, available };
    let [id0, id1, id2, _] = message_id.to_le_bytes();
    let bytes = [MAV_STX_V2, payload_len, 0, 0, header.sequence, system_id]
        .into_iter()
        .chain([header.component_id, id0, id1, id2])
        .chain(payload.iter().copied());
    let packet = out.get_mut(..needed).ok_or(too_small)?;
    for (slot, byte) in packet.iter_mut().zip(bytes) {
        *slot = byte;
    }
    seal(packet, extra_crc);
    Ok(needed)
}
