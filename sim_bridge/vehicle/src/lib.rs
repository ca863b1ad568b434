//! A 6-DOF quadcopter with its autopilot's controllers and sensors.
//!
//! [`Vehicle::step`] advances it by 1 ms under one [`ControlCommand`]; [`Vehicle::view`] is what its autopilot believes,
//! [`Vehicle::truth`] what is. Model, parameters and their sources: `docs/vehicle.md`.
#![forbid(unsafe_code)]

mod body;
mod control;
mod ground;
mod interface;
mod math;
mod noise;
mod params;
mod rotors;
mod sensors;
mod shaping;
mod validate;
mod vehicle;

pub use interface::{ControlCommand, Estimate, Sensors, Truth, VehicleView, YawCommand};
pub use params::{
    AirframeParams, BatteryParams, ControlParams, GRAVITY_M_S2, GroundParams, MotorParams, SensorParams, VehicleParams,
    Wind,
};
pub use validate::ParamsError;
pub use vehicle::{STEP_NS, Vehicle};
