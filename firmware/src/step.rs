//! One step, the same live, in lockstep and in replay: tick, send, record.

use crate::config::FirmwareConfig;
use crate::pilots::Pilots;
use crate::stack::{FlightStack, TickInput, TickOutput};
use vigil_log::Recorder;
use vigil_policy::GeometricPilot;
use vigil_policy::actor::Actor;
use vigil_types::{Datagrams, DepthFrame, Nanos, StepReport};

/// The flight stack with its buffers and its log. Allocates nothing after it was made.
pub struct Firmware {
    pub(crate) stack: Box<FlightStack>,
    output: Box<TickOutput>,
    recorder: Option<Recorder>,
}

impl Firmware {
    /// A stack with the pilots of a configuration, that has flown nothing yet.
    ///
    /// # Errors
    /// A guidance configuration that must not fly, an actor or a detector that is refused.
    pub fn of(config: &FirmwareConfig) -> anyhow::Result<Self> {
        Ok(Self {
            stack: FlightStack::with_pilots(&config.stack(), Pilots::of(config)?)?,
            output: Box::default(),
            recorder: None,
        })
    }

    /// Keeps a log of all steps from now on.
    pub fn record(&mut self, recorder: Recorder) {
        self.recorder = Some(recorder);
    }

    /// One step, whose datagrams are handed to `send` before the log gets it. Never waits, unless the recorder was asked to
    /// ([`vigil_log::WhenFull::Wait`]).
    pub fn step(&mut self, input: &TickInput<'_>, send: impl FnOnce(&Datagrams)) -> &StepReport {
        self.stack.tick(input, &mut self.output);
        let TickOutput { report, sent } = &*self.output;
        send(sent);
        if let Some(recorder) = &mut self.recorder {
            // A full recorder counts the record as dropped.
            recorder.record(|record| {
                record.fill(input.now_ns, input.timing, input.frame, input.received, sent, report);
            });
        }
        report
    }

    /// Hands the last packets before the firmware ends to `send`. They belong to no step and are not in the log.
    pub fn shut_down(&mut self, now_ns: Nanos, send: impl FnOnce(&Datagrams)) {
        self.stack.shut_down(now_ns, &mut self.output.sent);
        send(&self.output.sent);
    }

    /// The pilot that keeps a map and plans a path: the recovery pilot, else the geometric one; `None` where neither has been asked. For
    /// looking at a flight afterwards ([`crate::replay()`]).
    pub fn mapping(&self) -> Option<&GeometricPilot> {
        self.stack.deciding.mapping()
    }

    /// The actor and the frame that it decided on in the last step; `None` if none did. For looking at a flight afterwards.
    pub fn actor(&self) -> Option<(&Actor, &DepthFrame)> {
        self.stack.deciding.actor().zip(self.stack.frames.newest())
    }

    /// Closes the log, if there is one, and says what became of it.
    pub fn finish(self) -> Option<vigil_log::Summary> {
        self.recorder.map(Recorder::finish)
    }
}
