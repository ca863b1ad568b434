//! Priorities of prioritised experience replay (Schaul et al., "Prioritized Experience Replay", 2016, proportional variant):
//! slot `i` stands for the caller's transition `i`.

use alloc::vec;
use alloc::vec::Vec;

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
