//! Reference tensors in PyTorch's order, and their reordering into this project's.

use flate2::read::GzDecoder;
use safetensors::{Dtype, SafeTensors};
use std::fs::File;
use std::io::Read;
use vigil_nnet::{Activation, Conv2d, Dense, Graph, GraphBuilder, Gru, Purpose};

/// What the reference network is given beside the two positional values.
#[derive(Clone, Copy)]
pub enum Given {
    /// The GRU's state.
    State,
    /// Five frames' features, oldest first.
    Features,
    /// Five frames, oldest first, explained or not.
    Frames(bool),
}

/// The network of the reference vectors, the paper's as we read it: five frames of 128 × 256, each through convolutions of 5×5 (16) and four
/// of 3×3 (32), stride 2, ELU; GRU of 48; `tanh` of its state beside two positional values (6, tanh); 32, ELU; 1.5 · tanh of two outputs.
pub fn reference(given: Given, purpose: Purpose) -> Graph {
    let mut b = GraphBuilder::new();
    let mut image = [128, 256, 1];
    let convolutions = [(5, 16), (3, 32), (3, 32), (3, 32), (3, 32)].map(|(kernel, filters)| {
        let layer = Conv2d::new(image, filters, kernel, 2, kernel / 2);
        image = [layer.out_rows(), layer.out_cols(), filters];
        (layer, b.params(layer.param_len()))
    });
    let (inputs, hidden) = (image.iter().product(), 48);
    let gru = Gru { inputs, hidden };
    let of_gru = b.params(gru.param_len());
    let dense = [(2, 6), (54, 32), (32, 2)].map(|(inputs, outputs)| {
        let layer = Dense { inputs, outputs };
        (layer, b.params(layer.param_len()))
    });
    let frame = |b: &mut GraphBuilder| match given {
        Given::State => None,
        Given::Features => b.input(inputs, true).ok(),
        Given::Frames(explained) => {
            let x = b.input(128 * 256, explained).unwrap();
            let conv2d = |x, (layer, params)| b.conv2d(x, layer, Activation::Elu, params).unwrap();
            Some(convolutions.into_iter().fold(x, conv2d))
        }
    };
    let features: Vec<_> = (0..5).filter_map(|_| frame(&mut b)).collect();
    let mut state = match given {
        Given::State => b.input(hidden, true).unwrap(),
        _ => b.zeros(hidden).unwrap(),
    };
    let low_dim = b.input(2, !matches!(given, Given::Frames(false))).unwrap();
    for x in features {
        state = b.gru(x, state, gru, of_gru).unwrap();
    }
    let [(first, p), (second, d), (output, o)] = dense;
    let state = b.activation(state, Activation::TANH).unwrap();
    let low_dim = b.dense(low_dim, first, Activation::TANH, p).unwrap();
    let joined = b.concat(&[state, low_dim]).unwrap();
    let joined = b.dense(joined, second, Activation::Elu, d).unwrap();
    let acted = b.dense(joined, output, Activation::Tanh { scale: 1.5 }, o).unwrap();
    b.finish(acted, purpose).unwrap()
}

/// One file of reference tensors.
pub struct Tensors(Vec<u8>);

impl Tensors {
    pub fn load(name: &str) -> Self {
        let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware/policy/tests/data");
        let file = File::open(format!("{data}/{name}.safetensors.gz")).unwrap();
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

    fn shape(&self, name: &str) -> Vec<usize> {
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
