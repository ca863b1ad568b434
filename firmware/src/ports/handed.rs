//! Ports of lockstep and replay: whoever drives hands in a step's time, frame and datagrams, and takes what is sent.

use super::{Clock, FrameSource, Link};
use vigil_types::{Datagrams, DepthFrame, Nanos};

/// A clock that shows what it was last set to.
#[derive(Debug, Clone, Copy, Default)]
pub struct HandedClock(pub Nanos);

impl Clock for HandedClock {
    fn now_ns(&mut self) -> Nanos {
        self.0
    }
}

/// The one frame of a step, if it has one.
#[derive(Debug, Default)]
pub struct HandedFrame<'a> {
    frame: Option<&'a DepthFrame>,
    unauthenticated: bool,
}

impl<'a> HandedFrame<'a> {
    /// A frame of which nothing is known.
    pub fn new(frame: Option<&'a DepthFrame>) -> Self {
        Self::recorded(frame, false)
    }

    /// The frame of a recorded step, and whether that step refused it as not made with the sensor's key.
    pub fn recorded(frame: Option<&'a DepthFrame>, unauthenticated: bool) -> Self {
        Self { frame, unauthenticated }
    }
}

impl FrameSource for HandedFrame<'_> {
    fn newest(&mut self) -> Option<&DepthFrame> {
        self.frame.take()
    }

    fn known_altered(&self) -> bool {
        self.unauthenticated
    }
}

/// The datagrams of a step, on their way in and out.
#[derive(Debug)]
pub struct HandedDatagrams<'a> {
    received: Option<&'a Datagrams>,
    sent: &'a mut Datagrams,
}

impl<'a> HandedDatagrams<'a> {
    /// Gives `received` once; what is sent is appended to `sent`.
    pub fn new(received: &'a Datagrams, sent: &'a mut Datagrams) -> Self {
        Self {
            received: Some(received),
            sent,
        }
    }
}

impl Link for HandedDatagrams<'_> {
    fn receive(&mut self, _now_ns: Nanos, received: &mut Datagrams) {
        for (link, datagram) in self.received.take().iter().flat_map(|r| r.iter()) {
            received.push(link, datagram);
        }
    }

    fn send(&mut self, sent: &Datagrams) {
        for (link, datagram) in sent.iter() {
            self.sent.push(link, datagram);
        }
    }
}
