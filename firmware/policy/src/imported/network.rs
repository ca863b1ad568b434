//! A network as a list of layers: what a file holds of it, and the graph that it becomes.

use super::network_text::{name_of, name_of_function};
use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::fmt;
use vigil_nnet::{
    Activation, BatchNorm, Conv2d, Dense, Function, Graph, GraphBuilder, Gru, LayerNorm, Lstm, MaxPool2d, NodeId,
    Params, Purpose, ShapeError,
};

/// Multiply-adds of one decision, at most: some 20 ms of the step's 50 with the portable kernels, 3 ms with AVX-512; the
/// built-in actor has 12 million.
pub const MOST_MULTIPLY_ADDS: u64 = 250_000_000;
/// Values of all layers together, and parameters, at most: 128 MiB each.
pub const MOST_VALUES: u64 = 32 << 20;
/// Values of a split point, at least and at most: fewer explain nothing that the outputs do not, and each costs the step time.
pub const SPLIT_VALUES: core::ops::RangeInclusive<usize> = 8..=512;
/// No size in a description may be larger: products of four of them cannot overflow.
const MOST_SIZE: usize = 1 << 24;
pub(super) const MOST_LAYERS: usize = 4096;

/// A layer. `x`, `y`, `h`, `state` and `parts` are numbers of earlier layers, `layer` its dimensions, `curve` what
/// follows it, `params_of` the step whose parameters a recurrent one has: an earlier layer, or its own number.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the texts say what the fields are")]
pub enum Layer {
    /// An input of the network, of so many values.
    Input { len: usize },
    /// Constant zeros.
    Zeros { len: usize },
    /// Values `from..from + len` of a layer.
    Slice { x: usize, from: usize, len: usize },
    /// Layers one after the other.
    Concat { parts: Vec<usize> },
    /// An element-wise function.
    Curve { x: usize, curve: Activation },
    /// A convolution.
    Conv2d { x: usize, layer: Conv2d, curve: Activation },
    /// A fully connected layer.
    Dense { x: usize, layer: Dense, curve: Activation },
    /// Max pooling.
    MaxPool2d { x: usize, layer: MaxPool2d },
    /// Batch normalisation with running statistics.
    BatchNorm { x: usize, layer: BatchNorm },
    /// A function of single values that is no part of a layer.
    Function { x: usize, function: Function },
    /// Layers of one length, added value by value.
    Sum { parts: Vec<usize> },
    /// Two layers of one length, multiplied value by value.
    Product { x: usize, y: usize },
    /// Layer normalisation.
    LayerNorm { x: usize, layer: LayerNorm },
    /// One step of a GRU from an input and a state.
    Gru {
        x: usize,
        h: usize,
        layer: Gru,
        params_of: usize,
    },
    /// One step of an LSTM from an input and a state: `h`, then `c`. The cell's curve is tanh.
    Lstm {
        x: usize,
        state: usize,
        layer: Lstm,
        params_of: usize,
    },
}

/// Why a description is refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkError(pub String);

impl fmt::Display for NetworkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl core::error::Error for NetworkError {}

impl From<ShapeError> for NetworkError {
    fn from(error: ShapeError) -> Self {
        Self(error.to_string())
    }
}

/// A network: layers in the order of computation. The text that [`fmt::Display`] writes and [`core::str::FromStr`] reads has a line for
/// each, its kind and numbers, and a last line `output N`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Network {
    /// Layers.
    pub layers: Vec<Layer>,
    /// The layer whose values are the output.
    pub output: usize,
}

fn product(sizes: &[usize]) -> u64 {
    sizes.iter().fold(1, |all, size| all.saturating_mul(*size as u64))
}

/// Places of a window along a side of an image.
fn places(size: usize, window: usize, stride: usize, padding: usize) -> u64 {
    (size as u64 + 2 * padding as u64).saturating_sub(window as u64) / stride.max(1) as u64 + 1
}

impl Layer {
    /// Its line in a network's text: the kind, the layers that it uses, its sizes, and the word behind them.
    pub(super) fn line(&self) -> Line {
        let params_of = match self {
            Self::Gru { params_of, .. } | Self::Lstm { params_of, .. } => Some(*params_of),
            _ => None,
        };
        let line = |kind, sources: &[usize], sizes: &[usize]| Line {
            kind,
            sources: sources.to_vec(),
            sizes: sizes.to_vec(),
            params_of,
            word: String::new(),
        };
        match self {
            Self::Input { len } => line("input", &[], &[*len]),
            Self::Zeros { len } => line("zeros", &[], &[*len]),
            Self::Slice { x, from, len } => line("slice", &[*x], &[*from, *len]),
            Self::Concat { parts } => line("concat", parts, &[]),
            Self::Sum { parts } => line("sum", parts, &[]),
            Self::Product { x, y } => line("product", &[*x, *y], &[]),
            Self::Curve { x, curve } => line("curve", &[*x], &[]).with(name_of(*curve)),
            Self::Function { x, function } => line("function", &[*x], &[]).with(name_of_function(*function)),
            Self::Conv2d { x, layer: l, curve } => {
                let sizes = [l.rows, l.cols, l.channels, l.filters, l.kernel, l.stride, l.padding];
                line("conv2d", &[*x], &sizes).with(name_of(*curve))
            }
            Self::Dense { x, layer, curve } => {
                line("dense", &[*x], &[layer.inputs, layer.outputs]).with(name_of(*curve))
            }
            Self::MaxPool2d { x, layer: l } => {
                let [height, width] = l.window;
                let sizes = [l.rows, l.cols, l.channels, height, width, l.stride, l.padding];
                // Windows side by side have one number.
                let tiles = *l == MaxPool2d::tiles(l.rows, l.cols, l.channels, height);
                line("max_pool2d", &[*x], if tiles { &sizes[..4] } else { &sizes })
            }
            Self::BatchNorm { x, layer } => {
                line("batch_norm", &[*x], &[layer.channels]).with(layer.epsilon.to_string())
            }
            Self::LayerNorm { x, layer } => line("layer_norm", &[*x], &[layer.width]).with(layer.epsilon.to_string()),
            Self::Gru { x, h, layer: l, .. } => line("gru", &[*x, *h], &[l.inputs, l.hidden]),
            Self::Lstm { x, state, layer: l, .. } => line("lstm", &[*x, *state], &[l.inputs, l.hidden]),
        }
    }

    /// Parameters, values (0 where it has as many as it reads) and multiply-adds at most, without overflow.
    pub(super) fn cost(&self) -> (u64, u64, u64) {
        match self {
            Self::Input { len } | Self::Zeros { len } | Self::Slice { len, .. } => (0, *len as u64, 0),
            Self::LayerNorm { layer, .. } => (2 * layer.width as u64, 0, 0),
            Self::BatchNorm { layer, .. } => (4 * layer.channels as u64, 0, 0),
            Self::Conv2d { layer: l, .. } => {
                let weights = product(&[l.kernel, l.kernel, l.channels, l.filters]);
                let out = |size: usize| places(size, l.kernel, l.stride, l.padding);
                let pixels = out(l.rows).saturating_mul(out(l.cols));
                let values = pixels.saturating_mul(l.filters as u64);
                let values = values.max(product(&[l.rows, l.cols, l.channels]));
                (
                    weights.saturating_add(l.filters as u64),
                    values,
                    pixels.saturating_mul(weights),
                )
            }
            Self::Dense { layer, .. } => {
                let weights = product(&[layer.inputs, layer.outputs]);
                (
                    weights.saturating_add(layer.outputs as u64),
                    layer.outputs as u64,
                    weights,
                )
            }
            Self::MaxPool2d { layer: l, .. } => {
                let out = |size: usize, window: usize| places(size, window, l.stride, l.padding);
                let [height, width] = l.window;
                let pixels = out(l.rows, height).saturating_mul(out(l.cols, width));
                let values = pixels.saturating_mul(l.channels as u64);
                // A comparison counts as a multiply-add: large windows that overlap are many.
                let compared = pixels.saturating_mul(product(&[height, width, l.channels]));
                (0, values.max(product(&[l.rows, l.cols, l.channels])), compared)
            }
            Self::Gru { layer, .. } => recurrent(3, layer.inputs, layer.hidden),
            Self::Lstm { layer, .. } => recurrent(4, layer.inputs, layer.hidden),
            _ => (0, 0, 0),
        }
    }

    pub(super) fn sources(&self) -> Vec<usize> {
        self.line().sources
    }
}

/// A layer as it stands in a network's text.
pub(super) struct Line {
    pub(super) kind: &'static str,
    /// Layers that it uses.
    pub(super) sources: Vec<usize>,
    /// Numbers that are sizes.
    pub(super) sizes: Vec<usize>,
    /// The layer whose parameters it has, if it may be another one.
    pub(super) params_of: Option<usize>,
    /// A curve, a function or an epsilon; empty where there is none.
    pub(super) word: String,
}

impl Line {
    fn with(self, word: String) -> Self {
        Self { word, ..self }
    }
}

/// Refuses what there are more of than fit.
///
/// # Errors
/// How many there are, and the limit.
pub fn refuse_more(what: &str, found: u64, limit: u64) -> Result<(), NetworkError> {
    if found > limit {
        return Err(NetworkError(format!(
            "it has {found} {what}, more than the {limit} that fit the step of 50 ms and the memory kept for it"
        )));
    }
    Ok(())
}

fn recurrent(gates: u64, inputs: usize, hidden: usize) -> (u64, u64, u64) {
    let weights = (product(&[inputs, hidden]).saturating_add(product(&[hidden, hidden]))).saturating_mul(gates);
    let biases = 2 * gates * hidden as u64;
    (weights.saturating_add(biases), 12 * hidden as u64, weights)
}

impl Network {
    /// Checks it against the limits: sizes, memory, and the time that a decision may take.
    ///
    /// # Errors
    /// What is too large, with the limit; a layer that uses one that does not come before it; a dense layer of several rows.
    pub fn check(&self) -> Result<(), NetworkError> {
        if self.layers.is_empty() || self.layers.len() > MOST_LAYERS || self.output >= self.layers.len() {
            return Err(NetworkError(format!(
                "it has {} layers, of which number {} is the output; 1 to {MOST_LAYERS} are allowed",
                self.layers.len(),
                self.output
            )));
        }
        let (mut params, mut values, mut multiply_adds) = (0u64, 0u64, 0u64);
        let mut lens: Vec<u64> = Vec::with_capacity(self.layers.len());
        for (number, layer) in self.layers.iter().enumerate() {
            let line = layer.line();
            // Before anything is computed from them.
            if let Some(size) = line.sizes.iter().find(|size| **size > MOST_SIZE) {
                return Err(NetworkError(format!(
                    "layer {number} has a size of {size}, the limit is {MOST_SIZE}"
                )));
            }
            if line.params_of.is_some_and(|of| of > number) || !line.sources.iter().all(|source| *source < number) {
                return Err(NetworkError(format!(
                    "layer {number} uses a layer that does not come before it"
                )));
            }
            let (p, own, m) = layer.cost();
            let len_of = |source: &usize| lens.get(*source).copied().unwrap_or(0);
            let v = match layer {
                Layer::Concat { .. } => line.sources.iter().map(len_of).fold(0, u64::saturating_add),
                // As many as it reads.
                _ if own == 0 => line.sources.first().map_or(0, len_of),
                _ => own,
            };
            lens.push(v);
            (params, values) = (params.saturating_add(p), values.saturating_add(v));
            multiply_adds = multiply_adds.saturating_add(m);
        }
        for (what, found, limit) in [
            ("parameters", params, MOST_VALUES),
            ("values", values, MOST_VALUES),
            ("multiply-adds a decision", multiply_adds, MOST_MULTIPLY_ADDS),
        ] {
            refuse_more(what, found, limit)?;
        }
        // Not before: lengths within the limits cannot overflow.
        let lens = self.lens();
        for (number, layer) in self.layers.iter().enumerate() {
            if let Layer::Dense { x, layer, .. } = layer
                && let Some(found) = lens.get(*x).filter(|found| **found != layer.inputs)
            {
                let wrong = format!("layer {number}: dense of {} inputs reads {found} values", layer.inputs);
                return Err(NetworkError(wrong));
            }
        }
        Ok(())
    }

    /// Multiply-adds of one decision.
    pub fn multiply_adds(&self) -> u64 {
        self.layers.iter().map(|layer| layer.cost().2).sum()
    }

    /// Lengths of the inputs, in their order.
    pub fn inputs(&self) -> Vec<usize> {
        let lens = self.layers.iter().filter_map(|layer| match layer {
            Layer::Input { len } => Some(*len),
            _ => None,
        });
        lens.collect()
    }

    /// The graph, all inputs explained. Parameters lie in the order of the layers.
    ///
    /// # Errors
    /// Whatever [`Self::check`] finds, and lengths that do not fit each other.
    pub fn graph(&self, purpose: Purpose) -> Result<Graph, NetworkError> {
        self.graph_and_nodes(purpose).map(|(graph, _)| graph)
    }

    /// The graph, and the node of each layer.
    pub(super) fn graph_and_nodes(&self, purpose: Purpose) -> Result<(Graph, Vec<NodeId>), NetworkError> {
        self.check()?;
        let mut b = GraphBuilder::new();
        let (mut nodes, mut own): (Vec<NodeId>, Vec<Params>) = (Vec::new(), Vec::new());
        for (number, layer) in self.layers.iter().enumerate() {
            let at = |source: usize| {
                let node = nodes.get(source).copied();
                node.ok_or_else(|| NetworkError(format!("layer {number} uses a layer that is not there")))
            };
            let params = match layer.params_of(number) {
                Some(of) if of == number => b.params(layer.param_len()),
                Some(of) => own.get(of).copied().unwrap_or_default(),
                None => Params::default(),
            };
            own.push(params);
            let all = |parts: &[usize]| parts.iter().map(|part| at(*part)).collect::<Result<Vec<_>, _>>();
            let node = match layer {
                Layer::Input { len } => b.input(*len, true),
                Layer::Zeros { len } => b.zeros(*len),
                Layer::Slice { x, from, len } => b.slice(at(*x)?, *from, *len),
                Layer::Concat { parts } => b.concat(&all(parts)?),
                Layer::Sum { parts } => b.sum(&all(parts)?),
                Layer::Function { x, function } => b.function(at(*x)?, *function),
                Layer::Product { x, y } => b.product(at(*x)?, at(*y)?),
                Layer::LayerNorm { x, layer } => b.layer_norm(at(*x)?, *layer, params),
                Layer::Curve { x, curve } => b.activation(at(*x)?, *curve),
                Layer::Conv2d { x, layer, curve } => b.conv2d(at(*x)?, *layer, *curve, params),
                Layer::Dense { x, layer, curve } => b.dense(at(*x)?, *layer, *curve, params),
                Layer::MaxPool2d { x, layer } => b.max_pool2d(at(*x)?, *layer),
                Layer::BatchNorm { x, layer } => b.batch_norm(at(*x)?, *layer, params),
                Layer::Gru { x, h, layer, .. } => b.gru(at(*x)?, at(*h)?, *layer, params),
                Layer::Lstm { x, state, layer, .. } => b.lstm(at(*x)?, at(*state)?, *layer, params),
            };
            nodes.push(node.map_err(|e| NetworkError(format!("layer {number}: {e}")))?);
        }
        let output = nodes.get(self.output).copied();
        let output = output.ok_or_else(|| NetworkError("the output is not there".to_owned()))?;
        Ok((b.finish(output, purpose)?, nodes))
    }
}
