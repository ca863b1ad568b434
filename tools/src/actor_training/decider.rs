//! Decisions with weights that are still being trained.

use crate::actor_training::networks::{Networks, squash};
use crate::actor_training::replay_buffer::{State, unpack_frame};
use crate::actor_training::shard::five;
use vigil_nnet::{Aligned, Isa, ShapeError};
use vigil_policy::actor::ACTOR_FRAMES;
use vigil_types::DEPTH_PIXELS;

/// Decides with weights that are still being trained, from kept frames.
pub struct Decider {
    contrast: Vec<f32>,
    encoder: Aligned,
    features: Vec<f32>,
    recur: Vec<f32>,
    head: Vec<f32>,
}

impl Decider {
    /// Buffers.
    pub fn new(n: &Networks) -> Self {
        Self {
            contrast: vec![0.0; DEPTH_PIXELS],
            encoder: Aligned::zeros(n.encoder.tape_len()),
            features: vec![0.0; ACTOR_FRAMES * n.encoder.output_len()],
            recur: vec![0.0; n.actor_recur.tape_len()],
            head: vec![0.0; n.actor_head.tape_len()],
        }
    }

    /// The actor's action.
    ///
    /// # Errors
    /// Weights of other networks.
    pub fn decide(&mut self, n: &Networks, isa: Isa, actor: &[f32], state: &State<'_>) -> Result<[f32; 2], ShapeError> {
        let len = n.encoder.output_len();
        for (packed, features) in state.frames.iter().zip(self.features.chunks_exact_mut(len)) {
            unpack_frame(packed, false, &mut self.contrast);
            n.encoder.forward(isa, actor, &[&self.contrast], &mut self.encoder)?;
            features.copy_from_slice(n.encoder.output(&self.encoder)?);
        }
        n.actor_recur
            .forward(isa, actor, &five(&self.features), &mut self.recur)?;
        let inputs = [n.actor_recur.output(&self.recur)?, &state.position];
        n.actor_head.forward(isa, actor, &inputs, &mut self.head)?;
        Ok(squash(n.actor_head.output(&self.head)?))
    }
}
