//! A whole flight in lockstep in one process, every step's report kept.

use core::convert::Infallible;
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_sim::lockstep_flight::{FirmwarePort, fly_lockstep};
use vigil_sim::world::Outcome;
use vigil_sim::{SimConfig, Simulator};
use vigil_types::{Datagrams, DepthFrame, Nanos, StepReport};

struct Watched {
    firmware: LockstepFirmware,
    reports: Vec<StepReport>,
}

impl FirmwarePort for Watched {
    type Error = Infallible;

    fn step(
        &mut self,
        _: u64,
        now_ns: Nanos,
        frame: &DepthFrame,
        received: &Datagrams,
        sent: &mut Datagrams,
    ) -> Result<(), Infallible> {
        self.reports
            .push(*self.firmware.step(now_ns, Some(frame), received, sent));
        Ok(())
    }
}

/// Flies a course to its end, with the default firmware but for `change`; how it ended, and every step's report.
pub fn fly_watched(
    simulation: &SimConfig,
    change: impl FnOnce(&mut FirmwareConfig),
) -> (Option<Outcome>, Vec<StepReport>) {
    let mut config = FirmwareConfig::to_goal(simulation.course.goal_ned_m());
    change(&mut config);
    let mut simulator = Simulator::new(simulation, 0).expect("a simulator");
    let mut port = Watched {
        firmware: LockstepFirmware::new(&config).expect("a firmware"),
        reports: Vec::new(),
    };
    let limit_s = f64::from(simulation.course.time_limit_s);
    let Ok(record) = fly_lockstep(&mut simulator, &mut port, limit_s, 0.0);
    (record.outcome, port.reports)
}
