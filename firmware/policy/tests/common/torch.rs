//! Reference tensors in PyTorch's order, and their reordering into this project's.
#![allow(dead_code, reason = "each test binary uses its own part")]

use flate2::read::GzDecoder;
use safetensors::{Dtype, SafeTensors};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use vigil_nnet::{Activation, Conv2d, Dense, Graph, GraphBuilder, Gru, NodeId, Params, Purpose};

/// The network of the reference vectors, the paper's as we read it: five frames of 128 × 256, each through convolutions of 5×5 (16) and four
/// of 3×3 (32), stride 2, ELU; GRU of 48; `tanh` of its state beside two positional values (6, tanh); 32, ELU; 1.5 · tanh of two outputs.
pub struct Reference {
    builder: GraphBuilder,
    convolutions: Vec<(Conv2d, Params)>,
    gru: (Gru, Params),
    dense: [(Dense, Params); 3],
}

impl Reference {
    pub fn new() -> Self {
        let mut b = GraphBuilder::new();
        let (mut rows, mut cols, mut channels) = (128_usize, 256_usize, 1);
        let mut convolutions = Vec::new();
        for (kernel, filters) in [(5, 16), (3, 32), (3, 32), (3, 32), (3, 32)] {
            let layer = Conv2d::new([rows, cols, channels], filters, kernel, 2, kernel / 2);
            convolutions.push((layer, b.params(layer.param_len())));
            (rows, cols, channels) = (rows.div_ceil(2), cols.div_ceil(2), filters);
        }
        let gru = Gru {
            inputs: rows * cols * channels,
            hidden: 48,
        };
        let gru = (gru, b.params(gru.param_len()));
        let dense = [(2, 6), (54, 32), (32, 2)].map(|(inputs, outputs)| {
            let layer = Dense { inputs, outputs };
            (layer, b.params(layer.param_len()))
        });
        Self {
            builder: b,
            convolutions,
            gru,
            dense,
        }
    }

    fn head(&mut self, state: NodeId, low_dim: NodeId) -> NodeId {
        let b = &mut self.builder;
        let [(first, p), (dense, d), (output, o)] = self.dense;
        let state = b.activation(state, Activation::TANH).unwrap();
        let low_dim = b.dense(low_dim, first, Activation::TANH, p).unwrap();
        let joined = b.concat(&[state, low_dim]).unwrap();
        let hidden = b.dense(joined, dense, Activation::Elu, d).unwrap();
        b.dense(hidden, output, Activation::Tanh { scale: 1.5 }, o).unwrap()
    }

    /// What comes behind five frames' features.
    fn finish(mut self, features: Vec<NodeId>, explained: bool, purpose: Purpose) -> Graph {
        let low_dim = self.builder.input(2, explained).unwrap();
        let mut state = self.builder.zeros(48).unwrap();
        for x in features {
            state = self.builder.gru(x, state, self.gru.0, self.gru.1).unwrap();
        }
        let output = self.head(state, low_dim);
        self.builder.finish(output, purpose).unwrap()
    }

    /// Inputs are the GRU's state and the positional values.
    pub fn head_graph(mut self, purpose: Purpose) -> Graph {
        let state = self.builder.input(48, true).unwrap();
        let low_dim = self.builder.input(2, true).unwrap();
        let output = self.head(state, low_dim);
        self.builder.finish(output, purpose).unwrap()
    }

    /// Inputs are five frames' features, oldest first, and the positional values.
    pub fn features_graph(mut self, purpose: Purpose) -> Graph {
        let features = (0..5).map(|_| self.builder.input(self.gru.0.inputs, true).unwrap());
        let features = features.collect();
        self.finish(features, true, purpose)
    }

    /// Inputs are five frames, oldest first, and the positional values.
    pub fn graph(mut self, purpose: Purpose, explained: bool) -> Graph {
        let features = (0..5).map(|_| {
            let mut x = self.builder.input(128 * 256, explained).unwrap();
            for (layer, params) in self.convolutions.clone() {
                x = self.builder.conv2d(x, layer, Activation::Elu, params).unwrap();
            }
            x
        });
        let features = features.collect();
        self.finish(features, explained, purpose)
    }
}

/// One file of reference tensors.
pub struct Tensors(Vec<u8>);

impl Tensors {
    pub fn load(name: &str) -> Self {
        let own = Path::new(env!("CARGO_MANIFEST_DIR"));
        let data = [own.join("tests/data"), own.join("../firmware/policy/tests/data")];
        let file = data
            .iter()
            .map(|dir| dir.join(format!("{name}.safetensors.gz")))
            .find(|f| f.exists());
        let file = File::open(file.expect("reference vectors of the policy crate")).unwrap();
        let mut bytes = Vec::new();
        GzDecoder::new(file).read_to_end(&mut bytes).unwrap();
        Self(bytes)
    }

    pub fn get(&self, name: &str) -> Vec<f32> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = file.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        let pairs = || tensor.data().as_chunks::<2>().0.iter().copied();
        match tensor.dtype() {
            Dtype::F32 => (tensor.data().as_chunks().0.iter().copied())
                .map(f32::from_le_bytes)
                .collect(),
            Dtype::U16 => pairs().map(|b| f32::from(u16::from_le_bytes(b)) / 65535.0).collect(),
            Dtype::I16 => pairs().map(|b| f32::from(i16::from_le_bytes(b)) * 1e-6).collect(),
            other => panic!("{name} is {other:?}"),
        }
    }

    pub fn shape(&self, name: &str) -> Vec<usize> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        file.tensor(name).unwrap().shape().to_vec()
    }

    /// A `Linear`'s weights and bias as `[inputs][outputs]`, bias.
    pub fn dense(&self, name: &str) -> Vec<f32> {
        let weight = format!("{name}_weight");
        let weights = transposed(&self.get(&weight), self.shape(&weight)[0]);
        [weights, self.get(&format!("{name}_bias"))].concat()
    }

    /// A `Conv2d`'s weights and bias as `[row][column][input][output]`, bias.
    fn conv2d(&self, name: &str) -> Vec<f32> {
        let weight = format!("{name}_weight");
        let (w, shape) = (self.get(&weight), self.shape(&weight));
        let (inputs, taps) = (shape[1], shape[2] * shape[3]);
        let mut out = Vec::new();
        for tap in 0..taps {
            for i in 0..inputs {
                for o in 0..shape[0] {
                    out.push(w[(o * inputs + i) * taps + tap]);
                }
            }
        }
        [out, self.get(&format!("{name}_bias"))].concat()
    }
}

/// `[rows][n]` to `[n][rows]`.
pub fn transposed(w: &[f32], rows: usize) -> Vec<f32> {
    let n = w.len() / rows;
    (0..w.len()).map(|i| w[i % rows * n + i / rows]).collect()
}

/// Features of one frame from `[channel][pixel]` to `[pixel][channel]`.
pub fn features(torch: &[f32]) -> Vec<f32> {
    transposed(torch, 32)
}

/// All parameters of the reference network in its order.
pub fn actor_params() -> Vec<f32> {
    let t = Tensors::load("actor_weights");
    let mut all: Vec<f32> = [0, 2, 4, 6, 8]
        .iter()
        .flat_map(|i| t.conv2d(&format!("first_enc_{i}")))
        .collect();
    // Each of the 144 rows holds 1024 features in channel-first order.
    let input: Vec<f32> = t
        .get("first_rnn_weight_ih_l0")
        .chunks_exact(1024)
        .flat_map(features)
        .collect();
    all.extend(transposed(&input, 144));
    all.extend(transposed(&t.get("first_rnn_weight_hh_l0"), 144));
    all.extend(t.get("first_rnn_bias_ih_l0"));
    all.extend(t.get("first_rnn_bias_hh_l0"));
    for layer in ["second_dp", "second_d1", "second_d2"] {
        all.extend(t.dense(layer));
    }
    all
}
