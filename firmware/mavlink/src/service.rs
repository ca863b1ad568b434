//! A service of the guidance computer: one part of MAVLink's protocol in one file.

use crate::companion::CompanionConfig;
use crate::core::Core;
use crate::framing::Packet;
use crate::operator::ReplyTo;
use vigil_types::{Datagrams, Nanos, StepReport, VehicleRequest};

/// What a step decided.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step<'a> {
    /// What was decided and why.
    pub report: &'a StepReport,
    /// What guidance asks of the vehicle.
    pub request: VehicleRequest,
}

/// A service. Like the whole crate it reads no clock and allocates nothing. A new one is its file and its row in
/// [`crate::services`].
pub(crate) trait Service: Default {
    /// One that has heard nothing yet.
    fn new(_config: &CompanionConfig) -> Self {
        Self::default()
    }

    /// Hears a packet of the vehicle's autopilot, on the vehicle's link.
    fn hear_vehicle(&mut self, _core: &mut Core, _now_ns: Nanos, _packet: &Packet<'_>) {}

    /// Hears a packet of anybody. `true` says that it was of this service's protocol, and no other is asked.
    fn hear(&mut self, _core: &mut Core, _now_ns: Nanos, _packet: &Packet<'_>, _from: ReplyTo) -> bool {
        false
    }

    /// Says what the service has to say in this step.
    fn speak(&mut self, _core: &mut Core, _step: &Step<'_>, _out: &mut Datagrams) {}
}
