//! What the flight stack touches of the outside: a clock, frames, a link. The same step runs over each implementation:
//! [`live`], [`router`] and [`links`] (monotonic clock, shared memory, MAVLink over UDP, TCP or serial lines), [`handed`]
//! (lockstep and replay: whoever drives hands everything in).

pub mod handed;
pub mod live;

pub use vigil_io::{Link, gate, links, router};
use vigil_types::{DepthFrame, Nanos};

/// Time of the flight.
pub trait Clock {
    /// Now. Never less than before.
    fn now_ns(&mut self) -> Nanos;
}

/// Where depth frames come from.
pub trait FrameSource {
    /// The newest frame that was not given before, unchecked; older ones are skipped. Never waits.
    fn newest(&mut self) -> Option<&DepthFrame>;

    /// Whether that frame is known to have been refused as unauthenticated: of a log, whose reader has no key.
    fn known_altered(&self) -> bool {
        false
    }
}
