//! What guidance looks at in a step, and what it decides.

use crate::table::Transition;
use vigil_types::{
    Action, Alarm, GuidanceState, Nanos, Reasons, StepTiming, VehicleRequest, VehicleStatus, VehicleTelemetry,
    VelocitySetpoint, Verdict,
};

/// What became of the depth frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameStatus {
    /// Age of the newest valid frame; `None` when there never was one.
    pub age_ns: Option<Nanos>,
    /// A frame was refused in this step.
    pub refused: bool,
    /// It was refused because it was not made with the sensor's key.
    pub unauthenticated: bool,
    /// What is implausible about the newest valid frame: [`vigil_types::Reason::BlindSensor`] and its like; no pilot was shown it then.
    pub sensor_faults: Reasons,
}

/// What the recovery pilot foresees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Risk {
    /// The pilot's action leads into something.
    pub collision_course: bool,
    /// The recovery pilot's own action leads into something that stopping avoids.
    pub recovery_course: bool,
    /// How fast the vehicle flies along the path that the recovery pilot plans, metres per second; 0 where it has none.
    pub speed_along_path_m_s: f32,
}

/// Everything guidance looks at in one step.
#[derive(Debug, Clone, Copy)]
pub struct GuidanceInput<'a> {
    /// Time of the step.
    pub now_ns: Nanos,
    /// What is known of the vehicle.
    pub telemetry: &'a VehicleTelemetry,
    /// Depth frames.
    pub frame: FrameStatus,
    /// The pilot's action. The pilot is asked in every step for which [`crate::Guidance::expects_action`] and in which there are a
    /// fresh frame, fresh finite telemetry and a goal; `None` when it was not asked.
    pub action: Option<Action>,
    /// The recovery pilot's action, asked together with the pilot; `None` without a recovery pilot.
    pub recovery: Option<Action>,
    /// What the detector says of the pilot's action; `None` without a detector.
    pub verdict: Option<Verdict>,
    /// What the recovery pilot foresees; `None` when it did not look, or there is none.
    pub risk: Option<Risk>,
    /// Share of one surface among the cells of this step's new frame in which something is seen; `None` without one.
    pub smooth_share: Option<f32>,
    /// Steps missed.
    pub timing: StepTiming,
    /// How it stands with the vehicle.
    pub vehicle: VehicleStatus,
}

/// What guidance decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidanceOutput {
    /// State after the step.
    pub state: GuidanceState,
    /// Conditions present in the step, those that caused its transition included.
    pub reasons: Reasons,
    /// The alarm, while it is raised.
    pub alarm: Option<Alarm>,
    /// The action of the pilot that flies, whether or not it may reach the vehicle.
    pub action: Option<Action>,
    /// The transition taken, if one was.
    pub transition: Option<&'static Transition>,
    /// What to send; `None` is silence.
    pub setpoint: Option<VelocitySetpoint>,
    /// What to ask of the vehicle.
    pub request: VehicleRequest,
}
