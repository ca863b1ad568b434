//! Guidance: decides in each step whether the pilot's action may reach the vehicle.
//!
//! A pure state machine. [`table::TRANSITIONS`] says which condition leads from which state to which, in order of
//! precedence; [`conditions::CONDITIONS`] says when each named condition is present and when it clears. Both are data:
//! `docs/guidance.md` is generated from them.
//!
//! Only the state *guided* sends a velocity other than zero.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

pub mod alarm;
pub mod conditions;
mod config;
mod machine;
mod setpoint;
pub mod table;

pub use alarm::AlarmConfig;
pub use config::{ConfigError, FenceShape, GREATEST_GOAL_M, Geofence, GuidanceConfig};
pub use machine::{FrameStatus, Guidance, GuidanceInput, GuidanceOutput};
pub use setpoint::guided_setpoint;
// The policies that its configuration is made of.
pub use vigil_types::{AlarmPolicy, AtGoal, EngagePolicy, OnNoProgress};
