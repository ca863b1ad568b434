//! What a person should know of vehicle and inputs, as STATUSTEXTs.

use super::{Service, Step};
use crate::core::{Allowance, Core};
use crate::framing::Packet;
use crate::operator::ReplyTo;
use crate::status_text::{CRITICAL, ERROR, INFO, StatusText, WARNING};
use mavlink::MessageData;
use mavlink::dialects::common::HEARTBEAT_DATA;
use vigil_types::{Datagrams, Nanos, NedVector, Reason, Reasons, StepReport};

/// A vehicle of another autopilot than the configured one, and another guidance computer, are reported this often.
const WRONG_VEHICLE_NS: Nanos = 30_000_000_000;
/// Home is reported when it is this much elsewhere than last reported, metres.
const HOME_MOVED_M: f32 = 0.5;

#[derive(Debug, Clone, Default)]
pub(crate) struct WarningService {
    missing: MissingInputs,
    vehicle_named: bool,
    restarts: u32,
    restarts_said: Allowance,
    wrong_vehicle_said: Allowance,
    home_said_m: NedVector,
    /// Somebody on the vehicle's link calls itself what we are.
    double_heard: bool,
    doubles_said: Allowance,
}

impl Service for WarningService {
    fn hear(&mut self, core: &mut Core, _: Nanos, packet: &Packet<'_>, from: ReplyTo) -> bool {
        // No link gives us our own packets back: an autopilot passes them on to its other links only.
        self.double_heard |= packet.message_id() == HEARTBEAT_DATA::ID
            && from.link == core.config.link
            && Some(from.system) == core.system_id
            && from.component == core.config.component_id;
        false
    }

    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let report = step.report;
        let now_ns = report.now_ns;
        if let (true, false, Some(system)) = (core.vehicle_heard, self.vehicle_named, core.system_id) {
            self.vehicle_named = true;
            match (core.vehicle.named, core.vehicle.mav_autopilot) {
                (Some(named), _) => core.tell(out, INFO, format_args!("vehicle {system}: {}", named.name())),
                (None, number) => {
                    let flown_as = core.vehicle.flavour().name();
                    let text = format_args!("vehicle {system}: autopilot {number} is not known, flown as {flown_as}");
                    core.tell(out, INFO, text);
                }
            }
        }
        let restarts = core.vehicle.restarts;
        if core::mem::replace(&mut self.restarts, restarts) != restarts
            && self.restarts_said.takes(now_ns, WRONG_VEHICLE_NS, 1)
        {
            core.tell(out, WARNING, format_args!("the vehicle's autopilot restarted"));
        }
        if let (true, Some(named)) = (core.vehicle.is_other_autopilot(), core.vehicle.named)
            && self.wrong_vehicle_said.takes(now_ns, WRONG_VEHICLE_NS, 1)
        {
            let (named, configured) = (named.name(), core.vehicle.flavour().name());
            let text = format_args!("vehicle is {named}, but set is {configured}: it is not flown; use --vehicle auto");
            core.tell(out, ERROR, text);
        }
        if let Some(home_ned_m) = core.vehicle.home_ned_m()
            && (home_ned_m - self.home_said_m).norm() > HOME_MOVED_M
        {
            self.home_said_m = home_ned_m;
            let (north_m, east_m, up_m) = (home_ned_m.x, home_ned_m.y, -home_ned_m.z);
            core.tell(
                out,
                INFO,
                format_args!(
                    "home: {north_m:.1} m north, {east_m:.1} m east, {up_m:.1} m above the local origin; goals are from there"
                ),
            );
        }
        if core::mem::take(&mut self.double_heard) && self.doubles_said.takes(now_ns, WRONG_VEHICLE_NS, 1) {
            let (system, component) = (core.system_id.unwrap_or_default(), core.config.component_id);
            let text = format_args!("another guidance computer {system}/{component} is on the link: stop one");
            core.tell(out, CRITICAL, text);
        }
        if self.missing.is_due(report) {
            for (name, age_ns) in missing(report).into_iter().flatten() {
                let text = match age_ns.map(|age_ns| age_ns as f32 * 1e-9) {
                    Some(age_s) => StatusText::new(WARNING, format_args!("missing: {name}, for {age_s:.1} s")),
                    None => StatusText::new(WARNING, format_args!("missing: {name}, none came")),
                };
                core.tell_now(out, &text);
            }
        }
    }
}

/// An input that is missing for this long is named.
const PATIENCE_NS: Nanos = 1_000_000_000;
/// Pause until the same is named again: doubled each time up to the longest.
const FIRST_PAUSE_NS: Nanos = 10_000_000_000;
const LONGEST_PAUSE_NS: Nanos = 60_000_000_000;
/// Of position and attitude the older one is named, and the other too when it is as old to within this.
const TOGETHER_NS: Nanos = 100_000_000;

/// Watches what guidance misses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct MissingInputs {
    since_ns: Option<Nanos>,
    named_ns: Option<Nanos>,
    named: u8,
}

impl MissingInputs {
    /// Whether this step names them.
    fn is_due(&mut self, report: &StepReport) -> bool {
        let of_inputs = Reasons::of(Reason::StaleFrame)
            .union(Reasons::of(Reason::StaleTelemetry))
            .union(Reasons::of(Reason::LinkLost));
        if !report.reasons.intersects(of_inputs) {
            *self = Self::default();
            return false;
        }
        let now_ns = report.now_ns;
        let missing_ns = now_ns.saturating_sub(*self.since_ns.get_or_insert(now_ns));
        let pause_ns = (FIRST_PAUSE_NS << self.named.saturating_sub(1).min(3)).min(LONGEST_PAUSE_NS);
        let is_due = match self.named_ns {
            None => missing_ns >= PATIENCE_NS,
            Some(named_ns) => now_ns.saturating_sub(named_ns) >= pause_ns,
        };
        if is_due {
            (self.named_ns, self.named) = (Some(now_ns), self.named.saturating_add(1));
        }
        is_due
    }
}

/// Those that are missing, with the age of the last one: "LOCAL_POSITION_NED, for 3.2 s", "depth frames, none came".
fn missing(report: &StepReport) -> [Option<(&'static str, Option<Nanos>)>; 4] {
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
    let named =
        |reason, also: bool, name, age_ns: Option<Nanos>| (reasons.contains(reason) && also).then_some((name, age_ns));
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
