//! What guidance is doing: NAMED_VALUE_FLOATs and STATUSTEXTs on changes.

use super::{Service, Step};
use crate::autopilot::Flavour;
use crate::core::{Core, Periodic};
use crate::report::{self, InBrackets};
use crate::status_text::{CRITICAL, INFO, NOTICE, StatusText, WARNING};
use vigil_types::{Alarm, AlarmResponse, Datagrams, GuidanceState, Nanos, Reason, Reasons, Verdict};

/// How often values are sent, four times a second.
pub(super) const VALUES_NS: Nanos = 250_000_000;

#[derive(Debug, Clone, Default)]
pub(crate) struct StatusService {
    values: Periodic,
    said_verdict: Option<Verdict>,
    said_alarm: Option<Alarm>,
    pilot_said: bool,
}

impl Service for StatusService {
    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let report = step.report;
        let now = (report.state, report.reasons);
        let before = core.said.replace(now);
        let (state_before, reasons_before) = (before.map(|b| b.0), before.map_or(Reasons::NONE, |b| b.1));
        let due = self.values.is_due(report.now_ns, VALUES_NS);
        if due || before != Some(now) {
            for message in report::state_values(report) {
                core.say(out, &message);
            }
        }
        let interval_ns = core.telemetry_interval_ns;
        if due {
            for message in report::values(report, core.counters.bad_packets(), interval_ns) {
                core.say(out, &message);
            }
        }
        let is_new = state_before != Some(report.state);
        if is_new || core.newcomer {
            let (state, reasons) = (report.state.name(), InBrackets(report.reasons));
            let severity = report::severity(report.state, report.reasons);
            let text = StatusText::new(severity, format_args!("guidance: {state}{reasons}"));
            if is_new {
                core.tell_text(out, &text);
            } else {
                core.say_text(out, &text);
            }
        }
        let has_landed = state_before == Some(GuidanceState::Land) && report.reasons.contains(Reason::Disarmed);
        if is_new && has_landed {
            let text = format_args!("the flight is over: engage guidance for another");
            core.tell(out, NOTICE, text);
        }
        if is_new && report.state == GuidanceState::Engaging && core.vehicle.home_ned_m().is_none() {
            let text = format_args!("home is unknown: goals are from the local origin");
            core.tell(out, WARNING, text);
        }
        core.newcomer = false;
        let begins = |reason| report.reasons.contains(reason) && !reasons_before.contains(reason);
        if let (true, Some(interval_ns)) = (begins(Reason::SlowTelemetry), interval_ns) {
            let rate_hz = 1e9 / interval_ns as f32;
            let text = format_args!("slow telemetry: {rate_hz:.1} Hz leave little margin to stale telemetry");
            core.tell(out, WARNING, text);
        }
        // Not before the vehicle is known to be ready otherwise: then it is what is waited for.
        let waits = report.state == GuidanceState::Ready && report.reasons.contains(Reason::PilotInCommand);
        if waits && !core.let_go && !core::mem::replace(&mut self.pilot_said, waits) {
            let instead = match core.vehicle.flavour() {
                // It refuses OFFBOARD while nobody streams setpoints, and guidance streams none while a person has the vehicle.
                Flavour::Px4 => " when it may go on",
                Flavour::ArduPilot => ", or if nobody took it over, change to GUIDED",
            };
            let text = format_args!("a person has the vehicle: engage guidance{instead}");
            core.tell(out, NOTICE, text);
        }
        self.pilot_said = waits;
        let verdict = report.judgement.map(|j| j.verdict);
        if due | (core::mem::replace(&mut self.said_verdict, verdict) != verdict) {
            for message in report::judgement_values(report) {
                core.say(out, &message);
            }
        }
        if core::mem::replace(&mut self.said_alarm, report.alarm) != report.alarm {
            match report.alarm {
                Some(Alarm { cause, response }) => {
                    let severity = match response {
                        AlarmResponse::Stop | AlarmResponse::Ignored => CRITICAL,
                        AlarmResponse::Recovery => INFO,
                    };
                    let text = format_args!("alarm: {}, {}", cause.name(), response.name());
                    core.tell(out, severity, text);
                }
                None => core.tell(out, INFO, format_args!("alarm: clear")),
            }
        }
    }
}
