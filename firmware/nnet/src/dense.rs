//! Fully connected layer.

use crate::activation::Activation;
use crate::graph::layer::weighted_operation;
use crate::graph::{GraphBuilder, NodeId, Params};
use crate::isa::Isa;
use crate::kernels::{Product, Start};
use crate::shape::{ShapeError, expect, part, part_mut};

/// `y = x W + b`: weights `[inputs][outputs]` row-major (the transpose of PyTorch's), then the bias `[outputs]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dense {
    /// Length of `x`.
    pub inputs: usize,
    /// Length of `y`.
    pub outputs: usize,
}

impl Dense {
    /// One from so many values to so many.
    pub const fn new(inputs: usize, outputs: usize) -> Self {
        Self { inputs, outputs }
    }

    /// Number of weights.
    pub fn weight_len(&self) -> usize {
        self.inputs * self.outputs
    }

    /// Number of parameters: weights, then bias.
    pub fn param_len(&self) -> usize {
        self.weight_len() + self.outputs
    }

    fn split<'a>(&self, params: &'a [f32]) -> Result<(&'a [f32], &'a [f32]), ShapeError> {
        expect("dense parameters", params, self.param_len())?;
        Ok((
            part("dense weights", params, 0, self.weight_len())?,
            part("dense bias", params, self.weight_len(), self.outputs)?,
        ))
    }

    /// `y = f(x W + b)` from `x` `[rows][inputs]` to `y` `[rows][outputs]`, for `x.len() / inputs` rows at once. `pre` receives `x W + b` if given.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn forward(
        &self,
        isa: Isa,
        params: &[f32],
        activation: Activation,
        x: &[f32],
        pre: Option<&mut [f32]>,
        y: &mut [f32],
    ) -> Result<(), ShapeError> {
        let (weights, bias) = self.split(params)?;
        let rows = x.len() / self.inputs.max(1);
        expect("dense input", x, rows * self.inputs)?;
        expect("dense output", y, rows * self.outputs)?;
        self.multiply(rows).run(isa, x, weights, Start::Bias(bias), y)?;
        if let Some(pre) = pre {
            expect("dense pre-activation", pre, y.len())?;
            pre.copy_from_slice(y);
        }
        activation.apply_in_place(isa, y);
        Ok(())
    }

    fn multiply(&self, rows: usize) -> Product {
        Product {
            rows,
            cols: self.outputs,
            n_k: self.inputs,
            a_row: self.inputs as isize,
            a_k: 1,
            b_k: self.outputs as isize,
            out_row: self.outputs,
            ..Product::single()
        }
    }

    /// Writes the parameters in the order that [`Self::input_gradient`] reads: `W` transposed, bias unused.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn pack(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
        let (weights, _) = self.split(params)?;
        expect("packed dense parameters", packed, self.param_len())?;
        let packed = part_mut("packed dense weights", packed, 0, self.weight_len())?;
        transpose(self.inputs, self.outputs, weights, packed);
        Ok(())
    }

    /// `dx = dy Wᵀ`, a row for each row of `dy`. `dy` is with respect to `x W + b` (before the activation). The same
    /// for multipliers.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn input_gradient(&self, isa: Isa, packed: &[f32], dy: &[f32], dx: &mut [f32]) -> Result<(), ShapeError> {
        expect("packed dense parameters", packed, self.param_len())?;
        let rows = dy.len() / self.outputs.max(1);
        expect("dense output gradient", dy, rows * self.outputs)?;
        expect("dense input gradient", dx, rows * self.inputs)?;
        let transposed = Self::new(self.outputs, self.inputs);
        transposed.multiply(rows).run(isa, dy, packed, Start::Zero, dx)
    }

    /// Adds to `d_params` the gradient with respect to weights and bias, summed over the rows.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn weight_gradient(&self, isa: Isa, x: &[f32], dy: &[f32], d_params: &mut [f32]) -> Result<(), ShapeError> {
        expect("dense parameter gradient", d_params, self.param_len())?;
        let rows = dy.len() / self.outputs.max(1);
        expect("dense input", x, rows * self.inputs)?;
        expect("dense output gradient", dy, rows * self.outputs)?;
        let weights = Product {
            rows: self.inputs,
            n_k: rows,
            a_row: 1,
            a_k: self.inputs as isize,
            ..self.multiply(rows)
        };
        weights.run(isa, x, dy, Start::Output, d_params)?;
        column_sums(isa, rows, self.outputs, dy, d_params, self.weight_len())
    }
}

/// Adds the sums of the columns of `d` (`rows × cols`) to `out[at..]`: the gradient of a bias.
pub(crate) fn column_sums(
    isa: Isa,
    rows: usize,
    cols: usize,
    d: &[f32],
    out: &mut [f32],
    at: usize,
) -> Result<(), ShapeError> {
    let sums = Product {
        rows: 1,
        cols,
        n_k: rows,
        b_k: cols as isize,
        out_at: at,
        ..Product::single()
    };
    sums.run(isa, &[1.0], d, Start::Output, out)
}

/// Side of the blocks in which [`transpose`] goes, so that what it reads and writes stays in the cache.
const BLOCK: usize = 16;

/// `to[c][r] = from[r][c]`.
pub(crate) fn transpose(rows: usize, cols: usize, from: &[f32], to: &mut [f32]) {
    let height = BLOCK * cols;
    for (band, from) in from.chunks(height.max(1)).enumerate() {
        for left in (0..cols).step_by(BLOCK) {
            for (r, row) in from.chunks_exact(cols.max(1)).enumerate() {
                let row = row.get(left..).unwrap_or_default();
                let to = to.iter_mut().skip(left * rows + band * BLOCK + r).step_by(rows);
                for (to, x) in to.zip(row).take(BLOCK) {
                    *to = *x;
                }
            }
        }
    }
}

impl GraphBuilder {
    /// A fully connected layer with its activation, applied to each row: `[rows][inputs]` to `[rows][outputs]`.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn dense(
        &mut self,
        x: NodeId,
        layer: Dense,
        activation: Activation,
        params: Params,
    ) -> Result<NodeId, ShapeError> {
        let rows = self.len_of(x)? / layer.inputs.max(1);
        self.check("dense input", x, rows * layer.inputs)?;
        Self::check_params("dense parameters", params, layer.param_len())?;
        self.add((layer, activation), &[x], rows * layer.outputs, params)
    }
}

weighted_operation!(Dense, |layer| layer.inputs, |_| 0, |layer, isa, packed, d, dx, _| {
    layer.input_gradient(isa, packed, d, dx)
});
