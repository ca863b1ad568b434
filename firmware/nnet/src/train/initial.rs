//! First weights.

use crate::error::{ShapeError, expect, part_mut};
use crate::graph::{Graph, Layer};
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
        for (layer, range) in self.layers() {
            if range.len == 0 || done.contains(&range) {
                continue;
            }
            done.push(range);
            let own = part_mut("network parameters", params, range.at, range.len)?;
            let fan = match layer {
                Layer::Conv2d(layer, _) => layer.kernel * layer.kernel * layer.channels,
                Layer::Dense(layer, _) => layer.inputs,
                Layer::Gru(layer) => layer.hidden,
                Layer::Lstm(layer) => layer.hidden,
                Layer::BatchNorm(layer) => {
                    for (row, value) in own.chunks_exact_mut(layer.channels).zip([1.0, 0.0, 0.0, 1.0]) {
                        row.fill(value);
                    }
                    continue;
                }
                _ => continue,
            };
            let limit = 1.0 / libm::sqrtf(fan as f32);
            for param in own {
                *param = rng.random_range(-limit..=limit);
            }
        }
        Ok(())
    }
}
