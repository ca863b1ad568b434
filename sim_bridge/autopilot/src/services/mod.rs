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

use crate::service::Service;

pub(crate) use actions::BELOW_HOME_M;
pub(crate) use intervals::message_interval;

/// Every service: a new one needs its line here. Commands are offered in this order; a message goes to all.
pub(crate) fn all() -> Vec<Box<dyn Service + Send>> {
    vec![
        Box::<setpoints::SetpointService>::default(),
        Box::new(manual::Manual),
        Box::new(state::State),
        Box::new(attitude::Attitude),
        Box::new(position::Position),
        Box::new(sensors::SensorReadings),
        Box::new(ranges::Ranges),
        Box::<actuators::Actuators>::default(),
        Box::new(estimator::Estimator),
        Box::<vibration::Vibration>::default(),
        Box::<flight_information::FlightInformation>::default(),
        Box::new(absent::Absent),
        Box::new(ground_truth::GroundTruth),
        Box::new(failures::Failures),
        Box::new(battery::Battery),
        Box::new(health::Health),
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
        Box::new(version::Version),
        Box::new(signing::SigningService),
    ]
}
