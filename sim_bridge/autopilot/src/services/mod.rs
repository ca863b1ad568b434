//! The protocol services, one file each. A new one is its file and its line in the table below, besides its `mod`.

mod absent;
mod actions;
mod actuators;
mod arming;
mod attitude;
mod battery;
mod calibration;
mod estimator;
mod events;
mod failures;
mod flight_information;
mod follow;
mod ftp;
mod geofence;
mod geography;
mod ground_truth;
mod health;
mod interest;
mod link_status;
mod logs;
mod manual;
mod metadata;
mod mission;
mod modes;
mod orbit;
mod packed_parameters;
mod parameters;
mod plans;
mod position;
mod ranges;
mod sensors;
mod setpoints;
mod shell;
mod signing;
mod state;
mod storage;
mod time;
mod version;
mod vibration;

use crate::service::prelude::*;

pub(crate) use actions::{BELOW_HOME_M, GLOBAL_FRAMES, MAX_DISTANCE_M, MAX_HEIGHT_M};

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
        Box::new(Receiver(manual::joystick)),
        Box::new(Receiver(manual::channels)),
        Box::new(Tables(&[], state::MESSAGES)),
        Box::new(Tables(&[], attitude::MESSAGES)),
        Box::new(Tables(&[], position::MESSAGES)),
        Box::new(Tables(&[], sensors::MESSAGES)),
        Box::new(Tables(&[], ranges::MESSAGES)),
        Box::<actuators::Actuators>::default(),
        Box::new(Tables(&[], estimator::MESSAGES)),
        Box::<vibration::Vibration>::default(),
        Box::<flight_information::FlightInformation>::default(),
        Box::new(Tables(&[], absent::MESSAGES)),
        Box::new(ground_truth::GroundTruth),
        Box::new(Tables(failures::COMMANDS, &[])),
        Box::new(Tables(&[], battery::MESSAGES)),
        Box::new(Tables(&[], health::MESSAGES)),
        Box::new(Receiver(geography::set_origin)),
        Box::new(Tables(geography::COMMANDS, geography::MESSAGES)),
        Box::new(Tables(arming::COMMANDS, &[])),
        Box::new(actions::SetMode),
        Box::new(Tables(actions::COMMANDS, &[])),
        Box::<calibration::Calibration>::default(),
        Box::<plans::PlanTransfer>::default(),
        Box::new(Receiver(mission::set_current)),
        Box::new(Tables(mission::COMMANDS, mission::MESSAGES)),
        Box::<geofence::Geofence>::default(),
        Box::new(Tables(orbit::COMMANDS, orbit::MESSAGES)),
        Box::new(follow::Follow::default()),
        Box::new(Tables(interest::COMMANDS, &[])),
        Box::<parameters::ParameterService>::default(),
        Box::new(Tables(storage::COMMANDS, &[])),
        Box::<ftp::Ftp>::default(),
        Box::new(metadata::Metadata),
        Box::<logs::Logs>::default(),
        Box::<events::Events>::default(),
        Box::<shell::Shell>::default(),
        Box::new(Receiver(time::ping)),
        Box::new(Receiver(time::synchronise)),
        Box::new(Tables(&[], time::MESSAGES)),
        Box::<link_status::LinkStatus>::default(),
        Box::new(Tables(modes::COMMANDS, modes::MESSAGES)),
        Box::new(Tables(&[], version::MESSAGES)),
        Box::new(Receiver(signing::set_up)),
    ]
}
