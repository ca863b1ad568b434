//! Stories of flights, each told step by step.

mod alarm;
mod command;
#[path = "../common/mod.rs"]
mod common;
mod flight;

use common::{GOAL, Story};
use vigil_guidance::{
    AlarmConfig, AlarmPolicy, AtGoal, EngagePolicy, FenceShape, Geofence, GuidanceConfig, OnNoProgress,
};
use vigil_types::GuidanceState::{Engaging, Guided, Hold, Land, Ready, Standby};
use vigil_types::{
    Action, AlarmCause, AlarmResponse, HandoverProgress, Landed, NedVector, OperatorRequest, Reason, Reasons,
    RequestOutcome, STEP_NS, VehicleMode, VehicleRequest, VelocitySetpoint, Verdict,
};

fn auto() -> GuidanceConfig {
    GuidanceConfig {
        engage: EngagePolicy::Auto,
        ..Default::default()
    }
}

fn seconds(s: f64) -> usize {
    (s / 0.05).round() as usize
}
