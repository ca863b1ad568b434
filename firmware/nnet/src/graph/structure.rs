//! Nodes that compute nothing: inputs, constants, and values put together or cut out.

use super::build::GraphBuilder;
use super::operation::Operation;
use super::run::{Backward, Forward, Pass};
use super::{NodeId, Params};
use crate::shape::{ShapeError, expect, part, part_mut};

/// An input of the network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Input {
    /// The backward passes shall reach it.
    pub explained: bool,
}

/// Constant zeros.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Zeros;

/// Values of all sources, one after the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Concat;

/// Values of a source from this place on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Slice {
    from: usize,
}

impl GraphBuilder {
    /// An input of the network. Inputs are numbered from 0 in the order they are added. `explained` says whether the
    /// backward passes shall reach it; leaving out what nobody asks for saves the first layers' work.
    ///
    /// # Errors
    /// A zero length.
    pub fn input(&mut self, len: usize, explained: bool) -> Result<NodeId, ShapeError> {
        self.add(Input { explained }, &[], len, Params::default())
    }

    /// Constant zeros: a recurrent layer's first state.
    ///
    /// # Errors
    /// A zero length.
    pub fn zeros(&mut self, len: usize) -> Result<NodeId, ShapeError> {
        self.add(Zeros, &[], len, Params::default())
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
        self.add(Concat, parts, len, Params::default())
    }

    /// Values `from..from + len` of a node.
    ///
    /// # Errors
    /// A range outside the node.
    pub fn slice(&mut self, x: NodeId, from: usize, len: usize) -> Result<NodeId, ShapeError> {
        let (what, expected, got) = ("sliced node", from + len, self.len_of(x)?);
        if expected > got {
            return Err(ShapeError::Length { what, expected, got });
        }
        self.add(Slice { from }, &[x], len, Params::default())
    }
}

impl Operation for Input {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        expect("network input", node.given, node.value.len())?;
        node.value.copy_from_slice(node.given);
        Ok(())
    }
}

impl Operation for Zeros {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        node.value.fill(0.0);
        Ok(())
    }
}

impl Operation for Concat {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        let mut at = 0;
        for i in 0..node.source_count() {
            let from = node.source(i)?;
            part_mut("tape", node.value, at, from.len())?.copy_from_slice(from);
            at += from.len();
        }
        Ok(())
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], _: &mut Pass<'_>) -> Result<(), ShapeError> {
        let mut at = 0;
        for i in 0..node.source_count() {
            let len = node.source_len(i)?;
            let share = part("work buffer", d, at, len)?;
            node.hand_on(i, share)?;
            at += len;
        }
        Ok(())
    }
}

impl Operation for Slice {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        let from = part("tape", node.source(0)?, self.from, node.value.len())?;
        node.value.copy_from_slice(from);
        Ok(())
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], _: &mut Pass<'_>) -> Result<(), ShapeError> {
        node.write_source(0, |dx, _| {
            dx.fill(0.0);
            part_mut("work buffer", dx, self.from, d.len())?.copy_from_slice(d);
            Ok(())
        })
    }
}
