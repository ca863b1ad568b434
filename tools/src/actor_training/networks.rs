//! Actor and critic as graphs.
//!
//! One encoder serves both: it is the first part of the actor's parameters and is trained by the critic's loss; the actor's
//! own loss stops at the features. The kept frames are contrast already, so training starts behind the contrast layer.

use core::ops::Range;
use rand::{Rng, RngExt};
use vigil_nnet::{Activation, Dense, Graph, GraphBuilder, Gru, NodeId, Params, Purpose, ShapeError};
use vigil_policy::actor::{
    ACTOR_FRAMES, ACTOR_HIDDEN, ACTOR_LIMIT, ACTOR_OUTPUTS, ActorParams, ActorSpec, GOAL_INPUTS,
};
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
const CRITIC_DENSE: Dense = Dense {
    inputs: ACTOR_HIDDEN + POSITIONAL.outputs + ACTOR_OUTPUTS,
    outputs: 128,
};
const CRITIC_DENSE_2: Dense = Dense {
    inputs: CRITIC_DENSE.outputs,
    outputs: 64,
};
const CRITIC_OUT: Dense = Dense {
    inputs: CRITIC_DENSE_2.outputs,
    outputs: 1,
};
/// Contrast varies by about a third of what later layers get.
const CONTRAST_GAIN: f32 = 3.0;
/// Bias of the forward output at first, before the tanh: an actor that hovers gathers nothing.
const FORWARD_AT_FIRST: f32 = 1.0;
/// Layers with more inputs than this learn at a lower rate.
const FULL_RATE_INPUTS: f32 = 64.0;
/// The critic's last bias learns so much faster: the value that all states share is learned there.
const LAST_BIAS_SHARE: f32 = 20.0;
/// Largest weight of the last layers at first (Lillicrap et al. 2016).
const LAST_LAYER_LIMIT: f32 = 3e-3;

/// Where the critic's layers keep their parameters.
#[derive(Debug, Clone, Copy)]
struct CriticParams {
    gru: Params,
    positional: Params,
    dense: Params,
    dense_2: Params,
    output: Params,
}

/// All graphs. The actor's share one parameter slice, the critic's another.
pub struct Networks {
    /// One frame of contrast to features; the actor's parameters.
    pub encoder: Graph,
    /// Five frames' features to the actor's GRU state; the actor's parameters.
    pub actor_recur: Graph,
    /// State and positional values to the outputs before their last tanh; the actor's parameters.
    pub actor_head: Graph,
    /// State, positional values and action to the value; the critic's parameters.
    pub critic_head: Graph,
    actor: ActorParams,
    critic: CriticParams,
}

impl Networks {
    /// Describes them.
    ///
    /// # Errors
    /// Layers that do not fit each other, which would be a mistake here.
    pub fn new() -> Result<Self, ShapeError> {
        let features = SPEC.features();
        let mut b = GraphBuilder::new();
        let actor = SPEC.reserve(&mut b);
        let inputs = frame_features(&mut b, features)?;
        let state = SPEC.recur(&mut b, &actor, &inputs)?;
        let actor_recur = b.finish(state, Purpose::Gradients)?;

        let mut b = GraphBuilder::new();
        let actor = SPEC.reserve(&mut b);
        let state = b.input(ACTOR_HIDDEN, true)?;
        let position = b.input(GOAL_INPUTS, false)?;
        let state = b.activation(state, Activation::TANH)?;
        let position = b.dense(position, POSITIONAL, Activation::TANH, actor.positional)?;
        let joined = b.concat(&[state, position])?;
        let hidden = b.dense(joined, ACTOR_DENSE, Activation::Elu, actor.dense)?;
        let out = b.dense(hidden, ACTOR_OUT, Activation::Identity, actor.output)?;
        let actor_head = b.finish(out, Purpose::Gradients)?;

        let gru = SPEC.gru();
        let (mut b, critic) = critic_builder(gru);
        let state = b.input(ACTOR_HIDDEN, true)?;
        let position = b.input(GOAL_INPUTS, false)?;
        let action = b.input(ACTOR_OUTPUTS, true)?;
        let state = b.activation(state, Activation::TANH)?;
        let position = b.dense(position, POSITIONAL, Activation::TANH, critic.positional)?;
        let joined = b.concat(&[state, position, action])?;
        let hidden = b.dense(joined, CRITIC_DENSE, Activation::Elu, critic.dense)?;
        let hidden = b.dense(hidden, CRITIC_DENSE_2, Activation::Elu, critic.dense_2)?;
        let value = b.dense(hidden, CRITIC_OUT, Activation::Identity, critic.output)?;
        let critic_head = b.finish(value, Purpose::Gradients)?;

        Ok(Self {
            encoder: SPEC.encoder_graph(Purpose::Gradients, false)?,
            actor_recur,
            actor_head,
            critic_head,
            actor,
            critic,
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

    /// Number of the critic's parameters.
    pub fn critic_len(&self) -> usize {
        self.critic_head.param_len()
    }

    /// Where the actor's GRU has its parameters.
    pub fn actor_gru(&self) -> Range<usize> {
        self.actor.gru.at..self.actor.gru.at + self.actor.gru.len
    }

    /// Where the critic's GRU has its parameters.
    pub fn critic_gru(&self) -> Range<usize> {
        self.critic.gru.at..self.critic.gru.at + self.critic.gru.len
    }

    /// The actor's layers by name.
    pub fn actor_layers(&self) -> Vec<(&'static str, Params)> {
        const CONVOLUTIONS: [&str; 5] = [
            "convolution 1",
            "convolution 2",
            "convolution 3",
            "convolution 4",
            "convolution 5",
        ];
        let mut layers: Vec<_> = CONVOLUTIONS.into_iter().zip(self.actor.convolutions).collect();
        layers.extend([
            ("actor GRU", self.actor.gru),
            ("actor positional", self.actor.positional),
            ("actor dense", self.actor.dense),
            ("actor output", self.actor.output),
        ]);
        layers
    }

    /// The critic's layers by name.
    pub fn critic_layers(&self) -> Vec<(&'static str, Params)> {
        vec![
            ("critic GRU", self.critic.gru),
            ("critic positional", self.critic.positional),
            ("critic dense", self.critic.dense),
            ("critic dense 2", self.critic.dense_2),
            ("critic output", self.critic.output),
        ]
    }

    /// Each parameter's share of the learning rate, actor and critic: weights of a layer with many inputs move less, because
    /// all of them move at once. At one rate for all, the 1 024 features drive the GRU into saturation within a hundred
    /// updates, and nothing that the image shows reaches the actor any more (docs/learning.md).
    pub fn rate_shares(&self) -> (Vec<f32>, Vec<f32>) {
        let actor = rate_shares_of(SPEC);
        let mut critic = vec![1.0; self.critic_len()];
        let gru = SPEC.gru();
        critic[self.critic.gru.at..][..gru.inputs * 3 * gru.hidden].fill(rate_share(gru.inputs));
        critic[self.critic.output.at + CRITIC_OUT.weight_len()..][..CRITIC_OUT.outputs].fill(LAST_BIAS_SHARE);
        (actor, critic)
    }

    /// Random weights: convolutions and dense layers keep the variance of what passes through them, last layers are small,
    /// biases are 0. Each filter's weights sum to 0, so what all pictures have in common does not pass.
    pub fn initial(&self, rng: &mut impl Rng) -> (Vec<f32>, Vec<f32>) {
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
        let mut critic = vec![0.0; self.critic_len()];
        gru(rng, &mut critic, self.critic.gru);
        dense(rng, &mut critic, self.critic.positional, POSITIONAL);
        dense(rng, &mut critic, self.critic.dense, CRITIC_DENSE);
        dense(rng, &mut critic, self.critic.dense_2, CRITIC_DENSE_2);
        uniform(
            rng,
            &mut critic,
            self.critic.output.at,
            self.critic.output.len,
            LAST_LAYER_LIMIT,
        );
        (actor, critic)
    }
}

fn rate_share(fan_in: usize) -> f32 {
    (FULL_RATE_INPUTS / fan_in as f32).min(1.0)
}

/// [`Networks::rate_shares`] of an actor of any dimensions.
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

fn frame_features(b: &mut GraphBuilder, features: usize) -> Result<[NodeId; ACTOR_FRAMES], ShapeError> {
    let first = b.input(features, false)?;
    let mut nodes = [first; ACTOR_FRAMES];
    for node in nodes.iter_mut().skip(1) {
        *node = b.input(features, false)?;
    }
    Ok(nodes)
}

fn critic_builder(gru: Gru) -> (GraphBuilder, CriticParams) {
    let mut b = GraphBuilder::new();
    let params = CriticParams {
        gru: b.params(gru.param_len()),
        positional: b.params(POSITIONAL.param_len()),
        dense: b.params(CRITIC_DENSE.param_len()),
        dense_2: b.params(CRITIC_DENSE_2.param_len()),
        output: b.params(CRITIC_OUT.param_len()),
    };
    (b, params)
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
