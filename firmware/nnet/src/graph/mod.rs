//! Networks made of this crate's layers: a list of nodes in the order of computation.
//!
//! A [`Graph`] is a description only. Parameters, the *tape* (all nodes' values of one evaluation) and the *work* buffer
//! of a backward pass belong to the caller, so one graph serves any number of threads, samples and weight sets, and an
//! evaluation allocates nothing.

mod build;
pub(crate) mod layer;
pub(crate) mod operation;
pub(crate) mod run;
mod structure;

pub use build::GraphBuilder;
pub(crate) use build::description;

use crate::shape::{ShapeError, part};
#[cfg(feature = "train")]
use crate::shape::{expect, part_mut};
use alloc::vec::Vec;
use operation::AnyOperation;

/// A node of one graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NodeId(pub(crate) usize);

/// Where a layer's parameters lie in the network's parameter slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Params {
    /// Offset of the first.
    pub at: usize,
    /// How many.
    pub len: usize,
}

/// What the tapes of a graph are kept for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Values and gradients: activations are kept only after their curve.
    Gradients,
    /// Multipliers as well: values before each curve are kept, too.
    Multipliers,
}

/// A node's use of an earlier node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Edge {
    source: usize,
    /// Backwards: whether this edge adds to the source's gradient instead of being the first to write it.
    adds: bool,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Node {
    operation: AnyOperation,
    sources: Vec<Edge>,
    params: Params,
    /// Offset of the value on the tape; what the node keeps besides follows it.
    at: usize,
    len: usize,
    aux_len: usize,
    /// Offset of the gradient in the work buffer.
    gradient_at: usize,
    /// The output depends on it.
    live: bool,
    /// It depends on an explained input.
    reaches_input: bool,
    /// It depends on parameters.
    reaches_params: bool,
}

/// A network. Made by [`GraphBuilder`].
#[derive(Debug, Clone, PartialEq)]
pub struct Graph {
    nodes: Vec<Node>,
    inputs: Vec<usize>,
    output: usize,
    param_len: usize,
    purpose: Purpose,
    tape_len: usize,
    gradient_len: usize,
    spill_len: usize,
    scratch_len: usize,
}

impl Graph {
    /// Number of parameters.
    pub fn param_len(&self) -> usize {
        self.param_len
    }

    /// Length of a tape.
    pub fn tape_len(&self) -> usize {
        self.tape_len
    }

    /// Length of a backward pass's work buffer.
    pub fn work_len(&self) -> usize {
        self.gradient_len + self.spill_len + self.scratch_len
    }

    /// What the tapes are kept for.
    pub fn purpose(&self) -> Purpose {
        self.purpose
    }

    /// Number of inputs.
    pub fn input_count(&self) -> usize {
        self.inputs.len()
    }

    /// Length of input `i`, 0 if there is none.
    pub fn input_len(&self, i: usize) -> usize {
        self.input_node(i).map_or(0, |n| n.len)
    }

    /// Whether the backward passes reach input `i`.
    pub fn is_explained(&self, i: usize) -> bool {
        self.input_node(i).is_ok_and(|n| n.reaches_input && n.live)
    }

    /// Length of the output.
    pub fn output_len(&self) -> usize {
        self.nodes.get(self.output).map_or(0, |n| n.len)
    }

    fn input_node(&self, i: usize) -> Result<&Node, ShapeError> {
        let node = self.inputs.get(i).and_then(|n| self.nodes.get(*n));
        node.map_or_else(|| description("graph", "there is no input of that number"), Ok)
    }

    fn node(&self, id: usize) -> Result<&Node, ShapeError> {
        let node = self.nodes.get(id);
        node.map_or_else(|| description("graph", "a node belongs to another graph"), Ok)
    }

    /// The output on a tape.
    ///
    /// # Errors
    /// A tape of another length.
    pub fn output<'a>(&self, tape: &'a [f32]) -> Result<&'a [f32], ShapeError> {
        self.value(tape, NodeId(self.output))
    }

    /// A node's value on a tape.
    ///
    /// # Errors
    /// A tape of another length, a node of another graph.
    pub fn value<'a>(&self, tape: &'a [f32], node: NodeId) -> Result<&'a [f32], ShapeError> {
        let node = self.node(node.0)?;
        part("tape", tape, node.at, node.len)
    }

    /// Input `i` on a tape.
    ///
    /// # Errors
    /// A tape of another length, no such input.
    pub fn input<'a>(&self, tape: &'a [f32], i: usize) -> Result<&'a [f32], ShapeError> {
        let node = self.input_node(i)?;
        part("tape", tape, node.at, node.len)
    }

    /// The gradient or multipliers of input `i` after a backward pass. Meaningless unless [`Self::is_explained`].
    ///
    /// # Errors
    /// A work buffer of another length, no such input.
    pub fn input_gradient<'a>(&self, work: &'a [f32], i: usize) -> Result<&'a [f32], ShapeError> {
        let node = self.input_node(i)?;
        part("work buffer", work, node.gradient_at, node.len)
    }
}

#[cfg(feature = "train")]
impl Graph {
    /// Draws first weights as PyTorch does: convolutions and dense layers uniform within ±1/√(inputs of a unit),
    /// recurrent layers within ±1/√hidden, biases alike; batch norm starts as the identity.
    ///
    /// # Errors
    /// A slice of another length.
    pub fn initialize(&self, rng: &mut impl rand::Rng, params: &mut [f32]) -> Result<(), ShapeError> {
        expect("network parameters", params, self.param_len)?;
        // Shared parameters are drawn once, by their first user.
        let mut done = Vec::new();
        for node in &self.nodes {
            let Params { at, len } = node.params;
            if len == 0 || done.contains(&node.params) {
                continue;
            }
            done.push(node.params);
            let own = part_mut("network parameters", params, at, len)?;
            let draw = &mut |limit: f32| rand::RngExt::random_range(rng, -limit..=limit);
            node.operation.get().initialize_node(own, draw);
        }
        Ok(())
    }
}
