//! Finding MAVLink packets in bytes and making bytes of messages.
//!
//! Packet formats: <https://mavlink.io/en/guide/serialization.html>. A packet whose checksum fits is yielded raw, so that a
//! message that the crate's parser refuses (an unknown command or enum value) can still be answered or routed.

mod command;
mod packet;
mod serialize;
mod stream;

#[cfg(test)]
mod tests;

pub use command::{Command, CommandAck, CommandForm};
pub use packet::{AUTOPILOT, FramingCounters, Packet, packets};
pub use serialize::{MAX_PACKET_LEN, SerializeError, renumber, serialize, serialize_payload};
#[cfg(feature = "std")]
pub use serialize::{encode, encode_payload};
pub(crate) use serialize::{extra_crc, seal};
pub use stream::StreamFramer;

/// The first of these bytes, as many as there is room for, and zeros behind them.
pub(crate) fn filled<const N: usize>(bytes: impl IntoIterator<Item = u8>) -> [u8; N] {
    let mut out = [0; N];
    for (slot, byte) in out.iter_mut().zip(bytes) {
        *slot = byte;
    }
    out
}

/// Little-endian reads at an offset of a payload whose trailing zeros were cut (MAVLink 2): what is cut reads as zero.
pub(crate) struct Zeroed<'a>(pub &'a [u8]);

impl Zeroed<'_> {
    pub fn bytes<const N: usize>(&self, offset: usize) -> [u8; N] {
        filled(self.0.iter().skip(offset).copied())
    }

    /// Whether a parameter's name, 16 bytes or up to a zero, is this one.
    pub fn is_parameter(&self, offset: usize, name: &str) -> bool {
        let id: [u8; 16] = self.bytes(offset);
        let len = id.iter().position(|byte| *byte == 0).unwrap_or(id.len());
        id.get(..len) == Some(name.as_bytes())
    }

    pub fn u8(&self, offset: usize) -> u8 {
        u8::from_le_bytes(self.bytes(offset))
    }

    pub fn u16(&self, offset: usize) -> u16 {
        u16::from_le_bytes(self.bytes(offset))
    }

    pub fn u32(&self, offset: usize) -> u32 {
        u32::from_le_bytes(self.bytes(offset))
    }

    pub fn i32(&self, offset: usize) -> i32 {
        i32::from_le_bytes(self.bytes(offset))
    }

    pub fn f32(&self, offset: usize) -> f32 {
        f32::from_le_bytes(self.bytes(offset))
    }
}
