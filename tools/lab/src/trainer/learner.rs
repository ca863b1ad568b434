//! The updates: deterministic policy gradient (Lillicrap et al. 2016) with twin critics (Fujimoto et al. 2018) that see the true state and
//! what the actor observes: of the state alone, the gradient of an actor that remembers is biased (Baisero, Amato 2021).

use crate::trainer::actor_net::{ActorNet, LAST_LAYER_LIMIT, squash};
use crate::trainer::config::{LearnConfig, LearningConfig};
use crate::trainer::mlp::{Mlp, MlpTape};
use crate::trainer::noise::normal;
use crate::trainer::observation::OBSERVATION;
use crate::trainer::replay::{Sample, Stored};
use anyhow::{Result, ensure};
use rand::Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use vigil_nnet::train::adam::{self, Adam};
use vigil_nnet::train::soft_update;
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::actor::ACTOR_LIMIT;
use vigil_sim::environment::true_state::TRUE_STATE;

const ACTIONS: usize = 2;
/// Inputs of a critic: the true state, the action, the observation.
pub const CRITIC_INPUTS: usize = TRUE_STATE + ACTIONS + OBSERVATION;

pub struct Critic {
    pub params: Vec<f32>,
    /// Their slow copy.
    pub target: Vec<f32>,
    pub adam: Adam,
    packed: Vec<f32>,
    tape: MlpTape,
    d: Vec<f32>,
    out: Vec<f32>,
    loss: f32,
    norm: f32,
}

/// What an update was like; means over its transitions.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct UpdateReport {
    /// Squared error of the first critic, weighted.
    pub critic_loss: f32,
    /// First critic's value of the actor's own actions.
    pub value: f32,
    /// Share of the actor's outputs beyond 1 before the last tanh.
    pub saturated: f32,
    /// Length of the first critic's gradient.
    pub critic_norm: f32,
    /// Length of the actor's gradient.
    pub actor_norm: f32,
}

impl UpdateReport {
    /// The sum of this and `other` times a factor.
    #[must_use]
    pub fn plus(&self, other: &Self, factor: f32) -> Self {
        Self {
            critic_loss: self.critic_loss + factor * other.critic_loss,
            value: self.value + factor * other.value,
            saturated: self.saturated + factor * other.saturated,
            critic_norm: self.critic_norm + factor * other.critic_norm,
            actor_norm: self.actor_norm + factor * other.actor_norm,
        }
    }
}

pub struct Learner {
    config: LearningConfig,
    isa: Isa,
    all_updates: u64,
    pub updates: u64,
    net: ActorNet,
    /// The actor's trained parameters, behind the encoder.
    pub actor: Vec<f32>,
    /// Their slow copy, which is evaluated and frozen.
    pub actor_target: Vec<f32>,
    pub actor_adam: Adam,
    d_actor: Vec<f32>,
    critic_mlp: Mlp,
    /// Two.
    pub critics: Vec<Critic>,
    x: Vec<f32>,
    observations: Vec<f32>,
    pre: Vec<f32>,
    d_pre: Vec<f32>,
    d_x: Vec<f32>,
    targets: Vec<f32>,
    ones: Vec<f32>,
}

impl Learner {
    /// First weights.
    pub fn new(config: &LearnConfig, isa: Isa, rng: &mut impl Rng) -> Self {
        let l = &config.learning;
        let rows = l.batch;
        let net = ActorNet::new(rows);
        let actor = net.initial(rng);
        let critic_mlp = Mlp::new(CRITIC_INPUTS, &l.critic_units, 1);
        let len = critic_mlp.param_len();
        let critics = (0..2)
            .map(|_| {
                let params = critic_mlp.initial(rng, LAST_LAYER_LIMIT);
                Critic {
                    target: params.clone(),
                    params,
                    adam: Adam::new(len),
                    packed: vec![0.0; len],
                    tape: critic_mlp.tape(rows),
                    d: vec![0.0; len],
                    out: vec![0.0; rows],
                    loss: 0.0,
                    norm: 0.0,
                }
            })
            .collect();
        Self {
            isa,
            all_updates: config.updates_due(config.decisions),
            updates: 0,
            actor_target: actor.clone(),
            actor_adam: Adam::new(actor.len()),
            d_actor: vec![0.0; actor.len()],
            actor,
            net,
            critic_mlp,
            critics,
            x: Vec::new(),
            observations: Vec::new(),
            pre: vec![0.0; rows * ACTIONS],
            d_pre: vec![0.0; rows * ACTIONS],
            d_x: vec![0.0; rows * CRITIC_INPUTS],
            targets: vec![0.0; rows],
            ones: Vec::new(),
            config: l.clone(),
        }
    }

    fn rates_share(&self) -> f32 {
        let (from, all) = (self.config.rates_fall_from, self.all_updates.max(1) as f64);
        let over = (self.updates as f64 / all - from).max(0.0) / (1.0 - from).max(1e-9);
        (1.0 - 0.9 * over.min(1.0)) as f32
    }

    /// Sets the observations of a batch, and has an actor decide on them: outputs before saturation in `pre`.
    fn look<'a>(&mut self, of_target: bool, states: impl Iterator<Item = Stored<'a>>) -> Result<usize, ShapeError> {
        self.observations.clear();
        states.for_each(|state| state.push_observation(&mut self.observations));
        let rows = self.observations.len() / OBSERVATION;
        let params = if of_target { &self.actor_target } else { &self.actor };
        self.net
            .forward(self.isa, params, &self.observations, &mut self.pre[..rows * ACTIONS])?;
        Ok(rows)
    }

    /// Sets the critics' inputs: true states, actions, the observations last looked at.
    fn arrange<'a>(&mut self, states: impl Iterator<Item = (Stored<'a>, [f32; ACTIONS])>) {
        self.x.clear();
        for ((state, action), observation) in states.zip(self.observations.chunks_exact(OBSERVATION)) {
            state.push_truth(&mut self.x);
            self.x.extend_from_slice(&action);
            self.x.extend_from_slice(observation);
        }
    }

    /// One update of critics, actor and target networks. Returns each transition's temporal-difference error as well.
    ///
    /// # Errors
    /// A loss or gradient that is not finite; the weights are as they were then.
    pub fn update(&mut self, batch: &[Sample<'_>], rng: &mut impl Rng) -> Result<(UpdateReport, Vec<(usize, f32)>)> {
        let errors = self.critic_step(batch, rng)?;
        let report = self.actor_step(batch)?;
        self.targets_step(report.actor_norm)?;
        Ok((report, errors))
    }

    /// What the decisions turned out to be worth, by the target networks.
    fn set_targets(&mut self, batch: &[Sample<'_>], rng: &mut impl Rng) -> Result<(), ShapeError> {
        let rows = self.look(true, batch.iter().map(|s| s.next))?;
        let limit = 2.0 * self.config.smoothing;
        let actions: Vec<[f32; ACTIONS]> = self.pre[..rows * ACTIONS]
            .chunks_exact(ACTIONS)
            .map(|pre| {
                squash(pre).map(|a| {
                    let noise = (self.config.smoothing * normal(rng)).clamp(-limit, limit);
                    (a + noise).clamp(-ACTOR_LIMIT, ACTOR_LIMIT)
                })
            })
            .collect();
        self.arrange(batch.iter().map(|s| s.next).zip(actions));
        let (isa, mlp, x) = (self.isa, &self.critic_mlp, &self.x);
        self.critics.par_iter_mut().try_for_each(|c| {
            mlp.forward(isa, &c.target, x, &mut c.tape)?;
            c.out[..rows].copy_from_slice(c.tape.out(mlp));
            Ok(())
        })?;
        for (i, (target, step)) in self.targets.iter_mut().zip(batch).enumerate() {
            let lowest = self.critics.iter().map(|c| c.out[i]).fold(f32::INFINITY, f32::min);
            *target = step.reward
                + if step.discount > 0.0 {
                    step.discount * lowest
                } else {
                    0.0
                };
        }
        Ok(())
    }

    /// L = mean of w (Q(s, a) − y)².
    fn critic_step(&mut self, batch: &[Sample<'_>], rng: &mut impl Rng) -> Result<Vec<(usize, f32)>> {
        self.set_targets(batch, rng)?;
        self.look(false, batch.iter().map(|s| s.state))?;
        self.arrange(batch.iter().map(|s| (s.state, s.action)));
        let (isa, mlp, x, targets, count) = (self.isa, &self.critic_mlp, &self.x, &self.targets, batch.len() as f32);
        self.critics
            .par_iter_mut()
            .try_for_each(|c| -> Result<(), ShapeError> {
                mlp.forward(isa, &c.params, x, &mut c.tape)?;
                c.loss = 0.0;
                let values = c.tape.out(mlp).to_vec();
                for (((slot, value), target), step) in c.out.iter_mut().zip(&values).zip(targets).zip(batch) {
                    let error = value - target;
                    *slot = 2.0 * step.weight * error / count;
                    c.loss += step.weight * error * error / count;
                }
                mlp.pack(&c.params, &mut c.packed)?;
                let (packed, out, d) = (&c.packed, &c.out[..batch.len()], Some(&mut *c.d));
                mlp.backward(isa, &c.params, packed, x, &mut c.tape, out, d, None)?;
                c.norm = adam::norm(&c.d) as f32;
                Ok(())
            })?;
        for critic in &self.critics {
            finite(self.updates, "loss", "critic", critic.loss)?;
            finite(self.updates, "gradient", "critic", critic.norm)?;
        }
        let errors = &self.critics[0].out;
        let error = |(i, step): (usize, &Sample<'_>)| (step.leaf, 0.5 * count * errors[i] / step.weight.max(1e-6));
        Ok(batch.iter().enumerate().map(error).collect())
    }

    /// L = mean of penalty − Q(s, μ(s)), through the first critic as it was before this update's step.
    fn actor_step(&mut self, batch: &[Sample<'_>]) -> Result<UpdateReport> {
        let (isa, rows, count) = (self.isa, batch.len(), batch.len() as f32);
        let pre = &self.pre[..rows * ACTIONS];
        for (row, pre) in self.x.chunks_exact_mut(CRITIC_INPUTS).zip(pre.chunks_exact(ACTIONS)) {
            row[TRUE_STATE..TRUE_STATE + ACTIONS].copy_from_slice(&squash(pre));
        }
        self.ones.resize(rows, 1.0);
        let (mlp, critic) = (&self.critic_mlp, &mut self.critics[0]);
        mlp.forward(isa, &critic.params, &self.x, &mut critic.tape)?;
        let mut report = UpdateReport {
            value: critic.tape.out(mlp).iter().sum::<f32>() / count,
            critic_loss: critic.loss,
            critic_norm: critic.norm,
            ..UpdateReport::default()
        };
        let d_x = &mut self.d_x[..rows * CRITIC_INPUTS];
        let (packed, ones) = (&critic.packed, &self.ones[..rows]);
        mlp.backward(
            isa,
            &critic.params,
            packed,
            &self.x,
            &mut critic.tape,
            ones,
            None,
            Some(&mut *d_x),
        )?;
        let d_pre = &mut self.d_pre[..rows * ACTIONS];
        for (i, (d_pre, before)) in d_pre.iter_mut().zip(pre).enumerate() {
            let squashed = libm::tanhf(*before);
            let d_action = -d_x[i / ACTIONS * CRITIC_INPUTS + TRUE_STATE + i % ACTIONS];
            let beyond = before.abs() - 1.0;
            let penalty = if beyond > 0.0 {
                report.saturated += 1.0 / (count * ACTIONS as f32);
                2.0 * self.config.saturation_penalty * beyond.copysign(*before)
            } else {
                0.0
            };
            *d_pre = (d_action * ACTOR_LIMIT * (1.0 - squashed * squashed) + penalty) / count;
        }
        self.net.backward(isa, &self.actor, d_pre, &mut self.d_actor)?;
        report.actor_norm = adam::norm(&self.d_actor) as f32;
        finite(self.updates, "gradient", "actor", report.actor_norm)?;
        Ok(report)
    }

    /// Moves the weights down their gradients, and the target networks after them.
    fn targets_step(&mut self, actor_norm: f32) -> Result<()> {
        let (share, limit, tau) = (self.rates_share(), self.config.gradient_norm, self.config.tau);
        let step = |rate: f32, adam: &mut Adam, params: &mut [f32], d: &mut [f32], norm: f32| {
            let scale = adam::shortening(f64::from(norm), limit);
            adam.step(rate * share, scale, params, d);
        };
        step(
            self.config.actor_rate,
            &mut self.actor_adam,
            &mut self.actor,
            &mut self.d_actor,
            actor_norm,
        );
        soft_update(tau, &self.actor, &mut self.actor_target)?;
        let rate = self.config.critic_rate;
        self.critics.par_iter_mut().try_for_each(|c| {
            step(rate, &mut c.adam, &mut c.params, &mut c.d, c.norm);
            soft_update(tau, &c.params, &mut c.target)
        })?;
        self.updates += 1;
        Ok(())
    }
}

/// Refuses a loss or a gradient of a network that is not finite.
pub(super) fn finite(update: u64, what: &str, network: &str, value: f32) -> Result<()> {
    ensure!(
        value.is_finite(),
        "update {update}: the {what} of the {network} is not finite; lower the learning rates or the gradient norm"
    );
    Ok(())
}
