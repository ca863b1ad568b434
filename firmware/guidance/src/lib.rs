//! Guidance: decides in each step whether the pilot's action may reach the vehicle.
//!
//! A pure state machine. [`table::TRANSITIONS`] says which condition leads from which state to which, in order of
//! precedence; [`conditions::CONDITIONS`] says when each named condition is present and when it clears. Both are data:
//! `docs/guidance.md` is generated from them.
//!
//! Only the state *guided* sends a velocity other than zero.
//!
//! ```
//! use vigil_guidance::{FrameStatus, Guidance, GuidanceConfig, GuidanceInput};
//! use vigil_types::{Action, GuidanceState, StepTiming, VehicleStatus, VehicleTelemetry};
//!
//! let mut guidance = Guidance::new(GuidanceConfig::default())?;
//! let decided = guidance.step(&GuidanceInput {
//!     now_ns: 50_000_000,
//!     telemetry: &VehicleTelemetry::default(), // the vehicle was never heard
//!     frame: FrameStatus::default(),
//!     action: Some(Action { forward_m_s: 1.5, yaw: 0.0 }),
//!     recovery: None,
//!     verdict: None,
//!     risk: None,
//!     smooth_share: None,
//!     timing: StepTiming::default(),
//!     vehicle: VehicleStatus::default(),
//! });
//! assert_eq!(decided.state, GuidanceState::Standby);
//! assert_eq!(decided.setpoint, None, "whatever the pilot wants, nothing is sent");
//! # Ok::<(), vigil_guidance::ConfigError>(())
//! ```
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

pub mod alarm;
pub mod conditions;
mod config;
mod input;
pub mod just_stop;
mod machine;
mod setpoint;
mod stopping_distance;
pub mod table;

pub use alarm::{AlarmConfig, ROUGH_BELOW};
pub use config::{ConfigError, GREATEST_GOAL_M, Geofence, GuidanceConfig};
pub use input::{FrameStatus, GuidanceInput, GuidanceOutput, Risk};
pub use just_stop::{JustStop, JustStopConfig, JustStopInput, JustStopState};
pub use machine::Guidance;
pub use setpoint::guided_setpoint;
// The policies that its configuration is made of.
pub use vigil_types::{AlarmPolicy, AtGoal, EngagePolicy, OnNoProgress};
