//! The actor behind its encoder over whole batches, with its gradient. Parameters are in the order of
//! [`ActorParams`](vigil_policy::actor::ActorParams), without the encoder's; a test holds it against the graph that flies.

use crate::trainer::mlp::{Mlp, MlpTape, draw};
use crate::trainer::observation::{FIRST_HALF, OBSERVATION};
use core::ops::Range;
use rand::Rng;
use vigil_nnet::{Activation, Dense, Isa, ShapeError};
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS, ActorSpec, LOW_UNITS, TRUNK};

/// Largest weight of the last layers at first (Lillicrap et al. 2016).
pub const LAST_LAYER_LIMIT: f32 = 3e-3;
/// The forward output before its tanh at first: an actor that stands still learns nothing.
const FORWARD_AT_FIRST: f32 = 0.5;

/// Values joined behind the split point.
const JOINED: usize = ACTOR_HIDDEN + LOW_UNITS;

/// A layer, and where its parameters lie.
type Layer = (Dense, Range<usize>);

/// The actor's network with buffers for batches.
pub struct ActorNet {
    trunk: Mlp,
    tape: MlpTape,
    low: Layer,
    /// Those behind the split point, the output last.
    head: [Layer; 3],
    rows: usize,
    first_half: Vec<f32>,
    low_dim: Vec<f32>,
    /// What goes into each of the head's layers.
    x: [Vec<f32>; 3],
    d_x: [Vec<f32>; 3],
    d_state: Vec<f32>,
    packed: Vec<f32>,
}

impl ActorNet {
    /// For batches of up to `rows`.
    pub fn new(rows: usize) -> Self {
        let spec = ActorSpec::FULL;
        let trunk = Mlp::new(FIRST_HALF, &TRUNK, ACTOR_HIDDEN);
        let mut len = trunk.param_len();
        let mut layer = |layer: Dense| {
            let at = len;
            len += layer.param_len();
            (layer, at..len)
        };
        let low = layer(spec.low());
        let [first, second] = spec.head();
        let head = [first, second, spec.output()].map(layer);
        let inputs = || head.each_ref().map(|(layer, _)| vec![0.0; rows * layer.inputs]);
        Self {
            tape: trunk.tape(rows),
            trunk,
            low,
            rows: 0,
            first_half: Vec::new(),
            low_dim: Vec::new(),
            x: inputs(),
            d_x: inputs(),
            d_state: vec![0.0; rows * ACTOR_HIDDEN],
            packed: vec![0.0; head[2].1.end],
            head,
        }
    }

    /// First weights.
    pub fn initial(&self, rng: &mut impl Rng) -> Vec<f32> {
        let mut params = self.trunk.initial(rng, (3.0 / TRUNK[1] as f32).sqrt());
        params.resize(self.packed.len(), 0.0);
        let [first, second, (output, at)] = &self.head;
        for (layer, at) in [&self.low, first, second] {
            let limit = (3.0 / layer.inputs as f32).sqrt();
            draw(&mut params[at.clone()][..layer.weight_len()], limit, rng);
        }
        let last = &mut params[at.clone()];
        draw(&mut last[..output.weight_len()], LAST_LAYER_LIMIT, rng);
        last[output.weight_len()] = FORWARD_AT_FIRST;
        params
    }

    /// The outputs before the last tanh, `[row][2]`, of observations `[row][OBSERVATION]`.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn forward(&mut self, isa: Isa, params: &[f32], rows: &[f32], out: &mut [f32]) -> Result<(), ShapeError> {
        self.rows = rows.len() / OBSERVATION;
        self.first_half.clear();
        self.low_dim.clear();
        for row in rows.chunks_exact(OBSERVATION) {
            self.first_half.extend_from_slice(&row[..FIRST_HALF]);
            self.low_dim.extend_from_slice(&row[FIRST_HALF..]);
        }
        let (layer, at) = &self.low;
        self.trunk
            .forward(isa, &params[..at.start], &self.first_half, &mut self.tape)?;
        let mut low = vec![0.0; self.rows * LOW_UNITS];
        let own = &params[at.clone()];
        layer.forward(isa, own, Activation::TANH, &self.low_dim, None, &mut low)?;
        let states = self.tape.out.chunks_exact(ACTOR_HIDDEN);
        let parts = states.zip(low.chunks_exact(LOW_UNITS));
        for (joined, (state, low)) in self.x[0].chunks_exact_mut(JOINED).zip(parts) {
            joined[..ACTOR_HIDDEN].copy_from_slice(state);
            joined[ACTOR_HIDDEN..].copy_from_slice(low);
            Activation::TANH.apply_in_place(isa, &mut joined[..ACTOR_HIDDEN]);
        }
        for (i, (layer, at)) in self.head.iter().enumerate() {
            let (before, behind) = self.x.split_at_mut(i + 1);
            let (curve, y) = match behind.first_mut() {
                Some(y) => (Activation::Elu, &mut y[..self.rows * layer.outputs]),
                None => (Activation::Identity, &mut *out),
            };
            let x = &before[i][..self.rows * layer.inputs];
            layer.forward(isa, &params[at.clone()], curve, x, None, y)?;
        }
        Ok(())
    }

    /// Adds the parameters' gradient of the last forward pass to `d_params`, from `d`, that at its outputs.
    ///
    /// # Errors
    /// Slices of other lengths.
    pub fn backward(&mut self, isa: Isa, params: &[f32], d: &[f32], d_params: &mut [f32]) -> Result<(), ShapeError> {
        let rows = self.rows;
        for (i, (layer, at)) in self.head.iter().enumerate().rev() {
            let (below, above) = self.d_x.split_at_mut(i + 1);
            let d = above.first().map_or(d, |d| &d[..rows * layer.outputs]);
            let inputs = rows * layer.inputs;
            let (x, d_x) = (&self.x[i][..inputs], &mut below[i][..inputs]);
            let packed = &mut self.packed[at.clone()];
            layer.pack(&params[at.clone()], packed)?;
            layer.weight_gradient(isa, x, d, &mut d_params[at.clone()])?;
            layer.input_gradient(isa, packed, d, d_x)?;
            let curve = if i == 0 { Activation::TANH } else { Activation::Elu };
            curve.gradient(isa, x, d_x)?;
        }
        let mut d_low = Vec::with_capacity(rows * LOW_UNITS);
        let d_state = &mut self.d_state[..rows * ACTOR_HIDDEN];
        let d_states = d_state.chunks_exact_mut(ACTOR_HIDDEN);
        for (d_joined, d_state) in self.d_x[0].chunks_exact(JOINED).zip(d_states) {
            d_state.copy_from_slice(&d_joined[..ACTOR_HIDDEN]);
            d_low.extend_from_slice(&d_joined[ACTOR_HIDDEN..]);
        }
        let (low, at) = &self.low;
        low.weight_gradient(isa, &self.low_dim, &d_low, &mut d_params[at.clone()])?;
        let (own, x, tape) = (&params[..at.start], &self.first_half, &mut self.tape);
        let d_own = Some(&mut d_params[..at.start]);
        self.trunk.backward(isa, own, x, tape, d_state, d_own, None)
    }
}

/// The actor's output from what is before its last tanh.
pub fn squash(pre: &[f32]) -> [f32; ACTOR_OUTPUTS] {
    core::array::from_fn(|k| vigil_policy::actor::ACTOR_LIMIT * libm::tanhf(pre[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use vigil_nnet::{GraphBuilder, Purpose};
    use vigil_policy::actor::memory::{CONTEXT, SCAN};
    use vigil_policy::actor::senses::LOW_DIM;

    /// Scan, memory and low-dimensional observation to the outputs before saturation, as it flies.
    fn graph() -> vigil_nnet::Graph {
        let spec = ActorSpec::FULL;
        let mut b = GraphBuilder::new();
        let params = spec.reserve(&mut b);
        let scan = b.input(SCAN, true).unwrap();
        let context = b.input(CONTEXT, true).unwrap();
        let low = b.input(LOW_DIM, true).unwrap();
        let state = spec.trunk_to_state(&mut b, &params, scan, context).unwrap();
        let out = spec.decide(&mut b, &params, state, low, Activation::Identity).unwrap();
        b.finish(out, Purpose::Gradients).unwrap()
    }

    #[test]
    fn a_batch_decides_and_learns_as_the_graph_that_flies() {
        const ROWS: usize = 5;
        let (isa, graph) = (Isa::detect(), graph());
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut net = ActorNet::new(ROWS);
        let encoder = ActorSpec::FULL.encoder_len();
        let mut all = vec![0.0; encoder];
        all.extend(net.initial(&mut rng));
        all[encoder..]
            .iter_mut()
            .for_each(|p| *p += rng.random_range(-0.05..0.05));
        assert_eq!(all.len(), graph.param_len());
        let mut x = vec![0.0; ROWS * OBSERVATION];
        draw(&mut x, 1.0, &mut rng);
        let d = [0.3, -0.7, 1.0, 0.1, -0.4, 0.2, 0.9, 0.5, -1.0, 0.6];
        let mut out = [0.0; 2 * ROWS];
        net.forward(isa, &all[encoder..], &x, &mut out).unwrap();
        let mut d_params = vec![0.0; all.len() - encoder];
        net.backward(isa, &all[encoder..], &d, &mut d_params).unwrap();
        let (mut tape, mut work) = (vec![0.0; graph.tape_len()], vec![0.0; graph.work_len()]);
        let (mut packed, mut expected) = (vec![0.0; all.len()], vec![0.0; all.len()]);
        graph.pack(&all, &mut packed).unwrap();
        for (row, x) in x.chunks_exact(OBSERVATION).enumerate() {
            let inputs = [&x[..SCAN], &x[SCAN..FIRST_HALF], &x[FIRST_HALF..]];
            graph.forward(isa, &all, &inputs, &mut tape).unwrap();
            for (got, want) in out[2 * row..].iter().zip(graph.output(&tape).unwrap()) {
                assert!((got - want).abs() < 1e-4, "{got} {want}");
            }
            let d = &d[2 * row..2 * row + 2];
            graph
                .backward(isa, &packed, &tape, d, Some(&mut expected), &mut work)
                .unwrap();
        }
        for (i, (got, want)) in d_params.iter().zip(&expected[encoder..]).enumerate() {
            assert!(
                (got - want).abs() < 1e-3 * (1.0 + want.abs()),
                "parameter {i}: {got} {want}"
            );
        }
    }
}
