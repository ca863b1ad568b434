//! MAVLink 2 message signing: <https://mavlink.io/en/guide/message_signing.html>.
//!
//! Sans IO: the caller gives the time and keeps [`SigningMemory`] over restarts, so that what was received before one is
//! refused after it. A signed packet ends in 13 bytes: link id, 48-bit timestamp, and the first 48 bits of the SHA-256 of
//! key, packet, link id and timestamp.

use crate::framing::{Packet, extra_crc, filled, seal};
use heapless::Vec;
use mavlink::dialects::common::SETUP_SIGNING_DATA;
use mavlink::{MAV_STX_V2, MessageData};
use sha2::{Digest, Sha256};

/// Units of a [`Timestamp`] in a second: one is 10 µs.
pub const UNITS_PER_SECOND: u64 = 100_000;
/// Bytes that signing adds to a packet.
pub const SIGNATURE_LEN: usize = 13;
/// Streams remembered. Only who has the key can fill the table.
pub const MAX_STREAMS: usize = 32;
/// A stream that was not seen before may lag this far behind the clock; nothing may be this far ahead of it.
const TOLERANCE: u64 = 60 * UNITS_PER_SECOND;
/// 2015-01-01T00:00:00Z, the protocol's epoch, in seconds of Unix time.
const EPOCH_UNIX_S: u64 = 1_420_070_400;
/// Timestamps have 48 bits: they end in the year 2104.
pub const LAST_TIMESTAMP: u64 = (1 << 48) - 1;
const SIGNED_FLAG: u8 = 0x01;

/// Time as signatures have it: units of 10 µs since 2015-01-01 UTC.
pub type Timestamp = u64;

/// The timestamp of a Unix time in nanoseconds; 0 for times before the protocol's epoch.
pub const fn timestamp_of_unix_ns(unix_ns: u64) -> Timestamp {
    unix_ns.saturating_sub(EPOCH_UNIX_S * 1_000_000_000) / 10_000
}

/// The shared secret. It is not shown by `Debug`.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct SigningKey(pub [u8; 32]);

impl SigningKey {
    /// Whether it is all zeros, which the protocol takes for "no signing" and anybody would guess: never a key.
    pub fn is_zero(&self) -> bool {
        self.0 == [0; 32]
    }
}

impl core::fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("SigningKey(..)")
    }
}

/// A sender on a link: each has timestamps of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamTime {
    /// The sender's link id.
    pub link_id: u8,
    /// The sender's system.
    pub system_id: u8,
    /// The sender's component.
    pub component_id: u8,
    /// Timestamp of the newest packet accepted.
    pub timestamp: Timestamp,
}

fn sender(stream: &StreamTime) -> (u8, u8, u8) {
    (stream.link_id, stream.system_id, stream.component_id)
}

/// What replay protection needs to know after a restart.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SigningMemory {
    /// Newest timestamp sent. What others send does not move it: who has the key could else carry it ahead, packet by
    /// packet.
    pub newest: Timestamp,
    /// Newest timestamp of each stream.
    pub streams: Vec<StreamTime, MAX_STREAMS>,
}

impl SigningMemory {
    /// The same with every time later by `units`: what is stored while packets still come, so that those accepted after
    /// the storing are refused too. A time that is as it was when the run `began` may be ahead already, of a run that was
    /// killed: it is no further ahead of `now`, however often that happens.
    pub fn ahead(mut self, began: &Self, now: Timestamp, units: u64) -> Self {
        let later = |t: Timestamp| (t + units).min(LAST_TIMESTAMP);
        let capped = |t: Timestamp| t.max(later(t.min(now)));
        // Ahead of the clock each packet that is sent moves it by one: by no more than this between two storings.
        self.newest = capped(self.newest).max((self.newest + units / 100).min(LAST_TIMESTAMP));
        for stream in &mut self.streams {
            let has_moved = !began.streams.contains(stream);
            stream.timestamp = if has_moved {
                later(stream.timestamp)
            } else {
                capped(stream.timestamp)
            };
        }
        self
    }
}

/// Whether a packet holds a signing key (SETUP_SIGNING), which is its receiver's business only.
pub fn carries_key(packet: &Packet<'_>) -> bool {
    packet.message_id() == SETUP_SIGNING_DATA::ID
}

macro_rules! refusals {
    ($($(#[$doc:meta])+ $refusal:ident: $counter:ident = $name:literal,)+) => {
        /// Why a packet is not accepted.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Refusal {
            $($(#[$doc])+ $refusal,)+
        }

        /// What was accepted and refused since start.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
        pub struct SigningCounters {
            /// Packets accepted for their signature.
            pub signed: u64,
            /// Packets without a signature that were accepted because the link allows it.
            pub unsigned_allowed: u64,
            $(#[doc = concat!("[`Refusal::", stringify!($refusal), "`].")] pub $counter: u64,)+
        }

        impl SigningCounters {
            /// Counts a verdict.
            pub fn count(&mut self, signed: bool, verdict: Result<(), Refusal>) {
                *match verdict {
                    Ok(()) if signed => &mut self.signed,
                    Ok(()) => &mut self.unsigned_allowed,
                    $(Err(Refusal::$refusal) => &mut self.$counter,)+
                } += 1;
            }

            /// Packets refused, with the reason's name.
            pub fn refusals(&self) -> [(&'static str, u64); [$($name),+].len()] {
                [$(($name, self.$counter)),+]
            }
        }
    };
}

refusals! {
    /// It carries no signature, and none is not allowed here.
    Unsigned: unsigned = "unsigned",
    /// The signature is another key's, or the packet was altered.
    WrongSignature: wrong_signature = "wrong signature",
    /// Its stream has sent this timestamp or a later one before.
    Replayed: replayed = "replayed",
    /// It begins a stream, more than a minute behind.
    Outdated: outdated = "outdated",
    /// It is more than a minute ahead.
    FromTheFuture: from_the_future = "from the future",
    /// It begins a stream, and [`MAX_STREAMS`] are known whose newest packet is less than a minute old.
    TooManyStreams: too_many_streams = "too many senders",
    /// It brings a key (SETUP_SIGNING) and is not signed with the present one.
    UnsignedKey: unsigned_key = "keys without a signature",
}

impl SigningCounters {
    /// Packets refused, for whatever reason.
    pub fn refused(&self) -> u64 {
        self.refusals().iter().map(|(_, count)| count).sum()
    }
}

/// A packet that cannot be signed: it is not MAVLink 2, is signed already, is of a message that the dialect does not
/// know, or the buffer is too small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("only an unsigned MAVLink 2 packet of a known message can be signed, into a buffer 13 bytes longer")]
pub struct SignError;

/// Signs and verifies with one key. Fixed memory.
#[derive(Debug, Clone)]
pub struct Signing {
    key: SigningKey,
    link_id: u8,
    memory: SigningMemory,
}

impl Signing {
    /// Signs as `link_id`, and goes on where `memory` ends.
    pub fn new(key: SigningKey, link_id: u8, memory: SigningMemory) -> Self {
        Self { key, link_id, memory }
    }

    /// What to keep over a restart.
    pub fn memory(&self) -> &SigningMemory {
        &self.memory
    }

    /// Whether the packet is to be obeyed at `now`; the stream's time is noted.
    /// With `allow_unsigned` a packet without a signature is accepted, unless it brings another key; a wrong one never is.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn verify(&mut self, now: Timestamp, packet: &Packet<'_>, allow_unsigned: bool) -> Result<(), Refusal> {
        match packet.is_signed() {
            true => self.check(now, packet),
            false if carries_key(packet) => Err(Refusal::UnsignedKey),
            false if allow_unsigned => Ok(()),
            false => Err(Refusal::Unsigned),
        }
    }

    fn check(&mut self, now: Timestamp, packet: &Packet<'_>) -> Result<(), Refusal> {
        let raw = packet.raw();
        let (signed, tail) = raw.split_last_chunk::<SIGNATURE_LEN>().ok_or(Refusal::WrongSignature)?;
        let [link_id, t0, t1, t2, t3, t4, t5, signature @ ..] = *tail;
        let stamp = [link_id, t0, t1, t2, t3, t4, t5];
        if !is_equal(signature, signature_of(&self.key, signed, stamp)) {
            return Err(Refusal::WrongSignature);
        }
        let timestamp = u64::from_le_bytes([t0, t1, t2, t3, t4, t5, 0, 0]);
        let local = self.local(now);
        let stream = StreamTime {
            link_id,
            system_id: packet.system_id(),
            component_id: packet.component_id(),
            timestamp,
        };
        let known = self.memory.streams.iter_mut().find(|s| sender(s) == sender(&stream));
        if known.as_ref().is_some_and(|known| timestamp <= known.timestamp) {
            return Err(Refusal::Replayed);
        }
        if timestamp > local + TOLERANCE {
            return Err(Refusal::FromTheFuture);
        }
        match known {
            Some(known) => known.timestamp = timestamp,
            None if timestamp + TOLERANCE < local => return Err(Refusal::Outdated),
            None => self.remember(stream, local)?,
        }
        Ok(())
    }

    /// Where there is no room, the oldest stream gives way if whatever it sent is outdated, known or not.
    fn remember(&mut self, stream: StreamTime, local: Timestamp) -> Result<(), Refusal> {
        let SigningMemory { newest, streams } = &mut self.memory;
        let Err(stream) = streams.push(stream) else {
            return Ok(());
        };
        let oldest = streams.iter_mut().min_by_key(|s| s.timestamp);
        let outdated = oldest.filter(|s| s.timestamp + TOLERANCE < local);
        let place = outdated.ok_or(Refusal::TooManyStreams)?;
        // A clock that is set back makes it no younger.
        *newest = (*newest).max(place.timestamp + TOLERANCE + 1);
        *place = stream;
        Ok(())
    }

    /// Whether a stream went on beyond what is stored.
    pub fn has_overtaken(&self, stored: &SigningMemory) -> bool {
        let covers = |s: &StreamTime, by: &StreamTime| sender(by) == sender(s) && by.timestamp >= s.timestamp;
        let is_covered = |s| stored.streams.iter().any(|by| covers(s, by));
        !self.memory.streams.iter().all(is_covered)
    }

    /// The clock, or what was sent, whichever is later. So a machine whose clock was set back goes on where it was.
    fn local(&self, now: Timestamp) -> Timestamp {
        now.max(self.memory.newest)
    }

    /// Writes an unsigned MAVLink 2 packet, signed at `now`, into `out` and returns its length. Each packet's timestamp is
    /// later than that of the packet before.
    ///
    /// # Errors
    /// [`SignError`].
    pub fn sign(&mut self, now: Timestamp, packet: &[u8], out: &mut [u8]) -> Result<usize, SignError> {
        let &[MAV_STX_V2, _, 0, _, _, _, _, id0, id1, id2, ..] = packet else {
            return Err(SignError);
        };
        let message_id = u32::from_le_bytes([id0, id1, id2, 0]);
        let extra_crc = extra_crc(message_id).ok_or(SignError)?;
        let len = packet.len() + SIGNATURE_LEN;
        let out = out.get_mut(..len).ok_or(SignError)?;
        let (signed, tail) = out.split_at_mut(packet.len());
        signed.copy_from_slice(packet);
        if let Some(flags) = signed.get_mut(2) {
            *flags |= SIGNED_FLAG;
        }
        // The checksum covers the flags.
        seal(signed, extra_crc);
        let timestamp = now.max(self.memory.newest + 1).min(LAST_TIMESTAMP);
        self.memory.newest = timestamp;
        let [t0, t1, t2, t3, t4, t5, ..] = timestamp.to_le_bytes();
        let stamp = [self.link_id, t0, t1, t2, t3, t4, t5];
        let (stamp_slot, signature_slot) = tail.split_at_mut(stamp.len());
        stamp_slot.copy_from_slice(&stamp);
        signature_slot.copy_from_slice(&signature_of(&self.key, signed, stamp));
        Ok(len)
    }
}

/// The first 48 bits of SHA-256 over key, packet (start marker to checksum), link id and timestamp.
fn signature_of(key: &SigningKey, packet: &[u8], stamp: [u8; 7]) -> [u8; 6] {
    let mut hash = Sha256::new();
    hash.update(key.0);
    hash.update(packet);
    hash.update(stamp);
    filled(hash.finalize())
}

/// Compares in a time that does not tell how much of the signature fits.
fn is_equal(a: [u8; 6], b: [u8; 6]) -> bool {
    a.iter().zip(b).fold(0, |differing, (x, y)| differing | (x ^ y)) == 0
}
