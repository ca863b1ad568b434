//! The simulator: world, vehicle, LiDAR and MAVLink endpoint in one clock, in lockstep or in real time.
//!
//! It publishes depth frames and obeys MAVLink; it knows nothing of pilots, detectors and attacks. [`environment`] is the same world
//! as a function of setpoints, for training.
//!
//! ```
//! use vigil_sim::{SimConfig, Simulator, Start};
//! use vigil_types::{Datagrams, DepthFrame};
//! use vigil_sim::world::{Family, generate};
//!
//! let mut config = SimConfig::new(generate(Family::Validation, 7), 7);
//! config.start = Start::Airborne;
//! let mut simulator = Simulator::new(&config, 0)?;
//! let mut frame = Box::new(DepthFrame::EMPTY);
//! let (silence, mut telemetry) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
//! for _ in 0..20 {
//!     simulator.lockstep(&silence, &mut frame, &mut telemetry); // 50 ms
//! }
//! assert_eq!(simulator.now_ns(), 1_000_000_000);
//! assert!(frame.header.stamp_ns == simulator.now_ns() && telemetry.len() > 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod companion_view;
mod config;
mod depth_sensor;
pub mod environment;
pub mod foreign;
pub mod lockstep_flight;
pub mod program;
mod saved_state;
mod sensor_fault;
mod simulator;
pub mod statistics;
#[cfg(test)]
mod testing;
mod udp;
pub mod vehicle_links;
pub mod world;

pub use companion_view::CompanionView;
pub use config::{CourseChoice, Models, SimConfig, Start, VehicleChoice, family_parser};
pub use depth_sensor::LIDAR_SENSOR_ID;
pub use sensor_fault::{Onset, SensorFault, SensorFaultMode};
pub use simulator::{Ending, STEP_MS, Simulator};
pub use vigil_autopilot::vehicle;
