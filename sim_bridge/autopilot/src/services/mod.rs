//! The protocol services, those of one matter in one file. A new one is its line in the table below, besides its `mod`.

mod actions;
mod actuators;
mod calibration;
mod events;
mod ftp;
mod geography;
mod health;
mod identity;
mod link;
mod logs;
mod metadata;
mod parameters;
mod plans;
mod position;
mod sensors;
mod setpoints;
mod shell;
mod state;

use crate::service::prelude::*;

/// Commands that are served, and messages that are built, by what all services share, and nothing else.
struct Tables(&'static [(u16, Handler)], &'static [Produced]);

impl Service for Tables {
    fn messages(&self) -> &'static [Produced] {
        self.1
    }

    fn serves(&self, command: u16) -> bool {
        self.0.iter().any(|(number, _)| *number == command)
    }

    fn command(&mut self, command: &Command, source: Source, core: &mut Core) -> Answer {
        let served = self.0.iter().find(|(number, _)| *number == command.number);
        served.map_or(Err(Refusal::UNSUPPORTED), |(_, serve)| serve(command, source, core))
    }
}

/// A message that is taken by what all services share, and nothing else.
struct Receiver<M>(fn(M, Source, &mut Core));

impl<M: MessageData<Message = MavMessage>> Service for Receiver<M> {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        if let Some(message) = core.read(packet) {
            (self.0)(message, source, core);
        }
    }
}

/// Every service: a new one needs its line here. Commands are offered in this order; a message goes to all.
pub(crate) fn all() -> Vec<Box<dyn Service + Send>> {
    vec![
        Box::<setpoints::SetpointService>::default(),
        Box::new(Receiver(setpoints::joystick)),
        Box::new(Receiver(setpoints::channels)),
        Box::new(Tables(state::COMMANDS, state::MESSAGES)),
        Box::new(Tables(&[], position::MESSAGES)),
        Box::new(Tables(sensors::COMMANDS, sensors::MESSAGES)),
        Box::<actuators::Actuators>::default(),
        Box::<sensors::Vibration>::default(),
        Box::new(position::GroundTruth),
        Box::new(Tables(&[], health::MESSAGES)),
        Box::new(Receiver(geography::set_origin)),
        Box::new(Tables(geography::COMMANDS, geography::MESSAGES)),
        Box::new(actions::SetMode),
        Box::new(Tables(actions::COMMANDS, actions::MESSAGES)),
        Box::<calibration::Calibration>::default(),
        Box::<plans::PlanTransfer>::default(),
        Box::new(Receiver(plans::set_current)),
        Box::new(Tables(plans::COMMANDS, plans::MESSAGES)),
        Box::<geography::Geofence>::default(),
        Box::<setpoints::Follow>::default(),
        Box::<parameters::ParameterService>::default(),
        Box::new(Tables(parameters::COMMANDS, &[])),
        Box::<ftp::Ftp>::default(),
        Box::new(metadata::Metadata),
        Box::<logs::Logs>::default(),
        Box::<events::Events>::default(),
        Box::<shell::Shell>::default(),
        Box::new(Receiver(link::answer_ping)),
        Box::new(Receiver(link::synchronise)),
        Box::<link::LinkStatus>::default(),
        Box::new(Tables(&[], identity::MESSAGES)),
        Box::new(Receiver(identity::set_up)),
    ]
}
