//! Describing a network.

use super::{Edge, Graph, Layer, Node, NodeId, Params, Purpose};
use crate::aligned::LINE;
use crate::error::ShapeError;
use crate::{Activation, BatchNorm, Conv2d, Dense, Gru, Lstm, MaxPool2d};
use alloc::vec;
use alloc::vec::Vec;

/// Collects the nodes of a [`Graph`] in the order in which they are computed. Allocates; nothing after
/// [`GraphBuilder::finish`] does.
#[derive(Debug, Clone, Default)]
pub struct GraphBuilder {
    layers: Vec<(Layer, Vec<usize>, usize, Params)>,
    param_len: usize,
}

fn description<T>(what: &'static str, why: &'static str) -> Result<T, ShapeError> {
    Err(ShapeError::Description { what, why })
}

impl GraphBuilder {
    /// An empty network.
    pub fn new() -> Self {
        Self::default()
    }

    /// Reserves parameters. Layers that are given the same [`Params`] share their weights.
    pub fn params(&mut self, len: usize) -> Params {
        let at = self.param_len;
        self.param_len += len;
        Params { at, len }
    }

    fn len_of(&self, node: NodeId) -> Result<usize, ShapeError> {
        match self.layers.get(node.0) {
            Some((_, _, len, _)) => Ok(*len),
            None => description("graph", "a node belongs to another graph"),
        }
    }

    fn add(&mut self, layer: Layer, sources: &[NodeId], len: usize, params: Params) -> Result<NodeId, ShapeError> {
        if len == 0 {
            return description("graph", "a node has no values");
        }
        if params.at + params.len > self.param_len {
            return description("graph", "parameters belong to another graph");
        }
        for source in sources {
            self.len_of(*source)?;
        }
        self.layers
            .push((layer, sources.iter().map(|s| s.0).collect(), len, params));
        Ok(NodeId(self.layers.len() - 1))
    }

    fn check(&self, what: &'static str, source: NodeId, expected: usize) -> Result<(), ShapeError> {
        let got = self.len_of(source)?;
        if got == expected {
            Ok(())
        } else {
            Err(ShapeError::Length { what, expected, got })
        }
    }

    fn check_params(what: &'static str, params: Params, expected: usize) -> Result<(), ShapeError> {
        if params.len == expected {
            Ok(())
        } else {
            Err(ShapeError::Length {
                what,
                expected,
                got: params.len,
            })
        }
    }

    /// An input of the network. Inputs are numbered from 0 in the order they are added. `explained` says whether the
    /// backward passes shall reach it; leaving out what nobody asks for saves the first layers' work.
    ///
    /// # Errors
    /// A zero length.
    pub fn input(&mut self, len: usize, explained: bool) -> Result<NodeId, ShapeError> {
        self.add(Layer::Input { explained }, &[], len, Params::default())
    }

    /// Constant zeros: a recurrent layer's first state.
    ///
    /// # Errors
    /// A zero length.
    pub fn zeros(&mut self, len: usize) -> Result<NodeId, ShapeError> {
        self.add(Layer::Zeros, &[], len, Params::default())
    }

    /// A convolution with its activation.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn conv2d(
        &mut self,
        x: NodeId,
        layer: Conv2d,
        activation: Activation,
        params: Params,
    ) -> Result<NodeId, ShapeError> {
        layer.validate()?;
        self.check("conv2d input", x, layer.input_len())?;
        Self::check_params("conv2d parameters", params, layer.param_len())?;
        self.add(Layer::Conv2d(layer, activation), &[x], layer.output_len(), params)
    }

    /// A fully connected layer with its activation, applied to each row of `inputs` values.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn dense(
        &mut self,
        x: NodeId,
        layer: Dense,
        activation: Activation,
        params: Params,
    ) -> Result<NodeId, ShapeError> {
        let rows = self.len_of(x)? / layer.inputs.max(1);
        self.check("dense input", x, rows * layer.inputs)?;
        Self::check_params("dense parameters", params, layer.param_len())?;
        self.add(Layer::Dense(layer, activation), &[x], rows * layer.outputs, params)
    }

    /// An element-wise function.
    ///
    /// # Errors
    /// An unknown node.
    pub fn activation(&mut self, x: NodeId, activation: Activation) -> Result<NodeId, ShapeError> {
        let len = self.len_of(x)?;
        self.add(Layer::Activation(activation), &[x], len, Params::default())
    }

    /// Batch normalisation with running statistics.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn batch_norm(&mut self, x: NodeId, layer: BatchNorm, params: Params) -> Result<NodeId, ShapeError> {
        let len = self.len_of(x)?;
        self.check("batch norm input", x, len / layer.channels.max(1) * layer.channels)?;
        Self::check_params("batch norm parameters", params, layer.param_len())?;
        self.add(Layer::BatchNorm(layer), &[x], len, params)
    }

    /// Max pooling.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn max_pool2d(&mut self, x: NodeId, layer: MaxPool2d) -> Result<NodeId, ShapeError> {
        layer.validate()?;
        self.check("max pool input", x, layer.input_len())?;
        self.add(Layer::MaxPool2d(layer), &[x], layer.output_len(), Params::default())
    }

    /// One step of a GRU from state `h`; the node's value is the next state.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn gru(&mut self, x: NodeId, h: NodeId, layer: Gru, params: Params) -> Result<NodeId, ShapeError> {
        self.check("GRU input", x, layer.inputs)?;
        self.check("GRU state", h, layer.hidden)?;
        Self::check_params("GRU parameters", params, layer.param_len())?;
        if x == h {
            return description("GRU", "input and state are the same node");
        }
        self.add(Layer::Gru(layer), &[x, h], layer.hidden, params)
    }

    /// One step of an LSTM from `state` (`h`, then `c`); the node's value is the next state.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn lstm(&mut self, x: NodeId, state: NodeId, layer: Lstm, params: Params) -> Result<NodeId, ShapeError> {
        self.check("LSTM input", x, layer.inputs)?;
        self.check("LSTM state", state, layer.state_len())?;
        Self::check_params("LSTM parameters", params, layer.param_len())?;
        if x == state {
            return description("LSTM", "input and state are the same node");
        }
        self.add(Layer::Lstm(layer), &[x, state], layer.state_len(), params)
    }

    /// Values of several nodes, one after the other.
    ///
    /// # Errors
    /// An unknown node.
    pub fn concat(&mut self, parts: &[NodeId]) -> Result<NodeId, ShapeError> {
        let mut len = 0;
        for part in parts {
            len += self.len_of(*part)?;
        }
        self.add(Layer::Concat, parts, len, Params::default())
    }

    /// Values `from..from + len` of a node.
    ///
    /// # Errors
    /// A range outside the node.
    pub fn slice(&mut self, x: NodeId, from: usize, len: usize) -> Result<NodeId, ShapeError> {
        let got = self.len_of(x)?;
        if from + len > got {
            return Err(ShapeError::Length {
                what: "sliced node",
                expected: from + len,
                got,
            });
        }
        self.add(Layer::Slice { from }, &[x], len, Params::default())
    }

    /// The finished network with `output` as its output. Nodes that the output does not depend on are not computed.
    ///
    /// # Errors
    /// An unknown node.
    pub fn finish(self, output: NodeId, purpose: Purpose) -> Result<Graph, ShapeError> {
        self.len_of(output)?;
        let mut live = vec![false; self.layers.len()];
        if let Some(slot) = live.get_mut(output.0) {
            *slot = true;
        }
        for (i, (_, sources, _, _)) in self.layers.iter().enumerate().rev() {
            if live.get(i).copied().unwrap_or(false) {
                for source in sources {
                    if let Some(slot) = live.get_mut(*source) {
                        *slot = true;
                    }
                }
            }
        }
        let mut nodes: Vec<Node> = Vec::with_capacity(self.layers.len());
        let mut inputs = Vec::new();
        let (mut tape_len, mut gradient_len, mut spill_len, mut scratch_len) = (0, 0, 0, 0);
        for ((layer, sources, len, params), live) in self.layers.into_iter().zip(live) {
            let aux_len = layer.aux_len(len, purpose);
            if let Layer::Input { .. } = layer {
                inputs.push(nodes.len());
            }
            let of = |flag: fn(&Node) -> bool| sources.iter().any(|s| nodes.get(*s).is_some_and(flag));
            let node = Node {
                reaches_input: matches!(layer, Layer::Input { explained: true }) || of(|n| n.reaches_input),
                reaches_params: params.len > 0 || of(|n| n.reaches_params),
                sources: sources
                    .iter()
                    .map(|source| Edge {
                        source: *source,
                        adds: false,
                    })
                    .collect(),
                at: tape_len,
                len,
                aux_len,
                gradient_at: gradient_len,
                layer,
                params,
                live,
            };
            scratch_len = scratch_len.max(node.layer.scratch_len());
            for source in &sources {
                spill_len = spill_len.max(nodes.get(*source).map_or(0, |n| n.len));
            }
            // Every node's values begin at a cache line of an `Aligned` buffer.
            tape_len += (len + aux_len).next_multiple_of(LINE);
            gradient_len += len.next_multiple_of(LINE);
            nodes.push(node);
        }
        // Backwards, the first edge into a node writes its gradient and every further one adds to it.
        let mut written = vec![false; nodes.len()];
        for node in nodes.iter_mut().rev().filter(|n| n.live) {
            for edge in &mut node.sources {
                if let Some(written) = written.get_mut(edge.source) {
                    edge.adds = core::mem::replace(written, true);
                }
            }
        }
        Ok(Graph {
            nodes,
            inputs,
            output: output.0,
            param_len: self.param_len,
            purpose,
            tape_len,
            gradient_len,
            // The recurrent layers write the gradients of both of their sources at once.
            spill_len: (2 * spill_len).next_multiple_of(LINE),
            scratch_len,
        })
    }
}
