//! Courses for vehicles that are not ours: what PX4's and ArduPilot's own simulators, or a hardware-in-the-loop rig, fly on
//! (docs/foreign-vehicles.md). [`ForeignFlight`] is the course around the reported pose, without a socket; [`render`] is the process.

mod flight;
mod pose_link;
pub mod render;

pub use flight::{ForeignConfig, ForeignFlight, PoseState};
pub use pose_link::PoseLink;
