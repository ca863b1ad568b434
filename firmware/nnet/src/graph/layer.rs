//! What layers of one kind share as nodes: those with weights before a curve, and steps of recurrent ones.

use super::run::{Backward, Pass};
use crate::activation::Activation;
use crate::shape::{ShapeError, part_mut};

/// The backward pass of a layer with weights before a curve. `add_weight_gradient` gets the input, the gradient before the
/// curve and the parameters' gradient; `write_input_gradient` the gradient before the curve, the input's and scratch.
pub(crate) fn weighted_backward(
    node: &mut Backward<'_>,
    activation: Activation,
    d: &mut [f32],
    pass: &mut Pass<'_>,
    add_weight_gradient: impl FnOnce(&[f32], &[f32], &mut [f32]) -> Result<(), ShapeError>,
    write_input_gradient: impl FnOnce(&[f32], &mut [f32], &mut [f32]) -> Result<(), ShapeError>,
) -> Result<(), ShapeError> {
    node.through(activation, d, pass)?;
    if let Some(d_params) = node.d_params(pass)? {
        add_weight_gradient(node.source(0, node.tape)?, d, d_params)?;
    }
    node.write_source(0, |dx, scratch| write_input_gradient(d, dx, scratch))
}

/// A step as the tape keeps it: the state before it, what it keeps besides its value, the state after it.
pub(crate) type Step<'a> = (&'a [f32], &'a [f32], &'a [f32]);

/// The backward pass of a recurrent layer's step, whose sources are input and state. `backward` gets the step, the one it is
/// measured against, and the gradients of the gates, of the input and of the state to write; `add_weight_gradient` the input,
/// the state, the gradient of the gates and the parameters' gradient.
pub(crate) fn recurrent_backward(
    node: &mut Backward<'_>,
    pass: &mut Pass<'_>,
    gate_gradient_len: usize,
    backward: impl FnOnce(Step<'_>, Step<'_>, &mut [f32], &mut [f32], &mut [f32]) -> Result<(), ShapeError>,
    add_weight_gradient: impl FnOnce(&[f32], &[f32], &[f32], &mut [f32]) -> Result<(), ShapeError>,
) -> Result<(), ShapeError> {
    let tape = node.tape;
    let reference_tape = pass.reference().unwrap_or(tape);
    let (now, reference) = (node.kept(tape)?, node.kept(reference_tape)?);
    let (x, state) = (node.source(0, tape)?, node.source(1, tape)?);
    let step = (state, now.aux, now.value);
    let reference = (node.source(1, reference_tape)?, reference.aux, reference.value);
    let d_params = node.d_params(pass)?;
    node.write_both_sources(|dx, d_state, scratch| {
        let d_gates = part_mut("work buffer", scratch, 0, gate_gradient_len)?;
        backward(step, reference, d_gates, dx, d_state)?;
        match d_params {
            Some(d_params) => add_weight_gradient(x, state, d_gates, d_params),
            None => Ok(()),
        }
    })
}

/// What recurrent layers of so many gates share: their two matrices, and a step as a node, whose sources are input and state.
macro_rules! recurrent_operation {
    ($layer:ty, $name:literal, $gates:literal) => {
        impl $layer {
            fn input(&self) -> usize {
                self.inputs * $gates * self.hidden
            }

            fn recurrent(&self) -> usize {
                self.hidden * $gates * self.hidden
            }

            /// Writes the parameters in the order that the backward passes read: both matrices transposed, biases unused.
            ///
            /// # Errors
            /// Slices that do not fit.
            pub fn pack(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
                $crate::shape::expect(concat!($name, " parameters"), params, self.param_len())?;
                $crate::shape::expect(concat!("packed ", $name, " parameters"), packed, self.param_len())?;
                $crate::gru::pack_matrices([self.inputs, self.hidden], $gates * self.hidden, params, packed)
            }
        }

        impl $crate::graph::operation::Operation for $layer {
            fn aux_len(&self, _len: usize, _purpose: $crate::Purpose) -> usize {
                self.gates_len()
            }

            fn scratch_len(&self) -> usize {
                self.gate_gradient_len()
            }

            fn forward_node(&self, node: &mut $crate::graph::run::Forward<'_>) -> Result<(), ShapeError> {
                let (x, state) = (node.source(0)?, node.source(1)?);
                self.step(node.isa, node.params, x, state, node.aux, node.value)
            }

            fn backward_node(
                &self,
                node: &mut $crate::graph::run::Backward<'_>,
                d: &mut [f32],
                pass: &mut $crate::graph::run::Pass<'_>,
            ) -> Result<(), ShapeError> {
                let (isa, packed) = (node.isa, node.packed);
                $crate::graph::layer::recurrent_backward(
                    node,
                    pass,
                    self.gate_gradient_len(),
                    |step, reference, d_gates, dx, d_state| {
                        self.backward(isa, packed, step, reference, d, d_gates, dx, d_state)
                    },
                    |x, state, d_gates, d_params| self.weight_gradient(isa, x, state, d_gates, d_params),
                )
            }

            fn pack_node(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
                self.pack(params, packed)
            }

            #[cfg(feature = "train")]
            fn initialize_node(&self, params: &mut [f32], draw: &mut dyn FnMut(f32) -> f32) {
                $crate::graph::operation::draw_for(self.hidden, params, draw);
            }
        }
    };
}
pub(crate) use recurrent_operation;
