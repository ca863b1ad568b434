//! The heartbeat protocol. <https://mavlink.io/en/services/heartbeat.html>

use super::{Service, Step};
use crate::core::{Core, Periodic};
use crate::report;
use mavlink::dialects::common::MavType;
use vigil_types::{Datagrams, Nanos, STEP_NS};

const HEARTBEAT_NS: Nanos = 1_000_000_000;
const COMPUTER_NS: Nanos = 5_000_000_000;
/// Slices of 100 ms in ONBOARD_COMPUTER_STATUS, and steps in each.
const SLICES: usize = 10;
const STEPS: usize = 2;

/// HEARTBEAT, and ONBOARD_COMPUTER_STATUS with how much of each tenth of the last second the steps took.
#[derive(Debug, Clone, Default)]
pub(crate) struct HeartbeatService {
    due: Periodic,
    computer_due: Periodic,
    /// Execution times of the last steps, newest first.
    steps_ns: [Nanos; SLICES * STEPS],
}

impl HeartbeatService {
    /// Percent of each slice, oldest first.
    fn busy_percent(&self) -> [u8; SLICES] {
        let mut percent = [0; SLICES];
        for (percent, steps_ns) in percent.iter_mut().rev().zip(self.steps_ns.chunks(STEPS)) {
            let busy_ns = steps_ns.iter().fold(0, |sum: Nanos, ns| sum.saturating_add(*ns));
            *percent = (busy_ns.saturating_mul(100) / (STEPS as Nanos * STEP_NS)).min(100) as u8;
        }
        percent
    }
}

impl Service for HeartbeatService {
    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let report = step.report;
        self.steps_ns.rotate_right(1);
        if let Some(newest) = self.steps_ns.first_mut() {
            *newest = report.timing.previous_execution_ns;
        }
        if self.due.is_due(report.now_ns, HEARTBEAT_NS) {
            let state = report::mav_state(report.state, report.reasons);
            core.say(out, &report::heartbeat(MavType::MAV_TYPE_ONBOARD_CONTROLLER, state));
        }
        if self.computer_due.is_due(report.now_ns, COMPUTER_NS) {
            core.say(out, &report::onboard_computer(report.now_ns, self.busy_percent()));
        }
    }
}
