//! Flights that evaluate a pilot: the frozen actor's own code, deciding every step, without noise.

use crate::campaign::Tally;
use crate::explained::Flight;
use crate::trainer::observation::{Drift, Drifting};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use vigil_firmware::arguments::choice;
use vigil_nnet::Isa;
use vigil_policy::actor::Actor;
use vigil_policy::{FlightField, FrozenActor, GeometricConfig, GeometricPilot, Pilot, PilotInput, RangeScan};
use vigil_sim::environment::Environment;
use vigil_sim::family_parser;
use vigil_sim::vehicle::Wind;
use vigil_sim::world::{Family, Outcome, generate};
use vigil_types::{ACTION_LIMIT, Ablation, Action, Choice, NedVector};

/// Who decides.
#[derive(Debug, Clone, Copy)]
pub enum EvaluatedActor<'a> {
    /// An actor.
    Actor(&'a FrozenActor),
    /// No motion at all: what the field does alone.
    Zero,
    /// Each output drawn evenly anew each step.
    Random,
    /// The geometric pilot.
    Geometric,
}

/// Which flights.
#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct EvaluationSpec {
    /// Take something from the actor, as a control.
    #[arg(long = "ablate", value_name = "ABLATE", value_parser = choice::<Ablation>(), default_value = "nothing")]
    pub ablation: Ablation,

    /// How its odometry drifts.
    #[command(flatten)]
    pub drift: Drift,

    /// Number of flights; flight i uses seed SEED + i.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    pub flights: u64,

    /// First seed.
    #[arg(long = "seed", value_name = "SEED", default_value_t = 1)]
    pub first_seed: u64,

    /// Family of generated courses.
    #[arg(long, value_parser = family_parser(), default_value_t = Family::Validation)]
    pub family: Family,

    /// A flight that takes longer has failed, seconds.
    #[arg(long = "time-limit", value_name = "SECONDS", default_value_t = 90.0)]
    pub time_limit_s: f32,

    /// The potential field is added, as in flight.
    #[arg(skip)]
    pub field: bool,
}

/// How many flights ended how.
pub fn tally(flights: &[(Outcome, f64)]) -> Tally {
    let outcomes: Vec<_> = flights.iter().map(|(outcome, _)| Some(*outcome)).collect();
    Tally::of(&outcomes)
}

/// Mean time of those that reached the goal, seconds.
pub fn mean_time_s(flights: &[(Outcome, f64)]) -> Option<f64> {
    let arrived = flights.iter().filter(|(outcome, _)| *outcome == Outcome::Success);
    let times: Vec<f64> = arrived.map(|(_, time_s)| *time_s).collect();
    (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64)
}

/// Completion of a family.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FamilyCount {
    /// The family.
    pub family: Family,
    /// Seed of the first course.
    pub first_seed: u64,
    /// What was taken from the actor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ablation: Option<String>,
    /// Flights.
    pub flights: usize,
    /// Those at the goal.
    pub successes: usize,
    /// Those that hit something.
    pub collisions: usize,
    /// Those that took too long.
    pub time_outs: usize,
    /// 95 % Wilson interval of the completion.
    pub wilson_95: (f64, f64),
}

impl FamilyCount {
    /// Counts flights.
    pub fn new(what: &EvaluationSpec, flights: &[(Outcome, f64)]) -> Self {
        let tally = tally(flights);
        Self {
            family: what.family,
            first_seed: what.first_seed,
            ablation: (what.ablation != Ablation::Nothing).then(|| what.ablation.name().to_owned()),
            flights: tally.flights,
            successes: tally.completed,
            collisions: tally.collisions,
            time_outs: tally.time_outs,
            wilson_95: tally.wilson_95,
        }
    }

    /// Share of the flights at the goal.
    pub fn completion(&self) -> f64 {
        self.successes as f64 / self.flights.max(1) as f64
    }
}

/// Flies all flights in the current thread pool: outcome and time of each, in the order of the seeds.
///
/// # Errors
/// Parameters of another architecture.
pub fn evaluate(actor: EvaluatedActor<'_>, isa: Isa, what: &EvaluationSpec) -> Result<Vec<(Outcome, f64)>> {
    (0..what.flights)
        .into_par_iter()
        .map(|i| fly(actor, isa, what, what.first_seed.wrapping_add(i), |_, _, _| Ok(())))
        .collect()
}

/// Flies one; `each` gets the actor after each of its decisions, what it decided on but for the drift, and where the vehicle is.
pub(super) fn fly(
    actor: EvaluatedActor<'_>,
    isa: Isa,
    what: &EvaluationSpec,
    seed: u64,
    mut each: impl FnMut(&Actor, &PilotInput<'_>, NedVector) -> Result<()>,
) -> Result<(Outcome, f64)> {
    let mut course = generate(what.family, seed);
    course.time_limit_s = what.time_limit_s;
    let mut flight = Flight::of(Environment::new(&course, Wind::default(), seed)?);
    let mut network = match actor {
        EvaluatedActor::Actor(frozen) => Some(frozen.actor(isa)?.without(what.ablation)),
        EvaluatedActor::Zero | EvaluatedActor::Random | EvaluatedActor::Geometric => None,
    };
    let mut geometric = Box::new(GeometricPilot::new(GeometricConfig::default()));
    let mut drifting = Drifting::new(what.drift);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut surroundings = Box::new(RangeScan::new());
    let mut field = FlightField::default();
    loop {
        let mut action = match (&mut network, actor) {
            (Some(actor), _) => {
                let [forward_m_s, yaw] = drifting.with(&flight.input(), |input| actor.decide(input))?;
                each(actor, &flight.input(), flight.estimate().position_ned_m)?;
                Action { forward_m_s, yaw }
            }
            (None, EvaluatedActor::Geometric) => geometric.decide(&flight.input()),
            (None, EvaluatedActor::Random) => Action {
                forward_m_s: rng.random_range(-ACTION_LIMIT..ACTION_LIMIT),
                yaw: rng.random_range(-ACTION_LIMIT..ACTION_LIMIT),
            },
            (None, EvaluatedActor::Zero | EvaluatedActor::Actor(_)) => Action::HOVER,
        };
        if what.field {
            let input = flight.input();
            let unit_m_s = network.as_ref().map_or(1.0, Actor::unit_m_s);
            action = field.add_to(action, unit_m_s, &input, surroundings.observe(&input));
            if let Some(actor) = &mut network {
                actor.note_action(action);
            }
        }
        if let Some(outcome) = flight.advance(action) {
            return Ok((outcome, flight.time_s()));
        }
    }
}
