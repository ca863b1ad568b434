//! A PX4-flavoured MAVLink vehicle, sans IO.
//!
//! [`Endpoint`] takes datagrams and the vehicle's view of itself, and gives datagrams and the command for the vehicle's
//! controllers. It has no clock, no socket and no thread: time is an argument, so the same bytes at the same times give
//! the same bytes and the same flight. What it speaks is described in docs/mavlink.md, from
//! <https://mavlink.io/en/services/> and the behaviour of PX4's software in the loop.
//!
//! ```
//! use vigil_autopilot::{Endpoint, EndpointConfig};
//! use vigil_autopilot::vehicle::{Vehicle, VehicleParams, Wind};
//!
//! let mut vehicle = Vehicle::new(VehicleParams::default(), Wind::default(), 1)?;
//! let mut endpoint = Endpoint::new(EndpointConfig::companion_only())?;
//! let mut datagrams = 0;
//! for ms in 1..=1000 {
//!     let command = endpoint.step(ms * 1_000_000, &vehicle.view());
//!     vehicle.step(&command);
//!     endpoint.transmit(|_link, _is_telemetry, _datagram| datagrams += 1);
//! }
//! assert!(datagrams > 10, "a second of telemetry: {datagrams}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A protocol service is what implements `service::Service` in `services`, and its line in their table: `services`
//! know the core, the core knows none of them.
#![forbid(unsafe_code)]
// Clients still send what the protocol calls superseded (PING, SET_MODE, MAV_FRAME_BODY_NED), and expect answers.
#![allow(deprecated)]

mod config;
mod core;
mod endpoint;
mod files;
mod flight;
pub mod geo;
mod outbox;
mod plan;
mod saved;
mod service;
mod services;
mod streams;
mod ulog;
mod used_parameters;
pub mod vehicle;
mod vehicle_parameters;

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

pub use config::{ConfigError, EndpointConfig, LinkId, LinkRole};
pub use core::{EndpointStatus, Refusals, SigningSetup, ZoneRanges};
pub use endpoint::Endpoint;
pub use flight::{Failsafe, FlightMode, LandedState};
pub use saved::Saved;
pub use vehicle_parameters::{ParameterError, ParameterInfo, ParameterRole, ParameterValue, parameter_table};
pub use vigil_mavlink::routing::ComponentId;
