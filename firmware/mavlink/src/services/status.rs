//! What guidance is doing: NAMED_VALUE_FLOATs and STATUSTEXTs on changes.

use crate::companion::CompanionConfig;
use crate::core::{Core, Periodic};
use crate::report;
use crate::service::{Service, Step};
use vigil_types::{Alarm, Datagrams, GuidanceState, Nanos, Reason, Reasons, Verdict};

/// How often values are told, four times a second.
pub(super) const VALUES_NS: Nanos = 250_000_000;

#[derive(Debug, Clone)]
pub(crate) struct StatusService {
    values: Periodic,
    said_verdict: Option<Verdict>,
    said_alarm: Option<Alarm>,
    pilot_said: bool,
}

impl StatusService {
    pub fn new(_: &CompanionConfig) -> Self {
        Self {
            values: Periodic::new(VALUES_NS),
            said_verdict: None,
            said_alarm: None,
            pilot_said: false,
        }
    }
}

impl Service for StatusService {
    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let report = step.report;
        let now = (report.state, report.reasons);
        let before = core.said.replace(now);
        let (state_before, reasons_before) = (before.map(|b| b.0), before.map_or(Reasons::NONE, |b| b.1));
        let due = self.values.is_due(report.now_ns);
        if due || before != Some(now) {
            for message in report::state_values(report, reasons_before) {
                core.say(out, &message);
            }
        }
        let interval_ns = core.telemetry_interval_ns;
        if due {
            for message in report::values(report, core.counters.bad_packets(), interval_ns) {
                core.say(out, &message);
            }
        }
        if state_before != Some(report.state) {
            core.tell(out, &report::state_text(report.state, report.reasons));
            if report.state == GuidanceState::Engaging && core.vehicle.home_ned_m().is_none() {
                core.tell(out, &report::no_home_text());
            }
        } else if core.newcomer {
            core.say_text(out, &report::state_text(report.state, report.reasons));
        }
        core.newcomer = false;
        let begins = |reason| report.reasons.contains(reason) && !reasons_before.contains(reason);
        if let (true, Some(interval_ns)) = (begins(Reason::SlowTelemetry), interval_ns) {
            core.tell(out, &report::slow_telemetry_text(interval_ns));
        }
        // Not before the vehicle is known to be ready otherwise: then it is what is waited for.
        let waits = report.state == GuidanceState::Ready && report.reasons.contains(Reason::PilotInCommand);
        if waits && !core::mem::replace(&mut self.pilot_said, waits) {
            core.tell(out, &report::pilot_in_command_text(core.vehicle.flavour()));
        }
        self.pilot_said = waits;
        let verdict = report.judgement.map(|j| j.verdict);
        if due | (core::mem::replace(&mut self.said_verdict, verdict) != verdict) {
            for message in report::judgement_values(report) {
                core.say(out, &message);
            }
        }
        if core::mem::replace(&mut self.said_alarm, report.alarm) != report.alarm {
            core.tell(out, &report::alarm_text(report.alarm));
        }
    }
}
