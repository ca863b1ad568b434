//! States that an actor meets in flight: five frames and where the goal is.

use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use vigil_learn::flight::Flight;
use vigil_nnet::Isa;
use vigil_policy::ActorInputs;
use vigil_policy::actor::{Actor, Lead, PositionalInputs};
use vigil_types::Action;
use vigil_vehicle::Wind;
use vigil_world::{Family, generate};

/// States taken from one flight: few, since neighbours resemble each other.
pub const STATES_PER_FLIGHT: usize = 5;

/// A state.
pub struct State {
    /// Five frames, oldest first.
    pub frames: Vec<f32>,
    /// The positional inputs.
    pub position: PositionalInputs,
    /// A seed of its own.
    pub seed: u64,
}

/// Flies a validation course with the actor alone, without the potential field, and picks [`STATES_PER_FLIGHT`] of the
/// states it decided on, each as likely as the other (reservoir sampling), from the first on that has five frames of its own.
///
/// # Errors
/// Parameters of another actor.
pub fn met_in_flight((params, inputs): (&[f32], ActorInputs), seed: u64) -> Result<Vec<State>> {
    let course = generate(Family::Validation, seed);
    let mut flight = Flight::new(&course, Wind::default(), seed)?;
    let ages = inputs.frame_ages;
    let mut actor = Actor::with_frame_ages(inputs.spec(), Isa::detect(), params, ages)?;
    let mut lead = Lead::new(inputs);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let kept = 1 + ages[0];
    let mut frames = VecDeque::with_capacity(kept);
    let mut states: Vec<State> = Vec::with_capacity(STATES_PER_FLIGHT);
    for step in 0.. {
        let (_, position) = lead.inputs(&flight.input());
        let depth = &flight.frame().depth;
        frames.truncate(kept - 1);
        frames.push_front(depth.to_vec());
        let [forward_m_s, yaw] = actor.decide(depth, position)?;
        if let Some(met) = (step + 1usize).checked_sub(kept) {
            let state = |frames: &VecDeque<Vec<f32>>| State {
                frames: ages.iter().flat_map(|age| &frames[*age]).copied().collect(),
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
