//! What is reckoned with of the replay memory's decisions, whatever it keeps of them: which outcomes are known, and returns over n decisions.

use serde::{Deserialize, Serialize};

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

/// Importance weights as shares of the largest.
pub fn normalised(weights: &[f64]) -> impl Iterator<Item = f32> {
    let largest = weights.iter().copied().fold(0.0, f64::max);
    weights.iter().map(move |weight| (weight / largest) as f32)
}
