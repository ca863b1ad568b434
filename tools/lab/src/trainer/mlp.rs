//! Multilayer perceptrons over whole batches: dense layers, each hidden one followed by layer normalisation and ELU.

use rand::{Rng, RngExt};
use vigil_nnet::{Activation, Aligned, Dense, Isa, LayerNorm, ShapeError};

const EPSILON: f32 = 1e-5;

/// Draws first weights, evenly up to `limit`.
pub fn draw(weights: &mut [f32], limit: f32, rng: &mut impl Rng) {
    weights.fill_with(|| rng.random_range(-limit..limit));
}

/// A hidden layer and where its parameters lie: dense, then norm.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Hidden {
    at: usize,
    dense: Dense,
    norm: LayerNorm,
}

/// A description; parameters and buffers belong to the caller.
#[derive(Debug, Clone, PartialEq)]
pub struct Mlp {
    hidden: Vec<Hidden>,
    out: Dense,
    out_at: usize,
}

/// What a forward pass keeps of each layer for a backward pass, for up to as many rows as it was made for.
pub struct MlpTape {
    /// Of each hidden layer: normal values, deviations, outputs.
    layers: Vec<(Aligned, Vec<f32>, Aligned)>,
    pre: Aligned,
    d: [Aligned; 2],
    /// The weights in the order that the inputs' gradients read.
    packed: Vec<f32>,
    /// The outputs of the last forward pass, `[rows][outputs]`.
    pub out: Vec<f32>,
    rows: usize,
}

impl Mlp {
    /// Layers of these widths, the inputs' first, the outputs' last.
    pub fn new(inputs: usize, hidden: &[usize], outputs: usize) -> Self {
        let (mut layers, mut at, mut width) = (Vec::new(), 0, inputs);
        for &units in hidden {
            let layer = Hidden {
                at,
                dense: Dense::new(width, units),
                norm: LayerNorm {
                    width: units,
                    epsilon: EPSILON,
                },
            };
            at += layer.dense.param_len() + layer.norm.param_len();
            layers.push(layer);
            width = units;
        }
        Self {
            hidden: layers,
            out: Dense { inputs: width, outputs },
            out_at: at,
        }
    }

    pub fn param_len(&self) -> usize {
        self.out_at + self.out.param_len()
    }

    /// Length of an input row.
    pub fn inputs(&self) -> usize {
        self.hidden.first().map_or(self.out.inputs, |h| h.dense.inputs)
    }

    /// First weights: uniform with the variance kept, the last layer within `last_limit`, biases 0, norms the identity.
    pub fn initial(&self, rng: &mut impl Rng, last_limit: f32) -> Vec<f32> {
        let mut params = vec![0.0; self.param_len()];
        for layer in &self.hidden {
            let limit = (3.0 / layer.dense.inputs as f32).sqrt();
            draw(&mut params[layer.at..][..layer.dense.weight_len()], limit, rng);
            params[layer.at + layer.dense.param_len()..][..layer.norm.width].fill(1.0);
        }
        draw(&mut params[self.out_at..][..self.out.weight_len()], last_limit, rng);
        params
    }

    /// Buffers for up to so many rows.
    pub fn tape(&self, rows: usize) -> MlpTape {
        let widest = self.hidden.iter().map(|h| h.dense.outputs).chain([self.inputs()]).max();
        let wide = rows * widest.unwrap_or(0).max(self.out.outputs);
        MlpTape {
            layers: self
                .hidden
                .iter()
                .map(|h| {
                    let len = rows * h.dense.outputs;
                    (Aligned::zeros(len), vec![0.0; rows], Aligned::zeros(len))
                })
                .collect(),
            pre: Aligned::zeros(wide),
            d: [Aligned::zeros(wide), Aligned::zeros(wide)],
            packed: vec![0.0; self.param_len()],
            out: Vec::new(),
            rows: 0,
        }
    }

    /// Evaluates `x` `[rows][inputs]`; the outputs are in the tape.
    ///
    /// # Errors
    /// Parameters or inputs that do not fit.
    pub fn forward(&self, isa: Isa, params: &[f32], x: &[f32], tape: &mut MlpTape) -> Result<(), ShapeError> {
        let rows = x.len() / self.inputs();
        tape.rows = rows;
        for (i, layer) in self.hidden.iter().enumerate() {
            let (before, rest) = tape.layers.split_at_mut(i);
            let input = before.last().map_or(x, |(_, _, y)| &y[..rows * layer.dense.inputs]);
            let (normal, inverse, y) = &mut rest[0];
            let len = rows * layer.dense.outputs;
            let pre = &mut tape.pre[..len];
            let norm = layer.at + layer.dense.param_len();
            layer
                .dense
                .forward(isa, &params[layer.at..norm], Activation::Identity, input, None, pre)?;
            let norm_params = &params[norm..norm + layer.norm.param_len()];
            let (normal, inverse, y) = (&mut normal[..len], &mut inverse[..rows], &mut y[..len]);
            layer.norm.forward(isa, norm_params, pre, normal, inverse, y)?;
            Activation::Elu.apply_in_place(isa, y);
        }
        let input = tape.layers.last().map_or(x, |(_, _, y)| &y[..rows * self.out.inputs]);
        tape.out.resize(rows * self.out.outputs, 0.0);
        let params = &params[self.out_at..];
        self.out
            .forward(isa, params, Activation::Identity, input, None, &mut tape.out)
    }

    /// Backward from `d_out`, the gradient at the outputs of the tape's forward pass over `x`: adds the parameters' gradient to
    /// `d_params` and writes the inputs' to `d_x`, each if it is given.
    ///
    /// # Errors
    /// Slices that do not fit.
    #[expect(clippy::too_many_arguments, reason = "caller-owned buffers, each with its own role")]
    pub fn backward(
        &self,
        isa: Isa,
        params: &[f32],
        x: &[f32],
        tape: &mut MlpTape,
        d_out: &[f32],
        mut d_params: Option<&mut [f32]>,
        d_x: Option<&mut [f32]>,
    ) -> Result<(), ShapeError> {
        let rows = tape.rows;
        let input = tape.layers.last().map_or(x, |(_, _, y)| &y[..rows * self.out.inputs]);
        if let Some(d_params) = d_params.as_deref_mut() {
            self.out
                .weight_gradient(isa, input, d_out, &mut d_params[self.out_at..])?;
        }
        let [d, below] = &mut tape.d;
        let (mut d, mut below) = (d, below);
        let packed = &mut tape.packed[self.out_at..];
        self.out.pack(&params[self.out_at..], packed)?;
        self.out
            .input_gradient(isa, packed, d_out, &mut d[..rows * self.out.inputs])?;
        for (i, layer) in self.hidden.iter().enumerate().rev() {
            let (normal, inverse, y) = &tape.layers[i];
            let (dense, len) = (layer.dense, rows * layer.dense.outputs);
            let norm = layer.at + layer.dense.param_len();
            let norm_range = norm..norm + layer.norm.param_len();
            let (normal, inverse, y) = (&normal[..len], &inverse[..rows], &y[..len]);
            Activation::Elu.gradient(isa, y, &mut d[..len])?;
            let d_norm = d_params.as_deref_mut().map(|p| &mut p[norm_range.clone()]);
            let norm_params = &params[norm_range.clone()];
            layer
                .norm
                .backward(isa, norm_params, normal, inverse, &mut d[..len], d_norm)?;
            let before = tape.layers[..i].last();
            let input = before.map_or(x, |(_, _, y)| &y[..rows * layer.dense.inputs]);
            if let Some(d_params) = d_params.as_deref_mut() {
                dense.weight_gradient(isa, input, &d[..len], &mut d_params[layer.at..norm])?;
            }
            if i > 0 || d_x.is_some() {
                let (inputs, packed) = (rows * dense.inputs, &mut tape.packed[layer.at..norm]);
                dense.pack(&params[layer.at..norm], packed)?;
                dense.input_gradient(isa, packed, &d[..len], &mut below[..inputs])?;
                core::mem::swap(&mut d, &mut below);
            }
        }
        if let Some(d_x) = d_x {
            d_x.copy_from_slice(&d[..rows * self.inputs()]);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    const ROWS: usize = 5;
    const INPUTS: usize = 7;

    fn loss(mlp: &Mlp, params: &[f32], x: &[f32], toward: &[f32]) -> f64 {
        let mut tape = mlp.tape(ROWS);
        mlp.forward(Isa::PORTABLE, params, x, &mut tape).unwrap();
        tape.out.iter().zip(toward).map(|(y, t)| f64::from(y * t)).sum()
    }

    /// Every parameter's and every input's gradient against a central difference of the whole network.
    #[test]
    fn gradients_agree_with_finite_differences() {
        let mlp = Mlp::new(INPUTS, &[6, 5], 2);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut draw = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.random_range(-1.0..1.0)).collect() };
        let (x, toward, params) = (draw(ROWS * INPUTS), draw(ROWS * 2), draw(mlp.param_len()));
        for isa in [Isa::PORTABLE, Isa::detect()] {
            let mut tape = mlp.tape(ROWS + 3);
            mlp.forward(isa, &params, &x, &mut tape).unwrap();
            let (mut d_params, mut d_x) = (vec![0.0; params.len()], vec![0.0; x.len()]);
            let (to_params, to_x) = (Some(&mut d_params[..]), Some(&mut d_x[..]));
            mlp.backward(isa, &params, &x, &mut tape, &toward, to_params, to_x)
                .unwrap();
            const STEP: f32 = 1e-2;
            let slope = |values: &[f32], i: usize, f: &dyn Fn(&[f32]) -> f64| {
                let mut moved = values.to_vec();
                moved[i] = values[i] + STEP;
                let high = f(&moved);
                moved[i] = values[i] - STEP;
                (high - f(&moved)) / f64::from(2.0 * STEP)
            };
            for (i, d) in d_params.iter().enumerate() {
                let expected = slope(&params, i, &|p| loss(&mlp, p, &x, &toward));
                assert!(
                    (f64::from(*d) - expected).abs() < 2e-2,
                    "parameter {i}: {d}, {expected}"
                );
            }
            for (i, d) in d_x.iter().enumerate() {
                let expected = slope(&x, i, &|x| loss(&mlp, &params, x, &toward));
                assert!((f64::from(*d) - expected).abs() < 2e-2, "input {i}: {d}, {expected}");
            }
        }
    }
}
