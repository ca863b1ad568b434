//! What an action becomes on its way to the vehicle.

use crate::GuidanceConfig;
use vigil_types::{Action, Goal, HeadingVector, NedVector, VelocitySetpoint};

/// Off the goal's height by no more than this the vehicle flies ahead as it is asked to, and not at all beyond the second, metres.
const LEVEL_M: f32 = 0.5;
const OFF_LEVEL_M: f32 = 1.0;
/// Vertical speed per metre of height error, 1/s, and the greatest one, metres per second.
const HEIGHT_GAIN_PER_S: f32 = 0.8;
const VERTICAL_LIMIT_M_S: f32 = 0.5;

/// Whether a vehicle that is so far above or below the goal's height changes it first, where it is: what stands in its way there is not
/// at the height that its pilot looks at.
pub fn changes_height(goal: Goal, position_ned_m: NedVector) -> bool {
    (goal.position_ned_m.z - position_ned_m.z).abs() > OFF_LEVEL_M
}

/// The setpoint of guided flight: the action within the limit of speed, and a bounded vertical speed that keeps the goal's
/// height. Far from that height the vehicle climbs or descends where it is. Hold where any of it is not finite.
/// `position_ned_m` and the goal are metres from the local origin.
pub fn guided_setpoint(
    config: &GuidanceConfig,
    action: Action,
    goal: Goal,
    position_ned_m: NedVector,
) -> VelocitySetpoint {
    let action = action.within(config.speed_limit_m_s);
    let below_m = goal.position_ned_m.z - position_ned_m.z;
    let down_m_s = (HEIGHT_GAIN_PER_S * below_m).clamp(-VERTICAL_LIMIT_M_S, VERTICAL_LIMIT_M_S);
    let level = ((OFF_LEVEL_M - below_m.abs()) / (OFF_LEVEL_M - LEVEL_M)).clamp(0.0, 1.0);
    let setpoint = VelocitySetpoint {
        velocity_m_s: HeadingVector::new(level * action.forward_m_s, 0.0, down_m_s),
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
    fn a_vehicle_far_from_the_goals_height_changes_it_where_it_is() {
        let config = GuidanceConfig::default();
        let goal = Goal {
            position_ned_m: NedVector::new(20.0, 0.0, -2.0),
        };
        let ahead = Action::new(1.2, 0.3);
        let forward_m_s = |height_m: f32| {
            let here = NedVector::new(0.0, 0.0, -height_m);
            let setpoint = guided_setpoint(&config, ahead, goal, here);
            assert_eq!(changes_height(goal, here), setpoint.velocity_m_s.x == 0.0, "{height_m}");
            setpoint.velocity_m_s.x
        };
        assert_eq!([6.0, 3.1, 0.9, 0.5].map(forward_m_s), [0.0; 4]);
        assert_eq!([2.5, 2.0, 1.5].map(forward_m_s), [1.2; 3]);
        assert!((forward_m_s(2.75) - 0.6).abs() < 1e-5);
        let nowhere = NedVector::new(0.0, 0.0, f32::NAN);
        assert_eq!(guided_setpoint(&config, ahead, goal, nowhere), VelocitySetpoint::HOLD);
    }
}
