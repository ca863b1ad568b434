//! Names the inputs that are missing, one by one: which message, since when.

use crate::status_text::{StatusText, WARNING};
use vigil_types::{Nanos, Reason, Reasons, StepReport};

/// An input that is missing for this long is named.
const PATIENCE_NS: Nanos = 1_000_000_000;
/// Pause until the same is named again: doubled each time up to the longest.
const FIRST_PAUSE_NS: Nanos = 10_000_000_000;
const LONGEST_PAUSE_NS: Nanos = 60_000_000_000;
/// Of position and attitude the older one is named, and the other too when it is as old to within this.
const TOGETHER_NS: Nanos = 100_000_000;

/// Inputs that can be missing.
const INPUTS: usize = 4;

/// Watches what guidance misses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct MissingInputs {
    since_ns: Option<Nanos>,
    named_ns: Option<Nanos>,
    named: u8,
}

impl MissingInputs {
    /// The texts that name inputs in this step: "missing: LOCAL_POSITION_NED, for 3.2 s", "missing: depth frames, none came".
    pub fn due(&mut self, report: &StepReport) -> [Option<StatusText>; INPUTS] {
        let of_inputs = Reasons::of(Reason::StaleFrame)
            .union(Reasons::of(Reason::StaleTelemetry))
            .union(Reasons::of(Reason::LinkLost));
        if !report.reasons.intersects(of_inputs) {
            *self = Self::default();
            return [None; INPUTS];
        }
        let now_ns = report.now_ns;
        let missing_ns = now_ns.saturating_sub(*self.since_ns.get_or_insert(now_ns));
        let pause_ns = (FIRST_PAUSE_NS << self.named.saturating_sub(1).min(3)).min(LONGEST_PAUSE_NS);
        let is_due = match self.named_ns {
            None => missing_ns >= PATIENCE_NS,
            Some(named_ns) => now_ns.saturating_sub(named_ns) >= pause_ns,
        };
        if !is_due {
            return [None; INPUTS];
        }
        self.named_ns = Some(now_ns);
        self.named = self.named.saturating_add(1);
        missing(report)
    }
}

fn missing(report: &StepReport) -> [Option<StatusText>; INPUTS] {
    let StepReport {
        now_ns,
        reasons,
        telemetry,
        ..
    } = *report;
    let age_ns = |at_ns: Option<Nanos>| at_ns.map(|at_ns| now_ns.saturating_sub(at_ns));
    let heartbeat = age_ns(telemetry.heartbeat.map(|h| h.at_ns));
    let position = age_ns(telemetry.kinematics.map(|k| k.at_ns));
    let attitude = age_ns(telemetry.attitude.map(|a| a.at_ns));
    // What never came counts as older than anything.
    let as_old = |one: Option<Nanos>, other: Option<Nanos>| {
        one.is_none_or(|one| other.is_some_and(|other| one.saturating_add(TOGETHER_NS) >= other))
    };
    let named = |reason, also: bool, name: &str, age_ns: Option<Nanos>| {
        let text = match age_ns.map(|age_ns| age_ns as f32 * 1e-9) {
            Some(age_s) => StatusText::new(WARNING, format_args!("missing: {name}, for {age_s:.1} s")),
            None => StatusText::new(WARNING, format_args!("missing: {name}, none came")),
        };
        (reasons.contains(reason) && also).then_some(text)
    };
    [
        named(Reason::LinkLost, true, "HEARTBEAT of a vehicle", heartbeat),
        named(
            Reason::StaleTelemetry,
            as_old(position, attitude),
            "LOCAL_POSITION_NED",
            position,
        ),
        named(Reason::StaleTelemetry, as_old(attitude, position), "ATTITUDE", attitude),
        named(Reason::StaleFrame, true, "depth frames", report.frame_age_ns),
    ]
}
