//! How the vehicle moves, as far as telemetry is to be believed.
#![deny(clippy::std_instead_of_core, clippy::alloc_instead_of_core)]

use vigil_policy::PilotInput;
use vigil_types::{AttitudeSample, DepthFrame, GoalRelative, Kinematics, Nanos, NedVector, VehicleTelemetry};

/// Position, velocity and attitude that are fresh and finite.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    pub kinematics: Kinematics,
    pub sample: AttitudeSample,
}

impl Motion {
    /// What telemetry says, if it is all there, finite and at most so old.
    pub fn of(telemetry: &VehicleTelemetry, now_ns: Nanos, age_limit_ns: Nanos) -> Option<Self> {
        if telemetry.flight_data_age_ns(now_ns)? > age_limit_ns || !telemetry.is_finite() {
            return None;
        }
        Some(Self {
            kinematics: telemetry.kinematics?,
            sample: telemetry.attitude?,
        })
    }

    /// What a pilot may look at, its height above `ground_ned_m`. The distance to the goal is 0: who flies to one fills it in.
    pub fn pilot_input<'a>(&self, now_ns: Nanos, depth: &'a DepthFrame, ground_ned_m: NedVector) -> PilotInput<'a> {
        let Self {
            kinematics,
            sample: AttitudeSample { attitude, .. },
        } = *self;
        PilotInput {
            now_ns,
            depth,
            goal: GoalRelative::default(),
            attitude,
            velocity_m_s: kinematics.velocity_ned_m_s.to_heading(attitude.yaw_rad()),
            height_m: -(kinematics.position_ned_m - ground_ned_m).z,
        }
    }
}
