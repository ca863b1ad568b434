//! Two-dimensional convolution, direct, rows × columns × channels.

use crate::activation::Activation;
use crate::dense::{column_sums, transpose};
use crate::error::{ShapeError, expect, part, part_mut};
use crate::isa::Isa;
use crate::kernels::{self, Product, Start, Task};

/// A convolution of one image with zero padding.
///
/// Images are `[row][column][channel]`; weights are `[kernel row][kernel column][input channel][output channel]`, then
/// the bias `[output channel]`. Cross-correlation, as in every framework.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Conv2d {
    /// Input rows.
    pub rows: usize,
    /// Input columns.
    pub cols: usize,
    /// Input channels.
    pub channels: usize,
    /// Output channels.
    pub filters: usize,
    /// Side of the square kernel.
    pub kernel: usize,
    /// Step between output pixels, in both directions.
    pub stride: usize,
    /// Rows and columns of zeros around the input.
    pub padding: usize,
}

/// Which outputs along one axis see the input through a given part of the kernel.
#[derive(Clone, Copy)]
struct Axis {
    size: usize,
    out: usize,
    kernel: usize,
    stride: usize,
    padding: usize,
}

impl Axis {
    /// Kernel taps of output `o` that fall on the input, `from..to`.
    fn taps(self, o: usize) -> (usize, usize) {
        let start = o * self.stride;
        let from = self.padding.saturating_sub(start).min(self.kernel);
        let to = (self.size + self.padding).saturating_sub(start).min(self.kernel);
        (from, to.max(from))
    }

    /// Outputs all of whose taps fall on the input, `from..to`.
    fn interior(self) -> (usize, usize) {
        let from = self.padding.div_ceil(self.stride).min(self.out);
        let reach = (self.size + self.padding + self.stride).saturating_sub(self.kernel) / self.stride;
        (from, reach.clamp(from, self.out))
    }

    /// Outputs whose tap `t` falls on the input, `from..to`.
    fn outputs_of_tap(self, t: usize) -> (usize, usize) {
        let from = self.padding.saturating_sub(t).div_ceil(self.stride).min(self.out);
        let to = (self.size + self.padding).saturating_sub(t).div_ceil(self.stride);
        (from, to.clamp(from, self.out))
    }

    /// First input coordinate of output `o` through tap `t`; the pair must be one of the above.
    fn input(self, o: usize, t: usize) -> usize {
        o * self.stride + t - self.padding
    }
}

/// One set of taps of the transposed convolution: `first + n · stride`, of which `count` reach an output.
#[derive(Clone, Copy)]
struct Phase {
    first: usize,
    count: usize,
    /// Output that tap `first` leads to; each further tap leads to the one before.
    output: usize,
}

impl Axis {
    /// The taps through which input `i` is seen by existing outputs.
    fn phase(self, i: usize) -> Phase {
        let at = i + self.padding;
        let mut first = at % self.stride;
        // Tap t leads to output (at − t) / stride; skip those past the last output.
        let top = at / self.stride;
        let skip = (top + 1).saturating_sub(self.out);
        first += skip * self.stride;
        let output = top - skip.min(top);
        let by_kernel = self.kernel.saturating_sub(first).div_ceil(self.stride);
        let count = if skip > top { 0 } else { by_kernel.min(output + 1) };
        Phase { first, count, output }
    }
}

impl Conv2d {
    /// Checks the description.
    ///
    /// # Errors
    /// A zero size, or a kernel larger than the padded input.
    pub fn validate(&self) -> Result<(), ShapeError> {
        let why = if self.rows * self.cols * self.channels * self.filters * self.kernel * self.stride == 0 {
            "a size is zero"
        } else if self.rows.min(self.cols) + 2 * self.padding < self.kernel {
            "the kernel is larger than the padded input"
        } else if self.padding >= self.kernel {
            "the padding is not smaller than the kernel"
        } else {
            return Ok(());
        };
        Err(ShapeError::Description { what: "conv2d", why })
    }

    /// Output rows.
    pub fn out_rows(&self) -> usize {
        (self.rows + 2 * self.padding - self.kernel) / self.stride + 1
    }

    /// Output columns.
    pub fn out_cols(&self) -> usize {
        (self.cols + 2 * self.padding - self.kernel) / self.stride + 1
    }

    /// Values in the input image.
    pub fn input_len(&self) -> usize {
        self.rows * self.cols * self.channels
    }

    /// Values in the output image.
    pub fn output_len(&self) -> usize {
        self.out_rows() * self.out_cols() * self.filters
    }

    /// Number of weights.
    pub fn weight_len(&self) -> usize {
        self.kernel * self.kernel * self.channels * self.filters
    }

    /// Number of parameters: weights, then bias.
    pub fn param_len(&self) -> usize {
        self.weight_len() + self.filters
    }

    /// Multiply-adds of one forward pass, padding included.
    pub fn macs(&self) -> usize {
        self.out_rows() * self.out_cols() * self.weight_len()
    }

    fn vertical(&self) -> Axis {
        Axis {
            size: self.rows,
            out: self.out_rows(),
            kernel: self.kernel,
            stride: self.stride,
            padding: self.padding,
        }
    }

    fn horizontal(&self) -> Axis {
        Axis {
            size: self.cols,
            out: self.out_cols(),
            ..self.vertical()
        }
    }

    /// `y = f(x ∗ w + b)`. `pre` receives `x ∗ w + b` if given.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn forward(
        &self,
        isa: Isa,
        params: &[f32],
        activation: Activation,
        x: &[f32],
        mut pre: Option<&mut [f32]>,
        y: &mut [f32],
    ) -> Result<(), ShapeError> {
        self.validate()?;
        expect("conv2d parameters", params, self.param_len())?;
        expect("conv2d input", x, self.input_len())?;
        expect("conv2d output", y, self.output_len())?;
        if let Some(pre) = &pre {
            expect("conv2d pre-activation", pre, self.output_len())?;
        }
        let weights = part("conv2d weights", params, 0, self.weight_len())?;
        let bias = Start::Bias(part("conv2d bias", params, self.weight_len(), self.filters)?);
        let (vertical, horizontal) = (self.vertical(), self.horizontal());
        let (row, column) = (self.cols * self.channels, self.channels);
        let (w_row, w_col) = (self.kernel * self.channels * self.filters, self.channels * self.filters);
        let out_row_len = self.out_cols() * self.filters;
        let (inner_from, inner_to) = horizontal.interior();
        for (oy, y_row) in y.chunks_exact_mut(out_row_len).enumerate() {
            let (t0, t1) = vertical.taps(oy);
            // One or more neighbouring outputs that see the same columns of the kernel.
            let mut run = |from: usize, to: usize, s0: usize, s1: usize| {
                if from == to {
                    return Ok(());
                }
                let sees = t1 > t0 && s1 > s0;
                let product = Product {
                    rows: to - from,
                    cols: self.filters,
                    n_u: t1 - t0,
                    n_v: 1,
                    n_k: (s1 - s0) * self.channels,
                    a_at: if sees {
                        (vertical.input(oy, t0) * row + horizontal.input(from, s0) * column) as isize
                    } else {
                        0
                    },
                    a_row: (self.stride * column) as isize,
                    a_u: row as isize,
                    a_k: 1,
                    b_at: (t0 * w_row + s0 * w_col) as isize,
                    b_u: w_row as isize,
                    b_k: self.filters as isize,
                    out_at: from * self.filters,
                    out_row: self.filters,
                    ..Product::default()
                };
                product.run(isa, x, weights, bias, y_row)
            };
            run(inner_from, inner_to, 0, self.kernel)?;
            for ox in (0..inner_from).chain(inner_to..horizontal.out) {
                let (s0, s1) = horizontal.taps(ox);
                run(ox, ox + 1, s0, s1)?;
            }
            // While the row is in the nearest cache.
            if let Some(pre) = &mut pre {
                part_mut("conv2d pre-activation", pre, oy * out_row_len, out_row_len)?.copy_from_slice(y_row);
            }
            activation.apply_in_place(isa, y_row);
        }
        Ok(())
    }

    /// Writes the parameters in the order that [`Self::input_gradient`] reads: each tap's matrix transposed, bias unused.
    /// With few input channels the order differs (see there).
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn pack(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
        expect("conv2d parameters", params, self.param_len())?;
        expect("packed conv2d parameters", packed, self.param_len())?;
        let tap = self.channels * self.filters;
        let taps = params.chunks_exact(tap.max(1)).zip(packed.chunks_exact_mut(tap.max(1)));
        for (from, to) in taps.take(self.kernel * self.kernel) {
            if self.is_planar() {
                // [channel][filter] is already the order that the planar kernel reads.
                to.copy_from_slice(from);
            } else {
                transpose(self.channels, self.filters, from, to);
            }
        }
        Ok(())
    }

    /// With so few input channels vectors run along image columns instead of channels.
    fn is_planar(&self) -> bool {
        self.channels <= 4
    }

    /// Zeros left of each row of the transposed output gradient; also the least right of it.
    fn halo(&self) -> usize {
        self.kernel
    }

    /// Length of a row of the transposed output gradient with its halo.
    fn plane_row_len(&self) -> usize {
        self.out_cols().max(self.cols.div_ceil(self.stride)) + 2 * self.halo()
    }

    /// Length of one image row of the input, its columns sorted by phase and channel.
    fn phases_len(&self) -> usize {
        self.stride.min(self.cols) * self.channels * self.cols.div_ceil(self.stride)
    }

    /// Length of the scratch slice that [`Self::input_gradient`] needs.
    pub fn input_gradient_scratch_len(&self) -> usize {
        if self.is_planar() {
            self.out_rows() * self.filters * self.plane_row_len() + self.phases_len()
        } else {
            0
        }
    }

    /// `dx`, the gradient with respect to the input, from `dy` with respect to `x ∗ w + b`. The same for multipliers.
    ///
    /// `packed` comes from [`Self::pack`]; `scratch` is [`Self::input_gradient_scratch_len`] long, its content does not
    /// matter.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn input_gradient(
        &self,
        isa: Isa,
        packed: &[f32],
        dy: &[f32],
        dx: &mut [f32],
        scratch: &mut [f32],
    ) -> Result<(), ShapeError> {
        self.validate()?;
        expect("packed conv2d parameters", packed, self.param_len())?;
        expect("conv2d output gradient", dy, self.output_len())?;
        expect("conv2d input gradient", dx, self.input_len())?;
        if self.is_planar() {
            return self.input_gradient_planar(isa, packed, dy, dx, scratch);
        }
        let (vertical, horizontal) = (self.vertical(), self.horizontal());
        let row_len = self.cols * self.channels;
        let (w_row, w_col) = (self.kernel * self.channels * self.filters, self.channels * self.filters);
        let dy_row = horizontal.out * self.filters;
        let stride = self.stride;
        for (iy, dx_row) in dx.chunks_exact_mut(row_len).enumerate() {
            let rows = vertical.phase(iy);
            // `count` inputs a stride apart that are seen through the same taps.
            let mut run = |from: usize, count: usize, cols: Phase| {
                let product = Product {
                    rows: count,
                    cols: self.channels,
                    n_u: rows.count,
                    n_v: cols.count,
                    n_k: self.filters,
                    a_at: (rows.output * dy_row + cols.output * self.filters) as isize,
                    a_row: self.filters as isize,
                    a_u: -(dy_row as isize),
                    a_v: -(self.filters as isize),
                    a_k: 1,
                    b_at: (rows.first * w_row + cols.first * w_col) as isize,
                    b_u: (stride * w_row) as isize,
                    b_v: (stride * w_col) as isize,
                    b_k: self.channels as isize,
                    out_at: from * self.channels,
                    out_row: stride * self.channels,
                };
                product.run(isa, dy, packed, Start::Zero, dx_row)
            };
            for phase in 0..stride.min(self.cols) {
                let mut ix = phase;
                while ix < self.cols {
                    let taps = horizontal.phase(ix);
                    // Extend the run while the next input sees the same taps, one output further.
                    let mut count = 1;
                    let mut next = ix + stride;
                    while next < self.cols {
                        let further = horizontal.phase(next);
                        if further.first != taps.first
                            || further.count != taps.count
                            || further.output != taps.output + count
                        {
                            break;
                        }
                        count += 1;
                        next += stride;
                    }
                    run(ix, count, taps)?;
                    ix = next;
                }
            }
        }
        Ok(())
    }

    /// The input gradient with vectors along the columns: `dy` is first turned into planes `[row][filter][column]` with
    /// zeros around each row, so that no tap needs a bounds check; then each phase of columns is a product of weights
    /// (broadcast) and shifted planes, and the phases are interleaved into the image row.
    fn input_gradient_planar(
        &self,
        isa: Isa,
        packed: &[f32],
        dy: &[f32],
        dx: &mut [f32],
        scratch: &mut [f32],
    ) -> Result<(), ShapeError> {
        expect("conv2d scratch", scratch, self.input_gradient_scratch_len())?;
        let (vertical, horizontal) = (self.vertical(), self.horizontal());
        let (halo, plane_row, stride) = (self.halo(), self.plane_row_len(), self.stride);
        let plane_image_row = self.filters * plane_row;
        let phase_len = self.cols.div_ceil(stride);
        let planes_len = self.out_rows() * plane_image_row;
        let (planes, phase_rows) = scratch
            .split_at_mut_checked(planes_len)
            .ok_or(ShapeError::Description {
                what: "conv2d",
                why: "scratch is too short",
            })?;
        let dy_rows = dy.chunks_exact(horizontal.out * self.filters);
        for (plane, dy_row) in planes.chunks_exact_mut(plane_image_row).zip(dy_rows) {
            for row in plane.chunks_exact_mut(plane_row) {
                let (left, rest) = row.split_at_mut_checked(halo).unwrap_or_default();
                left.fill(0.0);
                if let Some(right) = rest.get_mut(horizontal.out..) {
                    right.fill(0.0);
                }
            }
            kernels::run(
                isa,
                Transpose {
                    width: self.filters,
                    from: dy_row,
                    to: plane.get_mut(halo..).unwrap_or_default(),
                    to_row: plane_row,
                },
            );
        }
        let tap = self.channels * self.filters;
        let w_row = self.kernel * tap;
        for (iy, dx_row) in dx.chunks_exact_mut(self.cols * self.channels).enumerate() {
            let rows = vertical.phase(iy);
            for (phase, phase_row) in phase_rows.chunks_exact_mut(self.channels * phase_len).enumerate() {
                let count = (self.cols - phase).div_ceil(stride);
                // Input phase + m·stride is seen through taps first, first + stride, … by outputs
                // top + m, top + m − 1, …; those that do not exist are zeros of the halo.
                let at = phase + self.padding;
                let (first, top) = (at % stride, at / stride);
                let taps = self.kernel.saturating_sub(first).div_ceil(stride);
                let product = Product {
                    rows: self.channels,
                    cols: count,
                    n_u: rows.count,
                    n_v: taps,
                    n_k: self.filters,
                    a_at: (rows.first * w_row + first * tap) as isize,
                    a_row: self.filters as isize,
                    a_u: (stride * w_row) as isize,
                    a_v: (stride * tap) as isize,
                    a_k: 1,
                    b_at: (rows.output * plane_image_row + halo + top) as isize,
                    b_u: -(plane_image_row as isize),
                    b_v: -1,
                    b_k: plane_row as isize,
                    out_at: 0,
                    out_row: phase_len,
                };
                product.run(isa, packed, planes, Start::Zero, phase_row)?;
            }
            let sorted = phase_rows.len() / phase_len;
            kernels::run(
                isa,
                Interleave {
                    from: phase_rows,
                    lists: sorted,
                    to: dx_row,
                },
            );
        }
        Ok(())
    }

    /// Adds to `d_params` the gradient with respect to weights and bias; `dy` is with respect to `x ∗ w + b`.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn weight_gradient(&self, isa: Isa, x: &[f32], dy: &[f32], d_params: &mut [f32]) -> Result<(), ShapeError> {
        self.validate()?;
        expect("conv2d parameter gradient", d_params, self.param_len())?;
        expect("conv2d input", x, self.input_len())?;
        expect("conv2d output gradient", dy, self.output_len())?;
        let (vertical, horizontal) = (self.vertical(), self.horizontal());
        let (row, column) = (self.cols * self.channels, self.channels);
        let dy_row = horizontal.out * self.filters;
        let (inner_from, inner_to) = horizontal.interior();
        for t in 0..self.kernel {
            let (o0, o1) = vertical.outputs_of_tap(t);
            if o0 == o1 {
                continue;
            }
            // A run of outputs per image row that see kernel columns s0..s1; all image rows in one sum.
            let mut run = |from: usize, to: usize, s0: usize, s1: usize| {
                if from == to || s0 == s1 {
                    return Ok(());
                }
                let product = Product {
                    rows: (s1 - s0) * self.channels,
                    cols: self.filters,
                    n_u: o1 - o0,
                    n_v: 1,
                    n_k: to - from,
                    a_at: (vertical.input(o0, t) * row + horizontal.input(from, s0) * column) as isize,
                    a_row: 1,
                    a_u: (self.stride * row) as isize,
                    a_k: (self.stride * column) as isize,
                    b_at: (o0 * dy_row + from * self.filters) as isize,
                    b_u: dy_row as isize,
                    b_k: self.filters as isize,
                    out_at: (t * self.kernel + s0) * self.channels * self.filters,
                    out_row: self.filters,
                    ..Product::default()
                };
                product.run(isa, x, dy, Start::Output, d_params)
            };
            run(inner_from, inner_to, 0, self.kernel)?;
            for ox in (0..inner_from).chain(inner_to..horizontal.out) {
                let (s0, s1) = horizontal.taps(ox);
                run(ox, ox + 1, s0, s1)?;
            }
        }
        let pixels = vertical.out * horizontal.out;
        column_sums(isa, pixels, self.filters, dy, d_params, self.weight_len())
    }
}

/// Turns `from` (rows of `width` values) into columns: value `c` of row `r` goes to `to[c · to_row + r]`.
struct Transpose<'a> {
    width: usize,
    from: &'a [f32],
    to: &'a mut [f32],
    to_row: usize,
}

/// Four values from `at` on.
#[inline(always)]
fn four(values: &[f32], at: usize) -> [f32; 4] {
    let values = values.get(at..).and_then(|values| values.first_chunk());
    values.copied().unwrap_or([0.0; 4])
}

impl Task for Transpose<'_> {
    #[inline(always)]
    fn run(self) {
        let (width, to_row) = (self.width, self.to_row);
        for (block, rows) in self.from.chunks(4 * width).enumerate() {
            let first = block * 4;
            let square = if rows.len() == 4 * width { width / 4 * 4 } else { 0 };
            // Four by four: the compiler makes shuffles of it.
            for column in (0..square).step_by(4) {
                let [a0, a1, a2, a3] = four(rows, column);
                let [b0, b1, b2, b3] = four(rows, column + width);
                let [c0, c1, c2, c3] = four(rows, column + 2 * width);
                let [d0, d1, d2, d3] = four(rows, column + 3 * width);
                let lines = [[a0, b0, c0, d0], [a1, b1, c1, d1], [a2, b2, c2, d2], [a3, b3, c3, d3]];
                for (c, line) in lines.iter().enumerate() {
                    let at = (column + c) * to_row + first;
                    if let Some(slot) = self.to.get_mut(at..at + 4) {
                        slot.copy_from_slice(line);
                    }
                }
            }
            for column in square..width {
                for (r, line) in rows.chunks_exact(width).enumerate() {
                    let value = line.get(column).copied();
                    if let (Some(slot), Some(value)) = (self.to.get_mut(column * to_row + first + r), value) {
                        *slot = value;
                    }
                }
            }
        }
    }
}

/// Deals several lists of equal length out in turn: `to[i · lists + l] = from[l][i]`, as far as `to` reaches.
struct Interleave<'a> {
    from: &'a [f32],
    lists: usize,
    to: &'a mut [f32],
}

impl Task for Interleave<'_> {
    #[inline(always)]
    fn run(self) {
        let len = self.from.len() / self.lists.max(1);
        if self.lists == 2
            && let Some((even, odd)) = self.from.split_at_checked(len)
        {
            let (pairs, last) = self.to.as_chunks_mut::<2>();
            for (pair, (even, odd)) in pairs.iter_mut().zip(even.iter().zip(odd)) {
                *pair = [*even, *odd];
            }
            if let ([last], Some(value)) = (last, even.last()) {
                *last = *value;
            }
            return;
        }
        for (l, list) in self.from.chunks_exact(len.max(1)).enumerate() {
            for (to, from) in self.to.iter_mut().skip(l).step_by(self.lists).zip(list) {
                *to = *from;
            }
        }
    }
}
