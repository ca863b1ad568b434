//! One step over the ports, the same live, in lockstep and in replay: receive, tick, send, record.

use crate::config::FirmwareConfig;
use crate::pilots::Pilots;
pub use crate::pilots::StackError;
use crate::ports::{Clock, FrameSource, Link};
use crate::stack::{FlightStack, TickInput, TickOutput};
use crate::stack_config::StackConfig;
use vigil_guidance::ConfigError;
use vigil_log::Recorder;
use vigil_policy::GeometricPilot;
use vigil_policy::actor::Actor;
use vigil_types::{Datagrams, DepthFrame, FrameKeys, Nanos, StepReport, StepTiming};

/// The flight stack with its buffers and its log. Allocates nothing after it was made.
pub struct Firmware {
    pub(crate) stack: Box<FlightStack>,
    received: Box<Datagrams>,
    output: Box<TickOutput>,
    recorder: Option<Recorder>,
}

impl Firmware {
    /// A stack that has flown nothing yet.
    ///
    /// # Errors
    /// A guidance configuration that must not fly.
    pub fn new(config: &StackConfig) -> Result<Self, ConfigError> {
        Ok(Self::flying(FlightStack::new(config)?))
    }

    /// A stack with the pilots of a configuration.
    ///
    /// # Errors
    /// [`StackError`]: a guidance configuration that must not fly, an actor or a detector that is refused.
    pub fn of(config: &FirmwareConfig) -> Result<Self, StackError> {
        let stack = FlightStack::with_pilots(&config.stack(), Pilots::of(config)?)?;
        Ok(Self::flying(stack))
    }

    fn flying(stack: Box<FlightStack>) -> Self {
        Self {
            stack,
            received: Box::default(),
            output: Box::default(),
            recorder: None,
        }
    }

    /// Keeps a log of all steps from now on.
    pub fn record(&mut self, recorder: Recorder) {
        self.recorder = Some(recorder);
    }

    /// One step. Never waits, unless the recorder was asked to ([`vigil_log::WhenFull::Wait`]).
    pub fn step(
        &mut self,
        timing: StepTiming,
        clock: &mut impl Clock,
        frames: &mut impl FrameSource,
        link: &mut impl Link,
    ) -> &StepReport {
        let now_ns = clock.now_ns();
        self.received.clear();
        link.receive(now_ns, &mut self.received);
        let frame_known_altered = frames.known_altered();
        let frame = frames.newest();
        let input = TickInput {
            now_ns,
            timing,
            frame,
            frame_known_altered,
            received: &self.received,
        };
        self.stack.tick(&input, &mut self.output);
        link.send(&self.output.sent);
        if let Some(recorder) = &mut self.recorder {
            let output = &self.output;
            // A full recorder counts the record as dropped.
            recorder.record(|record| {
                record.fill(now_ns, timing, frame, input.received, &output.sent, &output.report);
            });
        }
        &self.output.report
    }

    /// From now on takes only frames that were made with one of these keys, if there are any.
    pub fn require_frame_keys(&mut self, keys: FrameKeys) {
        self.stack.require_frame_keys(keys);
    }

    /// Sends the last packets before the firmware ends. They belong to no step and are not in the log.
    pub fn shut_down(&mut self, now_ns: Nanos, link: &mut impl Link) {
        self.stack.shut_down(now_ns, &mut self.output.sent);
        link.send(&self.output.sent);
    }

    /// The pilot that keeps a map and plans a way ([`FlightStack::mapping`]).
    pub fn mapping(&self) -> Option<&GeometricPilot> {
        self.stack.mapping()
    }

    /// The actor and the frame that it decided on ([`FlightStack::actor`]).
    pub fn actor(&self) -> Option<(&Actor, &DepthFrame)> {
        self.stack.actor()
    }

    /// Closes the log, if there is one, and says what became of it.
    pub fn finish(self) -> Option<vigil_log::Summary> {
        self.recorder.map(Recorder::finish)
    }
}
