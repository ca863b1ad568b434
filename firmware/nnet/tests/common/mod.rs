//! What the tests share: a plain float64 implementation of every layer, a small network, and seeded values.
#![allow(dead_code, reason = "each test binary uses its own part")]

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_nnet::{
    Activation, BatchNorm, Conv2d, Dense, Graph, GraphBuilder, Gru, Isa, LayerNorm, Lstm, MaxPool2d, Purpose,
};

pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

pub fn uniform(rng: &mut impl Rng, len: usize, limit: f32) -> Vec<f32> {
    (0..len).map(|_| rng.random_range(-limit..limit)).collect()
}

/// A small network of most layers: two images of 32 × 64, each through two convolutions, into a GRU of 8, then dense layers
/// beside two more values. The first convolution has 16 filters of 5 × 5.
pub fn small_network(purpose: Purpose, explained: bool) -> Graph {
    let first = Conv2d::new([32, 64, 1], 16, 5, 2, 2);
    let second = Conv2d::new([16, 32, 16], 4, 3, 2, 1);
    let gru = Gru {
        inputs: second.output_len(),
        hidden: 8,
    };
    let (dense, output) = (Dense::new(10, 16), Dense { inputs: 16, outputs: 2 });
    let mut b = GraphBuilder::new();
    let params = [
        first.param_len(),
        second.param_len(),
        gru.param_len(),
        dense.param_len(),
        output.param_len(),
    ]
    .map(|len| b.params(len));
    let mut state = b.zeros(gru.hidden).unwrap();
    for _ in 0..2 {
        let image = b.input(first.input_len(), explained).unwrap();
        let image = b.activation(image, Activation::NEAR_CONTRAST).unwrap();
        let x = b.conv2d(image, first, Activation::Elu, params[0]).unwrap();
        let x = b.conv2d(x, second, Activation::Elu, params[1]).unwrap();
        state = b.gru(x, state, gru, params[2]).unwrap();
    }
    let state = b.activation(state, Activation::TANH).unwrap();
    let beside = b.input(2, explained).unwrap();
    let x = b.concat(&[state, beside]).unwrap();
    let x = b.dense(x, dense, Activation::Elu, params[3]).unwrap();
    let x = b.dense(x, output, Activation::Tanh { scale: 1.5 }, params[4]).unwrap();
    b.finish(x, purpose).unwrap()
}

/// A network with its parameters, on an instruction set.
pub struct Evaluated<'a> {
    pub graph: Graph,
    isa: Isa,
    params: &'a [f32],
    packed: Vec<f32>,
}

impl<'a> Evaluated<'a> {
    pub fn new(graph: Graph, isa: Isa, params: &'a [f32]) -> Self {
        let mut packed = vec![f32::NAN; graph.param_len()];
        graph.pack(params, &mut packed).unwrap();
        Self {
            graph,
            isa,
            params,
            packed,
        }
    }

    /// The tape of an evaluation.
    pub fn tape(&self, inputs: &[Vec<f32>]) -> Vec<f32> {
        let mut tape = vec![f32::NAN; self.graph.tape_len()];
        let inputs: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
        self.graph.forward(self.isa, self.params, &inputs, &mut tape).unwrap();
        tape
    }

    pub fn output(&self, tape: &[f32]) -> Vec<f32> {
        self.graph.output(tape).unwrap().to_vec()
    }

    /// Gradients of `Σ d · output` at each input, and at the parameters, where they are added to `there`.
    pub fn gradients(&self, tape: &[f32], d: &[f32], there: f32) -> (Vec<Vec<f32>>, Vec<f32>) {
        let mut work = vec![f32::NAN; self.graph.work_len()];
        let mut d_params = vec![there; self.params.len()];
        let slot = Some(&mut *d_params);
        (self.graph)
            .backward(self.isa, &self.packed, tape, d, slot, &mut work)
            .unwrap();
        d_params.iter_mut().for_each(|d| *d -= there);
        (self.of_inputs(&work), d_params)
    }

    /// Multipliers of each input.
    pub fn multipliers(&self, tape: &[f32], reference: &[f32], m: &[f32]) -> Vec<Vec<f32>> {
        let mut work = vec![f32::NAN; self.graph.work_len()];
        (self.graph)
            .multipliers(self.isa, &self.packed, tape, reference, m, &mut work)
            .unwrap();
        self.of_inputs(&work)
    }

    fn of_inputs(&self, work: &[f32]) -> Vec<Vec<f32>> {
        let of = |i| self.graph.input_gradient(work, i).unwrap().to_vec();
        (0..self.graph.input_count()).map(of).collect()
    }
}

pub fn wide(x: &[f32]) -> Vec<f64> {
    x.iter().map(|x| f64::from(*x)).collect()
}

/// Asserts that multipliers add up: Σ m · Δx is Σ m_output · Δy.
pub fn adds_up(name: &str, m: &[f32], [x, x_ref]: [&[f32]; 2], m_output: &[f32], [y, y_ref]: [&[f64]; 2]) {
    let sum = |m: &[f32], to: &[f64], from: &[f64]| -> f64 {
        let changes = to.iter().zip(from).map(|(to, from)| to - from);
        m.iter().zip(changes).map(|(m, change)| f64::from(*m) * change).sum()
    };
    let (left, right) = (sum(m, &wide(x), &wide(x_ref)), sum(m_output, y, y_ref));
    assert!(
        (left - right).abs() < 1e-5,
        "{name}: multipliers add up to {left}, not {right}"
    );
}

pub fn largest(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |m, x| m.max(x.abs()))
}

/// Largest absolute difference.
pub fn distance(a: &[f32], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |m, (a, b)| {
        let d = (f64::from(*a) - b).abs();
        if d > m || d.is_nan() { d } else { m }
    })
}

pub fn activation(act: Activation, x: &[f64]) -> Vec<f64> {
    let f = |x: f64| match act {
        Activation::Identity => x,
        Activation::Relu => x.max(0.0),
        Activation::Elu if x > 0.0 => x,
        Activation::Elu => x.exp_m1(),
        Activation::Tanh { scale } => f64::from(scale) * x.tanh(),
        Activation::Sigmoid => sigmoid(x),
        Activation::NearContrast { gain } => 1.0 / (1.0 + f64::from(gain) * x),
    };
    x.iter().map(|x| f(*x)).collect()
}

pub fn dense(d: Dense, act: Activation, p: &[f64], x: &[f64]) -> Vec<f64> {
    let (w, b) = p.split_at(d.inputs * d.outputs);
    let mut y = Vec::new();
    for row in x.chunks_exact(d.inputs) {
        for o in 0..d.outputs {
            y.push(b[o] + (0..d.inputs).map(|i| row[i] * w[i * d.outputs + o]).sum::<f64>());
        }
    }
    activation(act, &y)
}

pub fn conv2d(c: Conv2d, act: Activation, p: &[f64], x: &[f64]) -> Vec<f64> {
    let (w, b) = p.split_at(c.kernel * c.kernel * c.channels * c.filters);
    let mut y = Vec::new();
    for oy in 0..c.out_rows() {
        for ox in 0..c.out_cols() {
            for f in 0..c.filters {
                let mut sum = b[f];
                for ky in 0..c.kernel {
                    for kx in 0..c.kernel {
                        let (iy, ix) = (oy * c.stride + ky, ox * c.stride + kx);
                        if iy < c.padding || ix < c.padding || iy >= c.rows + c.padding || ix >= c.cols + c.padding {
                            continue;
                        }
                        let at = ((iy - c.padding) * c.cols + ix - c.padding) * c.channels;
                        for ch in 0..c.channels {
                            sum += x[at + ch] * w[((ky * c.kernel + kx) * c.channels + ch) * c.filters + f];
                        }
                    }
                }
                y.push(sum);
            }
        }
    }
    activation(act, &y)
}

pub fn max_pool(m: MaxPool2d, x: &[f64]) -> Vec<f64> {
    let [height, width] = m.window;
    let mut y = Vec::new();
    for oy in 0..(m.rows + 2 * m.padding - height) / m.stride + 1 {
        for ox in 0..(m.cols + 2 * m.padding - width) / m.stride + 1 {
            for ch in 0..m.channels {
                let pixels = (0..height * width).map(|t| {
                    let (iy, ix) = (oy * m.stride + t / width, ox * m.stride + t % width);
                    let inside =
                        (m.padding..m.padding + m.rows).contains(&iy) && (m.padding..m.padding + m.cols).contains(&ix);
                    match inside {
                        true => x[((iy - m.padding) * m.cols + ix - m.padding) * m.channels + ch],
                        false => f64::NEG_INFINITY,
                    }
                });
                y.push(pixels.fold(f64::NEG_INFINITY, f64::max));
            }
        }
    }
    y
}

pub fn batch_norm(b: BatchNorm, p: &[f64], x: &[f64]) -> Vec<f64> {
    let n = b.channels;
    let at = |i: usize, x: f64| p[i] * (x - p[2 * n + i]) / (p[3 * n + i] + f64::from(b.epsilon)).sqrt() + p[n + i];
    x.iter().enumerate().map(|(i, x)| at(i % n, *x)).collect()
}

pub fn layer_norm(l: LayerNorm, p: &[f64], x: &[f64]) -> Vec<f64> {
    let of_row = |x: &[f64]| -> Vec<f64> {
        let mean = x.iter().sum::<f64>() / l.width as f64;
        let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / l.width as f64;
        let root = (variance + f64::from(l.epsilon)).sqrt();
        let row = x.iter().zip(p.iter().zip(&p[l.width..]));
        row.map(|(x, (scale, shift))| scale * (x - mean) / root + shift)
            .collect()
    };
    x.chunks_exact(l.width).flat_map(of_row).collect()
}

/// `x M + b` with `M` row-major.
fn affine(x: &[f64], m: &[f64], b: &[f64]) -> Vec<f64> {
    let column = |o: usize| x.iter().enumerate().map(|(i, x)| x * m[i * b.len() + o]).sum::<f64>();
    (0..b.len()).map(|o| b[o] + column(o)).collect()
}

pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

pub fn gru(g: Gru, p: &[f64], x: &[f64], h: &[f64]) -> Vec<f64> {
    let n = g.hidden;
    let (w, rest) = p.split_at(g.inputs * 3 * n);
    let (u, rest) = rest.split_at(n * 3 * n);
    let (b, c) = rest.split_at(3 * n);
    let (a, s) = (affine(x, w, b), affine(h, u, c));
    (0..n)
        .map(|i| {
            let (r, z) = (sigmoid(a[i] + s[i]), sigmoid(a[n + i] + s[n + i]));
            let candidate = (a[2 * n + i] + r * s[2 * n + i]).tanh();
            (1.0 - z) * candidate + z * h[i]
        })
        .collect()
}

pub fn lstm(l: Lstm, p: &[f64], x: &[f64], state: &[f64]) -> Vec<f64> {
    let n = l.hidden;
    let (h, c) = state.split_at(n);
    let (w, rest) = p.split_at(l.inputs * 4 * n);
    let (u, b) = rest.split_at(n * 4 * n);
    let (a, s) = (affine(x, w, b), affine(h, u, &vec![0.0; 4 * n]));
    let gate = |k: usize, i: usize| a[k * n + i] + s[k * n + i];
    let curve = |x: f64| activation(l.cell, &[x])[0];
    let c_out: Vec<f64> = (0..n)
        .map(|i| sigmoid(gate(1, i)) * c[i] + sigmoid(gate(0, i)) * curve(gate(2, i)))
        .collect();
    let h_out = (0..n).map(|i| sigmoid(gate(3, i)) * curve(c_out[i]));
    h_out.chain(c_out.iter().copied()).collect()
}

/// Central differences of `Σ weights · f` over every element of `at`.
pub fn finite_differences(f: impl Fn(&[f64]) -> Vec<f64>, weights: &[f64], at: &[f64]) -> Vec<f64> {
    let value = |x: &[f64]| -> f64 { f(x).iter().zip(weights).map(|(y, w)| y * w).sum() };
    let mut x = at.to_vec();
    (0..x.len())
        .map(|i| {
            let keep = x[i];
            let h = 1e-5;
            x[i] = keep + h;
            let above = value(&x);
            x[i] = keep - h;
            let below = value(&x);
            x[i] = keep;
            (above - below) / (2.0 * h)
        })
        .collect()
}
