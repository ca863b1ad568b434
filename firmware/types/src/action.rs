//! What a pilot decides and what is sent to the vehicle.

use crate::{AttitudeSample, HeadingVector, Kinematics, NedVector, wrap_pi};
use core::f32::consts::PI;

/// Both outputs of a pilot lie in ±1.5 (docs/paper.md, "Actor").
pub const ACTION_LIMIT: f32 = 1.5;
/// The fastest forward speed that is asked of a vehicle: an actor's whose unit is 2 m/s.
pub const FASTEST_M_S: f32 = 2.0 * ACTION_LIMIT;
/// One unit of the yaw output is 30 °/s (docs/paper.md, "Action").
pub const YAW_RATE_PER_UNIT_RAD_S: f32 = 30.0 * PI / 180.0;

/// A pilot's decision in the paper's action units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Action {
    /// Forward velocity, metres per second, in ±[`ACTION_LIMIT`] unless an actor was trained to be faster.
    pub forward_m_s: f32,
    /// Yaw output in ±[`ACTION_LIMIT`]; one unit is 30 °/s clockwise ([`YAW_RATE_PER_UNIT_RAD_S`]).
    pub yaw: f32,
}

impl Action {
    /// No motion.
    pub const HOVER: Self = Self::new(0.0, 0.0);

    /// A decision of its two outputs.
    pub const fn new(forward_m_s: f32, yaw: f32) -> Self {
        Self { forward_m_s, yaw }
    }

    /// Limits both outputs to ±[`ACTION_LIMIT`].
    pub fn clipped(self) -> Self {
        self.within(ACTION_LIMIT)
    }

    /// Limits the forward speed, and the yaw output to ±[`ACTION_LIMIT`].
    #[must_use]
    pub fn within(self, limit_m_s: f32) -> Self {
        Self::new(
            self.forward_m_s.clamp(-limit_m_s, limit_m_s),
            self.yaw.clamp(-ACTION_LIMIT, ACTION_LIMIT),
        )
    }

    /// The same with its forward speed times `factor`: from a pilot's units, which the potential field is in too, to metres per second and
    /// back.
    #[must_use]
    pub fn scaled(self, factor: f32) -> Self {
        Self::new(self.forward_m_s * factor, self.yaw)
    }

    /// Whether both outputs are finite.
    pub fn is_finite(self) -> bool {
        self.forward_m_s.is_finite() && self.yaw.is_finite()
    }

    /// Yaw rate in radians per second, clockwise.
    pub fn yaw_rate_rad_s(self) -> f32 {
        self.yaw * YAW_RATE_PER_UNIT_RAD_S
    }
}

/// What goes to the vehicle each step: SET_POSITION_TARGET_LOCAL_NED, frame 8, mask 0x5C7 (docs/mavlink.md).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VelocitySetpoint {
    /// Velocity in level axes along the heading.
    pub velocity_m_s: HeadingVector,
    /// Yaw rate, clockwise seen from above.
    pub yaw_rate_rad_s: f32,
}

impl VelocitySetpoint {
    /// Hover: the explicit hold that answers every invalid, stale or missing input.
    pub const HOLD: Self = Self {
        velocity_m_s: HeadingVector::ZERO,
        yaw_rate_rad_s: 0.0,
    };

    /// Whether all components are finite.
    pub fn is_finite(self) -> bool {
        self.velocity_m_s.is_finite() && self.yaw_rate_rad_s.is_finite()
    }
}

/// Where to fly.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Goal {
    /// Metres from the local origin; z is the height to fly at (down positive).
    pub position_ned_m: NedVector,
}

/// The goal as the pilot sees it: the paper's two positional inputs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GoalRelative {
    /// Horizontal distance in metres.
    pub distance_m: f32,
    /// Bearing relative to the heading, positive to the right, in (−π, π].
    pub bearing_rad: f32,
}

impl GoalRelative {
    /// A goal at this distance and bearing.
    pub const fn new(distance_m: f32, bearing_rad: f32) -> Self {
        Self {
            distance_m,
            bearing_rad,
        }
    }
}

impl Goal {
    /// Distance and bearing of the goal from where the vehicle is.
    pub fn relative_to(&self, kinematics: &Kinematics, attitude: &AttitudeSample) -> GoalRelative {
        let to_goal = self.position_ned_m - kinematics.position_ned_m;
        let bearing_ned_rad = libm::atan2f(to_goal.y, to_goal.x);
        GoalRelative::new(
            to_goal.horizontal_norm(),
            wrap_pi(bearing_ned_rad - attitude.attitude.yaw_rad()),
        )
    }
}
