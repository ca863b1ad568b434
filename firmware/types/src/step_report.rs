//! What goes into one step of the loop and comes out of it, as plain data: the log and replay see the same.

use crate::{
    Action, Alarm, Goal, GoalRelative, GuidanceState, Judgement, Nanos, Reasons, VehicleTelemetry, VelocitySetpoint,
};

/// What the loop measured of its own earlier steps. An input of the tick, so that replay gives the same telemetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StepTiming {
    /// Counts steps from 0.
    pub step: u64,
    /// How long the previous tick took; 0 in lockstep.
    pub previous_execution_ns: u64,
    /// How late this step began against its deadline; 0 in lockstep.
    pub wake_late_ns: u64,
    /// Steps missed since start.
    pub slips: u64,
}

impl StepTiming {
    /// Of a step with this number, of which nothing else is known.
    pub fn of_step(step: u64) -> Self {
        Self {
            step,
            ..Self::default()
        }
    }
}

/// Datagrams of one step, in order, each with the link it belongs to; fixed capacity, no allocation. Plain data with a fixed layout: it
/// crosses shared memory, and whatever another process wrote there can be read.
#[derive(Clone)]
#[repr(C)]
pub struct Datagrams {
    dropped: u64,
    count: u32,
    /// End offset of each datagram.
    ends: [u16; Self::MAX_COUNT],
    links: [u8; Self::MAX_COUNT],
    bytes: [u8; Self::CAPACITY],
}

impl Default for Datagrams {
    fn default() -> Self {
        Self {
            dropped: 0,
            count: 0,
            ends: [0; Self::MAX_COUNT],
            links: [0; Self::MAX_COUNT],
            bytes: [0; Self::CAPACITY],
        }
    }
}

impl core::fmt::Debug for Datagrams {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_list()
            .entries(self.iter().map(|(link, bytes)| (link, bytes.len())))
            .finish()
    }
}

impl PartialEq for Datagrams {
    fn eq(&self, other: &Self) -> bool {
        self.iter().eq(other.iter())
    }
}

impl Datagrams {
    /// Bytes that fit in one step.
    pub const CAPACITY: usize = 32 * 1024;
    /// Datagrams that fit in one step.
    pub const MAX_COUNT: usize = 256;

    /// Takes over what another holds; `false` with fewer than it counts, where that contradicts itself. Copies only the bytes in use: a
    /// whole buffer is ten times a usual step's traffic.
    pub fn copy_from(&mut self, from: &Self) -> bool {
        self.clear();
        for (link, bytes) in from.iter() {
            self.push(link, bytes);
        }
        self.len() == from.len()
    }

    /// Empties the buffer; the drop counter goes on.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Where the datagrams before this many from the end do.
    fn end_before(&self, last: usize) -> usize {
        let place = self.len().checked_sub(last + 1);
        place.and_then(|i| self.ends.get(i)).map_or(0, |end| usize::from(*end))
    }

    /// Appends a datagram of `link`. When it does not fit, it is dropped and counted: the return value is `false`.
    pub fn push(&mut self, link: u8, datagram: &[u8]) -> bool {
        let (start, at) = (self.end_before(0), self.len());
        let stop = start + datagram.len();
        let slots = (
            self.bytes.get_mut(start..stop),
            self.ends.get_mut(at),
            self.links.get_mut(at),
        );
        let (Some(bytes), Some(end), Some(of)) = slots else {
            self.dropped += 1;
            return false;
        };
        bytes.copy_from_slice(datagram);
        // CAPACITY fits u16: `stop` is at most 32 768.
        (*end, *of) = (stop as u16, link);
        self.count += 1;
        true
    }

    /// The datagrams with their link, in order.
    pub fn iter(&self) -> impl Iterator<Item = (u8, &[u8])> {
        let mut start = 0;
        let each = self.ends.iter().zip(&self.links).take(self.len());
        each.filter_map(move |(end, link)| {
            let range = start..usize::from(*end);
            start = range.end;
            self.bytes.get(range).map(|b| (*link, b))
        })
    }

    /// The datagram that was appended last.
    pub fn last(&self) -> Option<&[u8]> {
        let range = self.end_before(1)..self.end_before(0);
        self.bytes.get(range).filter(|_| self.count > 0)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of datagrams.
    pub fn len(&self) -> usize {
        self.count as usize
    }

    /// Bytes that still fit.
    pub fn free_bytes(&self) -> usize {
        Self::CAPACITY - self.end_before(0)
    }

    /// Datagrams dropped since start because a step held too many.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

/// What one step decided: for log, telemetry and display.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepReport {
    /// Time of the step.
    pub now_ns: Nanos,
    /// Timing inputs of this step.
    pub timing: StepTiming,
    /// Guidance state after the step.
    pub state: GuidanceState,
    /// Conditions present in this step.
    pub reasons: Reasons,
    /// What the vehicle last reported.
    pub telemetry: VehicleTelemetry,
    /// Goal in force.
    pub goal: Option<Goal>,
    /// Goal as the pilot saw it.
    pub goal_relative: Option<GoalRelative>,
    /// The flying pilot's action, if it was asked in this step: the recovery pilot's during a recovery.
    pub action: Option<Action>,
    /// What the detector says of the actor's decision; `None` without a detector, or when the actor was not asked.
    pub judgement: Option<Judgement>,
    /// The alarm, while it is raised.
    pub alarm: Option<Alarm>,
    /// The setpoint sent, if one was.
    pub setpoint: Option<VelocitySetpoint>,
    /// Sequence of the frame that was used, if any.
    pub frame_sequence: Option<u64>,
    /// Age of the newest valid frame.
    pub frame_age_ns: Option<Nanos>,
    /// Frames refused since start.
    pub frames_refused: u64,
}

impl StepReport {
    /// Whether the vehicle flies by the setpoints that it is sent, as far as its newest heartbeat shows.
    pub fn has_vehicle(&self) -> bool {
        let obeys = |h: crate::Heartbeat| h.armed && h.mode == crate::VehicleMode::External;
        self.setpoint.is_some() && self.telemetry.heartbeat.is_some_and(obeys)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datagrams_keep_order_link_and_bytes() {
        let mut d = Datagrams::default();
        assert!(d.push(0, b"abc") && d.push(2, b"") && d.push(1, b"xy"));
        assert!(d.iter().eq([(0, &b"abc"[..]), (2, &b""[..]), (1, &b"xy"[..])]));
        d.clear();
        assert!(d.is_empty() && d.iter().next().is_none());
    }

    #[test]
    fn what_another_process_wrote_is_copied_and_of_lies_only_what_can_be() {
        let (mut sent, mut received) = (Datagrams::default(), Datagrams::default());
        assert!(sent.push(0, b"heartbeat") && sent.push(2, b"") && sent.push(1, &[7; 2000]));
        assert!(received.copy_from(&sent));
        assert_eq!(received, sent);
        // Beyond the end, before its start, and more than there can be.
        for (end, count) in [(Datagrams::CAPACITY as u16 + 1, 3), (3, 3), (9, 257), (9, u32::MAX)] {
            (sent.ends[1], sent.count) = (end, count);
            assert!(!received.copy_from(&sent), "{end} {count}");
        }
    }

    #[test]
    fn a_full_buffer_drops_and_counts() {
        let mut d = Datagrams::default();
        let big = [7u8; 2048];
        for _ in 0..16 {
            assert!(d.push(0, &big));
        }
        assert!(!d.push(0, b"x"));
        assert_eq!((d.len(), d.dropped()), (16, 1));
        assert_eq!(d.free_bytes(), 0);
        d.clear();
        assert_eq!(d.free_bytes(), Datagrams::CAPACITY);
        for _ in 0..Datagrams::MAX_COUNT {
            assert!(d.push(3, b"1"));
        }
        assert!(!d.push(3, b"1"));
        assert_eq!(d.iter().count(), Datagrams::MAX_COUNT);
    }
}
