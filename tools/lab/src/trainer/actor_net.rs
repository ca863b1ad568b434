//! The actor behind its encoder over whole batches, with its gradient. Parameters are in the order of
//! [`ActorParams`](vigil_policy::actor::ActorParams), without the encoder's; a test holds it against the graph that flies.

use crate::trainer::mlp::{Mlp, draw};
use crate::trainer::observation::{FIRST_HALF, OBSERVATION};
use rand::Rng;
use vigil_nnet::{Activation, Dense, Isa, ShapeError};
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS, ActorSpec, LOW_UNITS, TRUNK};

/// Largest weight of the last layers at first (Lillicrap et al. 2016).
pub const LAST_LAYER_LIMIT: f32 = 3e-3;
/// The forward output before its tanh at first: an actor that stands still learns nothing.
const FORWARD_AT_FIRST: f32 = 0.5;

/// Values joined behind the split point.
const JOINED: usize = ACTOR_HIDDEN + LOW_UNITS;

/// The actor's network with buffers for batches.
pub struct ActorNet {
    trunk: Mlp,
    low: Dense,
    /// Behind the split point.
    head: Mlp,
    first_half: Vec<f32>,
    low_dim: Vec<f32>,
    /// What goes into the head.
    joined: Vec<f32>,
}

impl ActorNet {
    /// For batches of up to `rows`.
    pub fn new(rows: usize) -> Self {
        let spec = ActorSpec::FULL;
        let units = spec.head().map(|layer| layer.outputs);
        Self {
            trunk: Mlp::new(rows, FIRST_HALF, &TRUNK, ACTOR_HIDDEN, true),
            low: spec.low(),
            head: Mlp::new(rows, JOINED, &units, ACTOR_OUTPUTS, false),
            first_half: Vec::new(),
            low_dim: Vec::new(),
            joined: Vec::new(),
        }
    }

    /// First weights.
    pub fn initial(&self, rng: &mut impl Rng) -> Vec<f32> {
        let mut params = self.trunk.initial(rng, (3.0 / TRUNK[1] as f32).sqrt());
        let mut low = vec![0.0; self.low.param_len()];
        let limit = (3.0 / self.low.inputs as f32).sqrt();
        draw(&mut low[..self.low.weight_len()], limit, rng);
        params.extend(low);
        params.extend(self.head.initial(rng, LAST_LAYER_LIMIT));
        let forward = params.len() - ACTOR_OUTPUTS;
        params[forward] = FORWARD_AT_FIRST;
        params
    }

    /// The outputs before the last tanh, `[row][2]`, of observations `[row][OBSERVATION]`.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn forward(&mut self, isa: Isa, params: &[f32], rows: &[f32]) -> Result<&[f32], ShapeError> {
        self.first_half.clear();
        self.low_dim.clear();
        for row in rows.chunks_exact(OBSERVATION) {
            self.first_half.extend_from_slice(&row[..FIRST_HALF]);
            self.low_dim.extend_from_slice(&row[FIRST_HALF..]);
        }
        let (own, rest) = params.split_at(self.trunk.param_len());
        self.trunk.forward(isa, own, &self.first_half)?;
        let (own, rest) = rest.split_at(self.low.param_len());
        let mut low = vec![0.0; rows.len() / OBSERVATION * LOW_UNITS];
        self.low
            .forward(isa, own, Activation::TANH, &self.low_dim, None, &mut low)?;
        let mut states = self.trunk.out.clone();
        Activation::TANH.apply_in_place(isa, &mut states);
        self.joined.clear();
        for (state, low) in states.chunks_exact(ACTOR_HIDDEN).zip(low.chunks_exact(LOW_UNITS)) {
            self.joined.extend_from_slice(state);
            self.joined.extend_from_slice(low);
        }
        self.head.forward(isa, rest, &self.joined)?;
        Ok(&self.head.out)
    }

    /// Adds the parameters' gradient of the last forward pass to `d_params`, from `d`, that at its outputs.
    ///
    /// # Errors
    /// Slices of other lengths.
    pub fn backward(&mut self, isa: Isa, params: &[f32], d: &[f32], d_params: &mut [f32]) -> Result<(), ShapeError> {
        let (of_trunk, of_low) = (self.trunk.param_len(), self.low.param_len());
        let (d_trunk, d_rest) = d_params.split_at_mut(of_trunk);
        let (d_low, d_head) = d_rest.split_at_mut(of_low);
        let (own, mut d_joined) = (&params[of_trunk + of_low..], vec![0.0; self.joined.len()]);
        let to_joined = Some(&mut d_joined[..]);
        self.head.backward(isa, own, &self.joined, d, Some(d_head), to_joined)?;
        Activation::TANH.gradient(isa, &self.joined, &mut d_joined)?;
        let (mut d_state, mut d_units) = (Vec::new(), Vec::new());
        for d_joined in d_joined.chunks_exact(JOINED) {
            d_state.extend_from_slice(&d_joined[..ACTOR_HIDDEN]);
            d_units.extend_from_slice(&d_joined[ACTOR_HIDDEN..]);
        }
        self.low.weight_gradient(isa, &self.low_dim, &d_units, d_low)?;
        let (own, x) = (&params[..of_trunk], &self.first_half);
        self.trunk.backward(isa, own, x, &d_state, Some(d_trunk), None)
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
        let out = net.forward(isa, &all[encoder..], &x).unwrap().to_vec();
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
