//! Framing of a byte stream (TCP, serial), where packets are split across reads.

use crate::framing::packet::{FramingCounters, Packet, Scanner};

/// Bytes held: at least two of the largest packets, so that there is always room behind an incomplete one.
const CAPACITY: usize = 1024;

/// Finds packets in a stream of bytes; fixed memory.
#[derive(Debug, Clone)]
pub struct StreamFramer {
    buffer: [u8; CAPACITY],
    filled: usize,
    scanner: Scanner,
}

impl Default for StreamFramer {
    fn default() -> Self {
        Self {
            buffer: [0; CAPACITY],
            filled: 0,
            scanner: Scanner::default(),
        }
    }
}

impl StreamFramer {
    /// Takes the next bytes of the stream and hands out every packet that they complete. A packet that was cut by the end
    /// of `bytes` is kept for the next call.
    pub fn feed(&mut self, bytes: &[u8], counters: &mut FramingCounters, mut on_packet: impl FnMut(&Packet<'_>)) {
        let mut rest = bytes;
        loop {
            let room = CAPACITY - self.filled;
            let (now, later) = rest.split_at(rest.len().min(room));
            if let Some(slot) = self.buffer.get_mut(self.filled..self.filled + now.len()) {
                slot.copy_from_slice(now);
                self.filled += now.len();
            }
            rest = later;
            let data = self.buffer.get(..self.filled).unwrap_or_default();
            while let Some(packet) = self.scanner.next(data, false, counters) {
                on_packet(&packet);
            }
            let done = self.scanner.at.min(self.filled);
            self.buffer.copy_within(done..self.filled, 0);
            self.filled -= done;
            self.scanner.shift(done);
            if rest.is_empty() {
                return;
            }
        }
    }
}
