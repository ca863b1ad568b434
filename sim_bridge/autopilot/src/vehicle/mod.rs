//! A 6-DOF quadcopter with its autopilot's controllers and sensors.
//!
//! [`Vehicle::step`] advances it by 1 ms under one [`ControlCommand`]; [`Vehicle::view`] is what its autopilot believes,
//! [`Vehicle::truth`] what is. Model, parameters and their sources: `docs/vehicle.md`.
//!
//! ```
//! use vigil_types::{HeadingVector, NedVector};
//! use vigil_autopilot::vehicle::{ControlCommand, Vehicle, VehicleParams, Wind, YawCommand};
//!
//! let mut vehicle = Vehicle::new(VehicleParams::default(), Wind::default(), 1)?;
//! vehicle.place(NedVector::new(0.0, 0.0, -2.5), 0.0, true);
//! let ahead = ControlCommand::VelocityHeading(HeadingVector::new(1.5, 0.0, 0.0), YawCommand::Rate(0.0));
//! for _ in 0..4000 {
//!     vehicle.step(&ahead); // 1 ms
//! }
//! let truth = vehicle.truth();
//! assert!((truth.velocity_ned_m_s.x - 1.5).abs() < 0.2, "{truth:?}");
//! # Ok::<(), vigil_autopilot::vehicle::ParamsError>(())
//! ```
mod body;
mod control;
mod ground;
mod interface;
mod math;
mod model;
mod noise;
mod params;
mod quadcopter;
mod rotors;
mod sensors;
mod shaping;
mod validate;

pub use interface::{ControlCommand, Estimate, Goal, Held, Motion, Sensors, Truth, VehicleView, YawCommand};
pub use model::VehicleModel;
pub use noise::normal_of;
pub use params::{
    AirframeParams, BatteryParams, ControlParams, GRAVITY_M_S2, GroundParams, HoldLaw, MotorParams, SensorParams,
    VehicleParams, VelocityLaw, Wind,
};
pub use quadcopter::{STEP_NS, Vehicle};
pub use validate::ParamsError;
