//! Convolutions whose factors are bytes, for evaluation alone.

use crate::activation::Activation;
use crate::aligned::Aligned;
use crate::conv::Conv2d;
use crate::isa::Isa;
use crate::kernels::{self, BLOCK, DEPTH, DotProduct, Factors, Meaning, Task};
use crate::shape::{ShapeError, expect};
use alloc::vec;
use alloc::vec::Vec;
use core::f32::consts::{LN_2, LOG2_E};

/// Adding 1.5 · 2^23 leaves the nearest integer in the low mantissa bits.
const ROUND: f32 = 12_582_912.0;

/// Steps of a byte between the least value of an ELU, −1, and the frame's largest: two of the 255 are for rounding.
const STEPS: f32 = 253.0;

/// Convolutions one behind the other, each with an ELU, of an image of values from 0 to 1; what lies outside counts as the nearer of the two.
///
/// Weights are whole steps of a 127th of their filter's largest. Values between two layers are whole steps as well, of a length chosen
/// for each image from the layer's largest value, so that none is cut off and nothing has to be calibrated. Sums are integers, and what
/// is done to them is rounded operation by operation: **every instruction set gives the same bits**. The last layer's values are
/// float32. An image with a value that is not a number gives nothing but such.
#[derive(Debug, Clone)]
pub struct Int8Chain {
    near_contrast: Option<f32>,
    layers: Vec<Layer>,
    /// A layer's input, `[row][column][channel]` with its border.
    image: Vec<u8>,
    /// A layer's sums, `[row][column][filter]`.
    values: Aligned,
}

impl Int8Chain {
    /// Convolutions with their parameters (those of [`Conv2d`]); `input` is applied to the image before. Allocates; nothing after it does.
    ///
    /// # Errors
    /// No layer, parameters of another length, layers that do not follow one another, filters that are no multiple of 16, another `input` than
    /// identity and near contrast.
    pub fn new<'a>(
        input: Activation,
        layers: impl IntoIterator<Item = (Conv2d, &'a [f32])>,
    ) -> Result<Self, ShapeError> {
        let layers = layers.into_iter().map(|(shape, params)| Layer::new(shape, params));
        let layers = layers.collect::<Result<Vec<_>, _>>()?;
        let unusable = |why| ShapeError::Description {
            what: "int8 chain",
            why,
        };
        let near_contrast = match input {
            Activation::Identity => None,
            Activation::NearContrast { gain } => Some(gain),
            _ => return Err(unusable("its input is neither as it is nor near contrast")),
        };
        let follow = layers.iter().zip(layers.iter().skip(1)).all(|(before, after)| {
            let (from, to) = (&before.shape, &after.shape);
            (from.out_rows(), from.out_cols(), from.filters) == (to.rows, to.cols, to.channels)
        });
        if layers.is_empty() || !follow {
            return Err(unusable("its layers do not follow one another"));
        }
        let most = |len: fn(&Layer) -> usize| layers.iter().map(len).max().unwrap_or(0);
        Ok(Self {
            near_contrast,
            image: vec![0; most(Layer::image_len)],
            values: Aligned::zeros(most(|layer| layer.shape.output_len())),
            layers,
        })
    }

    /// From an image to the last layer's values, `[row][column][filter]`.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn forward(&mut self, isa: Isa, x: &[f32], y: &mut [f32]) -> Result<(), ShapeError> {
        let (Some(first), Some(last)) = (self.layers.first(), self.layers.last()) else {
            return Ok(());
        };
        expect("network input", x, first.shape.input_len())?;
        expect("network output", y, last.shape.output_len())?;
        let (gain, mut unknown) = (self.near_contrast, 0);
        first.write(&mut self.image, 0, x, |x, to| {
            let unknown = &mut unknown;
            kernels::run(isa, Input { gain, x, to, unknown });
        });
        if unknown != 0 {
            y.fill(f32::NAN);
            return Ok(());
        }
        let (mut step, mut zero) = (1.0 / 255.0, 0.0);
        let mut layers = self.layers.iter_mut().peekable();
        while let Some(layer) = layers.next() {
            let last = layers.peek().is_none();
            let len = layer.shape.output_len();
            let values = self.values.get_mut(..len).unwrap_or_default();
            // Sums that another layer reads are in units of ln 2.
            let most = layer.sums(isa, &self.image, step, zero, if last { 1.0 } else { LOG2_E }, values)? * LN_2;
            let Some(next) = layers.peek() else {
                // Few values, and the same bits: others fuse multiply and add.
                return Activation::Elu.apply(Isa::PORTABLE, values, y);
            };
            step = (most + 1.0) / STEPS;
            zero = libm::rintf(1.0 / step) + 1.0;
            next.write(&mut self.image, zero as u8, values, |x, to| {
                kernels::run(isa, Elu { x, to, step, zero });
            });
        }
        Ok(())
    }
}

/// A convolution with its weights as bytes.
#[derive(Debug, Clone)]
struct Layer {
    shape: Conv2d,
    /// `[block of filters][kernel row][four neighbours]`; neighbours are `[column][channel]`.
    weights: Vec<Factors>,
    /// Of each block of filters.
    filters: Vec<Filters>,
    /// What the sums stand for, for the image that is being evaluated.
    meaning: Vec<Meaning>,
}

/// What 16 filters' weights stand for.
#[derive(Debug, Clone)]
struct Filters {
    /// Weight of a step.
    step: [f32; BLOCK],
    /// Sum of the weights in steps.
    total: [i32; BLOCK],
    bias: [f32; BLOCK],
}

impl Layer {
    fn new(shape: Conv2d, params: &[f32]) -> Result<Self, ShapeError> {
        shape.validate()?;
        expect("conv2d parameters", params, shape.param_len())?;
        let (rows, bias) = params.split_at(shape.weight_len());
        let (blocks, rest) = bias.as_chunks::<BLOCK>();
        if !rest.is_empty() {
            return Err(ShapeError::Description {
                what: "int8 conv2d",
                why: "its filters are no multiple of 16",
            });
        }
        let mut layer = Self {
            shape,
            weights: Vec::with_capacity(blocks.len() * shape.kernel * layer_groups(&shape)),
            filters: Vec::with_capacity(blocks.len()),
            meaning: Vec::with_capacity(blocks.len()),
        };
        for (block, bias) in blocks.iter().enumerate() {
            // The weights of these filters: one line for each kernel row, column and channel.
            let lines = rows.chunks_exact(shape.filters);
            let lines = lines.filter_map(|line| line.as_chunks::<BLOCK>().0.get(block));
            let mut step = [0.0_f32; BLOCK];
            for line in lines.clone() {
                for (most, w) in step.iter_mut().zip(line) {
                    *most = most.max(w.abs());
                }
            }
            let step = step.map(|most| most.max(f32::MIN_POSITIVE * 256.0) / 127.0);
            let mut total = [0; BLOCK];
            let lines: Vec<_> = lines.collect();
            for row in lines.chunks(shape.kernel * shape.channels) {
                for group in row.chunks(DEPTH) {
                    let mut factors = Factors([[0; DEPTH]; BLOCK]);
                    for (j, line) in group.iter().enumerate() {
                        let filters = factors.0.iter_mut().zip(&mut total).zip(line.iter().zip(&step));
                        for ((factors, total), (w, step)) in filters {
                            let rounded = libm::rintf(w / step) as i8;
                            *total += i32::from(rounded);
                            if let Some(factor) = factors.get_mut(j) {
                                *factor = rounded;
                            }
                        }
                    }
                    layer.weights.push(factors);
                }
            }
            let bias = *bias;
            layer.filters.push(Filters { step, total, bias });
            layer.meaning.push(Meaning {
                start: [0; BLOCK],
                scale: [0.0; BLOCK],
                bias,
            });
        }
        Ok(layer)
    }

    /// Bytes in a row of the input image with its border.
    fn row_len(&self) -> usize {
        (self.shape.cols + 2 * self.shape.padding) * self.shape.channels
    }

    /// Bytes of the input image with its border, and those behind it that are read and multiplied by zero.
    fn image_len(&self) -> usize {
        (self.shape.rows + 2 * self.shape.padding) * self.row_len() + DEPTH
    }

    /// Writes the input image: `row` makes bytes of each row of `x`; the border is `zero`.
    fn write(&self, image: &mut [u8], zero: u8, x: &[f32], mut row: impl FnMut(&[f32], &mut [u8])) {
        let (side, len) = (
            self.shape.padding * self.shape.channels,
            self.shape.cols * self.shape.channels,
        );
        let mut rows = x.chunks_exact(len.max(1));
        let image = image.get_mut(..self.image_len()).unwrap_or_default();
        for (at, to) in image.chunks_mut(self.row_len().max(1)).enumerate() {
            let x = if at < self.shape.padding { None } else { rows.next() };
            match (x, to.split_at_mut_checked(side)) {
                (Some(x), Some((left, to))) => {
                    let (to, right) = to.split_at_mut(len.min(to.len()));
                    left.fill(zero);
                    right.fill(zero);
                    row(x, to);
                }
                _ => to.fill(zero),
            }
        }
    }

    /// `(x ∗ w + b) · unit` of an image whose bytes are `step` apart, with zero at `zero`; gives the largest, or zero if none is above.
    fn sums(
        &mut self,
        isa: Isa,
        image: &[u8],
        step: f32,
        zero: f32,
        unit: f32,
        y: &mut [f32],
    ) -> Result<f32, ShapeError> {
        for (meaning, filters) in self.meaning.iter_mut().zip(&self.filters) {
            meaning.start = filters.total.map(|total| -total * zero as i32);
            meaning.scale = filters.step.map(|weight| weight * step * unit);
            meaning.bias = filters.bias.map(|bias| bias * unit);
        }
        let shape = &self.shape;
        let mut most = [0; BLOCK];
        for (oy, y) in y.chunks_exact_mut(shape.out_cols() * shape.filters).enumerate() {
            let product = DotProduct {
                rows: shape.out_cols(),
                blocks: self.meaning.len(),
                n_u: shape.kernel,
                n_k: layer_groups(shape),
                a_at: oy * shape.stride * self.row_len(),
                a_row: shape.stride * shape.channels,
                a_u: self.row_len(),
            };
            product.run(isa, image, &self.weights, &self.meaning, &mut most, y)?;
        }
        let most = most.iter().fold(0, |most, bits| most.max(*bits));
        Ok(f32::from_bits(most as u32))
    }
}

/// Groups of neighbours in a kernel row.
fn layer_groups(shape: &Conv2d) -> usize {
    (shape.kernel * shape.channels).div_ceil(DEPTH)
}

/// The nearest byte of a number from −0.5 to 255.5.
#[inline(always)]
fn byte(x: f32) -> u8 {
    ((x + ROUND).to_bits() & 255) as u8
}

/// A row of the image.
struct Input<'a> {
    gain: Option<f32>,
    x: &'a [f32],
    to: &'a mut [u8],
    /// Becomes 1 where a value is not a number.
    unknown: &'a mut u32,
}

impl Input<'_> {
    #[inline(always)]
    fn each(self, f: impl Fn(f32) -> f32) {
        let mut unknown = 0;
        for (to, x) in self.to.iter_mut().zip(self.x) {
            let y = f(*x);
            unknown |= u32::from(y.is_nan());
            let y = if y > 1.0 { 1.0 } else { y };
            let y = if y > 0.0 { y } else { 0.0 };
            *to = byte(255.0 * y);
        }
        *self.unknown |= unknown;
    }
}

impl Task for Input<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        match self.gain {
            Some(gain) => self.each(|x| 1.0 / (1.0 + gain * x)),
            None => self.each(|x| x),
        }
    }
}

/// ELU of a row, from units of ln 2 to bytes.
struct Elu<'a> {
    x: &'a [f32],
    to: &'a mut [u8],
    step: f32,
    zero: f32,
}

impl Task for Elu<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let per_one = 1.0 / self.step;
        let (above, below) = (LN_2 * per_one, self.zero - per_one);
        // 2^f on ±½ to 1.8e-3 of it: less than half of the shortest step.
        let [c0, c1, c2] = [1.000_443_1, 0.703_448, 0.238_428_94].map(|c| c * per_one);
        for (to, x) in self.to.iter_mut().zip(self.x) {
            let positive = x * above + self.zero;
            // Below this 2^x is less than half of any step.
            let t = if *x < -24.0 { -24.0 } else { *x };
            let rounded = t + ROUND;
            let f = t - (rounded - ROUND);
            let p = (c2 * f + c1) * f + c0;
            // Times a power of two: added to the exponent.
            let power = f32::from_bits(p.to_bits().wrapping_add(rounded.to_bits() << 23));
            let negative = power + below;
            *to = byte(if *x > 0.0 { positive } else { negative });
        }
    }
}
