//! Pilots: what turns a depth frame and a goal into an action.
//!
//! [`LearnedPilot`] flies the frozen network ([`actor::ActorSpec`]), [`GeometricPilot`] needs none, [`RecoveryPilot`] takes over after an alarm;
//! [`PlausibilityCheck`] says before all of them whether a frame can be believed. None of them moves the vehicle: guidance does.
//!
//! ```
//! use vigil_policy::{GeometricConfig, GeometricPilot, Pilot, PilotInput};
//! use vigil_types::{DepthFrame, GoalRelative};
//!
//! let mut pilot = GeometricPilot::new(GeometricConfig::default());
//! let nothing_in_sight = DepthFrame::EMPTY;
//! let goal = GoalRelative { distance_m: 20.0, bearing_rad: 0.0 };
//! let action = pilot.decide(&PilotInput { height_m: 2.5, ..PilotInput::at_rest(&nothing_in_sight, goal) });
//! assert!(action.forward_m_s > 0.5 && action.yaw.abs() < 0.01, "straight ahead: {action:?}");
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing))]

extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

pub mod actor;
pub mod apf;
mod field;
#[cfg(feature = "actor-file")]
mod frozen;
pub mod geometric;
pub mod imported;
pub mod plausibility;
mod second_sensor;
mod take_off;

#[cfg(feature = "actor-file")]
pub use actor::FrozenActor;
pub use actor::{Decider, FlightPilot, LearnedPilot};
pub use apf::NearestObstacle;
pub use field::FlightField;
#[cfg(feature = "actor-file")]
pub use frozen::{ExplainedHead, FrozenPilot};
pub use geometric::{Aside, ForwardCheck, GeometricConfig, GeometricPilot, RangeScan, RecoveryPilot, Scan};
#[cfg(feature = "actor-file")]
pub use imported::FrozenPolicy;
pub use imported::ImportedPilot;
pub use plausibility::PlausibilityCheck;
pub use second_sensor::SecondSensor;
pub use take_off::TakeOff;

use vigil_types::{Action, Attitude, DepthFrame, GoalRelative, HeadingVector, Nanos};

/// What a pilot may look at in one step. All of it was checked (size, checksum, finite, fresh) before it got here.
#[derive(Debug, Clone, Copy)]
pub struct PilotInput<'a> {
    /// Time of the step.
    pub now_ns: Nanos,
    /// The newest depth frame.
    pub depth: &'a DepthFrame,
    /// Distance and bearing to the goal.
    pub goal: GoalRelative,
    /// Attitude now (the frame's header has the one at capture).
    pub attitude: Attitude,
    /// Velocity now, level axes along the heading.
    pub velocity_m_s: HeadingVector,
    /// Height above home now, metres, positive up.
    pub height_m: f32,
}

impl<'a> PilotInput<'a> {
    /// At rest where a frame was taken, at its time.
    pub fn at_rest(depth: &'a DepthFrame, goal: GoalRelative) -> Self {
        let header = &depth.header;
        Self {
            now_ns: header.stamp_ns,
            depth,
            goal,
            attitude: header.attitude,
            velocity_m_s: HeadingVector::ZERO,
            height_m: -header.position_ned_m.z,
        }
    }
}

/// A pilot: one decision per step; no allocation, no panic, no clock.
pub trait Pilot {
    /// Decides. An output that is not finite is treated as a fault by the caller (explicit hold).
    fn decide(&mut self, input: &PilotInput<'_>) -> Action;

    /// Forgets everything it remembered of earlier steps (a new flight).
    fn reset(&mut self);

    /// Frames or telemetry failed in flight: what follows does not continue what was before. What is remembered of places may be kept; it ages.
    fn pause(&mut self) {
        self.reset();
    }
}

/// The smaller of two numbers, neither NaN: `f32::min` also settles NaN, at several times the cost in the inner loops.
#[inline]
pub(crate) fn smaller(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

/// The larger of two numbers, neither NaN.
#[inline]
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if a < b { b } else { a }
}
