//! Flights that evaluate an actor: the frozen actor's own code, deciding every step, without noise.

use crate::actor_training::flight::Flight;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::actor::{Actor, Lead};
use vigil_policy::geometric::movers::Track;
use vigil_policy::{ActorInputs, FlightField, GeometricConfig, GeometricPilot, Pilot, PilotInput, RangeScan};
use vigil_types::{ACTION_LIMIT, Action, DEPTH_COLS, DEPTH_FULL_SCALE_M, DepthFrame, NedVector};
use vigil_vehicle::{ParamsError, Truth, Wind};
use vigil_world::{Course, Family, Mover, MoverShape, Outcome, generate, pixel_of};

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
    Geometric(KnownMovers),
}

/// What the geometric pilot knows of the movers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum KnownMovers {
    /// What it finds in the frames itself, as in flight.
    Followed,
    /// From the first moment that one is in view (120°, not hidden) all there is to know, for good.
    Seen,
    /// All there is to know, of all of them.
    All,
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

/// The geometric pilot, told of movers by the simulator.
struct KnowingPilot {
    pilot: Box<GeometricPilot>,
    known: KnownMovers,
    movers: Vec<Mover>,
    /// Which of them were in view.
    seen: Vec<bool>,
}

impl KnowingPilot {
    fn new(course: &Course, known: KnownMovers) -> Self {
        let config = GeometricConfig::default();
        let movers = course.movers.clone();
        Self {
            pilot: Box::new(match known {
                KnownMovers::Followed => GeometricPilot::new(config),
                KnownMovers::Seen | KnownMovers::All => GeometricPilot::knowing(config),
            }),
            known,
            seen: vec![known == KnownMovers::All; movers.len()],
            movers,
        }
    }

    fn decide(&mut self, flight: &Flight) -> Action {
        if self.known != KnownMovers::Followed {
            let truth = flight.truth();
            for (mover, seen) in self.movers.iter().zip(&mut self.seen) {
                *seen |= in_view(flight.frame(), &truth, mover);
            }
            let known = self.movers.iter().zip(&self.seen).filter(|(_, seen)| **seen);
            self.pilot
                .know_movers(known.map(|(mover, _)| track(mover, truth.at_ns)));
        }
        self.pilot.decide(&flight.input())
    }
}

/// What there is to know of a mover.
fn track(mover: &Mover, at_ns: u64) -> Track {
    const STEP_NS: u64 = 10_000_000;
    let (now, later) = (
        mover.solid_at(at_ns).centre_ned_m(),
        mover.solid_at(at_ns + STEP_NS).centre_ned_m(),
    );
    let velocity = (later - now) * (1e9 / STEP_NS as f32);
    let radius_m = match mover.shape {
        MoverShape::Column { radius_m } => radius_m,
        MoverShape::Box { length_m, width_m, .. } => 0.5 * length_m.hypot(width_m),
    };
    let lane_m = [mover.from_m, mover.to_m].map(|[north_m, east_m]| (north_m, east_m));
    let turns_after_s = mover.turns_in_s(at_ns);
    Track::known(
        (now.x, now.y),
        (velocity.x, velocity.y),
        radius_m,
        lane_m,
        turns_after_s,
    )
}

/// Whether the newest frame shows a mover: its middle, or what is less than a metre before that.
fn in_view(frame: &DepthFrame, truth: &Truth, mover: &Mover) -> bool {
    const OWN_M: f32 = 1.0;
    let here = truth.position_ned_m;
    let middle = mover.solid_at(truth.at_ns).centre_ned_m();
    let to = NedVector::new(middle.x - here.x, middle.y - here.y, 0.0);
    pixel_of(truth.attitude.to_frd(to))
        .and_then(|(row, column, range_m)| Some((frame.depth.get(row * DEPTH_COLS + column)?, range_m)))
        .is_some_and(|(seen_m, range_m)| *seen_m * DEPTH_FULL_SCALE_M > range_m - OWN_M)
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
        EvaluatedActor::Zero | EvaluatedActor::Random | EvaluatedActor::Geometric(_) => None,
    };
    let mut geometric = match actor {
        EvaluatedActor::Geometric(known) => Some(KnowingPilot::new(&course, known)),
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
                Some(pilot) => pilot.decide(&flight),
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
