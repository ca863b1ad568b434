//! Prioritised replay (Schaul et al. 2016) that keeps every depth frame once, in 8 bits of contrast.
//!
//! A frame is kept as `1 / (1 + range / 3 m)` in 255 steps, which is what the network's first layer makes of it: a step is
//! 1 cm of range near the vehicle, 8 cm at 5 m.

use crate::actor_training::priorities::{Priorities, Returns, newest_in_slot, normalised};
use rand::Rng;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use vigil_nnet::Activation;
use vigil_policy::actor::ACTOR_FRAMES;
use vigil_types::{DEPTH_COLS, DEPTH_PIXELS};

/// Steps of contrast in a kept frame.
const LEVELS: f32 = 255.0;
/// Frames a lane keeps beyond those of its decisions: a window and the steps of the decision being flown.
const SPARE_FRAMES: usize = 64;

/// Keeps a depth image.
pub fn pack_frame(depth: &[f32; DEPTH_PIXELS], packed: &mut [u8]) {
    let Activation::NearContrast { gain } = Activation::NEAR_CONTRAST else {
        unreachable!("the contrast layer is a contrast layer");
    };
    for (packed, depth) in packed.iter_mut().zip(depth) {
        *packed = (LEVELS / (1.0 + gain * depth) + 0.5) as u8;
    }
}

/// The contrast that the first convolution gets of a kept frame, as it was or in a mirror.
pub fn unpack_frame(packed: &[u8], mirror: bool, contrast: &mut [f32]) {
    const SCALE: f32 = 1.0 / LEVELS;
    if mirror {
        for (to, from) in contrast
            .chunks_exact_mut(DEPTH_COLS)
            .zip(packed.chunks_exact(DEPTH_COLS))
        {
            for (to, from) in to.iter_mut().zip(from.iter().rev()) {
                *to = f32::from(*from) * SCALE;
            }
        }
    } else {
        for (to, from) in contrast.iter_mut().zip(packed) {
            *to = f32::from(*from) * SCALE;
        }
    }
}

/// What follows a decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Next {
    /// The next record of the lane.
    Decision,
    /// Nothing: success, collision, out of bounds.
    Terminal,
    /// The next record of the lane is the state in which the flight was cut off.
    CutOff,
    /// This is that state; no action was taken in it.
    Nothing,
}

/// A state and what was done in it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Number of the state's newest frame in its lane.
    pub newest_frame: u64,
    /// Number of the flight's first frame in its lane.
    pub first_frame: u64,
    /// The positional inputs.
    pub position: [f32; 2],
    /// The action flown, the mean over the decision's steps, in action units.
    pub action: [f32; 2],
    /// What the geometric pilot decided, if it flew: the same mean, without the noise.
    pub teacher_action: Option<[f32; 2]>,
    /// Reward of the decision.
    pub reward: f32,
    /// What follows.
    pub next: Next,
}

/// A flight whose frames a lane keeps: what it takes to fly it again, bit for bit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Seed of course, vehicle and LiDAR.
    pub seed: u64,
    /// Number of its first frame.
    pub first_frame: u64,
    /// It was begun during the warm-up.
    pub warm_up: bool,
    /// The action flown in each step.
    pub actions: Vec<[f32; 2]>,
}

/// A lane without its frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LaneState {
    /// The flights that have frames in the lane, oldest first.
    pub episodes: VecDeque<Episode>,
    /// Frames ever kept.
    pub next_frame: u64,
    records: Vec<Record>,
    next_record: u64,
    settled: u64,
}

impl LaneState {
    /// Beyond it a number is damage, and sums would overflow.
    const MOST: u64 = 1 << 48;

    /// What does not belong together, whatever the capacity.
    pub fn check(&self) -> Result<(), &'static str> {
        if self.next_frame.max(self.next_record) > Self::MOST {
            return Err("it counts more frames than can have been flown");
        }
        if self.settled > self.next_record {
            return Err("it has settled decisions that were not made");
        }
        let frames_are_known =
            |record: &Record| record.first_frame <= record.newest_frame && record.newest_frame < self.next_frame;
        if !self.records.iter().all(frames_are_known) {
            return Err("a decision has frames that were not taken");
        }
        if !self
            .episodes
            .iter()
            .all(|episode| episode.first_frame < self.next_frame)
        {
            return Err("a flight has frames that were not taken");
        }
        Ok(())
    }
}

/// What one environment lived through, oldest overwritten first.
pub struct Lane {
    frames: Vec<u8>,
    frame_capacity: usize,
    capacity: usize,
    /// Records before `settled` have their place in the tree.
    state: LaneState,
}

impl Lane {
    fn new(capacity: usize, steps_per_decision: usize) -> Self {
        let frame_capacity = capacity * steps_per_decision + SPARE_FRAMES;
        Self {
            // Zeroed memory is not occupied until it is written.
            frames: vec![0; frame_capacity * DEPTH_PIXELS],
            frame_capacity,
            capacity,
            state: LaneState {
                episodes: VecDeque::new(),
                next_frame: 0,
                records: Vec::with_capacity(capacity),
                next_record: 0,
                settled: 0,
            },
        }
    }

    fn slot_of_frame(&self, number: u64) -> usize {
        (number % self.frame_capacity as u64) as usize * DEPTH_PIXELS
    }

    /// Begins a flight with its first frame; returns the frame's number.
    pub fn begin(&mut self, seed: u64, warm_up: bool, depth: &[f32; DEPTH_PIXELS]) -> u64 {
        let number = self.state.next_frame;
        self.state.episodes.push_back(Episode {
            seed,
            first_frame: number,
            warm_up,
            actions: Vec::new(),
        });
        self.state.next_frame += 1;
        self.write_frame(number, depth);
        // Flights all of whose frames are overwritten are no longer needed.
        let oldest = self.state.next_frame.saturating_sub(self.frame_capacity as u64);
        while self
            .state
            .episodes
            .get(1)
            .is_some_and(|second| second.first_frame <= oldest)
        {
            self.state.episodes.pop_front();
        }
        number
    }

    /// Keeps the action of a step.
    pub fn push_action(&mut self, action: [f32; 2]) {
        if let Some(episode) = self.state.episodes.back_mut() {
            episode.actions.push(action);
        }
    }

    /// Keeps the frame after a step; returns its number.
    pub fn push_frame(&mut self, depth: &[f32; DEPTH_PIXELS]) -> u64 {
        let number = self.state.next_frame;
        self.state.next_frame += 1;
        self.write_frame(number, depth);
        number
    }

    /// Keeps the frame of a number, unless it was overwritten since.
    pub fn write_frame(&mut self, number: u64, depth: &[f32; DEPTH_PIXELS]) {
        if number + self.frame_capacity as u64 >= self.state.next_frame {
            let at = self.slot_of_frame(number);
            pack_frame(depth, &mut self.frames[at..at + DEPTH_PIXELS]);
        }
    }

    /// Everything but the frames.
    pub fn state(&self) -> &LaneState {
        &self.state
    }

    /// Takes over a saved state; the frames have to be written again. `false` if it does not fit this lane: it has other
    /// records than its numbers say, or a priority for one whose return is not known.
    #[must_use]
    pub fn restore(&mut self, state: LaneState, priorities: &[f64], returns: Returns) -> bool {
        let capacity = self.capacity as u64;
        let fits = state.records.len() as u64 == state.next_record.min(capacity)
            && state.next_record - state.settled <= capacity
            && priorities.len() == self.capacity;
        if !fits {
            return false;
        }
        self.state = state;
        let oldest = self.state.next_record.saturating_sub(capacity);
        let slots = (oldest..self.state.next_record).map(|number| (number, (number % capacity) as usize));
        let mut known = vec![false; self.capacity];
        for (number, slot) in slots {
            known[slot] = number < self.state.settled
                && returns.is_known(number, self.state.next_record, |n| self.record(n).next);
        }
        let is_sound =
            |(priority, known): (&f64, bool)| *priority == 0.0 || (known && *priority > 0.0 && priority.is_finite());
        priorities.iter().zip(known).all(is_sound)
    }

    /// A kept frame.
    pub fn frame(&self, number: u64) -> &[u8] {
        let at = self.slot_of_frame(number);
        &self.frames[at..at + DEPTH_PIXELS]
    }

    /// The five frames of a state, oldest first; the flight's first frame stands for those before it.
    pub fn window(&self, newest: u64, first: u64) -> [&[u8]; ACTOR_FRAMES] {
        core::array::from_fn(|i| {
            let age = (ACTOR_FRAMES - 1 - i) as u64;
            self.frame(newest.saturating_sub(age).max(first))
        })
    }

    /// Keeps a record.
    pub fn push(&mut self, record: Record) {
        let slot = (self.state.next_record % self.capacity as u64) as usize;
        if slot < self.state.records.len() {
            self.state.records[slot] = record;
        } else {
            self.state.records.push(record);
        }
        self.state.next_record += 1;
    }

    fn record(&self, number: u64) -> &Record {
        &self.state.records[(number % self.capacity as u64) as usize]
    }
}

/// A state as the networks take it.
#[derive(Debug, Clone, Copy)]
pub struct State<'a> {
    /// Five kept frames, oldest first.
    pub frames: [&'a [u8]; ACTOR_FRAMES],
    /// Positional inputs.
    pub position: [f32; 2],
}

/// A sampled transition over up to n decisions.
#[derive(Debug, Clone, Copy)]
pub struct Transition<'a> {
    /// Where it is in the tree, for its new priority.
    pub leaf: usize,
    /// The state.
    pub state: State<'a>,
    /// The action flown.
    pub action: [f32; 2],
    /// What the geometric pilot decided, if it flew.
    pub teacher_action: Option<[f32; 2]>,
    /// Discounted rewards of the decisions.
    pub reward: f32,
    /// What the value of `next` counts: γⁿ, or 0 behind a terminal state.
    pub discount: f32,
    /// The state after them; the state itself behind a terminal one.
    pub next: State<'a>,
    /// Importance weight, at most 1.
    pub weight: f32,
}

/// The replay memory of all environments.
pub struct Memory {
    /// One for each environment.
    pub lanes: Vec<Lane>,
    priorities: Priorities,
    capacity: usize,
    returns: Returns,
    beta: f64,
}

impl Memory {
    /// An empty memory for `decisions` decisions.
    pub fn new(config: &crate::actor_training::TrainConfig) -> Self {
        let lanes = config.environments;
        let capacity = config.replay.decisions / lanes;
        Self {
            lanes: (0..lanes)
                .map(|_| Lane::new(capacity, config.steps_per_decision))
                .collect(),
            priorities: Priorities::new(lanes * capacity, config.replay.alpha),
            capacity,
            returns: Returns {
                n_steps: config.learning.n_steps as u64,
                gamma: config.learning.gamma,
            },
            beta: config.replay.beta,
        }
    }

    /// Gives new records whose outcome is known their place in the tree and takes overwritten ones out.
    pub fn settle(&mut self) {
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            let leaf = |number: u64| i * self.capacity + (number % lane.capacity as u64) as usize;
            while lane.state.settled < lane.state.next_record {
                let (settled, pushed) = (lane.state.settled, lane.state.next_record);
                if !self.returns.is_known(settled, pushed, |n| lane.record(n).next) {
                    break;
                }
                self.priorities.settle(leaf(settled), lane.record(settled).next);
                lane.state.settled += 1;
            }
            // Records about to be settled still lie over old ones: those are gone.
            for n in lane.state.settled..lane.state.next_record {
                self.priorities.take_out(leaf(n));
            }
        }
    }

    /// Transitions in proportion to their priorities, one from each of `count` equal parts of the sum.
    pub fn sample(&self, count: usize, rng: &mut impl Rng) -> Vec<Transition<'_>> {
        let held: f64 = self.lanes.iter().map(|l| l.state.records.len() as f64).sum();
        let mut batch: Vec<Transition<'_>> = Vec::with_capacity(count);
        let mut weights = Vec::with_capacity(count);
        for k in 0..count {
            let u: f64 = rand::RngExt::random_range(rng, 0.0..1.0);
            let Some(leaf) = self.priorities.find(k as f64 + u, count) else {
                // Nothing can be sampled yet.
                return Vec::new();
            };
            let (priority, total) = self.priorities.get(leaf);
            weights.push((held * (priority / total)).max(f64::MIN_POSITIVE).powf(-self.beta));
            batch.push(self.transition(leaf));
        }
        for (transition, weight) in batch.iter_mut().zip(normalised(&weights)) {
            transition.weight = weight;
        }
        batch
    }

    fn transition(&self, leaf: usize) -> Transition<'_> {
        let lane = &self.lanes[leaf / self.capacity];
        let slot = (leaf % self.capacity) as u64;
        let number = newest_in_slot(slot, lane.state.next_record, lane.capacity as u64);
        let record = lane.record(number);
        let state = |r: &Record| State {
            frames: lane.window(r.newest_frame, r.first_frame),
            position: r.position,
        };
        let outcome = self.returns.of(number, |at| {
            let r = lane.record(at);
            (r.reward, r.next)
        });
        Transition {
            leaf,
            state: state(record),
            action: record.action,
            teacher_action: record.teacher_action,
            reward: outcome.reward,
            discount: outcome.discount,
            next: state(lane.record(outcome.next)),
            weight: 1.0,
        }
    }

    /// Sets the priority of a sampled transition from its temporal-difference error.
    pub fn set_error(&mut self, leaf: usize, error: f32) {
        self.priorities.set_error(leaf, error);
    }

    /// All priorities and the largest that was ever set.
    pub fn priorities(&self) -> (Vec<f64>, f64) {
        self.priorities.all()
    }

    /// Takes over saved lanes and priorities; the frames have to be written again. `false` if they do not fit this memory or one
    /// another.
    #[must_use]
    pub fn restore(&mut self, lanes: Vec<LaneState>, priorities: &[f64], largest: f64) -> bool {
        // The tree may have more places than decisions fit.
        let (used, spare) = priorities
            .split_at_checked(self.lanes.len() * self.capacity)
            .unwrap_or_default();
        if self.priorities.places() != priorities.len()
            || lanes.len() != self.lanes.len()
            || spare.iter().any(|p| *p != 0.0)
        {
            return false;
        }
        let each = self.lanes.iter_mut().zip(lanes).zip(used.chunks(self.capacity.max(1)));
        for ((lane, state), priorities) in each {
            if !lane.restore(state, priorities, self.returns) {
                return false;
            }
        }
        self.priorities.restore(priorities, largest);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actor_training::TrainConfig;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    const GAMMA: f32 = 0.5;

    /// One lane of eight decisions of one step, three steps to a return.
    fn memory() -> Memory {
        let mut config = TrainConfig {
            environments: 1,
            steps_per_decision: 1,
            ..TrainConfig::default()
        };
        config.replay.decisions = 8;
        config.learning.gamma = GAMMA;
        config.learning.n_steps = 3;
        Memory::new(&config)
    }

    fn image(level: f32) -> Box<[f32; DEPTH_PIXELS]> {
        vec![level; DEPTH_PIXELS].into_boxed_slice().try_into().unwrap()
    }

    /// Lives through a flight of the given rewards; frame and first positional input of decision k are `first + k`.
    fn fly(memory: &mut Memory, first: u64, rewards: &[f32], end: Next) {
        let lane = &mut memory.lanes[0];
        let first_frame = lane.begin(first, false, &image(0.01 * first as f32));
        let mut newest_frame = first_frame;
        let record = |k: u64, newest_frame, reward, next| Record {
            newest_frame,
            first_frame,
            position: [(first + k) as f32, 0.0],
            action: [0.0; 2],
            teacher_action: None,
            reward,
            next,
        };
        for (k, reward) in rewards.iter().enumerate() {
            let last = k + 1 == rewards.len();
            lane.push(record(
                k as u64,
                newest_frame,
                *reward,
                if last { end } else { Next::Decision },
            ));
            if !last || end != Next::Terminal {
                newest_frame = lane.push_frame(&image(0.01 * (first + k as u64 + 1) as f32));
            }
        }
        if end == Next::CutOff {
            lane.push(record(rewards.len() as u64, newest_frame, 0.0, Next::Nothing));
        }
        memory.settle();
    }

    fn sampled(memory: &Memory) -> Vec<Transition<'_>> {
        let mut batch = memory.sample(200, &mut ChaCha8Rng::seed_from_u64(1));
        batch.sort_by(|a, b| a.state.position[0].total_cmp(&b.state.position[0]));
        batch.dedup_by_key(|t| t.leaf);
        batch
    }

    #[test]
    fn returns_end_at_the_flight_s_end_and_a_cut_off_flight_still_has_a_future() {
        let mut memory = memory();
        fly(&mut memory, 0, &[1.0, 2.0, 4.0], Next::Terminal);
        let batch = sampled(&memory);
        let returns: Vec<_> = batch.iter().map(|t| (t.reward, t.discount)).collect();
        assert_eq!(returns, [(3.0, 0.0), (4.0, 0.0), (4.0, 0.0)]);

        fly(&mut memory, 10, &[1.0, 2.0, 4.0, 8.0], Next::CutOff);
        let batch = sampled(&memory);
        let late: Vec<_> = batch[3..]
            .iter()
            .map(|t| (t.reward, t.discount, t.next.position[0]))
            .collect();
        // 1 + 2/2 + 4/4 and the state three decisions on; then ever fewer decisions up to the state of the cut.
        let expected = [
            (3.0, 0.125, 13.0),
            (6.0, 0.125, 14.0),
            (8.0, 0.25, 14.0),
            (8.0, 0.5, 14.0),
        ];
        assert_eq!(late, expected);
        assert!(batch.iter().all(|t| t.weight > 0.0 && t.weight <= 1.0));
    }

    #[test]
    fn a_decision_is_sampled_only_when_its_return_is_known() {
        let mut memory = memory();
        fly(&mut memory, 0, &[1.0, 1.0, 1.0, 1.0], Next::Decision);
        let known: Vec<f32> = sampled(&memory).iter().map(|t| t.state.position[0]).collect();
        assert_eq!(known, [0.0]);
    }

    #[test]
    fn old_decisions_make_room_and_windows_stay_within_their_flight() {
        let mut memory = memory();
        for flight in 0..5 {
            fly(&mut memory, 10 * flight, &[1.0, 1.0, 1.0], Next::Terminal);
        }
        let batch = sampled(&memory);
        let kept: Vec<f32> = batch.iter().map(|t| t.state.position[0]).collect();
        assert_eq!(kept, [21.0, 22.0, 30.0, 31.0, 32.0, 40.0, 41.0, 42.0]);
        for t in &batch {
            let level = |frame: &[u8]| frame[0];
            let mut expected = [0_u8; DEPTH_PIXELS];
            pack_frame(&image(0.01 * t.state.position[0]), &mut expected);
            assert_eq!(level(t.state.frames[4]), expected[0]);
            pack_frame(
                &image(0.01 * (t.state.position[0] / 10.0).floor() * 10.0),
                &mut expected,
            );
            assert_eq!(
                level(t.state.frames[0]),
                expected[0],
                "the first frame stands for earlier ones"
            );
        }
    }

    #[test]
    fn surprising_decisions_are_sampled_more_often_and_count_less_each() {
        let mut memory = memory();
        fly(&mut memory, 0, &[1.0, 1.0, 1.0], Next::Terminal);
        let leaves: Vec<usize> = sampled(&memory).iter().map(|t| t.leaf).collect();
        for (leaf, error) in leaves.iter().zip([0.1, -10.0, 0.1]) {
            memory.set_error(*leaf, error);
        }
        let batch = memory.sample(1000, &mut ChaCha8Rng::seed_from_u64(2));
        let of = |leaf| batch.iter().filter(move |t| t.leaf == leaf);
        // (10 / 0.1)^0.6 = 15.8 times as often, each at 15.8^-0.4 = 0.33 of the weight.
        let ratio = of(leaves[1]).count() as f32 / of(leaves[0]).count() as f32;
        assert!((ratio - 15.7).abs() < 1.5, "{ratio}");
        let weight = of(leaves[1]).next().unwrap().weight / of(leaves[0]).next().unwrap().weight;
        assert!((weight - 0.33).abs() < 0.02, "{weight}");
    }

    #[test]
    fn a_kept_frame_holds_near_range_to_centimetres_and_can_be_seen_in_a_mirror() {
        let mut depth = image(1.0);
        depth[0] = 0.005;
        depth[1] = 0.05;
        let mut packed = vec![0; DEPTH_PIXELS];
        pack_frame(&depth, &mut packed);
        let (mut plain, mut mirror) = (vec![0.0; DEPTH_PIXELS], vec![0.0; DEPTH_PIXELS]);
        unpack_frame(&packed, false, &mut plain);
        unpack_frame(&packed, true, &mut mirror);
        let range_m = |contrast: f32| 3.0 / contrast - 3.0;
        assert!((range_m(plain[0]) - 0.5).abs() < 0.02, "{}", range_m(plain[0]));
        assert!((range_m(plain[1]) - 5.0).abs() < 0.05, "{}", range_m(plain[1]));
        assert_eq!(mirror[DEPTH_COLS - 1], plain[0]);
        assert_eq!(mirror[DEPTH_COLS - 2], plain[1]);
        assert_eq!(mirror[DEPTH_COLS + 7], plain[DEPTH_COLS + 7]);
    }
}
