//! First weights.

use crate::graph::Graph;
use crate::shape::{ShapeError, expect, part_mut};
use alloc::vec::Vec;
use rand::{Rng, RngExt};

impl Graph {
    /// Draws first weights as PyTorch does: convolutions and dense layers uniform within ±1/√(inputs of a unit),
    /// recurrent layers within ±1/√hidden, biases alike; batch norm starts as the identity.
    ///
    /// # Errors
    /// A slice of another length.
    pub fn initialize(&self, rng: &mut impl Rng, params: &mut [f32]) -> Result<(), ShapeError> {
        expect("network parameters", params, self.param_len())?;
        // Shared parameters are drawn once, by their first user.
        let mut done = Vec::new();
        for (operation, range) in self.operations() {
            if range.len == 0 || done.contains(&range) {
                continue;
            }
            done.push(range);
            let own = part_mut("network parameters", params, range.at, range.len)?;
            operation.initialize_node(own, &mut |limit| rng.random_range(-limit..=limit));
        }
        Ok(())
    }
}
