//! From layers to ONNX's nodes.
//!
//! Every value is a row `[1, length]`, as our layers keep it; images are put into ONNX's order of channels, rows, columns before a
//! convolution and back after it, which runtimes do away with.

use crate::proto::{
    Attribute, Dim, Entry, Graph, Model, Node, OperatorSet, Shape, Tensor, TensorType, Type, ValueInfo, attribute_type,
    data_type,
};
use prost::Message;
use std::collections::HashSet;
use vigil_nnet::{Activation, Dense, Function, GraphBuilder, LayerNorm, Params, ShapeError};
use vigil_policy::actor::{ACTOR_LIMIT, ActorSpec, CONTEXT, LOW_DIM};
use vigil_policy::imported::{Layer, NetworkError};
use vigil_policy::{FrozenActor, FrozenPilot, FrozenPolicy};

/// Operators as of ONNX 1.12 (2022), which every runtime in use knows.
const OPERATOR_SET: i64 = 17;
/// Of the same release.
const IR_VERSION: i64 = 8;

/// Why a pilot is not exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The network is not one.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The actor's layers do not fit each other.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}

/// An input: its name and its shape in ONNX.
struct Input {
    name: &'static str,
    shape: Vec<usize>,
}

/// A layer of either.
enum Step {
    /// One that imported policies have, too.
    Layer(Layer),
    /// Of the actor alone.
    LayerNorm { x: usize, layer: LayerNorm },
}

/// Layers with the places of their parameters.
struct Placed<'a> {
    layers: Vec<(Step, Params)>,
    output: usize,
    params: &'a [f32],
    inputs: Vec<Input>,
}

/// A pilot's network as a model of ONNX. Inputs of an actor of ours: `frame` `[1, 1, 128, 256]`, ranges over 100 m, `context` `[1, 328]`,
/// what it remembers ([`CONTEXT`]), and `low_dim` `[1, 8]` ([`LOW_DIM`]); of an imported policy `frame` `[1, channels, rows, columns]` and,
/// if it has one, `position` `[1, 2]`. Output: `action` `[1, 2]`, of an imported policy before its
/// factor. What is to be known beside it is in the model's metadata.
///
/// # Errors
/// [`ExportError`]: a network that is none.
pub fn export(pilot: &FrozenPilot) -> Result<Vec<u8>, ExportError> {
    let (placed, about) = match pilot {
        FrozenPilot::Actor(actor) => (of_actor(actor), about_actor(actor)),
        FrozenPilot::Imported(policy) => (of_policy(policy)?, about_policy(policy)),
    };
    let mut writer = Writer {
        params: placed.params,
        graph: Graph {
            name: "vigil".to_owned(),
            ..Graph::default()
        },
        known: HashSet::new(),
    };
    let mut values: Vec<(String, usize)> = Vec::new();
    let mut inputs = placed.inputs.iter();
    for (layer, params) in &placed.layers {
        let value = match layer {
            Step::Layer(layer) => writer.layer(layer, *params, &values, &mut inputs)?,
            Step::LayerNorm { x, layer } => writer.layer_norm(*x, *layer, *params, &values)?,
        };
        values.push(value);
    }
    let (output, len) = value_of(&values, placed.output)?;
    writer.graph.node.push(Node {
        input: vec![output.to_owned()],
        output: vec!["action".to_owned()],
        name: "action".to_owned(),
        op_type: "Identity".to_owned(),
        ..Node::default()
    });
    writer.graph.output.push(value_info("action", &[1, len]));
    let model = Model {
        ir_version: IR_VERSION,
        producer_name: "vigil".to_owned(),
        producer_version: env!("CARGO_PKG_VERSION").to_owned(),
        graph: Some(writer.graph),
        opset_import: vec![OperatorSet {
            domain: String::new(),
            version: OPERATOR_SET,
        }],
        metadata_props: about
            .into_iter()
            .map(|(key, value)| Entry {
                key: key.to_owned(),
                value,
            })
            .collect(),
    };
    Ok(model.encode_to_vec())
}

fn of_policy(policy: &FrozenPolicy) -> Result<Placed<'_>, ExportError> {
    policy.network.check()?;
    let (mut layers, mut at): (Vec<(Step, Params)>, usize) = (Vec::new(), 0);
    for (number, layer) in policy.network.layers.iter().enumerate() {
        let (len, of) = match layer {
            Layer::Conv2d { layer, .. } => (layer.param_len(), number),
            Layer::Dense { layer, .. } => (layer.param_len(), number),
            Layer::BatchNorm { layer, .. } => (layer.param_len(), number),
            Layer::LayerNorm { layer, .. } => (layer.param_len(), number),
            Layer::Gru { layer, params_of, .. } => (layer.param_len(), *params_of),
            Layer::Lstm { layer, params_of, .. } => (layer.param_len(), *params_of),
            _ => (0, number),
        };
        let params = match layers.get(of) {
            Some((_, params)) => *params,
            None => {
                at += len;
                Params { at: at - len, len }
            }
        };
        layers.push((Step::Layer(layer.clone()), params));
    }
    let of_inputs = &policy.inputs;
    let frame = Input {
        name: "frame",
        shape: vec![1, of_inputs.channels, of_inputs.rows, of_inputs.cols],
    };
    let mut inputs = vec![frame];
    if of_inputs.has_position {
        let position = Input {
            name: "position",
            shape: vec![1, 2],
        };
        inputs.insert(1 - of_inputs.frame_input.min(1), position);
    }
    Ok(Placed {
        layers,
        output: policy.network.output,
        params: &policy.params,
        inputs,
    })
}

fn of_actor(actor: &FrozenActor) -> Placed<'_> {
    let spec = ActorSpec::FULL;
    let own = spec.reserve(&mut GraphBuilder::new());
    let mut layers: Vec<(Step, Params)> = Vec::new();
    let mut push = |step: Step, params: Params| {
        layers.push((step, params));
        layers.len() - 1
    };
    let none = Params::default();
    let [frame, context, low] =
        [spec.frame_len(), CONTEXT, LOW_DIM].map(|len| push(Step::Layer(Layer::Input { len }), none));
    let curved = |x, curve| Step::Layer(Layer::Curve { x, curve });
    let dense = |x, layer: Dense, curve| Step::Layer(Layer::Dense { x, layer, curve });
    let joined = |parts: [usize; 2]| Step::Layer(Layer::Concat { parts: parts.to_vec() });
    // The encoder.
    let mut x = push(curved(frame, Activation::NEAR_CONTRAST), none);
    for (layer, params) in spec.convolutions().into_iter().zip(own.convolutions) {
        let curve = Activation::Elu;
        x = push(Step::Layer(Layer::Conv2d { x, layer, curve }), params);
    }
    let scan = push(dense(x, spec.scan(), Activation::Sigmoid), own.scan);
    // The trunk.
    let mut x = push(joined([scan, context]), none);
    for (layer, (params, norm)) in spec.trunk().into_iter().zip(own.trunk) {
        x = push(dense(x, layer, Activation::Identity), params);
        let layer = ActorSpec::norm(layer);
        x = push(Step::LayerNorm { x, layer }, norm);
        x = push(curved(x, Activation::Elu), none);
    }
    let state = push(dense(x, spec.state(), Activation::Identity), own.state);
    // The second half.
    let state = push(curved(state, Activation::TANH), none);
    let low = push(dense(low, spec.low(), Activation::TANH), own.low);
    let mut x = push(joined([state, low]), none);
    for (layer, params) in spec.head().into_iter().zip(own.head) {
        x = push(dense(x, layer, Activation::Elu), params);
    }
    let scale = ACTOR_LIMIT;
    let output = push(dense(x, spec.output(), Activation::Tanh { scale }), own.output);
    let input = |name, shape: &[usize]| Input {
        name,
        shape: shape.to_vec(),
    };
    Placed {
        layers,
        output,
        params: &actor.params,
        inputs: vec![
            input("frame", &[1, 1, spec.rows, spec.cols]),
            input("context", &[1, CONTEXT]),
            input("low_dim", &[1, LOW_DIM]),
        ],
    }
}

fn about_actor(actor: &FrozenActor) -> Vec<(&'static str, String)> {
    vec![
        ("sha256", actor.sha256()),
        ("frame", "range / 100 m, 0 to 1".to_owned()),
        (
            "context",
            "older scans moved to here, remembered surfaces, own trail: docs/architecture.md".to_owned(),
        ),
        (
            "low_dim",
            "goal, own motion, last action: docs/architecture.md".to_owned(),
        ),
        (
            "action",
            "forward speed in m/s; yaw in units of 30 degrees/s, clockwise".to_owned(),
        ),
    ]
}

fn about_policy(policy: &FrozenPolicy) -> Vec<(&'static str, String)> {
    let inputs = &policy.inputs;
    vec![
        ("sha256", policy.sha256()),
        ("source", policy.source.clone()),
        ("channels", inputs.order.name().to_owned()),
        ("depth", inputs.depth.name().to_owned()),
        ("scale", inputs.scale.to_string()),
        ("output_scale", inputs.output_scale.to_string()),
    ]
}

fn value_of(values: &[(String, usize)], layer: usize) -> Result<(&str, usize), NetworkError> {
    match values.get(layer) {
        Some((name, len)) => Ok((name, *len)),
        None => Err(NetworkError(format!("layer {layer} is used before it is there"))),
    }
}

fn value_info(name: &str, shape: &[usize]) -> ValueInfo {
    let dim = |size: &usize| Dim {
        dim_value: *size as i64,
        dim_param: String::new(),
    };
    ValueInfo {
        name: name.to_owned(),
        r#type: Some(Type {
            tensor_type: Some(TensorType {
                elem_type: data_type::FLOAT,
                shape: Some(Shape {
                    dim: shape.iter().map(dim).collect(),
                }),
            }),
        }),
    }
}

fn int(name: &str, i: usize) -> Attribute {
    Attribute {
        name: name.to_owned(),
        i: i as i64,
        r#type: attribute_type::INT,
        ..Attribute::default()
    }
}

fn ints(name: &str, ints: &[usize]) -> Attribute {
    Attribute {
        name: name.to_owned(),
        ints: ints.iter().map(|i| *i as i64).collect(),
        r#type: attribute_type::INTS,
        ..Attribute::default()
    }
}

fn float(name: &str, f: f32) -> Attribute {
    Attribute {
        name: name.to_owned(),
        f,
        r#type: attribute_type::FLOAT,
        ..Attribute::default()
    }
}

fn strings(name: &str, words: &[&str]) -> Attribute {
    Attribute {
        name: name.to_owned(),
        strings: words.iter().map(|word| word.as_bytes().to_vec()).collect(),
        r#type: attribute_type::STRINGS,
        ..Attribute::default()
    }
}

/// Name of a row of zeros.
fn zeros(len: usize) -> String {
    format!("zeros_{len}")
}

/// `[rows][columns]` of a matrix with the columns for rows.
fn turned(matrix: &[f32], cols: usize) -> Vec<f32> {
    (0..cols)
        .flat_map(|col| matrix.iter().skip(col).step_by(cols).copied())
        .collect()
}

struct Writer<'a> {
    params: &'a [f32],
    graph: Graph,
    /// Constants that are there.
    known: HashSet<String>,
}

impl Writer<'_> {
    fn constant(&mut self, name: &str, tensor: impl FnOnce() -> Tensor) -> String {
        if self.known.insert(name.to_owned()) {
            self.graph.initializer.push(Tensor {
                name: name.to_owned(),
                ..tensor()
            });
        }
        name.to_owned()
    }

    /// Constants of the same name are the same.
    fn floats(&mut self, name: &str, dims: &[usize], values: impl FnOnce() -> Vec<f32>) -> String {
        self.constant(name, || Tensor {
            dims: dims.iter().map(|size| *size as i64).collect(),
            data_type: data_type::FLOAT,
            raw_data: values().iter().flat_map(|value| value.to_le_bytes()).collect(),
            ..Tensor::default()
        })
    }

    fn whole_numbers(&mut self, values: &[usize]) -> String {
        let words: Vec<String> = values.iter().map(usize::to_string).collect();
        self.constant(&format!("size_{}", words.join("_")), || Tensor {
            dims: vec![values.len() as i64],
            data_type: data_type::INT64,
            raw_data: values.iter().flat_map(|value| (*value as i64).to_le_bytes()).collect(),
            ..Tensor::default()
        })
    }

    fn node(&mut self, operator: &str, inputs: &[&str], attribute: Vec<Attribute>) -> String {
        let [output] = self.node_of(operator, inputs, [""], attribute);
        output
    }

    /// A node with several outputs; empty is one that nobody wants, others are named by what they end in.
    fn node_of<const N: usize>(
        &mut self,
        operator: &str,
        inputs: &[&str],
        endings: [&str; N],
        attribute: Vec<Attribute>,
    ) -> [String; N] {
        let name = format!("{operator}_{}", self.graph.node.len());
        let outputs = endings.map(|ending| format!("{name}{ending}"));
        self.graph.node.push(Node {
            input: inputs.iter().map(|input| (*input).to_owned()).collect(),
            output: outputs.to_vec(),
            name,
            op_type: operator.to_owned(),
            attribute,
            domain: String::new(),
        });
        outputs
    }

    fn reshaped(&mut self, x: &str, shape: &[usize]) -> String {
        let shape = self.whole_numbers(shape);
        self.node("Reshape", &[x, &shape], Vec::new())
    }

    /// A row as an image `[1, channels, rows, columns]`.
    fn image(&mut self, x: &str, [rows, cols, channels]: [usize; 3]) -> String {
        if channels == 1 {
            return self.reshaped(x, &[1, 1, rows, cols]);
        }
        let x = self.reshaped(x, &[1, rows, cols, channels]);
        self.node("Transpose", &[&x], vec![ints("perm", &[0, 3, 1, 2])])
    }

    /// An image as a row of `len` values.
    fn row(&mut self, image: &str, len: usize) -> String {
        let x = self.node("Transpose", &[image], vec![ints("perm", &[0, 2, 3, 1])]);
        self.reshaped(&x, &[1, len])
    }

    fn times(&mut self, x: &str, factor: f32) -> String {
        let name = self.floats(&format!("factor_{factor}"), &[1], || vec![factor]);
        self.node("Mul", &[x, &name], Vec::new())
    }

    fn curve(&mut self, x: String, curve: Activation) -> String {
        match curve {
            Activation::Identity => x,
            Activation::Relu => self.node("Relu", &[&x], Vec::new()),
            Activation::Elu => self.node("Elu", &[&x], vec![float("alpha", 1.0)]),
            Activation::Sigmoid => self.node("Sigmoid", &[&x], Vec::new()),
            Activation::Tanh { scale } => {
                let y = self.node("Tanh", &[&x], Vec::new());
                match scale == 1.0 {
                    true => y,
                    false => self.times(&y, scale),
                }
            }
            Activation::NearContrast { gain } => {
                let x = self.times(&x, gain);
                let one = self.floats("one", &[1], || vec![1.0]);
                let x = self.node("Add", &[&x, &one], Vec::new());
                self.node("Reciprocal", &[&x], Vec::new())
            }
        }
    }

    fn function(&mut self, x: &str, function: Function) -> String {
        let one = |operator: &'static str| (operator, Vec::new());
        let (operator, attributes) = match function {
            Function::LeakyRelu { alpha } => ("LeakyRelu", vec![float("alpha", alpha)]),
            Function::Elu { alpha } => ("Elu", vec![float("alpha", alpha)]),
            Function::Softplus => one("Softplus"),
            Function::Exp => one("Exp"),
            Function::Log => one("Log"),
            Function::Abs => one("Abs"),
            Function::Erf => one("Erf"),
            Function::Clip { least, most } => {
                // Infinite bounds are none.
                let [least, most] = [least, most].map(|bound| match bound.is_finite() {
                    true => self.floats(&format!("bound_{bound}"), &[], || vec![bound]),
                    false => String::new(),
                });
                return self.node("Clip", &[x, &least, &most], Vec::new());
            }
            Function::Power { exponent } => {
                let exponent = self.floats(&format!("exponent_{exponent}"), &[], || vec![exponent]);
                return self.node("Pow", &[x, &exponent], Vec::new());
            }
        };
        self.node(operator, &[x], attributes)
    }

    fn of(&self, params: Params) -> Result<Vec<f32>, ShapeError> {
        vigil_nnet::shape::part("a layer's parameters", self.params, params.at, params.len).map(<[f32]>::to_vec)
    }

    /// Adds the nodes of a layer; returns its values' name and number.
    fn layer<'i>(
        &mut self,
        layer: &Layer,
        params: Params,
        values: &[(String, usize)],
        inputs: &mut impl Iterator<Item = &'i Input>,
    ) -> Result<(String, usize), ExportError> {
        let own = self.of(params)?;
        let named = |what: &str| format!("{what}_{}", params.at);
        Ok(match layer {
            Layer::Input { len } => {
                let input = inputs
                    .next()
                    .ok_or_else(|| NetworkError("it has more inputs than a frame and a position".to_owned()))?;
                self.graph.input.push(value_info(input.name, &input.shape));
                let value = match *input.shape {
                    [1, channels, ..] if input.name == "frame" && channels > 1 => self.row(input.name, *len),
                    [1, _] => input.name.to_owned(),
                    _ => self.reshaped(input.name, &[1, *len]),
                };
                (value, *len)
            }
            Layer::Zeros { len } => {
                let zeros = self.floats(&zeros(*len), &[1, *len], || vec![0.0; *len]);
                (zeros, *len)
            }
            Layer::Slice { x, from, len } => {
                let (x, _) = value_of(values, *x)?;
                (self.slice(x, *from, *len), *len)
            }
            Layer::Concat { parts } => {
                let parts: Vec<(&str, usize)> = parts
                    .iter()
                    .map(|part| value_of(values, *part))
                    .collect::<Result<_, _>>()?;
                let names: Vec<&str> = parts.iter().map(|(name, _)| *name).collect();
                let len = parts.iter().map(|(_, len)| len).sum();
                (self.node("Concat", &names, vec![int("axis", 1)]), len)
            }
            Layer::Curve { x, curve } => {
                let (x, len) = value_of(values, *x)?;
                (self.curve(x.to_owned(), *curve), len)
            }
            Layer::Conv2d { x, layer: c, curve } => {
                let (x, _) = value_of(values, *x)?;
                let x = self.image(x, [c.rows, c.cols, c.channels]);
                let (taps, filters) = (c.kernel * c.kernel, c.filters);
                let dims = [filters, c.channels, c.kernel, c.kernel];
                let weights = self.floats(&named("kernels"), &dims, || {
                    // Ours: [tap][channel][filter].
                    let at = |i: usize| {
                        let (filter, rest) = (i / (c.channels * taps), i % (c.channels * taps));
                        (rest % taps * c.channels + rest / taps) * filters + filter
                    };
                    (0..taps * c.channels * filters).map(|i| own[at(i)]).collect()
                });
                let bias = self.floats(&named("biases"), &[filters], || {
                    own[taps * c.channels * filters..].to_vec()
                });
                let attributes = vec![
                    ints("kernel_shape", &[c.kernel; 2]),
                    ints("strides", &[c.stride; 2]),
                    ints("pads", &[c.padding; 4]),
                ];
                let y = self.node("Conv", &[&x, &weights, &bias], attributes);
                let y = self.curve(y, *curve);
                (self.row(&y, c.output_len()), c.output_len())
            }
            Layer::Dense { x, layer: d, curve } => {
                let (x, _) = value_of(values, *x)?;
                let weights = d.weight_len();
                let w = self.floats(&named("weights"), &[d.inputs, d.outputs], || own[..weights].to_vec());
                let b = self.floats(&named("biases"), &[d.outputs], || own[weights..].to_vec());
                let y = self.node("Gemm", &[x, &w, &b], Vec::new());
                (self.curve(y, *curve), d.outputs)
            }
            Layer::MaxPool2d { x, layer: p } => {
                let (x, _) = value_of(values, *x)?;
                let x = self.image(x, [p.rows, p.cols, p.channels]);
                let attributes = vec![
                    ints("kernel_shape", &p.window),
                    ints("strides", &[p.stride; 2]),
                    ints("pads", &[p.padding; 4]),
                ];
                let y = self.node("MaxPool", &[&x], attributes);
                (self.row(&y, p.output_len()), p.output_len())
            }
            Layer::BatchNorm { x, layer: n } => {
                let (x, len) = value_of(values, *x)?;
                let channels = n.channels;
                let x = self.image(x, [1, len / channels.max(1), channels]);
                let mut rows = Vec::new();
                for (row, what) in own.chunks_exact(channels).zip(["scale", "shift", "mean", "variance"]) {
                    rows.push(self.floats(&named(what), &[channels], || row.to_vec()));
                }
                let inputs: Vec<&str> = [x.as_str()]
                    .into_iter()
                    .chain(rows.iter().map(String::as_str))
                    .collect();
                let y = self.node("BatchNormalization", &inputs, vec![float("epsilon", n.epsilon)]);
                (self.row(&y, len), len)
            }
            Layer::Function { x, function } => {
                let (x, len) = value_of(values, *x)?;
                (self.function(x, *function), len)
            }
            Layer::Sum { parts } => {
                let parts: Vec<(&str, usize)> = parts
                    .iter()
                    .map(|part| value_of(values, *part))
                    .collect::<Result<_, _>>()?;
                let names: Vec<&str> = parts.iter().map(|(name, _)| *name).collect();
                (
                    self.node("Sum", &names, Vec::new()),
                    parts.first().map_or(0, |part| part.1),
                )
            }
            Layer::Product { x, y } => {
                let ((x, len), (y, _)) = (value_of(values, *x)?, value_of(values, *y)?);
                (self.node("Mul", &[x, y], Vec::new()), len)
            }
            Layer::LayerNorm { x, layer: n } => {
                let (x, len) = value_of(values, *x)?;
                let (scale, shift) = own.split_at(n.width);
                let x = self.reshaped(x, &[len / n.width.max(1), n.width]);
                let scale = self.floats(&named("scale"), &[n.width], || scale.to_vec());
                let shift = self.floats(&named("shift"), &[n.width], || shift.to_vec());
                let y = self.node(
                    "LayerNormalization",
                    &[&x, &scale, &shift],
                    vec![float("epsilon", n.epsilon)],
                );
                (self.reshaped(&y, &[1, len]), len)
            }
            Layer::Gru { x, h, layer: g, .. } => {
                let (x, h) = (value_of(values, *x)?.0, value_of(values, *h)?.0);
                let x = self.reshaped(x, &[1, 1, g.inputs]);
                // Without a first state it is zeros.
                let h = match h == zeros(g.hidden) {
                    true => String::new(),
                    false => self.reshaped(h, &[1, 1, g.hidden]),
                };
                // Ours: r, z, n; ONNX's: z, r, h.
                let [w, r, b] = self.recurrent(&own, [g.inputs, g.hidden], &[1, 0, 2], &named);
                let attributes = vec![int("hidden_size", g.hidden), int("linear_before_reset", 1)];
                let [_, y] = self.node_of("GRU", &[&x, &w, &r, &b, "", &h], ["_all", "_h"], attributes);
                (self.reshaped(&y, &[1, g.hidden]), g.hidden)
            }
            Layer::Lstm { x, state, layer: l, .. } => {
                let (x, state) = (value_of(values, *x)?.0, value_of(values, *state)?.0);
                let x = self.reshaped(x, &[1, 1, l.inputs]);
                let mut part = |from: usize| match state == zeros(2 * l.hidden) {
                    true => String::new(),
                    false => {
                        let part = self.slice(state, from, l.hidden);
                        self.reshaped(&part, &[1, 1, l.hidden])
                    }
                };
                let (h, c) = (part(0), part(l.hidden));
                // Ours: i, f, g, o; ONNX's: i, o, f, c.
                let [w, r, b] = self.recurrent(&own, [l.inputs, l.hidden], &[0, 3, 1, 2], &named);
                let mut attributes = vec![int("hidden_size", l.hidden)];
                if l.cell == Activation::Relu {
                    attributes.push(strings("activations", &["Sigmoid", "Relu", "Relu"]));
                } else if l.cell != Activation::TANH {
                    return Err(NetworkError("an LSTM's cell with another curve than tanh and ReLU".to_owned()).into());
                }
                let [_, h, c] = self.node_of("LSTM", &[&x, &w, &r, &b, "", &h, &c], ["_all", "_h", "_c"], attributes);
                let both = self.node("Concat", &[&h, &c], vec![int("axis", 2)]);
                (self.reshaped(&both, &[1, 2 * l.hidden]), 2 * l.hidden)
            }
        })
    }

    /// Adds the layer normalisation of a row.
    fn layer_norm(
        &mut self,
        x: usize,
        layer: LayerNorm,
        params: Params,
        values: &[(String, usize)],
    ) -> Result<(String, usize), ExportError> {
        let own = self.of(params)?;
        let (scale, shift) = own.split_at(layer.width);
        let scale = self.floats(&format!("scale_{}", params.at), &[layer.width], || scale.to_vec());
        let shift = self.floats(&format!("shift_{}", params.at), &[layer.width], || shift.to_vec());
        let (x, len) = value_of(values, x)?;
        let epsilon = float("epsilon", layer.epsilon);
        Ok((
            self.node("LayerNormalization", &[x, &scale, &shift], vec![epsilon]),
            len,
        ))
    }

    fn slice(&mut self, x: &str, from: usize, len: usize) -> String {
        let (start, end, axis) = (
            self.whole_numbers(&[from]),
            self.whole_numbers(&[from + len]),
            self.whole_numbers(&[1]),
        );
        self.node("Slice", &[x, &start, &end, &axis], Vec::new())
    }

    /// A recurrent layer's matrices `[1, gates · hidden, …]` and biases `[1, 2 · gates · hidden]`, the gates in `order` (numbers of
    /// ours); our parameters hold one or two biases.
    fn recurrent(
        &mut self,
        own: &[f32],
        [inputs, hidden]: [usize; 2],
        order: &[usize],
        named: &dyn Fn(&str) -> String,
    ) -> [String; 3] {
        let rows = order.len() * hidden;
        let (input, rest) = own.split_at(inputs * rows);
        let (state, bias) = rest.split_at(hidden * rows);
        let in_order = |rows_of: Vec<f32>| -> Vec<f32> {
            let gate = rows_of.len() / order.len();
            order
                .iter()
                .flat_map(|at| rows_of[at * gate..][..gate].to_vec())
                .collect()
        };
        let w = self.floats(&named("input"), &[1, rows, inputs], || in_order(turned(input, rows)));
        let r = self.floats(&named("state"), &[1, rows, hidden], || in_order(turned(state, rows)));
        let b = self.floats(&named("biases"), &[1, 2 * rows], || {
            let mut both: Vec<f32> = bias.chunks_exact(rows).flat_map(|row| in_order(row.to_vec())).collect();
            both.resize(2 * rows, 0.0);
            both
        });
        [w, r, b]
    }
}
