//! The services of the guidance computer, one file each. A new one is its file and its row in the table below, besides its `mod`.

pub(crate) mod commands;
pub(crate) mod handover;
mod heartbeat;
mod metadata;
mod mission_motion;
pub(crate) mod obstacles;
pub(crate) mod parameters;
pub(crate) mod setpoint_timeout;
pub(crate) mod setpoints;
mod status;
pub(crate) mod streams;
mod time;
mod warnings;

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
/// the table below.
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

macro_rules! services {
    ($($name:ident: $service:ty,)+) => {
        /// Every service.
        #[derive(Debug, Clone)]
        pub(crate) struct Services {
            $(pub $name: $service,)+
        }

        impl Services {
            pub fn new(config: &CompanionConfig) -> Self {
                Self {
                    $($name: <$service>::new(config),)+
                }
            }

            pub fn hear_vehicle(&mut self, core: &mut Core, now_ns: Nanos, packet: &Packet<'_>) {
                $(self.$name.hear_vehicle(core, now_ns, packet);)+
            }

            pub fn hear(&mut self, core: &mut Core, now_ns: Nanos, packet: &Packet<'_>, from: ReplyTo) {
                let _ = false $(|| self.$name.hear(core, now_ns, packet, from))+;
            }

            pub fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
                $(self.$name.speak(core, step, out);)+
            }
        }
    };
}

// They hear and speak in this order. One command is for the metadata, which therefore hears it first.
services! {
    metadata: metadata::MetadataService,
    commands: commands::CommandService,
    parameters: parameters::ParameterService,
    time: time::TimeService,
    heartbeat: heartbeat::HeartbeatService,
    setpoints: setpoints::SetpointService,
    handover: handover::HandoverService,
    setpoint_timeout: setpoint_timeout::SetpointTimeoutService,
    streams: streams::StreamService,
    mission_motion: mission_motion::MissionMotionService,
    status: status::StatusService,
    warnings: warnings::WarningService,
    obstacles: obstacles::ObstacleService,
}
