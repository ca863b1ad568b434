//! Gated recurrent unit, PyTorch's convention.

use crate::activation::{Activation, rescale};
use crate::dense::{column_sums, transpose};
use crate::graph::layer::recurrent_backward;
use crate::graph::operation::Operation;
#[cfg(feature = "train")]
use crate::graph::operation::draw_for;
use crate::graph::run::{Backward, Forward, Pass};
use crate::graph::{Bounds, BoundsForward};
#[cfg(feature = "train")]
use crate::graph::{BoundsBackward, BoundsMut, Rounding, ends_to_split};
use crate::graph::{GraphBuilder, NodeId, Params, Purpose, description};
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

/// What a step remembers for the backward passes: seven rows of `hidden` values.
struct Gates<'a> {
    pre_r: &'a [f32],
    pre_z: &'a [f32],
    pre_n: &'a [f32],
    r: &'a [f32],
    z: &'a [f32],
    /// `U_n h + c_n`.
    recurrent_n: &'a [f32],
    n: &'a [f32],
}

impl<'a> Gates<'a> {
    fn of(gates: &'a [f32], hidden: usize) -> Result<Self, ShapeError> {
        let row = |i: usize| part("GRU gates", gates, i * hidden, hidden);
        Ok(Self {
            pre_r: row(0)?,
            pre_z: row(1)?,
            pre_n: row(2)?,
            r: row(3)?,
            z: row(4)?,
            recurrent_n: row(5)?,
            n: row(6)?,
        })
    }

    /// One hidden unit's values.
    fn unit(&self, i: usize) -> [f32; 7] {
        [
            self.pre_r,
            self.pre_z,
            self.pre_n,
            self.r,
            self.z,
            self.recurrent_n,
            self.n,
        ]
        .map(|row| row.get(i).copied().unwrap_or(f32::NAN))
    }
}

impl Gru {
    fn input(&self) -> usize {
        self.inputs * 3 * self.hidden
    }

    fn recurrent(&self) -> usize {
        self.hidden * 3 * self.hidden
    }

    /// Number of parameters.
    pub fn param_len(&self) -> usize {
        self.input() + self.recurrent() + 6 * self.hidden
    }

    /// Length of `projection`: what the input contributes to the gates.
    pub fn projection_len(&self) -> usize {
        3 * self.hidden
    }

    /// Length of `gates`: what a step remembers for the backward passes.
    pub fn gates_len(&self) -> usize {
        7 * self.hidden
    }

    /// Length of `d_gates`: gradients at the six gate sums, `[r z n]` on the input's side, then on the state's side.
    pub fn gate_gradient_len(&self) -> usize {
        6 * self.hidden
    }

    /// `projection = W x + b`, from `x` `[inputs]` to `projection` `[3][hidden]`: the part of a step that does not depend on the state, so it can be kept.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn project(&self, isa: Isa, params: &[f32], x: &[f32], projection: &mut [f32]) -> Result<(), ShapeError> {
        expect("GRU parameters", params, self.param_len())?;
        expect("GRU input", x, self.inputs)?;
        expect("GRU projection", projection, self.projection_len())?;
        let bias = part("GRU bias", params, self.input() + self.recurrent(), 3 * self.hidden)?;
        row_times_matrix(isa, x, params, 0, 3 * self.hidden, Start::Bias(bias), projection)
    }

    /// One step from a projection: from `h` `[hidden]` to `h_out` `[hidden]`, which must be different slices.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn step(
        &self,
        isa: Isa,
        params: &[f32],
        projection: &[f32],
        h: &[f32],
        gates: &mut [f32],
        h_out: &mut [f32],
    ) -> Result<(), ShapeError> {
        let width = self.hidden;
        expect("GRU parameters", params, self.param_len())?;
        expect("GRU projection", projection, self.projection_len())?;
        expect("GRU state", h, width)?;
        expect("GRU gates", gates, self.gates_len())?;
        expect("GRU next state", h_out, width)?;
        let sums = part_mut("GRU gates", gates, 0, 3 * width)?;
        sums.copy_from_slice(projection);
        let bias = part(
            "GRU bias",
            params,
            self.input() + self.recurrent() + 3 * width,
            3 * width,
        )?;
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

    /// Writes the parameters in the order that the backward passes read: both matrices transposed, biases unused.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn pack(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
        expect("GRU parameters", params, self.param_len())?;
        expect("packed GRU parameters", packed, self.param_len())?;
        pack_matrices([self.inputs, self.hidden], 3 * self.hidden, params, packed)
    }

    /// Multipliers of a step against a reference step; with the reference equal to the step itself, its gradient.
    ///
    /// `d_out` is with respect to `h_out`. Products of two varying values follow the midpoint rule (`a·b` gives `a` the
    /// mean of both `b`s and `b` the mean of both `a`s), curves the rescale rule, so that
    /// `Σ dx·(x − x_ref) + Σ dh·(h − h_ref) = Σ d_out·(h_out − h_out_ref)` exactly, but for rounding. Writes `d_gates`
    /// (for [`Self::weight_gradient`]), `dx` and `dh`.
    ///
    /// # Errors
    /// Slices that do not fit.
    #[expect(clippy::too_many_arguments, reason = "caller-owned buffers, each with its own role")]
    pub fn backward(
        &self,
        isa: Isa,
        packed: &[f32],
        (h, gates): (&[f32], &[f32]),
        (h_ref, gates_ref): (&[f32], &[f32]),
        d_out: &[f32],
        d_gates: &mut [f32],
        dx: &mut [f32],
        dh: &mut [f32],
    ) -> Result<(), ShapeError> {
        let width = self.hidden;
        expect("packed GRU parameters", packed, self.param_len())?;
        expect("GRU state", h, width)?;
        expect("GRU reference state", h_ref, width)?;
        expect("GRU output gradient", d_out, width)?;
        expect("GRU gate gradient", d_gates, self.gate_gradient_len())?;
        expect("GRU input gradient", dx, self.inputs)?;
        expect("GRU state gradient", dh, width)?;
        let now = Gates::of(gates, width)?;
        let reference = Gates::of(gates_ref, width)?;
        let mid = |a: f32, b: f32| 0.5 * (a + b);
        for (i, ((h, h_ref), (d, dh))) in h.iter().zip(h_ref).zip(d_out.iter().zip(dh.iter_mut())).enumerate() {
            let [pre_r, pre_z, pre_n, r, z, rec_n, n] = now.unit(i);
            let [pre_r0, pre_z0, pre_n0, r0, z0, rec_n0, n0] = reference.unit(i);
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
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn weight_gradient(
        &self,
        isa: Isa,
        x: &[f32],
        h: &[f32],
        d_gates: &[f32],
        d_params: &mut [f32],
    ) -> Result<(), ShapeError> {
        expect("GRU parameter gradient", d_params, self.param_len())?;
        expect("GRU input", x, self.inputs)?;
        expect("GRU state", h, self.hidden)?;
        expect("GRU gate gradient", d_gates, self.gate_gradient_len())?;
        let width = 3 * self.hidden;
        let input_side = part("GRU gate gradient", d_gates, 0, width)?;
        let state_side = part("GRU gate gradient", d_gates, width, width)?;
        outer_product(isa, x, input_side, d_params, 0)?;
        outer_product(isa, h, state_side, d_params, self.input())?;
        let biases = self.input() + self.recurrent();
        column_sums(isa, 1, 2 * width, d_gates, d_params, biases)
    }
}

/// Bounds of one hidden unit's values: ends of r, z, `U_n h + c_n`, n and of the state before.
struct UnitBounds {
    r: [f32; 2],
    z: [f32; 2],
    recurrent_n: [f32; 2],
    n: [f32; 2],
    h: [f32; 2],
}

impl UnitBounds {
    /// The end of r that makes `r · recurrent_n` least (`end` 0) or greatest (1), and which of the two it is.
    fn r_for(&self, end: usize) -> (f32, usize) {
        let [q_low, q_high] = self.recurrent_n;
        let [r_low, r_high] = self.r;
        let low = if end == 0 { q_low >= 0.0 } else { q_high < 0.0 };
        if low { (r_low, 0) } else { (r_high, 1) }
    }

    /// The end of z that makes `n + z (h − n)` least (`end` 0) or greatest (1), and which of the two it is: it rises with n and h, so
    /// both are at this end too.
    fn z_for(&self, end: usize) -> (f32, usize) {
        let ([n_low, n_high], [h_low, h_high], [z_low, z_high]) = (self.n, self.h, self.z);
        let low = if end == 0 { h_low >= n_low } else { h_high < n_high };
        if low { (z_low, 0) } else { (z_high, 1) }
    }
}

/// What a step's bounds keep: rows of `hidden` each.
mod kept {
    /// From the state: r, z, n.
    pub const FROM_STATE: usize = 0;
    /// From the input: r, z, n.
    pub const FROM_INPUT: usize = 3;
    /// r and z behind their curves.
    pub const GATES: usize = 6;
    /// n behind its curve.
    pub const N: usize = 8;
}

impl Gru {
    fn unit_bounds(&self, kept: Bounds<'_>, state: Bounds<'_>, i: usize) -> UnitBounds {
        let of = |bounds: &Bounds<'_>, at: usize| {
            [bounds.lower, bounds.upper].map(|end| end.get(at).copied().unwrap_or(f32::NAN))
        };
        let row = |row: usize| of(&kept, row * self.hidden + i);
        UnitBounds {
            r: row(kept::GATES),
            z: row(kept::GATES + 1),
            recurrent_n: row(kept::FROM_STATE + 2),
            n: row(kept::N),
            h: of(&state, i),
        }
    }

    /// Bounds of a step. `n + z (h − n)` is bounded as a whole, not term by term: it lies between n and h.
    fn step_bounds(&self, node: &mut BoundsForward<'_>) -> Result<(), ShapeError> {
        let width = self.hidden;
        let (isa, rounding) = (node.isa, node.rounding);
        let (params, magnitudes) = (node.params, node.magnitudes);
        let (x, state) = (node.source(0)?, node.source(1)?);
        let kept = &mut node.aux;

        let (centre, radius) = x.split(rounding, self.inputs, node.work)?;
        let sums = kept.part_mut("GRU bounds", kept::FROM_INPUT * width, 3 * width)?;
        self.project(isa, params, centre, sums.lower)?;
        self.project(isa, magnitudes, radius, sums.upper)?;
        let (centre, radius) = state.split(rounding, width, node.work)?;
        let sums = kept.part_mut("GRU bounds", kept::FROM_STATE * width, 3 * width)?;
        let bias = part(
            "GRU bias",
            params,
            self.input() + self.recurrent() + 3 * width,
            3 * width,
        )?;
        row_times_matrix(
            isa,
            centre,
            params,
            self.input(),
            3 * width,
            Start::Bias(bias),
            sums.lower,
        )?;
        row_times_matrix(
            isa,
            radius,
            magnitudes,
            self.input(),
            3 * width,
            Start::Zero,
            sums.upper,
        )?;
        kept.part_mut("GRU bounds", 0, kept::GATES * width)?.spread();

        for end in [&mut *kept.lower, &mut *kept.upper] {
            let (sums, gates) = end.split_at_mut_checked(kept::GATES * width).unwrap_or_default();
            let (from_state, from_input) = sums.split_at_checked(3 * width).unwrap_or_default();
            let both = from_state.iter().zip(from_input).take(2 * width);
            for (gate, (from_state, from_input)) in gates.iter_mut().zip(both) {
                *gate = from_state + from_input;
            }
        }
        let mut gates = kept.part_mut("GRU bounds", kept::GATES * width, 2 * width)?;
        gates.through(isa, rounding, Activation::Sigmoid);
        for i in 0..width {
            let unit = self.unit_bounds(kept.view(), state, i);
            for (end, kept) in [&mut *kept.lower, &mut *kept.upper].into_iter().enumerate() {
                let [q_low, q_high] = unit.recurrent_n;
                let product = unit.r_for(end).0 * if end == 0 { q_low } else { q_high };
                let from_input = kept.get((kept::FROM_INPUT + 2) * width + i).copied();
                if let Some(n) = kept.get_mut(kept::N * width + i) {
                    *n = from_input.unwrap_or(f32::NAN) + product;
                }
            }
        }
        kept.part_mut("GRU bounds", kept::N * width, width)?
            .through(isa, rounding, Activation::TANH);
        let ends = node.value.lower.iter_mut().zip(node.value.upper.iter_mut());
        for (i, (lower, upper)) in ends.enumerate() {
            let unit = self.unit_bounds(kept.view(), state, i);
            let ([n_low, n_high], [h_low, h_high]) = (unit.n, unit.h);
            *lower = n_low + unit.z_for(0).0 * (h_low - n_low);
            *upper = n_high + unit.z_for(1).0 * (h_high - n_high);
        }
        node.value.widen(rounding);
        Ok(())
    }

    #[cfg(feature = "train")]
    fn step_bounds_backward(&self, node: &mut BoundsBackward<'_>, d_out: Bounds<'_>) -> Result<(), ShapeError> {
        let width = self.hidden;
        let isa = node.isa;
        let (x, state, (_, kept)) = (node.source(0)?, node.source(1)?, node.kept()?);
        let scratch = core::mem::take(&mut node.scratch);
        let (d_gates, _) = scratch
            .split_at_mut_checked(2 * self.gate_gradient_len())
            .unwrap_or_default();
        // Rows as in `backward`, of the lower ends and then of the upper ones.
        let (d_low, d_high) = d_gates
            .split_at_mut_checked(self.gate_gradient_len())
            .unwrap_or_default();
        for i in 0..width {
            let (unit, mut d_unit) = (self.unit_bounds(kept, state, i), UnitGradient::default());
            for (end, d) in [d_out.lower, d_out.upper].into_iter().enumerate() {
                d_unit.add(&unit, end, d.get(i).copied().unwrap_or(f32::NAN));
            }
            for (end, rows) in [&mut *d_low, &mut *d_high].into_iter().enumerate() {
                for (slot, value) in rows.iter_mut().skip(i).step_by(width).zip(d_unit.rows(&unit, end)) {
                    *slot = value;
                }
            }
        }
        ends_to_split(d_low, d_high);
        let (d_centre, d_radius) = (&*d_low, &*d_high);
        // Centre and radius of the input, then of the state.
        let (x_split, rest) = node.spill.split_at_mut_checked(2 * self.inputs).unwrap_or_default();
        let (x_centre, x_radius) = x.split(Rounding::Ignored, 0, x_split)?;
        let (h_centre, h_radius) = state.split(Rounding::Ignored, 0, rest)?;
        let (x_of, h_of) = ([x_centre, x_radius], [h_centre, h_radius]);
        let to = [&mut *node.d_params.params, &mut *node.d_params.magnitudes];
        for (((x, h), d_gates), to) in x_of.into_iter().zip(h_of).zip([d_centre, d_radius]).zip(to) {
            self.weight_gradient(isa, x, h, d_gates, to)?;
        }
        node.write_split_source(0, |side, packed, dx, _| {
            let d = part("GRU gate gradient", side.of(d_centre, d_radius), 0, 3 * width)?;
            row_times_matrix(isa, d, packed, 0, self.inputs, Start::Zero, dx)
        })?;
        node.write_split_source(1, |side, packed, dh, _| {
            let d = part("GRU gate gradient", side.of(d_centre, d_radius), 3 * width, 3 * width)?;
            // Beside the gates the state is in the output itself: as ends, so as centre and radius before they become ends.
            for (i, dh) in dh.iter_mut().enumerate() {
                let unit = self.unit_bounds(kept, state, i);
                let at = |d: &[f32]| d.get(i).copied().unwrap_or(f32::NAN);
                let (low, high) = (at(d_out.lower) * unit.z_for(0).0, at(d_out.upper) * unit.z_for(1).0);
                *dh = side.of(low + high, high - low);
            }
            row_times_matrix(isa, d, packed, self.input(), width, Start::Output, dh)
        })
    }
}

/// Gradients at one unit's bounds: at the ends of r and z, of `U_n h + c_n`, and of n before its curve.
#[cfg(feature = "train")]
#[derive(Default)]
struct UnitGradient {
    r: [f32; 2],
    z: [f32; 2],
    recurrent_n: [f32; 2],
    before_n: [f32; 2],
}

#[cfg(feature = "train")]
impl UnitGradient {
    /// Adds what the gradient `d` of this end of the next state makes.
    fn add(&mut self, unit: &UnitBounds, end: usize, d: f32) {
        let at = |ends: [f32; 2]| if end == 0 { ends[0] } else { ends[1] };
        let (n, h, q) = (at(unit.n), at(unit.h), at(unit.recurrent_n));
        let (z, which) = unit.z_for(end);
        add_at(&mut self.z, which, d * (h - n));
        let before_n = d * (1.0 - z) * Activation::TANH.slope(n);
        add_at(&mut self.before_n, end, before_n);
        let (r, which) = unit.r_for(end);
        add_at(&mut self.recurrent_n, end, before_n * r);
        add_at(&mut self.r, which, before_n * q);
    }

    /// Gradients of this end at the six gate sums, as [`Gru::backward`] has them.
    fn rows(&self, unit: &UnitBounds, end: usize) -> [f32; 6] {
        let at = |ends: [f32; 2]| if end == 0 { ends[0] } else { ends[1] };
        let r = at(self.r) * Activation::Sigmoid.slope(at(unit.r));
        let z = at(self.z) * Activation::Sigmoid.slope(at(unit.z));
        [r, z, at(self.before_n), r, z, at(self.recurrent_n)]
    }
}

#[cfg(feature = "train")]
fn add_at(ends: &mut [f32; 2], which: usize, d: f32) {
    if let Some(end) = ends.get_mut(which) {
        *end += d;
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
        transpose(
            inputs,
            cols,
            part("recurrent weights", params, at, len)?,
            part_mut("packed recurrent weights", packed, at, len)?,
        );
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

impl Operation for Gru {
    fn aux_len(&self, _len: usize, _purpose: Purpose) -> usize {
        self.gates_len() + self.projection_len()
    }

    fn scratch_len(&self) -> usize {
        self.gate_gradient_len()
    }

    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        let (x, state) = (node.source(0)?, node.source(1)?);
        let (gates, projection) = node.aux.split_at_mut_checked(self.gates_len()).unwrap_or_default();
        self.project(node.isa, node.params, x, projection)?;
        self.step(node.isa, node.params, projection, state, gates, node.value)
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        let (isa, packed, len) = (node.isa, node.packed, self.gates_len());
        recurrent_backward(
            node,
            pass,
            self.gate_gradient_len(),
            |(h, kept, _), (h_ref, kept_ref, _), d_gates, dx, dh| {
                let step = (h, part("tape", kept, 0, len)?);
                let reference = (h_ref, part("tape", kept_ref, 0, len)?);
                self.backward(isa, packed, step, reference, d, d_gates, dx, dh)
            },
            |x, h, d_gates, d_params| self.weight_gradient(isa, x, h, d_gates, d_params),
        )
    }

    fn weight_len(&self) -> usize {
        self.input() + self.recurrent()
    }

    fn bounds_node(&self, node: &mut BoundsForward<'_>) -> Result<(), ShapeError> {
        self.step_bounds(node)
    }

    #[cfg(feature = "train")]
    fn bounds_backward_node(&self, node: &mut BoundsBackward<'_>, d: BoundsMut<'_>) -> Result<(), ShapeError> {
        self.step_bounds_backward(node, d.view())
    }

    fn pack_node(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
        self.pack(params, packed)
    }

    #[cfg(feature = "train")]
    fn initialize_node(&self, params: &mut [f32], draw: &mut dyn FnMut(f32) -> f32) {
        draw_for(self.hidden, params, draw);
    }
}
