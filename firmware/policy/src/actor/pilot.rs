//! A flight stack's pilot: a learned one, alone or with the potential field added (docs/paper.md, Algorithm 1), or the
//! geometric one.

use crate::actor::{ACTOR_OUTPUTS, Actor, LowDim};
use crate::field::FlightField;
use crate::geometric::range_scan::RangeScan;
use crate::{GeometricPilot, ImportedPilot, Pilot, PilotInput};
use alloc::boxed::Box;
use vigil_nnet::ShapeError;
use vigil_types::{Ablation, Action};

/// A learned pilot without the vehicle around it.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "one per flight")]
pub enum Decider {
    /// An actor of ours.
    Actor(Actor),
    /// A policy of others.
    Imported(Box<ImportedPilot>),
}

impl Decider {
    /// Decides on the newest frame: forward speed in m/s, and yaw within ±1.5.
    ///
    /// # Errors
    /// A frame of another length.
    pub fn decide(&mut self, input: &PilotInput<'_>) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        match self {
            Self::Actor(actor) => actor.decide(input),
            Self::Imported(policy) => {
                let Action { forward_m_s, yaw } = policy.decide(input);
                Ok([forward_m_s, yaw])
            }
        }
    }

    /// Metres per second that one unit of its forward output is ([`Actor::unit_m_s`]).
    pub fn unit_m_s(&self) -> f32 {
        match self {
            Self::Actor(actor) => actor.unit_m_s(),
            Self::Imported(_) => 1.0,
        }
    }

    /// What it decided from beside frames and memory, in the last decision.
    pub fn low_dim(&self) -> Option<LowDim> {
        match self {
            Self::Actor(actor) => Some(actor.low_dim()),
            Self::Imported(policy) => policy.low_dim(),
        }
    }

    /// The values at its split point, of the last decision: the actor's 48, an imported policy's own; none without one.
    pub fn state(&self) -> &[f32] {
        match self {
            Self::Actor(actor) => actor.state(),
            Self::Imported(policy) => policy.state().unwrap_or_default(),
        }
    }
}

/// Flies what a learned pilot decides. Each step encodes the new frame only; an actor remembers what the frames before
/// it showed. No allocation after it was made.
#[derive(Debug, Clone)]
pub struct LearnedPilot {
    decider: Decider,
    surroundings: RangeScan,
    field: Option<FlightField>,
}

impl LearnedPilot {
    /// A pilot that has seen nothing. `field` adds the potential field to its action.
    pub fn new(decider: Decider, field: bool) -> Self {
        Self {
            decider,
            surroundings: RangeScan::new(),
            field: field.then(FlightField::default),
        }
    }

    /// The same pilot, something taken from its actor.
    #[must_use]
    pub fn without(self, what: Ablation) -> Self {
        let decider = match self.decider {
            Decider::Actor(actor) => Decider::Actor(actor.without(what)),
            imported => imported,
        };
        Self { decider, ..self }
    }
}

impl Pilot for LearnedPilot {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        let scan = self.surroundings.observe(input);
        let Ok([forward_m_s, yaw]) = self.decider.decide(input) else {
            // Only an actor of other dimensions refuses a frame. An action that is not finite makes the caller hold.
            return Action::new(f32::NAN, f32::NAN);
        };
        let own = Action { forward_m_s, yaw };
        let Some(field) = self.field.as_mut().filter(|_| own.is_finite()) else {
            return own;
        };
        let flown = field.add_to(own, self.decider.unit_m_s(), input, scan);
        if let Decider::Actor(actor) = &mut self.decider {
            actor.note_action(flown);
        }
        flown
    }

    fn reset(&mut self) {
        self.pause();
        if let Decider::Actor(actor) = &mut self.decider {
            actor.reset();
        }
    }

    fn pause(&mut self) {
        match &mut self.decider {
            Decider::Actor(actor) => actor.pause(),
            Decider::Imported(policy) => policy.reset(),
        }
        self.field = self.field.as_ref().map(|_| FlightField::default());
    }
}

/// The pilot of a flight stack, whichever it is. A large value: box it once at start.
#[derive(Debug, Clone)]
#[expect(
    clippy::large_enum_variant,
    reason = "one per process, and flight code does not allocate"
)]
pub enum FlightPilot {
    /// Goal seeking, potential field and memory.
    Geometric(GeometricPilot),
    /// A frozen actor, or a policy of others.
    Learned(LearnedPilot),
}

impl FlightPilot {
    /// What the last frame showed.
    pub fn surroundings(&self) -> &RangeScan {
        match self {
            Self::Geometric(pilot) => pilot.surroundings(),
            Self::Learned(pilot) => &pilot.surroundings,
        }
    }

    fn pilot(&mut self) -> &mut dyn Pilot {
        match self {
            Self::Geometric(pilot) => pilot,
            Self::Learned(pilot) => pilot,
        }
    }

    /// The learned pilot with what it remembers, as of the last decision; `None` without one.
    pub fn decider(&self) -> Option<&Decider> {
        match self {
            Self::Geometric(_) => None,
            Self::Learned(pilot) => Some(&pilot.decider),
        }
    }

    /// The actor, if one of ours flies.
    pub fn actor(&self) -> Option<&Actor> {
        match self.decider() {
            Some(Decider::Actor(actor)) => Some(actor),
            _ => None,
        }
    }
}

impl Pilot for FlightPilot {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        self.pilot().decide(input)
    }

    fn reset(&mut self) {
        self.pilot().reset();
    }

    fn pause(&mut self) {
        self.pilot().pause();
    }
}
