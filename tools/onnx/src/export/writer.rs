//! The graph that is being written: each layer's nodes, constants and names.

use crate::proto::{Attribute, Dim, Graph, Node, Shape, Tensor, TensorType, Type, ValueInfo};
use vigil_nnet::{Activation, BatchNorm, Conv2d, Function, Gru, LayerNorm, Lstm, Params};
use vigil_policy::imported::{Layer, NetworkError};

/// Numbers of `TensorProto.DataType`.
const FLOAT: i32 = 1;
const INT64: i32 = 7;

/// An input: its name and its shape in ONNX.
pub(super) type Input = (&'static str, Vec<usize>);

/// Name and number of a layer's values.
type Written = Result<(String, usize), NetworkError>;

pub(super) fn value_of(values: &[(String, usize)], layer: usize) -> Result<(&str, usize), NetworkError> {
    match values.get(layer) {
        Some((name, len)) => Ok((name, *len)),
        None => Err(NetworkError(format!("layer {layer} is used before it is there"))),
    }
}

pub(super) fn value_info(name: &str, shape: &[usize]) -> ValueInfo {
    let dim = |size: &usize| Dim {
        dim_value: *size as i64,
        dim_param: String::new(),
    };
    ValueInfo {
        name: name.to_owned(),
        r#type: Some(Type {
            tensor_type: Some(TensorType {
                elem_type: FLOAT,
                shape: Some(Shape {
                    dim: shape.iter().map(dim).collect(),
                }),
            }),
        }),
    }
}

/// A setting of this name and of this number of `AttributeProto.AttributeType`, which `set` puts in its place.
fn attribute(name: &str, r#type: i32, set: impl FnOnce(&mut Attribute)) -> Attribute {
    let mut attribute = Attribute::default();
    (attribute.name, attribute.r#type) = (name.to_owned(), r#type);
    set(&mut attribute);
    attribute
}

fn int(name: &str, i: usize) -> Attribute {
    attribute(name, 2, |a| a.i = i as i64)
}

fn ints(name: &str, ints: &[usize]) -> Attribute {
    let ints = ints.iter().map(|i| *i as i64);
    attribute(name, 7, |a| a.ints = ints.collect())
}

fn float(name: &str, f: f32) -> Attribute {
    attribute(name, 1, |a| a.f = f)
}

fn strings(name: &str, words: &[&str]) -> Attribute {
    let words = words.iter().map(|word| word.as_bytes().to_vec());
    attribute(name, 8, |a| a.strings = words.collect())
}

/// How a window moves over an image.
fn window(kernel: &[usize; 2], stride: usize, padding: usize) -> Vec<Attribute> {
    vec![
        ints("kernel_shape", kernel),
        ints("strides", &[stride; 2]),
        ints("pads", &[padding; 4]),
    ]
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

pub(super) struct Writer<'a> {
    pub(super) params: &'a [f32],
    pub(super) graph: Graph,
}

impl<'a> Writer<'a> {
    fn constant(&mut self, name: &str, tensor: impl FnOnce() -> Tensor) -> String {
        if self.graph.initializer.iter().all(|there| there.name != name) {
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
            data_type: FLOAT,
            raw_data: values().iter().flat_map(|value| value.to_le_bytes()).collect(),
            ..Tensor::default()
        })
    }

    /// Parameters of a layer.
    fn weights(&mut self, what: &str, of: Params, dims: &[usize], values: impl FnOnce() -> Vec<f32>) -> String {
        self.floats(&format!("{what}_{}", of.at), dims, values)
    }

    fn whole_numbers(&mut self, values: &[usize]) -> String {
        let words: Vec<String> = values.iter().map(usize::to_string).collect();
        self.constant(&format!("size_{}", words.join("_")), || Tensor {
            dims: vec![values.len() as i64],
            data_type: INT64,
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

    fn of(&self, params: Params) -> Result<&'a [f32], NetworkError> {
        let part = vigil_nnet::shape::part("a layer's parameters", self.params, params.at, params.len);
        part.map_err(|e| NetworkError(e.to_string()))
    }

    /// Adds the nodes of a layer; returns its values' name and number.
    pub(super) fn layer<'i>(
        &mut self,
        layer: &Layer,
        params: Params,
        values: &[(String, usize)],
        inputs: &mut impl Iterator<Item = &'i Input>,
    ) -> Written {
        let of = |x: &usize| value_of(values, *x);
        let several = |parts: &[usize]| parts.iter().map(of).collect::<Result<(Vec<&str>, Vec<usize>), _>>();
        Ok(match layer {
            Layer::Input { len } => {
                let (name, shape) = inputs
                    .next()
                    .ok_or_else(|| NetworkError("it has more inputs than a frame and a position".to_owned()))?;
                self.graph.input.push(value_info(name, shape));
                let value = match *shape.as_slice() {
                    [1, channels, ..] if *name == "frame" && channels > 1 => self.row(name, *len),
                    [1, _] => (*name).to_owned(),
                    _ => self.reshaped(name, &[1, *len]),
                };
                (value, *len)
            }
            Layer::Zeros { len } => {
                let zeros = self.floats(&zeros(*len), &[1, *len], || vec![0.0; *len]);
                (zeros, *len)
            }
            Layer::Slice { x, from, len } => (self.slice(of(x)?.0, *from, *len), *len),
            Layer::Concat { parts } => {
                let (names, lens) = several(parts)?;
                (self.node("Concat", &names, vec![int("axis", 1)]), lens.iter().sum())
            }
            Layer::Curve { x, curve } => {
                let (x, len) = of(x)?;
                (self.curve(x.to_owned(), *curve), len)
            }
            Layer::Function { x, function } => {
                let (x, len) = of(x)?;
                (self.function(x, *function), len)
            }
            Layer::Sum { parts } => {
                let (names, lens) = several(parts)?;
                let len = lens.first().copied().unwrap_or(0);
                (self.node("Sum", &names, Vec::new()), len)
            }
            Layer::Product { x, y } => {
                let ((x, len), (y, _)) = (of(x)?, of(y)?);
                (self.node("Mul", &[x, y], Vec::new()), len)
            }
            Layer::MaxPool2d { x, layer: p } => {
                let x = self.image(of(x)?.0, [p.rows, p.cols, p.channels]);
                let y = self.node("MaxPool", &[&x], window(&p.window, p.stride, p.padding));
                (self.row(&y, p.output_len()), p.output_len())
            }
            Layer::Conv2d { x, layer, curve } => {
                let y = self.conv2d(of(x)?.0, layer, params)?;
                let y = self.curve(y, *curve);
                (self.row(&y, layer.output_len()), layer.output_len())
            }
            Layer::Dense { x, layer: d, curve } => {
                let (weights, biases) = self.of(params)?.split_at(d.weight_len());
                let w = self.weights("weights", params, &[d.inputs, d.outputs], || weights.to_vec());
                let b = self.weights("biases", params, &[d.outputs], || biases.to_vec());
                let y = self.node("Gemm", &[of(x)?.0, &w, &b], Vec::new());
                (self.curve(y, *curve), d.outputs)
            }
            Layer::BatchNorm { x, layer } => self.batch_norm(of(x)?, layer, params)?,
            Layer::LayerNorm { x, layer } => self.layer_norm(of(x)?, layer, params)?,
            Layer::Gru { x, h, layer, .. } => (self.gru(of(x)?.0, of(h)?.0, layer, params)?, layer.hidden),
            Layer::Lstm { x, state, layer, .. } => {
                (self.lstm(of(x)?.0, of(state)?.0, layer, params)?, 2 * layer.hidden)
            }
        })
    }

    fn conv2d(&mut self, x: &str, layer: &Conv2d, params: Params) -> Result<String, NetworkError> {
        let own = self.of(params)?;
        let x = self.image(x, [layer.rows, layer.cols, layer.channels]);
        let (taps, channels, filters) = (layer.kernel * layer.kernel, layer.channels, layer.filters);
        let dims = [filters, channels, layer.kernel, layer.kernel];
        let weights = self.weights("kernels", params, &dims, || {
            // Ours: [tap][channel][filter].
            let at = |i: usize| {
                let (filter, rest) = (i / (channels * taps), i % (channels * taps));
                (rest % taps * channels + rest / taps) * filters + filter
            };
            (0..taps * channels * filters).map(|i| own[at(i)]).collect()
        });
        let biases = &own[taps * channels * filters..];
        let bias = self.weights("biases", params, &[filters], || biases.to_vec());
        let attributes = window(&[layer.kernel; 2], layer.stride, layer.padding);
        Ok(self.node("Conv", &[&x, &weights, &bias], attributes))
    }

    fn batch_norm(&mut self, (x, len): (&str, usize), layer: &BatchNorm, params: Params) -> Written {
        let channels = layer.channels;
        let mut inputs = vec![self.image(x, [1, len / channels.max(1), channels])];
        let rows = self.of(params)?.chunks_exact(channels);
        for (row, what) in rows.zip(["scale", "shift", "mean", "variance"]) {
            inputs.push(self.weights(what, params, &[channels], || row.to_vec()));
        }
        let inputs: Vec<&str> = inputs.iter().map(String::as_str).collect();
        let y = self.node("BatchNormalization", &inputs, vec![float("epsilon", layer.epsilon)]);
        Ok((self.row(&y, len), len))
    }

    fn layer_norm(&mut self, (x, len): (&str, usize), layer: &LayerNorm, params: Params) -> Written {
        let width = layer.width;
        let (scale, shift) = self.of(params)?.split_at(width);
        let scale = self.weights("scale", params, &[width], || scale.to_vec());
        let shift = self.weights("shift", params, &[width], || shift.to_vec());
        let epsilon = vec![float("epsilon", layer.epsilon)];
        if len == width {
            return Ok((self.node("LayerNormalization", &[x, &scale, &shift], epsilon), len));
        }
        let x = self.reshaped(x, &[len / width.max(1), width]);
        let y = self.node("LayerNormalization", &[&x, &scale, &shift], epsilon);
        Ok((self.reshaped(&y, &[1, len]), len))
    }

    fn gru(&mut self, x: &str, h: &str, layer: &Gru, params: Params) -> Result<String, NetworkError> {
        let (inputs, hidden) = (layer.inputs, layer.hidden);
        let x = self.reshaped(x, &[1, 1, inputs]);
        // Without a first state it is zeros.
        let h = match h == zeros(hidden) {
            true => String::new(),
            false => self.reshaped(h, &[1, 1, hidden]),
        };
        // Ours: r, z, n; ONNX's: z, r, h.
        let [w, r, b] = self.recurrent(params, [inputs, hidden], &[1, 0, 2])?;
        let attributes = vec![int("hidden_size", hidden), int("linear_before_reset", 1)];
        let [_, y] = self.node_of("GRU", &[&x, &w, &r, &b, "", &h], ["_all", "_h"], attributes);
        Ok(self.reshaped(&y, &[1, hidden]))
    }

    fn lstm(&mut self, x: &str, state: &str, layer: &Lstm, params: Params) -> Result<String, NetworkError> {
        let (inputs, hidden) = (layer.inputs, layer.hidden);
        let x = self.reshaped(x, &[1, 1, inputs]);
        let mut part = |from: usize| match state == zeros(2 * hidden) {
            true => String::new(),
            false => {
                let part = self.slice(state, from, hidden);
                self.reshaped(&part, &[1, 1, hidden])
            }
        };
        let (h, c) = (part(0), part(hidden));
        // Ours: i, f, g, o; ONNX's: i, o, f, c.
        let [w, r, b] = self.recurrent(params, [inputs, hidden], &[0, 3, 1, 2])?;
        let mut attributes = vec![int("hidden_size", hidden)];
        if layer.cell == Activation::Relu {
            attributes.push(strings("activations", &["Sigmoid", "Relu", "Relu"]));
        } else if layer.cell != Activation::TANH {
            return Err(NetworkError(
                "an LSTM's cell with another curve than tanh and ReLU".to_owned(),
            ));
        }
        let [_, h, c] = self.node_of("LSTM", &[&x, &w, &r, &b, "", &h, &c], ["_all", "_h", "_c"], attributes);
        let both = self.node("Concat", &[&h, &c], vec![int("axis", 2)]);
        Ok(self.reshaped(&both, &[1, 2 * hidden]))
    }

    fn slice(&mut self, x: &str, from: usize, len: usize) -> String {
        let [start, end, axis] = [from, from + len, 1].map(|number| self.whole_numbers(&[number]));
        self.node("Slice", &[x, &start, &end, &axis], Vec::new())
    }

    /// A recurrent layer's matrices `[1, gates · hidden, …]` and biases `[1, 2 · gates · hidden]`, the gates in `order` (numbers of
    /// ours); our parameters hold one or two biases.
    fn recurrent(
        &mut self,
        params: Params,
        [inputs, hidden]: [usize; 2],
        order: &[usize],
    ) -> Result<[String; 3], NetworkError> {
        let own = self.of(params)?;
        let rows = order.len() * hidden;
        let (input, rest) = own.split_at(inputs * rows);
        let (state, bias) = rest.split_at(hidden * rows);
        let in_order = |rows_of: Vec<f32>| -> Vec<f32> {
            let gate = rows_of.len() / order.len();
            let gates = order.iter().flat_map(|at| &rows_of[at * gate..][..gate]);
            gates.copied().collect()
        };
        let w = self.weights("input", params, &[1, rows, inputs], || in_order(turned(input, rows)));
        let r = self.weights("state", params, &[1, rows, hidden], || in_order(turned(state, rows)));
        let b = self.weights("biases", params, &[1, 2 * rows], || {
            let mut both: Vec<f32> = bias.chunks_exact(rows).flat_map(|row| in_order(row.to_vec())).collect();
            both.resize(2 * rows, 0.0);
            both
        });
        Ok([w, r, b])
    }
}
