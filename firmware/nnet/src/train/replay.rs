//! Prioritised experience replay (Schaul et al., "Prioritized Experience Replay", 2016, proportional variant).
//!
//! Only priorities live here: slot `i` stands for the caller's transition `i`.

use alloc::vec;
use alloc::vec::Vec;
use rand::{Rng, RngExt};

/// Priorities of a fixed number of slots, with sums over them in a binary tree: setting one and finding where a share of
/// the total falls both take logarithmic time.
#[derive(Debug, Clone, PartialEq)]
pub struct SumTree {
    /// Node `k` has children `2k` and `2k + 1`; leaves start at `leaves`. Node 0 is unused.
    sums: Vec<f64>,
    leaves: usize,
    slots: usize,
}

impl SumTree {
    /// All priorities zero.
    pub fn new(slots: usize) -> Self {
        let leaves = slots.max(1).next_power_of_two();
        Self {
            sums: vec![0.0; 2 * leaves],
            leaves,
            slots,
        }
    }

    /// Number of slots.
    pub fn slots(&self) -> usize {
        self.slots
    }

    /// Sum of all priorities.
    pub fn total(&self) -> f64 {
        self.sums.get(1).copied().unwrap_or(0.0)
    }

    /// Priority of a slot, 0 for none.
    pub fn get(&self, slot: usize) -> f64 {
        if slot < self.slots {
            self.sums.get(self.leaves + slot).copied().unwrap_or(0.0)
        } else {
            0.0
        }
    }

    /// Sets a slot's priority. A slot that does not exist, a negative priority or one that is not finite is ignored and
    /// answered with `false`.
    pub fn set(&mut self, slot: usize, priority: f64) -> bool {
        if slot >= self.slots || !priority.is_finite() || priority < 0.0 {
            return false;
        }
        let mut node = self.leaves + slot;
        if let Some(leaf) = self.sums.get_mut(node) {
            *leaf = priority;
        }
        // Sums are formed anew from the children, so rounding does not pile up.
        while node > 1 {
            node /= 2;
            let sum = self.sums.get(2 * node..2 * node + 2).map_or(0.0, |c| c.iter().sum());
            if let Some(slot) = self.sums.get_mut(node) {
                *slot = sum;
            }
        }
        true
    }

    /// The slot in which `share` falls when the priorities are laid end to end; never one of priority 0 while another
    /// has more. `None` if all are 0.
    pub fn find(&self, share: f64) -> Option<usize> {
        if self.total() <= 0.0 {
            return None;
        }
        let mut share = share.max(0.0);
        let mut node = 1;
        while node < self.leaves {
            let left = self.sums.get(2 * node).copied().unwrap_or(0.0);
            let right = self.sums.get(2 * node + 1).copied().unwrap_or(0.0);
            // A share at or past the end, by rounding, stays with the last slot that has priority.
            if share < left || right <= 0.0 {
                node *= 2;
            } else {
                share -= left;
                node = 2 * node + 1;
            }
        }
        Some(node - self.leaves)
    }
}

/// Settings of a [`PrioritizedReplay`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplayConfig {
    /// Exponent of priorities: 0 samples uniformly; the paper's ancestor uses 0.6.
    pub alpha: f64,
    /// Exponent of the importance weights: 1 corrects fully; the paper's ancestor uses 0.4.
    pub beta: f64,
    /// Added to each error, so that no transition starves.
    pub epsilon: f64,
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self {
            alpha: 0.6,
            beta: 0.4,
            epsilon: 1e-6,
        }
    }
}

/// A drawn transition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampled {
    /// Its slot.
    pub slot: usize,
    /// Importance weight, relative to the largest of the batch: in (0, 1].
    pub weight: f32,
}

/// Which transition to learn from next. Slots are filled in turn; when all are full the oldest is overwritten.
#[derive(Debug, Clone, PartialEq)]
pub struct PrioritizedReplay {
    config: ReplayConfig,
    tree: SumTree,
    next: usize,
    filled: usize,
    /// Largest priority so far: what a new transition gets, so that each is seen.
    largest: f64,
}

impl PrioritizedReplay {
    /// Empty.
    pub fn new(slots: usize, config: ReplayConfig) -> Self {
        Self {
            config,
            tree: SumTree::new(slots),
            next: 0,
            filled: 0,
            largest: 1.0,
        }
    }

    /// Transitions held.
    pub fn len(&self) -> usize {
        self.filled
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.filled == 0
    }

    /// Takes the next slot for a new transition, with the largest priority so far; the caller stores it there. `None`
    /// if there are no slots.
    pub fn push(&mut self) -> Option<usize> {
        let slot = self.next;
        if !self.tree.set(slot, self.largest) {
            return None;
        }
        self.next = (slot + 1) % self.tree.slots();
        self.filled = (self.filled + 1).min(self.tree.slots());
        Some(slot)
    }

    /// Sets the priority of a transition from its temporal-difference error; one that is not finite is ignored and
    /// answered with `false`.
    pub fn update(&mut self, slot: usize, error: f64) -> bool {
        let priority = libm::pow(error.abs() + self.config.epsilon, self.config.alpha);
        let known = slot < self.filled && self.tree.set(slot, priority);
        if known {
            self.largest = self.largest.max(priority);
        }
        known
    }

    /// Draws `batch.len()` transitions, one from each equal share of the total priority. Leaves the batch as it is and
    /// answers `false` if there is nothing to draw.
    pub fn sample(&self, rng: &mut impl Rng, batch: &mut [Sampled]) -> bool {
        if self.filled == 0 || batch.is_empty() {
            return false;
        }
        let share = self.tree.total() / batch.len() as f64;
        let mut most = 0.0f64;
        for (i, drawn) in batch.iter_mut().enumerate() {
            let at = (i as f64 + rng.random::<f64>()) * share;
            let Some(slot) = self.tree.find(at) else {
                return false;
            };
            let probability = self.tree.get(slot) / self.tree.total();
            let weight = libm::pow(self.filled as f64 * probability, -self.config.beta);
            most = most.max(weight);
            *drawn = Sampled {
                slot,
                weight: weight as f32,
            };
        }
        for drawn in batch {
            drawn.weight = (f64::from(drawn.weight) / most) as f32;
        }
        true
    }
}
