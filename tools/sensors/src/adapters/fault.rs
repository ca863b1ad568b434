//! What is wrong with a stream, in words, and how often it was.

use std::mem::discriminant;
use vigil_types::Nanos;

/// Why a packet, or a whole picture, did not become a frame.
#[allow(missing_docs, reason = "the texts say what the fields are")]
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Fault {
    /// A datagram is not as long as the device's packets are.
    #[error(
        "a packet of {got} bytes, {expected} expected: truncated, of another device or number of beams, or of another packet format than LEGACY"
    )]
    PacketLength { got: usize, expected: usize },
    /// A packet has the length but not the content.
    #[error(
        "a packet whose column numbers cannot be this device's: is the metadata file that of this sensor in this mode?"
    )]
    PacketContent,
    /// A packet of a turn that is over.
    #[error("a packet that came late: its turn is over")]
    LatePacket,
    /// Columns of the view did not arrive, or the device marked them as bad.
    #[error("a turn without {missing} of the {needed} columns in view: packets were lost, no frame")]
    LostColumns { missing: usize, needed: usize },
    /// The device's clock went back by so many seconds.
    #[error("the device's clock went back by {0:.3} s: no frame until its stamps fit again")]
    ClockBack(f64),
    /// Stamps fell so many seconds farther behind this machine's clock: packets were held up, or the device's clock was set.
    #[error(
        "stamps are {0:.3} s farther behind the arrival than before: packets held up, or the device's clock was set; no frame"
    )]
    ClockBehind(f64),
    /// The stream ended within an image.
    #[error("the stream ended {got} bytes into an image of {expected}: is --size that of the stream?")]
    ImageLength { got: usize, expected: usize },
    /// An image in which nothing returned at all.
    #[error("an image without a single range: a covered lens, a stream that is not depth, or z16's --unit is wrong")]
    EmptyImage,
    /// Nothing came for a while.
    #[error("nothing for {since_s:.1} s: is the device on, and does it send to this address?")]
    Silence { since_s: f64 },
    /// The vehicle's pose at the moment of capture is not known.
    #[error("the vehicle's pose at the moment of capture is not known: is its telemetry heard, position and attitude?")]
    NoPose,
    /// A stamp of the future (its age is negative), of long ago, or not newer than that of the frame before.
    #[error(
        "a stamp that is {age_s:.3} s old, or not newer than that of the frame before: is --latency-ms right? no frame"
    )]
    Stamp { age_s: f64 },
}

/// A fault is reported at once, then at most this often.
const TELL_EVERY_NS: Nanos = 10_000_000_000;

/// Faults by kind: when to tell a person, and the sums at the end.
#[derive(Debug, Default)]
pub struct Tally {
    kinds: Vec<Kind>,
}

#[derive(Debug)]
struct Kind {
    last: Fault,
    count: u64,
    told_ns: Nanos,
    untold: u64,
}

impl Tally {
    /// Counts a fault at `now_ns`; the line to tell, if it is time for one.
    pub fn note(&mut self, now_ns: Nanos, fault: Fault) -> Option<String> {
        let same = |kind: &&mut Kind| discriminant(&kind.last) == discriminant(&fault);
        let Some(kind) = self.kinds.iter_mut().find(same) else {
            self.kinds.push(Kind {
                last: fault,
                count: 1,
                told_ns: now_ns,
                untold: 0,
            });
            return Some(fault.to_string());
        };
        (kind.last, kind.count, kind.untold) = (fault, kind.count + 1, kind.untold + 1);
        if now_ns.saturating_sub(kind.told_ns) < TELL_EVERY_NS {
            return None;
        }
        kind.told_ns = now_ns;
        let untold = std::mem::take(&mut kind.untold);
        Some(format!("{untold} times: {fault}"))
    }

    /// All that went wrong, one line a kind.
    pub fn summary(&self) -> impl Iterator<Item = String> {
        let kinds = self.kinds.iter();
        kinds.map(|kind| format!("{} times: {}", kind.count, kind.last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_reported_at_once_then_every_ten_seconds_with_its_number() {
        let (mut tally, late) = (Tally::default(), Fault::LatePacket);
        let line = tally.note(0, late).expect("at once");
        assert!(line.starts_with("a packet that came late"), "{line}");
        assert_eq!(tally.note(1_000_000_000, late), None);
        assert!(
            tally.note(2_000_000_000, Fault::NoPose).is_some(),
            "another kind is reported at once"
        );
        let line = tally.note(11_000_000_000, late).expect("it is time");
        assert!(line.starts_with("2 times"), "{line}");
        let lines: Vec<String> = tally.summary().collect();
        assert!(lines[0].starts_with("3 times: ") && lines.len() == 2, "{lines:?}");
    }
}
