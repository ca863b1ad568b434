//! States that an actor meets in flight: five frames and where the goal is.

use crate::actor_training::Flight;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_nnet::{ACTOR_FRAMES, Actor, ActorSpec, Isa};
use vigil_policy::actor::positional_inputs;
use vigil_types::{Action, DEPTH_PIXELS};
use vigil_vehicle::Wind;
use vigil_world::{Family, generate};

/// States taken from one flight: few, since neighbours resemble each other.
pub const STATES_PER_FLIGHT: usize = 5;

/// A state.
pub struct State {
    /// Five frames, oldest first.
    pub frames: Vec<f32>,
    /// The positional inputs.
    pub position: [f32; 2],
    /// A seed of its own.
    pub seed: u64,
}

/// Flies a validation course with the actor alone, without the potential field, and picks [`STATES_PER_FLIGHT`] of the
/// states it decided on, each as likely as the other (reservoir sampling), from the fifth on.
///
/// # Errors
/// Parameters of another actor.
pub fn met_in_flight(params: &[f32], seed: u64) -> Result<Vec<State>> {
    let course = generate(Family::Validation, seed);
    let mut flight = Flight::new(&course, Wind::default(), seed)?;
    let mut actor = Actor::new(ActorSpec::FULL, Isa::detect(), params)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut frames = vec![0.0; ACTOR_FRAMES * DEPTH_PIXELS];
    let mut states: Vec<State> = Vec::with_capacity(STATES_PER_FLIGHT);
    for step in 0.. {
        let (depth, position) = (&flight.frame().depth, positional_inputs(flight.goal()));
        frames.copy_within(DEPTH_PIXELS.., 0);
        frames[(ACTOR_FRAMES - 1) * DEPTH_PIXELS..].copy_from_slice(depth);
        let [forward_m_s, yaw] = actor.decide(depth, position)?;
        if let Some(met) = (step + 1usize).checked_sub(ACTOR_FRAMES) {
            let state = |frames: &[f32]| State {
                frames: frames.to_vec(),
                position,
                seed: seed * 100_000 + step as u64,
            };
            let slot = rng.random_range(0..=met);
            if states.len() < STATES_PER_FLIGHT {
                states.push(state(&frames));
            } else if slot < STATES_PER_FLIGHT {
                states[slot] = state(&frames);
            }
        }
        if flight.advance(Action { forward_m_s, yaw }).is_some() {
            break;
        }
    }
    Ok(states)
}
