//! What the flight stack touches of the outside: a clock, frames, a link. The same step runs over each implementation:
//! [`live`] and [`links`] (monotonic clock, shared memory, MAVLink over UDP, TCP or a serial line), [`handed`] (lockstep
//! and replay: whoever drives hands everything in).

pub mod gate;
pub mod handed;
pub mod links;
pub mod live;

use vigil_types::{Datagrams, DepthFrame, Nanos};

/// Time of the flight.
pub trait Clock {
    /// Now. Never less than before.
    fn now_ns(&mut self) -> Nanos;
}

/// Where depth frames come from.
pub trait FrameSource {
    /// The newest frame that was not given before, unchecked; older ones are skipped. Never waits.
    fn newest(&mut self) -> Option<&DepthFrame>;
}

/// Where datagrams come from and go to.
pub trait Link {
    /// Appends what arrived since the last call, in order of arrival. Never waits. What does not fit stays for the
    /// next call.
    fn receive(&mut self, now_ns: Nanos, received: &mut Datagrams);

    /// Sends the datagrams, in order. Never waits; what cannot be sent is lost, as on any radio link.
    fn send(&mut self, sent: &Datagrams);
}
