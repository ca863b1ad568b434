//! An environment flown by actions: guidance's law makes the setpoints, as in flight, and pilots see what they see there.

use std::ops::{Deref, DerefMut};
use vigil_guidance::{GuidanceConfig, guided_setpoint};
use vigil_policy::{PilotInput, RangeScan, apf};
use vigil_sim::environment::Environment;
use vigil_sim::world::Outcome;
use vigil_types::{Action, FASTEST_M_S};

/// One flight over one course, stepped at 20 Hz by actions, not by setpoints; else an environment.
pub struct Flight {
    environment: Environment,
    guidance: GuidanceConfig,
    surroundings: Box<RangeScan>,
}

impl Deref for Flight {
    type Target = Environment;

    fn deref(&self) -> &Environment {
        &self.environment
    }
}

impl DerefMut for Flight {
    fn deref_mut(&mut self) -> &mut Environment {
        &mut self.environment
    }
}

impl Flight {
    /// In an environment.
    pub fn of(environment: Environment) -> Self {
        Self {
            environment,
            // What is slower is so by its own actions.
            guidance: GuidanceConfig {
                speed_limit_m_s: FASTEST_M_S,
                ..GuidanceConfig::default()
            },
            surroundings: Box::new(RangeScan::new()),
        }
    }

    /// What a pilot may look at.
    pub fn input(&self) -> PilotInput<'_> {
        input(&self.environment)
    }

    /// The paper's potential field here and now, of the nearest surface within ±`half_angle_rad` of the nose
    /// and nearer than `range_m`.
    pub fn field(&mut self, half_angle_rad: f32, range_m: f32) -> Action {
        let input = input(&self.environment);
        let obstacle = self.surroundings.observe(&input).nearest_within(half_angle_rad);
        apf::force(input.goal, obstacle, range_m)
    }

    /// Flies one step of 50 ms under an action and takes the next frame. `Some` when the flight has ended.
    pub fn advance(&mut self, action: Action) -> Option<Outcome> {
        self.environment.advance(self.setpoint(action))
    }

    /// [`Self::advance`] without the next frame.
    pub fn advance_unseen(&mut self, action: Action) -> Option<Outcome> {
        self.environment.advance_unseen(self.setpoint(action))
    }

    fn setpoint(&self, action: Action) -> vigil_types::VelocitySetpoint {
        let position_ned_m = self.estimate().position_ned_m;
        guided_setpoint(&self.guidance, action, self.goal(), position_ned_m)
    }
}

fn input(environment: &Environment) -> PilotInput<'_> {
    let estimate = environment.estimate();
    PilotInput {
        now_ns: estimate.at_ns,
        depth: environment.frame(),
        goal: environment.goal_relative(),
        attitude: estimate.attitude,
        velocity_m_s: estimate.velocity_ned_m_s.to_heading(estimate.attitude.yaw_rad()),
        height_m: -estimate.position_ned_m.z,
    }
}
