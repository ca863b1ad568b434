//! What the flight stack is made from.

use vigil_guidance::{GuidanceConfig, JustStopConfig};
use vigil_mavlink::CompanionConfig;
use vigil_policy::GeometricConfig;
use vigil_types::{Duty, Goal};

/// What the flight stack is made from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StackConfig {
    /// The sensor whose frames are accepted.
    pub sensor_id: u32,
    /// Guidance.
    pub guidance: GuidanceConfig,
    /// MAVLink towards the vehicle.
    pub companion: CompanionConfig,
    /// The geometric pilot.
    pub pilot: GeometricConfig,
    /// Where to fly, from home; `None` waits for an operator.
    pub goal: Option<Goal>,
    /// Whether frames are checked before the pilots see them (docs/sensor-faults.md).
    pub plausibility: bool,
    /// Whether a second sensor must see nothing nearer than the frames show (docs/second-sensor.md).
    pub second_sensor: bool,
    /// Whether somebody else's flight is guarded while guidance has not the vehicle (docs/just-stop.md).
    pub duty: Duty,
    /// How a guarded vehicle stops.
    pub just_stop: JustStopConfig,
}
