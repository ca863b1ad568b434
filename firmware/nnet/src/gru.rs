//! Gated recurrent unit, PyTorch's convention.

use crate::activation::{Activation, rescale};
use crate::dense::{column_sums, transpose};
use crate::graph::layer::recurrent_operation;
use crate::graph::{GraphBuilder, NodeId, Params, description};
use crate::isa::Isa;
use crate::kernels::{Product, Start};
use crate::shape::{ShapeError, expect, part, part_mut};

/// One step of a GRU (PyTorch's `nn.GRU`):
///
/// `r = σ(W_r x + b_r + U_r h + c_r)`, `z = σ(W_z x + b_z + U_z h + c_z)`, `n = tanh(W_n x + b_n + r·(U_n h + c_n))`,
/// `h' = n + z·(h − n)`.
///
/// Parameters, in this order: input weights `[inputs][3 hidden]`, recurrent weights `[hidden][3 hidden]`, input bias
/// `[3 hidden]`, recurrent bias `[3 hidden]`; columns are r, z, n. PyTorch's matrices are the transposes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gru {
    /// Length of `x`.
    pub inputs: usize,
    /// Length of `h`.
    pub hidden: usize,
}

impl Gru {
    /// Number of parameters.
    pub fn param_len(&self) -> usize {
        self.input() + self.recurrent() + 6 * self.hidden
    }

    /// Length of `gates`: what a step remembers for the backward passes.
    pub fn gates_len(&self) -> usize {
        7 * self.hidden
    }

    /// Length of `d_gates`: gradients at the six gate sums, `[r z n]` on the input's side, then on the state's side.
    fn gate_gradient_len(&self) -> usize {
        6 * self.hidden
    }

    /// One step with the input `x` `[inputs]`: from `h` `[hidden]` to `h_out` `[hidden]`, which must be different slices.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn step(
        &self,
        isa: Isa,
        params: &[f32],
        x: &[f32],
        h: &[f32],
        gates: &mut [f32],
        h_out: &mut [f32],
    ) -> Result<(), ShapeError> {
        let width = self.hidden;
        expect("GRU parameters", params, self.param_len())?;
        expect("GRU input", x, self.inputs)?;
        expect("GRU state", h, width)?;
        expect("GRU gates", gates, self.gates_len())?;
        expect("GRU next state", h_out, width)?;
        let biases = self.input() + self.recurrent();
        let bias = part("GRU bias", params, biases, 3 * width)?;
        let sums = part_mut("GRU gates", gates, 0, 3 * width)?;
        row_times_matrix(isa, x, params, 0, 3 * width, Start::Bias(bias), sums)?;
        let bias = part("GRU bias", params, biases + 3 * width, 3 * width)?;
        let from_state = part_mut("GRU gates", gates, 3 * width, 3 * width)?;
        row_times_matrix(isa, h, params, self.input(), 3 * width, Start::Bias(bias), from_state)?;
        // [pre_r pre_z pre_n | from the state: r z n | n]: finish r and z, which take the place of the state's share.
        let (sums, rest) = gates.split_at_mut_checked(3 * width).unwrap_or_default();
        for (sum, from_state) in sums.iter_mut().zip(rest.iter_mut()).take(2 * width) {
            *sum += *from_state;
            *from_state = *sum;
        }
        let (r_z, rest) = rest.split_at_mut_checked(2 * width).unwrap_or_default();
        Activation::Sigmoid.apply_in_place(isa, r_z);
        let (recurrent_n, n) = rest.split_at_mut_checked(width).unwrap_or_default();
        let (r, z) = r_z.split_at_checked(width).unwrap_or_default();
        let pre_n = part_mut("GRU gates", sums, 2 * width, width)?;
        for ((pre_n, n), (r, recurrent_n)) in pre_n.iter_mut().zip(n.iter_mut()).zip(r.iter().zip(&*recurrent_n)) {
            *pre_n += r * recurrent_n;
            *n = *pre_n;
        }
        Activation::TANH.apply_in_place(isa, n);
        for ((h_out, h), (n, z)) in h_out.iter_mut().zip(h).zip(n.iter().zip(z)) {
            *h_out = n + z * (h - n);
        }
        Ok(())
    }

    /// Multipliers of a step against a reference step; with the reference equal to the step itself, its gradient.
    ///
    /// A step is `(h, gates, h_out)`, whose `h_out` is not read; `d_out` is with respect to it. Products of two varying values
    /// follow the midpoint rule (`a·b` gives `a` the mean of both `b`s and `b` the mean of both `a`s), curves the rescale rule, so that
    /// `Σ dx·(x − x_ref) + Σ dh·(h − h_ref) = Σ d_out·(h_out − h_out_ref)` exactly, but for rounding. Writes `d_gates`
    /// (for [`Self::weight_gradient`]), `dx` and `dh`.
    #[expect(clippy::too_many_arguments, reason = "caller-owned buffers, each with its own role")]
    fn backward(
        &self,
        isa: Isa,
        packed: &[f32],
        (h, gates, _): (&[f32], &[f32], &[f32]),
        (h_ref, gates_ref, _): (&[f32], &[f32], &[f32]),
        d_out: &[f32],
        d_gates: &mut [f32],
        dx: &mut [f32],
        dh: &mut [f32],
    ) -> Result<(), ShapeError> {
        let width = self.hidden;
        // One hidden unit's values of the seven rows that a step remembers; `rec_n` is `U_n h + c_n`.
        let unit = |gates: &[f32], i: usize| -> [f32; 7] {
            core::array::from_fn(|row| gates.get(row * width + i).copied().unwrap_or(f32::NAN))
        };
        let mid = |a: f32, b: f32| 0.5 * (a + b);
        for (i, ((h, h_ref), (d, dh))) in h.iter().zip(h_ref).zip(d_out.iter().zip(dh.iter_mut())).enumerate() {
            let [pre_r, pre_z, pre_n, r, z, rec_n, n] = unit(gates, i);
            let [pre_r0, pre_z0, pre_n0, r0, z0, rec_n0, n0] = unit(gates_ref, i);
            // h' = n + z·(h − n)
            let d_z = d * mid(h - n, h_ref - n0);
            let d_h = d * mid(z, z0);
            let d_n = d - d_h;
            let d_pre_n = d_n * rescale(pre_n, n, pre_n0, n0, Activation::TANH.slope(n));
            // pre_n = a + r·rec_n
            let d_r = d_pre_n * mid(rec_n, rec_n0);
            let d_rec_n = d_pre_n * mid(r, r0);
            let d_pre_r = d_r * rescale(pre_r, r, pre_r0, r0, Activation::Sigmoid.slope(r));
            let d_pre_z = d_z * rescale(pre_z, z, pre_z0, z0, Activation::Sigmoid.slope(z));
            *dh = d_h;
            let rows = [d_pre_r, d_pre_z, d_pre_n, d_pre_r, d_pre_z, d_rec_n];
            for (slot, value) in d_gates.iter_mut().skip(i).step_by(width).zip(rows) {
                *slot = value;
            }
        }
        let input_side = part("GRU gate gradient", d_gates, 0, 3 * width)?;
        row_times_matrix(isa, input_side, packed, 0, self.inputs, Start::Zero, dx)?;
        let state_side = part("GRU gate gradient", d_gates, 3 * width, 3 * width)?;
        row_times_matrix(isa, state_side, packed, self.input(), width, Start::Output, dh)
    }

    /// Adds to `d_params` the gradient of one step with respect to the parameters.
    fn weight_gradient(
        &self,
        isa: Isa,
        x: &[f32],
        h: &[f32],
        d_gates: &[f32],
        d_params: &mut [f32],
    ) -> Result<(), ShapeError> {
        let width = 3 * self.hidden;
        let input_side = part("GRU gate gradient", d_gates, 0, width)?;
        let state_side = part("GRU gate gradient", d_gates, width, width)?;
        outer_product(isa, x, input_side, d_params, 0)?;
        outer_product(isa, h, state_side, d_params, self.input())?;
        let biases = self.input() + self.recurrent();
        column_sums(isa, 1, 2 * width, d_gates, d_params, biases)
    }
}

/// `out = start + x M` with `M` (`x.len() × cols`) at `at` in `matrices`.
pub(crate) fn row_times_matrix(
    isa: Isa,
    x: &[f32],
    matrices: &[f32],
    at: usize,
    cols: usize,
    start: Start<'_>,
    out: &mut [f32],
) -> Result<(), ShapeError> {
    let product = Product {
        rows: 1,
        cols,
        n_k: x.len(),
        a_k: 1,
        b_at: at as isize,
        b_k: cols as isize,
        ..Product::single()
    };
    product.run(isa, x, matrices, start, out)
}

/// Adds `xᵀ d` to the matrix at `at` in `out`.
pub(crate) fn outer_product(isa: Isa, x: &[f32], d: &[f32], out: &mut [f32], at: usize) -> Result<(), ShapeError> {
    let product = Product {
        rows: x.len(),
        cols: d.len(),
        n_k: 1,
        a_row: 1,
        out_at: at,
        out_row: d.len(),
        ..Product::single()
    };
    product.run(isa, x, d, Start::Output, out)
}

/// Transposes two matrices that follow each other, `rows[i] × cols` each.
pub(crate) fn pack_matrices(
    rows: [usize; 2],
    cols: usize,
    params: &[f32],
    packed: &mut [f32],
) -> Result<(), ShapeError> {
    let mut at = 0;
    for inputs in rows {
        let len = inputs * cols;
        let to = part_mut("packed recurrent weights", packed, at, len)?;
        transpose(inputs, cols, part("recurrent weights", params, at, len)?, to);
        at += len;
    }
    Ok(())
}

impl GraphBuilder {
    /// One step of a GRU from `x` `[inputs]` and state `h` `[hidden]`; the node's value is the next state `[hidden]`.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn gru(&mut self, x: NodeId, h: NodeId, layer: Gru, params: Params) -> Result<NodeId, ShapeError> {
        self.check("GRU input", x, layer.inputs)?;
        self.check("GRU state", h, layer.hidden)?;
        Self::check_params("GRU parameters", params, layer.param_len())?;
        if x == h {
            return description("GRU", "input and state are the same node");
        }
        self.add(layer, &[x, h], layer.hidden, params)
    }
}

recurrent_operation!(Gru, 3);
