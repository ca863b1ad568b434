//! The updates: deterministic policy gradient (Lillicrap et al. 2016) with twin critics (Fujimoto et al. 2018) that see the true state and
//! what the actor observes: of the state alone, the gradient of an actor that remembers is biased (Baisero, Amato 2021).

use crate::trainer::actor_net::{ActorNet, LAST_LAYER_LIMIT, squash};
use crate::trainer::config::{LearnConfig, LearningConfig};
use crate::trainer::mlp::Mlp;
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

/// A network's parameters, and what moves them.
pub struct Trained {
    pub params: Vec<f32>,
    /// Their slow copy: of the actor, what is evaluated and frozen.
    pub target: Vec<f32>,
    pub adam: Adam,
    /// Their gradient, and its length.
    d: Vec<f32>,
    norm: f32,
}

impl Trained {
    fn new(params: Vec<f32>) -> Self {
        Self {
            target: params.clone(),
            adam: Adam::new(params.len()),
            d: vec![0.0; params.len()],
            params,
            norm: 0.0,
        }
    }

    /// Its numbers, each with the end of its name in a checkpoint.
    pub fn parts(&mut self) -> [(&'static str, &mut Vec<f32>); 4] {
        [
            ("", &mut self.params),
            ("_target", &mut self.target),
            ("_mean", &mut self.adam.mean),
            ("_square", &mut self.adam.square),
        ]
    }

    /// Moves the weights down their gradient, and their slow copy after them.
    fn step(&mut self, rate: f32, config: &LearningConfig) -> Result<(), ShapeError> {
        let scale = adam::shortening(f64::from(self.norm), config.gradient_norm);
        self.adam.step(rate, scale, &mut self.params, &mut self.d);
        soft_update(config.tau, &self.params, &mut self.target)
    }
}

struct Critic {
    net: Trained,
    mlp: Mlp,
    d_out: Vec<f32>,
    loss: f32,
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
    /// The actor behind the encoder.
    pub actor: Trained,
    critics: [Critic; 2],
    x: Vec<f32>,
    observations: Vec<f32>,
    pre: Vec<f32>,
}

impl Learner {
    /// First weights.
    pub fn new(config: &LearnConfig, isa: Isa, rng: &mut impl Rng) -> Self {
        let l = &config.learning;
        let rows = l.batch;
        let net = ActorNet::new(rows);
        let actor = Trained::new(net.initial(rng));
        let critics = core::array::from_fn(|_| {
            let mlp = Mlp::new(rows, CRITIC_INPUTS, &l.critic_units, 1, true);
            Critic {
                net: Trained::new(mlp.initial(rng, LAST_LAYER_LIMIT)),
                mlp,
                d_out: Vec::new(),
                loss: 0.0,
            }
        });
        Self {
            isa,
            all_updates: config.updates_due(config.decisions),
            updates: 0,
            actor,
            net,
            critics,
            x: Vec::new(),
            observations: Vec::new(),
            pre: Vec::new(),
            config: l.clone(),
        }
    }

    /// All networks, each with its name in a checkpoint.
    pub fn networks(&mut self) -> [(&'static str, &mut Trained); 3] {
        let [first, second] = &mut self.critics;
        [
            ("actor", &mut self.actor),
            ("critic_0", &mut first.net),
            ("critic_1", &mut second.net),
        ]
    }

    fn rates_share(&self) -> f32 {
        let (from, all) = (self.config.rates_fall_from, self.all_updates.max(1) as f64);
        let over = (self.updates as f64 / all - from).max(0.0) / (1.0 - from).max(1e-9);
        (1.0 - 0.9 * over.min(1.0)) as f32
    }

    /// Sets the observations of a batch, and has an actor decide on them: outputs before saturation in `pre`.
    fn look<'a>(&mut self, of_target: bool, states: impl Iterator<Item = Stored<'a>>) -> Result<(), ShapeError> {
        self.observations.clear();
        states.for_each(|state| state.push_observation(&mut self.observations));
        let actor = &self.actor;
        let params = if of_target { &actor.target } else { &actor.params };
        self.pre = self.net.forward(self.isa, params, &self.observations)?.to_vec();
        Ok(())
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
        let (share, config) = (self.rates_share(), &self.config);
        self.actor.step(config.actor_rate * share, config)?;
        let rate = config.critic_rate * share;
        self.critics.par_iter_mut().try_for_each(|c| c.net.step(rate, config))?;
        self.updates += 1;
        Ok((report, errors))
    }

    /// What the decisions turned out to be worth, by the target networks.
    fn targets(&mut self, batch: &[Sample<'_>], rng: &mut impl Rng) -> Result<Vec<f32>, ShapeError> {
        self.look(true, batch.iter().map(|s| s.next))?;
        let limit = 2.0 * self.config.smoothing;
        let actions: Vec<[f32; ACTIONS]> = self
            .pre
            .chunks_exact(ACTIONS)
            .map(|pre| {
                squash(pre).map(|a| {
                    let noise = (self.config.smoothing * normal(rng)).clamp(-limit, limit);
                    (a + noise).clamp(-ACTOR_LIMIT, ACTOR_LIMIT)
                })
            })
            .collect();
        self.arrange(batch.iter().map(|s| s.next).zip(actions));
        let (isa, x) = (self.isa, &self.x);
        let critics = self.critics.par_iter_mut();
        critics.try_for_each(|c| c.mlp.forward(isa, &c.net.target, x))?;
        let [first, second] = self.critics.each_ref().map(|c| &c.mlp.out);
        let lowest = first.iter().zip(second).map(|(a, b)| f32::INFINITY.min(*a).min(*b));
        let worth = |(step, lowest): (&Sample<'_>, f32)| {
            let share = step.discount;
            step.reward + if share > 0.0 { share * lowest } else { 0.0 }
        };
        Ok(batch.iter().zip(lowest).map(worth).collect())
    }

    /// L = mean of w (Q(s, a) − y)².
    fn critic_step(&mut self, batch: &[Sample<'_>], rng: &mut impl Rng) -> Result<Vec<(usize, f32)>> {
        let targets = &self.targets(batch, rng)?;
        self.look(false, batch.iter().map(|s| s.state))?;
        self.arrange(batch.iter().map(|s| (s.state, s.action)));
        let (isa, x, count) = (self.isa, &self.x, batch.len() as f32);
        self.critics
            .par_iter_mut()
            .try_for_each(|c| -> Result<(), ShapeError> {
                let net = &mut c.net;
                c.mlp.forward(isa, &net.params, x)?;
                c.loss = 0.0;
                c.d_out.clear();
                for ((value, target), step) in c.mlp.out.iter().zip(targets).zip(batch) {
                    let error = value - target;
                    c.d_out.push(2.0 * step.weight * error / count);
                    c.loss += step.weight * error * error / count;
                }
                c.mlp.backward(isa, &net.params, x, &c.d_out, Some(&mut net.d), None)?;
                net.norm = adam::norm(&net.d) as f32;
                Ok(())
            })?;
        for critic in &self.critics {
            finite(self.updates, "loss", "critic", critic.loss)?;
            finite(self.updates, "gradient", "critic", critic.net.norm)?;
        }
        let errors = &self.critics[0].d_out;
        let error = |(i, step): (usize, &Sample<'_>)| (step.leaf, 0.5 * count * errors[i] / step.weight.max(1e-6));
        Ok(batch.iter().enumerate().map(error).collect())
    }

    /// L = mean of penalty − Q(s, μ(s)), through the first critic as it was before this update's step.
    fn actor_step(&mut self, batch: &[Sample<'_>]) -> Result<UpdateReport> {
        let (isa, rows, count) = (self.isa, batch.len(), batch.len() as f32);
        let actions = self.pre.chunks_exact(ACTIONS);
        for (row, pre) in self.x.chunks_exact_mut(CRITIC_INPUTS).zip(actions) {
            row[TRUE_STATE..TRUE_STATE + ACTIONS].copy_from_slice(&squash(pre));
        }
        let critic = &mut self.critics[0];
        let (params, mlp) = (&critic.net.params, &mut critic.mlp);
        mlp.forward(isa, params, &self.x)?;
        let mut report = UpdateReport {
            value: mlp.out.iter().sum::<f32>() / count,
            critic_loss: critic.loss,
            critic_norm: critic.net.norm,
            ..UpdateReport::default()
        };
        let mut d_x = vec![0.0; rows * CRITIC_INPUTS];
        mlp.backward(isa, params, &self.x, &vec![1.0; rows], None, Some(&mut d_x))?;
        let d_pre = self.pre.iter().enumerate().map(|(i, before)| {
            let squashed = libm::tanhf(*before);
            let d_action = -d_x[i / ACTIONS * CRITIC_INPUTS + TRUE_STATE + i % ACTIONS];
            let beyond = before.abs() - 1.0;
            let penalty = if beyond > 0.0 {
                report.saturated += 1.0 / (count * ACTIONS as f32);
                2.0 * self.config.saturation_penalty * beyond.copysign(*before)
            } else {
                0.0
            };
            (d_action * ACTOR_LIMIT * (1.0 - squashed * squashed) + penalty) / count
        });
        let (d_pre, actor): (Vec<f32>, _) = (d_pre.collect(), &mut self.actor);
        self.net.backward(isa, &actor.params, &d_pre, &mut actor.d)?;
        actor.norm = adam::norm(&actor.d) as f32;
        report.actor_norm = actor.norm;
        finite(self.updates, "gradient", "actor", report.actor_norm)?;
        Ok(report)
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
