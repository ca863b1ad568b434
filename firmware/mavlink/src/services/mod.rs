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
use crate::service::{Service, Step};
use vigil_types::{Datagrams, Nanos};

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
