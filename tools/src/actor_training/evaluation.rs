//! Flights that evaluate an actor: the frozen actor's own code, deciding every step, without noise.

use crate::actor_training::flight::Flight;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::actor::{Actor, Lead};
use vigil_policy::{ActorInputs, FlightField, GeometricConfig, GeometricPilot, Pilot, PilotInput, RangeScan};
use vigil_types::{ACTION_LIMIT, Action};
use vigil_vehicle::{ParamsError, Wind};
use vigil_world::{Family, Outcome, generate};

/// Who decides.
#[derive(Debug, Clone, Copy)]
pub enum EvaluatedActor<'a> {
    /// An actor's parameters, and what it decides from.
    Actor(&'a [f32], ActorInputs),
    /// No motion at all: what the field does alone.
    Zero,
    /// Each output drawn evenly anew each step.
    Random,
    /// The geometric pilot.
    Geometric,
}

/// Which flights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvaluationSpec {
    /// Family of courses.
    pub family: Family,
    /// First seed.
    pub first_seed: u64,
    /// How many.
    pub flights: u64,
    /// A flight that takes longer has failed.
    pub time_limit_s: f32,
    /// The potential field is added, as in flight.
    pub field: bool,
}

/// How they ended.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EvaluationResult {
    /// Outcome and time of each flight, in the order of the seeds.
    pub flights: Vec<(Outcome, f64)>,
}

impl EvaluationResult {
    /// Number of flights with an outcome.
    pub fn count(&self, outcome: Outcome) -> usize {
        self.flights.iter().filter(|(o, _)| *o == outcome).count()
    }

    /// Number of flights that reached the goal.
    pub fn successes(&self) -> usize {
        self.count(Outcome::Success)
    }

    /// Share of flights that reached the goal.
    pub fn completion(&self) -> f64 {
        self.successes() as f64 / self.flights.len().max(1) as f64
    }

    /// Mean time of those that did, seconds.
    pub fn mean_time_s(&self) -> Option<f64> {
        let times = self
            .flights
            .iter()
            .filter(|(o, _)| *o == Outcome::Success)
            .map(|(_, t)| t);
        (self.successes() > 0).then(|| times.sum::<f64>() / self.successes() as f64)
    }
}

/// Why an evaluation could not be made.
#[derive(Debug, thiserror::Error)]
pub enum RolloutError {
    /// The vehicle.
    #[error(transparent)]
    Vehicle(#[from] ParamsError),
    /// The actor does not fit.
    #[error(transparent)]
    Network(#[from] ShapeError),
}

/// Flies all flights in the current thread pool.
///
/// # Errors
/// Parameters of another architecture.
pub fn evaluate(actor: EvaluatedActor<'_>, isa: Isa, what: &EvaluationSpec) -> Result<EvaluationResult, RolloutError> {
    let flights = (0..what.flights)
        .into_par_iter()
        .map(|i| fly(actor, isa, what, what.first_seed.wrapping_add(i)))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(EvaluationResult { flights })
}

fn fly(actor: EvaluatedActor<'_>, isa: Isa, what: &EvaluationSpec, seed: u64) -> Result<(Outcome, f64), RolloutError> {
    let mut course = generate(what.family, seed);
    course.time_limit_s = what.time_limit_s;
    let mut flight = Flight::new(&course, Wind::default(), seed)?;
    let mut network = match actor {
        EvaluatedActor::Actor(params, inputs) => {
            let ages = inputs.frame_ages;
            Some(Actor::with_frame_ages(inputs.spec(), isa, params, ages)?)
        }
        EvaluatedActor::Zero | EvaluatedActor::Random | EvaluatedActor::Geometric => None,
    };
    let mut geometric = match actor {
        EvaluatedActor::Geometric => Some(Box::new(GeometricPilot::new(GeometricConfig::default()))),
        _ => None,
    };
    let mut lead = match actor {
        EvaluatedActor::Actor(_, inputs) => Lead::new(inputs),
        _ => Lead::new(ActorInputs::default()),
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut surroundings = Box::new(RangeScan::new());
    let mut field = FlightField::default();
    loop {
        let (goal, position) = lead.inputs(&flight.input());
        let mut action = match (&mut network, actor) {
            (Some(actor), _) => {
                let [forward_m_s, yaw] = actor.decide(&flight.frame().depth, position)?;
                Action { forward_m_s, yaw }
            }
            (None, EvaluatedActor::Random) => Action {
                forward_m_s: rng.random_range(-ACTION_LIMIT..ACTION_LIMIT),
                yaw: rng.random_range(-ACTION_LIMIT..ACTION_LIMIT),
            },
            (None, _) => match &mut geometric {
                Some(pilot) => pilot.decide(&flight.input()),
                None => Action::HOVER,
            },
        };
        if what.field {
            let input = PilotInput { goal, ..flight.input() };
            action = field.add_to(action, &input, surroundings.observe(&input));
        }
        if let Some(outcome) = flight.advance(action) {
            return Ok((outcome, flight.time_s()));
        }
    }
}
