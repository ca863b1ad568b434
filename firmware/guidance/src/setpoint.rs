//! What an action becomes on its way to the vehicle.

use crate::GuidanceConfig;
use vigil_types::{Action, Goal, HeadingVector, NedVector, VelocitySetpoint};

/// The setpoint of guided flight: the clipped action, and a bounded vertical speed that keeps the goal's height. Hold where any of
/// it is not finite. `position_ned_m` and the goal are metres from the local origin.
pub fn guided_setpoint(
    config: &GuidanceConfig,
    action: Action,
    goal: Goal,
    position_ned_m: NedVector,
) -> VelocitySetpoint {
    let action = action.clipped();
    let below_m = goal.position_ned_m.z - position_ned_m.z;
    let limit_m_s = config.vertical_limit_m_s;
    let down_m_s = (config.height_gain_per_s * below_m).clamp(-limit_m_s, limit_m_s);
    let setpoint = VelocitySetpoint {
        velocity_m_s: HeadingVector::new(action.forward_m_s, 0.0, down_m_s),
        yaw_rate_rad_s: action.yaw_rate_rad_s(),
    };
    if setpoint.is_finite() {
        setpoint
    } else {
        VelocitySetpoint::HOLD
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_goals_height_is_approached_within_the_vertical_limit() {
        let config = GuidanceConfig::default();
        let goal = Goal {
            position_ned_m: NedVector::new(20.0, 0.0, -2.5),
        };
        let at = |down_m| guided_setpoint(&config, Action::HOVER, goal, NedVector::new(0.0, 0.0, down_m));
        assert_eq!(at(-2.5), VelocitySetpoint::HOLD);
        let climbs_m_s = -at(-2.4).velocity_m_s.z;
        assert!(
            (climbs_m_s - 0.1 * config.height_gain_per_s).abs() < 1e-6,
            "{climbs_m_s}"
        );
        assert_eq!(at(0.0).velocity_m_s.z, -config.vertical_limit_m_s);
        assert_eq!(at(f32::NAN), VelocitySetpoint::HOLD);
    }
}
