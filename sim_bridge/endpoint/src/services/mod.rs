//! The protocol services, one file each.

mod absent;
mod actions;
mod actuators;
mod arming;
mod attitude;
mod battery;
mod calibration;
mod estimator;
mod events;
pub(crate) mod flight_information;
mod ftp;
mod geofence;
mod geography;
mod health;
mod intervals;
mod logs;
mod manual;
pub(crate) mod metadata;
mod mission;
mod orbit;
mod parameters;
mod plans;
mod position;
mod sensors;
mod setpoints;
mod shell;
pub(crate) mod signing;
mod state;
mod statustext;
mod time;
mod version;
mod vibration;

use crate::service::Service;

pub(crate) use intervals::message_interval;

/// Every service. Commands are offered in this order; a message goes to all.
pub(crate) fn all() -> Vec<Box<dyn Service + Send>> {
    vec![
        Box::new(setpoints::SetpointService),
        Box::new(manual::Manual),
        Box::new(state::State),
        Box::new(attitude::Attitude),
        Box::new(position::Position),
        Box::new(sensors::SensorReadings),
        Box::new(actuators::Actuators),
        Box::new(estimator::Estimator),
        Box::<vibration::Vibration>::default(),
        Box::<flight_information::FlightInformation>::default(),
        Box::new(absent::Absent),
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
        Box::<parameters::ParameterService>::default(),
        Box::<ftp::Ftp>::default(),
        Box::new(metadata::Metadata),
        Box::<logs::Logs>::default(),
        Box::<events::Events>::default(),
        Box::<shell::Shell>::default(),
        Box::new(time::Time),
        Box::new(version::Version),
        Box::new(signing::SigningService),
    ]
}

/// Ids of messages that are announced besides their stream.
pub(crate) mod message_ids {
    use vigil_link::common::{
        EXTENDED_SYS_STATE_DATA, FENCE_STATUS_DATA, HEARTBEAT_DATA, MISSION_CURRENT_DATA, MISSION_ITEM_REACHED_DATA,
        NAMED_VALUE_FLOAT_DATA,
    };
    use vigil_link::mavlink::MessageData;

    pub const HEARTBEAT: u32 = HEARTBEAT_DATA::ID;
    pub const EXTENDED_SYS_STATE: u32 = EXTENDED_SYS_STATE_DATA::ID;
    pub const FENCE_STATUS: u32 = FENCE_STATUS_DATA::ID;
    pub const MISSION_CURRENT: u32 = MISSION_CURRENT_DATA::ID;
    pub const MISSION_ITEM_REACHED: u32 = MISSION_ITEM_REACHED_DATA::ID;
    /// The setpoint owner.
    pub const NAMED_VALUE_FLOAT: u32 = NAMED_VALUE_FLOAT_DATA::ID;
}
