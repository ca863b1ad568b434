//! The learned pilot: a frozen actor, alone or with the potential field added (docs/paper.md, Algorithm 1).

use crate::actor::{ACTOR_HIDDEN, Actor, LowDim};
use crate::field::FlightField;
use crate::geometric::range_scan::RangeScan;
use crate::{GeometricPilot, ImportedPilot, Pilot, PilotInput};
use vigil_types::{Ablation, Action};

/// Flies what a frozen actor decides. Each step encodes the new frame only; the actor remembers what the frames before it showed. No
/// allocation after it was made.
#[derive(Debug, Clone)]
pub struct ActorPilot {
    actor: Actor,
    surroundings: RangeScan,
    field: Option<FlightField>,
    /// The observation of the last decision; `None` before the first.
    low_dim: Option<LowDim>,
}

impl ActorPilot {
    /// A pilot that has seen nothing. `field` adds the potential field to the actor's action.
    pub fn new(actor: Actor, field: bool) -> Self {
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
    pub fn low_dim(&self) -> Option<LowDim> {
        self.low_dim
    }

    /// The network with what it remembers, as of the last decision.
    pub fn actor(&self) -> &Actor {
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

impl Pilot for ActorPilot {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        let scan = self.surroundings.observe(input);
        let Ok([forward_m_s, yaw]) = self.actor.decide(input) else {
            // Only an actor of other dimensions refuses a frame. An action that is not finite makes the caller hold.
            return Action::new(f32::NAN, f32::NAN);
        };
        self.low_dim = Some(self.actor.low_dim());
        let own = Action { forward_m_s, yaw };
        match &mut self.field {
            Some(field) if own.is_finite() => {
                let flown = field.add_to(own, self.actor.unit_m_s(), input, scan);
                self.actor.note_action(flown);
                flown
            }
            _ => own,
        }
    }

    fn reset(&mut self) {
        self.pause();
        self.actor.reset();
    }

    fn pause(&mut self) {
        self.actor.pause();
        self.low_dim = None;
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
    /// A frozen actor.
    Actor(ActorPilot),
    /// A policy of others.
    Imported(ImportedPilot),
}

impl FlightPilot {
    /// What the last frame showed.
    pub fn surroundings(&self) -> &RangeScan {
        match self {
            Self::Geometric(pilot) => pilot.surroundings(),
            Self::Actor(pilot) => pilot.surroundings(),
            Self::Imported(pilot) => pilot.surroundings(),
        }
    }

    fn pilot(&mut self) -> &mut dyn Pilot {
        match self {
            Self::Geometric(pilot) => pilot,
            Self::Actor(pilot) => pilot,
            Self::Imported(pilot) => pilot,
        }
    }

    /// The learned pilot's low-dimensional observation of the last decision; `None` without one, and before its first.
    pub fn low_dim(&self) -> Option<LowDim> {
        match self {
            Self::Geometric(_) => None,
            Self::Actor(pilot) => pilot.low_dim(),
            Self::Imported(pilot) => pilot.low_dim(),
        }
    }

    /// How often a jump of the odometry made the actor forget everything.
    pub fn forgotten(&self) -> u32 {
        match self {
            Self::Actor(pilot) => pilot.actor.forgotten(),
            Self::Geometric(_) | Self::Imported(_) => 0,
        }
    }

    /// The values at the split point, of the last decision: the actor's 48, an imported policy's own; `None` without one.
    pub fn state(&self) -> Option<&[f32]> {
        match self {
            Self::Geometric(_) => None,
            Self::Actor(pilot) => Some(pilot.state()),
            Self::Imported(pilot) => pilot.state(),
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
