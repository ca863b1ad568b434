//! The updates: decisions drawn to the teacher's, and so are the ends of their bounds.

use super::kept_flights::{KeptFlights, KeptState};
use super::robust_config::RobustConfig;
use crate::actor_training::adam::{self, Adam};
use crate::actor_training::learner::UpdateError;
use crate::actor_training::networks::{rate_shares_of, squash};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use vigil_adversary::EFFECTIVE_YAW;
use vigil_nnet::{
    Activation, Aligned, Bounds, BoundsGradient, BoundsMut, BoundsParams, Graph, GraphBuilder, Isa, PackedBoundsParams,
    Purpose, Rounding, ShapeError,
};
use vigil_policy::actor::{ACTOR_FRAMES, ACTOR_LIMIT, ACTOR_OUTPUTS, ActorSpec};
use vigil_types::DEPTH_PIXELS;

/// Parts of a batch; fixed, so that the sums do not depend on the threads.
const SHARDS: usize = 4;
/// Steps of contrast that a kept pixel may have.
const LEVELS: usize = 256;
const FORWARD: usize = 0;
const YAW: usize = 1;

/// Means over a batch.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BoundedReport {
    /// Squared distance of the decision from the teacher's.
    pub decision_loss: f32,
    /// Weighted squared distance of the bounds' ends.
    pub bounds_loss: f32,
    /// Share of the states whose yaw is proved to move by less than 1.0 at the update's ε.
    pub certified: f32,
    /// Length of the gradient.
    pub norm: f32,
}

/// The networks of an update: kept frames are contrast already, so both start behind the contrast layer.
struct Networks {
    /// All of it, to prepare all parameters at once.
    whole: Graph,
    encoder: Graph,
    /// Five frames' features and positional values to the outputs before their last tanh.
    rest: Graph,
}

impl Networks {
    fn new(spec: ActorSpec) -> Result<Self, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = spec.reserve(&mut b);
        let features = (0..ACTOR_FRAMES)
            .map(|_| b.input(spec.features(), true))
            .collect::<Result<Vec<_>, _>>()?;
        let position = b.input(spec.positional().inputs, false)?;
        let state = spec.recur(&mut b, &params, &features)?;
        let outputs = spec.head_before_saturation(&mut b, &params, state, position)?;
        Ok(Self {
            whole: spec.graph(Purpose::Gradients, false)?,
            encoder: spec.encoder_graph(Purpose::Gradients, false)?,
            rest: b.finish(outputs, Purpose::Gradients)?,
        })
    }
}

/// What one frame's evaluation leaves for the way back.
struct FrameTapes {
    exact: Aligned,
    lower: Aligned,
    upper: Aligned,
}

/// Buffers of one part of a batch.
struct Shard {
    frames: Vec<FrameTapes>,
    rest: FrameTapes,
    contrast: [Vec<f32>; 3],
    encoder_work: Aligned,
    rest_work: Aligned,
    /// Of the decision, and of its bounds.
    encoder_back: [Aligned; 2],
    rest_back: [Aligned; 2],
    d_params: Aligned,
    d_magnitudes: Aligned,
    report: BoundedReport,
}

/// Actor and optimiser.
pub struct BoundedLearner {
    isa: Isa,
    networks: Networks,
    shares: Vec<f32>,
    shards: Vec<Shard>,
    /// The actor's parameters.
    pub params: Vec<f32>,
    /// Its optimiser.
    pub adam: Adam,
    magnitudes: Vec<f32>,
    packed: Vec<f32>,
    packed_magnitudes: Vec<f32>,
}

/// Contrast of each level, and its ends when the range is altered by up to ε.
struct Contrast {
    exact: [f32; LEVELS],
    lower: [f32; LEVELS],
    upper: [f32; LEVELS],
}

impl Contrast {
    fn within(epsilon: f32) -> Self {
        let Activation::NearContrast { gain } = Activation::NEAR_CONTRAST else {
            unreachable!("the contrast layer is a contrast layer");
        };
        let exact: [f32; LEVELS] = core::array::from_fn(|level| level as f32 / (LEVELS - 1) as f32);
        let altered = |by: f32| {
            exact.map(|contrast| {
                let range = ((1.0 / contrast.max(1e-6) - 1.0) / gain).min(1.0);
                1.0 / (1.0 + gain * (range + by).clamp(0.0, 1.0))
            })
        };
        Self {
            exact,
            lower: altered(epsilon),
            upper: altered(-epsilon),
        }
    }
}

/// Loss of one state and its gradients before the last tanh: at the decision, at the lower and at the upper end.
struct Loss {
    decision: f32,
    bounds: f32,
    certified: bool,
    d: [[f32; ACTOR_OUTPUTS]; 3],
}

fn loss_of(config: &RobustConfig, pre: [[f32; ACTOR_OUTPUTS]; 3], target: [f32; ACTOR_OUTPUTS]) -> Loss {
    let out = pre.map(|pre| squash(&pre));
    let [exact, lower, upper] = out;
    let [yaw_weight, forward_weight] = config.bounds_weight;
    let mut weight = [0.0; ACTOR_OUTPUTS];
    (weight[FORWARD], weight[YAW]) = (forward_weight, yaw_weight);
    let mut loss = Loss {
        decision: 0.0,
        bounds: 0.0,
        certified: (upper[YAW] - exact[YAW]).max(exact[YAW] - lower[YAW]) < EFFECTIVE_YAW,
        d: [[0.0; ACTOR_OUTPUTS]; 3],
    };
    for k in 0..ACTOR_OUTPUTS {
        for (end, share) in [1.0, weight[k], weight[k]].into_iter().enumerate() {
            let error = out[end][k] - target[k];
            loss.d[end][k] = 2.0 * share * error * (ACTOR_LIMIT - out[end][k] * out[end][k] / ACTOR_LIMIT);
            match end {
                0 => loss.decision += error * error,
                _ => loss.bounds += share * error * error,
            }
        }
    }
    loss.bounds += config.width_weight * (pre[2][YAW] - pre[1][YAW]);
    loss.d[1][YAW] -= config.width_weight;
    loss.d[2][YAW] += config.width_weight;
    loss
}

impl BoundedLearner {
    /// Goes on from an actor's parameters.
    ///
    /// # Errors
    /// Parameters of another actor.
    pub fn new(spec: ActorSpec, params: Vec<f32>) -> Result<Self, ShapeError> {
        let spec = ActorSpec {
            near_contrast: false,
            ..spec
        };
        let networks = Networks::new(spec)?;
        let len = networks.rest.param_len();
        vigil_nnet::shape::expect("actor parameters", &params, len)?;
        let (encoder, rest) = (&networks.encoder, &networks.rest);
        let tapes = |graph: &Graph| FrameTapes {
            exact: Aligned::zeros(graph.tape_len()),
            lower: Aligned::zeros(graph.tape_len()),
            upper: Aligned::zeros(graph.tape_len()),
        };
        let back = |graph: &Graph| [graph.work_len(), graph.bounds_backward_work_len()].map(Aligned::zeros);
        let shards = (0..SHARDS)
            .map(|_| Shard {
                frames: (0..ACTOR_FRAMES).map(|_| tapes(encoder)).collect(),
                rest: tapes(rest),
                contrast: core::array::from_fn(|_| vec![0.0; DEPTH_PIXELS]),
                encoder_work: Aligned::zeros(encoder.bounds_work_len()),
                rest_work: Aligned::zeros(rest.bounds_work_len()),
                encoder_back: back(encoder),
                rest_back: back(rest),
                d_params: Aligned::zeros(len),
                d_magnitudes: Aligned::zeros(len),
                report: BoundedReport::default(),
            })
            .collect();
        Ok(Self {
            isa: Isa::detect(),
            shares: rate_shares_of(spec),
            shards,
            adam: Adam::new(len),
            magnitudes: vec![0.0; len],
            packed: vec![0.0; len],
            packed_magnitudes: vec![0.0; len],
            networks,
            params,
        })
    }

    /// One update on a batch drawn from these states.
    ///
    /// # Errors
    /// A gradient that is not finite; the parameters are then as before.
    pub fn update(
        &mut self,
        config: &RobustConfig,
        number: u64,
        states: &KeptFlights,
        rng: &mut ChaCha8Rng,
    ) -> Result<BoundedReport, UpdateError> {
        let drawn: Vec<Draw> = (0..config.batch)
            .map(|_| Draw {
                state: rng.random_range(0..states.len()),
                older: rng.random_range(0..ACTOR_FRAMES - 1),
            })
            .collect();
        let report = self.gradient(config, config.epsilon_at(number), states, &drawn)?;
        let total = &mut self.shards[0];
        let norm = adam::norm(&[&total.d_params]);
        if !norm.is_finite() {
            return Err(UpdateError::NotFinite {
                update: number,
                what: "gradient",
                layer: "actor",
            });
        }
        let scale = adam::shortening(norm, config.gradient_norm);
        total.d_params.iter_mut().for_each(|d| *d *= scale);
        self.adam
            .step(config.rate_at(number), &self.shares, &mut self.params, &total.d_params);
        Ok(BoundedReport {
            norm: norm as f32,
            ..report
        })
    }

    /// Mean loss of these states and its gradient, left in the first part.
    fn gradient(
        &mut self,
        config: &RobustConfig,
        epsilon: f32,
        states: &KeptFlights,
        drawn: &[Draw],
    ) -> Result<BoundedReport, ShapeError> {
        let graph = &self.networks.whole;
        graph.pack(&self.params, &mut self.packed)?;
        graph.magnitudes(&self.params, &mut self.magnitudes)?;
        graph.pack(&self.magnitudes, &mut self.packed_magnitudes)?;
        let step = Step {
            isa: self.isa,
            config,
            share: 1.0 / drawn.len().max(1) as f32,
            networks: &self.networks,
            contrast: Contrast::within(epsilon),
            params: BoundsParams {
                params: &self.params,
                magnitudes: &self.magnitudes,
            },
            packed: PackedBoundsParams {
                params: &self.packed,
                magnitudes: &self.packed_magnitudes,
            },
        };
        let per_shard = drawn.len().div_ceil(SHARDS).max(1);
        let used = drawn.len().div_ceil(per_shard);
        self.shards[..used]
            .par_iter_mut()
            .zip(drawn.par_chunks(per_shard))
            .try_for_each(|(shard, drawn)| step.take(shard, states, drawn))?;
        let (total, others) = self.shards[..used].split_at_mut(1);
        let total = &mut total[0];
        for other in others {
            for (to, from) in [
                (&mut total.d_params, &other.d_params),
                (&mut total.d_magnitudes, &other.d_magnitudes),
            ] {
                to.iter_mut().zip(from.iter()).for_each(|(to, from)| *to += from);
            }
            let (report, more) = (&mut total.report, &other.report);
            report.decision_loss += more.decision_loss;
            report.bounds_loss += more.bounds_loss;
            report.certified += more.certified;
        }
        let gradient = BoundsGradient {
            params: &mut total.d_params,
            magnitudes: &mut total.d_magnitudes,
        };
        graph.add_magnitude_gradient(step.params, gradient)?;
        Ok(total.report)
    }
}

/// A state of a batch.
#[derive(Debug, Clone, Copy)]
struct Draw {
    state: usize,
    /// The older frame through which the gradient goes into the encoder.
    older: usize,
}

/// What all parts of an update share.
struct Step<'a> {
    isa: Isa,
    config: &'a RobustConfig,
    /// Of one state in the batch.
    share: f32,
    networks: &'a Networks,
    contrast: Contrast,
    params: BoundsParams<'a>,
    packed: PackedBoundsParams<'a>,
}

impl Step<'_> {
    fn take(&self, shard: &mut Shard, states: &KeptFlights, drawn: &[Draw]) -> Result<(), ShapeError> {
        shard.d_params.fill(0.0);
        shard.d_magnitudes.fill(0.0);
        shard.report = BoundedReport::default();
        for draw in drawn {
            let state = states.state(draw.state);
            self.look(shard, &state)?;
            self.learn(shard, state.target, draw.older)?;
        }
        Ok(())
    }

    /// Forwards: the decision and its bounds.
    fn look(&self, shard: &mut Shard, state: &KeptState<'_>) -> Result<(), ShapeError> {
        let Networks { encoder, rest, .. } = self.networks;
        let [exact, lower, upper] = &mut shard.contrast;
        for (tapes, frame) in shard.frames.iter_mut().zip(state.frames) {
            for (i, level) in frame.iter().enumerate() {
                let level = usize::from(*level);
                exact[i] = self.contrast.exact[level];
                lower[i] = self.contrast.lower[level];
                upper[i] = self.contrast.upper[level];
            }
            encoder.forward(self.isa, self.params.params, &[exact], &mut tapes.exact)?;
            let mut ends = BoundsMut {
                lower: &mut tapes.lower,
                upper: &mut tapes.upper,
            };
            let given = [Bounds { lower, upper }];
            encoder.bounds(
                self.isa,
                Rounding::Ignored,
                self.params,
                &given,
                &mut ends,
                &mut shard.encoder_work,
            )?;
        }
        let position: &[f32] = state.position;
        let mut exact = [position; ACTOR_FRAMES + 1];
        let mut ends = [Bounds::exactly(position); ACTOR_FRAMES + 1];
        for ((exact, ends), tapes) in exact.iter_mut().zip(&mut ends).zip(&shard.frames) {
            *exact = encoder.output(&tapes.exact)?;
            *ends = encoder.output_bounds(Bounds {
                lower: &tapes.lower,
                upper: &tapes.upper,
            })?;
        }
        rest.forward(self.isa, self.params.params, &exact, &mut shard.rest.exact)?;
        let mut tapes = BoundsMut {
            lower: &mut shard.rest.lower,
            upper: &mut shard.rest.upper,
        };
        rest.bounds(
            self.isa,
            Rounding::Ignored,
            self.params,
            &ends,
            &mut tapes,
            &mut shard.rest_work,
        )
    }

    /// Backwards: into the encoder through the newest frame and one drawn older one, weighted so that all five count on average.
    fn learn(&self, shard: &mut Shard, target: [f32; ACTOR_OUTPUTS], older: usize) -> Result<(), ShapeError> {
        let Networks { encoder, rest, .. } = self.networks;
        let outputs = |tape: &[f32]| -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
            let out = rest.output(tape)?;
            Ok([out[FORWARD], out[YAW]])
        };
        let pre = [
            outputs(&shard.rest.exact)?,
            outputs(&shard.rest.lower)?,
            outputs(&shard.rest.upper)?,
        ];
        let loss = loss_of(self.config, pre, target);
        let share = self.share;
        shard.report.decision_loss += share * loss.decision;
        shard.report.bounds_loss += share * loss.bounds;
        shard.report.certified += if loss.certified { share } else { 0.0 };
        let [d_exact, d_lower, d_upper] = loss.d.map(|d| d.map(|d| share * d));
        let ([back, back_bounds], [encoder_back, encoder_back_bounds]) =
            (&mut shard.rest_back, &mut shard.encoder_back);
        rest.backward(
            self.isa,
            self.packed.params,
            &shard.rest.exact,
            &d_exact,
            Some(&mut shard.d_params),
            back,
        )?;
        rest.bounds_backward(
            self.isa,
            self.packed,
            Bounds {
                lower: &shard.rest.lower,
                upper: &shard.rest.upper,
            },
            Bounds {
                lower: &d_lower,
                upper: &d_upper,
            },
            BoundsGradient {
                params: &mut shard.d_params,
                magnitudes: &mut shard.d_magnitudes,
            },
            back_bounds,
        )?;
        for (frame, weight) in [(ACTOR_FRAMES - 1, 1.0), (older, (ACTOR_FRAMES - 1) as f32)] {
            let tapes = &shard.frames[frame];
            let weighted = |d: &[f32]| -> Vec<f32> { d.iter().map(|d| weight * d).collect() };
            let d = weighted(rest.input_gradient(back, frame)?);
            let ends = rest.input_bounds_gradient(back_bounds, frame)?;
            let (d_lower, d_upper) = (weighted(ends.lower), weighted(ends.upper));
            encoder.backward(
                self.isa,
                self.packed.params,
                &tapes.exact,
                &d,
                Some(&mut shard.d_params),
                encoder_back,
            )?;
            encoder.bounds_backward(
                self.isa,
                self.packed,
                Bounds {
                    lower: &tapes.lower,
                    upper: &tapes.upper,
                },
                Bounds {
                    lower: &d_lower,
                    upper: &d_upper,
                },
                BoundsGradient {
                    params: &mut shard.d_params,
                    magnitudes: &mut shard.d_magnitudes,
                },
                encoder_back_bounds,
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::kept_flights::Pair;
    use super::*;
    use vigil_policy::FrozenActor;

    /// Through every layer, for the decision and for its bounds: what the loss does when a layer moves along its gradient is what the
    /// gradient says.
    #[test]
    fn the_gradient_is_what_the_loss_does() {
        let actor = FrozenActor::built_in().unwrap();
        let config = RobustConfig {
            states: 24,
            width_weight: 0.0,
            ..RobustConfig::default()
        };
        let pair = Pair {
            student: &actor.params,
            teacher: &actor.params,
            inputs: actor.inputs,
        };
        let states = KeptFlights::fly(&config, 0, pair).unwrap();
        // Weaker layers: the built-in actor's bounds are saturated, and have no slope.
        let params: Vec<f32> = actor.params.iter().map(|p| 0.6 * p).collect();
        let spec = actor.inputs.spec();
        let mut learner = BoundedLearner::new(spec, params.clone()).unwrap();
        // Each older frame once: their mean is the gradient through all five.
        let drawn: Vec<Draw> = (0..ACTOR_FRAMES - 1)
            .map(|older| Draw {
                state: states.len() - 1,
                older,
            })
            .collect();
        let epsilon = 0.05 / 255.0;
        let first = learner.gradient(&config, epsilon, &states, &drawn).unwrap();
        assert!(first.bounds_loss > 1e-3 && first.decision_loss > 1e-3, "{first:?}");
        let gradient = learner.shards[0].d_params.to_vec();
        let loss = |learner: &mut BoundedLearner, by: f32, at: &std::ops::Range<usize>| {
            learner.params.copy_from_slice(&params);
            let norm = adam::norm(&[&gradient[at.clone()]]) as f32;
            for (p, d) in learner.params[at.clone()].iter_mut().zip(&gradient[at.clone()]) {
                *p += by * d / norm;
            }
            let report = learner.gradient(&config, epsilon, &states, &drawn).unwrap();
            f64::from(report.decision_loss + report.bounds_loss)
        };
        let mut b = GraphBuilder::new();
        let layout = spec.reserve(&mut b);
        let layers =
            layout
                .convolutions
                .into_iter()
                .chain([layout.gru, layout.positional, layout.dense, layout.output]);
        for (number, layer) in layers.enumerate() {
            let at = layer.at..layer.at + layer.len;
            let told = adam::norm(&[&gradient[at.clone()]]);
            assert!(told > 1e-4, "layer {number} has no gradient");
            let by = (1e-3 / told).min(1e-3) as f32;
            let seen = (loss(&mut learner, by, &at) - loss(&mut learner, -by, &at)) / (2.0 * f64::from(by));
            assert!((seen / told - 1.0).abs() < 0.1, "layer {number}: {seen} against {told}");
        }
    }
}
