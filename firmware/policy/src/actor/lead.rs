//! Where an actor is led outside of the flight stack, and what it is told, step by step as in it.

extern crate alloc;

use crate::actor::{ActorInputs, LedBy, PositionalInputs, PositionalSense};
use crate::{GeometricConfig, GeometricPilot, PilotInput, RangeScan, RecoveryPilot};
use alloc::boxed::Box;
use vigil_types::{Action, GoalRelative};

/// Leads an actor to the goal as it is, or along the path planned over what the frames have shown, and follows what moves if the actor is
/// told of it. To be asked once in every step.
#[derive(Debug, Clone)]
pub struct Lead {
    planner: Planner,
    surroundings: Option<Box<RangeScan>>,
    sense: PositionalSense,
}

#[derive(Debug, Clone)]
enum Planner {
    /// The goal as it is.
    None,
    /// Of an actor that is told of the goal alone.
    Recovery(Box<RecoveryPilot>),
    /// Of an actor that is told of movers: they are not in the way, when to fly is the actor's business.
    Mapping(Box<GeometricPilot>),
}

impl Lead {
    /// What has seen nothing, of an actor with these inputs.
    pub fn new(inputs: ActorInputs) -> Self {
        Self {
            planner: match (inputs.led_by, inputs.told_of_movers) {
                (LedBy::Goal, _) => Planner::None,
                (LedBy::Path, false) => Planner::Recovery(Box::default()),
                (LedBy::Path, true) => Planner::Mapping(Box::new(GeometricPilot::new(GeometricConfig::default()))),
            },
            surroundings: inputs.told_of_movers.then(Box::default),
            sense: PositionalSense::new(inputs.told_of_movers),
        }
    }

    /// Whether it needs a frame in each step.
    pub fn looks(&self) -> bool {
        !matches!(self.planner, Planner::None) || self.surroundings.is_some()
    }

    /// Where it leads now, and what the actor decides from beside its frames.
    pub fn inputs(&mut self, input: &PilotInput<'_>) -> (GoalRelative, PositionalInputs) {
        let goal = match &mut self.planner {
            Planner::None => input.goal,
            Planner::Recovery(planner) => {
                planner.observe(input, true);
                planner.lead(input)
            }
            Planner::Mapping(planner) => planner.lead(input),
        };
        let position = match &mut self.surroundings {
            None => PositionalInputs::of_goal(goal),
            Some(surroundings) => self.sense.inputs(input, surroundings.observe(input), goal),
        };
        (goal, position)
    }

    /// What the geometric pilot that plans the path would do itself, after [`Self::inputs`] with the same input; `None` where another leads.
    /// A teacher that knows no more than the actor.
    pub fn teacher(&self, input: &PilotInput<'_>) -> Option<Action> {
        match &self.planner {
            Planner::Mapping(pilot) => Some(pilot.along_lead(input)),
            Planner::None | Planner::Recovery(_) => None,
        }
    }
}
