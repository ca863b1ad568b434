//! States that an actor meets in flight: the newest frame, and what the actor holds beside it.

use crate::explained::Flight;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_adversary::Beside;
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_policy::actor::memory::SCAN_AGES;
use vigil_sim::environment::Environment;
use vigil_sim::vehicle::Wind;
use vigil_sim::world::{Family, generate};
use vigil_types::Action;

/// States taken from one flight: few, since neighbours resemble each other.
pub const STATES_PER_FLIGHT: usize = 5;

pub struct State {
    pub frame: Vec<f32>,
    /// What the actor remembers and observes beside it.
    pub beside: Beside,
    pub seed: u64,
}

/// Flies a validation course with the actor alone, without the potential field, and picks [`STATES_PER_FLIGHT`] of the
/// states it decided on, each as likely as the other (reservoir sampling), from the first on whose older scans are all of the flight.
pub fn met_in_flight(victim: &FrozenActor, seed: u64) -> Result<Vec<State>> {
    let course = generate(Family::Validation, seed);
    let mut flight = Flight::of(Environment::new(&course, Wind::default(), seed)?);
    let mut actor = victim.actor(Isa::detect())?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut states: Vec<State> = Vec::with_capacity(STATES_PER_FLIGHT);
    for step in 0_usize.. {
        let [forward_m_s, yaw] = actor.decide(&flight.input())?;
        if let Some(met) = step.checked_sub(SCAN_AGES[0]) {
            let state = || State {
                frame: flight.frame().depth.to_vec(),
                beside: Beside::of(&actor),
                seed: seed.wrapping_mul(100_000).wrapping_add(step as u64),
            };
            let slot = rng.random_range(0..=met);
            if states.len() < STATES_PER_FLIGHT {
                states.push(state());
            } else if slot < STATES_PER_FLIGHT {
                states[slot] = state();
            }
        }
        if flight.advance(Action { forward_m_s, yaw }).is_some() {
            break;
        }
    }
    Ok(states)
}
