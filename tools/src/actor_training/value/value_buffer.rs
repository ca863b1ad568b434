//! What the environments lived through: true states, kept features of the frames, actions, rewards.

use super::value_config::ValueConfig;
use crate::actor_training::priorities::{Priorities, Returns, newest_in_slot, normalised};
use crate::actor_training::replay_buffer::Next;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use vigil_policy::actor::{ACTOR_FRAMES, PositionalInputs};
use vigil_sim::environment::true_state::TRUE_STATE;

/// Decisions between the newest frame of a state and each of its five, oldest first: with four steps to a decision 1.6, 0.8, 0.4,
/// 0.2 and 0 s. Motion shows over that time, and features that are kept cost nothing in flight.
pub const FRAME_DECISIONS: [u64; ACTOR_FRAMES] = [8, 4, 2, 1, 0];

/// Positional inputs in a checkpoint: their values.
mod values {
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
    use vigil_policy::actor::PositionalInputs;

    pub fn serialize<S: Serializer>(inputs: &PositionalInputs, to: S) -> Result<S::Ok, S::Error> {
        inputs[..].serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<PositionalInputs, D::Error> {
        let values = Vec::<f32>::deserialize(from)?;
        PositionalInputs::from_values(&values)
            .ok_or_else(|| D::Error::custom(format!("no actor has {} positional inputs", values.len())))
    }
}

/// A decision.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// Number of the flight's first decision in its lane.
    pub first: u64,
    /// The positional inputs.
    #[serde(with = "values")]
    pub position: PositionalInputs,
    /// What the teacher would have done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub teacher: Option<[f32; 2]>,
    /// The action flown, the mean over the decision's steps.
    pub action: [f32; 2],
    /// Its reward.
    pub reward: f32,
    /// What follows.
    pub next: Next,
}

/// One environment's decisions, oldest overwritten first.
#[derive(Debug, Clone, PartialEq)]
pub struct ValueLane {
    capacity: u64,
    width: usize,
    /// True states `[decision][TRUE_STATE]`.
    pub truths: Vec<f32>,
    /// Features in the upper half of their bits (bfloat16) `[decision][width]`.
    pub features: Vec<u16>,
    /// The rest.
    pub moments: Vec<Moment>,
    /// Decisions ever kept.
    pub next: u64,
    settled: u64,
}

/// Keeps the upper half of a number, rounded.
pub fn halve(value: f32) -> u16 {
    ((value.to_bits() + 0x7fff + ((value.to_bits() >> 16) & 1)) >> 16) as u16
}

/// The number whose upper half was kept.
pub fn double(kept: u16) -> f32 {
    f32::from_bits(u32::from(kept) << 16)
}

impl ValueLane {
    /// An empty lane; `width` is the number of features of a frame.
    pub fn new(capacity: usize, width: usize) -> Self {
        Self {
            capacity: capacity as u64,
            width,
            truths: Vec::new(),
            features: Vec::new(),
            moments: Vec::new(),
            next: 0,
            settled: 0,
        }
    }

    /// Keeps a decision.
    pub fn push(&mut self, truth: &[f32; TRUE_STATE], features: &[u16], moment: Moment) {
        let slot = (self.next % self.capacity) as usize;
        if slot < self.moments.len() {
            self.truths[slot * TRUE_STATE..(slot + 1) * TRUE_STATE].copy_from_slice(truth);
            self.features[slot * self.width..(slot + 1) * self.width].copy_from_slice(features);
            self.moments[slot] = moment;
        } else {
            self.truths.extend_from_slice(truth);
            self.features.extend_from_slice(features);
            self.moments.push(moment);
        }
        self.next += 1;
    }

    fn slot(&self, number: u64) -> usize {
        (number % self.capacity) as usize
    }

    fn moment(&self, number: u64) -> &Moment {
        &self.moments[self.slot(number)]
    }

    fn oldest(&self) -> u64 {
        self.next.saturating_sub(self.capacity)
    }

    /// A kept decision's state.
    pub fn view(&self, number: u64) -> StateView<'_> {
        let (slot, moment) = (self.slot(number), self.moment(number));
        StateView {
            truth: &self.truths[slot * TRUE_STATE..(slot + 1) * TRUE_STATE],
            features: core::array::from_fn(|i| {
                let frame = self.slot(number.saturating_sub(FRAME_DECISIONS[i]).max(moment.first));
                &self.features[frame * self.width..(frame + 1) * self.width]
            }),
            position: moment.position,
            teacher: moment.teacher,
        }
    }

    /// The features of the newest frames, as a state made of `newest` would have them; `first` is the flight's first decision, and
    /// the newest frame belongs to the decision about to be kept.
    pub fn window<'a>(&'a self, first: u64, newest: &'a [u16]) -> [&'a [u16]; ACTOR_FRAMES] {
        core::array::from_fn(|i| {
            let number = self.next.saturating_sub(FRAME_DECISIONS[i]).max(first);
            if number == self.next {
                return newest;
            }
            let slot = self.slot(number);
            &self.features[slot * self.width..(slot + 1) * self.width]
        })
    }
}

/// A state as the networks take it.
#[derive(Debug, Clone, Copy)]
pub struct StateView<'a> {
    /// The true state.
    pub truth: &'a [f32],
    /// Five frames' features, oldest first; empty where the actor sees the true state.
    pub features: [&'a [u16]; ACTOR_FRAMES],
    /// Positional inputs.
    pub position: PositionalInputs,
    /// What the teacher would do.
    pub teacher: Option<[f32; 2]>,
}

/// A sampled transition over up to n decisions.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// Where it is in the tree, for its new priority.
    pub leaf: usize,
    /// The state.
    pub state: StateView<'a>,
    /// The action flown.
    pub action: [f32; 2],
    /// Discounted rewards.
    pub reward: f32,
    /// What the value of `next` counts: γⁿ, or 0 behind a terminal state.
    pub discount: f32,
    /// The state after them; the state itself behind a terminal one.
    pub next: StateView<'a>,
    /// Importance weight, at most 1.
    pub weight: f32,
    /// It is seen in a mirror.
    pub mirror: bool,
}

/// The memory of all environments.
pub struct ValueMemory {
    /// One for each environment.
    pub lanes: Vec<ValueLane>,
    priorities: Priorities,
    capacity: usize,
    returns: Returns,
    beta: f64,
    mirror: bool,
}

impl ValueMemory {
    /// An empty memory; `width` is the number of features of a frame, 0 where none are kept.
    pub fn new(config: &ValueConfig, width: usize) -> Self {
        let lanes = config.environments;
        let capacity = config.replay.decisions / lanes;
        Self {
            lanes: (0..lanes).map(|_| ValueLane::new(capacity, width)).collect(),
            priorities: Priorities::new(lanes * capacity, config.replay.alpha),
            capacity,
            returns: Returns {
                n_steps: config.learning.n_steps as u64,
                gamma: config.learning.gamma,
            },
            beta: config.replay.beta,
            // Features are not symmetric: only a true state can be seen in a mirror.
            mirror: config.learning.mirror && width == 0,
        }
    }

    /// Gives new decisions whose outcome is known their place in the tree and takes out those that are overwritten, or whose oldest
    /// frame is.
    pub fn settle(&mut self) {
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            let leaf = |number: u64| i * self.capacity + (number % lane.capacity) as usize;
            while lane.settled < lane.next {
                if !self.returns.is_known(lane.settled, lane.next, |n| lane.moment(n).next) {
                    break;
                }
                self.priorities
                    .settle(leaf(lane.settled), lane.moment(lane.settled).next);
                lane.settled += 1;
            }
            for number in lane.settled..lane.next {
                self.priorities.take_out(leaf(number));
            }
            // The oldest states have lost frames of their window.
            let oldest = lane.oldest();
            if oldest > 0 {
                for number in oldest..(oldest + FRAME_DECISIONS[0]).min(lane.settled) {
                    self.priorities.take_out(leaf(number));
                }
            }
        }
    }

    /// Transitions in proportion to their priorities, one from each of `count` equal parts of the sum; none while there are none.
    pub fn sample(&self, count: usize, rng: &mut impl Rng) -> Vec<Step<'_>> {
        let held: f64 = self.lanes.iter().map(|l| l.moments.len() as f64).sum();
        let mut batch = Vec::with_capacity(count);
        let mut weights = Vec::with_capacity(count);
        for k in 0..count {
            let u: f64 = rng.random_range(0.0..1.0);
            let Some(leaf) = self.priorities.find(k as f64 + u, count) else {
                return Vec::new();
            };
            let (priority, total) = self.priorities.get(leaf);
            weights.push((held * priority / total).max(f64::MIN_POSITIVE).powf(-self.beta));
            let mirror = self.mirror && rng.random_bool(0.5);
            batch.push(Step {
                mirror,
                ..self.step(leaf)
            });
        }
        for (step, weight) in batch.iter_mut().zip(normalised(&weights)) {
            step.weight = weight;
        }
        batch
    }

    fn step(&self, leaf: usize) -> Step<'_> {
        let lane = &self.lanes[leaf / self.capacity];
        let slot = (leaf % self.capacity) as u64;
        let number = newest_in_slot(slot, lane.next, lane.capacity);
        let outcome = self.returns.of(number, |at| {
            let moment = lane.moment(at);
            (moment.reward, moment.next)
        });
        Step {
            leaf,
            state: lane.view(number),
            action: lane.moment(number).action,
            reward: outcome.reward,
            discount: outcome.discount,
            next: lane.view(outcome.next),
            weight: 1.0,
            mirror: false,
        }
    }

    /// Sets the priority of a sampled transition from its temporal-difference error.
    pub fn set_error(&mut self, leaf: usize, error: f32) {
        self.priorities.set_error(leaf, error);
    }

    /// All priorities, the largest that was ever set, and of each lane how many decisions were kept and are settled.
    pub fn places(&self) -> (Vec<f64>, f64, Vec<(u64, u64)>) {
        let (priorities, largest) = self.priorities.all();
        let lanes = self.lanes.iter().map(|l| (l.next, l.settled)).collect();
        (priorities, largest, lanes)
    }

    /// Takes over what [`Self::places`] gave, the lanes' content being back. `false` if it does not fit.
    #[must_use]
    pub fn restore(&mut self, priorities: &[f64], largest: f64, lanes: &[(u64, u64)]) -> bool {
        if self.priorities.places() != priorities.len() || self.lanes.len() != lanes.len() {
            return false;
        }
        self.priorities.restore(priorities, largest);
        self.lanes.iter_mut().zip(lanes).all(|(lane, &(next, settled))| {
            (lane.next, lane.settled) = (next, settled);
            let held = next.min(lane.capacity) as usize;
            let features = lane.features.len() == held * lane.width;
            lane.moments.len() == held && lane.truths.len() == held * TRUE_STATE && features
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use vigil_types::GoalRelative;

    fn memory(capacity: usize) -> ValueMemory {
        let mut config = ValueConfig {
            environments: 1,
            ..ValueConfig::default()
        };
        config.replay.decisions = capacity;
        config.learning.gamma = 0.5;
        config.learning.n_steps = 3;
        ValueMemory::new(&config, 1)
    }

    fn push(memory: &mut ValueMemory, first: u64, reward: f32, next: Next) {
        let number = memory.lanes[0].next;
        let mut truth = [0.0; TRUE_STATE];
        truth[0] = number as f32;
        let moment = Moment {
            first,
            position: PositionalInputs::of_goal(GoalRelative::default()),
            teacher: None,
            action: [0.0; 2],
            reward,
            next,
        };
        memory.lanes[0].push(&truth, &[number as u16], moment);
        memory.settle();
    }

    #[test]
    fn returns_reach_three_decisions_ahead_but_not_past_an_end() {
        let mut m = memory(100);
        for (reward, next) in [
            (1.0, Next::Decision),
            (2.0, Next::Decision),
            (4.0, Next::Decision),
            (8.0, Next::Terminal),
            (16.0, Next::CutOff),
            (0.0, Next::Nothing),
        ] {
            push(&mut m, 0, reward, next);
        }
        let seen: Vec<(f32, f32, f32)> = (0..5)
            .map(|leaf| {
                let step = m.step(leaf);
                (step.reward, step.discount, step.next.truth[0])
            })
            .collect();
        assert_eq!(seen[0], (1.0 + 1.0 + 1.0, 0.125, 3.0));
        assert_eq!(seen[1], (2.0 + 2.0 + 2.0, 0.0, 1.0));
        assert_eq!(seen[3], (8.0, 0.0, 3.0));
        assert_eq!(seen[4], (16.0, 0.5, 5.0));
    }

    #[test]
    fn only_what_has_an_outcome_and_all_its_frames_is_sampled() {
        let mut m = memory(32);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        assert!(m.sample(4, &mut rng).is_empty());
        for n in 0..50 {
            push(&mut m, 0, 1.0, Next::Decision);
            if n < 3 {
                assert!(m.sample(4, &mut rng).is_empty(), "{n}");
            }
        }
        for _ in 0..200 {
            for step in m.sample(8, &mut rng) {
                let number = step.state.truth[0] as u64;
                assert!((18 + FRAME_DECISIONS[0]..47).contains(&number), "{number}");
                let frames: Vec<u64> = step.state.features.iter().map(|f| u64::from(f[0])).collect();
                assert_eq!(frames, FRAME_DECISIONS.map(|age| number - age));
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
