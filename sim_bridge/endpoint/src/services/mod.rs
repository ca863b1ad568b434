//! The protocol services, one file each.

mod actions;
mod arming;
mod attitude;
mod battery;
mod geography;
mod health;
mod intervals;
mod parameters;
mod position;
mod sensors;
mod setpoints;
mod state;
mod statustext;
mod time;
mod version;

use crate::service::Service;

pub(crate) use intervals::message_interval;

/// Every service. Commands are offered in this order; a message goes to all.
pub(crate) fn all() -> Vec<Box<dyn Service + Send>> {
    vec![
        Box::new(setpoints::SetpointService),
        Box::new(state::State),
        Box::new(attitude::Attitude),
        Box::new(position::Position),
        Box::new(sensors::SensorReadings),
        Box::new(battery::Battery),
        Box::new(health::Health),
        Box::new(geography::Geography),
        Box::new(arming::Arming),
        Box::new(actions::Actions),
        Box::<parameters::ParameterService>::default(),
        Box::new(time::Time),
        Box::new(version::Version),
    ]
}

/// Ids of messages that are announced besides their stream.
pub(crate) mod message_ids {
    use vigil_link::common::{EXTENDED_SYS_STATE_DATA, HEARTBEAT_DATA, NAMED_VALUE_FLOAT_DATA};
    use vigil_link::mavlink::MessageData;

    pub const HEARTBEAT: u32 = HEARTBEAT_DATA::ID;
    pub const EXTENDED_SYS_STATE: u32 = EXTENDED_SYS_STATE_DATA::ID;
    /// The setpoint owner.
    pub const NAMED_VALUE_FLOAT: u32 = NAMED_VALUE_FLOAT_DATA::ID;
}
