//! The GRU over five frames' features, with the five products on the input's side made at once.
//!
//! Same parameters and same result as five nodes of a graph; the large input matrix is read once per state instead of five
//! times, which is what an update's recurrent part costs.

use vigil_nnet::{Activation, Aligned, Dense, Gru, Isa, ShapeError};
use vigil_policy::actor::{ACTOR_FRAMES, ACTOR_HIDDEN};

const GATES: usize = 3 * ACTOR_HIDDEN;
/// The recurrent side alone: a GRU without inputs whose projection comes from outside.
const STEP: Gru = Gru {
    inputs: 0,
    hidden: ACTOR_HIDDEN,
};

/// A GRU's parameters in the order its two sides read and write them, and transposed.
pub struct RecurrentParams {
    input: Dense,
    /// Input weights, input bias.
    projection: Aligned,
    projection_packed: Aligned,
    /// Recurrent weights, input bias, recurrent bias.
    step: Aligned,
    step_packed: Aligned,
}

impl RecurrentParams {
    /// For features of a length.
    pub fn new(features: usize) -> Self {
        let input = Dense {
            inputs: features,
            outputs: GATES,
        };
        Self {
            projection: Aligned::zeros(input.param_len()),
            projection_packed: Aligned::zeros(input.param_len()),
            step: Aligned::zeros(STEP.param_len()),
            step_packed: Aligned::zeros(STEP.param_len()),
            input,
        }
    }

    /// Takes over a GRU's parameters ([`Gru`]'s order).
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn set(&mut self, params: &[f32]) -> Result<(), ShapeError> {
        let (input, rest) = params.split_at(self.input.weight_len());
        self.projection[..input.len()].copy_from_slice(input);
        let biases = ACTOR_HIDDEN * GATES;
        self.projection[input.len()..].copy_from_slice(&rest[biases..biases + GATES]);
        self.step.copy_from_slice(rest);
        self.input.pack(&self.projection, &mut self.projection_packed)?;
        STEP.pack(&self.step, &mut self.step_packed)
    }
}

/// Buffers of one state's pass.
pub struct Recurrent {
    projections: Aligned,
    gates: [Vec<f32>; ACTOR_FRAMES],
    states: [[f32; ACTOR_HIDDEN]; ACTOR_FRAMES + 1],
    d_gates: Aligned,
    d_projections: Aligned,
    /// Features and gradients at the projections of all backward passes since [`Self::finish`].
    seen: Vec<f32>,
    d_seen: Vec<f32>,
    /// Gradient with respect to the features after [`Self::backward`], five frames in a row.
    pub d_features: Aligned,
}

impl Recurrent {
    /// For features of a length.
    pub fn new(features: usize) -> Self {
        Self {
            projections: Aligned::zeros(ACTOR_FRAMES * GATES),
            gates: core::array::from_fn(|_| vec![0.0; STEP.gates_len()]),
            states: [[0.0; ACTOR_HIDDEN]; ACTOR_FRAMES + 1],
            d_gates: Aligned::zeros(STEP.gate_gradient_len()),
            d_projections: Aligned::zeros(ACTOR_FRAMES * GATES),
            seen: Vec::new(),
            d_seen: Vec::new(),
            d_features: Aligned::zeros(ACTOR_FRAMES * features),
        }
    }

    /// The state after five frames' features, from zero.
    ///
    /// # Errors
    /// Features of another length.
    pub fn forward(
        &mut self,
        isa: Isa,
        params: &RecurrentParams,
        features: &[f32],
    ) -> Result<[f32; ACTOR_HIDDEN], ShapeError> {
        let projections = &mut self.projections;
        params.input.forward(
            isa,
            &params.projection,
            Activation::Identity,
            features,
            None,
            projections,
        )?;
        for (t, projection) in projections.chunks_exact(GATES).enumerate() {
            let previous = self.states[t];
            STEP.step(
                isa,
                &params.step,
                projection,
                &previous,
                &mut self.gates[t],
                &mut self.states[t + 1],
            )?;
        }
        Ok(self.states[ACTOR_FRAMES])
    }

    /// Adds to `d_params` (a GRU's parameters) the recurrent side's gradient for `d_state`, the gradient at the last state,
    /// and leaves that with respect to the features in [`Self::d_features`] if it is wanted. The input's side follows with
    /// [`Self::finish`].
    ///
    /// # Errors
    /// Slices of other lengths.
    pub fn backward(
        &mut self,
        isa: Isa,
        params: &RecurrentParams,
        features: &[f32],
        d_state: &[f32],
        d_params: &mut [f32],
        features_wanted: bool,
    ) -> Result<(), ShapeError> {
        let weights = params.input.weight_len();
        let d_step = &mut d_params[weights..];
        let mut d = [0.0; ACTOR_HIDDEN];
        d.copy_from_slice(d_state);
        for t in (0..ACTOR_FRAMES).rev() {
            let now = (self.states[t].as_slice(), self.gates[t].as_slice());
            let mut d_previous = [0.0; ACTOR_HIDDEN];
            STEP.backward(
                isa,
                &params.step_packed,
                now,
                now,
                &d,
                &mut self.d_gates,
                &mut [],
                &mut d_previous,
            )?;
            STEP.weight_gradient(isa, &[], now.0, &self.d_gates, d_step)?;
            self.d_projections[t * GATES..(t + 1) * GATES].copy_from_slice(&self.d_gates[..GATES]);
            d = d_previous;
        }
        self.seen.extend_from_slice(features);
        self.d_seen.extend_from_slice(&self.d_projections);
        if features_wanted {
            let d_features = &mut self.d_features;
            params
                .input
                .input_gradient(isa, &params.projection_packed, &self.d_projections, d_features)?;
        }
        Ok(())
    }

    /// Adds to `d_params` the gradient of the input matrix for all backward passes since the last time: in one product,
    /// because the matrix is larger than what each state has to say about it.
    ///
    /// # Errors
    /// Slices of other lengths.
    pub fn finish(&mut self, isa: Isa, params: &RecurrentParams, d_params: &mut [f32]) -> Result<(), ShapeError> {
        let weights = params.input.weight_len();
        // The dense layer adds its bias's gradient behind its weights, where a GRU has recurrent weights; the bias is in the
        // recurrent side's gradient already.
        let mut kept = [0.0; GATES];
        kept.copy_from_slice(&d_params[weights..weights + GATES]);
        params
            .input
            .weight_gradient(isa, &self.seen, &self.d_seen, &mut d_params[..weights + GATES])?;
        d_params[weights..weights + GATES].copy_from_slice(&kept);
        self.seen.clear();
        self.d_seen.clear();
        Ok(())
    }
}
