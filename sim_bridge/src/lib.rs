//! The simulator: world, vehicle, LiDAR and MAVLink endpoint in one clock, in lockstep or in real time.

mod companion_view;
mod config;
pub mod links;
pub mod lockstep;
pub mod program;
mod sensor_fault;
mod simulator;
mod state;
mod udp;

pub use companion_view::CompanionView;
pub use config::{ConfigError, CourseChoice, Models, SimConfig, Start, family_parser};
pub use sensor_fault::{Onset, SensorFault, SensorFaultMode};
pub use simulator::{Ending, LIDAR_SENSOR_ID, STEP_MS, Simulator};
