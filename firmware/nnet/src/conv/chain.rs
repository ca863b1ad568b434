//! Convolutions one behind the other, row by row: what lies between two of them stays in the nearest caches.
//!
//! As nodes of a [`crate::Graph`], which keeps all values for a backward pass, the built-in encoder writes 1 MB, and a step
//! after 50 ms of sleep waits for memory at each line of it.

use super::Conv2d;
use crate::activation::Activation;
use crate::aligned::Aligned;
use crate::graph::Params;
use crate::isa::Isa;
use crate::kernels::{Product, Start};
use crate::shape::{ShapeError, expect, part, part_mut};
use alloc::vec::Vec;
use core::ops::Range;

/// Some rows of what a layer reads, with zeros on all sides, as many as its padding.
#[derive(Debug, Clone)]
struct Plane {
    /// Rows of the image without zeros, and those of zeros above and below them.
    rows: usize,
    padding: usize,
    /// Values of a row without zeros, and zeros on each of its sides.
    row_len: usize,
    halo: usize,
    /// The rows that `values` holds, counted from the first one of zeros.
    held: Range<usize>,
    values: Aligned,
}

impl Plane {
    /// Room for `room` rows of an image of `[rows, cols, channels]`.
    fn new([rows, cols, channels]: [usize; 3], padding: usize, room: usize) -> Self {
        let (row_len, halo) = (cols * channels, padding * channels);
        Self {
            rows,
            padding,
            row_len,
            halo,
            held: 0..0,
            values: Aligned::zeros((row_len + 2 * halo) * room),
        }
    }

    /// Values of a row with its zeros.
    fn pitch(&self) -> usize {
        self.row_len + 2 * self.halo
    }

    /// Where a row begins.
    fn at(&self, row: usize) -> usize {
        row.saturating_sub(self.held.start) * self.pitch()
    }

    /// Makes room for the rows before `until`, if there is none, where rows before `from` are.
    fn make_room(&mut self, from: usize, until: usize) {
        if self.at(until) > self.values.len() {
            let kept = from.min(self.held.end);
            let moved = self.at(kept)..self.at(self.held.end);
            self.values.copy_within(moved, 0);
            self.held.start = kept;
        }
    }
}

/// One layer: the convolution, its curve, its parameters among all of the network's.
type Layer = (Conv2d, Activation, Params);

/// A curve and convolutions behind it, evaluated without keeping what a backward pass would need. The same values as of
/// [`Conv2d::forward`], to the bit (but for the sign of a zero): a sum with zeros of the padding in it is the same. Allocates
/// when it is made; nothing after it does.
#[derive(Debug, Clone)]
pub struct ConvChain {
    first: Activation,
    layers: Vec<Layer>,
    /// What each layer reads, and behind them the output, whole.
    planes: Vec<Plane>,
}

impl ConvChain {
    /// `first` of the image, then `layers`.
    ///
    /// # Errors
    /// No layer, one that is not usable, or one that does not fit the one before it.
    pub fn new(first: Activation, layers: &[Layer]) -> Result<Self, ShapeError> {
        let description = |why| ShapeError::Description {
            what: "conv chain",
            why,
        };
        let mut planes = Vec::with_capacity(layers.len() + 1);
        let mut written = None;
        for (layer, _, params) in layers {
            layer.validate()?;
            let read = [layer.rows, layer.cols, layer.channels];
            if written.is_some_and(|written| written != read) || params.len != layer.param_len() {
                return Err(description("a layer does not fit the one before it, or its parameters"));
            }
            // Rows are moved together once for several that are made.
            planes.push(Plane::new(read, layer.padding, layer.kernel + 4 * layer.stride));
            written = Some([layer.out_rows(), layer.out_cols(), layer.filters]);
        }
        let Some(written @ [rows, ..]) = written else {
            return Err(description("it has no layer"));
        };
        planes.push(Plane::new(written, 0, rows));
        let layers = layers.to_vec();
        Ok(Self { first, layers, planes })
    }

    /// The last layer's output `[out_rows][out_cols][filters]` of an image `[rows][cols][channels]`; `params` are the whole
    /// network's.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn forward(&mut self, isa: Isa, params: &[f32], image: &[f32]) -> Result<&[f32], ShapeError> {
        let Self { first, layers, planes } = self;
        let read = layers.first().map_or(0, |(layer, _, _)| layer.input_len());
        expect("conv chain input", image, read)?;
        planes.iter_mut().for_each(|plane| plane.held = 0..0);
        let all = planes.last().map_or(0, |output| output.rows);
        let evaluated = Evaluated {
            isa,
            params,
            image,
            first: *first,
        };
        evaluated.make(layers, planes, 0..all)?;
        Ok(planes.last().map_or(&[], |output| &output.values))
    }
}

/// One evaluation.
struct Evaluated<'a> {
    isa: Isa,
    params: &'a [f32],
    image: &'a [f32],
    first: Activation,
}

impl Evaluated<'_> {
    /// Makes those of the last plane's rows `wanted` that are not there yet, of the rows before them that they are made from: as deep
    /// as there are layers. Rows before `wanted` are not asked for again.
    fn make(&self, layers: &[Layer], planes: &mut [Plane], wanted: Range<usize>) -> Result<(), ShapeError> {
        let Some((plane, before)) = planes.split_last_mut() else {
            return Ok(());
        };
        plane.make_room(wanted.start, wanted.end);
        for row in plane.held.end..wanted.end {
            let at = plane.at(row) + plane.halo;
            let own = part_mut("conv chain row", &mut plane.values, at, plane.row_len)?;
            plane.held.end = row + 1;
            let Some(y) = row.checked_sub(plane.padding).filter(|y| *y < plane.rows) else {
                own.fill(0.0);
                continue;
            };
            let Some(((layer, activation, params), before_it)) = layers.split_last() else {
                own.copy_from_slice(part("conv chain input", self.image, y * plane.row_len, plane.row_len)?);
                self.first.apply_in_place(self.isa, own);
                continue;
            };
            let top = y * layer.stride;
            self.make(before_it, before, top..top + layer.kernel)?;
            let Some(read) = before.last() else { continue };
            let line = layer.kernel * layer.channels;
            let product = Product {
                rows: layer.out_cols(),
                cols: layer.filters,
                n_u: layer.kernel,
                n_k: line,
                a_at: read.at(top) as isize,
                a_row: (layer.stride * layer.channels) as isize,
                a_u: read.pitch() as isize,
                a_k: 1,
                b_u: (line * layer.filters) as isize,
                b_k: layer.filters as isize,
                out_row: layer.filters,
                ..Product::single()
            };
            let weights = part("conv chain weights", self.params, params.at, layer.weight_len())?;
            let bias = part(
                "conv chain bias",
                self.params,
                params.at + layer.weight_len(),
                layer.filters,
            )?;
            product.run(self.isa, &read.values, weights, Start::Bias(bias), own)?;
            activation.apply_in_place(self.isa, own);
        }
        Ok(())
    }
}
