//! The learned pilot: a frozen actor, alone or with the potential field added (docs/paper.md, Algorithm 1).

use crate::actor::positional::{PositionalInputs, PositionalSense};
use crate::actor::{ACTOR_FRAMES, ACTOR_HIDDEN, Actor, ActorSpec, FRAMES_IN_A_ROW};
use crate::field::FlightField;
use crate::geometric::range_scan::RangeScan;
use crate::{GeometricPilot, ImportedPilot, Pilot, PilotInput, SeeingPilot};
use vigil_types::Action;

/// What an actor's second positional input is the bearing of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LedBy {
    /// The goal.
    #[default]
    Goal,
    /// The path planned to the goal over the occupancy grid of what the frames have shown: an actor that sees 1.6 s of frames has
    /// no other memory of a hall (docs/architecture.md).
    Path,
}

/// What an actor decides from, beside its weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ActorInputs {
    /// How many decisions ago each of its five frames was taken, oldest first.
    pub frame_ages: [usize; ACTOR_FRAMES],
    /// What its second positional input is the bearing of.
    pub led_by: LedBy,
    /// Whether it is told what moves near it ([`PositionalInputs`]).
    pub told_of_movers: bool,
}

impl ActorInputs {
    /// The network that decides from them.
    pub fn spec(&self) -> ActorSpec {
        if self.told_of_movers {
            ActorSpec::FULL_WITH_MOVERS
        } else {
            ActorSpec::FULL
        }
    }
}

impl Default for ActorInputs {
    fn default() -> Self {
        Self {
            frame_ages: FRAMES_IN_A_ROW,
            led_by: LedBy::Goal,
            told_of_movers: false,
        }
    }
}

/// Flies what a frozen actor decides. The goal of its input is what leads it: the goal, or for [`LedBy::Path`] what
/// [`RecoveryPilot::lead`](crate::RecoveryPilot::lead) gives. Each step encodes the new frame only; the actor remembers what the frames before it
/// gave. No allocation after it was made.
#[derive(Debug, Clone)]
pub struct ActorPilot {
    actor: Actor,
    surroundings: RangeScan,
    field: Option<FlightField>,
    sense: PositionalSense,
    position: Option<PositionalInputs>,
}

impl ActorPilot {
    /// A pilot that has seen nothing. `field` adds the potential field to the actor's action.
    pub fn new(actor: Actor, field: bool) -> Self {
        Self {
            sense: PositionalSense::new(actor.spec().told_of_movers),
            actor,
            surroundings: RangeScan::new(),
            field: field.then(FlightField::default),
            position: None,
        }
    }

    /// The positional inputs of the last decision; `None` before the first.
    pub fn position(&self) -> Option<PositionalInputs> {
        self.position
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
        let position = self.sense.inputs(input, scan, input.goal);
        self.position = Some(position);
        let Ok([forward_m_s, yaw]) = self.actor.decide(&input.depth.depth, position) else {
            // Only an actor of other dimensions refuses a frame. An action that is not finite makes the caller hold.
            return Action {
                forward_m_s: f32::NAN,
                yaw: f32::NAN,
            };
        };
        let own = Action { forward_m_s, yaw };
        match &mut self.field {
            Some(field) if own.is_finite() => field.add_to(own, input, scan),
            _ => own,
        }
    }

    fn reset(&mut self) {
        self.actor.reset();
        self.sense.reset();
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
    /// A frozen actor that a planner leads.
    Actor(ActorPilot),
    /// A frozen actor that looks and remembers.
    Seeing(SeeingPilot),
    /// A policy of others.
    Imported(ImportedPilot),
}

impl FlightPilot {
    /// What the last frame showed.
    pub fn surroundings(&self) -> &RangeScan {
        match self {
            Self::Geometric(pilot) => pilot.surroundings(),
            Self::Actor(pilot) => pilot.surroundings(),
            Self::Seeing(pilot) => pilot.surroundings(),
            Self::Imported(pilot) => pilot.surroundings(),
        }
    }

    /// The learned pilot's positional inputs of the last decision; `None` without one, and before its first.
    pub fn position(&self) -> Option<PositionalInputs> {
        match self {
            Self::Geometric(_) => None,
            Self::Actor(pilot) => pilot.position(),
            Self::Seeing(pilot) => pilot.position(),
            Self::Imported(pilot) => pilot.position(),
        }
    }

    /// The values at the split point, of the last decision: the actor's 48, an imported policy's own; `None` without one.
    pub fn state(&self) -> Option<&[f32]> {
        match self {
            Self::Geometric(_) => None,
            Self::Actor(pilot) => Some(pilot.state()),
            Self::Seeing(pilot) => Some(pilot.state()),
            Self::Imported(pilot) => pilot.state(),
        }
    }
}

impl Pilot for FlightPilot {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        match self {
            Self::Geometric(pilot) => pilot.decide(input),
            Self::Actor(pilot) => pilot.decide(input),
            Self::Seeing(pilot) => pilot.decide(input),
            Self::Imported(pilot) => pilot.decide(input),
        }
    }

    fn reset(&mut self) {
        match self {
            Self::Geometric(pilot) => pilot.reset(),
            Self::Actor(pilot) => pilot.reset(),
            Self::Seeing(pilot) => pilot.reset(),
            Self::Imported(pilot) => pilot.reset(),
        }
    }
}
