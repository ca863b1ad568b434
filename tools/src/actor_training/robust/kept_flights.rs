//! States that an actor flies to, and what its teacher does in them.

use super::robust_config::RobustConfig;
use crate::actor_training::collector::CollectError;
use crate::actor_training::flight::Flight;
use crate::actor_training::noise::OrnsteinUhlenbeck;
use crate::actor_training::replay_buffer::pack_frame;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use vigil_nnet::Isa;
use vigil_policy::ActorInputs;
use vigil_policy::actor::{ACTOR_FRAMES, ACTOR_OUTPUTS, Actor, Lead, PositionalInputs};
use vigil_types::{Action, DEPTH_PIXELS};
use vigil_vehicle::Wind;
use vigil_world::generate;

/// Flights side by side; fixed, so that the states do not depend on the threads.
const PARTS: usize = 8;
/// Seeds of the flights; no others use them.
const FIRST_SEED: u64 = 800_000_000;
/// Frames are kept this often, in steps, or as often as the actor's ages ask for.
const KEPT_EVERY: usize = 4;
const THETA: f32 = 0.05;

/// A flight's kept frames, and what belongs to each.
struct KeptFlight {
    /// Contrast in 255ths, one frame after the other.
    frames: Vec<u8>,
    moments: Vec<(PositionalInputs, [f32; ACTOR_OUTPUTS])>,
}

/// A state, to look at.
pub struct KeptState<'a> {
    /// Five frames of contrast in 255ths, oldest first.
    pub frames: [&'a [u8]; ACTOR_FRAMES],
    /// The positional inputs.
    pub position: &'a PositionalInputs,
    /// What the teacher does.
    pub target: [f32; ACTOR_OUTPUTS],
}

/// Of one round.
pub struct KeptFlights {
    flights: Vec<KeptFlight>,
    /// Flight and moment of each state.
    index: Vec<(usize, usize)>,
    /// How many kept frames ago each of the five was taken, oldest first.
    ages: [usize; ACTOR_FRAMES],
}

/// Who flies and who teaches: two actors' parameters, which decide from the same.
#[derive(Clone, Copy)]
pub struct Pair<'a> {
    /// Flies.
    pub student: &'a [f32],
    /// Says what to do.
    pub teacher: &'a [f32],
    /// What both decide from.
    pub inputs: ActorInputs,
}

impl KeptFlights {
    /// Flies until there are enough.
    ///
    /// # Errors
    /// Parameters of another actor.
    pub fn fly(config: &RobustConfig, round: u64, pair: Pair<'_>) -> Result<Self, CollectError> {
        let step = pair
            .inputs
            .frame_ages
            .iter()
            .fold(KEPT_EVERY, |step, age| gcd(step, *age));
        let share = config.states.div_ceil(PARTS);
        let parts = (0..PARTS)
            .into_par_iter()
            .map(|part| fly_part(config, round, part as u64, share, step, pair))
            .collect::<Result<Vec<_>, _>>()?;
        let flights: Vec<KeptFlight> = parts.into_iter().flatten().collect();
        let numbered = flights.iter().enumerate();
        let index = numbered.flat_map(|(i, flight)| (0..flight.moments.len()).map(move |k| (i, k)));
        Ok(Self {
            index: index.collect(),
            flights,
            ages: pair.inputs.frame_ages.map(|age| age / step),
        })
    }

    /// How many states there are.
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// One of them. The first frame of a flight stands for the missing older ones, as in flight.
    pub fn state(&self, number: usize) -> KeptState<'_> {
        let (flight, moment) = self.index[number];
        let flight = &self.flights[flight];
        let (position, target) = &flight.moments[moment];
        KeptState {
            frames: self.ages.map(|age| {
                let at = moment.saturating_sub(age) * DEPTH_PIXELS;
                &flight.frames[at..at + DEPTH_PIXELS]
            }),
            position,
            target: *target,
        }
    }
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn fly_part(
    config: &RobustConfig,
    round: u64,
    part: u64,
    share: usize,
    step: usize,
    pair: Pair<'_>,
) -> Result<Vec<KeptFlight>, CollectError> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(1 + round * PARTS as u64 + part);
    let actor = |params| Actor::with_frame_ages(pair.inputs.spec(), Isa::detect(), params, pair.inputs.frame_ages);
    let (mut student, mut teacher) = (actor(pair.student)?, actor(pair.teacher)?);
    let mut seed = FIRST_SEED + config.seed.wrapping_mul(1 << 24) + (round * PARTS as u64 + part) * 4096;
    let (mut flights, mut states) = (Vec::new(), 0);
    while states < share {
        let family = config.families[rng.random_range(0..config.families.len())];
        let mut course = generate(family, seed);
        course.time_limit_s = config.time_limit_s;
        let mut flight = Flight::new(&course, Wind::default(), seed)?;
        seed += 1;
        let mut lead = Lead::new(pair.inputs);
        student.reset();
        teacher.reset();
        let mut wander = OrnsteinUhlenbeck::start(&mut rng);
        let sigma = if rng.random_bool(config.noise_share) {
            config.noise_sigma
        } else {
            0.0
        };
        let mut kept = KeptFlight {
            frames: Vec::new(),
            moments: Vec::new(),
        };
        for number in 0.. {
            let (_, position) = lead.inputs(&flight.input());
            let depth = &flight.frame().depth;
            let own = student.decide(depth, position)?;
            let target = teacher.decide(depth, position)?;
            if number % step == 0 {
                let at = kept.frames.len();
                kept.frames.resize(at + DEPTH_PIXELS, 0);
                pack_frame(depth, &mut kept.frames[at..]);
                kept.moments.push((position, target));
            }
            wander.step(THETA, &mut rng);
            let noise = wander.at(sigma);
            let action = Action {
                forward_m_s: own[0],
                yaw: own[1],
            };
            if flight.advance(vigil_policy::apf::add(action, noise)).is_some() || states + kept.moments.len() >= share {
                break;
            }
        }
        states += kept.moments.len();
        flights.push(kept);
    }
    Ok(flights)
}
