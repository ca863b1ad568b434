//! The learned pilot: a frozen actor, alone or with the potential field added (docs/paper.md, Algorithm 1).

use crate::actor::{ACTOR_HIDDEN, PositionalInputs};
use crate::field::FlightField;
use crate::geometric::range_scan::RangeScan;
use crate::seeing::SeeingActor;
use crate::{Pilot, PilotInput};
use vigil_types::{Ablation, Action};

/// Flies what a frozen actor decides. Each step encodes the new frame only; the actor remembers what the frames before it showed. No
/// allocation after it was made.
#[derive(Debug, Clone)]
pub struct SeeingPilot {
    actor: SeeingActor,
    surroundings: RangeScan,
    field: Option<FlightField>,
    /// The observation of the last decision; `None` before the first.
    low_dim: Option<PositionalInputs>,
}

impl SeeingPilot {
    /// A pilot that has seen nothing. `field` adds the potential field to the actor's action.
    pub fn new(actor: SeeingActor, field: bool) -> Self {
        Self {
            actor,
            surroundings: RangeScan::new(),
            field: field.then(FlightField::default),
            low_dim: None,
        }
    }

    /// The same pilot, something taken from its actor.
    #[must_use]
    pub fn without(mut self, what: Ablation) -> Self {
        self.actor = self.actor.without(what);
        self
    }

    /// The low-dimensional observation of the last decision; `None` before the first.
    pub fn position(&self) -> Option<PositionalInputs> {
        self.low_dim
    }

    /// The network with what it remembers, as of the last decision.
    pub fn actor(&self) -> &SeeingActor {
        &self.actor
    }

    /// What the last frame showed.
    pub fn surroundings(&self) -> &RangeScan {
        &self.surroundings
    }

    /// The 48 values at the paper's split point, of the last decision.
    pub fn state(&self) -> &[f32; ACTOR_HIDDEN] {
        self.actor.state()
    }
}

impl Pilot for SeeingPilot {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        let scan = self.surroundings.observe(input);
        let Ok([forward_m_s, yaw]) = self.actor.decide(input) else {
            // Only an actor of other dimensions refuses a frame. An action that is not finite makes the caller hold.
            return Action {
                forward_m_s: f32::NAN,
                yaw: f32::NAN,
            };
        };
        self.low_dim = Some(self.actor.low_dim());
        let own = Action { forward_m_s, yaw };
        match &mut self.field {
            Some(field) if own.is_finite() => {
                let flown = field.add_to(own, input, scan);
                self.actor.note_action(flown);
                flown
            }
            _ => own,
        }
    }

    fn reset(&mut self) {
        self.actor.reset();
        self.low_dim = None;
        self.field = self.field.as_ref().map(|_| FlightField::default());
    }
}
