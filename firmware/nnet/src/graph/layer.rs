//! What layers of one kind share as nodes: those with weights before a curve, and steps of recurrent ones.

/// A layer with weights before a curve as a node: how many inputs a unit has, how much scratch its input gradient needs, and that
/// gradient, of the packed parameters and the gradient before the curve.
macro_rules! weighted_operation {
    ($layer:ty, $fan_in:expr, $scratch_len:expr, $input_gradient:expr) => {
        impl $crate::graph::operation::Operation for ($layer, Activation) {
            /// The values before the curve, which its multipliers need.
            fn aux_len(&self, len: usize, purpose: $crate::Purpose) -> usize {
                let is_kept = purpose == $crate::Purpose::Multipliers && self.1 != Activation::Identity;
                if is_kept { len } else { 0 }
            }

            fn scratch_len(&self) -> usize {
                const SCRATCH_LEN: fn(&$layer) -> usize = $scratch_len;
                SCRATCH_LEN(&self.0)
            }

            fn forward_node(&self, node: &mut $crate::graph::run::Forward<'_>) -> Result<(), ShapeError> {
                let (x, pre) = (node.source(0)?, $crate::graph::run::unless_empty(node.aux));
                self.0.forward(node.isa, node.params, self.1, x, pre, node.value)
            }

            fn backward_node(
                &self,
                node: &mut $crate::graph::run::Backward<'_>,
                d: &mut [f32],
                pass: &mut $crate::graph::run::Pass<'_>,
            ) -> Result<(), ShapeError> {
                type InputGradient<T> = fn(&T, Isa, &[f32], &[f32], &mut [f32], &mut [f32]) -> Result<(), ShapeError>;
                const INPUT_GRADIENT: InputGradient<$layer> = $input_gradient;
                let ((layer, activation), isa, packed) = (self, node.isa, node.packed);
                node.through(*activation, d, pass)?;
                if let Some(d_params) = node.d_params(pass)? {
                    layer.weight_gradient(isa, node.source(0, node.tape)?, d, d_params)?;
                }
                node.write_source(0, |dx, scratch| {
                    let scratch = part_mut("work buffer", scratch, 0, self.scratch_len())?;
                    INPUT_GRADIENT(layer, isa, packed, d, dx, scratch)
                })
            }

            fn pack_node(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
                self.0.pack(params, packed)
            }

            #[cfg(feature = "train")]
            fn initialize_node(&self, params: &mut [f32], draw: &mut dyn FnMut(f32) -> f32) {
                const FAN_IN: fn(&$layer) -> usize = $fan_in;
                $crate::graph::operation::draw_for(FAN_IN(&self.0), params, draw);
            }
        }
    };
}
pub(crate) use weighted_operation;

/// What recurrent layers of so many gates share: their two matrices, and a step as a node, whose sources are input and state.
macro_rules! recurrent_operation {
    ($layer:ty, $gates:literal) => {
        impl $layer {
            fn input(&self) -> usize {
                self.inputs * $gates * self.hidden
            }

            fn recurrent(&self) -> usize {
                self.hidden * $gates * self.hidden
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
                let (isa, packed, tape) = (node.isa, node.packed, node.tape);
                let reference_tape = pass.reference().unwrap_or(tape);
                let (now, reference) = (node.kept(tape)?, node.kept(reference_tape)?);
                let (x, state) = (node.source(0, tape)?, node.source(1, tape)?);
                let step = (state, now.aux, now.value);
                let reference = (node.source(1, reference_tape)?, reference.aux, reference.value);
                let d_params = node.d_params(pass)?;
                node.write_both_sources(|dx, d_state, scratch| {
                    let d_gates = $crate::shape::part_mut("work buffer", scratch, 0, self.gate_gradient_len())?;
                    self.backward(isa, packed, step, reference, d, d_gates, dx, d_state)?;
                    match d_params {
                        Some(d_params) => self.weight_gradient(isa, x, state, d_gates, d_params),
                        None => Ok(()),
                    }
                })
            }

            /// Both matrices transposed, biases unused.
            fn pack_node(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
                $crate::gru::pack_matrices([self.inputs, self.hidden], $gates * self.hidden, params, packed)
            }

            #[cfg(feature = "train")]
            fn initialize_node(&self, params: &mut [f32], draw: &mut dyn FnMut(f32) -> f32) {
                $crate::graph::operation::draw_for(self.hidden, params, draw);
            }
        }
    };
}
pub(crate) use recurrent_operation;
