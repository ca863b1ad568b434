//! Evaluating a network forwards and backwards.

use super::{AnyOperation, Graph, Node, Params, Purpose, description};
use crate::Activation;
use crate::isa::Isa;
use crate::shape::{ShapeError, expect, expect_len, part, part_mut};

/// What a backward pass is for.
pub(crate) enum Pass<'a> {
    /// Gradients at a tape; adds to the parameters' gradient if it is wanted.
    Gradient(Option<&'a mut [f32]>),
    /// Multipliers against this reference tape.
    Multipliers(&'a [f32]),
}

impl<'a> Pass<'a> {
    /// The reference tape of multipliers.
    pub fn reference(&self) -> Option<&'a [f32]> {
        match self {
            Self::Gradient(_) => None,
            Self::Multipliers(reference) => Some(reference),
        }
    }
}

/// A node's value and what it keeps besides, on one tape.
pub(crate) struct Kept<'a> {
    pub value: &'a [f32],
    pub aux: &'a [f32],
}

impl Kept<'_> {
    /// The value before the activation.
    fn pre(&self) -> &[f32] {
        if self.aux.is_empty() { self.value } else { self.aux }
    }
}

fn params_of(params: &[f32], range: Params) -> Result<&[f32], ShapeError> {
    part("network parameters", params, range.at, range.len)
}

/// One node's turn in an evaluation.
pub(crate) struct Forward<'a> {
    graph: &'a Graph,
    node: &'a Node,
    pub isa: Isa,
    /// The node's own parameters.
    pub params: &'a [f32],
    /// Values of all earlier nodes.
    before: &'a [f32],
    /// What was given for it, if it is an input of the network.
    pub given: &'a [f32],
    /// The node's value, to be written.
    pub value: &'a mut [f32],
    /// What it keeps besides, to be written; empty where it keeps nothing.
    pub aux: &'a mut [f32],
}

impl<'a> Forward<'a> {
    /// How many sources the node has.
    pub fn source_count(&self) -> usize {
        self.node.sources.len()
    }

    /// The value of source `i`.
    pub fn source(&self, i: usize) -> Result<&'a [f32], ShapeError> {
        let from = self.graph.source(self.node, i)?;
        part("tape", self.before, from.at, from.len)
    }
}

/// `None` for nothing.
pub(crate) fn unless_empty(values: &mut [f32]) -> Option<&mut [f32]> {
    Some(values).filter(|values| !values.is_empty())
}

impl Graph {
    /// Computes all nodes from the inputs.
    ///
    /// # Errors
    /// Slices that do not fit; the tape's content is then undefined.
    pub fn forward(&self, isa: Isa, params: &[f32], inputs: &[&[f32]], tape: &mut [f32]) -> Result<(), ShapeError> {
        expect("network parameters", params, self.param_len)?;
        expect("tape", tape, self.tape_len)?;
        expect_len("list of inputs", inputs.len(), self.inputs.len())?;
        let mut inputs = inputs.iter();
        for node in &self.nodes {
            let is_input = matches!(node.operation, AnyOperation::Input(_));
            let given = is_input.then(|| inputs.next()).flatten();
            if !node.live {
                continue;
            }
            let (before, own) = tape.split_at_mut_checked(node.at).unwrap_or_default();
            let own = part_mut("tape", own, 0, node.len + node.aux_len)?;
            let (value, aux) = own.split_at_mut_checked(node.len).unwrap_or_default();
            node.operation.get().forward_node(&mut Forward {
                graph: self,
                node,
                isa,
                params: params_of(params, node.params)?,
                before,
                given: given.copied().unwrap_or_default(),
                value,
                aux,
            })?;
        }
        Ok(())
    }

    pub(super) fn source(&self, node: &Node, i: usize) -> Result<&Node, ShapeError> {
        match node.sources.get(i) {
            Some(edge) => self.node(edge.source),
            None => description("graph", "a node lacks a source"),
        }
    }

    /// Writes the parameters in the order that the backward passes read (matrices transposed). To be repeated whenever
    /// the parameters change.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn pack(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
        expect("network parameters", params, self.param_len)?;
        expect("packed parameters", packed, self.param_len)?;
        for node in &self.nodes {
            let from = params_of(params, node.params)?;
            let to = part_mut("packed parameters", packed, node.params.at, node.params.len)?;
            node.operation.get().pack_node(from, to)?;
        }
        Ok(())
    }

    /// Gradient of `Σ d_output · output` at the tape's point: with respect to the explained inputs (left in `work`, see
    /// [`Self::input_gradient`]) and, added to `d_params` if given, to the parameters.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn backward(
        &self,
        isa: Isa,
        packed: &[f32],
        tape: &[f32],
        d_output: &[f32],
        d_params: Option<&mut [f32]>,
        work: &mut [f32],
    ) -> Result<(), ShapeError> {
        if let Some(d_params) = &d_params {
            expect("parameter gradient", d_params, self.param_len)?;
        }
        self.reverse(isa, packed, tape, d_output, Pass::Gradient(d_params), work)
    }

    /// DeepLIFT multipliers (rescale rule, midpoint rule for products) of `Σ m_output · output` between a tape and a
    /// reference tape of the same parameters, left in `work` for the explained inputs (see [`Self::input_gradient`]).
    ///
    /// `Σ m·(x − x_ref)` over all inputs equals `Σ m_output · (output − output_ref)`, but for rounding.
    ///
    /// # Errors
    /// Slices that do not fit, or a graph that was not made for [`Purpose::Multipliers`].
    pub fn multipliers(
        &self,
        isa: Isa,
        packed: &[f32],
        tape: &[f32],
        reference: &[f32],
        m_output: &[f32],
        work: &mut [f32],
    ) -> Result<(), ShapeError> {
        if self.purpose != Purpose::Multipliers {
            return description("graph", "it was finished for gradients only");
        }
        expect("reference tape", reference, self.tape_len)?;
        self.reverse(isa, packed, tape, m_output, Pass::Multipliers(reference), work)
    }

    fn reverse(
        &self,
        isa: Isa,
        packed: &[f32],
        tape: &[f32],
        d_output: &[f32],
        mut pass: Pass<'_>,
        work: &mut [f32],
    ) -> Result<(), ShapeError> {
        expect("packed parameters", packed, self.param_len)?;
        expect("tape", tape, self.tape_len)?;
        expect("work buffer", work, self.work_len())?;
        let (gradients, rest) = work.split_at_mut_checked(self.gradient_len).unwrap_or_default();
        let (spill, scratch) = rest.split_at_mut_checked(self.spill_len).unwrap_or_default();
        let output = self.node(self.output)?;
        expect("output gradient", d_output, output.len)?;
        part_mut("work buffer", gradients, output.gradient_at, output.len)?.copy_from_slice(d_output);
        let weights_wanted = matches!(pass, Pass::Gradient(Some(_)));
        for node in self.nodes.iter().rev() {
            let wanted = |n: &Node| n.reaches_input || (weights_wanted && n.reaches_params);
            if !node.live || !wanted(node) || node.sources.is_empty() {
                continue;
            }
            let (before, own) = gradients.split_at_mut_checked(node.gradient_at).unwrap_or_default();
            let d = part_mut("work buffer", own, 0, node.len)?;
            let mut step = Backward {
                graph: self,
                isa,
                node,
                packed: params_of(packed, node.params)?,
                tape,
                before,
                spill,
                scratch,
                wanted: &wanted,
            };
            node.operation.get().backward_node(&mut step, d, &mut pass)?;
        }
        Ok(())
    }
}

/// One node's turn in a backward pass.
pub(crate) struct Backward<'a> {
    graph: &'a Graph,
    node: &'a Node,
    pub isa: Isa,
    /// The node's own parameters, packed.
    pub packed: &'a [f32],
    pub tape: &'a [f32],
    /// Gradients of all earlier nodes.
    before: &'a mut [f32],
    spill: &'a mut [f32],
    scratch: &'a mut [f32],
    wanted: &'a dyn Fn(&Node) -> bool,
}

impl Backward<'_> {
    /// How many sources the node has.
    pub fn source_count(&self) -> usize {
        self.node.sources.len()
    }

    /// Length of source `i`.
    pub fn source_len(&self, i: usize) -> Result<usize, ShapeError> {
        Ok(self.graph.source(self.node, i)?.len)
    }

    /// The value of source `i` on a tape.
    pub fn source<'t>(&self, i: usize, tape: &'t [f32]) -> Result<&'t [f32], ShapeError> {
        let source = self.graph.source(self.node, i)?;
        part("tape", tape, source.at, source.len)
    }

    /// The node's own value on a tape, and what it keeps besides.
    pub fn kept<'t>(&self, tape: &'t [f32]) -> Result<Kept<'t>, ShapeError> {
        let node = self.node;
        Ok(Kept {
            value: part("tape", tape, node.at, node.len)?,
            aux: part("tape", tape, node.at + node.len, node.aux_len)?,
        })
    }

    /// Where the node's parameter gradient is added, if it is wanted.
    pub fn d_params<'p>(&self, pass: &'p mut Pass<'_>) -> Result<Option<&'p mut [f32]>, ShapeError> {
        let Params { at, len } = self.node.params;
        match pass {
            Pass::Gradient(Some(d_params)) => part_mut("parameter gradient", d_params, at, len).map(Some),
            _ => Ok(None),
        }
    }

    /// Turns the gradient behind a curve into the one before it.
    pub fn through(&self, act: Activation, d: &mut [f32], pass: &Pass<'_>) -> Result<(), ShapeError> {
        let now = self.kept(self.tape)?;
        match pass.reference() {
            None => act.gradient(self.isa, now.value, d),
            Some(reference) => {
                let reference = self.kept(reference)?;
                act.multipliers(self.isa, (now.pre(), now.value), (reference.pre(), reference.value), d)
            }
        }
    }

    /// Source `i` gets this gradient as it is.
    pub fn hand_on(&mut self, i: usize, d: &[f32]) -> Result<(), ShapeError> {
        self.write_source(i, |dx, _| {
            dx.copy_from_slice(d);
            Ok(())
        })
    }

    /// Hands the gradient of source `i` and the scratch to `write`: in place, or beside and added afterwards if another edge was
    /// first.
    pub fn write_source(
        &mut self,
        i: usize,
        write: impl FnOnce(&mut [f32], &mut [f32]) -> Result<(), ShapeError>,
    ) -> Result<(), ShapeError> {
        let source = self.graph.source(self.node, i)?;
        if !(self.wanted)(source) {
            return Ok(());
        }
        let adds = self.node.sources.get(i).is_some_and(|edge| edge.adds);
        let to = part_mut("work buffer", self.before, source.gradient_at, source.len)?;
        if adds {
            let beside = part_mut("work buffer", self.spill, 0, source.len)?;
            write(beside, self.scratch)?;
            for (to, beside) in to.iter_mut().zip(beside) {
                *to += *beside;
            }
            Ok(())
        } else {
            write(to, self.scratch)
        }
    }

    /// Hands the gradients of input and state of a recurrent layer, and the scratch, to `write`, which writes both at once: beside,
    /// then to where they belong.
    pub fn write_both_sources(
        &mut self,
        write: impl FnOnce(&mut [f32], &mut [f32], &mut [f32]) -> Result<(), ShapeError>,
    ) -> Result<(), ShapeError> {
        let (x_len, state_len) = (self.source_len(0)?, self.source_len(1)?);
        let spill = core::mem::take(&mut self.spill);
        let (dx, rest) = spill.split_at_mut_checked(x_len).unwrap_or_default();
        let d_state = part_mut("work buffer", rest, 0, state_len)?;
        write(dx, d_state, self.scratch)?;
        for (i, from) in [&*dx, &*d_state].into_iter().enumerate() {
            let source = self.graph.source(self.node, i)?;
            if !(self.wanted)(source) {
                continue;
            }
            let to = part_mut("work buffer", self.before, source.gradient_at, source.len)?;
            if self.node.sources.get(i).is_some_and(|edge| edge.adds) {
                for (to, from) in to.iter_mut().zip(from) {
                    *to += *from;
                }
            } else {
                to.copy_from_slice(from);
            }
        }
        Ok(())
    }
}
