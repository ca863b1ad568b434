//! Batch normalisation.

use crate::graph::operation::Operation;
use crate::graph::run::{Backward, Forward, Pass};
use crate::graph::{GraphBuilder, NodeId, Params, description};
use crate::shape::{ShapeError, part};
use crate::vectorised;

/// Normalises each channel (the fastest-running index).
///
/// Parameters, in this order: scale γ, shift β, running mean, running variance, `channels` each. In flight the running
/// statistics are used, so the layer is affine and its multipliers are its gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatchNorm {
    /// Channels.
    pub channels: usize,
    /// Added to the variance.
    pub epsilon: f32,
}

/// The four rows of parameters: scale, shift, mean, variance.
type Parts<'a> = [&'a [f32]; 4];

impl BatchNorm {
    /// Number of parameters, running statistics included.
    pub fn param_len(&self) -> usize {
        4 * self.channels
    }

    fn split<'a>(&self, params: &'a [f32]) -> Result<Parts<'a>, ShapeError> {
        let row = |i: usize| part("batch norm parameters", params, i * self.channels, self.channels);
        Ok([row(0)?, row(1)?, row(2)?, row(3)?])
    }

    /// Adds to `d_params` the gradient with respect to γ and β; running statistics are not learned.
    fn add_weight_gradient(&self, [_, _, mean, variance]: Parts<'_>, x: &[f32], dy: &[f32], d_params: &mut [f32]) {
        let (d_scale, d_shift) = d_params.split_at_mut_checked(self.channels).unwrap_or_default();
        let width = self.channels.max(1);
        for (x, dy) in x.chunks_exact(width).zip(dy.chunks_exact(width)) {
            let statistics = mean.iter().zip(variance);
            let slots = d_scale.iter_mut().zip(d_shift.iter_mut());
            for ((x, dy), ((mean, variance), (d_scale, d_shift))) in x.iter().zip(dy).zip(statistics.zip(slots)) {
                *d_scale += dy * (x - mean) / libm::sqrtf(variance + self.epsilon);
                *d_shift += dy;
            }
        }
    }
}

vectorised! {
    /// `y = γ (x − mean) / √(variance + ε) + β` with the running statistics; `x` and `y` are `[rows][channels]`.
    fn affine<'a>(p: Parts<'a>, epsilon: f32, x: &'a [f32], y: &'a mut [f32]) {
        let [scale, shift, mean, variance] = p;
        let width = scale.len().max(1);
        for (x, y) in x.chunks_exact(width).zip(y.chunks_exact_mut(width)) {
            let curve = scale.iter().zip(shift).zip(mean.iter().zip(variance));
            for ((x, y), ((scale, shift), (mean, variance))) in x.iter().zip(y).zip(curve) {
                *y = scale * (x - mean) / libm::sqrtf(variance + epsilon) + shift;
            }
        }
    }
}

vectorised! {
    /// `dx = dy γ / √(variance + ε)`: the gradient of [`affine`], and its multipliers.
    fn slopes<'a>(p: Parts<'a>, epsilon: f32, dy: &'a [f32], dx: &'a mut [f32]) {
        let [scale, _, _, variance] = p;
        let width = scale.len().max(1);
        for (dy, dx) in dy.chunks_exact(width).zip(dx.chunks_exact_mut(width)) {
            for ((dy, dx), (scale, variance)) in dy.iter().zip(dx).zip(scale.iter().zip(variance)) {
                *dx = dy * scale / libm::sqrtf(variance + epsilon);
            }
        }
    }
}

impl GraphBuilder {
    /// Batch normalisation with running statistics of `[rows][channels]`.
    ///
    /// # Errors
    /// Lengths that do not fit; an epsilon that makes no numbers.
    pub fn batch_norm(&mut self, x: NodeId, layer: BatchNorm, params: Params) -> Result<NodeId, ShapeError> {
        let len = self.len_of(x)?;
        self.check("batch norm input", x, len / layer.channels.max(1) * layer.channels)?;
        if !(layer.epsilon >= 0.0 && layer.epsilon.is_finite()) {
            return description("batch norm", "epsilon is negative or not finite");
        }
        Self::check_params("batch norm parameters", params, layer.param_len())?;
        self.add(layer, &[x], len, params)
    }
}

impl Operation for BatchNorm {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        let x = node.source(0)?;
        affine(node.isa, self.split(node.params)?, self.epsilon, x, node.value);
        Ok(())
    }

    fn backward_node(&self, node: &mut Backward<'_>, dy: &mut [f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        let (isa, p, epsilon) = (node.isa, self.split(node.packed)?, self.epsilon);
        if let Some(d_params) = node.d_params(pass)? {
            self.add_weight_gradient(p, node.source(0, node.tape)?, dy, d_params);
        }
        node.write_source(0, |dx, _| {
            slopes(isa, p, epsilon, dy, dx);
            Ok(())
        })
    }

    /// The identity.
    #[cfg(feature = "train")]
    fn initialize_node(&self, params: &mut [f32], _draw: &mut dyn FnMut(f32) -> f32) {
        for (row, value) in params.chunks_exact_mut(self.channels).zip([1.0, 0.0, 0.0, 1.0]) {
            row.fill(value);
        }
    }
}
