//! The updates: deterministic policy gradient with critics that see the true state, whatever the actor sees.

use super::actors::{ActorNetwork, LAST_LAYER_LIMIT, Row, push_truth};
use super::mlp::{Mlp, MlpTape};
use super::value_buffer::Step;
use super::value_config::{Sees, ValueConfig, ValueLearning};
use crate::actor_training::adam::{self, Adam};
use crate::actor_training::learner::UpdateError;
use crate::actor_training::networks::squash;
use crate::actor_training::noise::normal;
use rand::Rng;
use serde::{Deserialize, Serialize};
use vigil_nnet::train::soft_update;
use vigil_nnet::{Activation, Dense, Isa, ShapeError};
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_LIMIT, PositionalInputs};
use vigil_sim::environment::true_state::{SIGHT, TRUE_STATE, mover_in_sight};

const ACTIONS: usize = 2;
/// Inputs of a critic: the true state, then the action.
const CRITIC_INPUTS: usize = TRUE_STATE + ACTIONS;
/// Distance to the expert from which on it counts as it is, not squared.
const IMITATION_WIDTH: f32 = 0.2;

/// Tells the mover in sight from the actor's 48 values.
const READOUT: Dense = Dense {
    inputs: ACTOR_HIDDEN,
    outputs: SIGHT,
};

/// An expert: an actor on the true state, and the critics that taught it.
#[derive(Debug, Clone, PartialEq)]
pub struct Expert {
    /// Units of its two layers.
    pub actor_units: [usize; 2],
    /// Its actor's parameters.
    pub actor: Vec<f32>,
    /// Units of the critics' layers.
    pub critic_units: [usize; 2],
    /// The critics' parameters.
    pub critics: Vec<Vec<f32>>,
}

/// A critic with what training keeps about it.
pub struct Critic {
    /// Parameters.
    pub params: Vec<f32>,
    /// Their slow copy.
    pub target: Vec<f32>,
    /// Optimiser.
    pub adam: Adam,
    packed: Vec<f32>,
    tape: MlpTape,
    d: Vec<f32>,
    out: Vec<f32>,
    report: (f32, f32),
}

/// What an update was like; means over its transitions.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ValueReport {
    /// Squared error of the first critic, weighted.
    pub critic_loss: f32,
    /// First critic's value of the actor's own actions.
    pub value: f32,
    /// Distance to the expert.
    pub imitation_loss: f32,
    /// Share of the actor's outputs beyond 1 before the last tanh.
    pub saturated: f32,
    /// Squared error in telling the mover in sight.
    pub motion_loss: f32,
    /// Length of the first critic's gradient.
    pub critic_norm: f32,
    /// Length of the actor's gradient.
    pub actor_norm: f32,
}

impl ValueReport {
    /// The sum, field by field.
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            critic_loss: self.critic_loss + other.critic_loss,
            value: self.value + other.value,
            imitation_loss: self.imitation_loss + other.imitation_loss,
            saturated: self.saturated + other.saturated,
            motion_loss: self.motion_loss + other.motion_loss,
            critic_norm: self.critic_norm + other.critic_norm,
            actor_norm: self.actor_norm + other.actor_norm,
        }
    }

    /// All fields times a factor.
    pub fn scaled(&self, by: f32) -> Self {
        Self {
            critic_loss: self.critic_loss * by,
            value: self.value * by,
            imitation_loss: self.imitation_loss * by,
            saturated: self.saturated * by,
            motion_loss: self.motion_loss * by,
            critic_norm: self.critic_norm * by,
            actor_norm: self.actor_norm * by,
        }
    }
}

/// A critic's first weights, begun with one that sees the true state alone, of which `units` is the first layer: what it sees beside that
/// counts for nothing at first.
fn widened(critic: &[f32], units: usize, further: usize) -> Vec<f32> {
    let (first, rest) = critic.split_at((CRITIC_INPUTS * units).min(critic.len()));
    [first, &vec![0.0; further * units], rest].concat()
}

/// Actor, critics, and the updates made.
pub struct ValueLearner {
    config: ValueLearning,
    isa: Isa,
    all_updates: u64,
    /// Updates made.
    pub updates: u64,
    network: ActorNetwork,
    /// The actor's trained parameters.
    pub actor: Vec<f32>,
    /// Their slow copy.
    pub actor_target: Vec<f32>,
    /// Optimiser.
    pub actor_adam: Adam,
    actor_shares: Vec<f32>,
    d_actor: Vec<f32>,
    /// What tells the mover in sight from the actor's values.
    pub readout: Vec<f32>,
    /// Its optimiser.
    pub readout_adam: Adam,
    critic_mlp: Mlp,
    /// Positional inputs that the critics see.
    further: usize,
    critic_shares: Vec<f32>,
    /// One or two.
    pub critics: Vec<Critic>,
    expert: Option<(Mlp, Vec<f32>, MlpTape)>,
    x: Vec<f32>,
    pre: Vec<f32>,
    d_pre: Vec<f32>,
    d_x: Vec<f32>,
    targets: Vec<f32>,
}

impl ValueLearner {
    /// First weights; the critics' are the expert's where the configuration says so.
    ///
    /// # Errors
    /// An expert of other dimensions than the configuration's.
    pub fn new(
        config: &ValueConfig,
        isa: Isa,
        expert: Option<&Expert>,
        rng: &mut impl Rng,
    ) -> Result<Self, ShapeError> {
        let l = &config.learning;
        let rows = l.batch;
        let network = ActorNetwork::new(config, rows);
        let actor = network.initial(rng)?;
        let further = match (config.sees, l.critics_told) {
            (Sees::Pictures, true) => config.inputs().spec().positional().inputs,
            _ => 0,
        };
        let critic_mlp = Mlp::new(CRITIC_INPUTS + further, &l.critic_units, 1);
        let len = critic_mlp.param_len();
        let mut critics = Vec::new();
        for i in 0..if l.twin { 2 } else { 1 } {
            let first = critic_mlp.initial(rng, LAST_LAYER_LIMIT);
            let taught = expert.filter(|_| l.expert_critics).and_then(|e| e.critics.get(i));
            let params = taught.map_or(first, |critic| widened(critic, l.critic_units[0], further));
            fits("critic of the expert", &params, len)?;
            critics.push(Critic {
                target: params.clone(),
                params,
                adam: Adam::new(len),
                packed: vec![0.0; len],
                tape: critic_mlp.tape(rows),
                d: vec![0.0; len],
                out: vec![0.0; rows],
                report: (0.0, 0.0),
            });
        }
        let expert = expert.map(|e| {
            let mlp = Mlp::new(TRUE_STATE, &e.actor_units, ACTIONS);
            let tape = mlp.tape(rows);
            fits("expert", &e.actor, mlp.param_len())?;
            Ok::<_, ShapeError>((mlp, e.actor.clone(), tape))
        });
        Ok(Self {
            isa,
            all_updates: config.updates_due(config.decisions),
            updates: 0,
            actor_target: actor.clone(),
            actor_adam: Adam::new(actor.len()),
            actor_shares: network.rate_shares(),
            d_actor: vec![0.0; actor.len()],
            readout: vec![0.0; READOUT.param_len()],
            readout_adam: Adam::new(READOUT.param_len()),
            actor,
            network,
            critic_shares: vec![1.0; len],
            critic_mlp,
            critics,
            expert: expert.transpose()?,
            x: Vec::new(),
            pre: vec![0.0; rows * ACTIONS],
            d_pre: vec![0.0; rows * ACTIONS],
            d_x: vec![0.0; rows * (CRITIC_INPUTS + further)],
            further,
            targets: vec![0.0; rows],
            config: l.clone(),
        })
    }

    /// The parameters that are judged and frozen.
    pub fn frozen(&self) -> &[f32] {
        if self.config.freeze_target {
            &self.actor_target
        } else {
            &self.actor
        }
    }

    /// The expert that this run makes of its actor and critics, where the actor sees the true state.
    pub fn as_expert(&self) -> Expert {
        Expert {
            actor_units: self.config.actor_units,
            actor: self.frozen().to_vec(),
            critic_units: self.config.critic_units,
            critics: self.critics.iter().map(|c| c.target.clone()).collect(),
        }
    }

    /// What the expert's word counts in the next update.
    pub fn imitation(&self) -> f32 {
        let over = self.config.imitation_falls_over * self.all_updates as f64;
        let left = if self.config.imitation_stays {
            1.0
        } else if over > 0.0 {
            1.0 - self.updates as f64 / over
        } else {
            0.0
        };
        self.config.imitation * left.max(0.0) as f32
    }

    fn rates_share(&self) -> f32 {
        let (from, all) = (self.config.rates_fall_from, self.all_updates.max(1) as f64);
        let over = (self.updates as f64 / all - from).max(0.0) / (1.0 - from).max(1e-9);
        (1.0 - 0.95 * over.min(1.0)) as f32
    }

    /// First critic's value, and its slope over the two outputs, of one state under one action.
    ///
    /// # Errors
    /// None for a true state.
    pub fn slope(
        &mut self,
        truth: &[f32; TRUE_STATE],
        position: &PositionalInputs,
        action: [f32; 2],
    ) -> Result<(f32, [f32; 2]), ShapeError> {
        let (isa, mlp) = (self.isa, &self.critic_mlp);
        let mut mean = (0.0, [0.0; 2]);
        let count = self.critics.len() as f32;
        for critic in &mut self.critics {
            let mut x = truth.to_vec();
            x.extend_from_slice(&action);
            x.extend_from_slice(&position[..self.further]);
            mlp.forward(isa, &critic.params, &x, &mut critic.tape)?;
            mean.0 += critic.tape.out(mlp)[0] / count;
            mlp.pack(&critic.params, &mut critic.packed)?;
            let d_x = &mut self.d_x[..CRITIC_INPUTS + self.further];
            mlp.backward(
                isa,
                &critic.params,
                &critic.packed,
                &x,
                &mut critic.tape,
                &[1.0],
                None,
                Some(&mut *d_x),
            )?;
            mean.1[0] += d_x[TRUE_STATE] / count;
            mean.1[1] += d_x[TRUE_STATE + 1] / count;
        }
        Ok(mean)
    }

    /// One update of critics, actor and target networks. Returns each transition's temporal-difference error as well.
    ///
    /// # Errors
    /// [`UpdateError`] names a loss or gradient that is not finite; the weights are as they were then.
    pub fn update(
        &mut self,
        batch: &[Step<'_>],
        rng: &mut impl Rng,
    ) -> Result<(ValueReport, Vec<(usize, f32)>), UpdateError> {
        let (isa, rows) = (self.isa, batch.len());
        let (count, imitation) = (rows as f32, self.imitation());
        let mut report = ValueReport::default();

        // What the decisions turned out to be worth.
        let next: Vec<Row<'_>> = batch.iter().map(|s| (s.next, s.mirror)).collect();
        let pre = &mut self.pre[..rows * ACTIONS];
        self.network.forward(isa, &self.actor_target, &next, pre)?;
        self.x.clear();
        for (step, pre) in batch.iter().zip(pre.chunks_exact(ACTIONS)) {
            push_truth(&mut self.x, step.next.truth, step.mirror);
            let limit = 2.0 * self.config.smoothing;
            self.x.extend(squash(pre).map(|a| {
                let noise = (self.config.smoothing * normal(rng)).clamp(-limit, limit);
                (a + noise).clamp(-ACTOR_LIMIT, ACTOR_LIMIT)
            }));
            self.x.extend_from_slice(&step.next.position[..self.further]);
        }
        let (mlp, x) = (&self.critic_mlp, &self.x);
        each(&mut self.critics, |c| {
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

        // Critics: L = mean of w (Q(s, a) − y)².
        self.x.clear();
        for step in batch {
            push_truth(&mut self.x, step.state.truth, step.mirror);
            self.x.extend_from_slice(&mirrored(step.action, step.mirror));
            self.x.extend_from_slice(&step.state.position[..self.further]);
        }
        let (x, targets) = (&self.x, &self.targets);
        each(&mut self.critics, |c| {
            mlp.forward(isa, &c.params, x, &mut c.tape)?;
            let mut loss = 0.0;
            let values = c.tape.out(mlp).to_vec();
            for (((slot, value), target), step) in c.out.iter_mut().zip(&values).zip(targets).zip(batch) {
                let error = value - target;
                *slot = 2.0 * step.weight * error / count;
                loss += step.weight * error * error / count;
            }
            mlp.pack(&c.params, &mut c.packed)?;
            c.d.fill(0.0);
            let (packed, d) = (&c.packed, Some(&mut *c.d));
            mlp.backward(isa, &c.params, packed, x, &mut c.tape, &c.out[..rows], d, None)?;
            c.report = (loss, adam::norm(&[&c.d]) as f32);
            Ok(())
        })?;
        let errors = batch
            .iter()
            .enumerate()
            .map(|(i, step)| (step.leaf, 0.5 * count * self.critics[0].out[i] / step.weight.max(1e-6)))
            .collect();
        (report.critic_loss, report.critic_norm) = self.critics[0].report;
        for critic in &self.critics {
            finite(self.updates, "loss", "critic", critic.report.0)?;
            finite(self.updates, "gradient", "critic", critic.report.1)?;
        }

        // Actor: L = mean of penalty + imitation − Q(s, μ(s)).
        let states: Vec<Row<'_>> = batch.iter().map(|s| (s.state, s.mirror)).collect();
        let pre = &mut self.pre[..rows * ACTIONS];
        self.network.forward(isa, &self.actor, &states, pre)?;
        let inputs = CRITIC_INPUTS + self.further;
        for (row, pre) in self.x.chunks_exact_mut(inputs).zip(pre.chunks_exact(ACTIONS)) {
            row[TRUE_STATE..CRITIC_INPUTS].copy_from_slice(&squash(pre));
        }
        let judge = &mut self.critics[0];
        mlp.forward(isa, &judge.params, &self.x, &mut judge.tape)?;
        report.value = judge.tape.out(mlp).iter().sum::<f32>() / count;
        judge.out[..rows].fill(1.0);
        let d_x = &mut self.d_x[..rows * inputs];
        mlp.backward(
            isa,
            &judge.params,
            &judge.packed,
            &self.x,
            &mut judge.tape,
            &judge.out[..rows],
            None,
            Some(&mut *d_x),
        )?;
        if let Some((expert, params, tape)) = &mut self.expert {
            let truths: Vec<f32> = self
                .x
                .chunks_exact(inputs)
                .flat_map(|row| row[..TRUE_STATE].iter().copied())
                .collect();
            expert.forward(isa, params, &truths, tape)?;
        }
        for (i, (d_pre, before)) in self.d_pre.iter_mut().zip(&*pre).enumerate() {
            let (row, k) = (i / ACTIONS, i % ACTIONS);
            let action = ACTOR_LIMIT * libm::tanhf(*before);
            let mut d_action = -self.config.value_weight * d_x[row * inputs + TRUE_STATE + k];
            let of_expert = || {
                let (expert, _, tape) = self.expert.as_ref()?;
                Some(ACTOR_LIMIT * libm::tanhf(tape.out(expert)[i]))
            };
            if let Some(taught) = batch[row].state.teacher.map(|action| action[k]).or_else(of_expert) {
                let apart = action - taught;
                report.imitation_loss += apart.abs() / count;
                d_action += imitation * (apart / IMITATION_WIDTH).clamp(-1.0, 1.0);
            }
            let slope = ACTOR_LIMIT - action * action / ACTOR_LIMIT;
            let beyond = before.abs() - 1.0;
            let penalty = if beyond > 0.0 {
                report.saturated += 1.0 / (count * ACTIONS as f32);
                2.0 * self.config.saturation_penalty * beyond * before.signum()
            } else {
                0.0
            };
            *d_pre = (d_action * slope + penalty) / count;
        }
        let mut d_readout = Vec::new();
        let d_state = if self.config.motion > 0.0 {
            let mut states = Vec::with_capacity(rows * ACTOR_HIDDEN);
            self.network.states(&mut states);
            let mut told = vec![0.0; rows * SIGHT];
            READOUT.forward(isa, &self.readout, Activation::Identity, &states, None, &mut told)?;
            for (told, step) in told.chunks_exact_mut(SIGHT).zip(batch) {
                let Some(truth) = step.state.truth.as_array::<TRUE_STATE>() else {
                    continue;
                };
                for (told, seen) in told.iter_mut().zip(mover_in_sight(truth)) {
                    let error = *told - seen;
                    report.motion_loss += error * error / count;
                    *told = 2.0 * self.config.motion * error / count;
                }
            }
            d_readout = vec![0.0; READOUT.param_len()];
            READOUT.weight_gradient(isa, &states, &told, &mut d_readout)?;
            let mut packed = vec![0.0; READOUT.param_len()];
            READOUT.pack(&self.readout, &mut packed)?;
            READOUT.input_gradient(isa, &packed, &told, &mut states)?;
            Some(states)
        } else {
            None
        };
        self.d_actor.fill(0.0);
        let d_pre = &self.d_pre[..rows * ACTIONS];
        self.network
            .backward(isa, &self.actor, d_pre, d_state.as_deref(), &mut self.d_actor)?;
        let actor_norm = adam::norm(&[&self.d_actor]);
        report.actor_norm = actor_norm as f32;
        finite(self.updates, "loss", "actor", report.value)?;
        finite(self.updates, "gradient", "actor", report.actor_norm)?;

        let share = self.rates_share();
        let (limit, critic_rate) = (self.config.gradient_norm, share * self.config.critic_rate);
        let (shares, tau) = (&self.critic_shares, self.config.tau);
        each(&mut self.critics, |c| {
            shorten(&mut c.d, f64::from(c.report.1), limit);
            c.adam.step(critic_rate, shares, &mut c.params, &c.d);
            soft_update(tau, &c.params, &mut c.target)
        })?;
        if d_state.is_some() {
            let shares = vec![1.0; d_readout.len()];
            self.readout_adam
                .step(critic_rate, &shares, &mut self.readout, &d_readout);
        }
        if self.updates >= self.config.critics_first {
            shorten(&mut self.d_actor, actor_norm, limit);
            self.actor_adam.step(
                share * self.config.actor_rate,
                &self.actor_shares,
                &mut self.actor,
                &self.d_actor,
            );
            soft_update(tau, &self.actor, &mut self.actor_target)?;
        }
        self.updates += 1;
        Ok((report, errors))
    }
}

/// Both critics at once, on two threads where there are two.
fn each(critics: &mut [Critic], f: impl Fn(&mut Critic) -> Result<(), ShapeError> + Sync) -> Result<(), ShapeError> {
    match critics {
        [one] => f(one),
        [one, two] => {
            let (first, second) = rayon::join(|| f(one), || f(two));
            first.and(second)
        }
        _ => Ok(()),
    }
}

fn shorten(d: &mut [f32], norm: f64, limit: f32) {
    let scale = adam::shortening(norm, limit);
    d.iter_mut().for_each(|d| *d *= scale);
}

fn finite(update: u64, what: &'static str, layer: &'static str, value: f32) -> Result<(), UpdateError> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(UpdateError::NotFinite { update, what, layer })
    }
}

fn fits(what: &'static str, params: &[f32], expected: usize) -> Result<(), ShapeError> {
    if params.len() == expected {
        Ok(())
    } else {
        Err(ShapeError::Length {
            what,
            expected,
            got: params.len(),
        })
    }
}

fn mirrored([forward, yaw]: [f32; 2], mirror: bool) -> [f32; 2] {
    [forward, if mirror { -yaw } else { yaw }]
}

#[cfg(test)]
mod tests {
    use super::super::value_buffer::{StateView, halve};
    use super::super::value_config::Leader;
    use super::*;
    use crate::actor_training::networks::SPEC;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use vigil_policy::actor::WITH_MOVERS;
    use vigil_sim::environment::true_state::MOVER;
    use vigil_types::GoalRelative;

    /// What should be done in a state, and what an action is worth there.
    fn best(truth: &[f32]) -> [f32; 2] {
        [0.8 * truth[0], -0.8 * truth[1]]
    }

    fn worth(truth: &[f32], action: [f32; 2]) -> f32 {
        let best = best(truth);
        1.0 - (action[0] - best[0]).powi(2) - (action[1] - best[1]).powi(2)
    }

    fn config() -> ValueConfig {
        let mut config = ValueConfig::default();
        config.learning.batch = 64;
        config.learning.critic_units = [32, 32];
        config.learning.actor_units = [32, 32];
        config.learning.actor_rate = 3e-3;
        config.learning.critic_rate = 3e-3;
        config.learning.freeze_target = false;
        config
    }

    fn truths(rng: &mut ChaCha8Rng, rows: usize) -> Vec<Vec<f32>> {
        (0..rows)
            .map(|_| (0..TRUE_STATE).map(|_| rng.random_range(-1.0..1.0)).collect())
            .collect()
    }

    /// Updates on actions drawn at random, in states after which nothing follows.
    fn learn(learner: &mut ValueLearner, rng: &mut ChaCha8Rng, updates: usize) {
        for _ in 0..updates {
            let truths = truths(rng, 64);
            let batch: Vec<Step<'_>> = truths
                .iter()
                .enumerate()
                .map(|(leaf, truth)| {
                    let action = [rng.random_range(-1.5..1.5), rng.random_range(-1.5..1.5)];
                    let state = StateView {
                        truth,
                        features: [&[]; 5],
                        position: PositionalInputs::of_goal(GoalRelative::default()),
                        teacher: None,
                    };
                    Step {
                        leaf,
                        state,
                        action,
                        reward: worth(truth, action),
                        discount: 0.0,
                        next: state,
                        weight: 1.0,
                        mirror: false,
                    }
                })
                .collect();
            learner.update(&batch, rng).unwrap();
        }
    }

    fn mean_worth(learner: &ValueLearner, rng: &mut ChaCha8Rng) -> f32 {
        let mlp = Mlp::new(TRUE_STATE, &[32, 32], 2);
        let mut tape = mlp.tape(1);
        let truths = truths(rng, 200);
        let sum: f32 = truths
            .iter()
            .map(|truth| {
                mlp.forward(Isa::detect(), &learner.actor, truth, &mut tape).unwrap();
                worth(truth, squash(tape.out(&mlp)))
            })
            .sum();
        sum / 200.0
    }

    /// Nobody shows the actor what to do; were the critic's slope taken with the wrong sign, it would go to its limits, where the
    /// mean is below −2.
    #[test]
    fn the_value_alone_teaches_what_is_best() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut learner = ValueLearner::new(&config(), Isa::detect(), None, &mut rng).unwrap();
        let first = mean_worth(&learner, &mut rng);
        assert!((0.4..0.75).contains(&first), "an actor that does nothing: {first}");
        learn(&mut learner, &mut rng, 600);
        let last = mean_worth(&learner, &mut rng);
        assert!(last > 0.9, "{first}, then {last}");
        // The slope points to what is better, from either side of it.
        let mut truth = [0.0; TRUE_STATE];
        truth[1] = -0.5;
        let (_, above) = learner.slope(&truth, &[0.0; 2].into(), [0.0, 1.2]).unwrap();
        let (_, below) = learner.slope(&truth, &[0.0; 2].into(), [0.0, -0.4]).unwrap();
        assert!(above[1] < -0.3 && below[1] > 0.3, "{above:?} {below:?}");
    }

    /// What is left of the readout's squared error after some updates; the actor begins to move after the first `critics_first`.
    fn untold_motion(critics_first: u64) -> f32 {
        let mut config = config();
        config.learning.critics_first = critics_first;
        config.sees = Sees::Pictures;
        config.learning.motion = 1.0;
        config.learning.value_weight = 0.0;
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut learner = ValueLearner::new(&config, Isa::detect(), None, &mut rng).unwrap();
        let mut losses = Vec::new();
        for _ in 0..300 {
            let movers: Vec<([f32; TRUE_STATE], [Vec<u16>; 5])> = (0..64)
                .map(|_| {
                    let (aside, velocity) = (rng.random_range(-0.5..0.5), rng.random_range(-1.0..1.0));
                    let mut truth = [0.0; TRUE_STATE];
                    truth[MOVER..MOVER + 5].copy_from_slice(&[0.9, 0.8, aside, 0.0, velocity]);
                    let frames = core::array::from_fn(|age| {
                        let place: f32 = aside - 0.2 * (4 - age) as f32 * velocity;
                        (0..SPEC.features())
                            .map(|k| halve(libm::expf(-8.0 * (place - (k as f32 / 512.0 - 1.0)).powi(2))))
                            .collect()
                    });
                    (truth, frames)
                })
                .collect();
            let batch: Vec<Step<'_>> = movers
                .iter()
                .enumerate()
                .map(|(leaf, (truth, frames))| {
                    let state = StateView {
                        truth,
                        features: core::array::from_fn(|i| frames[i].as_slice()),
                        position: PositionalInputs::of_goal(GoalRelative::default()),
                        teacher: None,
                    };
                    Step {
                        leaf,
                        state,
                        action: [0.0; 2],
                        reward: 0.0,
                        discount: 0.0,
                        next: state,
                        weight: 1.0,
                        mirror: false,
                    }
                })
                .collect();
            losses.push(learner.update(&batch, &mut rng).unwrap().0.motion_loss);
        }
        losses[280..].iter().sum::<f32>() / 20.0
    }

    /// Each frame shows a mover's place only. The readout's error teaches the actor's values to tell its velocity, more than a readout
    /// finds in values that do not learn.
    #[test]
    fn the_actors_values_come_to_tell_how_a_mover_moves() {
        let (taught, untaught) = (untold_motion(0), untold_motion(u64::MAX));
        // The place without the velocity would leave the velocity's variance, 0.27.
        assert!(taught < 0.1 && taught < 0.5 * untaught, "{taught}; {untaught} untaught");
    }

    /// Critics that are told more begin with the expert's word, and what they are told has a say once they learn.
    #[test]
    fn critics_that_are_told_more_begin_as_the_experts() {
        let mut config = ValueConfig {
            sees: Sees::Pictures,
            led_by: Leader::Path,
            told_of_movers: true,
            ..ValueConfig::default()
        };
        config.learning.critic_units = [8, 8];
        config.learning.expert_critics = true;
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let critic = Mlp::new(CRITIC_INPUTS, &[8, 8], 1);
        let expert = Expert {
            actor_units: [8, 8],
            actor: vec![0.0; Mlp::new(TRUE_STATE, &[8, 8], 2).param_len()],
            critic_units: [8, 8],
            critics: (0..2).map(|_| critic.initial(&mut rng, 0.5)).collect(),
        };
        let truth: [f32; TRUE_STATE] = core::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let told: Vec<f32> = (0..WITH_MOVERS).map(|_| rng.random_range(-1.0..1.0)).collect();
        let told = PositionalInputs::from_values(&told).unwrap();
        let values: Vec<(f32, [f32; 2])> = [false, true]
            .into_iter()
            .map(|critics_told| {
                config.learning.critics_told = critics_told;
                let mut learner = ValueLearner::new(&config, Isa::detect(), Some(&expert), &mut rng).unwrap();
                assert_eq!(learner.further, if critics_told { WITH_MOVERS } else { 0 });
                learner.slope(&truth, &told, [0.3, -0.7]).unwrap()
            })
            .collect();
        assert!((values[0].0 - values[1].0).abs() < 1e-5, "{values:?}");
        for (a, b) in values[0].1.iter().zip(values[1].1) {
            assert!((a - b).abs() < 1e-5 && *a != 0.0, "{values:?}");
        }
    }

    #[test]
    fn the_experts_word_ends_at_half_of_the_run() {
        let mut config = config();
        config.learning.imitation = 2.0;
        let expert = Expert {
            actor_units: [8, 8],
            actor: vec![0.0; Mlp::new(TRUE_STATE, &[8, 8], 2).param_len()],
            critic_units: config.learning.critic_units,
            critics: Vec::new(),
        };
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut learner = ValueLearner::new(&config, Isa::detect(), Some(&expert), &mut rng).unwrap();
        let all = config.updates_due(config.decisions);
        for (updates, expected) in [(0, 2.0), (all / 4, 1.0), (all / 2, 0.0), (all, 0.0)] {
            learner.updates = updates;
            assert!((learner.imitation() - expected).abs() < 1e-2, "{updates}");
        }
        let short = Expert {
            actor: vec![0.0; 3],
            ..expert
        };
        assert!(ValueLearner::new(&config, Isa::detect(), Some(&short), &mut rng).is_err());
    }
}
