//! The firmware driven step by step by a simulator: in the same process by a call, in another through shared memory.

use crate::config::FirmwareConfig;
use crate::stack::TickInput;
use crate::step::Firmware;
use std::time::Duration;
use vigil_io::shared_memory::{Domain, LockstepError, LockstepServer, Served};
use vigil_log::Recorder;
use vigil_types::{Datagrams, DepthFrame, FrameKeys, Nanos, StepReport, StepTiming};

/// The firmware in the simulator's own process.
pub struct LockstepFirmware {
    firmware: Firmware,
    steps: u64,
}

impl LockstepFirmware {
    /// A firmware without a log.
    ///
    /// # Errors
    /// A configuration that must not fly, an actor that is refused.
    pub fn new(config: &FirmwareConfig) -> anyhow::Result<Self> {
        Ok(Self {
            firmware: Firmware::of(config)?,
            steps: 0,
        })
    }

    /// Keeps a log of all steps from now on ([`vigil_log::WhenFull::Wait`] loses no record).
    pub fn record(&mut self, recorder: Recorder) {
        self.firmware.record(recorder);
    }

    /// One step at simulated time `now_ns` with the frame that is new in it and what the links received since the last
    /// step. Overwrites `sent` and returns the report.
    pub fn step(
        &mut self,
        now_ns: Nanos,
        frame: Option<&DepthFrame>,
        received: &Datagrams,
        sent: &mut Datagrams,
    ) -> &StepReport {
        let input = TickInput {
            now_ns,
            timing: StepTiming::of_step(self.steps),
            frame,
            frame_known_altered: false,
            received,
        };
        self.steps += 1;
        self.firmware.step(&input, |output| _ = sent.copy_from(output))
    }

    /// From now on takes only frames that were made with one of these keys, if there are any.
    pub fn require_frame_keys(&mut self, keys: FrameKeys) {
        self.firmware.stack.require_frame_keys(keys);
    }

    /// Steps taken.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Closes the log, if there is one, and says what became of it.
    pub fn finish(self) -> Option<vigil_log::Summary> {
        self.firmware.finish()
    }
}

/// Answers a simulator in another process until it says that the flight is over or `cancelled` does; shows each step's
/// report to `observe`.
///
/// # Errors
/// [`LockstepError`], also when no step comes within `timeout`.
pub fn serve(
    firmware: &mut LockstepFirmware,
    domain: &Domain,
    timeout: Duration,
    cancelled: impl Fn() -> bool,
    mut observe: impl FnMut(&StepReport),
) -> Result<(), LockstepError> {
    let mut server = LockstepServer::create(domain)?;
    let mut sent = Box::<Datagrams>::default();
    loop {
        let (firmware, sent, observe) = (&mut *firmware, &mut *sent, &mut observe);
        let served = server.serve(timeout, &cancelled, move |request| {
            observe(firmware.step(request.now_ns, request.frame, request.received, sent));
            sent
        })?;
        if served != Served::Step || cancelled() {
            return Ok(());
        }
    }
}
