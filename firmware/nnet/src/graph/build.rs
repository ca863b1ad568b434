//! Describing a network.

use super::operation::AnyOperation;
use super::structure::Input;
use super::{Edge, Graph, Node, NodeId, Params, Purpose};
use crate::aligned::LINE;
use crate::shape::{ShapeError, expect_len};
use alloc::vec;
use alloc::vec::Vec;

/// Collects the nodes of a [`Graph`] in the order in which they are computed. Allocates; nothing after
/// [`GraphBuilder::finish`] does.
#[derive(Debug, Clone, Default)]
pub struct GraphBuilder {
    layers: Vec<(AnyOperation, Vec<usize>, usize, Params)>,
    param_len: usize,
}

pub(crate) fn description<T>(what: &'static str, why: &'static str) -> Result<T, ShapeError> {
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

    /// Values of a node.
    pub(crate) fn len_of(&self, node: NodeId) -> Result<usize, ShapeError> {
        match self.layers.get(node.0) {
            Some((_, _, len, _)) => Ok(*len),
            None => description("graph", "a node belongs to another graph"),
        }
    }

    /// Adds a node of `len` values.
    pub(crate) fn add(
        &mut self,
        operation: impl Into<AnyOperation>,
        sources: &[NodeId],
        len: usize,
        params: Params,
    ) -> Result<NodeId, ShapeError> {
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
            .push((operation.into(), sources.iter().map(|s| s.0).collect(), len, params));
        Ok(NodeId(self.layers.len() - 1))
    }

    /// Refuses a source of another length.
    pub(crate) fn check(&self, what: &'static str, source: NodeId, expected: usize) -> Result<(), ShapeError> {
        expect_len(what, self.len_of(source)?, expected)
    }

    /// Refuses parameters of another length.
    pub(crate) fn check_params(what: &'static str, params: Params, expected: usize) -> Result<(), ShapeError> {
        expect_len(what, params.len, expected)
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
        for ((operation, sources, len, params), live) in self.layers.into_iter().zip(live) {
            let aux_len = operation.get().aux_len(len, purpose);
            if let AnyOperation::Input(_) = operation {
                inputs.push(nodes.len());
            }
            let of = |flag: fn(&Node) -> bool| sources.iter().any(|s| nodes.get(*s).is_some_and(flag));
            let node = Node {
                reaches_input: matches!(operation, AnyOperation::Input(Input { explained: true }))
                    || of(|n| n.reaches_input),
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
                operation,
                params,
                live,
            };
            scratch_len = scratch_len.max(node.operation.get().scratch_len());
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
