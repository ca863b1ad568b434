//! What the vehicle does: arming, modes, failsafes, and the command for its controllers.

mod commander;
mod control;
mod fence;
mod manual;
mod mission;
mod mode;
mod orbit;
mod setpoints;

pub use commander::{Failsafe, LandedState};
pub use mode::FlightMode;

pub(crate) use commander::{Commander, Denial};
pub(crate) use control::{attitude_target, position_target};
pub(crate) use fence::FenceWatch;
pub(crate) use manual::{Deflections, Sticks};
pub(crate) use mode::Requested;
pub(crate) use orbit::{Facing, Orbit};
pub(crate) use setpoints::{
    Claim, SetpointDefect, Setpoints, Taken, attitude_setpoint, global_setpoint, position_setpoint,
};
