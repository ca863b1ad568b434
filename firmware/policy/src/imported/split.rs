//! Where an imported policy is taken apart to be explained: the layers behind its split point are a network of their own.

use super::network::{Layer, Network, NetworkError, SPLIT_VALUES};
use super::network_text::layer_of;
use crate::actor::GOAL_INPUTS;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;
use core::mem::replace;
use vigil_nnet::{Activation, Dense, Function};

/// The layers behind a split point: inputs are the split point's values and the low-dimensional observation `[2]` (read or not), the output is the
/// policy's. Parameters are those of its layers, in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct Head {
    /// Its layers.
    pub network: Network,
    /// Their parameters.
    pub params: Vec<f32>,
    /// Values of the split point.
    pub width: usize,
}

impl Layer {
    /// Whose parameters it has, if it has any: its own number, or an earlier step's.
    pub fn params_of(&self, number: usize) -> Option<usize> {
        let own = || (self.param_len() > 0).then_some(number);
        self.line().params_of.or_else(own)
    }

    /// Number of its parameters.
    pub fn param_len(&self) -> usize {
        match self {
            // Of the two biases of others it has the sum.
            Self::Lstm { layer, .. } => layer.param_len(),
            _ => self.cost().0 as usize,
        }
    }

    /// The same layer with other numbers for those that it reads.
    fn renumbered(&self, new: impl Fn(usize) -> usize, new_params_of: usize) -> Option<Self> {
        let line = self.line();
        let sources = line.sources.into_iter().map(new).chain(line.sizes);
        let numbers: Vec<usize> = sources.chain(line.params_of.map(|_| new_params_of)).collect();
        layer_of(line.kind, &numbers, Some(&line.word))
    }
}

impl Network {
    /// Layers that the output is computed from, those before `stop` left out.
    fn behind(&self, stop: Option<usize>) -> Vec<bool> {
        let mut needed: Vec<bool> = (0..self.layers.len()).map(|number| number == self.output).collect();
        for (number, layer) in self.layers.iter().enumerate().rev() {
            if needed.get(number) == Some(&true) && Some(number) != stop {
                for source in layer.sources() {
                    if let Some(source) = needed.get_mut(source) {
                        *source = true;
                    }
                }
            }
        }
        needed
    }

    /// Values of each layer; lengths that the layers do not say themselves follow from what they read.
    pub fn lens(&self) -> Vec<usize> {
        let mut lens: Vec<usize> = Vec::with_capacity(self.layers.len());
        for layer in &self.layers {
            let of = |x: usize| lens.get(x).copied().unwrap_or(0);
            let len = match layer {
                Layer::Input { len } | Layer::Zeros { len } | Layer::Slice { len, .. } => *len,
                Layer::Concat { parts } => parts.iter().map(|part| of(*part)).sum(),
                Layer::Conv2d { layer, .. } => layer.output_len(),
                Layer::Dense { layer, .. } => layer.outputs,
                Layer::MaxPool2d { layer, .. } => layer.output_len(),
                Layer::Gru { layer, .. } => layer.hidden,
                Layer::Lstm { layer, .. } => layer.state_len(),
                // As many as they read.
                _ => layer.sources().first().map_or(0, |x| of(*x)),
            };
            lens.push(len);
        }
        lens
    }

    /// Where each layer's parameters begin, of those that have their own.
    fn offsets(&self) -> Vec<usize> {
        let layers = self.layers.iter().enumerate();
        let offsets = layers.scan(0, |next, (number, layer)| {
            let is_own = layer.params_of(number) == Some(number);
            let len = if is_own { layer.param_len() } else { 0 };
            Some(replace(next, *next + len))
        });
        offsets.collect()
    }

    /// Number of the layer that is the network's input `i`.
    fn input_layer(&self, i: usize) -> Option<usize> {
        let inputs = self.layers.iter().enumerate();
        let mut inputs = inputs.filter(|(_, layer)| matches!(layer, Layer::Input { .. }));
        inputs.nth(i).map(|(number, _)| number)
    }

    /// The layers behind a split point.
    ///
    /// # Errors
    /// A layer that does not stand between the frame and the action, or of a size that is not explained; by its number.
    pub fn head(&self, params: &[f32], split: usize, frame_input: usize) -> Result<Head, NetworkError> {
        let refused = |what: String| Err(NetworkError(format!("layer {split} cannot be the split point: {what}")));
        let lens = self.lens();
        let Some(width) = lens.get(split).copied() else {
            return refused(format!("there are {} layers", self.layers.len()));
        };
        if !SPLIT_VALUES.contains(&width) {
            return refused(format!(
                "it has {width} values; {} to {} are explained",
                SPLIT_VALUES.start(),
                SPLIT_VALUES.end()
            ));
        }
        let frame = self.input_layer(frame_input);
        if frame == Some(split) {
            return refused("it is the frame itself".to_string());
        }
        let needed = self.behind(Some(split));
        let is_needed = |number: usize| needed.get(number) == Some(&true);
        if !is_needed(split) || self.output == split {
            return refused("the action is not computed from it".to_string());
        }
        if frame.is_none_or(is_needed) {
            return refused("the action depends on the frame by another way as well".to_string());
        }
        let offsets = self.offsets();
        let mut network = Self {
            layers: vec![Layer::Input { len: width }, Layer::Input { len: GOAL_INPUTS }],
            output: 0,
        };
        let mut numbers = vec![0; self.layers.len()];
        let mut owners = vec![None; self.layers.len()];
        let mut own_params = Vec::new();
        for (number, layer) in self.layers.iter().enumerate().filter(|(number, _)| is_needed(*number)) {
            let new_number = match layer {
                _ if number == split => 0,
                // The frame is not among them.
                Layer::Input { .. } => 1,
                _ => network.layers.len(),
            };
            if let Some(to) = numbers.get_mut(number) {
                *to = new_number;
            }
            if new_number < 2 {
                continue;
            }
            let mut new_params_of = 0;
            if let Some(owner) = layer.params_of(number)
                && let (Some(slot), Some(from)) = (owners.get_mut(owner), offsets.get(owner))
            {
                // The first step on this side of the split point has the parameters that it shared with those before.
                new_params_of = *slot.get_or_insert(new_number);
                if new_params_of == new_number {
                    let range = *from..from.saturating_add(layer.param_len());
                    own_params.extend_from_slice(params.get(range).unwrap_or_default());
                }
            }
            let new = |source: usize| numbers.get(source).copied().unwrap_or(usize::MAX);
            let Some(layer) = layer.renumbered(new, new_params_of) else {
                return refused(format!("layer {number} has no text"));
            };
            network.layers.push(layer);
        }
        network.output = numbers.get(self.output).copied().unwrap_or(0);
        network.check()?;
        Ok(Head {
            network,
            params: own_params,
            width,
        })
    }

    /// The split point that is proposed: the last layer with weights, its curve included, of a size that is explained, which stands between the
    /// frame and the action. It is the closest to the decision, so the least of it is left to be explained.
    pub fn proposed_split(&self, params: &[f32], frame_input: usize) -> Option<usize> {
        // A layer's sources come before it.
        let has_weights = |mut number: usize| loop {
            match self.layers.get(number) {
                Some(Layer::Curve { x, .. } | Layer::Function { x, .. }) => number = *x,
                layer => return layer.is_some_and(|layer| layer.params_of(number).is_some()),
            }
        };
        let with_weights = |number: &usize| has_weights(*number) && self.not_followed_by_curve(*number);
        let numbers = (0..self.layers.len()).rev();
        numbers
            .filter(with_weights)
            .find(|number| self.head(params, *number, frame_input).is_ok())
    }

    /// Whether something else than an element-wise function reads the layer: otherwise what that gives is the better split point.
    fn not_followed_by_curve(&self, number: usize) -> bool {
        let mut readers = self.layers.iter().filter(|layer| layer.sources().contains(&number));
        !readers.all(|layer| matches!(layer, Layer::Curve { .. } | Layer::Function { .. }))
    }

    /// The same network before its outputs saturate: clips at its end and the last sigmoid or tanh, if only what scales or picks its values
    /// follows them, are left out. Its gradient does not vanish where the policy is at its limits.
    #[must_use]
    pub fn unsaturated(&self, params: &[f32]) -> Self {
        let offsets = self.offsets();
        // What lies before a layer that mixes values is hidden, no limit of an output.
        let mixes = |number: usize, layer: &Dense| {
            let from = offsets.get(number).copied().unwrap_or_default();
            let weights = params.get(from..).unwrap_or_default().iter();
            let column = |output| (weights.clone().skip(output).step_by(layer.outputs.max(1))).take(layer.inputs);
            (0..layer.outputs).any(|output| column(output).filter(|weight| **weight != 0.0).count() > 1)
        };
        let mut network = self.clone();
        let mut number = self.output;
        loop {
            if let Some(layer) = network.layers.get_mut(number)
                && let Layer::Function {
                    x,
                    function: Function::Clip { .. },
                } = *layer
            {
                let curve = Activation::Identity;
                *layer = Layer::Curve { x, curve };
            }
            let source = match network.layers.get_mut(number) {
                Some(Layer::Dense {
                    layer,
                    curve: Activation::Identity,
                    ..
                }) if mixes(number, layer) => return network,
                Some(Layer::Dense { x, curve, .. } | Layer::Curve { x, curve }) => match curve {
                    Activation::Tanh { .. } | Activation::Sigmoid => {
                        *curve = Activation::Identity;
                        return network;
                    }
                    Activation::Identity => *x,
                    _ => return network,
                },
                Some(Layer::Slice { x, .. } | Layer::BatchNorm { x, .. }) => *x,
                _ => return network,
            };
            number = source;
        }
    }
}
