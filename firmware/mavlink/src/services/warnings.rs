//! What a person should know of vehicle and inputs, as STATUSTEXTs.

use crate::allowance::Allowance;
use crate::core::Core;
use crate::framing::Packet;
use crate::inputs::MissingInputs;
use crate::operator::ReplyTo;
use crate::service::{Service, Step};
use crate::status_text::{CRITICAL, ERROR, INFO, WARNING};
use mavlink::MessageData;
use mavlink::dialects::common::HEARTBEAT_DATA;
use vigil_types::{Datagrams, Nanos, NedVector};

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
        for text in self.missing.due(report).iter().flatten() {
            core.tell_now(out, text);
        }
    }
}
