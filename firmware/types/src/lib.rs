//! Data that flows through the loop, in one direction: depth frame → pilot → guidance → setpoint → link.
//!
//! Everything here but `files` and `settings`, a feature, is plain data: `no_std`, no allocation, no clock. Field names carry their unit; vectors carry their
//! frame as a type, so that NED, FRD and heading-frame values cannot be mixed.
//!
//! ```
//! use vigil_types::{Action, Attitude, AttitudeSample, FrdVector, Goal, Kinematics, NedVector};
//!
//! let at_home = Kinematics { at_ns: 0, position_ned_m: NedVector::ZERO, velocity_ned_m_s: NedVector::ZERO };
//! let level = AttitudeSample { at_ns: 0, attitude: Attitude::LEVEL_NORTH, rates_frd_rad_s: FrdVector::ZERO };
//! let goal = Goal { position_ned_m: NedVector::new(3.0, 4.0, -2.5) };
//! let seen = goal.relative_to(&at_home, &level);
//! assert_eq!(seen.distance_m, 5.0);
//! assert!((seen.bearing_rad.to_degrees() - 53.13).abs() < 0.01, "to the right of a vehicle that looks north");
//!
//! let action = Action { forward_m_s: 2.0, yaw: 0.5 }.clipped();
//! assert_eq!(action.forward_m_s, 1.5);
//! assert!((action.yaw_rate_rad_s().to_degrees() - 15.0).abs() < 1e-4);
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing))]

#[cfg(feature = "files")]
#[macro_use]
extern crate std;

mod action;
mod choice;
mod depth;
#[cfg(feature = "files")]
pub mod files;
mod frame_key;
mod guidance;
mod judgement;
pub mod parameters;
#[cfg(feature = "files")]
pub mod settings;
mod step_report;
mod telemetry;
mod vector;
mod vehicle_requests;

pub use action::{ACTION_LIMIT, Action, FASTEST_M_S, Goal, GoalRelative, VelocitySetpoint, YAW_RATE_PER_UNIT_RAD_S};
pub use choice::{
    Ablation, AlarmPolicy, AtGoal, AutopilotChoice, Choice, Duty, EngagePolicy, LogContent, ObstacleReports,
    OnNoProgress, PilotKind,
};
pub use depth::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DEPTH_ROWS, DepthFrame, FrameDefect, FrameHeader, HORIZONTAL_FOV_RAD,
    PIXEL_PITCH_RAD, VERTICAL_FOV_RAD, column_bearing_rad, row_elevation_rad,
};
pub use frame_key::{FRAME_TAG_BYTES, FrameKey, FrameKeys};
pub use guidance::{GuidanceState, Reason, Reasons};
pub use judgement::{Alarm, AlarmCause, AlarmResponse, EXPLAINED_STATE, Judgement, Verdict};
pub use parameters::ParameterSpec;
pub use step_report::{Datagrams, StepReport, StepTiming};
pub use telemetry::{
    AttitudeSample, Heartbeat, Kinematics, Landed, MissionMotion, RANGE_SECTORS, RANGE_SOURCES, SectorRanges,
    VehicleMode, VehicleTelemetry,
};
pub use vector::{Attitude, Frame, Frd, FrdVector, Heading, HeadingVector, Ned, NedVector, Vector, wrap_pi};
pub use vehicle_requests::{
    GuardNotice, HandoverProgress, OperatorRequest, RequestOutcome, StopCause, VehicleRequest, VehicleStatus,
};

/// Nanoseconds since an arbitrary epoch that all processes of one flight share (the machine's monotonic clock when
/// live, simulated time in lockstep and replay).
pub type Nanos = u64;

/// The loop's fixed period: 20 Hz, 0.05 s (docs/paper.md, "The time step").
pub const STEP_NS: Nanos = 50_000_000;

/// The loop's fixed period in seconds.
pub const STEP_S: f32 = 0.05;
