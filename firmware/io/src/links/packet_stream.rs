//! MAVLink over a byte stream: packets are found in what is read, and never torn by what is written.

use super::{LinkAdmission, LinkStatistics, PeerRule};
use crate::gate::SigningGate;
use std::io::{ErrorKind, Read, Write};
use vigil_mavlink::framing::{FramingCounters, Packet, StreamFramer};
use vigil_types::Datagrams;

/// Bytes read at once. The packets that one read can complete must fit in what [`MIN_FREE_COUNT`] and [`MIN_FREE_BYTES`]
/// leave: a packet has at least 8 bytes, and fewer than 300 were held back.
const CHUNK: usize = 512;
const MIN_FREE_COUNT: usize = (CHUNK + 300) / 8 + 1;
const MIN_FREE_BYTES: usize = CHUNK + 300;
/// Reads in one step at most; bounds the step.
const MAX_READS_PER_STEP: usize = 64;
/// The same of somebody who is not the peer.
const MAX_READS_OF_A_CALLER: usize = 4;
/// Bytes that may wait to be written: some steps' worth. What is older is of no use to the vehicle.
const OUTBOX: usize = 8192;

/// The stream is no more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Broken;

/// The state of a byte stream, whatever carries it.
pub(super) struct PacketStream {
    chunk: Box<[u8; CHUNK]>,
    outbox: Box<[u8; OUTBOX]>,
    /// What waits to be written is `outbox[written..queued]`.
    written: usize,
    queued: usize,
    /// Of the link.
    pub statistics: LinkStatistics,
}

impl PacketStream {
    pub fn new() -> Self {
        Self {
            chunk: Box::new([0; CHUNK]),
            outbox: Box::new([0; OUTBOX]),
            written: 0,
            queued: 0,
            statistics: LinkStatistics::default(),
        }
    }

    /// Another stream begins, and is counted: halves of packets are worth nothing to it.
    pub fn begin(&mut self) {
        self.written = 0;
        self.queued = 0;
        self.statistics.connections += 1;
    }

    /// Reads what is there; each packet that passes the gate becomes a datagram. Returns whether one did that keeps the peer
    /// from being taken for silent.
    pub fn receive(
        &mut self,
        wire: &mut impl Read,
        framer: &mut StreamFramer,
        (rule, admission, is_local): (PeerRule, &mut LinkAdmission<'_>, bool),
        received: &mut Datagrams,
    ) -> Result<bool, Broken> {
        let mut heard = false;
        let mut on_packet = |packet: &Packet<'_>, received: &mut Datagrams| {
            heard |= admission.admit(is_local, packet.raw(), received) && rule.is_heard_by(packet);
        };
        let chunk = self.chunk.as_mut_slice();
        for _ in 0..MAX_READS_PER_STEP {
            let Some(bytes) = read(wire, chunk, received)? else {
                break;
            };
            let counters = &mut self.statistics.framing;
            framer.feed(bytes, counters, |packet| on_packet(packet, received));
        }
        Ok(heard)
    }

    /// Reads what somebody sends who is not the peer yet, with a framing of his own, until he shows that he may be: from
    /// then on packets become datagrams as the peer's do. Returns whether he did.
    pub fn receive_introduction(
        &mut self,
        wire: &mut impl Read,
        (framer, garbage): (&mut StreamFramer, &mut FramingCounters),
        (rule, admission, is_local): (PeerRule, &mut LinkAdmission<'_>, bool),
        received: &mut Datagrams,
    ) -> Result<bool, Broken> {
        let mut introduced = false;
        let has_key = admission.gate.has_key();
        for _ in 0..MAX_READS_OF_A_CALLER {
            let Some(bytes) = read(wire, self.chunk.as_mut_slice(), received)? else {
                break;
            };
            framer.feed(bytes, garbage, |packet| {
                if introduced || rule.introduces(packet, has_key) {
                    introduced |= admission.admit(is_local, packet.raw(), received);
                } else {
                    let other_system = &mut self.statistics.other_system;
                    *other_system = rule.other_system(packet).or(*other_system);
                }
            });
            if introduced {
                break;
            }
        }
        Ok(introduced)
    }

    /// Queues the packets, as many as fit, and writes what the stream takes.
    pub fn send(&mut self, wire: &mut impl Write, gate: &mut SigningGate, sent: &Datagrams) -> Result<(), Broken> {
        self.flush(wire)?;
        for (_, datagram) in sent.iter() {
            let packet = gate.seal(datagram);
            match self.outbox.get_mut(self.queued..self.queued + packet.len()) {
                Some(slot) => {
                    slot.copy_from_slice(packet);
                    self.queued += packet.len();
                }
                None => self.statistics.unsent += 1,
            }
        }
        self.flush(wire)
    }

    /// Nobody is there to send to.
    pub fn discard(&mut self, sent: &Datagrams) {
        self.statistics.unsent += sent.len() as u64;
    }

    fn flush(&mut self, wire: &mut impl Write) -> Result<(), Broken> {
        while self.written < self.queued {
            let waiting = self.outbox.get(self.written..self.queued).unwrap_or_default();
            match wire.write(waiting) {
                Ok(0) => return Err(Broken),
                Ok(len) => self.written += len,
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => return Err(Broken),
            }
        }
        self.outbox.copy_within(self.written..self.queued, 0);
        self.queued -= self.written;
        self.written = 0;
        Ok(())
    }
}

/// Reads once; `None` when nothing is there or there is no room for what it may hold.
fn read<'a>(wire: &mut impl Read, chunk: &'a mut [u8], received: &Datagrams) -> Result<Option<&'a [u8]>, Broken> {
    loop {
        if Datagrams::MAX_COUNT - received.len() < MIN_FREE_COUNT || received.free_bytes() < MIN_FREE_BYTES {
            return Ok(None);
        }
        match wire.read(chunk) {
            Ok(0) => return Err(Broken),
            Ok(len) => return Ok(chunk.get(..len)),
            Err(e) if e.kind() == ErrorKind::WouldBlock => return Ok(None),
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(_) => return Err(Broken),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use vigil_mavlink::framing::encode;
    use vigil_mavlink::message;

    fn packet(sequence: u8) -> Vec<u8> {
        let message = message!(STATUSTEXT, text = "of some length".into());
        encode((1, 1), sequence, &message)
    }

    /// A line that delivers in portions.
    struct Line {
        to_read: Vec<u8>,
        portion: usize,
    }

    impl Read for Line {
        fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
            let len = out.len().min(self.portion).min(self.to_read.len());
            if len == 0 {
                return Err(ErrorKind::WouldBlock.into());
            }
            out[..len].copy_from_slice(&self.to_read[..len]);
            self.to_read.drain(..len);
            Ok(len)
        }
    }

    /// Takes what is there; says whether the peer was heard.
    fn receive((stream, framer): &mut (PacketStream, StreamFramer), line: &mut Line, received: &mut Datagrams) -> bool {
        let mut gate = SigningGate::open();
        let mut admission = LinkAdmission {
            allow_unsigned: gate.allow_unsigned(),
            gate: &mut gate,
            link: 0,
        };
        let from = (PeerRule::Anyone, &mut admission, true);
        stream.receive(line, framer, from, received).unwrap()
    }

    #[test]
    fn packets_that_arrive_byte_by_byte_among_garbage_are_given_whole_once_and_in_order() {
        let mut stream = (PacketStream::new(), StreamFramer::default());
        let expected: Vec<_> = (0..40).map(packet).collect();
        let noisy = expected.iter().flat_map(|p| [p.as_slice(), b"noise"].concat());
        let (to_read, portion) = (noisy.collect(), 1);
        let mut line = Line { to_read, portion };
        let (mut got, mut received) = (Vec::new(), Datagrams::default());
        while receive(&mut stream, &mut line, &mut received) || !line.to_read.is_empty() {
            got.extend(received.iter().map(|(_, d)| d.to_vec()));
            received.clear();
        }
        assert_eq!(got, expected);
        assert_eq!(stream.0.statistics.framing.garbage_bytes, 40 * 5);
    }

    #[test]
    fn a_flood_of_the_smallest_packets_fits_step_by_step_and_none_is_lost() {
        let mut stream = (PacketStream::new(), StreamFramer::default());
        // An empty packet of MAVLink 1, of a message that the dialect does not know: 8 bytes.
        let (to_read, portion) = ([0xFE, 0, 0, 1, 1, 200, 0, 0].repeat(2000), usize::MAX);
        let mut line = Line { to_read, portion };
        let (mut count, mut steps) = (0, 0);
        while !line.to_read.is_empty() {
            let mut received = Datagrams::default();
            receive(&mut stream, &mut line, &mut received);
            assert_eq!(received.dropped(), 0);
            count += received.len();
            steps += 1;
        }
        assert!(steps > 1);
        assert_eq!(count, 2000);
    }
}
