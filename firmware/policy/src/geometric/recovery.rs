//! The recovery pilot: flies on when an attack on the depth frames is detected, or the actor is about to fly into something
//! (docs/detection.md).

use crate::{GeometricConfig, GeometricPilot, Pilot, PilotInput};
use vigil_types::Action;

/// Fastest forward speed, metres per second: slower than the actor, which believes each frame.
const CRUISE_M_S: f32 = 0.8;

/// The pilot. It is asked in every step, also while another one flies, so that it remembers what trusted frames showed.
/// A large value without pointers; no allocation.
#[derive(Debug, Clone)]
pub struct RecoveryPilot {
    pilot: GeometricPilot,
}

impl RecoveryPilot {
    /// A pilot that remembers nothing.
    pub fn new() -> Self {
        Self {
            pilot: GeometricPilot::recovery(GeometricConfig {
                cruise_m_s: CRUISE_M_S,
                ..GeometricConfig::default()
            }),
        }
    }

    /// Decides. `flying` says whether this pilot's last action reached the vehicle.
    pub fn decide(&mut self, input: &PilotInput<'_>, flying: bool) -> Action {
        if !flying {
            self.pilot.excuse_standstill();
        }
        self.pilot.decide(input)
    }

    /// Forgets everything it remembered: a new flight.
    pub fn reset(&mut self) {
        self.pilot.reset();
    }

    /// Whether the actor's action leads into something that many frames have shown, even if the vehicle is told to stop 0.2 s
    /// later. To be asked after [`Self::decide`], with the same input.
    pub fn foresees_collision(&self, input: &PilotInput<'_>, action: Action) -> bool {
        self.pilot.foresees_collision(input, action)
    }
}

impl Default for RecoveryPilot {
    fn default() -> Self {
        Self::new()
    }
}
