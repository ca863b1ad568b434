//! Long short-term memory.

use crate::activation::{Activation, rescale};
use crate::dense::column_sums;
use crate::graph::layer::recurrent_operation;
use crate::graph::{GraphBuilder, NodeId, Params, description};
use crate::gru::{outer_product, row_times_matrix};
use crate::isa::Isa;
use crate::kernels::Start;
use crate::shape::{ShapeError, part};

/// One step of an LSTM (PyTorch's `nn.LSTM` with its two biases added up, gates in the order i, f, g, o):
///
/// `i, f, o = σ(W x + U h + b)`, `g = a(W_g x + U_g h + b_g)`, `c' = f·c + i·g`, `h' = o·a(c')`
///
/// with `a` the cell's activation: [`Activation::TANH`] usually, [`Activation::Relu`] in the paper's LSTM-AD.
///
/// Parameters, in this order: input weights `[inputs][4 hidden]`, recurrent weights `[hidden][4 hidden]`, bias
/// `[4 hidden]`. The state is one slice: `h`, then `c`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lstm {
    /// Length of `x`.
    pub inputs: usize,
    /// Length of `h` and of `c`.
    pub hidden: usize,
    /// The curve of the candidate and of the cell.
    pub cell: Activation,
}

impl Lstm {
    /// Number of parameters.
    pub fn param_len(&self) -> usize {
        self.input() + self.recurrent() + 4 * self.hidden
    }

    /// Length of a state: `h`, then `c`.
    pub fn state_len(&self) -> usize {
        2 * self.hidden
    }

    /// Length of `gates`: four sums, four gates, `a(c')`.
    fn gates_len(&self) -> usize {
        9 * self.hidden
    }

    /// Length of `d_gates`: gradients at the four sums.
    fn gate_gradient_len(&self) -> usize {
        4 * self.hidden
    }

    /// One step from `x` `[inputs]` and `state` `[2][hidden]` (`h`, then `c`) to `state_out` `[2][hidden]`, which must be another slice.
    fn step(
        &self,
        isa: Isa,
        params: &[f32],
        x: &[f32],
        state: &[f32],
        gates: &mut [f32],
        state_out: &mut [f32],
    ) -> Result<(), ShapeError> {
        let width = self.hidden;
        let bias = part("LSTM bias", params, self.input() + self.recurrent(), 4 * width)?;
        let (sums, rest) = gates.split_at_mut_checked(4 * width).unwrap_or_default();
        let (h, c) = state.split_at_checked(width).unwrap_or_default();
        row_times_matrix(isa, x, params, 0, 4 * width, Start::Bias(bias), sums)?;
        row_times_matrix(isa, h, params, self.input(), 4 * width, Start::Output, sums)?;
        let (gates, cell) = rest.split_at_mut_checked(4 * width).unwrap_or_default();
        gates.copy_from_slice(sums);
        let curves = [Activation::Sigmoid, Activation::Sigmoid, self.cell, Activation::Sigmoid];
        for (gate, curve) in gates.chunks_exact_mut(width.max(1)).zip(curves) {
            curve.apply_in_place(isa, gate);
        }
        let gate = |k: usize| part("LSTM gates", gates, k * width, width);
        let (i, f, g, o) = (gate(0)?, gate(1)?, gate(2)?, gate(3)?);
        let (h_out, c_out) = state_out.split_at_mut_checked(width).unwrap_or_default();
        for ((c_out, c), (f, (i, g))) in c_out.iter_mut().zip(c).zip(f.iter().zip(i.iter().zip(g))) {
            *c_out = f * c + i * g;
        }
        self.cell.apply(isa, c_out, cell)?;
        for (h_out, (o, cell)) in h_out.iter_mut().zip(o.iter().zip(&*cell)) {
            *h_out = o * cell;
        }
        Ok(())
    }

    /// Multipliers of a step against a reference step; with the reference equal to the step itself, its gradient. As
    /// [`crate::Gru::backward`]: midpoint rule for products, rescale rule for curves.
    ///
    /// A step is `(state, gates, state_out)`; `d_out` is with respect to `state_out`.
    #[expect(clippy::too_many_arguments, reason = "caller-owned buffers, each with its own role")]
    fn backward(
        &self,
        isa: Isa,
        packed: &[f32],
        step: (&[f32], &[f32], &[f32]),
        reference: (&[f32], &[f32], &[f32]),
        d_out: &[f32],
        d_gates: &mut [f32],
        dx: &mut [f32],
        d_state: &mut [f32],
    ) -> Result<(), ShapeError> {
        let width = self.hidden;
        let mid = |a: f32, b: f32| 0.5 * (a + b);
        let at = |slice: &[f32], row: usize, unit: usize| slice.get(row * width + unit).copied().unwrap_or(f32::NAN);
        let (dh, dc) = d_state.split_at_mut_checked(width).unwrap_or_default();
        for (unit, dc) in dc.iter_mut().enumerate() {
            let gate = |k: usize| (at(step.1, 4 + k, unit), at(reference.1, 4 + k, unit));
            let through = |k: usize, curve: Activation, d: f32| {
                let (y, y_ref) = gate(k);
                d * rescale(at(step.1, k, unit), y, at(reference.1, k, unit), y_ref, curve.slope(y))
            };
            let ((i, i0), (f, f0), (g, g0), (o, o0)) = (gate(0), gate(1), gate(2), gate(3));
            let (cell, cell0) = (at(step.1, 8, unit), at(reference.1, 8, unit));
            let (c, c0) = (at(step.0, 1, unit), at(reference.0, 1, unit));
            let (c_out, c_out0) = (at(step.2, 1, unit), at(reference.2, 1, unit));
            let d_h_out = at(d_out, 0, unit);
            // h' = o·a(c')
            let d_o = d_h_out * mid(cell, cell0);
            let d_cell = d_h_out * mid(o, o0);
            let d_c_out = at(d_out, 1, unit) + d_cell * rescale(c_out, cell, c_out0, cell0, self.cell.slope(cell));
            // c' = f·c + i·g
            *dc = d_c_out * mid(f, f0);
            let rows = [
                through(0, Activation::Sigmoid, d_c_out * mid(g, g0)),
                through(1, Activation::Sigmoid, d_c_out * mid(c, c0)),
                through(2, self.cell, d_c_out * mid(i, i0)),
                through(3, Activation::Sigmoid, d_o),
            ];
            for (slot, value) in d_gates.iter_mut().skip(unit).step_by(width).zip(rows) {
                *slot = value;
            }
        }
        row_times_matrix(isa, d_gates, packed, 0, self.inputs, Start::Zero, dx)?;
        row_times_matrix(isa, d_gates, packed, self.input(), width, Start::Zero, dh)
    }

    /// Adds to `d_params` the gradient of one step with respect to the parameters.
    fn weight_gradient(
        &self,
        isa: Isa,
        x: &[f32],
        state: &[f32],
        d_gates: &[f32],
        d_params: &mut [f32],
    ) -> Result<(), ShapeError> {
        outer_product(isa, x, d_gates, d_params, 0)?;
        let h = part("LSTM state", state, 0, self.hidden)?;
        outer_product(isa, h, d_gates, d_params, self.input())?;
        let bias = self.input() + self.recurrent();
        column_sums(isa, 1, 4 * self.hidden, d_gates, d_params, bias)
    }
}

impl GraphBuilder {
    /// One step of an LSTM from `x` `[inputs]` and `state` `[2][hidden]` (`h`, then `c`); the node's value is the next state.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn lstm(&mut self, x: NodeId, state: NodeId, layer: Lstm, params: Params) -> Result<NodeId, ShapeError> {
        self.check("LSTM input", x, layer.inputs)?;
        self.check("LSTM state", state, layer.state_len())?;
        Self::check_params("LSTM parameters", params, layer.param_len())?;
        if x == state {
            return description("LSTM", "input and state are the same node");
        }
        self.add(layer, &[x, state], layer.state_len(), params)
    }
}

recurrent_operation!(Lstm, 4);
