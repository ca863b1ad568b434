//! What the replay memories share, whatever they keep of a decision: which outcomes are known, returns over n decisions, and the
//! priorities by which transitions are sampled (Schaul et al. 2016).

use serde::{Deserialize, Serialize};
use vigil_nnet::train::SumTree;

/// Keeps every transition possible to sample.
const LEAST_PRIORITY: f64 = 1e-3;

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

/// Returns over several decisions.
#[derive(Debug, Clone, Copy)]
pub struct Returns {
    pub n_steps: u64,
    /// What a decision later counts.
    pub gamma: f32,
}

/// A return, and where it ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Return {
    /// Discounted rewards.
    pub reward: f32,
    /// What the value behind it counts: γⁿ, or 0 behind a terminal state.
    pub discount: f32,
    /// Number of the decision whose state follows; the first one's own behind a terminal state.
    pub next: u64,
}

impl Returns {
    /// Whether the return of decision `number` lies within what a lane has; `end` is the number after its newest.
    pub fn is_known(&self, number: u64, end: u64, next: impl Fn(u64) -> Next) -> bool {
        (number..end)
            .take(self.n_steps as usize)
            .find_map(|n| match next(n) {
                Next::Decision => None,
                Next::CutOff => Some(n + 1 < end),
                Next::Terminal | Next::Nothing => Some(true),
            })
            .unwrap_or(number.saturating_add(self.n_steps) < end)
    }

    /// The return of decision `number`, whose outcome is known; `decision` gives reward and what follows.
    pub fn of(&self, number: u64, decision: impl Fn(u64) -> (f32, Next)) -> Return {
        let (mut reward, mut discount, mut at) = (0.0, 1.0, number);
        let next = loop {
            let (of_decision, next) = decision(at);
            reward += discount * of_decision;
            discount *= self.gamma;
            at += 1;
            match next {
                Next::Terminal | Next::Nothing => {
                    discount = 0.0;
                    break number;
                }
                Next::CutOff => break at,
                Next::Decision if at - number == self.n_steps => break at,
                Next::Decision => {}
            }
        };
        Return { reward, discount, next }
    }
}

/// The number that lies in `slot` of a ring of `capacity` whose newest is `end - 1`.
pub fn newest_in_slot(slot: u64, end: u64, capacity: u64) -> u64 {
    let last = end - 1;
    last - (last + capacity - slot) % capacity
}

/// The priorities of all lanes' decisions, each in a place of its own.
pub struct Priorities {
    tree: SumTree,
    /// The exponent of an error.
    alpha: f64,
    largest: f64,
}

impl Priorities {
    /// Nothing can be sampled yet.
    pub fn new(places: usize, alpha: f64) -> Self {
        Self {
            tree: SumTree::new(places),
            alpha,
            largest: 1.0,
        }
    }

    /// A decision whose outcome became known: it is sampled as if its error were the largest, unless nothing was done in it.
    pub fn settle(&mut self, leaf: usize, next: Next) {
        let priority = match next {
            Next::Nothing => 0.0,
            _ => self.largest,
        };
        self.tree.set(leaf, priority);
    }

    /// A decision that is not to be sampled.
    pub fn take_out(&mut self, leaf: usize) {
        self.tree.set(leaf, 0.0);
    }

    /// The place at `part` of `of` equal parts of the sum; `None` while nothing can be sampled.
    pub fn find(&self, part: f64, of: usize) -> Option<usize> {
        self.tree.find(part / of as f64 * self.tree.total())
    }

    /// A place's priority, and the sum of all.
    pub fn get(&self, leaf: usize) -> (f64, f64) {
        (self.tree.get(leaf), self.tree.total())
    }

    /// Sets the priority of a sampled transition from its error.
    pub fn set_error(&mut self, leaf: usize, error: f32) {
        // An overwritten or ended place stays out.
        if self.tree.get(leaf) > 0.0 {
            let priority = (f64::from(error.abs()) + LEAST_PRIORITY).powf(self.alpha);
            self.largest = self.largest.max(priority);
            self.tree.set(leaf, priority);
        }
    }

    /// Places; there may be more than decisions fit.
    pub fn places(&self) -> usize {
        self.tree.slots()
    }

    /// All priorities and the largest that was ever set.
    pub fn all(&self) -> (Vec<f64>, f64) {
        ((0..self.tree.slots()).map(|i| self.tree.get(i)).collect(), self.largest)
    }

    /// Takes over what [`Self::all`] gave.
    pub fn restore(&mut self, priorities: &[f64], largest: f64) {
        self.largest = largest;
        for (i, p) in priorities.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            self.tree.set(i, *p);
        }
    }
}

/// Importance weights as shares of the largest.
pub fn normalised(weights: &[f64]) -> impl Iterator<Item = f32> {
    let largest = weights.iter().copied().fold(0.0, f64::max);
    weights.iter().map(move |weight| (weight / largest) as f32)
}
