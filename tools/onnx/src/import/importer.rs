//! The network that is being made, what each tensor of the graph is in it, and how a node reads its inputs.

use super::needed::{Needed, bounds};
use crate::constant::Constant;
use crate::proto::{Attribute, Graph, Node};
use std::collections::{HashMap, HashSet};
use std::rc::Rc;
use vigil_policy::imported::{Layer, MOST_VALUES, Network, refuse_more};

/// What a node has done that made, of finite numbers, one that is not.
pub(super) const NOT_FINITE: &str =
    "it makes a constant that is not finite (a division by zero, a negative variance, numbers that are too large?)";

/// Values of a layer.
#[derive(Debug, Clone)]
pub(super) struct Live {
    pub(super) layer: usize,
    /// As ONNX has it, batch included.
    pub(super) shape: Vec<usize>,
    /// Where each value is in the layer.
    pub(super) places: Rc<Vec<u32>>,
    /// Nothing else uses the layer, if nothing else uses this tensor.
    pub(super) alone: bool,
}

impl Live {
    /// Of a layer that was made for them.
    pub(super) fn of(layer: usize, shape: Vec<usize>, places: Rc<Vec<u32>>) -> Self {
        Self {
            layer,
            shape,
            places,
            alone: true,
        }
    }

    /// The same where something else uses them as well.
    pub(super) fn shared(self) -> Self {
        Self { alone: false, ..self }
    }

    /// Values of these, each from its place among them.
    pub(super) fn moved(&self, shape: Vec<usize>, places: &[usize]) -> Result<Self, String> {
        let of = |place: &usize| self.places.get(*place).copied();
        let moved: Option<Vec<u32>> = places.iter().map(of).collect();
        Ok(Self {
            layer: self.layer,
            shape,
            places: Rc::new(moved.ok_or("it moves values that are not there")?),
            alone: self.alone && places.len() == self.places.len(),
        })
    }
}

#[derive(Debug, Clone)]
pub(super) enum Value {
    Constant(Rc<Constant>),
    Live(Live),
}

/// What distinguishes the weights of a recurrent layer from others'.
#[derive(Debug, PartialEq)]
pub(super) struct RecurrentWeights<'a> {
    pub(super) is_gru: bool,
    pub(super) names: Vec<&'a str>,
    /// Where the inputs are in a layer of as many values.
    pub(super) places: Rc<Vec<u32>>,
    pub(super) inputs: usize,
}

#[derive(Default)]
pub(super) struct Importer<'a> {
    pub(super) network: Network,
    /// Of each layer.
    pub(super) params: Vec<Vec<f32>>,
    /// Values of each layer.
    pub(super) lens: Vec<usize>,
    /// Parameters and values of all layers.
    totals: [u64; 2],
    pub(super) tensors: HashMap<&'a str, Value>,
    /// How many nodes read a tensor.
    pub(super) uses: HashMap<&'a str, usize>,
    /// [`bounds`].
    pub(super) bounds: HashSet<&'a str>,
    /// Those that are among the parameters already, and of which layer.
    pub(super) recurrent_weights: Vec<(RecurrentWeights<'a>, usize)>,
    pub(super) needed: Needed<'a>,
}

impl<'a> Importer<'a> {
    pub(super) fn new(graph: &'a Graph, action: &'a str) -> Result<Self, String> {
        let mut importer = Self {
            bounds: bounds(graph),
            needed: Needed::by(graph, action),
            ..Self::default()
        };
        for tensor in &graph.initializer {
            if !importer.needed.tensors.contains(tensor.name.as_str()) {
                continue;
            }
            let is_bound = importer.bounds.contains(tensor.name.as_str());
            let constant = Constant::of(tensor).and_then(|constant| constant.checked(is_bound));
            let constant = constant.map_err(|e| format!("the tensor `{}`: {e}", tensor.name))?;
            let value = Value::Constant(Rc::new(constant));
            importer.tensors.insert(&tensor.name, value);
        }
        let nodes = importer.needed.nodes.iter();
        let read = nodes.flat_map(|(_, node)| node.input.iter().map(String::as_str));
        for name in read.chain([action]) {
            *importer.uses.entry(name).or_default() += 1;
        }
        Ok(importer)
    }

    /// Ends with the action: two values in their order.
    pub(super) fn output(&mut self, name: &str) -> Result<(), String> {
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

    /// The layer of a node or of its output, by name; `frame` is the number of the frame's input.
    pub(super) fn split_point(&self, graph: &Graph, name: &str, params: &[f32], frame: usize) -> Result<usize, String> {
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
            Some(Some(layer)) => match self.network.head(params, layer, frame) {
                Ok(_) => return Ok(layer),
                Err(e) => format!("`{name}`: {e}"),
            },
        };
        let possible = outputs
            .filter(|(_, output)| whole(output).is_some_and(|layer| self.network.head(params, layer, frame).is_ok()));
        let possible: Vec<&str> = possible.map(|(_, output)| output.as_str()).collect();
        Err(match possible.is_empty() {
            true => format!("{refused}; no value of it can be the split point"),
            false => format!("{refused}; these can be the split point: {}", possible.join(", ")),
        })
    }

    /// A further layer; what is too large is refused here, before the memory for the rest of it is taken.
    pub(super) fn push(&mut self, layer: Layer, params: Vec<f32>, len: usize) -> Result<usize, String> {
        let [all_params, all_values] = &mut self.totals;
        for (what, total, more) in [("parameters", all_params, params.len()), ("values", all_values, len)] {
            *total = total.saturating_add(more as u64);
            refuse_more(what, *total, MOST_VALUES).map_err(|e| e.to_string())?;
        }
        refuse_endless(&params)?;
        self.network.layers.push(layer);
        self.params.push(params);
        self.lens.push(len);
        Ok(self.lens.len() - 1)
    }

    pub(super) fn input<'n>(&self, node: &'n Node, i: usize) -> Result<(&'n str, Value), String> {
        let name = node.input.get(i).filter(|name| !name.is_empty());
        let name = name.ok_or_else(|| format!("input {i} is missing"))?;
        let value = self.tensors.get(name.as_str()).cloned();
        Ok((
            name,
            value.ok_or_else(|| format!("nothing computes its input `{name}`"))?,
        ))
    }

    pub(super) fn live(&self, node: &Node, i: usize) -> Result<Live, String> {
        match self.input(node, i)? {
            (name, Value::Live(mut live)) => {
                live.alone &= self.uses.get(name) == Some(&1);
                Ok(live)
            }
            (name, Value::Constant(_)) => Err(format!("its input `{name}` is a constant")),
        }
    }

    pub(super) fn constant(&self, node: &Node, i: usize) -> Result<Rc<Constant>, String> {
        match self.input(node, i)? {
            (_, Value::Constant(constant)) => Ok(constant),
            (name, Value::Live(_)) => Err(format!("its input `{name}` has to be a constant")),
        }
    }

    pub(super) fn optional(&self, node: &Node, i: usize) -> Result<Option<Rc<Constant>>, String> {
        match node.input.get(i).is_none_or(String::is_empty) {
            true => Ok(None),
            false => self.constant(node, i).map(Some),
        }
    }
}

/// Its settings.
impl Node {
    pub(super) fn get(&self, name: &str) -> Option<&Attribute> {
        self.attribute.iter().find(|attribute| attribute.name == name)
    }

    pub(super) fn list(&self, name: &str) -> Option<&[i64]> {
        self.get(name).map(|attribute| attribute.ints.as_slice())
    }

    pub(super) fn whole(&self, name: &str, default: i64) -> i64 {
        self.get(name).map_or(default, |attribute| attribute.i)
    }

    pub(super) fn real(&self, name: &str, default: f32) -> f32 {
        self.get(name).map_or(default, |attribute| attribute.f)
    }

    pub(super) fn word(&self, name: &str) -> Option<String> {
        self.get(name)
            .map(|attribute| String::from_utf8_lossy(&attribute.s).into_owned())
    }

    /// Refuses a setting that is there and is not as computed here.
    pub(super) fn only(&self, name: &str, allowed: i64) -> Result<(), String> {
        match self.whole(name, allowed) == allowed {
            true => Ok(()),
            false => Err(format!("{name} = {} is not supported", self.whole(name, allowed))),
        }
    }
}

/// Whether parameters are numbers.
pub(super) fn refuse_endless(params: &[f32]) -> Result<(), String> {
    let all = params.iter().all(|value| value.is_finite());
    all.then_some(()).ok_or_else(|| NOT_FINITE.to_owned())
}

/// Where the values of an image `[channel][row][column]` are in one of `[row][column][channel]`.
pub(super) fn image_places(channels: usize, rows: usize, cols: usize) -> Vec<u32> {
    let mut places = Vec::with_capacity(channels * rows * cols);
    for channel in 0..channels {
        places.extend((0..rows * cols).map(|pixel| (pixel * channels + channel) as u32));
    }
    places
}

pub(super) fn identity(len: usize) -> Rc<Vec<u32>> {
    Rc::new((0..len as u32).collect())
}

pub(super) fn positive(value: i64, what: &str) -> Result<usize, String> {
    usize::try_from(value)
        .ok()
        .filter(|v| *v > 0 && *v <= 1 << 20)
        .ok_or_else(|| format!("{what} of {value}"))
}

pub(super) fn shape_of(value: &Value) -> &[usize] {
    match value {
        Value::Constant(constant) => &constant.shape,
        Value::Live(live) => &live.shape,
    }
}

pub(super) fn broadcast(values: &[f32], len: usize) -> Result<Vec<f32>, String> {
    match values {
        [one] => Ok(vec![*one; len]),
        all if all.len() == len => Ok(all.to_vec()),
        all => Err(format!("a bias of {} values for {len} outputs", all.len())),
    }
}
