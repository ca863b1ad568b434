//! What the vehicle does: arming, modes, failsafes, and the command for its controllers.

mod around;
mod commander;
mod control;
mod fence;
mod manual;
mod mission;
pub(crate) mod mode;
pub(crate) mod setpoint_owner;
mod setpoints;
pub(crate) mod state;

pub use mode::FlightMode;
pub use state::{Failsafe, LandedState};

pub(crate) use control::{attitude_target, position_target};
pub(crate) use setpoints::{SetpointDefect, attitude_setpoint, global_setpoint, position_setpoint};
pub(crate) use state::{Denial, Facing, Orbit, SensorFault};
