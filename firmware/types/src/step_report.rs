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

/// Datagrams of one step, in order, each with the link it belongs to; fixed capacity, no allocation.
#[derive(Clone)]
pub struct Datagrams {
    bytes: [u8; Self::CAPACITY],
    /// (end offset, link) of each datagram.
    marks: [(u16, u8); Self::MAX_COUNT],
    count: usize,
    dropped: u64,
}

impl Default for Datagrams {
    fn default() -> Self {
        Self {
            bytes: [0; Self::CAPACITY],
            marks: [(0, 0); Self::MAX_COUNT],
            count: 0,
            dropped: 0,
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

    /// Takes over what another holds. Copies only the bytes in use: a whole buffer is ten times a usual step's traffic.
    pub fn copy_from(&mut self, from: &Self) {
        self.clear();
        for (link, bytes) in from.iter() {
            self.push(link, bytes);
        }
    }

    /// Empties the buffer; the drop counter goes on.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    fn used(&self) -> usize {
        self.count
            .checked_sub(1)
            .and_then(|i| self.marks.get(i))
            .map_or(0, |m| usize::from(m.0))
    }

    /// Appends a datagram of `link`. When it does not fit, it is dropped and counted: the return value is `false`.
    pub fn push(&mut self, link: u8, datagram: &[u8]) -> bool {
        let start = self.used();
        let end = start + datagram.len();
        let (Some(slot), Some(mark)) = (self.bytes.get_mut(start..end), self.marks.get_mut(self.count)) else {
            self.dropped += 1;
            return false;
        };
        slot.copy_from_slice(datagram);
        // CAPACITY fits u16: `end` is at most 32 768.
        *mark = (end as u16, link);
        self.count += 1;
        true
    }

    /// The datagrams with their link, in order.
    pub fn iter(&self) -> impl Iterator<Item = (u8, &[u8])> {
        let mut start = 0;
        self.marks.iter().take(self.count).filter_map(move |&(end, link)| {
            let range = start..usize::from(end);
            start = usize::from(end);
            self.bytes.get(range).map(|b| (link, b))
        })
    }

    /// The datagram that was appended last.
    pub fn last(&self) -> Option<&[u8]> {
        let before = self.count.checked_sub(2).and_then(|i| self.marks.get(i));
        let start = before.map_or(0, |mark| usize::from(mark.0));
        self.bytes.get(start..self.used()).filter(|_| self.count > 0)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of datagrams.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Bytes that still fit.
    pub fn free_bytes(&self) -> usize {
        Self::CAPACITY - self.used()
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
