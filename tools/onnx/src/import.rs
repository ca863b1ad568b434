//! From ONNX's nodes to layers.
//!
//! A tensor of the graph is a constant, or values of one layer: which, and where each of the tensor's values is there. Layers
//! keep images as `[row][column][channel]`, so reshaping, transposing, cutting and joining only change these places, and the
//! next layer's weights are put in their order.

use crate::beside;
use crate::constant::{Constant, Data, len_of};
use crate::fold;
use crate::movement::{self, axis, reshape, take, transpose};
use crate::proto::{Attribute, Graph, Model, Node, ValueInfo};
use prost::Message;
use std::collections::{HashMap, HashSet};
use std::rc::Rc;
use vigil_nnet::network_file::FileError;
use vigil_nnet::{Activation, BatchNorm, Conv2d, Dense, Function, Gru, Isa, LayerNorm, Lstm, MaxPool2d};
use vigil_policy::FrozenPolicy;
use vigil_policy::imported::{Channels, Depth, Layer, MOST_VALUES, Network, PolicyInputs};

/// The operators that are known, for the message about others.
const KNOWN: &str = "Abs, Add, AveragePool, BatchNormalization, Cast, Celu, Clip, Concat, Constant, Conv, Div, Dropout, Elu, Erf, \
    Exp, Expand, Flatten, GRU, Gather, Gelu, Gemm, GlobalAveragePool, GlobalMaxPool, HardSigmoid, HardSwish, Identity, LSTM, LayerNormalization, \
    LeakyRelu, Log, MatMul, Max, MaxPool, Min, Mish, Mul, Neg, PRelu, Pow, Reciprocal, ReduceMax, ReduceMean, ReduceSum, Relu, Reshape, Selu, \
    Shape, Sigmoid, Slice, Softplus, Softsign, Split, Sqrt, Squeeze, Sub, Sum, Swish, Tanh, Transpose, Unsqueeze";

/// Weights of a layer that only puts values in their order, at most.
const MOST_REARRANGED: usize = 1 << 22;

/// Why a model is not imported.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// It is not ONNX.
    #[error("{file} is truncated or not ONNX: {source}")]
    Container {
        /// The file.
        file: String,
        /// Where.
        source: prost::DecodeError,
    },
    /// The model as a whole.
    #[error("{file}: {message}")]
    Model {
        /// The file.
        file: String,
        /// What is wrong.
        message: String,
    },
    /// One of its nodes.
    #[error("{file}, node {number} `{name}` ({operator}): {message}")]
    Node {
        /// The file.
        file: String,
        /// From 0 on.
        number: usize,
        /// Its name, or that of its output.
        name: String,
        /// Its operator.
        operator: String,
        /// What is wrong.
        message: String,
    },
    /// The policy would not fly.
    #[error(transparent)]
    Policy(#[from] FileError),
}

/// How the policy is given what we have: see [`PolicyInputs`].
#[derive(Debug, Clone, PartialEq)]
pub struct Adapter {
    /// What its channels are.
    pub order: Channels,
    /// What a pixel is.
    pub depth: Depth,
    /// Every pixel is multiplied by it.
    pub scale: f32,
    /// Its outputs are multiplied by it.
    pub output_scale: f32,
    /// The row of values that it takes, if it takes no picture.
    pub flat: Option<Flat>,
    /// The output that is the action, where there are several.
    pub output: Option<String>,
    /// The node, or its output, whose values are explained; absent: the last layer with weights that can be.
    pub split: Option<String>,
}

/// Where the goal is in a policy's one row of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlatGoal {
    /// It has none.
    None,
    /// Before the frame.
    First,
    /// After it.
    Last,
}

/// A frame that a policy takes as a row of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flat {
    /// Channels, rows and columns, or rows, columns and channels where the last number is less than the first; the last runs fastest.
    pub frame: [usize; 3],
    /// The goal in the same row.
    pub goal: FlatGoal,
}

impl std::str::FromStr for Flat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (frame, goal) = match (text.strip_prefix("goal+"), text.strip_suffix("+goal")) {
            (Some(frame), _) => (frame, FlatGoal::First),
            (_, Some(frame)) => (frame, FlatGoal::Last),
            _ => (text, FlatGoal::None),
        };
        let sizes: Option<Vec<usize>> = frame
            .split('x')
            .map(|size| size.parse().ok().filter(|n| *n > 0))
            .collect();
        match sizes.as_deref() {
            Some([a, b, c]) => Ok(Self {
                frame: [*a, *b, *c],
                goal,
            }),
            _ => Err("three sizes are wanted, as 1x24x32, 1x24x32+goal or goal+1x24x32".to_owned()),
        }
    }
}

impl Default for Adapter {
    fn default() -> Self {
        Self {
            order: Channels::default(),
            depth: Depth::default(),
            scale: 1.0,
            output_scale: 1.0,
            flat: None,
            output: None,
            split: None,
        }
    }
}

/// Values of a layer.
#[derive(Debug, Clone)]
struct Live {
    layer: usize,
    /// As ONNX has it, batch included.
    shape: Vec<usize>,
    /// Where each value is in the layer.
    places: Rc<Vec<u32>>,
    /// Nothing else uses the layer, if nothing else uses this tensor.
    alone: bool,
}

#[derive(Debug, Clone)]
enum Value {
    Constant(Rc<Constant>),
    Live(Live),
}

/// Weights of a recurrent layer that are among the parameters already.
#[derive(Debug)]
struct RecurrentWeights<'a> {
    is_gru: bool,
    names: Vec<&'a str>,
    /// Where the inputs are in a layer of as many values.
    places: Rc<Vec<u32>>,
    inputs: usize,
    layer: usize,
}

/// Makes a policy of a model. `file` names it in errors; `beside` reads a file of weights that the model names, from its own folder.
///
/// # Errors
/// [`ImportError`]: what cannot be read, is not known, does not fit, or is too large for the step.
pub fn import(
    file: &str,
    bytes: &[u8],
    beside: &dyn Fn(&str) -> Result<Vec<u8>, String>,
    adapter: &Adapter,
) -> Result<FrozenPolicy, ImportError> {
    let mut model = Model::decode(bytes).map_err(|source| ImportError::Container {
        file: file.to_owned(),
        source,
    })?;
    let of_model = |message: String| ImportError::Model {
        file: file.to_owned(),
        message,
    };
    let graph = model
        .graph
        .as_mut()
        .ok_or_else(|| of_model("it holds no graph".to_owned()))?;
    beside::bring_in(graph, beside).map_err(of_model)?;
    let graph = &*graph;
    let action = action_name(graph, adapter.output.as_deref()).map_err(of_model)?;
    let needed = Needed::by(graph, action);
    let mut importer = Importer::new(graph, action, &needed).map_err(of_model)?;
    let frame = importer
        .inputs(graph, action, &needed, adapter.flat)
        .map_err(of_model)?;
    let nodes = graph.node.iter().enumerate();
    for (number, node) in nodes.filter(|(number, _)| needed.nodes.get(*number) == Some(&true)) {
        importer.node(node).map_err(|message| ImportError::Node {
            file: file.to_owned(),
            number,
            name: match node.name.is_empty() {
                true => node.output.first().cloned().unwrap_or_default(),
                false => node.name.clone(),
            },
            operator: node.op_type.clone(),
            message,
        })?;
    }
    importer.output(action).map_err(of_model)?;
    let params = importer.params.concat();
    let split = match adapter.split.as_deref() {
        None => importer.network.proposed_split(&params, frame.input),
        Some(name) => Some(
            importer
                .split_point(graph, name, &params, frame.input)
                .map_err(of_model)?,
        ),
    };
    let policy = FrozenPolicy {
        network: importer.network,
        params,
        split,
        inputs: PolicyInputs {
            rows: frame.rows,
            cols: frame.cols,
            channels: frame.channels,
            order: adapter.order,
            depth: adapter.depth,
            scale: adapter.scale,
            frame_input: frame.input,
            has_position: frame.has_position,
            output_scale: adapter.output_scale,
        },
        source: format!("{} {}", model.producer_name, graph.name).trim().to_owned(),
    };
    policy.network.check().map_err(|e| of_model(e.to_string()))?;
    policy.pilot(Isa::PORTABLE, false)?;
    Ok(policy)
}

/// The output that is the action.
fn action_name<'a>(graph: &'a Graph, wanted: Option<&str>) -> Result<&'a str, String> {
    let names: Vec<&str> = graph.output.iter().map(|output| output.name.as_str()).collect();
    match (wanted, names.as_slice()) {
        (Some(wanted), _) => {
            let found = names.iter().find(|name| **name == wanted).copied();
            found.ok_or_else(|| format!("there is no output `{wanted}`, only {}", names.join(", ")))
        }
        (None, [one]) => Ok(one),
        (None, _) => Err(format!(
            "it has {} outputs ({}); name the action's with --action",
            names.len(),
            names.join(", ")
        )),
    }
}

/// What the action is computed from: nothing else of a model is looked at.
struct Needed<'a> {
    nodes: Vec<bool>,
    tensors: HashSet<&'a str>,
    /// Outputs of nodes that are [`is_softplus_in_pieces`]: their third input, the others are not computed.
    pieces: HashSet<&'a str>,
}

/// Whether a node is `x > threshold ? x : softplus(x)`, as PyTorch's softplus is written out: from 15 on both are the same number.
fn is_softplus_in_pieces(graph: &Graph, producer: impl Fn(&str) -> Option<usize>, node: &Node) -> bool {
    let [condition, x, softplus] = node.input.as_slice() else {
        return false;
    };
    let made_by = |name: &str, operator: &str| {
        let node = graph.node.get(producer(name)?)?;
        (node.op_type == operator).then_some(node.input.as_slice())
    };
    let threshold = |name: &str| {
        let tensor = graph.initializer.iter().find(|tensor| tensor.name == name);
        let constant = tensor.and_then(|tensor| Constant::of(tensor).ok());
        constant.is_some_and(|constant| constant.real().is_ok_and(|all| all.iter().all(|value| *value >= 15.0)))
    };
    node.op_type == "Where"
        && matches!(made_by(softplus, "Softplus"), Some([of]) if of == x)
        && matches!(made_by(condition, "Greater"), Some([of, bound]) if of == x && threshold(bound))
}

impl<'a> Needed<'a> {
    fn by(graph: &'a Graph, action: &'a str) -> Self {
        let mut producers = HashMap::new();
        for (number, node) in graph.node.iter().enumerate() {
            for output in node.output.iter().filter(|output| !output.is_empty()) {
                producers.entry(output.as_str()).or_insert(number);
            }
        }
        let mut nodes = vec![false; graph.node.len()];
        let (mut tensors, mut pieces) = (HashSet::new(), HashSet::new());
        let mut open = vec![action];
        while let Some(name) = open.pop() {
            if !tensors.insert(name) {
                continue;
            }
            if let Some(number) = producers.get(name)
                && let (Some(is_needed), Some(node)) = (nodes.get_mut(*number), graph.node.get(*number))
                && !std::mem::replace(is_needed, true)
            {
                let in_pieces = is_softplus_in_pieces(graph, |name| producers.get(name).copied(), node);
                if in_pieces {
                    pieces.insert(name);
                }
                let read = node.input.iter().skip(if in_pieces { 2 } else { 0 });
                open.extend(read.map(String::as_str).filter(|input| !input.is_empty()));
            }
        }
        Self { nodes, tensors, pieces }
    }
}

/// The frame among the inputs.
struct Frame {
    rows: usize,
    cols: usize,
    channels: usize,
    input: usize,
    has_position: bool,
}

/// Whether a frame's channels are its last axis: it is transposed before a layer looks at it as an image; `None` where none does.
fn is_channels_last(graph: &Graph, needed: &Needed<'_>, frame: &str) -> Option<bool> {
    // Nodes stand in the order of computation.
    let mut of_frame = HashSet::from([frame]);
    let nodes = graph.node.iter().zip(&needed.nodes).filter(|(_, needed)| **needed);
    for (node, _) in nodes {
        if !node.input.iter().any(|input| of_frame.contains(input.as_str())) {
            continue;
        }
        match node.op_type.as_str() {
            "Transpose" => return Some(Settings(&node.attribute).list("perm") == Some(&[0, 3, 1, 2])),
            "Conv" | "MaxPool" | "AveragePool" => return Some(false),
            // What they give is no frame.
            "Gemm" | "MatMul" | "GlobalAveragePool" | "GlobalMaxPool" | "Concat" | "Shape" => {}
            _ => of_frame.extend(node.output.iter().map(String::as_str)),
        }
    }
    None
}

struct Importer<'a> {
    network: Network,
    /// Of each layer.
    params: Vec<Vec<f32>>,
    /// Values of each layer.
    lens: Vec<usize>,
    tensors: HashMap<&'a str, Value>,
    /// How many nodes read a tensor.
    uses: HashMap<&'a str, usize>,
    recurrent_weights: Vec<RecurrentWeights<'a>>,
    /// [`Needed::pieces`].
    pieces: HashSet<&'a str>,
}

/// A node's settings.
struct Settings<'a>(&'a [Attribute]);

impl<'a> Settings<'a> {
    fn get(&self, name: &str) -> Option<&'a Attribute> {
        self.0.iter().find(|attribute| attribute.name == name)
    }

    fn whole(&self, name: &str, default: i64) -> i64 {
        self.get(name).map_or(default, |attribute| attribute.i)
    }

    fn real(&self, name: &str, default: f32) -> f32 {
        self.get(name).map_or(default, |attribute| attribute.f)
    }

    fn list(&self, name: &str) -> Option<&'a [i64]> {
        self.get(name).map(|attribute| attribute.ints.as_slice())
    }

    fn word(&self, name: &str) -> Option<String> {
        self.get(name)
            .map(|attribute| String::from_utf8_lossy(&attribute.s).into_owned())
    }

    /// Refuses a setting that is there and is not as computed here.
    fn only(&self, name: &str, allowed: i64) -> Result<(), String> {
        match self.whole(name, allowed) == allowed {
            true => Ok(()),
            false => Err(format!("{name} = {} is not supported", self.whole(name, allowed))),
        }
    }
}

fn sizes_of(info: &ValueInfo) -> Result<Vec<usize>, String> {
    let name = &info.name;
    let shape = info
        .r#type
        .as_ref()
        .and_then(|t| t.tensor_type.as_ref())
        .and_then(|t| t.shape.as_ref())
        .ok_or_else(|| format!("the input `{name}` has no shape"))?;
    let sizes = shape.dim.iter().enumerate().map(|(i, dim)| match dim.dim_value {
        1.. => usize::try_from(dim.dim_value).map_err(|e| e.to_string()),
        // Policies are exported for batches of any size; one decision is a batch of one.
        _ if i == 0 => Ok(1),
        _ => Err(format!(
            "the input `{name}` has a dynamic size `{}` at axis {i}: export the policy with fixed sizes",
            dim.dim_param
        )),
    });
    sizes.collect()
}

/// Where the values of an image `[channel][row][column]` are in one of `[row][column][channel]`.
fn image_places(channels: usize, rows: usize, cols: usize) -> Vec<u32> {
    let mut places = Vec::with_capacity(channels * rows * cols);
    for channel in 0..channels {
        places.extend((0..rows * cols).map(|pixel| (pixel * channels + channel) as u32));
    }
    places
}

const WIDE_PADDING: &str = "padding as large as the kernel is not supported";

fn not_square(height: usize, width: usize) -> String {
    format!("a kernel of {height} × {width} is not supported: squares only")
}

fn identity(len: usize) -> Rc<Vec<u32>> {
    Rc::new((0..len as u32).collect())
}

fn positive(value: i64, what: &str) -> Result<usize, String> {
    usize::try_from(value)
        .ok()
        .filter(|v| *v > 0 && *v <= 1 << 20)
        .ok_or_else(|| format!("{what} of {value}"))
}

impl<'a> Importer<'a> {
    fn new(graph: &'a Graph, action: &'a str, needed: &Needed<'a>) -> Result<Self, String> {
        let mut importer = Self {
            network: Network::default(),
            params: Vec::new(),
            lens: Vec::new(),
            tensors: HashMap::new(),
            uses: HashMap::new(),
            recurrent_weights: Vec::new(),
            pieces: needed.pieces.clone(),
        };
        let initializers = graph.initializer.iter();
        for tensor in initializers.filter(|tensor| needed.tensors.contains(tensor.name.as_str())) {
            let constant = Constant::of(tensor).map_err(|e| format!("the tensor `{}`: {e}", tensor.name))?;
            importer
                .tensors
                .insert(&tensor.name, Value::Constant(Rc::new(constant)));
        }
        let nodes = graph.node.iter().zip(&needed.nodes).filter(|(_, needed)| **needed);
        let read = nodes.flat_map(|(node, _)| node.input.iter().map(String::as_str));
        for name in read.chain([action]) {
            *importer.uses.entry(name).or_default() += 1;
        }
        Ok(importer)
    }

    fn inputs(
        &mut self,
        graph: &'a Graph,
        action: &str,
        needed: &Needed<'a>,
        flat: Option<Flat>,
    ) -> Result<Frame, String> {
        let mut found: Option<Frame> = None;
        let mut positions = 0;
        // Old exports list the weights among the inputs.
        let weights: HashSet<&str> = graph.initializer.iter().map(|tensor| tensor.name.as_str()).collect();
        let real = graph.input.iter().filter(|input| {
            let name = input.name.as_str();
            needed.tensors.contains(name) && !weights.contains(name)
        });
        let real: Vec<&ValueInfo> = real.collect();
        if let Some(flat) = flat {
            return match real.as_slice() {
                [info] => self.flat_input(info, flat),
                _ => Err(format!("it has {} inputs; --flat is for policies with one", real.len())),
            };
        }
        for (number, info) in real.into_iter().enumerate() {
            let shape = sizes_of(info)?;
            let len = len_of(&shape)?;
            let places = match *shape.as_slice() {
                [1, a, b, c] if found.is_none() => {
                    let channels_last = is_channels_last(graph, needed, &info.name).unwrap_or(c < a);
                    let (rows, cols, channels) = if channels_last { (a, b, c) } else { (b, c, a) };
                    found = Some(Frame {
                        rows,
                        cols,
                        channels,
                        input: number,
                        has_position: false,
                    });
                    match channels_last {
                        true => identity(len),
                        false => Rc::new(image_places(channels, rows, cols)),
                    }
                }
                [1, 2] if positions == 0 => {
                    positions += 1;
                    identity(len)
                }
                _ => {
                    let more = match *shape.as_slice() {
                        [1, _] => "; if it is a frame's values in a row, say so with --flat",
                        _ => "; a state that goes from one decision to the next is not supported",
                    };
                    return Err(format!(
                        "the input `{}` has the shape {shape:?}; a policy gets one frame [1, channels, rows, columns] (or \
                         channels last, if it is transposed first), and beside it [1, 2], distance and bearing of the goal{more}",
                        info.name
                    ));
                }
            };
            let layer = self.push(Layer::Input { len }, Vec::new(), len)?;
            self.tensors.insert(
                &info.name,
                Value::Live(Live {
                    layer,
                    shape,
                    places,
                    alone: true,
                }),
            );
        }
        let frame = found.ok_or_else(|| {
            format!(
                "the action `{action}` depends on no frame: none of shape [1, channels, rows, columns] among the inputs that it is \
                 computed from"
            )
        })?;
        Ok(Frame {
            has_position: positions == 1,
            ..frame
        })
    }

    /// The one input of a policy that takes its frame as a row of values.
    fn flat_input(&mut self, info: &'a ValueInfo, flat: Flat) -> Result<Frame, String> {
        let shape = sizes_of(info)?;
        let [a, b, c] = flat.frame;
        let (rows, cols, channels) = if c < a { (a, b, c) } else { (b, c, a) };
        let len = len_of(&flat.frame)?;
        let has_position = flat.goal != FlatGoal::None;
        let wanted = len + if has_position { 2 } else { 0 };
        if shape != [1, wanted] {
            return Err(format!(
                "the input `{}` has the shape {shape:?}; --flat says [1, {wanted}], a frame of {rows} × {cols} with {channels} channels{}",
                info.name,
                if has_position { " and the goal" } else { "" }
            ));
        }
        let of_frame = match c < a {
            true => (0..len as u32).collect(),
            false => image_places(channels, rows, cols),
        };
        let mut layer = self.push(Layer::Input { len }, Vec::new(), len)?;
        let mut places = of_frame;
        if has_position {
            let goal = self.push(Layer::Input { len: 2 }, Vec::new(), 2)?;
            let parts = vec![layer, goal];
            layer = self.push(Layer::Concat { parts }, Vec::new(), wanted)?;
            let of_goal = [len as u32, len as u32 + 1];
            match flat.goal {
                FlatGoal::First => places.splice(0..0, of_goal).for_each(drop),
                _ => places.extend(of_goal),
            }
        }
        let value = self.fresh(layer, shape, Rc::new(places));
        self.tensors.insert(&info.name, value);
        Ok(Frame {
            rows,
            cols,
            channels,
            input: 0,
            has_position,
        })
    }

    /// Ends with the action: two values in their order.
    fn output(&mut self, name: &str) -> Result<(), String> {
        let Some(Value::Live(live)) = self.tensors.get(name).cloned() else {
            return Err(format!("the output `{name}` does not depend on an input"));
        };
        let len = live.places.len();
        if len != 2 {
            return Err(format!(
                "the output `{name}` has {len} values; an action has 2, forward speed and yaw"
            ));
        }
        let in_order = live.places.iter().enumerate().all(|(i, place)| *place as usize == i);
        self.network.output = match in_order && self.lens.get(live.layer) == Some(&len) {
            true => live.layer,
            false => {
                let straight: Vec<f32> = (0..len * len).map(|i| f32::from(i % (len + 1) == 0)).collect();
                self.dense(&live, &straight, len, None)?.layer
            }
        };
        Ok(())
    }

    /// The layer of a node or of its output, by name.
    fn split_point(&self, graph: &Graph, name: &str, params: &[f32], frame_input: usize) -> Result<usize, String> {
        let outputs = graph
            .node
            .iter()
            .filter_map(|node| Some((&node.name, node.output.first()?)));
        let named = outputs.clone().find(|(node, output)| *node == name || *output == name);
        let whole = |tensor: &str| match self.tensors.get(tensor) {
            Some(Value::Live(live)) if self.lens.get(live.layer) == Some(&live.places.len()) => Some(live.layer),
            _ => None,
        };
        let refused = match named.map(|(_, output)| whole(output)) {
            None => format!("there is no node or value `{name}`"),
            Some(None) if named.is_some_and(|(_, output)| !self.tensors.contains_key(output.as_str())) => {
                format!("`{name}` is nothing that the action is computed from")
            }
            Some(None) => format!("`{name}` is no layer of its own here: only values are moved there"),
            Some(Some(layer)) => match self.network.head(params, layer, frame_input) {
                Ok(_) => return Ok(layer),
                Err(e) => format!("`{name}`: {e}"),
            },
        };
        let possible = outputs.filter(|(_, output)| {
            whole(output).is_some_and(|layer| self.network.head(params, layer, frame_input).is_ok())
        });
        let possible: Vec<&str> = possible.map(|(_, output)| output.as_str()).collect();
        Err(match possible.is_empty() {
            true => format!("{refused}; no value of it can be the split point"),
            false => format!("{refused}; these can be the split point: {}", possible.join(", ")),
        })
    }

    fn push(&mut self, layer: Layer, params: Vec<f32>, len: usize) -> Result<usize, String> {
        if len as u64 > MOST_VALUES {
            return Err(format!("it has {len} values, the limit is {MOST_VALUES}"));
        }
        self.network.layers.push(layer);
        self.params.push(params);
        self.lens.push(len);
        Ok(self.lens.len() - 1)
    }

    fn input<'n>(&self, node: &'n Node, i: usize) -> Result<(&'n str, Value), String> {
        let name = node.input.get(i).filter(|name| !name.is_empty());
        let name = name.ok_or_else(|| format!("input {i} is missing"))?;
        let value = self.tensors.get(name.as_str()).cloned();
        Ok((
            name,
            value.ok_or_else(|| format!("nothing computes its input `{name}`"))?,
        ))
    }

    fn live(&self, node: &Node, i: usize) -> Result<Live, String> {
        match self.input(node, i)? {
            (name, Value::Live(mut live)) => {
                live.alone &= self.uses.get(name) == Some(&1);
                Ok(live)
            }
            (name, Value::Constant(_)) => Err(format!("its input `{name}` is a constant")),
        }
    }

    fn constant(&self, node: &Node, i: usize) -> Result<Rc<Constant>, String> {
        match self.input(node, i)? {
            (_, Value::Constant(constant)) => Ok(constant),
            (name, Value::Live(_)) => Err(format!("its input `{name}` has to be a constant")),
        }
    }

    fn optional(&self, node: &Node, i: usize) -> Result<Option<Rc<Constant>>, String> {
        match node.input.get(i).is_none_or(String::is_empty) {
            true => Ok(None),
            false => self.constant(node, i).map(Some),
        }
    }

    fn node(&mut self, node: &'a Node) -> Result<(), String> {
        let settings = Settings(&node.attribute);
        let unknown = || format!("this operator is not supported; there are {KNOWN}");
        if !(node.domain.is_empty() || node.domain == "ai.onnx") {
            return Err(unknown());
        }
        if node
            .output
            .first()
            .is_some_and(|name| self.pieces.contains(name.as_str()))
        {
            let (_, softplus) = self.input(node, 2)?;
            return self.set(node, 0, softplus);
        }
        if let Some(constant) = self.folded(node, &settings)? {
            return self.set(node, 0, Value::Constant(Rc::new(constant)));
        }
        let result = match node.op_type.as_str() {
            "Relu" => self.curve(node, Activation::Relu)?,
            "Tanh" => self.curve(node, Activation::TANH)?,
            "Sigmoid" => self.curve(node, Activation::Sigmoid)?,
            "Elu" if settings.real("alpha", 1.0) == 1.0 => self.curve(node, Activation::Elu)?,
            "Elu" => self.function(
                node,
                Function::Elu {
                    alpha: settings.real("alpha", 1.0),
                },
            )?,
            "LeakyRelu" => self.function(
                node,
                Function::LeakyRelu {
                    alpha: settings.real("alpha", 0.01),
                },
            )?,
            "Softplus" => self.function(node, Function::Softplus)?,
            "Exp" => self.function(node, Function::Exp)?,
            "Log" => self.function(node, Function::Log)?,
            "Abs" => self.function(node, Function::Abs)?,
            "Erf" => self.function(node, Function::Erf)?,
            "Sqrt" => self.function(node, Function::Power { exponent: 0.5 })?,
            "Reciprocal" => self.function(node, Function::Power { exponent: -1.0 })?,
            "Neg" => {
                let x = self.live(node, 0)?;
                self.moved_by(&x, -1.0, 0.0)?
            }
            "Clip" => self.clip(node, &settings)?,
            "Max" | "Min" | "Sum" => self.of_several(node)?,
            "Pow" => self.power(node)?,
            "Selu" | "Celu" | "PRelu" | "Softsign" | "HardSigmoid" | "HardSwish" | "Mish" | "Gelu" | "Swish" => {
                self.composed(node, &settings)?
            }
            "LayerNormalization" => self.layer_norm(node, &settings)?,
            "ReduceMean" | "ReduceSum" => self.reduce(node, &settings)?,
            "Gemm" => self.gemm(node, &settings)?,
            "MatMul" => self.mat_mul(node)?,
            "Conv" => self.conv(node, &settings)?,
            "MaxPool" | "GlobalMaxPool" => self.max_pool(node, &settings)?,
            "ReduceMax" => self.reduce_max(node, &settings)?,
            "AveragePool" => self.average_pool(node, &settings)?,
            "GlobalAveragePool" => self.global_average(node)?,
            "BatchNormalization" => self.batch_norm(node, &settings)?,
            "Add" | "Sub" | "Mul" | "Div" => self.affine(node)?,
            "GRU" | "LSTM" => return self.recurrent(node, &settings),
            "Concat" => self.concat(node, &settings)?,
            "Split" => return self.split(node, &settings),
            "Constant" => {
                let tensor = settings.get("value").and_then(|attribute| attribute.t.as_ref());
                let given = |name: &str| settings.get(name);
                let constant = if let Some(tensor) = tensor {
                    Constant::of(tensor)?
                } else if let Some(list) = given("value_ints") {
                    Constant::row(Data::Whole(list.ints.clone()))
                } else if let Some(list) = given("value_floats") {
                    Constant::row(Data::Real(list.floats.clone()))
                } else if let Some(one) = given("value_int") {
                    Constant::one(Data::Whole(vec![one.i]))
                } else if let Some(one) = given("value_float") {
                    Constant::one(Data::Real(vec![one.f]))
                } else {
                    return Err("it holds no tensor of numbers".to_owned());
                };
                Value::Constant(Rc::new(constant))
            }
            "Shape" => {
                let (_, value) = self.input(node, 0)?;
                let sizes: Vec<i64> = shape_of(&value).iter().map(|size| *size as i64).collect();
                Value::Constant(Rc::new(Constant {
                    shape: vec![sizes.len()],
                    data: Data::Whole(sizes),
                }))
            }
            "Identity" | "Dropout" | "Cast" | "Reshape" | "Flatten" | "Squeeze" | "Unsqueeze" | "Transpose"
            | "Slice" | "Gather" | "Expand" => self.movement(node, &settings)?,
            _ => return Err(unknown()),
        };
        self.set(node, 0, result)
    }

    /// The constant that a node is whose inputs are all constants, if it is one that is known.
    fn folded(&self, node: &Node, settings: &Settings<'_>) -> Result<Option<Constant>, String> {
        let mut operator = node.op_type.as_str();
        let mut given = Vec::new();
        for (i, _) in node.input.iter().enumerate().filter(|(_, name)| !name.is_empty()) {
            match self.input(node, i)?.1 {
                Value::Constant(constant) => given.push(constant),
                Value::Live(_) => return Ok(None),
            }
        }
        let Some(first) = given.first() else {
            return Ok(None);
        };
        match operator {
            "Clip" if node.input.get(1).is_none_or(String::is_empty) && given.len() == 2 => operator = "Min",
            "Reshape" | "Flatten" | "Squeeze" | "Unsqueeze" | "Transpose" | "Slice" | "Gather" | "Identity"
            | "Dropout" | "Concat" | "Split" | "Shape" => return Ok(None),
            "Cast" => return first.cast(settings.whole("to", 1)).map(Some),
            "ConstantOfShape" => {
                let shape: Option<Vec<usize>> = first.whole()?.iter().map(|size| usize::try_from(*size).ok()).collect();
                let shape = shape.ok_or("a shape with a negative size")?;
                let value = match settings.get("value").and_then(|attribute| attribute.t.as_ref()) {
                    Some(tensor) => Constant::of(tensor)?,
                    None => Constant::one(Data::Real(vec![0.0])),
                };
                let places = vec![0; len_of(&shape)?];
                return Ok(Some(value.moved(shape, &places)));
            }
            "Expand" => {
                let wanted = given.get(1).ok_or("it has no shape")?;
                let (shape, places) = expanded(&first.shape, wanted)?;
                return Ok(Some(first.moved(shape, &places)));
            }
            "ReduceMean" | "ReduceSum" | "ReduceProd" | "ReduceMax" | "ReduceMin" => {
                let (along, shape) = self.reduction(node, settings, &first.shape)?;
                return fold::reduce(operator, first, &along, shape).map(Some);
            }
            _ => {}
        }
        let constant = fold::fold(operator, &given)?;
        match &constant {
            Some(Constant {
                data: Data::Real(values),
                ..
            }) if !values.iter().all(|value| value.is_finite()) => {
                Err("what it makes of constants is not finite".to_owned())
            }
            _ => Ok(constant),
        }
    }

    /// Along which axes a reduction goes, and the shape that it leaves.
    fn reduction(
        &self,
        node: &Node,
        settings: &Settings<'_>,
        shape: &[usize],
    ) -> Result<(Vec<bool>, Vec<usize>), String> {
        let axes = self.list(node, settings, "axes", 1)?;
        let [keep, noop] =
            [("keepdims", 1), ("noop_with_empty_axes", 0)].map(|(name, usual)| settings.whole(name, usual) != 0);
        fold::reduced(shape, axes.as_deref(), keep, noop)
    }

    fn set(&mut self, node: &'a Node, i: usize, value: Value) -> Result<(), String> {
        let name = node.output.get(i).ok_or("it has no output")?;
        if self.tensors.insert(name, value).is_some() {
            return Err(format!("its output `{name}` is computed twice"));
        }
        Ok(())
    }

    /// A whole layer that was made for this.
    fn fresh(&self, layer: usize, shape: Vec<usize>, places: Rc<Vec<u32>>) -> Value {
        Value::Live(Live {
            layer,
            shape,
            places,
            alone: true,
        })
    }

    /// A part of a layer that is one run of it, as a layer of its own; others as they are.
    fn narrowed(&mut self, live: &Live) -> Result<Live, String> {
        let (Some(least), Some(most)) = (live.places.iter().min(), live.places.iter().max()) else {
            return Err("it has no values".to_owned());
        };
        let (from, len) = (*least as usize, (most - least) as usize + 1);
        let own = self.lens.get(live.layer).copied().unwrap_or(0);
        if len == own || len > live.places.len() {
            return Ok(live.clone());
        }
        let layer = self.push(
            Layer::Slice {
                x: live.layer,
                from,
                len,
            },
            Vec::new(),
            len,
        )?;
        let places = live.places.iter().map(|place| place - least).collect();
        Ok(Live {
            layer,
            shape: live.shape.clone(),
            places: Rc::new(places),
            alone: true,
        })
    }

    /// `y = x W + b` with `W` `[x's values][outputs]`.
    fn dense(&mut self, x: &Live, weights: &[f32], outputs: usize, bias: Option<&[f32]>) -> Result<Live, String> {
        let x = self.narrowed(x)?;
        let inputs = self.lens.get(x.layer).copied().unwrap_or(0);
        let len = len_of(&[inputs + 1, outputs])?;
        if weights.len() != x.places.len() * outputs || outputs == 0 {
            return Err(format!(
                "weights of {} values for {} inputs and {outputs} outputs",
                weights.len(),
                x.places.len()
            ));
        }
        let mut params = vec![0.0; len];
        for (row, place) in weights.chunks_exact(outputs).zip(x.places.iter()) {
            let at = *place as usize * outputs;
            // One value may stand in two places of the tensor.
            for (to, from) in params[at..at + outputs].iter_mut().zip(row) {
                *to += from;
            }
        }
        if let Some(bias) = bias {
            let bias = broadcast(bias, outputs)?;
            params[inputs * outputs..].copy_from_slice(&bias);
        }
        let layer = Layer::Dense {
            x: x.layer,
            layer: Dense { inputs, outputs },
            curve: Activation::Identity,
        };
        let layer = self.push(layer, params, outputs)?;
        Ok(Live {
            layer,
            shape: vec![1, outputs],
            places: identity(outputs),
            alone: true,
        })
    }

    fn gemm(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        settings.only("transA", 0)?;
        let (x, w) = (self.live(node, 0)?, self.constant(node, 1)?);
        let (alpha, beta) = (settings.real("alpha", 1.0), settings.real("beta", 1.0));
        let [rows, cols] = *w.shape.as_slice() else {
            return Err(format!("weights of shape {:?}", w.shape));
        };
        let turned = settings.whole("transB", 0) != 0;
        let (inputs, outputs) = if turned { (cols, rows) } else { (rows, cols) };
        let values = w.real()?;
        let weights: Vec<f32> = match turned {
            true => (0..values.len())
                .map(|i| alpha * values[(i % outputs) * inputs + i / outputs])
                .collect(),
            false => values.iter().map(|value| alpha * value).collect(),
        };
        let bias = self.optional(node, 2)?;
        let bias: Option<Vec<f32>> = match &bias {
            Some(bias) => Some(bias.real()?.iter().map(|value| beta * value).collect()),
            None => None,
        };
        Ok(Value::Live(self.dense(&x, &weights, outputs, bias.as_deref())?))
    }

    fn mat_mul(&mut self, node: &Node) -> Result<Value, String> {
        let (x, w) = (self.live(node, 0)?, self.constant(node, 1)?);
        let [inputs, outputs] = *w.shape.as_slice() else {
            return Err(format!("weights of shape {:?}", w.shape));
        };
        if x.places.len() != inputs {
            return Err(format!("{:?} times {:?}: one row only", x.shape, w.shape));
        }
        let mut live = self.dense(&x, w.real()?, outputs, None)?;
        live.shape = x.shape.clone();
        if let Some(last) = live.shape.last_mut() {
            *last = outputs;
        }
        Ok(Value::Live(live))
    }

    /// The layer of an image, and its channels, rows and columns.
    fn image(&mut self, node: &Node) -> Result<(usize, [usize; 3]), String> {
        let x = self.live(node, 0)?;
        let [1, channels, rows, cols] = *x.shape.as_slice() else {
            return Err(format!(
                "an input of shape {:?} instead of [1, channels, rows, columns]",
                x.shape
            ));
        };
        let x = self.narrowed(&x)?;
        let whole = self.lens.get(x.layer) == Some(&x.places.len());
        if !whole || *x.places != image_places(channels, rows, cols) {
            return Err("the values of its image were put in another order before; that is not supported".to_owned());
        }
        Ok((x.layer, [channels, rows, cols]))
    }

    /// Stride, padding and dilation, which have to be the same both ways.
    fn window(settings: &Settings<'_>) -> Result<[usize; 3], String> {
        if let Some(pad) = settings
            .word("auto_pad")
            .filter(|pad| pad != "NOTSET" && pad != "VALID")
        {
            return Err(format!(
                "auto_pad = {pad} is not supported: export it with explicit padding"
            ));
        }
        settings.only("ceil_mode", 0)?;
        let same = |what: &str, default: i64| match settings.list(what) {
            None | Some([]) => Ok(default),
            Some([first, rest @ ..]) if rest.iter().all(|other| other == first) => Ok(*first),
            Some(other) => Err(format!(
                "{what} = {other:?} is not supported: the same on all sides only"
            )),
        };
        let padding = usize::try_from(same("pads", 0)?).map_err(|_| "negative padding is not supported".to_owned())?;
        let [stride, dilation] = ["strides", "dilations"].map(|what| same(what, 1).and_then(|n| positive(n, what)));
        Ok([stride?, padding, dilation?])
    }

    /// A square kernel with its stride and padding, for pooling.
    fn square(settings: &Settings<'_>) -> Result<[usize; 3], String> {
        let (height, width) = Self::kernel_shape(settings)?;
        if height != width {
            return Err(not_square(height, width));
        }
        match Self::window(settings)? {
            [stride, padding, 1] if padding < height => Ok([height, stride, padding]),
            [_, _, 1] => Err(WIDE_PADDING.to_owned()),
            _ => Err("dilations of pooling are not supported".to_owned()),
        }
    }

    fn convolve(&mut self, x: usize, layer: Conv2d, params: Vec<f32>) -> Result<Value, String> {
        layer.validate().map_err(|e| e.to_string())?;
        let (rows, cols, filters) = (layer.out_rows(), layer.out_cols(), layer.filters);
        let len = len_of(&[rows, cols, filters])?;
        let curve = Activation::Identity;
        let layer = self.push(Layer::Conv2d { x, layer, curve }, params, len)?;
        let places = Rc::new(image_places(filters, rows, cols));
        Ok(self.fresh(layer, vec![1, filters, rows, cols], places))
    }

    fn conv(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let (x, [channels, rows, cols]) = self.image(node)?;
        let w = self.constant(node, 1)?;
        let [filters, depth, height, width] = *w.shape.as_slice() else {
            return Err(format!("weights of shape {:?}: two dimensions only", w.shape));
        };
        let groups = positive(settings.whole("group", 1), "group")?;
        if depth * groups != channels || !filters.is_multiple_of(groups) {
            return Err(format!(
                "weights of shape {:?} in {groups} groups for {channels} channels",
                w.shape
            ));
        }
        if height != width {
            return Err(not_square(height, width));
        }
        let [stride, padding, dilation] = Self::window(settings)?;
        // A dilated kernel is a larger one with zeros between.
        let kernel = (height - 1).saturating_mul(dilation).saturating_add(1);
        if padding >= kernel {
            return Err(WIDE_PADDING.to_owned());
        }
        let layer = Conv2d {
            rows,
            cols,
            channels,
            filters,
            kernel,
            stride,
            padding,
        };
        let taps = len_of(&[kernel, kernel, channels, filters])?;
        let mut params = vec![0.0; taps + filters];
        for (i, value) in w.real()?.iter().enumerate() {
            let (filter, rest) = (i / (depth * height * width), i % (depth * height * width));
            let (channel, tap) = (rest / (height * width), rest % (height * width));
            let tap = (tap / width * kernel + tap % width) * dilation;
            let channel = filter / (filters / groups) * depth + channel;
            params[(tap * channels + channel) * filters + filter] = *value;
        }
        if let Some(bias) = self.optional(node, 2)? {
            params[taps..].copy_from_slice(&broadcast(bias.real()?, filters)?);
        }
        self.convolve(x, layer, params)
    }

    fn kernel_shape(settings: &Settings<'_>) -> Result<(usize, usize), String> {
        match settings.list("kernel_shape") {
            Some([height, width]) => Ok((positive(*height, "kernel")?, positive(*width, "kernel")?)),
            other => Err(format!("kernel_shape = {other:?}")),
        }
    }

    fn max_pool(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let (x, [channels, rows, cols]) = self.image(node)?;
        let whole = match node.op_type.as_str() {
            "MaxPool" => Self::kernel_shape(settings)? == (rows, cols),
            _ => true,
        };
        let layer = MaxPool2d::tiles(rows, cols, channels, 1);
        let layer = match whole
            && settings
                .list("pads")
                .is_none_or(|pads| pads.iter().all(|pad| *pad == 0))
        {
            true => MaxPool2d {
                window: [rows, cols],
                ..layer
            },
            false => {
                let [window, stride, padding] = Self::square(settings)?;
                MaxPool2d {
                    window: [window; 2],
                    stride,
                    padding,
                    ..layer
                }
            }
        };
        layer.validate().map_err(|e| e.to_string())?;
        let (rows, cols) = (layer.out_rows(), layer.out_cols());
        let layer = self.push(Layer::MaxPool2d { x, layer }, Vec::new(), rows * cols * channels)?;
        let places = Rc::new(image_places(channels, rows, cols));
        Ok(self.fresh(layer, vec![1, channels, rows, cols], places))
    }

    /// A convolution whose weights are all the same, each channel for itself.
    fn average_pool(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let (x, [channels, rows, cols]) = self.image(node)?;
        let [kernel, stride, padding] = Self::square(settings)?;
        if padding != 0 && settings.whole("count_include_pad", 0) == 0 {
            return Err("padding that does not count is not supported: count_include_pad = 1, or none".to_owned());
        }
        let layer = Conv2d {
            rows,
            cols,
            channels,
            filters: channels,
            kernel,
            stride,
            padding,
        };
        let mut params = vec![0.0; len_of(&[kernel, kernel, channels, channels])? + channels];
        for tap in 0..kernel * kernel {
            for channel in 0..channels {
                params[(tap * channels + channel) * channels + channel] = 1.0 / (kernel * kernel) as f32;
            }
        }
        self.convolve(x, layer, params)
    }

    fn global_average(&mut self, node: &Node) -> Result<Value, String> {
        let x = self.live(node, 0)?;
        let [1, channels, rows, cols] = *x.shape.as_slice() else {
            return Err(format!(
                "an input of shape {:?} instead of [1, channels, rows, columns]",
                x.shape
            ));
        };
        let pixels = rows * cols;
        let mut weights = vec![0.0; len_of(&[channels, pixels, channels])?];
        for i in 0..channels * pixels {
            weights[i * channels + i / pixels] = 1.0 / pixels as f32;
        }
        let mut live = self.dense(&x, &weights, channels, None)?;
        live.shape = vec![1, channels, 1, 1];
        Ok(Value::Live(live))
    }

    fn batch_norm(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        settings.only("training_mode", 0)?;
        let x = self.live(node, 0)?;
        let Some(channels) = x.shape.get(1).copied() else {
            return Err(format!("an input of shape {:?}", x.shape));
        };
        let epsilon = settings.real("epsilon", 1e-5);
        let rows: Vec<Rc<Constant>> = (1..5).map(|i| self.constant(node, i)).collect::<Result<_, _>>()?;
        let row = |i: usize| rows[i].real();
        if rows.iter().any(|row| row.len() != channels) {
            return Err(format!("statistics for another number than {channels} channels"));
        }
        // As factors and summands, so that they can go into the layer before.
        let (mut factors, mut summands) = (Vec::new(), Vec::new());
        for channel in 0..channels {
            let [scale, shift, mean, variance] =
                [row(0)?[channel], row(1)?[channel], row(2)?[channel], row(3)?[channel]].map(f64::from);
            if variance + f64::from(epsilon) <= 0.0 {
                return Err(format!("channel {channel} has a variance of {variance}"));
            }
            let factor = scale / (variance + f64::from(epsilon)).sqrt();
            factors.push(factor as f32);
            summands.push((shift - factor * mean) as f32);
        }
        let inner = x.places.len() / channels.max(1);
        let each = |values: &[f32]| -> Vec<f32> { (0..x.places.len()).map(|i| values[i / inner]).collect() };
        let (factors, summands) = (each(&factors), each(&summands));
        self.scaled(&x, &factors, &summands)
    }

    /// An input of a node; of values, with whether nothing else uses them.
    fn operand(&self, node: &Node, i: usize) -> Result<Value, String> {
        match self.input(node, i)?.1 {
            Value::Live(_) => self.live(node, i).map(Value::Live),
            constant => Ok(constant),
        }
    }

    fn affine(&mut self, node: &Node) -> Result<Value, String> {
        let (a, b) = (self.operand(node, 0)?, self.operand(node, 1)?);
        self.arithmetic(&node.op_type, &a, &b)
    }

    /// A sum, difference, product or quotient, of which one at least depends on the inputs.
    fn arithmetic(&mut self, operator: &str, a: &Value, b: &Value) -> Result<Value, String> {
        let (x, constant, swapped) = match (a, b) {
            (Value::Live(x), Value::Constant(constant)) => (x, constant, false),
            (Value::Constant(constant), Value::Live(x)) => (x, constant, true),
            (Value::Live(a), Value::Live(b)) => {
                let b = match operator {
                    "Sub" => self.moved_by(b, -1.0, 0.0)?,
                    "Div" => self.through(b, Function::Power { exponent: -1.0 })?,
                    _ => Value::Live(b.clone()),
                };
                let Value::Live(b) = b else {
                    return Err("a divisor that is a constant".to_owned());
                };
                return self.both(a, &b, matches!(operator, "Mul" | "Div"));
            }
            _ => return Err("constants of which one is of whole numbers, the other of real ones".to_owned()),
        };
        let x = spread_live(x, &fold::broadcast_shape(&x.shape, &constant.shape)?)?;
        let values = spread(constant, &x.shape)?;
        let n = values.len();
        let negated = || values.iter().map(|value| -value).collect::<Vec<f32>>();
        let (factors, summands) = match (operator, swapped) {
            ("Add", _) => (vec![1.0; n], values),
            ("Sub", false) => (vec![1.0; n], negated()),
            ("Sub", true) => (vec![-1.0; n], values),
            ("Mul", _) => (values, vec![0.0; n]),
            ("Div", false) => (values.iter().map(|value| 1.0 / value).collect(), vec![0.0; n]),
            _ => {
                let Value::Live(inverse) = self.through(&x, Function::Power { exponent: -1.0 })? else {
                    return Err("a divisor that is a constant".to_owned());
                };
                return self.scaled(&inverse, &values, &vec![0.0; n]);
            }
        };
        if !factors.iter().all(|factor| factor.is_finite()) {
            return Err("it divides by zero".to_owned());
        }
        self.scaled(&x, &factors, &summands)
    }

    /// `y = factor · x + summand`.
    fn moved_by(&mut self, x: &Live, factor: f32, summand: f32) -> Result<Value, String> {
        let n = x.places.len();
        self.scaled(x, &vec![factor; n], &vec![summand; n])
    }

    /// The values in the tensor's order as a layer of their own.
    fn arranged(&mut self, x: &Live) -> Result<usize, String> {
        self.arranged_as(x, &identity(x.places.len()))
    }

    /// A layer of the values, each at the place that `order` has for it; `order` has each place once.
    fn arranged_as(&mut self, x: &Live, order: &[u32]) -> Result<usize, String> {
        let x = self.narrowed(x)?;
        let (own, n) = (self.lens.get(x.layer).copied().unwrap_or(0), x.places.len());
        if own == n && *x.places == order {
            return Ok(x.layer);
        }
        if own.saturating_mul(n) > MOST_REARRANGED {
            return Err(format!(
                "{n} values that were put in another order before are met by others; as many as {} can be put back",
                MOST_REARRANGED.isqrt()
            ));
        }
        let mut params = vec![0.0; (own + 1) * n];
        for (place, to) in x.places.iter().zip(order) {
            params[*place as usize * n + *to as usize] = 1.0;
        }
        let layer = Layer::Dense {
            x: x.layer,
            layer: Dense {
                inputs: own,
                outputs: n,
            },
            curve: Activation::Identity,
        };
        self.push(layer, params, n)
    }

    /// Whether the values are all those of a layer, each once, as an image's are.
    fn is_whole(&self, x: &Live) -> bool {
        let n = x.places.len();
        let mut seen = vec![false; n];
        let each_once = x.places.iter().all(|place| {
            let slot = seen.get_mut(*place as usize);
            slot.is_some_and(|slot| !std::mem::replace(slot, true))
        });
        each_once && self.lens.get(x.layer) == Some(&n)
    }

    /// The sum or the product of two that both depend on the inputs, in the order of one that is a whole layer.
    fn both(&mut self, a: &Live, b: &Live, multiply: bool) -> Result<Value, String> {
        let shape = fold::broadcast_shape(&a.shape, &b.shape)?;
        let (a, b) = (spread_live(a, &shape)?, spread_live(b, &shape)?);
        let (a, b) = (self.narrowed(&a)?, self.narrowed(&b)?);
        let n = a.places.len();
        let places = match (self.is_whole(&a), self.is_whole(&b)) {
            (true, _) => a.places.clone(),
            (_, true) => b.places.clone(),
            _ => identity(n),
        };
        let (x, y) = (self.arranged_as(&a, &places)?, self.arranged_as(&b, &places)?);
        let layer = match multiply {
            true => Layer::Product { x, y },
            false => Layer::Sum { parts: vec![x, y] },
        };
        let layer = self.push(layer, Vec::new(), n)?;
        Ok(self.fresh(layer, shape, places))
    }

    fn function(&mut self, node: &Node, function: Function) -> Result<Value, String> {
        let x = self.live(node, 0)?;
        self.through(&x, function)
    }

    /// A function of each value.
    fn through(&mut self, x: &Live, function: Function) -> Result<Value, String> {
        let x = self.narrowed(x)?;
        let len = self.lens.get(x.layer).copied().unwrap_or(0);
        let layer = self.push(Layer::Function { x: x.layer, function }, Vec::new(), len)?;
        Ok(self.fresh(layer, x.shape, x.places))
    }

    /// One of the curves of layers, as a layer of its own.
    fn curved(&mut self, x: &Live, curve: Activation) -> Result<Live, String> {
        let x = self.narrowed(x)?;
        let len = self.lens.get(x.layer).copied().unwrap_or(0);
        let layer = self.push(Layer::Curve { x: x.layer, curve }, Vec::new(), len)?;
        Ok(Live {
            layer,
            alone: true,
            ..x
        })
    }

    fn clip(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let mut bounds = [f32::NEG_INFINITY, f32::INFINITY];
        for (i, (bound, name)) in bounds.iter_mut().zip(["min", "max"]).enumerate() {
            if let Some(constant) = self.optional(node, i + 1)? {
                match constant.real()? {
                    [one] => *bound = *one,
                    all => return Err(format!("{name} has {} values; one is allowed", all.len())),
                }
            } else if let Some(attribute) = settings.get(name) {
                *bound = attribute.f;
            }
        }
        let [least, most] = bounds;
        self.function(node, Function::Clip { least, most })
    }

    /// The largest, the least or the sum of any number.
    fn of_several(&mut self, node: &Node) -> Result<Value, String> {
        let mut all = self.operand(node, 0)?;
        for i in 1..node.input.len() {
            let next = self.operand(node, i)?;
            all = match (&all, &next) {
                (Value::Constant(a), Value::Constant(b)) => {
                    let folded = fold::fold(&node.op_type, &[a.clone(), b.clone()])?;
                    Value::Constant(Rc::new(folded.ok_or("constants that are not combined")?))
                }
                _ if node.op_type == "Sum" => self.arithmetic("Add", &all, &next)?,
                _ => self.extreme(&all, &next, node.op_type == "Max")?,
            };
        }
        Ok(all)
    }

    /// The larger or the smaller of two.
    fn extreme(&mut self, a: &Value, b: &Value, larger: bool) -> Result<Value, String> {
        let bound = |constant: &Constant| match constant.real() {
            Ok([first, rest @ ..]) if rest.iter().all(|other| other == first) => Some(*first),
            _ => None,
        };
        let (x, other) = match (a, b) {
            (Value::Live(x), other) | (other, Value::Live(x)) => (x, other),
            _ => return Err("constants that are not combined".to_owned()),
        };
        // Both are read twice.
        let other = &match other {
            Value::Live(other) => Value::Live(Live {
                alone: false,
                ..other.clone()
            }),
            constant => constant.clone(),
        };
        if let Value::Constant(constant) = other
            && let Some(bound) = bound(constant)
        {
            let (least, most) = match larger {
                true => (bound, f32::INFINITY),
                false => (f32::NEG_INFINITY, bound),
            };
            let x = spread_live(x, &fold::broadcast_shape(&x.shape, &constant.shape)?)?;
            return self.through(&x, Function::Clip { least, most });
        }
        // max(x, c) = c + relu(x − c), min(x, c) = c − relu(c − x): a bound for each value, or two that both vary.
        let shared = Value::Live(Live {
            alone: false,
            ..x.clone()
        });
        let above = match larger {
            true => self.arithmetic("Sub", &shared, other)?,
            false => self.arithmetic("Sub", other, &shared)?,
        };
        let Value::Live(above) = above else {
            return Err("constants that are not combined".to_owned());
        };
        let above = Value::Live(self.curved(&above, Activation::Relu)?);
        self.arithmetic(if larger { "Add" } else { "Sub" }, other, &above)
    }

    fn power(&mut self, node: &Node) -> Result<Value, String> {
        match (self.operand(node, 0)?, self.operand(node, 1)?) {
            (Value::Live(x), Value::Constant(exponent)) => {
                let exponents: Vec<f32> = match &exponent.data {
                    Data::Real(values) => values.clone(),
                    Data::Whole(values) => values.iter().map(|value| *value as f32).collect(),
                };
                match exponents.as_slice() {
                    [first, rest @ ..] if rest.iter().all(|other| other == first) => match *first {
                        1.0 => Ok(Value::Live(x)),
                        exponent => self.through(&x, Function::Power { exponent }),
                    },
                    _ => Err("several exponents are not supported: one for all values".to_owned()),
                }
            }
            (Value::Constant(base), Value::Live(x)) => match base.real()? {
                [base] if *base > 0.0 => {
                    let Value::Live(x) = self.moved_by(&x, libm::logf(*base), 0.0)? else {
                        return Err("a constant exponent".to_owned());
                    };
                    self.through(&x, Function::Exp)
                }
                _ => Err("a base that is not one number above 0 is not supported".to_owned()),
            },
            _ => Err("a base and an exponent that both depend on the inputs are not supported".to_owned()),
        }
    }

    /// Curves that are made of others.
    fn composed(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        // It is read more than once.
        let x = Live {
            alone: false,
            ..self.live(node, 0)?
        };
        let live = |value: Value| match value {
            Value::Live(live) => Ok(live),
            Value::Constant(_) => Err("its input is a constant".to_owned()),
        };
        let gate = match node.op_type.as_str() {
            "Selu" => {
                let alpha = settings.real("alpha", 1.673_263_2);
                let y = live(self.through(&x, Function::Elu { alpha })?)?;
                return self.moved_by(&y, settings.real("gamma", 1.050_701), 0.0);
            }
            "Celu" => {
                let alpha = settings.real("alpha", 1.0);
                let y = live(self.moved_by(&x, 1.0 / alpha, 0.0)?)?;
                let y = live(self.through(&y, Function::Elu { alpha: 1.0 })?)?;
                // Above 0 it is x again.
                return self.moved_by(&y, alpha, 0.0);
            }
            "PRelu" => {
                // slope · x + (1 − slope) · relu(x)
                let slope = self.constant(node, 1)?;
                let one = Rc::new(Constant::one(Data::Real(vec![1.0])));
                let rest = fold::fold("Sub", &[one, slope.clone()])?.ok_or("slopes that are no numbers")?;
                let above = Value::Live(self.curved(&x, Activation::Relu)?);
                let above = self.arithmetic("Mul", &above, &Value::Constant(Rc::new(rest)))?;
                let below = self.arithmetic("Mul", &Value::Live(x), &Value::Constant(slope))?;
                return self.arithmetic("Add", &below, &above);
            }
            "HardSigmoid" | "HardSwish" => {
                let is_gate = node.op_type == "HardSwish";
                let (alpha, beta) = match is_gate {
                    true => (1.0 / 6.0, 0.5),
                    false => (settings.real("alpha", 0.2), settings.real("beta", 0.5)),
                };
                let y = live(self.moved_by(&x, alpha, beta)?)?;
                let y = self.through(&y, Function::Clip { least: 0.0, most: 1.0 })?;
                match is_gate {
                    true => live(y)?,
                    false => return Ok(y),
                }
            }
            "Softsign" => {
                let y = live(self.through(&x, Function::Abs)?)?;
                let y = live(self.moved_by(&y, 1.0, 1.0)?)?;
                live(self.through(&y, Function::Power { exponent: -1.0 })?)?
            }
            "Mish" => {
                let y = live(self.through(&x, Function::Softplus)?)?;
                self.curved(&y, Activation::TANH)?
            }
            "Gelu" => {
                let y = match settings.word("approximate").as_deref() {
                    Some("tanh") => {
                        let cube = live(self.through(&x, Function::Power { exponent: 3.0 })?)?;
                        let cube = live(self.moved_by(&cube, 0.044_715, 0.0)?)?;
                        let y = live(self.both(&x, &cube, false)?)?;
                        let y = live(self.moved_by(&y, (2.0 / std::f32::consts::PI).sqrt(), 0.0)?)?;
                        self.curved(&y, Activation::TANH)?
                    }
                    _ => {
                        let y = live(self.moved_by(&x, std::f32::consts::FRAC_1_SQRT_2, 0.0)?)?;
                        live(self.through(&y, Function::Erf)?)?
                    }
                };
                live(self.moved_by(&y, 0.5, 0.5)?)?
            }
            _ => {
                let y = live(self.moved_by(&x, settings.real("alpha", 1.0), 0.0)?)?;
                self.curved(&y, Activation::Sigmoid)?
            }
        };
        self.both(&x, &gate, true)
    }

    fn layer_norm(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let x = self.live(node, 0)?;
        let from = axis(settings.whole("axis", -1), x.shape.len())?;
        let width = len_of(&x.shape[from..])?;
        let scale = spread(self.constant(node, 1)?.as_ref(), &x.shape[from..])?;
        let shift = match self.optional(node, 2)? {
            Some(shift) => spread(shift.as_ref(), &x.shape[from..])?,
            None => vec![0.0; width],
        };
        let epsilon = settings.real("epsilon", 1e-5);
        if !(epsilon > 0.0 && epsilon.is_finite()) {
            return Err(format!("epsilon = {epsilon} is not supported: above 0"));
        }
        let (shape, n) = (x.shape.clone(), x.places.len());
        let x = self.narrowed(&x)?;
        // All of an image together: in its own order.
        let places = match width == n && self.is_whole(&x) {
            true => x.places.clone(),
            false => identity(n),
        };
        let mut params = [scale, shift].concat();
        if width == n {
            let ordered: Vec<f32> = params.clone();
            for (half, values) in params.chunks_exact_mut(n).zip(ordered.chunks_exact(n)) {
                places
                    .iter()
                    .zip(values)
                    .for_each(|(place, value)| half[*place as usize] = *value);
            }
        }
        let x = self.arranged_as(&x, &places)?;
        let layer = LayerNorm { width, epsilon };
        let layer = self.push(Layer::LayerNorm { x, layer }, params, n)?;
        Ok(self.fresh(layer, shape, places))
    }

    /// Means and sums along axes: a layer whose weights are all the same.
    fn reduce(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let x = self.live(node, 0)?;
        let (along, shape) = self.reduction(node, settings, &x.shape)?;
        let places = fold::reduced_places(&x.shape, &along)?;
        let (n, outputs) = (x.places.len(), len_of(&shape)?);
        let weight = match node.op_type.as_str() {
            "ReduceMean" => outputs as f32 / n as f32,
            _ => 1.0,
        };
        let mut weights = vec![0.0; len_of(&[n, outputs])?];
        for (i, place) in places.into_iter().enumerate() {
            weights[i * outputs + place] = weight;
        }
        let mut live = self.dense(&x, &weights, outputs, None)?;
        live.shape = shape;
        Ok(Value::Live(live))
    }

    /// The largest value of each channel of an image.
    fn reduce_max(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let x = self.live(node, 0)?;
        let (along, shape) = self.reduction(node, settings, &x.shape)?;
        if along != [false, false, true, true] {
            return Err("the largest of other than an image's rows and columns is not supported".to_owned());
        }
        match self.max_pool(node, settings)? {
            Value::Live(live) => Ok(Value::Live(Live { shape, ..live })),
            constant => Ok(constant),
        }
    }

    /// `y = factor · x + summand`, each value of the tensor its own: in the layer before where that is possible.
    fn scaled(&mut self, x: &Live, factors: &[f32], summands: &[f32]) -> Result<Value, String> {
        let mut len = self.lens.get(x.layer).copied().unwrap_or(0);
        let own;
        let (x, (factor, summand)) = match each_place(&x.places, len, factors, summands) {
            Some(both) => (x, both),
            // What stands in several places of the tensor has a factor for each.
            None => {
                let layer = self.arranged(x)?;
                len = x.places.len();
                own = Live {
                    layer,
                    shape: x.shape.clone(),
                    places: identity(len),
                    alone: false,
                };
                (&own, (factors.to_vec(), summands.to_vec()))
            }
        };
        let result = |layer: usize| {
            Value::Live(Live {
                layer,
                alone: true,
                ..x.clone()
            })
        };
        // Of an image, one for each channel if all pixels have the same.
        let channels = match *x.shape.as_slice() {
            [1, channels, _, _] if channels > 0 && len.is_multiple_of(channels) => channels,
            _ => len,
        };
        let uniform = |all: &[f32], n: usize| all.iter().enumerate().all(|(i, value)| *value == all[i % n]);
        let whole = x.alone && x.places.len() == len;
        if whole
            && let (Some(before), Some(params)) = (self.network.layers.get_mut(x.layer), self.params.get_mut(x.layer))
        {
            let outputs = match before {
                Layer::Dense { layer, curve, .. } if *curve == Activation::Identity => Some(layer.outputs),
                Layer::Conv2d { layer, curve, .. } if *curve == Activation::Identity => Some(layer.filters),
                _ => None,
            };
            if let Some(outputs) = outputs.filter(|n| uniform(&factor, *n) && uniform(&summand, *n)) {
                for row in params.chunks_exact_mut(outputs) {
                    row.iter_mut().zip(&factor).for_each(|(value, factor)| *value *= factor);
                }
                let bias = params.len() - outputs;
                params[bias..]
                    .iter_mut()
                    .zip(&summand)
                    .for_each(|(value, s)| *value += s);
                return Ok(result(x.layer));
            }
            let all = factor.first().copied().unwrap_or(0.0);
            if let Layer::Dense { curve, .. } | Layer::Conv2d { curve, .. } | Layer::Curve { curve, .. } = before
                && let Activation::Tanh { scale } = curve
                && uniform(&factor, 1)
                && all > 0.0
                && summand.iter().all(|s| *s == 0.0)
            {
                *scale *= all;
                return Ok(result(x.layer));
            }
        }
        let channels = match uniform(&factor, channels) && uniform(&summand, channels) {
            true => channels,
            false => len,
        };
        let rows = [&factor[..channels], &summand[..channels]].concat();
        let params = [rows, vec![0.0; channels], vec![1.0; channels]].concat();
        let layer = BatchNorm { channels, epsilon: 0.0 };
        let layer = self.push(Layer::BatchNorm { x: x.layer, layer }, params, len)?;
        Ok(result(layer))
    }

    fn curve(&mut self, node: &Node, curve: Activation) -> Result<Value, String> {
        let x = self.live(node, 0)?;
        let len = self.lens.get(x.layer).copied().unwrap_or(0);
        if x.alone
            && x.places.len() == len
            && let Some(Layer::Dense { curve: own, .. } | Layer::Conv2d { curve: own, .. }) =
                self.network.layers.get_mut(x.layer)
            && *own == Activation::Identity
        {
            *own = curve;
            return Ok(Value::Live(x));
        }
        let x = self.narrowed(&x)?;
        let len = self.lens.get(x.layer).copied().unwrap_or(0);
        let layer = self.push(Layer::Curve { x: x.layer, curve }, Vec::new(), len)?;
        Ok(Value::Live(Live {
            layer,
            alone: true,
            ..x
        }))
    }

    /// The result of an operator that only moves values.
    fn moved(&self, node: &Node, value: &Value, (shape, places): movement::Moved) -> Result<Value, String> {
        match value {
            Value::Constant(constant) => Ok(Value::Constant(Rc::new(constant.moved(shape, &places)))),
            Value::Live(_) => {
                let live = self.live(node, 0)?;
                let of = |place: &usize| live.places.get(*place).copied();
                let moved: Option<Vec<u32>> = places.iter().map(of).collect();
                let moved = moved.ok_or("it moves values that are not there")?;
                Ok(Value::Live(Live {
                    layer: live.layer,
                    alone: live.alone && moved.len() == live.places.len(),
                    shape,
                    places: Rc::new(moved),
                }))
            }
        }
    }

    fn list(&self, node: &Node, settings: &Settings<'_>, name: &str, i: usize) -> Result<Option<Vec<i64>>, String> {
        match settings.list(name) {
            Some(list) => Ok(Some(list.to_vec())),
            None => match self.optional(node, i)? {
                Some(constant) => Ok(Some(constant.whole()?.to_vec())),
                None => Ok(None),
            },
        }
    }

    fn movement(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let (_, value) = self.input(node, 0)?;
        let shape = shape_of(&value).to_vec();
        let len = len_of(&shape)?;
        let rank = shape.len();
        let axes_of =
            |axes: &[i64], rank: usize| -> Result<Vec<usize>, String> { axes.iter().map(|a| axis(*a, rank)).collect() };
        let in_place = |shape: Vec<usize>| (shape, (0..len).collect::<Vec<usize>>());
        let moved = match node.op_type.as_str() {
            "Cast" if matches!(value, Value::Live(_)) && !matches!(settings.whole("to", 1), 1 | 11) => {
                return Err("values as whole numbers are not supported".to_owned());
            }
            "Identity" | "Dropout" | "Cast" => in_place(shape),
            "Reshape" => {
                let wanted = self.list(node, settings, "shape", 1)?.ok_or("it has no shape")?;
                in_place(reshape(&shape, &wanted)?)
            }
            "Flatten" => {
                let at = match settings.whole("axis", 1) {
                    end if end == rank as i64 => rank,
                    other => axis(other, rank)?,
                };
                in_place(vec![len_of(&shape[..at])?, len_of(&shape[at..])?])
            }
            "Squeeze" => {
                let dropped = match self.list(node, settings, "axes", 1)? {
                    Some(axes) => axes_of(&axes, rank)?,
                    None => (0..rank).filter(|i| shape[*i] == 1).collect(),
                };
                if let Some(wrong) = dropped.iter().find(|i| shape[**i] != 1) {
                    return Err(format!("axis {wrong} of the shape {shape:?} is not 1"));
                }
                in_place((0..rank).filter(|i| !dropped.contains(i)).map(|i| shape[i]).collect())
            }
            "Unsqueeze" => {
                let axes = self.list(node, settings, "axes", 1)?.ok_or("it has no axes")?;
                if axes.len() > 8 {
                    return Err(format!("{} axes", axes.len()));
                }
                let added = axes_of(&axes, rank + axes.len())?;
                let mut left = shape.iter();
                let sizes = (0..rank + axes.len()).map(|i| match added.contains(&i) {
                    true => Ok(1),
                    false => left.next().copied().ok_or_else(|| format!("axes {axes:?}")),
                });
                in_place(sizes.collect::<Result<_, _>>()?)
            }
            "Transpose" => {
                let order: Vec<usize> = match settings.list("perm") {
                    Some(order) => axes_of(order, rank)?,
                    None => (0..rank).rev().collect(),
                };
                transpose(&shape, &order)?
            }
            "Expand" => expanded(&shape, self.constant(node, 1)?.as_ref())?,
            "Gather" => {
                let along = axis(settings.whole("axis", 0), rank)?;
                let indices = self.constant(node, 1)?;
                let taken: Vec<usize> = indices
                    .whole()?
                    .iter()
                    .map(|i| axis(*i, shape[along]))
                    .collect::<Result<_, _>>()?;
                let (mut result, places) = take(&shape, along, &taken)?;
                match indices.shape.len() {
                    0 => drop(result.remove(along)),
                    1 => {}
                    _ => return Err("indices of more than one axis are not supported".to_owned()),
                }
                (result, places)
            }
            _ => self.slice(node, settings, &shape)?,
        };
        self.moved(node, &value, moved)
    }

    fn slice(&self, node: &Node, settings: &Settings<'_>, shape: &[usize]) -> Result<movement::Moved, String> {
        let starts = self.list(node, settings, "starts", 1)?.ok_or("it has no starts")?;
        let ends = self.list(node, settings, "ends", 2)?.ok_or("it has no ends")?;
        let axes = self.list(node, settings, "axes", 3)?;
        let axes = axes.unwrap_or_else(|| (0..starts.len() as i64).collect());
        let steps = self.list(node, settings, "steps", 4)?;
        let steps = steps.unwrap_or_else(|| vec![1; starts.len()]);
        if [ends.len(), axes.len(), steps.len()] != [starts.len(); 3] {
            return Err("starts, ends, axes and steps are not of one length".to_owned());
        }
        let mut moved: movement::Moved = (shape.to_vec(), (0..len_of(shape)?).collect());
        for (((start, end), along), step) in starts.iter().zip(&ends).zip(&axes).zip(&steps) {
            let along = axis(*along, shape.len())?;
            let size = moved.0[along] as i64;
            // Backwards it ends before the first.
            let (first, last) = if *step < 0 { (-1, size - 1) } else { (0, size) };
            let place = |value: i64| if value < 0 { value.saturating_add(size) } else { value }.clamp(first, last);
            let stride = positive(step.saturating_abs(), "a step")?;
            let (from, to) = (place(*start), place(*end));
            let taken: Vec<usize> = match *step < 0 {
                true => (to + 1..=from).rev().step_by(stride).map(|i| i as usize).collect(),
                false => (from..to).step_by(stride).map(|i| i as usize).collect(),
            };
            if taken.is_empty() {
                return Err(format!("nothing is left of axis {along}"));
            }
            let (shape, places) = take(&moved.0, along, &taken)?;
            moved = (shape, places.into_iter().map(|place| moved.1[place]).collect());
        }
        Ok(moved)
    }

    fn split(&mut self, node: &'a Node, settings: &Settings<'_>) -> Result<(), String> {
        let (_, value) = self.input(node, 0)?;
        let shape = shape_of(&value).to_vec();
        let along = axis(settings.whole("axis", 0), shape.len())?;
        let count = node.output.len().max(1);
        let lens: Vec<usize> = match self.list(node, settings, "split", 1)? {
            Some(lens) => lens
                .iter()
                .map(|len| positive(*len, "a part"))
                .collect::<Result<_, _>>()?,
            None => {
                let each = shape[along].div_ceil(count);
                (0..count)
                    .map(|i| each.min(shape[along].saturating_sub(i * each)))
                    .collect()
            }
        };
        if lens.iter().sum::<usize>() != shape[along] || lens.len() != count || lens.contains(&0) {
            return Err(format!("parts of {lens:?} of an axis of {}", shape[along]));
        }
        let mut from = 0;
        for (i, len) in lens.into_iter().enumerate() {
            let taken: Vec<usize> = (from..from + len).collect();
            let part = self.moved(node, &value, take(&shape, along, &taken)?)?;
            self.set(node, i, part)?;
            from += len;
        }
        Ok(())
    }

    fn concat(&mut self, node: &Node, settings: &Settings<'_>) -> Result<Value, String> {
        let values: Vec<Value> = (0..node.input.len())
            .map(|i| self.input(node, i).map(|(_, value)| value))
            .collect::<Result<_, _>>()?;
        let shapes: Vec<&[usize]> = values.iter().map(shape_of).collect();
        let first = *shapes.first().ok_or("it has no inputs")?;
        let along = axis(settings.whole("axis", 0), first.len())?;
        let others = |shape: &[usize]| -> Vec<usize> {
            let kept = shape.iter().enumerate().filter(|(i, _)| *i != along);
            kept.map(|(_, size)| *size).collect()
        };
        if let Some(wrong) = shapes.iter().find(|shape| others(shape) != others(first)) {
            return Err(format!("the shapes {first:?} and {wrong:?} along axis {along}"));
        }
        let mut shape = first.to_vec();
        shape[along] = shapes.iter().map(|shape| shape[along]).sum();
        let total = len_of(&shape)?;
        let (outer, inner) = (len_of(&shape[..along])?, len_of(&shape[along + 1..])?);
        // Where each value of the result is: in which input, and where there.
        let mut places = Vec::with_capacity(total);
        for o in 0..outer {
            for (input, own) in shapes.iter().enumerate() {
                let run = own[along] * inner;
                places.extend((o * run..(o + 1) * run).map(|place| (input, place)));
            }
        }
        if values.iter().all(|value| matches!(value, Value::Constant(_))) {
            let constants = values.iter().filter_map(|value| match value {
                Value::Constant(constant) => Some(constant.as_ref()),
                Value::Live(_) => None,
            });
            let data = Constant::picked(&constants.collect::<Vec<_>>(), &places)?;
            return Ok(Value::Constant(Rc::new(Constant { shape, data })));
        }
        let mut parts = Vec::new();
        for value in &values {
            match value {
                Value::Live(live) => parts.push(self.narrowed(live)?),
                Value::Constant(_) => return Err("constants beside values are not supported".to_owned()),
            }
        }
        let mut begins = Vec::new();
        let mut len = 0usize;
        for part in &parts {
            begins.push(len);
            len += self.lens.get(part.layer).copied().unwrap_or(0);
        }
        let places = places
            .into_iter()
            .map(|(input, place)| (begins[input] + parts[input].places[place] as usize) as u32)
            .collect();
        let parts = parts.iter().map(|part| part.layer).collect();
        let layer = self.push(Layer::Concat { parts }, Vec::new(), len)?;
        Ok(self.fresh(layer, shape, Rc::new(places)))
    }

    /// The layer that holds the state before the first step: of a GRU `h`, of an LSTM `h`, then `c`.
    fn first_state(&mut self, node: &Node, is_gru: bool, hidden: usize) -> Result<usize, String> {
        let zero = |constant: &Constant| constant.real().is_ok_and(|all| all.iter().all(|value| *value == 0.0));
        let inputs = if is_gru { 5..6 } else { 5..7 };
        let mut given = Vec::new();
        for i in inputs.clone() {
            given.push(match node.input.get(i).is_none_or(String::is_empty) {
                true => None,
                false => match self.input(node, i)?.1 {
                    Value::Constant(constant) if zero(&constant) => None,
                    Value::Constant(_) => return Err("a first state of constants other than zeros".to_owned()),
                    Value::Live(live) => Some(live),
                },
            });
        }
        if given.iter().all(Option::is_none) {
            let len = inputs.len() * hidden;
            return self.push(Layer::Zeros { len }, Vec::new(), len);
        }
        let mut parts = Vec::new();
        for live in given {
            let Some(live) = live else {
                parts.push(self.push(Layer::Zeros { len: hidden }, Vec::new(), hidden)?);
                continue;
            };
            let part = self.narrowed(&live)?;
            if self.lens.get(part.layer) != Some(&hidden) || !part.places.iter().copied().eq(0..hidden as u32) {
                return Err(format!(
                    "a first state of shape {:?} that is not {hidden} values in a row",
                    live.shape
                ));
            }
            parts.push(part.layer);
        }
        match *parts.as_slice() {
            [only] => Ok(only),
            _ => self.push(Layer::Concat { parts }, Vec::new(), 2 * hidden),
        }
    }

    fn recurrent(&mut self, node: &'a Node, settings: &Settings<'_>) -> Result<(), String> {
        let is_gru = node.op_type == "GRU";
        let gates = if is_gru { 3 } else { 4 };
        if let Some(direction) = settings.word("direction").filter(|word| word != "forward") {
            return Err(format!("direction = {direction} is not supported"));
        }
        settings.only("layout", 0)?;
        if settings.get("activations").is_some() || settings.get("clip").is_some() {
            return Err("other activations, or clipped ones, are not supported".to_owned());
        }
        if is_gru && settings.whole("linear_before_reset", 0) != 1 {
            return Err("linear_before_reset = 0 is not supported; PyTorch exports 1".to_owned());
        }
        let x = self.live(node, 0)?;
        let (w, r) = (self.constant(node, 1)?, self.constant(node, 2)?);
        let ([steps, 1, inputs], [1, _, wide], [1, _, hidden]) =
            (x.shape.as_slice(), w.shape.as_slice(), r.shape.as_slice())
        else {
            return Err(format!("shapes {:?}, {:?}, {:?}", x.shape, w.shape, r.shape));
        };
        let (steps, inputs, hidden) = (*steps, *inputs, *hidden);
        let rows = gates * hidden;
        if *wide != inputs || w.shape[1] != rows || r.shape[1] != rows || steps > 256 || hidden == 0 {
            return Err(format!("shapes {:?}, {:?}, {:?}", x.shape, w.shape, r.shape));
        }
        if self.optional(node, 4)?.is_some() {
            return Err("sequence_lens is not supported".to_owned());
        }
        if node.input.get(7).is_some_and(|name| !name.is_empty()) {
            return Err("peepholes are not supported".to_owned());
        }
        let bias = self.optional(node, 3)?;
        let bias = match &bias {
            Some(bias) if bias.len() == 2 * rows => bias.real()?.to_vec(),
            Some(bias) => return Err(format!("a bias of shape {:?}", bias.shape)),
            None => vec![0.0; 2 * rows],
        };
        // ONNX's gates: z, r, h and i, o, f, c; ours: r, z, n and i, f, g, o.
        let order: &[usize] = if is_gru { &[1, 0, 2] } else { &[0, 2, 3, 1] };
        let row_of = |column: usize| order[column / hidden] * hidden + column % hidden;
        let state_len = if is_gru { hidden } else { 2 * hidden };
        let mut state = self.first_state(node, is_gru, hidden)?;
        // The same weights, in this node or an earlier one, are kept once.
        let weights: Vec<&str> = (1..4).map(|i| node.input.get(i).map_or("", String::as_str)).collect();
        let mut outputs = Vec::new();
        for step in 0..steps {
            let part = Live {
                layer: x.layer,
                shape: vec![1, inputs],
                places: Rc::new(x.places[step * inputs..(step + 1) * inputs].to_vec()),
                alone: false,
            };
            let part = self.narrowed(&part)?;
            let own = self.lens.get(part.layer).copied().unwrap_or(0);
            let kept = self.recurrent_weights.iter().find(|kept| {
                kept.is_gru == is_gru && kept.names == weights && kept.places == part.places && kept.inputs == own
            });
            let params_of = kept.map_or(self.lens.len(), |kept| kept.layer);
            let mut params = Vec::new();
            if params_of == self.lens.len() {
                let mut input = vec![0.0; len_of(&[own, rows])?];
                for (i, place) in part.places.iter().enumerate() {
                    for column in 0..rows {
                        input[*place as usize * rows + column] += w.real()?[row_of(column) * inputs + i];
                    }
                }
                params.extend(input);
                for i in 0..hidden {
                    for column in 0..rows {
                        params.push(r.real()?[row_of(column) * hidden + i]);
                    }
                }
                let biases = |from: usize| (0..rows).map(move |column| from + row_of(column)).map(|i| bias[i]);
                match is_gru {
                    true => params.extend(biases(0).chain(biases(rows))),
                    false => params.extend(biases(0).zip(biases(rows)).map(|(a, b)| a + b)),
                }
                self.recurrent_weights.push(RecurrentWeights {
                    is_gru,
                    names: weights.clone(),
                    places: part.places.clone(),
                    inputs: own,
                    layer: params_of,
                });
            }
            let layer = match is_gru {
                true => Layer::Gru {
                    x: part.layer,
                    h: state,
                    layer: Gru { inputs: own, hidden },
                    params_of,
                },
                false => Layer::Lstm {
                    x: part.layer,
                    state,
                    layer: Lstm {
                        inputs: own,
                        hidden,
                        cell: Activation::TANH,
                    },
                    params_of,
                },
            };
            state = self.push(layer, params, state_len)?;
            outputs.push(state);
        }
        let of_state = |from: usize| (from as u32..(from + hidden) as u32).collect::<Vec<u32>>();
        let last = |from: usize| Live {
            layer: state,
            shape: vec![1, 1, hidden],
            places: Rc::new(of_state(from)),
            alone: false,
        };
        let wanted = |i: usize| node.output.get(i).is_some_and(|name| !name.is_empty());
        if wanted(0) {
            // All steps' states one after the other; of an LSTM with the cells between them.
            let all = self.push(Layer::Concat { parts: outputs }, Vec::new(), steps * state_len)?;
            let places = (0..steps).flat_map(|step| (0..hidden).map(move |i| (step * state_len + i) as u32));
            let places = Rc::new(places.collect());
            let value = self.fresh(all, vec![steps, 1, 1, hidden], places);
            self.set(node, 0, value)?;
        }
        if wanted(1) {
            self.set(node, 1, Value::Live(last(0)))?;
        }
        if wanted(2) && !is_gru {
            self.set(node, 2, Value::Live(last(hidden)))?;
        }
        Ok(())
    }
}

fn shape_of(value: &Value) -> &[usize] {
    match value {
        Value::Constant(constant) => &constant.shape,
        Value::Live(live) => &live.shape,
    }
}

fn broadcast(values: &[f32], len: usize) -> Result<Vec<f32>, String> {
    match values {
        [one] => Ok(vec![*one; len]),
        all if all.len() == len => Ok(all.to_vec()),
        all => Err(format!("a bias of {} values for {len} outputs", all.len())),
    }
}

/// A constant for each value of a shape, as NumPy broadcasts it.
fn spread(constant: &Constant, shape: &[usize]) -> Result<Vec<f32>, String> {
    let values = constant.real()?;
    let own = if constant.len() == 1 { &[][..] } else { &constant.shape };
    let places = fold::spread_places(own, shape)
        .map_err(|_| format!("a constant of shape {:?} for values of shape {shape:?}", constant.shape))?;
    let picked: Option<Vec<f32>> = places.into_iter().map(|place| values.get(place).copied()).collect();
    picked.ok_or_else(|| "a value is missing".to_owned())
}

/// Factors and summands of a layer's values, of those that stand at `places` of it; `None` where one stands at several that differ.
fn each_place(places: &[u32], len: usize, factors: &[f32], summands: &[f32]) -> Option<(Vec<f32>, Vec<f32>)> {
    let (mut factor, mut summand) = (vec![1.0; len], vec![0.0; len]);
    let mut seen = vec![false; len];
    for ((place, f), s) in places.iter().zip(factors).zip(summands) {
        let place = *place as usize;
        if std::mem::replace(&mut seen[place], true) && (factor[place], summand[place]) != (*f, *s) {
            return None;
        }
        (factor[place], summand[place]) = (*f, *s);
    }
    Some((factor, summand))
}

/// Values spread to a shape, as NumPy broadcasts them.
fn spread_live(x: &Live, shape: &[usize]) -> Result<Live, String> {
    if x.shape == shape {
        return Ok(x.clone());
    }
    let places = fold::spread_places(&x.shape, shape)?;
    let of = |place: &usize| x.places.get(*place).copied();
    let moved: Option<Vec<u32>> = places.iter().map(of).collect();
    Ok(Live {
        layer: x.layer,
        shape: shape.to_vec(),
        places: Rc::new(moved.ok_or("it moves values that are not there")?),
        alone: x.alone && places.len() == x.places.len(),
    })
}

/// The movement of values of `shape` to the shape that both they and `wanted` are spread to.
fn expanded(shape: &[usize], wanted: &Constant) -> Result<movement::Moved, String> {
    let wanted: Option<Vec<usize>> = wanted.whole()?.iter().map(|size| usize::try_from(*size).ok()).collect();
    let wanted = fold::broadcast_shape(shape, &wanted.ok_or("a shape with a negative size")?)?;
    let places = fold::spread_places(shape, &wanted)?;
    Ok((wanted, places))
}
