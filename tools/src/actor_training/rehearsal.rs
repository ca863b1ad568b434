//! Updates on one fixed batch: for timing, and for comparing them with another framework's (docs/peers.md).

use crate::actor_training::config::TrainConfig;
use crate::actor_training::learner::{Learner, UpdateError, UpdateReport};
use crate::actor_training::networks::Networks;
use crate::actor_training::replay_buffer::{State, Transition, pack_frame};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::actor::ACTOR_FRAMES;
use vigil_types::DEPTH_PIXELS;

/// Five frames as the replay memory keeps them, oldest first, and the positional inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptState {
    /// 8 bits of contrast for each pixel.
    pub frames: [Vec<u8>; ACTOR_FRAMES],
    /// Distance / 20 m, bearing / 1 rad.
    pub position: [f32; 2],
}

impl KeptState {
    /// Keeps five depth frames (range / 100 m), oldest first.
    pub fn new(frames: [&[f32; DEPTH_PIXELS]; ACTOR_FRAMES], position: [f32; 2]) -> Self {
        let keep = |frame: &[f32; DEPTH_PIXELS]| {
            let mut kept = vec![0; DEPTH_PIXELS];
            pack_frame(frame, &mut kept);
            kept
        };
        Self {
            frames: frames.map(keep),
            position,
        }
    }

    fn view(&self) -> State<'_> {
        State {
            frames: self.frames.each_ref().map(Vec::as_slice),
            position: self.position,
        }
    }
}

/// A transition of the batch.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// The state.
    pub state: KeptState,
    /// The action flown in it.
    pub action: [f32; 2],
    /// What the geometric pilot would have done.
    pub teacher_action: [f32; 2],
    /// Reward.
    pub reward: f32,
    /// What the value of `next` counts.
    pub discount: f32,
    /// The state after it.
    pub next: KeptState,
    /// Importance weight.
    pub weight: f32,
}

/// Fresh networks and a batch that they see again and again.
pub struct Rehearsal {
    learner: Learner,
    batch: Vec<Example>,
    rng: ChaCha8Rng,
}

impl Rehearsal {
    /// First weights and draws by the configuration's seed. Updates take all threads of the current pool.
    ///
    /// # Errors
    /// Networks that do not fit, which would be a mistake here.
    pub fn new(isa: Isa, config: &TrainConfig, batch: Vec<Example>) -> Result<Self, ShapeError> {
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let learner = Learner::new(Arc::new(Networks::new()?), isa, config, &mut rng)?;
        Ok(Self { learner, batch, rng })
    }

    /// One update of encoder, actor, critic and target networks, as training makes it.
    ///
    /// # Errors
    /// A loss or gradient that is not finite.
    pub fn update(&mut self) -> Result<UpdateReport, UpdateError> {
        let batch: Vec<Transition<'_>> = self
            .batch
            .iter()
            .enumerate()
            .map(|(leaf, e)| Transition {
                leaf,
                state: e.state.view(),
                action: e.action,
                teacher_action: Some(e.teacher_action),
                reward: e.reward,
                discount: e.discount,
                next: e.next.view(),
                weight: e.weight,
            })
            .collect();
        self.learner.update(&batch, &mut self.rng).map(|(report, _)| report)
    }

    /// All weights and Adam's moments by name, in the order of the networks' parameters.
    pub fn parts(&self) -> [(&'static str, &Vec<f32>); 10] {
        self.learner.weights().parts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(seed: usize) -> KeptState {
        let frame = |t: usize| -> Box<[f32; DEPTH_PIXELS]> {
            Box::new(core::array::from_fn(|p| {
                ((p / 97 + 13 * t + 31 * seed) % 64) as f32 / 320.0
            }))
        };
        let frames: [Box<[f32; DEPTH_PIXELS]>; ACTOR_FRAMES] = core::array::from_fn(frame);
        KeptState::new(frames.each_ref().map(|frame| &**frame), [0.5, 0.1 * seed as f32])
    }

    fn rehearsal(seed: u64) -> Rehearsal {
        let example = |i: usize| Example {
            state: kept(i),
            action: [1.0, -0.5],
            teacher_action: [0.2, 0.4],
            reward: 1.0 + i as f32,
            discount: 0.0,
            next: kept(i),
            weight: 1.0,
        };
        let mut config = TrainConfig {
            seed,
            ..TrainConfig::default()
        };
        config.warm_up.updates = 0;
        Rehearsal::new(Isa::detect(), &config, (0..2).map(example).collect()).unwrap()
    }

    #[test]
    fn updates_on_one_batch_learn_it_and_are_the_same_for_the_same_seed() {
        let (mut one, mut twin, mut other) = (rehearsal(1), rehearsal(1), rehearsal(2));
        let first = one.update().unwrap();
        assert_eq!(first, twin.update().unwrap());
        assert_eq!(one.parts(), twin.parts());
        other.update().unwrap();
        assert_ne!(one.parts()[0].1, other.parts()[0].1, "another seed, other weights");
        let mut last = first;
        for _ in 0..20 {
            last = one.update().unwrap();
        }
        assert!(
            last.critic_loss < 0.75 * first.critic_loss,
            "{} after {}",
            last.critic_loss,
            first.critic_loss
        );
    }
}
