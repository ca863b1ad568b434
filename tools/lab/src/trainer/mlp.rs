//! Multilayer perceptrons over whole batches: dense layers, each hidden one followed by layer normalisation, where it is wanted, and ELU.

use rand::{Rng, RngExt};
use vigil_nnet::{Activation, Aligned, Dense, Isa, LayerNorm, ShapeError};
use vigil_policy::actor::ActorSpec;

/// Draws first weights, evenly up to `limit`.
pub fn draw(weights: &mut [f32], limit: f32, rng: &mut impl Rng) {
    weights.fill_with(|| rng.random_range(-limit..limit));
}

/// A hidden layer, where its parameters lie (dense, then norm), and what a forward pass keeps of it for a backward pass.
struct Hidden {
    at: usize,
    dense: Dense,
    norm: Option<LayerNorm>,
    normal: Aligned,
    inverse: Vec<f32>,
    y: Aligned,
}

/// A network with its buffers, for up to as many rows as it was made for; parameters belong to the caller.
pub struct Mlp {
    hidden: Vec<Hidden>,
    last: Dense,
    last_at: usize,
    pre: Aligned,
    d: [Aligned; 2],
    /// The weights in the order that the inputs' gradients read.
    packed: Vec<f32>,
    /// The outputs of the last forward pass, `[rows][outputs]`.
    pub out: Vec<f32>,
    rows: usize,
}

impl Mlp {
    /// For up to `rows`: layers of these widths, the inputs' first, the outputs' last; hidden ones normalised or not.
    pub fn new(rows: usize, inputs: usize, hidden: &[usize], outputs: usize, is_normal: bool) -> Self {
        let (mut layers, mut at, mut width, mut widest) = (Vec::new(), 0, inputs, inputs.max(outputs));
        for &units in hidden {
            let dense = Dense::new(width, units);
            let norm = is_normal.then(|| ActorSpec::norm(dense));
            layers.push(Hidden {
                at,
                dense,
                norm,
                normal: Aligned::zeros(rows * units),
                inverse: vec![0.0; rows],
                y: Aligned::zeros(rows * units),
            });
            at += dense.param_len() + norm.map_or(0, |norm| norm.param_len());
            (width, widest) = (units, widest.max(units));
        }
        let last = Dense::new(width, outputs);
        Self {
            hidden: layers,
            last,
            last_at: at,
            pre: Aligned::zeros(rows * widest),
            d: [0, 1].map(|_| Aligned::zeros(rows * widest)),
            packed: vec![0.0; at + last.param_len()],
            out: Vec::new(),
            rows: 0,
        }
    }

    pub fn param_len(&self) -> usize {
        self.packed.len()
    }

    /// First weights: uniform with the variance kept, the last layer within `last_limit`, biases 0, norms the identity.
    pub fn initial(&self, rng: &mut impl Rng, last_limit: f32) -> Vec<f32> {
        let mut params = vec![0.0; self.param_len()];
        for layer in &self.hidden {
            let limit = (3.0 / layer.dense.inputs as f32).sqrt();
            draw(&mut params[layer.at..][..layer.dense.weight_len()], limit, rng);
            let scales = layer.norm.map_or(0, |norm| norm.width);
            params[layer.at + layer.dense.param_len()..][..scales].fill(1.0);
        }
        draw(&mut params[self.last_at..][..self.last.weight_len()], last_limit, rng);
        params
    }

    /// Evaluates `x` `[rows][inputs]`.
    ///
    /// # Errors
    /// Parameters or inputs that do not fit.
    pub fn forward(&mut self, isa: Isa, params: &[f32], x: &[f32]) -> Result<(), ShapeError> {
        let curve = Activation::Identity;
        let rows = x.len() / self.hidden.first().map_or(self.last.inputs, |h| h.dense.inputs);
        self.rows = rows;
        for i in 0..self.hidden.len() {
            let (before, rest) = self.hidden.split_at_mut(i);
            let layer = &mut rest[0];
            let input = before.last().map_or(x, |h| &h.y[..rows * layer.dense.inputs]);
            let len = rows * layer.dense.outputs;
            let (own, rest) = params[layer.at..].split_at(layer.dense.param_len());
            let (pre, y) = (&mut self.pre[..len], &mut layer.y[..len]);
            match layer.norm {
                Some(norm) => {
                    let (normal, inverse) = (&mut layer.normal[..len], &mut layer.inverse[..rows]);
                    layer.dense.forward(isa, own, curve, input, None, pre)?;
                    norm.forward(isa, &rest[..norm.param_len()], pre, normal, inverse, y)?;
                }
                None => layer.dense.forward(isa, own, curve, input, None, y)?,
            }
            Activation::Elu.apply_in_place(isa, y);
        }
        let input = self.hidden.last().map_or(x, |h| &h.y[..rows * self.last.inputs]);
        self.out.resize(rows * self.last.outputs, 0.0);
        let params = &params[self.last_at..];
        self.last.forward(isa, params, curve, input, None, &mut self.out)
    }

    /// Backward from `d_out`, the gradient at the outputs of the last forward pass, which was over `x`: adds the parameters' gradient to
    /// `d_params` and writes the inputs' to `d_x`, each if it is given.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn backward(
        &mut self,
        isa: Isa,
        params: &[f32],
        x: &[f32],
        d_out: &[f32],
        mut d_params: Option<&mut [f32]>,
        d_x: Option<&mut [f32]>,
    ) -> Result<(), ShapeError> {
        let (rows, at) = (self.rows, self.last_at);
        let input = self.hidden.last().map_or(x, |h| &h.y[..rows * self.last.inputs]);
        if let Some(d_params) = d_params.as_deref_mut() {
            self.last.weight_gradient(isa, input, d_out, &mut d_params[at..])?;
        }
        let [d, below] = &mut self.d;
        let (mut d, mut below) = (d, below);
        let (packed, d_input) = (&mut self.packed[at..], &mut d[..rows * self.last.inputs]);
        self.last.pack(&params[at..], packed)?;
        self.last.input_gradient(isa, packed, d_out, d_input)?;
        for (i, layer) in self.hidden.iter().enumerate().rev() {
            let (dense, len) = (layer.dense, rows * layer.dense.outputs);
            let own = layer.at..layer.at + dense.param_len();
            Activation::Elu.gradient(isa, &layer.y[..len], &mut d[..len])?;
            if let Some(norm) = layer.norm {
                let of_norm = own.end..own.end + norm.param_len();
                let d_norm = d_params.as_deref_mut().map(|p| &mut p[of_norm.clone()]);
                let (normal, inverse) = (&layer.normal[..len], &layer.inverse[..rows]);
                norm.backward(isa, &params[of_norm], normal, inverse, &mut d[..len], d_norm)?;
            }
            let before = self.hidden[..i].last();
            let input = before.map_or(x, |h| &h.y[..rows * dense.inputs]);
            if let Some(d_params) = d_params.as_deref_mut() {
                dense.weight_gradient(isa, input, &d[..len], &mut d_params[own.clone()])?;
            }
            if i > 0 || d_x.is_some() {
                let packed = &mut self.packed[own.clone()];
                dense.pack(&params[own], packed)?;
                dense.input_gradient(isa, packed, &d[..len], &mut below[..rows * dense.inputs])?;
                core::mem::swap(&mut d, &mut below);
            }
        }
        if let Some(d_x) = d_x {
            d_x.copy_from_slice(&d[..d_x.len()]);
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

    fn loss(mlp: &mut Mlp, params: &[f32], x: &[f32], toward: &[f32]) -> f64 {
        mlp.forward(Isa::PORTABLE, params, x).unwrap();
        mlp.out.iter().zip(toward).map(|(y, t)| f64::from(y * t)).sum()
    }

    /// Every input's gradient against a central difference of the whole network; those of parameters are compared with the graph's
    /// in `actor_net`.
    #[test]
    fn gradients_agree_with_finite_differences() {
        const STEP: f32 = 1e-2;
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut draw = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.random_range(-1.0..1.0)).collect() };
        for (isa, is_normal) in [(Isa::PORTABLE, true), (Isa::detect(), true), (Isa::detect(), false)] {
            let mut mlp = Mlp::new(ROWS + 3, INPUTS, &[6, 5], 2, is_normal);
            let (x, toward, params) = (draw(ROWS * INPUTS), draw(ROWS * 2), draw(mlp.param_len()));
            let mut d_x = vec![0.0; x.len()];
            mlp.forward(isa, &params, &x).unwrap();
            mlp.backward(isa, &params, &x, &toward, None, Some(&mut d_x)).unwrap();
            for (i, d) in d_x.iter().enumerate() {
                let mut at = |step: f32| {
                    let mut moved = x.clone();
                    moved[i] += step;
                    loss(&mut mlp, &params, &moved, &toward)
                };
                let expected = (at(STEP) - at(-STEP)) / f64::from(2.0 * STEP);
                assert!((f64::from(*d) - expected).abs() < 2e-2, "input {i}: {d}, {expected}");
            }
        }
    }
}
