//! Ports of a real flight: monotonic clock, frames from shared memory. MAVLink is in [`links`](super::links).

use super::{Clock, FrameSource};
use vigil_io::clock;
use vigil_io::shared_memory::{BorrowedFrame, FrameSubscriber};
use vigil_types::{DepthFrame, Nanos};

/// The machine's monotonic clock, which all processes on it share.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now_ns(&mut self) -> Nanos {
        clock::monotonic_ns()
    }
}

impl MonotonicClock {
    /// Sleeps until `deadline_ns`; signals do not shorten it.
    pub fn sleep_until(&self, deadline_ns: Nanos) {
        clock::sleep_until(deadline_ns);
    }
}

/// Frames from the shared-memory service.
pub struct SharedFrames {
    subscriber: FrameSubscriber,
    borrowed: Option<BorrowedFrame>,
    failures: u64,
}

impl SharedFrames {
    /// Reads from `subscriber`.
    pub fn new(subscriber: FrameSubscriber) -> Self {
        Self {
            subscriber,
            borrowed: None,
            failures: 0,
        }
    }

    /// How often the transport failed to receive; each shows as a missing frame.
    pub fn failures(&self) -> u64 {
        self.failures
    }
}

impl FrameSource for SharedFrames {
    fn newest(&mut self) -> Option<&DepthFrame> {
        self.borrowed = None;
        match self.subscriber.newest() {
            Ok(frame) => self.borrowed = frame,
            Err(_) => self.failures += 1,
        }
        self.borrowed.as_deref()
    }
}
