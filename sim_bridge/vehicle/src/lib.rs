//! A 6-DOF quadcopter with its autopilot's controllers and sensors.

mod interface;

pub use interface::{ControlCommand, Estimate, Sensors, Truth, VehicleView, YawCommand};
