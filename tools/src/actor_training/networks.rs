//! The actor's first weights, and its encoder as a graph. The kept frames are contrast already, so training starts behind the
//! contrast layer.

use rand::{Rng, RngExt};
use vigil_nnet::{Dense, Graph, GraphBuilder, Params, Purpose, ShapeError};
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_LIMIT, ACTOR_OUTPUTS, ActorParams, ActorSpec, GOAL_INPUTS};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS};

/// The dimensions while training.
pub const SPEC: ActorSpec = ActorSpec {
    rows: DEPTH_ROWS,
    cols: DEPTH_COLS,
    near_contrast: false,
    told_of_movers: false,
};

const POSITIONAL: Dense = Dense {
    inputs: GOAL_INPUTS,
    outputs: 6,
};
const ACTOR_DENSE: Dense = Dense {
    inputs: ACTOR_HIDDEN + POSITIONAL.outputs,
    outputs: 32,
};
const ACTOR_OUT: Dense = Dense {
    inputs: ACTOR_DENSE.outputs,
    outputs: ACTOR_OUTPUTS,
};
/// Contrast varies by about a third of what later layers get.
const CONTRAST_GAIN: f32 = 3.0;
/// Bias of the forward output at first, before the tanh: an actor that hovers gathers nothing.
const FORWARD_AT_FIRST: f32 = 1.0;
/// Layers with more inputs than this learn at a lower rate.
const FULL_RATE_INPUTS: f32 = 64.0;
/// Largest weight of the last layers at first (Lillicrap et al. 2016).
const LAST_LAYER_LIMIT: f32 = 3e-3;

/// The actor's graph of one frame, and where its layers keep their parameters.
pub struct Networks {
    /// One frame of contrast to features; the actor's parameters.
    pub encoder: Graph,
    actor: ActorParams,
}

impl Networks {
    /// Describes them.
    ///
    /// # Errors
    /// Layers that do not fit each other, which would be a mistake here.
    pub fn new() -> Result<Self, ShapeError> {
        let actor = SPEC.reserve(&mut GraphBuilder::new());
        Ok(Self {
            encoder: SPEC.encoder_graph(Purpose::Gradients, false)?,
            actor,
        })
    }

    /// Number of the actor's parameters, the encoder's first.
    pub fn actor_len(&self) -> usize {
        self.encoder.param_len()
    }

    /// Number of the encoder's parameters.
    pub fn encoder_len(&self) -> usize {
        self.actor.gru.at
    }

    /// Random weights: convolutions and dense layers keep the variance of what passes through them, last layers are small,
    /// biases are 0. Each filter's weights sum to 0, so what all pictures have in common does not pass.
    pub fn initial(&self, rng: &mut impl Rng) -> Vec<f32> {
        let mut actor = vec![0.0; self.actor_len()];
        for (layer, at) in SPEC.convolutions().iter().zip(self.actor.convolutions) {
            let fan_in = layer.kernel * layer.kernel * layer.channels;
            // ELU passes on about two thirds of the variance.
            let gain = if layer.channels == 1 { CONTRAST_GAIN } else { 1.0 };
            uniform(
                rng,
                &mut actor,
                at.at,
                layer.weight_len(),
                gain * (4.5 / fan_in as f32).sqrt(),
            );
            let weights = &mut actor[at.at..at.at + layer.weight_len()];
            for filter in 0..layer.filters {
                let mean = weights.iter().skip(filter).step_by(layer.filters).sum::<f32>() / fan_in as f32;
                weights
                    .iter_mut()
                    .skip(filter)
                    .step_by(layer.filters)
                    .for_each(|w| *w -= mean);
            }
        }
        gru(rng, &mut actor, self.actor.gru);
        dense(rng, &mut actor, self.actor.positional, POSITIONAL);
        dense(rng, &mut actor, self.actor.dense, ACTOR_DENSE);
        uniform(
            rng,
            &mut actor,
            self.actor.output.at,
            self.actor.output.len,
            LAST_LAYER_LIMIT,
        );
        actor[self.actor.output.at + ACTOR_OUT.weight_len()] = FORWARD_AT_FIRST;
        actor
    }
}

fn rate_share(fan_in: usize) -> f32 {
    (FULL_RATE_INPUTS / fan_in as f32).min(1.0)
}

/// Each parameter's share of the learning rate: weights of a layer with many inputs move less, because all of them move at once.
/// At one rate for all, the 1 024 features drive the GRU into saturation within a hundred updates, and nothing that the image
/// shows reaches the actor any more (docs/learning.md).
pub fn rate_shares_of(spec: ActorSpec) -> Vec<f32> {
    let mut b = GraphBuilder::new();
    let at = spec.reserve(&mut b);
    let mut shares = vec![1.0; at.output.at + at.output.len];
    for (layer, at) in spec.convolutions().iter().zip(at.convolutions) {
        let fan_in = layer.kernel * layer.kernel * layer.channels;
        shares[at.at..at.at + layer.weight_len()].fill(rate_share(fan_in));
    }
    let gru = spec.gru();
    shares[at.gru.at..][..gru.inputs * 3 * gru.hidden].fill(rate_share(gru.inputs));
    shares
}

fn uniform(rng: &mut impl Rng, params: &mut [f32], at: usize, len: usize, limit: f32) {
    for p in &mut params[at..at + len] {
        *p = rng.random_range(-limit..limit);
    }
}

fn dense(rng: &mut impl Rng, params: &mut [f32], at: Params, layer: Dense) {
    uniform(
        rng,
        params,
        at.at,
        layer.weight_len(),
        (3.0 / layer.inputs as f32).sqrt(),
    );
}

fn gru(rng: &mut impl Rng, params: &mut [f32], at: Params) {
    let layer = SPEC.gru();
    let (input, recurrent) = (layer.inputs * 3 * layer.hidden, layer.hidden * 3 * layer.hidden);
    uniform(rng, params, at.at, input, (3.0 / layer.inputs as f32).sqrt());
    uniform(
        rng,
        params,
        at.at + input,
        recurrent,
        (1.0 / layer.hidden as f32).sqrt(),
    );
}

/// The actor's output from what is before its last tanh.
pub fn squash(pre: &[f32]) -> [f32; 2] {
    [ACTOR_LIMIT * libm::tanhf(pre[0]), ACTOR_LIMIT * libm::tanhf(pre[1])]
}
