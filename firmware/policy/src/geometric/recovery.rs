//! The recovery pilot: flies on when an attack on the depth frames is detected, or the actor is about to fly into something
//! (docs/detection.md). The path that it plans meanwhile leads an imported policy to a far goal.

use crate::geometric::governor::REACTION_S;
use crate::geometric::pilot::{LEAST_LEAD_M, position_ned_m};
use crate::{GeometricConfig, GeometricPilot, Pilot, PilotInput};
use vigil_types::{Action, GoalRelative, NedVector, wrap_pi};

/// So long the actor is taken to go on as it does, seconds. With the 0.2 s alone that go by before braking begins, the alarm came too late for most
/// of what it was raised for; with more it is raised beside what the actor would have passed (docs/robustness.md).
const FORESIGHT_S: f32 = 0.7;
/// Fastest forward speed, metres per second: slower than the actor, which believes each frame.
const CRUISE_M_S: f32 = 0.8;

/// The pilot. It observes in every step, also while another one flies, so that it remembers what trusted frames showed.
/// A large value without pointers; no allocation.
#[derive(Debug, Clone)]
pub struct RecoveryPilot {
    pilot: GeometricPilot,
    /// The farthest point of the path that can be flown to in a straight line, since the last observation.
    waypoint: Option<NedVector>,
}

impl Default for RecoveryPilot {
    /// A pilot that remembers nothing.
    fn default() -> Self {
        let config = GeometricConfig {
            cruise_m_s: CRUISE_M_S,
            ..GeometricConfig::default()
        };
        Self {
            pilot: GeometricPilot::of(true, config),
            waypoint: None,
        }
    }
}

impl RecoveryPilot {
    /// Enters the frame into the grid and plans on: a slice of the search. To be asked once in every step, before the others. `flying`
    /// says whether the vehicle was flown by this pilot or along its path in the step before: only then may standing still
    /// mean that its memory is wrong.
    pub fn observe(&mut self, input: &PilotInput<'_>, flying: bool) {
        if !flying {
            self.pilot.excuse_standstill();
        }
        self.waypoint = self.pilot.plan(input);
    }

    /// The pilot below it, with its grid and its path.
    pub fn mapping(&self) -> &GeometricPilot {
        &self.pilot
    }

    /// The local goal of an actor: bearing of the planned path, distance of the goal; without a path the goal as it is. After [`Self::observe`], with
    /// the same input.
    pub fn path_ahead(&self, input: &PilotInput<'_>) -> GoalRelative {
        let to_waypoint = self.waypoint.map(|waypoint| waypoint - position_ned_m(input));
        match to_waypoint.filter(|to| to.horizontal_norm() > LEAST_LEAD_M) {
            None => input.goal,
            Some(to) => GoalRelative {
                bearing_rad: wrap_pi(libm::atan2f(to.y, to.x) - input.attitude.yaw_rad()),
                ..input.goal
            },
        }
    }

    /// Decides. After [`Self::observe`], with the same input.
    pub fn decide(&self, input: &PilotInput<'_>) -> Action {
        self.pilot.steer(input, self.waypoint).0
    }

    /// How fast the vehicle flies along the planned path, metres per second: the part of its horizontal velocity that points to the waypoint;
    /// `None` without a path, or at its end. After [`Self::observe`], with the same input.
    pub fn speed_along_path_m_s(&self, input: &PilotInput<'_>) -> Option<f32> {
        let to_waypoint = self.waypoint? - position_ned_m(input);
        let distance_m = to_waypoint.horizontal_norm();
        let velocity_m_s = input.velocity_m_s.to_ned(input.attitude.yaw_rad());
        let along_m2_s = velocity_m_s.x * to_waypoint.x + velocity_m_s.y * to_waypoint.y;
        (distance_m > LEAST_LEAD_M).then(|| along_m2_s / distance_m)
    }

    /// Forgets everything it remembered: a new flight.
    pub fn reset(&mut self) {
        self.pilot.reset();
        self.waypoint = None;
    }

    /// Whether the actor's action runs into something that many frames have shown, even if the vehicle is ordered to stop 0.7 s later. After
    /// [`Self::observe`], with the same input.
    pub fn foresees_collision(&self, input: &PilotInput<'_>, action: Action) -> bool {
        self.pilot.foresees_collision(input, action, FORESIGHT_S)
    }

    /// Whether this pilot's own action, which is chosen anew with every frame, does so within 0.2 s, where stopping would help: in a cell that was marked wrongly, say,
    /// it would stand for ever.
    pub fn foresees_own_collision(&self, input: &PilotInput<'_>, own: Action) -> bool {
        let foresees = |action| self.pilot.foresees_collision(input, action, REACTION_S);
        foresees(own) && !foresees(Action::HOVER)
    }
}
