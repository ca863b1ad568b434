//! What the loop hands to the log each step.

use vigil_types::{Datagrams, DepthFrame, Nanos, StepReport, StepTiming};

/// All inputs and outputs of one step: enough to run the step again and to compare every byte.
///
/// A record is large (about 200 kB) and lives in a box that circulates between the loop and the recorder; it is filled
/// in place.
#[derive(Debug, Clone, PartialEq)]
pub struct TickRecord {
    /// Time of the step, an input.
    pub now_ns: Nanos,
    /// What the loop measured of itself, an input.
    pub timing: StepTiming,
    /// Datagrams that arrived since the last step, an input.
    pub received: Datagrams,
    /// Datagrams that the step sent, an output.
    pub sent: Datagrams,
    /// What the step decided, an output.
    pub report: StepReport,
    /// Records that the recorder had dropped before this one, since start; a replay is exact only up to the first drop.
    pub dropped_before: u64,
    has_frame: bool,
    frame: DepthFrame,
}

impl Default for TickRecord {
    fn default() -> Self {
        Self {
            now_ns: 0,
            timing: StepTiming::default(),
            received: Datagrams::default(),
            sent: Datagrams::default(),
            report: StepReport::default(),
            dropped_before: 0,
            has_frame: false,
            frame: DepthFrame::EMPTY,
        }
    }
}

impl TickRecord {
    /// Fills the record with one step: its inputs (`now_ns`, `timing`, the frame that is new in this step, the
    /// datagrams received) and its outputs (the datagrams sent, the report). Copies; no allocation.
    pub fn fill(
        &mut self,
        now_ns: Nanos,
        timing: StepTiming,
        frame: Option<&DepthFrame>,
        received: &Datagrams,
        sent: &Datagrams,
        report: &StepReport,
    ) {
        self.now_ns = now_ns;
        self.timing = timing;
        self.set_frame(frame);
        self.received.copy_from(received);
        self.sent.copy_from(sent);
        self.report = *report;
    }

    /// The frame that was new in this step, exactly as it arrived (it may be one that the step refused).
    pub fn frame(&self) -> Option<&DepthFrame> {
        self.has_frame.then_some(&self.frame)
    }

    /// Sets the frame that was new in this step. Copies; no allocation.
    pub fn set_frame(&mut self, frame: Option<&DepthFrame>) {
        self.has_frame = frame.is_some();
        if let Some(frame) = frame {
            self.frame.header = frame.header;
            self.frame.depth.copy_from_slice(&frame.depth);
        }
    }

    /// Gives the frame's memory to a reader that fills it in place.
    pub(crate) fn frame_slot(&mut self, has_frame: bool) -> &mut DepthFrame {
        self.has_frame = has_frame;
        &mut self.frame
    }
}
