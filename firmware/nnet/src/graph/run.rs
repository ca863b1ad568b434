//! Evaluating a network forwards and backwards.

use super::{Graph, Layer, Node, Params, Purpose};
use crate::Activation;
use crate::error::{ShapeError, expect, part, part_mut};
use crate::isa::Isa;

/// What a backward pass is for.
enum Pass<'a> {
    /// Gradients at a tape; adds to the parameters' gradient if it is wanted.
    Gradient(Option<&'a mut [f32]>),
    /// Multipliers against this reference tape.
    Multipliers(&'a [f32]),
}

/// A node's value and what it keeps besides, on one tape.
struct Kept<'a> {
    value: &'a [f32],
    aux: &'a [f32],
}

impl Kept<'_> {
    /// The value before the activation.
    fn pre(&self) -> &[f32] {
        if self.aux.is_empty() { self.value } else { self.aux }
    }
}

fn kept<'a>(node: &Node, tape: &'a [f32]) -> Result<Kept<'a>, ShapeError> {
    Ok(Kept {
        value: part("tape", tape, node.at, node.len)?,
        aux: part("tape", tape, node.at + node.len, node.aux_len)?,
    })
}

fn params_of(params: &[f32], range: Params) -> Result<&[f32], ShapeError> {
    part("network parameters", params, range.at, range.len)
}

impl Graph {
    /// Computes all nodes from the inputs.
    ///
    /// # Errors
    /// Slices that do not fit; the tape's content is then undefined.
    pub fn forward(&self, isa: Isa, params: &[f32], inputs: &[&[f32]], tape: &mut [f32]) -> Result<(), ShapeError> {
        expect("network parameters", params, self.param_len)?;
        expect("tape", tape, self.tape_len)?;
        if inputs.len() != self.inputs.len() {
            return Err(ShapeError::Length {
                what: "list of inputs",
                expected: self.inputs.len(),
                got: inputs.len(),
            });
        }
        let mut inputs = inputs.iter();
        for node in &self.nodes {
            let given = if let Layer::Input { .. } = node.layer {
                inputs.next()
            } else {
                None
            };
            if !node.live {
                continue;
            }
            let (before, own) = tape.split_at_mut_checked(node.at).unwrap_or_default();
            let own = part_mut("tape", own, 0, node.len + node.aux_len)?;
            let (value, aux) = own.split_at_mut_checked(node.len).unwrap_or_default();
            let source = |i: usize| -> Result<&[f32], ShapeError> {
                let from = self.source(node, i)?;
                part("tape", before, from.at, from.len)
            };
            let own_params = params_of(params, node.params)?;
            let pre = |aux| if node.aux_len == 0 { None } else { Some(aux) };
            match node.layer {
                Layer::Input { .. } => {
                    let given = given.copied().unwrap_or_default();
                    expect("network input", given, node.len)?;
                    value.copy_from_slice(given);
                }
                Layer::Zeros => value.fill(0.0),
                Layer::Conv2d(layer, act) => layer.forward(isa, own_params, act, source(0)?, pre(aux), value)?,
                Layer::Dense(layer, act) => layer.forward(isa, own_params, act, source(0)?, pre(aux), value)?,
                Layer::Activation(act) => act.apply(isa, source(0)?, value)?,
                Layer::BatchNorm(layer) => layer.forward(isa, own_params, source(0)?, value)?,
                Layer::MaxPool2d(layer) => layer.forward(isa, source(0)?, value)?,
                Layer::Gru(layer) => {
                    let (gates, projection) = aux.split_at_mut_checked(layer.gates_len()).unwrap_or_default();
                    layer.project(isa, own_params, source(0)?, projection)?;
                    layer.step(isa, own_params, projection, source(1)?, gates, value)?;
                }
                Layer::Lstm(layer) => layer.step(isa, own_params, source(0)?, source(1)?, aux, value)?,
                Layer::Concat => {
                    let mut at = 0;
                    for i in 0..node.sources.len() {
                        let from = source(i)?;
                        part_mut("tape", value, at, from.len())?.copy_from_slice(from);
                        at += from.len();
                    }
                }
                Layer::Slice { from } => value.copy_from_slice(part("tape", source(0)?, from, node.len)?),
            }
        }
        Ok(())
    }

    fn source(&self, node: &Node, i: usize) -> Result<&Node, ShapeError> {
        let edge = node.sources.get(i).ok_or(ShapeError::Description {
            what: "graph",
            why: "a node lacks a source",
        })?;
        self.node(edge.source)
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
            match node.layer {
                Layer::Conv2d(layer, _) => layer.pack(from, to)?,
                Layer::Dense(layer, _) => layer.pack(from, to)?,
                Layer::Gru(layer) => layer.pack(from, to)?,
                Layer::Lstm(layer) => layer.pack(from, to)?,
                // Nothing to transpose.
                _ => to.copy_from_slice(from),
            }
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
            return Err(ShapeError::Description {
                what: "graph",
                why: "it was finished for gradients only",
            });
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
            let mut step = Step {
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
            step.run(d, &mut pass)?;
        }
        Ok(())
    }
}

/// One node's turn in a backward pass.
struct Step<'a> {
    graph: &'a Graph,
    isa: Isa,
    node: &'a Node,
    packed: &'a [f32],
    tape: &'a [f32],
    /// Gradients of all earlier nodes.
    before: &'a mut [f32],
    spill: &'a mut [f32],
    scratch: &'a mut [f32],
    wanted: &'a dyn Fn(&Node) -> bool,
}

impl Step<'_> {
    /// Hands the gradient of source `i` to `write`: in place, or beside and added afterwards if another edge was first.
    fn write_source(
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

    fn source_value(&self, i: usize) -> Result<&[f32], ShapeError> {
        let source = self.graph.source(self.node, i)?;
        part("tape", self.tape, source.at, source.len)
    }

    /// Turns the gradient behind a curve into the one before it.
    fn through(&self, act: Activation, d: &mut [f32], pass: &Pass<'_>) -> Result<(), ShapeError> {
        let now = kept(self.node, self.tape)?;
        match pass {
            Pass::Gradient(_) => act.gradient(self.isa, now.value, d),
            Pass::Multipliers(reference) => {
                let reference = kept(self.node, reference)?;
                act.multipliers(self.isa, (now.pre(), now.value), (reference.pre(), reference.value), d)
            }
        }
    }

    fn run(&mut self, d: &mut [f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        let (isa, packed, range) = (self.isa, self.packed, self.node.params);
        // Where this node's parameter gradient goes, if it is wanted.
        fn own<'p>(pass: &'p mut Pass<'_>, range: Params) -> Result<Option<&'p mut [f32]>, ShapeError> {
            match pass {
                Pass::Gradient(Some(d_params)) => {
                    part_mut("parameter gradient", d_params, range.at, range.len).map(Some)
                }
                _ => Ok(None),
            }
        }
        match self.node.layer {
            Layer::Input { .. } | Layer::Zeros => Ok(()),
            Layer::Conv2d(layer, act) => {
                self.through(act, d, pass)?;
                if let Some(d_params) = own(pass, range)? {
                    layer.weight_gradient(isa, self.source_value(0)?, d, d_params)?;
                }
                let scratch_len = layer.input_gradient_scratch_len();
                self.write_source(0, |dx, scratch| {
                    layer.input_gradient(isa, packed, d, dx, part_mut("work buffer", scratch, 0, scratch_len)?)
                })
            }
            Layer::Dense(layer, act) => {
                self.through(act, d, pass)?;
                if let Some(d_params) = own(pass, range)? {
                    layer.weight_gradient(isa, self.source_value(0)?, d, d_params)?;
                }
                self.write_source(0, |dx, _| layer.input_gradient(isa, packed, d, dx))
            }
            Layer::Activation(act) => {
                // The curve's input is the source's value, so it is not kept twice.
                let (x, y) = (self.source_value(0)?, kept(self.node, self.tape)?.value);
                match pass {
                    Pass::Gradient(_) => act.gradient(isa, y, d)?,
                    Pass::Multipliers(reference) => {
                        let source = self.graph.source(self.node, 0)?;
                        let x_ref = part("tape", reference, source.at, source.len)?;
                        let y_ref = kept(self.node, reference)?.value;
                        act.multipliers(isa, (x, y), (x_ref, y_ref), d)?;
                    }
                }
                self.write_source(0, |dx, _| {
                    dx.copy_from_slice(d);
                    Ok(())
                })
            }
            Layer::BatchNorm(layer) => {
                if let Some(d_params) = own(pass, range)? {
                    layer.weight_gradient(packed, self.source_value(0)?, d, d_params)?;
                }
                self.write_source(0, |dx, _| layer.input_gradient(isa, packed, d, dx))
            }
            Layer::MaxPool2d(layer) => {
                let source = self.graph.source(self.node, 0)?;
                let tape = self.tape;
                let x = part("tape", tape, source.at, source.len)?;
                let y = kept(self.node, tape)?.value;
                let reference = match pass {
                    Pass::Gradient(_) => None,
                    Pass::Multipliers(reference) => Some((
                        part("tape", reference, source.at, source.len)?,
                        kept(self.node, reference)?.value,
                    )),
                };
                self.write_source(0, |dx, _| match reference {
                    None => layer.input_gradient(x, y, d, dx),
                    Some(reference) => layer.multipliers((x, y), reference, d, dx),
                })
            }
            Layer::Gru(_) | Layer::Lstm(_) => self.recurrent(d, pass),
            Layer::Concat => {
                let mut at = 0;
                for i in 0..self.node.sources.len() {
                    let len = self.graph.source(self.node, i)?.len;
                    let share = part("work buffer", d, at, len)?;
                    self.write_source(i, |dx, _| {
                        dx.copy_from_slice(share);
                        Ok(())
                    })?;
                    at += len;
                }
                Ok(())
            }
            Layer::Slice { from } => {
                let d = &*d;
                self.write_source(0, |dx, _| {
                    dx.fill(0.0);
                    part_mut("work buffer", dx, from, d.len())?.copy_from_slice(d);
                    Ok(())
                })
            }
        }
    }

    /// Recurrent layers write the gradients of input and state at once: both beside, then to where they belong.
    fn recurrent(&mut self, d: &[f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        let (isa, node, tape) = (self.isa, self.node, self.tape);
        let reference_tape: &[f32] = match pass {
            Pass::Gradient(_) => tape,
            Pass::Multipliers(reference) => reference,
        };
        let x_node = self.graph.source(node, 0)?;
        let state_node = self.graph.source(node, 1)?;
        let x = part("tape", tape, x_node.at, x_node.len)?;
        let state = |tape| part("tape", tape, state_node.at, state_node.len);
        let (now, reference) = (kept(node, tape)?, kept(node, reference_tape)?);
        let spill = core::mem::take(&mut self.spill);
        let (dx, rest) = spill.split_at_mut_checked(x_node.len).unwrap_or_default();
        let d_state = part_mut("work buffer", rest, 0, state_node.len)?;
        let d_params = match pass {
            Pass::Gradient(Some(d_params)) => Some(part_mut(
                "parameter gradient",
                d_params,
                node.params.at,
                node.params.len,
            )?),
            _ => None,
        };
        match node.layer {
            Layer::Gru(layer) => {
                let d_gates = part_mut("work buffer", self.scratch, 0, layer.gate_gradient_len())?;
                let gates = part("tape", now.aux, 0, layer.gates_len())?;
                let gates_ref = part("tape", reference.aux, 0, layer.gates_len())?;
                let step = (state(tape)?, gates);
                let reference = (state(reference_tape)?, gates_ref);
                layer.backward(isa, self.packed, step, reference, d, d_gates, dx, d_state)?;
                if let Some(d_params) = d_params {
                    layer.weight_gradient(isa, x, step.0, d_gates, d_params)?;
                }
            }
            Layer::Lstm(layer) => {
                let d_gates = part_mut("work buffer", self.scratch, 0, layer.gate_gradient_len())?;
                let step = (state(tape)?, now.aux, now.value);
                let reference = (state(reference_tape)?, reference.aux, reference.value);
                layer.backward(isa, self.packed, step, reference, d, d_gates, dx, d_state)?;
                if let Some(d_params) = d_params {
                    layer.weight_gradient(isa, x, step.0, d_gates, d_params)?;
                }
            }
            _ => {}
        }
        for (i, from) in [&*dx, &*d_state].into_iter().enumerate() {
            let source = self.graph.source(node, i)?;
            if !(self.wanted)(source) {
                continue;
            }
            let to = part_mut("work buffer", self.before, source.gradient_at, source.len)?;
            if node.sources.get(i).is_some_and(|edge| edge.adds) {
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
