//! One part of a batch: the losses of its transitions and their gradients.

use crate::actor_training::config::LearningConfig;
use crate::actor_training::learner::UpdateReport;
use crate::actor_training::networks::{Networks, squash};
use crate::actor_training::recurrent::{Recurrent, RecurrentParams};
use crate::actor_training::replay_buffer::{State, Transition, unpack_frame};
use crate::actor_training::weights::Weights;
use rand::{Rng, RngExt};
use vigil_nnet::{Aligned, Graph, Isa, ShapeError};
use vigil_policy::actor::{ACTOR_FRAMES, ACTOR_LIMIT};
use vigil_types::DEPTH_PIXELS;

/// From this difference between two yaw outputs on, one of them is wrong.
const DISAGREEING: f32 = 0.3;

/// A tape and a work buffer of a graph.
pub struct Pass {
    pub tape: Aligned,
    pub work: Aligned,
}

impl Pass {
    fn new(graph: &Graph) -> Self {
        Self {
            tape: Aligned::zeros(graph.tape_len()),
            work: Aligned::zeros(graph.work_len()),
        }
    }
}

/// What one part of a batch needs.
pub struct Shard {
    pub contrast: Vec<f32>,
    /// A tape for each frame whose gradient is wanted, and one for the others.
    pub encoders: [Aligned; ACTOR_FRAMES],
    pub passing_encoder: Aligned,
    pub encoder_work: Aligned,
    pub features: Aligned,
    pub d_features: Aligned,
    pub actor_recur: Recurrent,
    pub actor_head: Pass,
    pub critic_recur: Recurrent,
    pub critic_head: Pass,
    pub d_encoder: Aligned,
    pub d_actor: Aligned,
    pub d_critic: Aligned,
    pub sums: UpdateReport,
    pub errors: Vec<(usize, f32)>,
}

impl Shard {
    /// Buffers.
    pub fn new(n: &Networks) -> Self {
        let features = n.encoder.output_len();
        Self {
            contrast: vec![0.0; DEPTH_PIXELS],
            encoders: core::array::from_fn(|_| Aligned::zeros(n.encoder.tape_len())),
            passing_encoder: Aligned::zeros(n.encoder.tape_len()),
            encoder_work: Aligned::zeros(n.encoder.work_len()),
            features: Aligned::zeros(ACTOR_FRAMES * features),
            d_features: Aligned::zeros(features),
            actor_recur: Recurrent::new(features),
            actor_head: Pass::new(&n.actor_head),
            critic_recur: Recurrent::new(features),
            critic_head: Pass::new(&n.critic_head),
            d_encoder: Aligned::zeros(n.actor_len()),
            d_actor: Aligned::zeros(n.actor_len()),
            d_critic: Aligned::zeros(n.critic_len()),
            sums: UpdateReport::default(),
            errors: Vec::new(),
        }
    }
}

/// The weights an update works with.
pub struct UpdateContext<'a> {
    pub networks: &'a Networks,
    pub isa: Isa,
    pub weights: &'a Weights,
    pub packed_actor: &'a [f32],
    pub packed_critic: &'a [f32],
    pub arranged: &'a Arranged,
    pub saturation_penalty: f32,
    pub imitation: f32,
    pub imitation_width: f32,
    pub imitation_trains_encoder: bool,
    /// What the critic says counts for the actor.
    pub by_value: f32,
    pub batch: f32,
}

/// What is drawn for a transition.
#[derive(Debug, Clone, Copy)]
pub struct Augmentation {
    /// It is seen in a mirror.
    pub mirror: bool,
    /// What each frame's gradient counts for the encoder, oldest first; 1 on average over the draws.
    pub frame_shares: [f32; ACTOR_FRAMES],
}

impl Augmentation {
    /// The newest frame and `frames − 1` of the older ones, neighbours in a ring.
    pub fn new(config: &LearningConfig, rng: &mut impl Rng) -> Self {
        const OLDER: usize = ACTOR_FRAMES - 1;
        let mirror = config.mirror && rng.random_range(0..2) == 1;
        let mut frame_shares = [0.0; ACTOR_FRAMES];
        frame_shares[OLDER] = 1.0;
        let drawn = config.encoder_frames - 1;
        let first = rng.random_range(0..OLDER);
        for i in 0..drawn {
            frame_shares[(first + i) % OLDER] = OLDER as f32 / drawn as f32;
        }
        Self { mirror, frame_shares }
    }
}

/// The weights that an update reads most, arranged for it: the four GRUs, the encoders at a cache line's beginning.
pub struct Arranged {
    pub encoder: Aligned,
    pub encoder_target: Aligned,
    pub actor: RecurrentParams,
    pub critic: RecurrentParams,
    pub actor_target: RecurrentParams,
    pub critic_target: RecurrentParams,
}

impl Arranged {
    /// Buffers.
    pub fn new(n: &Networks) -> Self {
        let set = || RecurrentParams::new(n.encoder.output_len());
        Self {
            encoder: Aligned::zeros(n.actor_len()),
            encoder_target: Aligned::zeros(n.actor_len()),
            actor: set(),
            critic: set(),
            actor_target: set(),
            critic_target: set(),
        }
    }

    /// Takes over all weights.
    ///
    /// # Errors
    /// Weights of other networks.
    pub fn set(&mut self, n: &Networks, w: &Weights) -> Result<(), ShapeError> {
        let encoder = ..n.encoder_len();
        self.encoder[encoder].copy_from_slice(&w.actor[encoder]);
        self.encoder_target[encoder].copy_from_slice(&w.actor_target[encoder]);
        self.actor.set(&w.actor[n.actor_gru()])?;
        self.critic.set(&w.critic[n.critic_gru()])?;
        self.actor_target.set(&w.actor_target[n.actor_gru()])?;
        self.critic_target.set(&w.critic_target[n.critic_gru()])
    }
}

/// A value in a mirror: bearing and yaw change sign.
pub fn mirrored(v: [f32; 2], mirror: bool) -> [f32; 2] {
    if mirror { [v[0], -v[1]] } else { v }
}

/// Five frames' features apart.
pub fn five(features: &[f32]) -> [&[f32]; ACTOR_FRAMES] {
    let len = features.len() / ACTOR_FRAMES;
    core::array::from_fn(|i| &features[i * len..(i + 1) * len])
}

impl Shard {
    /// Encodes a state with the given weights and collects the features; keeps the tapes of the frames that have a share.
    pub fn encode(
        &mut self,
        f: &UpdateContext<'_>,
        encoder_weights: &[f32],
        state: &State<'_>,
        mirror: bool,
        shares: [f32; ACTOR_FRAMES],
    ) -> Result<(), ShapeError> {
        let encoder = &f.networks.encoder;
        let len = encoder.output_len();
        for (i, (packed, own)) in state.frames.iter().zip(&mut self.encoders).enumerate() {
            // One tape for everything that is not read again stays in the cache.
            let tape = if shares[i] > 0.0 {
                own
            } else {
                &mut self.passing_encoder
            };
            unpack_frame(packed, mirror, &mut self.contrast);
            encoder.forward(f.isa, encoder_weights, &[&self.contrast], tape)?;
            self.features[i * len..(i + 1) * len].copy_from_slice(encoder.output(tape)?);
        }
        Ok(())
    }

    /// What the target networks think the next state is worth.
    fn next_value(&mut self, f: &UpdateContext<'_>, t: &Transition<'_>, mirror: bool) -> Result<f32, ShapeError> {
        let (n, w) = (f.networks, f.weights);
        self.encode(f, &f.arranged.encoder_target, &t.next, mirror, [0.0; ACTOR_FRAMES])?;
        let position = mirrored(t.next.position, mirror);
        let state = self
            .actor_recur
            .forward(f.isa, &f.arranged.actor_target, &self.features)?;
        n.actor_head
            .forward(f.isa, &w.actor_target, &[&state, &position], &mut self.actor_head.tape)?;
        let action = squash(n.actor_head.output(&self.actor_head.tape)?);
        let state = self
            .critic_recur
            .forward(f.isa, &f.arranged.critic_target, &self.features)?;
        let inputs: [&[f32]; 3] = [&state, &position, &action];
        n.critic_head
            .forward(f.isa, &w.critic_target, &inputs, &mut self.critic_head.tape)?;
        Ok(n.critic_head.output(&self.critic_head.tape)?[0])
    }

    /// Adds one transition's share to the gradients; [`Self::finish`] completes them.
    ///
    /// # Errors
    /// Weights of other networks.
    pub fn learn(
        &mut self,
        f: &UpdateContext<'_>,
        t: &Transition<'_>,
        augmentation: Augmentation,
    ) -> Result<(), ShapeError> {
        let mirror = augmentation.mirror;
        let (n, w, isa) = (f.networks, f.weights, f.isa);
        let target = if t.discount > 0.0 {
            t.reward + t.discount * self.next_value(f, t, mirror)?
        } else {
            t.reward
        };
        self.encode(f, &f.arranged.encoder, &t.state, mirror, augmentation.frame_shares)?;
        let position = mirrored(t.state.position, mirror);
        let flown = mirrored(t.action, mirror);

        // Critic: L = w (Q(s, a) − y)² / batch.
        let critic_state = self.critic_recur.forward(isa, &f.arranged.critic, &self.features)?;
        let head_inputs: [&[f32]; 3] = [&critic_state, &position, &flown];
        let head = &mut self.critic_head;
        n.critic_head.forward(isa, &w.critic, &head_inputs, &mut head.tape)?;
        let error = n.critic_head.output(&head.tape)?[0] - target;
        let d_value = [2.0 * t.weight * error / f.batch];
        let d_critic = &mut self.d_critic;
        n.critic_head.backward(
            isa,
            f.packed_critic,
            &head.tape,
            &d_value,
            Some(d_critic),
            &mut head.work,
        )?;
        let d_state = n.critic_head.input_gradient(&head.work, 0)?;
        let d_gru = &mut d_critic[n.critic_gru()];
        self.critic_recur
            .backward(isa, &f.arranged.critic, &self.features, d_state, d_gru, true)?;

        // Actor: L = (penalty + imitation − Q(s, μ(s))) / batch.
        let actor_state = self.actor_recur.forward(isa, &f.arranged.actor, &self.features)?;
        n.actor_head
            .forward(isa, &w.actor, &[&actor_state, &position], &mut self.actor_head.tape)?;
        let pre = n.actor_head.output(&self.actor_head.tape)?;
        let action = squash(pre);
        let head_inputs: [&[f32]; 3] = [&critic_state, &position, &action];
        n.critic_head.forward(isa, &w.critic, &head_inputs, &mut head.tape)?;
        let value = n.critic_head.output(&head.tape)?[0];
        n.critic_head
            .backward(isa, f.packed_critic, &head.tape, &[1.0], None, &mut head.work)?;
        let d_action = n.critic_head.input_gradient(&head.work, 2)?;
        let mut d_pre = [0.0; 2];
        let mut d_imitation = [0.0; 2];
        let mut distance = 0.0;
        let teacher_action = t
            .teacher_action
            .map_or(action, |teacher_action| mirrored(teacher_action, mirror));
        for i in 0..2 {
            let excess = (pre[i].abs() - 1.0).max(0.0).copysign(pre[i]);
            let tanh_slope = ACTOR_LIMIT - action[i] * action[i] / ACTOR_LIMIT;
            d_pre[i] = (2.0 * f.saturation_penalty * excess - f.by_value * d_action[i] * tanh_slope) / f.batch;
            let off = action[i] - teacher_action[i];
            d_imitation[i] = f.imitation * huber_slope(off, f.imitation_width) * tanh_slope / f.batch;
            distance += off.abs();
            self.sums.imitation_loss += off * off;
            self.sums.saturated += if excess != 0.0 { 0.5 } else { 0.0 };
        }
        let off = teacher_action[1] - action[1];
        if off.abs() > DISAGREEING {
            self.sums.agreement += (d_action[1] * off).signum();
        }
        let with_imitation = f.imitation > 0.0 && f.imitation_trains_encoder;
        // What the encoder learns from the actor is the imitation alone, so that is kept apart and comes last.
        if f.by_value > 0.0 || f.imitation == 0.0 {
            self.learn_actor(f, &d_pre, false)?;
        } else {
            add(&mut d_imitation, &d_pre);
        }
        if f.imitation > 0.0 {
            self.learn_actor(f, &d_imitation, with_imitation)?;
        }

        let len = self.d_features.len();
        // The newest first: it was encoded last and is still in the cache.
        for (i, share) in augmentation.frame_shares.into_iter().enumerate().rev() {
            if share <= 0.0 {
                continue;
            }
            let own = i * len..(i + 1) * len;
            let d_features = &mut self.d_features;
            d_features.copy_from_slice(&self.critic_recur.d_features[own.clone()]);
            if with_imitation {
                add(d_features, &self.actor_recur.d_features[own]);
            }
            scale_by(d_features, share);
            n.encoder.backward(
                isa,
                f.packed_actor,
                &self.encoders[i],
                d_features,
                Some(&mut self.d_encoder),
                &mut self.encoder_work,
            )?;
        }

        self.sums.critic_loss += t.weight * error * error;
        self.sums.value += value;
        // Sampled more often: what the critic does not expect and where the actor is not like its teacher.
        self.errors.push((t.leaf, error.abs() + f.imitation * distance));
        Ok(())
    }

    /// Completes the gradients after the last transition.
    ///
    /// # Errors
    /// Weights of other networks.
    pub fn finish(&mut self, f: &UpdateContext<'_>) -> Result<(), ShapeError> {
        let (n, sets) = (f.networks, f.arranged);
        let d_critic = &mut self.d_critic[n.critic_gru()];
        self.critic_recur.finish(f.isa, &sets.critic, d_critic)?;
        let d_actor = &mut self.d_actor[n.actor_gru()];
        self.actor_recur.finish(f.isa, &sets.actor, d_actor)
    }

    /// Adds the actor's gradient for `d_pre` at its outputs before their last tanh; the gradient with respect to the
    /// features stays in the work buffer if it is wanted.
    fn learn_actor(
        &mut self,
        f: &UpdateContext<'_>,
        d_pre: &[f32; 2],
        features_wanted: bool,
    ) -> Result<(), ShapeError> {
        let (n, isa) = (f.networks, f.isa);
        let d_actor = &mut self.d_actor;
        let head = &mut self.actor_head;
        n.actor_head
            .backward(isa, f.packed_actor, &head.tape, d_pre, Some(d_actor), &mut head.work)?;
        let d_state = n.actor_head.input_gradient(&head.work, 0)?;
        let d_gru = &mut d_actor[n.actor_gru()];
        self.actor_recur
            .backward(isa, &f.arranged.actor, &self.features, d_state, d_gru, features_wanted)
    }
}

/// Slope of the imitation's loss: |off| from `width` on, off² / (2 width) nearer; off² without a width.
fn huber_slope(off: f32, width: f32) -> f32 {
    if width > 0.0 {
        (off / width).clamp(-1.0, 1.0)
    } else {
        2.0 * off
    }
}

/// `to += from`.
pub fn add(to: &mut [f32], from: &[f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += from;
    }
}

/// Multiplies a gradient by a factor.
pub fn scale_by(d: &mut [f32], factor: f32) {
    if factor != 1.0 {
        for d in d {
            *d *= factor;
        }
    }
}
