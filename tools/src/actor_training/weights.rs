//! Everything that is learned.

use crate::actor_training::adam::Adam;
use crate::actor_training::networks::Networks;

/// All weights with what training keeps about them.
#[derive(Clone, PartialEq)]
pub struct Weights {
    /// Encoder and actor.
    pub actor: Vec<f32>,
    /// Critic.
    pub critic: Vec<f32>,
    /// Slow copy of encoder and actor.
    pub actor_target: Vec<f32>,
    /// Slow copy of the critic.
    pub critic_target: Vec<f32>,
    /// Of the encoder, by the critic's loss.
    pub encoder_adam: Adam,
    /// Of the actor behind the encoder.
    pub actor_adam: Adam,
    /// Of the critic.
    pub critic_adam: Adam,
}

impl Weights {
    /// All zero.
    pub fn zeros(n: &Networks) -> Self {
        let (actor, encoder, critic) = (n.actor_len(), n.encoder_len(), n.critic_len());
        Self {
            actor: vec![0.0; actor],
            critic: vec![0.0; critic],
            actor_target: vec![0.0; actor],
            critic_target: vec![0.0; critic],
            encoder_adam: Adam::new(encoder),
            actor_adam: Adam::new(actor - encoder),
            critic_adam: Adam::new(critic),
        }
    }

    /// All slices by name.
    pub fn parts(&self) -> [(&'static str, &Vec<f32>); 10] {
        [
            ("actor", &self.actor),
            ("critic", &self.critic),
            ("actor_target", &self.actor_target),
            ("critic_target", &self.critic_target),
            ("encoder_mean", &self.encoder_adam.mean),
            ("encoder_square", &self.encoder_adam.square),
            ("actor_mean", &self.actor_adam.mean),
            ("actor_square", &self.actor_adam.square),
            ("critic_mean", &self.critic_adam.mean),
            ("critic_square", &self.critic_adam.square),
        ]
    }

    /// All slices by name, to be filled.
    pub fn parts_mut(&mut self) -> [(&'static str, &mut Vec<f32>); 10] {
        [
            ("actor", &mut self.actor),
            ("critic", &mut self.critic),
            ("actor_target", &mut self.actor_target),
            ("critic_target", &mut self.critic_target),
            ("encoder_mean", &mut self.encoder_adam.mean),
            ("encoder_square", &mut self.encoder_adam.square),
            ("actor_mean", &mut self.actor_adam.mean),
            ("actor_square", &mut self.actor_adam.square),
            ("critic_mean", &mut self.critic_adam.mean),
            ("critic_square", &mut self.critic_adam.square),
        ]
    }
}
