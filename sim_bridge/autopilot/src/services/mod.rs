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
mod intervals;
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

use crate::service::{Produced, Service};

pub(crate) use actions::BELOW_HOME_M;
pub(crate) use intervals::message_interval;

/// Messages that are built of what all services share, and nothing else.
struct Telemetry(&'static [Produced]);

impl Service for Telemetry {
    fn messages(&self) -> &'static [Produced] {
        self.0
    }
}

/// Every service: a new one needs its line here. Commands are offered in this order; a message goes to all.
pub(crate) fn all() -> Vec<Box<dyn Service + Send>> {
    vec![
        Box::<setpoints::SetpointService>::default(),
        Box::new(manual::Manual),
        Box::new(Telemetry(state::MESSAGES)),
        Box::new(Telemetry(attitude::MESSAGES)),
        Box::new(Telemetry(position::MESSAGES)),
        Box::new(Telemetry(sensors::MESSAGES)),
        Box::new(Telemetry(ranges::MESSAGES)),
        Box::<actuators::Actuators>::default(),
        Box::new(Telemetry(estimator::MESSAGES)),
        Box::<vibration::Vibration>::default(),
        Box::<flight_information::FlightInformation>::default(),
        Box::new(Telemetry(absent::MESSAGES)),
        Box::new(ground_truth::GroundTruth),
        Box::new(failures::Failures),
        Box::new(Telemetry(battery::MESSAGES)),
        Box::new(Telemetry(health::MESSAGES)),
        Box::new(geography::Geography),
        Box::new(arming::Arming),
        Box::new(actions::Actions),
        Box::<calibration::Calibration>::default(),
        Box::<plans::PlanTransfer>::default(),
        Box::new(mission::MissionService),
        Box::<geofence::Geofence>::default(),
        Box::new(orbit::OrbitService),
        Box::new(follow::Follow::default()),
        Box::new(interest::Interest),
        Box::<parameters::ParameterService>::default(),
        Box::new(storage::Storage),
        Box::<ftp::Ftp>::default(),
        Box::new(metadata::Metadata),
        Box::<logs::Logs>::default(),
        Box::<events::Events>::default(),
        Box::<shell::Shell>::default(),
        Box::new(time::Time),
        Box::<link_status::LinkStatus>::default(),
        Box::new(modes::Modes),
        Box::new(Telemetry(version::MESSAGES)),
        Box::new(signing::SigningService),
    ]
}
