//! Actors while they are trained, over whole batches: the expert on the true state, and the pictures' actor behind its encoder.

use super::mlp::{Mlp, MlpTape};
use super::value_buffer::{StateView, double};
use super::value_config::ValueConfig;
use crate::actor_training::networks::{Networks, SPEC};
use rand::{Rng, RngExt};
use vigil_nnet::{Activation, Aligned, Dense, Isa, ShapeError};
use vigil_policy::actor::{ACTOR_FRAMES, ACTOR_HIDDEN, ActorSpec, WITH_MOVERS};
use vigil_sim::environment::true_state::{TRUE_STATE, mirror};

/// Largest weight of the last layers at first (Lillicrap et al. 2016).
pub const LAST_LAYER_LIMIT: f32 = 3e-3;
/// Layers with more inputs than this learn at a lower rate, as in `rate_shares_of`.
const FULL_RATE_INPUTS: f32 = 64.0;

const GATES: usize = 3 * ACTOR_HIDDEN;
const RECURRENT: Dense = Dense {
    inputs: ACTOR_HIDDEN,
    outputs: GATES,
};

/// A row of a batch: a state, seen in a mirror or not.
pub type Row<'a> = (StateView<'a>, bool);

/// An actor's network with its buffers.
pub enum ActorNetwork {
    /// Of the true state.
    Truth(Box<TruthActor>),
    /// Of frames' features and positional inputs.
    Pictures(Box<PicturesActor>),
}

/// A multilayer perceptron on the true state.
pub struct TruthActor {
    mlp: Mlp,
    tape: MlpTape,
    packed: Vec<f32>,
    x: Vec<f32>,
}

impl ActorNetwork {
    /// The configuration's actor, for batches of up to `rows`.
    pub fn new(config: &ValueConfig, rows: usize) -> Self {
        match config.sees {
            super::value_config::Sees::Truth => {
                let mlp = Mlp::new(TRUE_STATE, &config.learning.actor_units, 2);
                Self::Truth(Box::new(TruthActor {
                    tape: mlp.tape(rows),
                    packed: vec![0.0; mlp.param_len()],
                    x: Vec::new(),
                    mlp,
                }))
            }
            super::value_config::Sees::Pictures => {
                Self::Pictures(Box::new(PicturesActor::new(config.inputs().spec(), rows)))
            }
        }
    }

    /// Number of parameters that are trained; of the pictures' actor those behind the encoder.
    pub fn param_len(&self) -> usize {
        match self {
            Self::Truth(actor) => actor.mlp.param_len(),
            Self::Pictures(actor) => actor.len,
        }
    }

    /// First weights.
    ///
    /// # Errors
    /// None for a valid description.
    pub fn initial(&self, rng: &mut impl Rng) -> Result<Vec<f32>, ShapeError> {
        match self {
            Self::Truth(actor) => Ok(actor.mlp.initial(rng, LAST_LAYER_LIMIT)),
            Self::Pictures(pictures) => {
                let networks = Networks::new()?;
                let actor = networks.initial(rng);
                let behind = &actor[networks.encoder_len()..];
                Ok(if pictures.spec.told_of_movers {
                    told_of_movers(behind, rng)
                } else {
                    behind.to_vec()
                })
            }
        }
    }

    /// Each parameter's share of the learning rate.
    pub fn rate_shares(&self) -> Vec<f32> {
        let mut shares = vec![1.0; self.param_len()];
        if let Self::Pictures(_) = self {
            let inputs = SPEC.features();
            shares[..inputs * GATES].fill((FULL_RATE_INPUTS / inputs as f32).min(1.0));
        }
        shares
    }

    /// The outputs before the last tanh, `[row][2]`.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn forward(&mut self, isa: Isa, params: &[f32], rows: &[Row<'_>], out: &mut [f32]) -> Result<(), ShapeError> {
        match self {
            Self::Truth(actor) => {
                actor.x.clear();
                for (state, mirrored) in rows {
                    push_truth(&mut actor.x, state.truth, *mirrored);
                }
                actor.mlp.forward(isa, params, &actor.x, &mut actor.tape)?;
                out.copy_from_slice(actor.tape.out(&actor.mlp));
                Ok(())
            }
            Self::Pictures(actor) => actor.forward(isa, params, rows, out),
        }
    }

    /// Adds the parameters' gradient of the last forward pass to `d_params`, from `d`, that at its outputs, and `d_state`, that at the
    /// pictures' actor's 48 values from elsewhere, `[row][48]`.
    ///
    /// # Errors
    /// Slices of other lengths.
    pub fn backward(
        &mut self,
        isa: Isa,
        params: &[f32],
        d: &[f32],
        d_state: Option<&[f32]>,
        d_params: &mut [f32],
    ) -> Result<(), ShapeError> {
        match self {
            Self::Truth(actor) => {
                let TruthActor { mlp, tape, packed, x } = &mut **actor;
                mlp.pack(params, packed)?;
                mlp.backward(isa, params, packed, x, tape, d, Some(d_params), None)
            }
            Self::Pictures(actor) => actor.backward(isa, params, d, d_state, d_params),
        }
    }

    /// Appends the 48 values of each row of the last forward pass; nothing where the actor sees the true state.
    pub fn states(&self, to: &mut Vec<f32>) {
        if let Self::Pictures(actor) = self {
            let joined = actor.spec.dense().inputs;
            for joined in actor.joined[..actor.rows * joined].chunks_exact(joined) {
                to.extend_from_slice(&joined[..ACTOR_HIDDEN]);
            }
        }
    }
}

/// Appends a true state as a batch's row.
pub fn push_truth(x: &mut Vec<f32>, truth: &[f32], mirrored: bool) {
    match truth.as_array::<TRUE_STATE>() {
        Some(truth) if mirrored => x.extend_from_slice(&mirror(truth)),
        _ => x.extend_from_slice(truth),
    }
}

/// The parameters behind the encoder of an actor that is told of the goal alone, as those of one that is told of movers as well: it decides
/// as before, and can learn what to make of them.
pub fn told_of_movers(behind: &[f32], rng: &mut impl Rng) -> Vec<f32> {
    let (from, to) = (At::new(ActorSpec::FULL), At::new(ActorSpec::FULL_WITH_MOVERS));
    let (old, new) = (ActorSpec::FULL.positional(), ActorSpec::FULL_WITH_MOVERS.positional());
    let mut widened = vec![0.0; to.len];
    widened[..to.positional].copy_from_slice(&behind[..from.positional]);
    let limit = (3.0 / WITH_MOVERS as f32).sqrt();
    let weights = widened[to.positional..to.dense].chunks_exact_mut(new.outputs);
    for (input, weights) in weights.enumerate() {
        let (kept, fresh) = weights.split_at_mut(old.outputs);
        if input < old.inputs {
            kept.copy_from_slice(&behind[from.positional + input * old.outputs..][..old.outputs]);
        } else if input == new.inputs {
            // Behind the weights follow the biases.
            kept.copy_from_slice(&behind[from.dense - old.outputs..from.dense]);
            continue;
        }
        fresh.fill_with(|| rng.random_range(-limit..limit));
    }
    let dense = ActorSpec::FULL.dense();
    let weights = dense.weight_len();
    widened[to.dense..][..weights].copy_from_slice(&behind[from.dense..][..weights]);
    widened[to.output - dense.outputs..to.output].copy_from_slice(&behind[from.output - dense.outputs..from.output]);
    widened[to.output..].copy_from_slice(&behind[from.output..]);
    widened
}

/// GRU and head of the actor that flies, over whole batches. Parameters in the order of [`vigil_policy::actor::ActorParams`], without the
/// convolutions.
pub struct PicturesActor {
    spec: ActorSpec,
    len: usize,
    rows: usize,
    input: Dense,
    /// Input weights and bias; recurrent weights and bias: in the order of dense layers.
    projection: Aligned,
    recurrent: Aligned,
    recurrent_packed: Aligned,
    /// Features `[frame][row][feature]`.
    x: Aligned,
    projections: Aligned,
    /// From the state, `[frame][row][r z n]`.
    from_state: Aligned,
    /// r, z, n `[frame][row]`.
    gates: Aligned,
    /// States before each frame and after the last, `[frame][row]`.
    states: Aligned,
    position: Vec<f32>,
    joined: Vec<f32>,
    hidden: Vec<f32>,
    head_packed: Vec<f32>,
    d_hidden: Vec<f32>,
    d_joined: Vec<f32>,
    d_state: Vec<f32>,
    d_before: Vec<f32>,
    d_projections: Aligned,
    d_from_state: Aligned,
    d_projection: Aligned,
    d_recurrent: Aligned,
}

/// Where the layers behind the encoder keep their parameters.
struct At {
    recurrent: usize,
    input_bias: usize,
    recurrent_bias: usize,
    positional: usize,
    dense: usize,
    output: usize,
    len: usize,
}

impl At {
    fn new(spec: ActorSpec) -> Self {
        let recurrent = spec.features() * GATES;
        let input_bias = recurrent + ACTOR_HIDDEN * GATES;
        let recurrent_bias = input_bias + GATES;
        let positional = recurrent_bias + GATES;
        let dense = positional + spec.positional().param_len();
        let output = dense + spec.dense().param_len();
        Self {
            recurrent,
            input_bias,
            recurrent_bias,
            positional,
            dense,
            output,
            len: output + spec.output().param_len(),
        }
    }
}

impl PicturesActor {
    /// Buffers for up to so many rows.
    pub fn new(spec: ActorSpec, rows: usize) -> Self {
        let features = spec.features();
        let input = Dense {
            inputs: features,
            outputs: GATES,
        };
        let frames = ACTOR_FRAMES * rows;
        Self {
            len: At::new(spec).len,
            rows: 0,
            projection: Aligned::zeros(input.param_len()),
            recurrent: Aligned::zeros(RECURRENT.param_len()),
            recurrent_packed: Aligned::zeros(RECURRENT.param_len()),
            x: Aligned::zeros(frames * features),
            projections: Aligned::zeros(frames * GATES),
            from_state: Aligned::zeros(frames * GATES),
            gates: Aligned::zeros(frames * GATES),
            states: Aligned::zeros((ACTOR_FRAMES + 1) * rows * ACTOR_HIDDEN),
            position: vec![0.0; rows * spec.positional().inputs],
            joined: vec![0.0; rows * spec.dense().inputs],
            hidden: vec![0.0; rows * spec.dense().outputs],
            head_packed: vec![0.0; spec.dense().param_len() + spec.output().param_len()],
            d_hidden: vec![0.0; rows * spec.dense().outputs],
            d_joined: vec![0.0; rows * spec.dense().inputs],
            d_state: vec![0.0; rows * ACTOR_HIDDEN],
            d_before: vec![0.0; rows * ACTOR_HIDDEN],
            d_projections: Aligned::zeros(frames * GATES),
            d_from_state: Aligned::zeros(frames * GATES),
            d_projection: Aligned::zeros(input.param_len()),
            d_recurrent: Aligned::zeros(RECURRENT.param_len()),
            input,
            spec,
        }
    }

    fn forward(&mut self, isa: Isa, params: &[f32], batch: &[Row<'_>], out: &mut [f32]) -> Result<(), ShapeError> {
        let (features, rows) = (self.input.inputs, batch.len());
        let at = At::new(self.spec);
        let (positional, dense, output) = (self.spec.positional(), self.spec.dense(), self.spec.output());
        self.rows = rows;
        self.projection[..at.recurrent].copy_from_slice(&params[..at.recurrent]);
        self.projection[at.recurrent..].copy_from_slice(&params[at.input_bias..at.recurrent_bias]);
        self.recurrent[..RECURRENT.weight_len()].copy_from_slice(&params[at.recurrent..at.input_bias]);
        self.recurrent[RECURRENT.weight_len()..].copy_from_slice(&params[at.recurrent_bias..at.positional]);
        for (row, (state, _)) in batch.iter().enumerate() {
            for (frame, kept) in state.features.iter().enumerate() {
                let to = &mut self.x[(frame * rows + row) * features..][..features];
                for (to, kept) in to.iter_mut().zip(*kept) {
                    *to = double(*kept);
                }
            }
            self.position[row * positional.inputs..][..positional.inputs].copy_from_slice(&state.position);
        }
        let frames = ACTOR_FRAMES * rows;
        let projections = &mut self.projections[..frames * GATES];
        self.input.forward(
            isa,
            &self.projection,
            Activation::Identity,
            &self.x[..frames * features],
            None,
            projections,
        )?;
        let width = rows * ACTOR_HIDDEN;
        self.states[..width].fill(0.0);
        for frame in 0..ACTOR_FRAMES {
            let span = frame * rows * GATES..(frame + 1) * rows * GATES;
            let (before, after) = self.states[frame * width..(frame + 2) * width].split_at_mut(width);
            let from_state = &mut self.from_state[span.clone()];
            RECURRENT.forward(isa, &self.recurrent, Activation::Identity, before, None, from_state)?;
            let gates = &mut self.gates[span.clone()];
            let projected = self.projections[span].chunks_exact(GATES);
            let sums = gates
                .chunks_exact_mut(GATES)
                .zip(projected.zip(from_state.chunks_exact(GATES)));
            for ((gates, (projected, from_state)), (before, after)) in sums.zip(
                before
                    .chunks_exact(ACTOR_HIDDEN)
                    .zip(after.chunks_exact_mut(ACTOR_HIDDEN)),
            ) {
                const SPLIT: usize = 2 * ACTOR_HIDDEN;
                for (gate, (p, s)) in gates[..SPLIT].iter_mut().zip(projected.iter().zip(from_state)) {
                    *gate = p + s;
                }
                Activation::Sigmoid.apply_in_place(isa, &mut gates[..SPLIT]);
                let (r_z, n) = gates.split_at_mut(SPLIT);
                for (k, n) in n.iter_mut().enumerate() {
                    *n = projected[SPLIT + k] + r_z[k] * from_state[SPLIT + k];
                }
                Activation::TANH.apply_in_place(isa, n);
                for (k, after) in after.iter_mut().enumerate() {
                    *after = n[k] + r_z[ACTOR_HIDDEN + k] * (before[k] - n[k]);
                }
            }
        }
        let state = &self.states[ACTOR_FRAMES * width..];
        for (row, joined) in self.joined[..rows * dense.inputs]
            .chunks_exact_mut(dense.inputs)
            .enumerate()
        {
            joined[..ACTOR_HIDDEN].copy_from_slice(&state[row * ACTOR_HIDDEN..][..ACTOR_HIDDEN]);
            Activation::TANH.apply_in_place(isa, &mut joined[..ACTOR_HIDDEN]);
            positional.forward(
                isa,
                &params[at.positional..at.dense],
                Activation::TANH,
                &self.position[row * positional.inputs..][..positional.inputs],
                None,
                &mut joined[ACTOR_HIDDEN..],
            )?;
        }
        let hidden = &mut self.hidden[..rows * dense.outputs];
        let joined = &self.joined[..rows * dense.inputs];
        dense.forward(isa, &params[at.dense..at.output], Activation::Elu, joined, None, hidden)?;
        output.forward(isa, &params[at.output..at.len], Activation::Identity, hidden, None, out)
    }

    fn backward(
        &mut self,
        isa: Isa,
        params: &[f32],
        d: &[f32],
        d_state: Option<&[f32]>,
        d_params: &mut [f32],
    ) -> Result<(), ShapeError> {
        let (features, rows) = (self.input.inputs, self.rows);
        let at = At::new(self.spec);
        let (positional, dense, output) = (self.spec.positional(), self.spec.dense(), self.spec.output());
        let (dense_packed, output_packed) = self.head_packed.split_at_mut(dense.param_len());
        dense.pack(&params[at.dense..at.output], dense_packed)?;
        output.pack(&params[at.output..at.len], output_packed)?;
        let hidden = &self.hidden[..rows * dense.outputs];
        output.weight_gradient(isa, hidden, d, &mut d_params[at.output..at.len])?;
        let d_hidden = &mut self.d_hidden[..rows * dense.outputs];
        output.input_gradient(isa, output_packed, d, d_hidden)?;
        Activation::Elu.gradient(isa, hidden, d_hidden)?;
        let width = rows * dense.inputs;
        let (joined, d_joined) = (&self.joined[..width], &mut self.d_joined[..width]);
        dense.weight_gradient(isa, joined, d_hidden, &mut d_params[at.dense..at.output])?;
        dense.input_gradient(isa, dense_packed, d_hidden, d_joined)?;
        if let Some(d_state) = d_state {
            for (d_joined, d_state) in d_joined
                .chunks_exact_mut(dense.inputs)
                .zip(d_state.chunks_exact(ACTOR_HIDDEN))
            {
                for (to, d) in d_joined.iter_mut().zip(d_state) {
                    *to += d;
                }
            }
        }
        Activation::TANH.gradient(isa, joined, d_joined)?;
        for (row, d_joined) in d_joined.chunks_exact(dense.inputs).enumerate() {
            self.d_state[row * ACTOR_HIDDEN..][..ACTOR_HIDDEN].copy_from_slice(&d_joined[..ACTOR_HIDDEN]);
            let position = &self.position[row * positional.inputs..][..positional.inputs];
            let d_positional = &mut d_params[at.positional..at.dense];
            positional.weight_gradient(isa, position, &d_joined[ACTOR_HIDDEN..], d_positional)?;
        }
        RECURRENT.pack(&self.recurrent, &mut self.recurrent_packed)?;
        self.d_recurrent.fill(0.0);
        let width = rows * ACTOR_HIDDEN;
        for frame in (0..ACTOR_FRAMES).rev() {
            let span = frame * rows * GATES..(frame + 1) * rows * GATES;
            let before = &self.states[frame * width..(frame + 1) * width];
            let (gates, from_state) = (&self.gates[span.clone()], &self.from_state[span.clone()]);
            let d_projected = &mut self.d_projections[span.clone()];
            let d_from_state = &mut self.d_from_state[span];
            for row in 0..rows {
                let (gates, from_state) = (&gates[row * GATES..][..GATES], &from_state[row * GATES..][..GATES]);
                let d_projected = &mut d_projected[row * GATES..][..GATES];
                let d_from_state = &mut d_from_state[row * GATES..][..GATES];
                for k in 0..ACTOR_HIDDEN {
                    let (r, z, n) = (gates[k], gates[ACTOR_HIDDEN + k], gates[2 * ACTOR_HIDDEN + k]);
                    let (d, h) = (self.d_state[row * ACTOR_HIDDEN + k], before[row * ACTOR_HIDDEN + k]);
                    let d_n = d * (1.0 - z) * (1.0 - n * n);
                    let d_r = d_n * from_state[2 * ACTOR_HIDDEN + k] * r * (1.0 - r);
                    let d_z = d * (h - n) * z * (1.0 - z);
                    self.d_before[row * ACTOR_HIDDEN + k] = d * z;
                    (d_projected[k], d_from_state[k]) = (d_r, d_r);
                    (d_projected[ACTOR_HIDDEN + k], d_from_state[ACTOR_HIDDEN + k]) = (d_z, d_z);
                    d_projected[2 * ACTOR_HIDDEN + k] = d_n;
                    d_from_state[2 * ACTOR_HIDDEN + k] = d_n * r;
                }
            }
            RECURRENT.weight_gradient(isa, before, d_from_state, &mut self.d_recurrent)?;
            let through = &mut self.d_state[..width];
            RECURRENT.input_gradient(isa, &self.recurrent_packed, d_from_state, through)?;
            for (d, kept) in through.iter_mut().zip(&self.d_before) {
                *d += kept;
            }
        }
        let frames = ACTOR_FRAMES * rows;
        self.d_projection.fill(0.0);
        let (x, d) = (&self.x[..frames * features], &self.d_projections[..frames * GATES]);
        self.input.weight_gradient(isa, x, d, &mut self.d_projection)?;
        let mut add = |at: usize, d: &[f32]| {
            for (to, d) in d_params[at..at + d.len()].iter_mut().zip(d) {
                *to += d;
            }
        };
        add(0, &self.d_projection[..at.recurrent]);
        add(at.input_bias, &self.d_projection[at.recurrent..]);
        add(at.recurrent, &self.d_recurrent[..RECURRENT.weight_len()]);
        add(at.recurrent_bias, &self.d_recurrent[RECURRENT.weight_len()..]);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::value_buffer::halve;
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use vigil_nnet::{GraphBuilder, Purpose};
    use vigil_policy::actor::PositionalInputs;
    use vigil_types::GoalRelative;

    /// An actor that was told of the goal alone decides as before once it is told of movers, whatever it is told, and learns from it.
    #[test]
    fn an_actor_that_is_told_more_decides_as_before() {
        let isa = Isa::detect();
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let networks = Networks::new().unwrap();
        let actor = networks.initial(&mut rng);
        let behind = &actor[networks.encoder_len()..];
        let told = told_of_movers(behind, &mut rng);
        let kept: Vec<u16> = (0..SPEC.features())
            .map(|_| halve(rng.random_range(-1.0..1.0)))
            .collect();
        let values: Vec<f32> = (0..WITH_MOVERS).map(|_| rng.random_range(-1.0..1.0)).collect();
        let state = |position: &[f32]| StateView {
            truth: &[],
            features: [kept.as_slice(); ACTOR_FRAMES],
            position: PositionalInputs::from_values(position).unwrap(),
            teacher: None,
        };
        let (mut before, mut after) = ([0.0; 2], [0.0; 2]);
        let mut small = PicturesActor::new(ActorSpec::FULL, 1);
        small
            .forward(isa, behind, &[(state(&values[..2]), false)], &mut before)
            .unwrap();
        let mut large = PicturesActor::new(ActorSpec::FULL_WITH_MOVERS, 1);
        large
            .forward(isa, &told, &[(state(&values), false)], &mut after)
            .unwrap();
        for (a, b) in before.iter().zip(after) {
            assert!((a - b).abs() < 1e-6, "{before:?}, {after:?}");
        }
        let mut d = vec![0.0; told.len()];
        large.backward(isa, &told, &[1.0, 1.0], None, &mut d).unwrap();
        let spec = ActorSpec::FULL_WITH_MOVERS;
        let new_units = At::new(spec).dense + (ACTOR_HIDDEN + 6) * spec.dense().outputs;
        assert!(
            d[new_units..new_units + 18 * spec.dense().outputs]
                .iter()
                .any(|d| d.abs() > 1e-4)
        );
    }

    /// The batch's values and gradient are those of the flying actor's own graph, row by row.
    #[test]
    fn a_batch_is_the_flying_actor_row_by_row() {
        let isa = Isa::detect();
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let networks = Networks::new().unwrap();
        let mut actor = networks.initial(&mut rng);
        for p in &mut actor[networks.encoder_len()..] {
            *p += rng.random_range(-0.02..0.02);
        }
        let behind = &actor[networks.encoder_len()..];
        let features = SPEC.features();
        let kept: Vec<Vec<u16>> = (0..10)
            .map(|_| (0..features).map(|_| halve(rng.random_range(-1.0..1.0))).collect())
            .collect();
        let states: Vec<StateView<'_>> = (0..2)
            .map(|row| StateView {
                truth: &[],
                features: core::array::from_fn(|i| kept[5 * row + i].as_slice()),
                position: PositionalInputs::of_goal(GoalRelative {
                    distance_m: 8.0 + 4.0 * row as f32,
                    bearing_rad: -0.3,
                }),
                teacher: None,
            })
            .collect();
        let d = [0.7, -0.4, 0.2, 1.1];
        let mut batch = PicturesActor::new(SPEC, 3);
        let rows: Vec<Row<'_>> = states.iter().map(|s| (*s, false)).collect();
        let mut out = [0.0; 4];
        batch.forward(isa, behind, &rows, &mut out).unwrap();
        let mut d_behind = vec![0.0; behind.len()];
        batch.backward(isa, behind, &d, None, &mut d_behind).unwrap();

        let mut b = GraphBuilder::new();
        let layout = SPEC.reserve(&mut b);
        let inputs: Vec<_> = (0..5).map(|_| b.input(features, false).unwrap()).collect();
        let position = b.input(2, false).unwrap();
        let state = SPEC.recur(&mut b, &layout, &inputs).unwrap();
        let head = SPEC.head_before_saturation(&mut b, &layout, state, position).unwrap();
        let graph = b.finish(head, Purpose::Gradients).unwrap();
        let (mut tape, mut work) = (vec![0.0; graph.tape_len()], vec![0.0; graph.work_len()]);
        let mut d_actor = vec![0.0; actor.len()];
        let mut packed = vec![0.0; actor.len()];
        graph.pack(&actor, &mut packed).unwrap();
        for (row, state) in states.iter().enumerate() {
            let frames: Vec<Vec<f32>> = state
                .features
                .iter()
                .map(|f| f.iter().map(|kept| double(*kept)).collect())
                .collect();
            let mut inputs: Vec<&[f32]> = frames.iter().map(Vec::as_slice).collect();
            inputs.push(&state.position);
            graph.forward(isa, &actor, &inputs, &mut tape).unwrap();
            let expected = graph.output(&tape).unwrap();
            for (a, b) in out[2 * row..].iter().zip(expected) {
                assert!((a - b).abs() < 1e-5, "row {row}: {a}, {b}");
            }
            graph
                .backward(
                    isa,
                    &packed,
                    &tape,
                    &d[2 * row..2 * row + 2],
                    Some(&mut d_actor),
                    &mut work,
                )
                .unwrap();
        }
        let expected = &d_actor[networks.encoder_len()..];
        let largest = expected.iter().fold(0.0_f32, |m, d| m.max(d.abs()));
        for (i, (a, b)) in d_behind.iter().zip(expected).enumerate() {
            assert!((a - b).abs() < 1e-5 * largest.max(1.0), "parameter {i}: {a}, {b}");
        }
    }
}
