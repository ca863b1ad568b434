//! What the environments lived through: true states, observations, actions, rewards.

use crate::trainer::config::LearnConfig;
use crate::trainer::observation::{OBSERVATION, mirror as mirror_observation};
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use vigil_nnet::train::SumTree;
use vigil_sim::environment::true_state::{TRUE_STATE, mirror as mirror_truth};

/// Keeps every transition possible to sample.
const LEAST_PRIORITY: f64 = 1e-3;
/// Values stored of a state.
const STATE: usize = TRUE_STATE + OBSERVATION;

/// What follows a decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Next {
    /// The next decision of the trajectory.
    Decision,
    /// Nothing: success, collision, out of bounds.
    Terminal,
    /// The next entry of the trajectory is the state in which the flight was cut off.
    CutOff,
    /// This is that state; no action was taken in it.
    Nothing,
}

/// A decision, beside its state.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Transition {
    /// The action flown, the mean over the decision's steps.
    pub action: [f32; 2],
    pub reward: f32,
    pub next: Next,
}

/// One environment's decisions, oldest overwritten first.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trajectory {
    capacity: u64,
    /// True state and observation of each decision, in the upper half of their bits (bfloat16).
    pub states: Vec<u16>,
    pub transitions: Vec<Transition>,
    /// Decisions ever stored.
    pub next: u64,
    settled: u64,
}

/// Keeps the upper half of a number, rounded.
fn halve(value: f32) -> u16 {
    ((value.to_bits() + 0x7fff + ((value.to_bits() >> 16) & 1)) >> 16) as u16
}

/// The number whose upper half was kept.
fn double(kept: u16) -> f32 {
    f32::from_bits(u32::from(kept) << 16)
}

impl Trajectory {
    /// Stores a decision.
    pub fn push(&mut self, truth: &[f32; TRUE_STATE], observation: &[f32; OBSERVATION], transition: Transition) {
        let slot = self.slot(self.next);
        let state = truth.iter().chain(observation).map(|x| halve(*x));
        if slot < self.transitions.len() {
            let stored = &mut self.states[slot * STATE..(slot + 1) * STATE];
            stored.iter_mut().zip(state).for_each(|(to, x)| *to = x);
            self.transitions[slot] = transition;
        } else {
            self.states.extend(state);
            self.transitions.push(transition);
        }
        self.next += 1;
    }

    fn slot(&self, number: u64) -> usize {
        (number % self.capacity) as usize
    }

    fn transition(&self, number: u64) -> &Transition {
        &self.transitions[self.slot(number)]
    }

    fn state(&self, number: u64) -> &[u16] {
        let slot = self.slot(number);
        &self.states[slot * STATE..(slot + 1) * STATE]
    }

    /// Whether the return of decision `number` over up to `n_steps` lies within what is stored.
    fn is_known(&self, number: u64, n_steps: usize) -> bool {
        (number..self.next)
            .take(n_steps)
            .find_map(|n| match self.transition(n).next {
                Next::Decision => None,
                Next::CutOff => Some(n + 1 < self.next),
                Next::Terminal | Next::Nothing => Some(true),
            })
            .unwrap_or(number.saturating_add(n_steps as u64) < self.next)
    }
}

/// A stored state, seen in a mirror or not.
#[derive(Debug, Clone, Copy)]
pub struct Stored<'a>(&'a [u16], bool);

impl Stored<'_> {
    pub fn push_truth(&self, to: &mut Vec<f32>) {
        let truth: [f32; TRUE_STATE] = core::array::from_fn(|k| double(self.0[k]));
        to.extend_from_slice(&if self.1 { mirror_truth(&truth) } else { truth });
    }

    pub fn push_observation(&self, to: &mut Vec<f32>) {
        let from = to.len();
        to.extend(self.0[TRUE_STATE..].iter().map(|x| double(*x)));
        if self.1 {
            mirror_observation(&mut to[from..]);
        }
    }
}

/// A sampled transition over up to n decisions.
#[derive(Debug, Clone, Copy)]
pub struct Sample<'a> {
    /// Where it is in the tree, for its new priority.
    pub leaf: usize,
    pub state: Stored<'a>,
    /// The action flown, as seen in the mirror if the state is.
    pub action: [f32; 2],
    pub reward: f32,
    /// What the value of `next` counts: γⁿ, or 0 behind a terminal state.
    pub discount: f32,
    /// The state after them; the state itself behind a terminal one.
    pub next: Stored<'a>,
    /// Importance weight, at most 1.
    pub weight: f32,
}

/// The replay memory of all environments, sampled by priority (Schaul et al. 2016).
pub struct Replay {
    pub trajectories: Vec<Trajectory>,
    /// The priorities of all trajectories' decisions, each in a place of its own.
    tree: SumTree,
    /// The largest priority that was ever set.
    largest: f64,
    config: LearnConfig,
}

impl Replay {
    pub fn new(config: &LearnConfig) -> Self {
        let count = config.environments;
        let capacity = config.replay.decisions / count;
        let lane = Trajectory {
            capacity: capacity as u64,
            ..Trajectory::default()
        };
        Self {
            trajectories: vec![lane; count],
            tree: SumTree::new(count * capacity),
            largest: 1.0,
            config: config.clone(),
        }
    }

    /// Gives new decisions whose outcome is known their place in the tree and takes out those that are overwritten.
    pub fn settle(&mut self) {
        for (i, lane) in (0..).zip(&mut self.trajectories) {
            let leaf = |number: u64| (i * lane.capacity + number % lane.capacity) as usize;
            while lane.settled < lane.next && lane.is_known(lane.settled, self.config.learning.n_steps) {
                // Sampled as if its error were the largest, unless nothing was done in it.
                let is_nothing = lane.transition(lane.settled).next == Next::Nothing;
                let priority = if is_nothing { 0.0 } else { self.largest };
                self.tree.set(leaf(lane.settled), priority);
                lane.settled += 1;
            }
            for number in lane.settled..lane.next {
                self.tree.set(leaf(number), 0.0);
            }
        }
    }

    /// Transitions in proportion to their priorities, one from each of `count` equal parts of the sum; none while there are none.
    pub fn sample(&self, count: usize, rng: &mut impl Rng) -> Vec<Sample<'_>> {
        let held: f64 = self.trajectories.iter().map(|l| l.transitions.len() as f64).sum();
        let mut batch = Vec::with_capacity(count);
        let mut weights = Vec::with_capacity(count);
        for k in 0..count {
            let u: f64 = rng.random_range(0.0..1.0);
            let Some(leaf) = self.tree.find((k as f64 + u) / count as f64 * self.tree.total()) else {
                return Vec::new();
            };
            let (priority, total) = (self.tree.get(leaf), self.tree.total());
            let share = (held * priority / total).max(f64::MIN_POSITIVE);
            weights.push(share.powf(-self.config.replay.beta));
            batch.push(self.step(leaf, self.config.learning.mirror && rng.random_bool(0.5)));
        }
        let largest = weights.iter().copied().fold(0.0, f64::max);
        for (step, weight) in batch.iter_mut().zip(weights) {
            step.weight = (weight / largest) as f32;
        }
        batch
    }

    fn step(&self, leaf: usize, mirror: bool) -> Sample<'_> {
        let capacity = self.trajectories[0].capacity;
        let (lane, slot) = (&self.trajectories[leaf / capacity as usize], leaf as u64 % capacity);
        let last = lane.next - 1;
        // The newest that lies there.
        let number = last - (last + capacity - slot) % capacity;
        let (mut reward, mut discount, mut at) = (0.0, 1.0, number);
        let next = loop {
            let decision = lane.transition(at);
            reward += discount * decision.reward;
            discount *= self.config.learning.gamma;
            at += 1;
            match decision.next {
                Next::Terminal | Next::Nothing => {
                    discount = 0.0;
                    break number;
                }
                Next::CutOff => break at,
                Next::Decision if at - number == self.config.learning.n_steps as u64 => break at,
                Next::Decision => {}
            }
        };
        let [forward, yaw] = lane.transition(number).action;
        Sample {
            leaf,
            state: Stored(lane.state(number), mirror),
            action: [forward, if mirror { -yaw } else { yaw }],
            reward,
            discount,
            next: Stored(lane.state(next), mirror),
            weight: 1.0,
        }
    }

    /// Sets the priority of a sampled transition from its temporal-difference error.
    pub fn set_error(&mut self, leaf: usize, error: f32) {
        // An overwritten or ended place stays out.
        if self.tree.get(leaf) > 0.0 {
            let priority = (f64::from(error.abs()) + LEAST_PRIORITY).powf(self.config.replay.alpha);
            self.largest = self.largest.max(priority);
            self.tree.set(leaf, priority);
        }
    }

    /// All priorities, the largest that was ever set, and of each trajectory how many decisions were stored and are settled.
    pub fn places(&self) -> (Vec<f64>, f64, Vec<(u64, u64)>) {
        let priorities = (0..self.tree.slots()).map(|i| self.tree.get(i)).collect();
        let lanes = self.trajectories.iter().map(|l| (l.next, l.settled)).collect();
        (priorities, self.largest, lanes)
    }

    /// Takes over what [`Self::places`] gave, the trajectories' content being back. `false` if it does not fit.
    #[must_use]
    pub fn restore(&mut self, priorities: &[f64], largest: f64, lanes: &[(u64, u64)]) -> bool {
        if self.tree.slots() != priorities.len() || self.trajectories.len() != lanes.len() {
            return false;
        }
        self.largest = largest;
        for (i, priority) in priorities.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            self.tree.set(i, *priority);
        }
        self.trajectories.iter_mut().zip(lanes).all(|(lane, &(next, settled))| {
            (lane.next, lane.settled) = (next, settled);
            let held = next.min(lane.capacity) as usize;
            lane.transitions.len() == held && lane.states.len() == held * STATE
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn replay(capacity: usize) -> Replay {
        let mut config = LearnConfig {
            environments: 1,
            ..LearnConfig::default()
        };
        config.replay.decisions = capacity;
        config.learning.gamma = 0.5;
        config.learning.n_steps = 3;
        Replay::new(&config)
    }

    fn push(memory: &mut Replay, reward: f32, next: Next) {
        let number = memory.trajectories[0].next;
        let mut truth = [0.0; TRUE_STATE];
        truth[0] = number as f32;
        let transition = Transition {
            action: [0.25, 0.5],
            reward,
            next,
        };
        memory.trajectories[0].push(&truth, &[0.0; OBSERVATION], transition);
        memory.settle();
    }

    fn number(state: Stored<'_>) -> f32 {
        let mut truth = Vec::new();
        state.push_truth(&mut truth);
        truth[0]
    }

    #[test]
    fn returns_reach_three_decisions_ahead_but_not_past_an_end() {
        let mut m = replay(100);
        for (reward, next) in [
            (1.0, Next::Decision),
            (2.0, Next::Decision),
            (4.0, Next::Decision),
            (8.0, Next::Terminal),
            (16.0, Next::CutOff),
            (0.0, Next::Nothing),
        ] {
            push(&mut m, reward, next);
        }
        let seen: Vec<(f32, f32, f32)> = (0..5)
            .map(|leaf| {
                let step = m.step(leaf, false);
                (step.reward, step.discount, number(step.next))
            })
            .collect();
        assert_eq!(seen[0], (1.0 + 1.0 + 1.0, 0.125, 3.0));
        assert_eq!(seen[1], (2.0 + 2.0 + 2.0, 0.0, 1.0));
        assert_eq!(seen[3], (8.0, 0.0, 3.0));
        assert_eq!(seen[4], (16.0, 0.5, 5.0));
        assert_eq!(
            (m.step(0, false).action, m.step(0, true).action),
            ([0.25, 0.5], [0.25, -0.5])
        );
    }

    #[test]
    fn only_what_has_an_outcome_is_sampled() {
        let mut m = replay(32);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        assert!(m.sample(4, &mut rng).is_empty());
        for n in 0..50 {
            push(&mut m, 1.0, Next::Decision);
            assert_eq!(m.sample(4, &mut rng).is_empty(), n < 3, "{n}");
        }
        for _ in 0..200 {
            for step in m.sample(8, &mut rng) {
                assert!((18.0..47.0).contains(&number(step.state)));
            }
        }
    }

    #[test]
    fn halves_round_to_the_nearest() {
        for x in [0.0, 1.0, -0.3333, 123.456, -1e-3] {
            let error = (double(halve(x)) - x).abs();
            assert!(error <= x.abs() / 256.0, "{x}");
        }
    }
}
