//! Max pooling.

use crate::graph::operation::Operation;
use crate::graph::run::{Backward, Forward, Pass};
use crate::graph::{GraphBuilder, NodeId, Params, description};
use crate::shape::ShapeError;
use crate::vectorised;
use core::ops::Range;

/// The largest value of each window of one image `[row][column][channel]`; windows may overlap, and what pads the image never is
/// the largest. Rows and columns left over at the end are not looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MaxPool2d {
    /// Input rows.
    pub rows: usize,
    /// Input columns.
    pub cols: usize,
    /// Channels.
    pub channels: usize,
    /// Rows and columns of a window.
    pub window: [usize; 2],
    /// Step between windows.
    pub stride: usize,
    /// Rows and columns that are added on each side: less than a window has.
    pub padding: usize,
}

impl MaxPool2d {
    /// Square windows side by side.
    pub fn tiles(rows: usize, cols: usize, channels: usize, side: usize) -> Self {
        Self {
            rows,
            cols,
            channels,
            window: [side; 2],
            stride: side,
            padding: 0,
        }
    }

    /// Checks the description.
    ///
    /// # Errors
    /// A zero size, a window larger than the padded image, or one that holds padding alone.
    pub fn validate(&self) -> Result<(), ShapeError> {
        let [height, width] = self.window;
        let fits = |size: usize, window: usize| {
            let padded = size.saturating_add(self.padding.saturating_mul(2));
            size > 0 && window <= padded && self.padding < window
        };
        if self.channels == 0 || self.stride == 0 || !fits(self.rows, height) || !fits(self.cols, width) {
            let why = "a size is zero, the window is larger than the image, or the padding is as large as the window";
            return description("max pool", why);
        }
        Ok(())
    }

    fn out(&self, size: usize, window: usize) -> usize {
        (size + 2 * self.padding).saturating_sub(window) / self.stride.max(1) + 1
    }

    /// Output rows.
    pub fn out_rows(&self) -> usize {
        self.out(self.rows, self.window[0])
    }

    /// Output columns.
    pub fn out_cols(&self) -> usize {
        self.out(self.cols, self.window[1])
    }

    /// Values in the input image.
    pub fn input_len(&self) -> usize {
        self.rows * self.cols * self.channels
    }

    /// Values in the output image.
    pub fn output_len(&self) -> usize {
        self.out_rows() * self.out_cols() * self.channels
    }

    /// Rows and columns of the image that the window of output pixel `o` looks at.
    fn window_of(&self, o: usize) -> [Range<usize>; 2] {
        let (row, col) = (o / self.out_cols(), o % self.out_cols());
        let within = |at: usize, window: usize, size: usize| {
            let from = at * self.stride;
            from.saturating_sub(self.padding)..(from + window).saturating_sub(self.padding).min(size)
        };
        [
            within(row, self.window[0], self.rows),
            within(col, self.window[1], self.cols),
        ]
    }

    /// Where in `x` the maximum of a window, output value number `at`, lies: the first of equals.
    fn winner(&self, x: &[f32], at: usize, best: f32) -> usize {
        let (window, channel) = (at / self.channels.max(1), at % self.channels.max(1));
        let [rows, cols] = self.window_of(window);
        let at = |row: usize, col: usize| (row * self.cols + col) * self.channels + channel;
        let first = at(rows.start, cols.start);
        let all = rows.flat_map(|row| cols.clone().map(move |col| (row, col)));
        all.map(|(row, col)| at(row, col))
            .find(|at| x.get(*at).is_some_and(|x| *x == best))
            .unwrap_or(first)
    }

    /// `dx`: each output's gradient at the input that was the maximum.
    fn input_gradient(&self, (x, y): (&[f32], &[f32]), dy: &[f32], dx: &mut [f32]) {
        for (at, (best, d)) in y.iter().zip(dy).enumerate() {
            if let Some(slot) = dx.get_mut(self.winner(x, at, *best)) {
                *slot += d;
            }
        }
    }

    /// Multipliers: the change of a window's maximum is given to the pixel that is the maximum where the maximum is
    /// larger (in `x` or in `x_ref`), divided by that pixel's change. This is the rule of the `shap` package's
    /// PyTorch explainer, and additive.
    fn multipliers(&self, (x, y): (&[f32], &[f32]), (x_ref, y_ref): (&[f32], &[f32]), m_out: &[f32], m_in: &mut [f32]) {
        for (at, ((y, y_ref), m)) in y.iter().zip(y_ref).zip(m_out).enumerate() {
            let winner = if y >= y_ref {
                self.winner(x, at, *y)
            } else {
                self.winner(x_ref, at, *y_ref)
            };
            if let (Some(x), Some(x_ref), Some(slot)) = (x.get(winner), x_ref.get(winner), m_in.get_mut(winner)) {
                let dx = x - x_ref;
                *slot += if dx.abs() < crate::activation::RESCALE_THRESHOLD {
                    0.0
                } else {
                    m * (y - y_ref) / dx
                };
            }
        }
    }
}

vectorised! {
    /// `y` `[out_rows][out_cols][channels]`: the maximum of each window of `x` `[rows][cols][channels]`.
    fn pool<'a>(layer: MaxPool2d, x: &'a [f32], y: &'a mut [f32]) {
        // So many channels at a time as fill a register, whose number is known to the compiler.
        match layer.channels {
            channels if channels % 8 == 0 => layer.pool_by::<8>(x, y),
            channels if channels % 4 == 0 => layer.pool_by::<4>(x, y),
            channels if channels % 3 == 0 => layer.pool_by::<3>(x, y),
            channels if channels % 2 == 0 => layer.pool_by::<2>(x, y),
            _ => layer.pool_by::<1>(x, y),
        }
    }
}

impl MaxPool2d {
    #[inline(always)]
    fn pool_by<const C: usize>(self, x: &[f32], y: &mut [f32]) {
        let Self { cols, channels, .. } = self;
        for (o, best) in y.chunks_exact_mut(channels).enumerate() {
            let [lines, columns] = self.window_of(o);
            let side = columns.len() * channels;
            for (c, best) in best.as_chunks_mut::<C>().0.iter_mut().enumerate() {
                let mut largest = [f32::NEG_INFINITY; C];
                for line in lines.clone() {
                    let at = (line * cols + columns.start) * channels;
                    for pixel in x.get(at..at + side).unwrap_or_default().chunks_exact(channels) {
                        let Some(pixel) = pixel.as_chunks::<C>().0.get(c) else {
                            continue;
                        };
                        for (largest, x) in largest.iter_mut().zip(pixel) {
                            // A value that is not a number wins, so that it is not hidden.
                            *largest = if *x > *largest || x.is_nan() { *x } else { *largest };
                        }
                    }
                }
                *best = largest;
            }
        }
    }
}

impl GraphBuilder {
    /// Max pooling.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn max_pool2d(&mut self, x: NodeId, layer: MaxPool2d) -> Result<NodeId, ShapeError> {
        layer.validate()?;
        self.check("max pool input", x, layer.input_len())?;
        self.add(layer, &[x], layer.output_len(), Params::default())
    }
}

impl Operation for MaxPool2d {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        pool(node.isa, *self, node.source(0)?, node.value);
        Ok(())
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        let on = |tape| Ok::<_, ShapeError>((node.source(0, tape)?, node.kept(tape)?.value));
        let now = on(node.tape)?;
        let reference = pass.reference().map(on).transpose()?;
        node.write_source(0, |dx, _| {
            dx.fill(0.0);
            match reference {
                None => self.input_gradient(now, d, dx),
                Some(reference) => self.multipliers(now, reference, d, dx),
            }
            Ok(())
        })
    }
}
