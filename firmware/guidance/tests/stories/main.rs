//! Stories of flights, each step by step.

mod alarm;
mod command;
#[path = "../common/mod.rs"]
mod common;
mod flight;

use common::{GOAL, Story};
use vigil_guidance::{
    AlarmPolicy, AtGoal, EngagePolicy, Geofence, GuidanceConfig, GuidanceOutput, OnNoProgress, ROUGH_BELOW,
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

/// It holds, for this reason alone.
#[track_caller]
fn assert_holds(out: GuidanceOutput, reason: Reason) {
    let holds = (Hold, Reasons::of(reason), Some(VelocitySetpoint::HOLD));
    assert_eq!((out.state, out.reasons, out.setpoint), holds, "{}", reason.name());
}

/// It is in this state, sends nothing and asks nothing of the vehicle.
#[track_caller]
fn assert_silent(out: GuidanceOutput, state: vigil_types::GuidanceState) {
    let silent = (state, None, VehicleRequest::None);
    assert_eq!((out.state, out.setpoint, out.request), silent);
}

/// The forward speed that is sent, metres per second.
fn sent_m_s(out: GuidanceOutput) -> f32 {
    out.setpoint.unwrap().velocity_m_s.x
}

fn seconds(s: f64) -> usize {
    (s / 0.05).round() as usize
}

fn goal(north_m: f32, east_m: f32, height_m: Option<f32>) -> OperatorRequest {
    OperatorRequest::Goal {
        north_m,
        east_m,
        height_m,
    }
}

/// A fence from 0.8 to 6 m.
fn fence(radius_m: f32) -> Option<Geofence> {
    Some(Geofence {
        radius_m,
        min_height_m: 0.8,
        max_height_m: 6.0,
    })
}
