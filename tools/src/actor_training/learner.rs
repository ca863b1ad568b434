//! DDPG's update (Lillicrap et al. 2016; docs/paper.md, Algorithm 1) with n-step returns and prioritised replay.

use crate::actor_training::adam;
use crate::actor_training::config::{LearningConfig, TrainConfig, WarmUp};
use crate::actor_training::networks::Networks;
use crate::actor_training::replay_buffer::Transition;
use crate::actor_training::shard::{Arranged, Augmentation, Shard, UpdateContext, add, scale_by};
use crate::actor_training::weights::Weights;
use rand::Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vigil_nnet::train::soft_update;
use vigil_nnet::{Aligned, Isa, Params, ShapeError};

/// Parts into which a batch is cut. Their gradients are added in a fixed order, so any number of threads gives the same bits.
const SHARDS: usize = 4;

/// Why training cannot go on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UpdateError {
    /// Not a number, or infinite.
    #[error("update {update}: the {what} of {layer} is not finite; lower the learning rates or the gradient norm")]
    NotFinite {
        /// Number of the update.
        update: u64,
        /// Loss or gradient.
        what: &'static str,
        /// Which layer.
        layer: &'static str,
    },
    /// A network and its buffers do not fit, which would be a mistake here.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}

/// What an update saw, means over the batch.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct UpdateReport {
    /// Weighted squared temporal-difference error.
    pub critic_loss: f32,
    /// Value of the actor's own actions.
    pub value: f32,
    /// Squared distance between the actor's action and what the geometric pilot would do.
    pub imitation_loss: f32,
    /// Share of the actor's outputs beyond 1 before their last tanh.
    pub saturated: f32,
    /// How the value's slope over yaw points where the actor's yaw is more than 0.3 from the pilot's: the share of the batch
    /// where it points towards the pilot's, less the share where it points away.
    pub agreement: f32,
    /// Length of the critic's gradient before it was shortened.
    pub critic_norm: f32,
    /// Length of the actor's gradient before it was shortened.
    pub actor_norm: f32,
}

impl UpdateReport {
    /// The sum of two.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            critic_loss: self.critic_loss + other.critic_loss,
            value: self.value + other.value,
            imitation_loss: self.imitation_loss + other.imitation_loss,
            saturated: self.saturated + other.saturated,
            agreement: self.agreement + other.agreement,
            critic_norm: self.critic_norm + other.critic_norm,
            actor_norm: self.actor_norm + other.actor_norm,
        }
    }

    /// All values times a factor.
    #[must_use]
    pub fn scaled(&self, factor: f32) -> Self {
        Self {
            critic_loss: self.critic_loss * factor,
            value: self.value * factor,
            imitation_loss: self.imitation_loss * factor,
            saturated: self.saturated * factor,
            agreement: self.agreement * factor,
            critic_norm: self.critic_norm * factor,
            actor_norm: self.actor_norm * factor,
        }
    }
}

/// Actor and critic being trained.
pub struct Learner {
    networks: Arc<Networks>,
    isa: Isa,
    config: LearningConfig,
    warm_up: WarmUp,
    weights: Weights,
    /// Shares of the learning rate.
    actor_shares: Vec<f32>,
    critic_shares: Vec<f32>,
    packed_actor: Aligned,
    packed_critic: Aligned,
    arranged: Arranged,
    shards: Vec<Shard>,
    updates: u64,
    /// Updates of the whole run.
    all_updates: u64,
}

impl Learner {
    /// Fresh weights.
    ///
    /// # Errors
    /// Networks that do not fit, which would be a mistake here.
    pub fn new(
        networks: Arc<Networks>,
        isa: Isa,
        config: &TrainConfig,
        rng: &mut impl Rng,
    ) -> Result<Self, ShapeError> {
        let mut weights = Weights::zeros(&networks);
        (weights.actor, weights.critic) = networks.initial(rng);
        weights.actor_target.clone_from(&weights.actor);
        weights.critic_target.clone_from(&weights.critic);
        Self::with_weights(networks, isa, config, weights, 0)
    }

    /// Goes on from weights after `updates` updates.
    ///
    /// # Errors
    /// Weights of other networks.
    pub fn with_weights(
        networks: Arc<Networks>,
        isa: Isa,
        config: &TrainConfig,
        weights: Weights,
        updates: u64,
    ) -> Result<Self, ShapeError> {
        let (actor_shares, critic_shares) = networks.rate_shares();
        let mut learner = Self {
            actor_shares,
            critic_shares,
            isa,
            config: config.learning.clone(),
            warm_up: config.warm_up.clone(),
            packed_actor: Aligned::zeros(networks.actor_len()),
            packed_critic: Aligned::zeros(networks.critic_len()),
            arranged: Arranged::new(&networks),
            shards: (0..SHARDS).map(|_| Shard::new(&networks)).collect(),
            networks,
            weights,
            updates,
            all_updates: config.updates_due(config.decisions),
        };
        learner.pack()?;
        Ok(learner)
    }

    fn pack(&mut self) -> Result<(), ShapeError> {
        let (n, w) = (&self.networks, &self.weights);
        // Each graph packs its own layers and leaves the rest as it is.
        n.encoder.pack(&w.actor, &mut self.packed_actor)?;
        n.actor_head.pack(&w.actor, &mut self.packed_actor)?;
        n.critic_head.pack(&w.critic, &mut self.packed_critic)?;
        self.arranged.set(n, w)
    }

    /// Everything that is learned.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// Encoder and actor as they explore.
    pub fn actor(&self) -> &[f32] {
        &self.weights.actor
    }

    /// What is evaluated, frozen and flown.
    pub fn frozen(&self) -> &[f32] {
        if self.config.freeze_target {
            &self.weights.actor_target
        } else {
            &self.weights.actor
        }
    }

    /// Share of the learning rates now.
    fn rate(&self) -> f32 {
        let done = self.updates as f64 / self.all_updates.max(1) as f64;
        let from = self.config.rates_fall_from;
        let fallen = ((done - from) / (1.0 - from).max(1e-9)).clamp(0.0, 1.0);
        (1.0 - 0.95 * fallen) as f32
    }

    /// Updates so far.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// With an imitation, the updates before the actor's first own flight are its alone: the critic knows nothing yet.
    fn warms_up(&self) -> bool {
        self.config.imitation > 0.0 && self.updates < self.warm_up.updates
    }

    /// The imitation's weight now.
    fn imitation(&self) -> f32 {
        let left = 1.0 - self.updates as f32 / self.config.imitation_updates.max(1) as f32;
        self.config.imitation * left.max(0.0)
    }

    /// One update of critic, encoder, actor and target networks. Returns the temporal-difference errors by leaf.
    ///
    /// # Errors
    /// A loss or gradient that is not finite; the weights stay as they were.
    pub fn update(
        &mut self,
        batch: &[Transition<'_>],
        rng: &mut impl Rng,
    ) -> Result<(UpdateReport, Vec<(usize, f32)>), UpdateError> {
        let augmentations: Vec<Augmentation> = batch.iter().map(|_| Augmentation::new(&self.config, rng)).collect();
        let frozen = UpdateContext {
            networks: &self.networks,
            isa: self.isa,
            weights: &self.weights,
            packed_actor: &self.packed_actor,
            packed_critic: &self.packed_critic,
            arranged: &self.arranged,
            saturation_penalty: self.config.saturation_penalty,
            imitation: self.imitation(),
            imitation_width: self.config.imitation_width,
            imitation_trains_encoder: self.config.imitation_trains_encoder,
            by_value: if self.warms_up() { 0.0 } else { self.config.value_weight },
            batch: batch.len() as f32,
        };
        let per_shard = batch.len().div_ceil(SHARDS);
        self.shards
            .par_iter_mut()
            .enumerate()
            .try_for_each(|(k, shard)| -> Result<(), ShapeError> {
                for d in [&mut shard.d_encoder, &mut shard.d_actor, &mut shard.d_critic] {
                    d.fill(0.0);
                }
                shard.sums = UpdateReport::default();
                shard.errors.clear();
                let own = batch.iter().zip(&augmentations).skip(k * per_shard).take(per_shard);
                for (transition, augmentation) in own {
                    shard.learn(&frozen, transition, *augmentation)?;
                }
                shard.finish(&frozen)
            })?;
        self.apply(batch.len())
    }

    /// Adds the shards' gradients and steps.
    fn apply(&mut self, batch: usize) -> Result<(UpdateReport, Vec<(usize, f32)>), UpdateError> {
        let actor_rate = if self.warms_up() {
            self.warm_up.actor_rate
        } else {
            self.config.actor_rate
        };
        let rate = self.rate();
        let (actor_rate, critic_rate) = (rate * actor_rate, rate * self.config.critic_rate);
        let (first, rest) = self.shards.split_at_mut(1);
        let total = &mut first[0];
        let mut report = total.sums;
        let mut errors = total.errors.clone();
        for shard in rest {
            add(&mut total.d_encoder, &shard.d_encoder);
            add(&mut total.d_actor, &shard.d_actor);
            add(&mut total.d_critic, &shard.d_critic);
            report = report.plus(&shard.sums);
            errors.extend_from_slice(&shard.errors);
        }
        let mut report = report.scaled(1.0 / batch as f32);
        let update = self.updates;
        let encoder = self.networks.encoder_len();
        let d_encoder = &mut total.d_encoder[..encoder];
        let d_actor = &mut total.d_actor[encoder..];
        let d_critic = &mut total.d_critic;
        let losses = [("critic", report.critic_loss), ("actor", report.value)];
        for (layer, loss) in losses {
            if !loss.is_finite() {
                return Err(UpdateError::NotFinite {
                    update,
                    what: "loss",
                    layer,
                });
            }
        }
        let critic_norm = adam::norm(&[d_encoder, d_critic]);
        let actor_norm = adam::norm(&[d_actor]);
        if !(critic_norm.is_finite() && actor_norm.is_finite()) {
            let layers = |d: &[f32], offset: usize, layers: Vec<(&'static str, Params)>| {
                layers.into_iter().find(|(_, p)| {
                    let own = p.at.checked_sub(offset).and_then(|at| d.get(at..at + p.len));
                    own.is_some_and(|d| d.iter().any(|g| !g.is_finite()))
                })
            };
            let named = layers(d_encoder, 0, self.networks.actor_layers())
                .or_else(|| layers(d_critic, 0, self.networks.critic_layers()))
                .or_else(|| layers(d_actor, encoder, self.networks.actor_layers()));
            return Err(UpdateError::NotFinite {
                update,
                what: "gradient",
                layer: named.map_or("all layers together", |(name, _)| name),
            });
        }
        report.critic_norm = critic_norm as f32;
        report.actor_norm = actor_norm as f32;
        let c = &self.config;
        let (critic_scale, actor_scale) = (
            adam::shortening(critic_norm, c.gradient_norm),
            adam::shortening(actor_norm, c.gradient_norm),
        );
        scale_by(d_encoder, critic_scale);
        scale_by(d_critic, critic_scale);
        scale_by(d_actor, actor_scale);
        let w = &mut self.weights;
        let (encoder_params, actor_params) = w.actor.split_at_mut(encoder);
        let (encoder_shares, actor_shares) = self.actor_shares.split_at(encoder);
        w.encoder_adam
            .step(critic_rate, encoder_shares, encoder_params, d_encoder);
        w.actor_adam.step(actor_rate, actor_shares, actor_params, d_actor);
        w.critic_adam
            .step(critic_rate, &self.critic_shares, &mut w.critic, d_critic);
        soft_update(c.tau, &w.actor, &mut w.actor_target)?;
        soft_update(c.tau, &w.critic, &mut w.critic_target)?;
        self.updates += 1;
        self.pack()?;
        Ok((report, errors))
    }
}

#[cfg(test)]
#[path = "gradient_test.rs"]
mod tests;
