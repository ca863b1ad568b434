//! Two-dimensional convolution, direct, rows × columns × channels.

pub(crate) mod chain;
mod input;
mod planar;
mod reorder;

use crate::activation::Activation;
use crate::dense::column_sums;
use crate::graph::layer::weighted_operation;
use crate::graph::{GraphBuilder, NodeId, Params};
use crate::isa::Isa;
use crate::kernels::{Product, Start};
use crate::shape::{ShapeError, expect, part, part_mut};

/// Values of an output gradient that are read while they are in the nearest cache.
const NEAR_CACHE: usize = 4096;

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

/// Neighbouring outputs `from..to` that see the input through kernel taps `taps.0..taps.1`.
#[derive(Clone, Copy)]
struct Run {
    from: usize,
    to: usize,
    taps: (usize, usize),
    border: bool,
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

    /// The outputs in runs that see the input through the same taps: those at the border one by one.
    fn runs(self) -> impl Iterator<Item = Run> {
        let (from, to) = self.interior();
        let border = move |o: usize| Run {
            from: o,
            to: o + 1,
            taps: self.taps(o),
            border: true,
        };
        let interior = Run {
            from,
            to,
            taps: (0, self.kernel),
            border: false,
        };
        let inside = core::iter::once(interior).filter(|run| run.from < run.to);
        (0..from).map(border).chain(inside).chain((to..self.out).map(border))
    }

    /// First input coordinate of output `o` through tap `t`; the pair must be one of the above.
    fn input(self, o: usize, t: usize) -> usize {
        o * self.stride + t - self.padding
    }
}

impl Conv2d {
    /// One of images of `[rows, cols, channels]`.
    pub const fn new(
        [rows, cols, channels]: [usize; 3],
        filters: usize,
        kernel: usize,
        stride: usize,
        padding: usize,
    ) -> Self {
        Self {
            rows,
            cols,
            channels,
            filters,
            kernel,
            stride,
            padding,
        }
    }

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
        (self.rows + 2 * self.padding).saturating_sub(self.kernel) / self.stride.max(1) + 1
    }

    /// Output columns.
    pub fn out_cols(&self) -> usize {
        (self.cols + 2 * self.padding).saturating_sub(self.kernel) / self.stride.max(1) + 1
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

    /// `y = f(x ∗ w + b)`, from `x` `[rows][cols][channels]` to `y` `[out_rows][out_cols][filters]`. `pre`, of `y`'s shape, receives
    /// `x ∗ w + b` if given.
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
        // `rows` outputs, `out_row` values apart, that see the same taps.
        let product = |h: Run, v: Run, oy: usize, rows: usize, a_row: usize, out_row: usize| {
            let ((t0, t1), (s0, s1)) = (v.taps, h.taps);
            Product {
                rows,
                cols: self.filters,
                n_u: t1 - t0,
                n_k: (s1 - s0) * self.channels,
                a_at: (vertical.input(oy, t0) * row + horizontal.input(h.from, s0) * column) as isize,
                a_row: (self.stride * a_row) as isize,
                a_u: row as isize,
                a_k: 1,
                b_at: (t0 * w_row + s0 * w_col) as isize,
                b_u: w_row as isize,
                b_k: self.filters as isize,
                out_row,
                ..Product::single()
            }
        };
        // The border's columns run downwards: one output at a time would wait for each sum.
        for h in horizontal.runs().filter(|h| h.border) {
            for v in vertical.runs() {
                let product = Product {
                    out_at: v.from * out_row_len + h.from * self.filters,
                    ..product(h, v, v.from, v.to - v.from, row, out_row_len)
                };
                product.run(isa, x, weights, bias, y)?;
            }
        }
        for v in vertical.runs() {
            for oy in v.from..v.to {
                let y_row = part_mut("conv2d output", y, oy * out_row_len, out_row_len)?;
                for h in horizontal.runs().filter(|h| !h.border) {
                    let product = Product {
                        out_at: h.from * self.filters,
                        ..product(h, v, oy, h.to - h.from, column, self.filters)
                    };
                    product.run(isa, x, weights, bias, y_row)?;
                }
                // While the row is in the nearest cache.
                if let Some(pre) = &mut pre {
                    part_mut("conv2d pre-activation", pre, oy * out_row_len, out_row_len)?.copy_from_slice(y_row);
                }
                activation.apply_in_place(isa, y_row);
            }
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
        // As many image rows at a time as stay in the nearest cache while all weights pass.
        let block = (NEAR_CACHE / dy_row.max(1)).max(1);
        for v in vertical.runs() {
            let (t0, t1) = v.taps;
            for h in horizontal.runs() {
                let (s0, s1) = h.taps;
                // Kernel rows `t..t + bands`, image rows `from..to`.
                let mut run = |t: usize, bands: usize, from: usize, to: usize| {
                    let product = Product {
                        rows: (s1 - s0) * self.channels,
                        cols: self.filters,
                        bands,
                        n_u: to - from,
                        n_k: h.to - h.from,
                        a_at: (vertical.input(from, t) * row + horizontal.input(h.from, s0) * column) as isize,
                        a_row: 1,
                        a_band: row as isize,
                        a_u: (self.stride * row) as isize,
                        a_k: (self.stride * column) as isize,
                        b_at: (from * dy_row + h.from * self.filters) as isize,
                        b_u: dy_row as isize,
                        b_k: self.filters as isize,
                        out_at: (t * self.kernel + s0) * self.channels * self.filters,
                        out_row: self.filters,
                        ..Product::single()
                    };
                    product.run(isa, x, dy, Start::Output, d_params)
                };
                if h.border {
                    // The weights of some kernel columns do not lie one behind the other.
                    for t in t0..t1 {
                        run(t, 1, v.from, v.to)?;
                    }
                } else {
                    for from in (v.from..v.to).step_by(block) {
                        run(t0, t1 - t0, from, v.to.min(from + block))?;
                    }
                }
            }
        }
        let pixels = vertical.out * horizontal.out;
        column_sums(isa, pixels, self.filters, dy, d_params, self.weight_len())
    }
}

impl GraphBuilder {
    /// A convolution with its activation: `[rows][cols][channels]` to `[out_rows][out_cols][filters]`.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn conv2d(
        &mut self,
        x: NodeId,
        layer: Conv2d,
        activation: Activation,
        params: Params,
    ) -> Result<NodeId, ShapeError> {
        layer.validate()?;
        self.check("conv2d input", x, layer.input_len())?;
        Self::check_params("conv2d parameters", params, layer.param_len())?;
        self.add((layer, activation), &[x], layer.output_len(), params)
    }
}

weighted_operation!(
    Conv2d,
    |layer| layer.kernel * layer.kernel * layer.channels,
    Conv2d::input_gradient_scratch_len,
    Conv2d::input_gradient
);
