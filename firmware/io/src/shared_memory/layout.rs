//! Layouts of what crosses between processes in lockstep.

use super::frames::ShmFrame;
use iceoryx2::prelude::ZeroCopySend;
use vigil_types::{Datagrams, DepthFrame};

/// [`Datagrams`] with a fixed layout.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct WireDatagrams {
    count: u32,
    /// End offset of each datagram.
    ends: [u32; Datagrams::MAX_COUNT],
    links: [u8; Datagrams::MAX_COUNT],
    bytes: [u8; Datagrams::CAPACITY],
}

impl WireDatagrams {
    pub(crate) const EMPTY: Self = Self {
        count: 0,
        ends: [0; Datagrams::MAX_COUNT],
        links: [0; Datagrams::MAX_COUNT],
        bytes: [0; Datagrams::CAPACITY],
    };

    pub(crate) fn fill(&mut self, datagrams: &Datagrams) {
        self.count = 0;
        let mut start = 0;
        for ((link, bytes), (end, link_slot)) in datagrams.iter().zip(self.ends.iter_mut().zip(&mut self.links)) {
            let stop = start + bytes.len();
            let Some(slot) = self.bytes.get_mut(start..stop) else {
                return;
            };
            slot.copy_from_slice(bytes);
            // At most CAPACITY, which is far below 2³².
            *end = stop as u32;
            *link_slot = link;
            self.count += 1;
            start = stop;
        }
    }

    /// Copies into `datagrams`; `false` when the other side wrote something impossible.
    pub(crate) fn read_into(&self, datagrams: &mut Datagrams) -> bool {
        datagrams.clear();
        let count = self.count as usize;
        let mut start = 0;
        count <= Datagrams::MAX_COUNT
            && self.ends.iter().zip(&self.links).take(count).all(|(end, link)| {
                let bytes = self.bytes.get(start..*end as usize);
                start = *end as usize;
                bytes.is_some_and(|bytes| datagrams.push(*link, bytes))
            })
    }
}

#[derive(Debug)]
#[repr(C)]
pub(crate) struct WireRequest {
    pub(crate) step: u64,
    pub(crate) now_ns: u64,
    /// 1 when no more steps come; what else is here means nothing then.
    pub(crate) finishes: u32,
    /// 1 when `frame` is new in this step.
    pub(crate) has_frame: u32,
    pub(crate) received: WireDatagrams,
    pub(crate) frame: DepthFrame,
}

#[derive(Debug)]
#[repr(C)]
pub(crate) struct WireResponse {
    pub(crate) step: u64,
    pub(crate) sent: WireDatagrams,
}

// SAFETY: both are `repr(C)` plain data without pointers or invalid bit patterns (the frame: see `ShmFrame`).
unsafe impl ZeroCopySend for WireRequest {
    unsafe fn type_name() -> &'static str {
        "vigil_lockstep_request_v2"
    }
}
// SAFETY: as above.
unsafe impl ZeroCopySend for WireResponse {
    unsafe fn type_name() -> &'static str {
        "vigil_lockstep_response_v1"
    }
}

const _: () = assert!(size_of::<ShmFrame>() == size_of::<DepthFrame>());

#[cfg(test)]
mod tests {
    use super::*;

    /// What crosses, and what it is read into.
    fn crossed(sent: &Datagrams) -> (Box<WireDatagrams>, Datagrams) {
        let (mut wire, mut received) = (Box::new(WireDatagrams::EMPTY), Datagrams::default());
        wire.fill(sent);
        assert!(wire.read_into(&mut received));
        assert_eq!(received, *sent);
        (wire, received)
    }

    #[test]
    fn datagrams_cross_unchanged_and_lies_are_refused() {
        let mut sent = Datagrams::default();
        assert!(sent.push(0, b"heartbeat") && sent.push(2, b"") && sent.push(1, &[7; 2000]));
        let (mut wire, mut received) = crossed(&sent);
        wire.ends[1] = Datagrams::CAPACITY as u32 + 1;
        assert!(!wire.read_into(&mut received));
        wire.ends[1] = 3;
        assert!(!wire.read_into(&mut received), "an end before its start");
        wire.count = u32::MAX;
        assert!(!wire.read_into(&mut received));
    }

    #[test]
    fn a_full_set_of_datagrams_crosses() {
        let mut sent = Datagrams::default();
        for i in 0..Datagrams::MAX_COUNT {
            assert!(sent.push(i as u8, &[i as u8; Datagrams::CAPACITY / Datagrams::MAX_COUNT]));
        }
        crossed(&sent);
    }
}
