//! The simulator: world, vehicle, LiDAR and MAVLink endpoint in one clock, in lockstep or in real time.
//!
//! It publishes depth frames and obeys MAVLink; it knows nothing of pilots, detectors and attacks. [`environment`] is the same world
//! as a function of setpoints, for training.

mod companion_view;
mod config;
pub mod environment;
pub mod lockstep_flight;
pub mod program;
mod saved_state;
mod sensor_fault;
mod simulator;
mod udp;
pub mod vehicle_links;

pub use companion_view::CompanionView;
pub use config::{ConfigError, CourseChoice, Models, SimConfig, Start, family_parser};
pub use sensor_fault::{Onset, SensorFault, SensorFaultMode};
pub use simulator::{Ending, LIDAR_SENSOR_ID, STEP_MS, Simulator};
