//! The heartbeat protocol. <https://mavlink.io/en/services/heartbeat.html>

use crate::core::{Core, Periodic};
use crate::report;
use crate::service::{Service, Step};
use vigil_types::{Datagrams, Nanos};

const HEARTBEAT_NS: Nanos = 1_000_000_000;

#[derive(Debug, Clone, Default)]
pub(crate) struct HeartbeatService {
    due: Periodic,
}

impl Service for HeartbeatService {
    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let report = step.report;
        if self.due.is_due(report.now_ns, HEARTBEAT_NS) {
            core.say(out, &report::heartbeat(report::mav_state(report.state, report.reasons)));
        }
    }
}
