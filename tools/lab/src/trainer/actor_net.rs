//! The actor behind its encoder over whole batches, with its gradient. Parameters are in the order of
//! [`ActorParams`](vigil_policy::actor::ActorParams), without the encoder's; a test holds it against the graph that flies.

use crate::trainer::mlp::{Mlp, MlpTape};
use crate::trainer::observation::{FIRST_HALF, OBSERVATION};
use rand::{Rng, RngExt};
use vigil_nnet::{Activation, Dense, Isa, ShapeError};
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS, ActorSpec, HEAD, LOW_UNITS, TRUNK};

/// Largest weight of the last layers at first (Lillicrap et al. 2016).
pub const LAST_LAYER_LIMIT: f32 = 3e-3;
/// The forward output before its tanh at first: an actor that stands still learns nothing.
const FORWARD_AT_FIRST: f32 = 0.5;

/// Values joined behind the split point.
const JOINED: usize = ACTOR_HIDDEN + LOW_UNITS;

/// The actor's network with buffers for batches.
pub struct ActorNet {
    trunk: Mlp,
    tape: MlpTape,
    low: Dense,
    head: [Dense; 2],
    output: Dense,
    rows: usize,
    first_half: Vec<f32>,
    low_dim: Vec<f32>,
    joined: Vec<f32>,
    hidden: [Vec<f32>; 2],
    d_joined: Vec<f32>,
    d_hidden: [Vec<f32>; 2],
    d_state: Vec<f32>,
    packed: Vec<f32>,
}

/// Where the layers have their parameters.
struct At {
    low: usize,
    head: [usize; 2],
    output: usize,
    len: usize,
}

impl ActorNet {
    /// For batches of up to `rows`.
    pub fn new(rows: usize) -> Self {
        let spec = ActorSpec::FULL;
        let trunk = Mlp::new(FIRST_HALF, &TRUNK, ACTOR_HIDDEN);
        let mut net = Self {
            tape: trunk.tape(rows),
            trunk,
            low: spec.low(),
            head: spec.head(),
            output: spec.output(),
            rows: 0,
            first_half: Vec::new(),
            low_dim: Vec::new(),
            joined: vec![0.0; rows * JOINED],
            hidden: HEAD.map(|units| vec![0.0; rows * units]),
            d_joined: vec![0.0; rows * JOINED],
            d_hidden: HEAD.map(|units| vec![0.0; rows * units]),
            d_state: vec![0.0; rows * ACTOR_HIDDEN],
            packed: Vec::new(),
        };
        net.packed = vec![0.0; net.param_len()];
        net
    }

    fn at(&self) -> At {
        let low = self.trunk.param_len();
        let first = low + self.low.param_len();
        let second = first + self.head[0].param_len();
        let output = second + self.head[1].param_len();
        At {
            low,
            head: [first, second],
            output,
            len: output + self.output.param_len(),
        }
    }

    pub fn param_len(&self) -> usize {
        self.at().len
    }

    /// First weights.
    pub fn initial(&self, rng: &mut impl Rng) -> Vec<f32> {
        let at = self.at();
        let mut params = self.trunk.initial(rng, (3.0 / TRUNK[1] as f32).sqrt());
        params.resize(at.len, 0.0);
        for (layer, at) in [
            (self.low, at.low),
            (self.head[0], at.head[0]),
            (self.head[1], at.head[1]),
        ] {
            let limit = (3.0 / layer.inputs as f32).sqrt();
            params[at..at + layer.weight_len()].fill_with(|| rng.random_range(-limit..limit));
        }
        let last = &mut params[at.output..];
        last[..self.output.weight_len()].fill_with(|| rng.random_range(-LAST_LAYER_LIMIT..LAST_LAYER_LIMIT));
        last[self.output.weight_len()] = FORWARD_AT_FIRST;
        params
    }

    /// The outputs before the last tanh, `[row][2]`, of observations `[row][OBSERVATION]`.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn forward(&mut self, isa: Isa, params: &[f32], rows: &[f32], out: &mut [f32]) -> Result<(), ShapeError> {
        let at = self.at();
        self.rows = rows.len() / OBSERVATION;
        self.first_half.clear();
        self.low_dim.clear();
        for row in rows.chunks_exact(OBSERVATION) {
            self.first_half.extend_from_slice(&row[..FIRST_HALF]);
            self.low_dim.extend_from_slice(&row[FIRST_HALF..]);
        }
        self.trunk
            .forward(isa, &params[..at.low], &self.first_half, &mut self.tape)?;
        let mut low = vec![0.0; self.rows * LOW_UNITS];
        let low_params = &params[at.low..at.head[0]];
        self.low
            .forward(isa, low_params, Activation::TANH, &self.low_dim, None, &mut low)?;
        let states = self.tape.out(&self.trunk).chunks_exact(ACTOR_HIDDEN);
        let joined = &mut self.joined[..self.rows * JOINED];
        for (joined, (state, low)) in joined
            .chunks_exact_mut(JOINED)
            .zip(states.zip(low.chunks_exact(LOW_UNITS)))
        {
            joined[..ACTOR_HIDDEN].copy_from_slice(state);
            joined[ACTOR_HIDDEN..].copy_from_slice(low);
            Activation::TANH.apply_in_place(isa, &mut joined[..ACTOR_HIDDEN]);
        }
        let [first, second] = &mut self.hidden;
        let (first, second) = (&mut first[..self.rows * HEAD[0]], &mut second[..self.rows * HEAD[1]]);
        self.head[0].forward(
            isa,
            &params[at.head[0]..at.head[1]],
            Activation::Elu,
            joined,
            None,
            first,
        )?;
        self.head[1].forward(
            isa,
            &params[at.head[1]..at.output],
            Activation::Elu,
            first,
            None,
            second,
        )?;
        self.output
            .forward(isa, &params[at.output..at.len], Activation::Identity, second, None, out)
    }

    /// Adds the parameters' gradient of the last forward pass to `d_params`, from `d`, that at its outputs.
    ///
    /// # Errors
    /// Slices of other lengths.
    pub fn backward(&mut self, isa: Isa, params: &[f32], d: &[f32], d_params: &mut [f32]) -> Result<(), ShapeError> {
        let (at, rows) = (self.at(), self.rows);
        let packed = &mut self.packed;
        let (trunk_packed, rest) = packed.split_at_mut(at.low);
        self.trunk.pack(&params[..at.low], trunk_packed)?;
        let rest = &mut rest[self.low.param_len()..];
        let (first_packed, rest) = rest.split_at_mut(self.head[0].param_len());
        let (second_packed, output_packed) = rest.split_at_mut(self.head[1].param_len());
        self.head[0].pack(&params[at.head[0]..at.head[1]], first_packed)?;
        self.head[1].pack(&params[at.head[1]..at.output], second_packed)?;
        self.output.pack(&params[at.output..at.len], output_packed)?;
        let [first, second] = &self.hidden;
        let (first, second) = (&first[..rows * HEAD[0]], &second[..rows * HEAD[1]]);
        let [d_first, d_second] = &mut self.d_hidden;
        let (d_first, d_second) = (&mut d_first[..rows * HEAD[0]], &mut d_second[..rows * HEAD[1]]);
        let joined = &self.joined[..rows * JOINED];
        let d_joined = &mut self.d_joined[..rows * JOINED];
        self.output
            .weight_gradient(isa, second, d, &mut d_params[at.output..at.len])?;
        self.output.input_gradient(isa, output_packed, d, d_second)?;
        Activation::Elu.gradient(isa, second, d_second)?;
        self.head[1].weight_gradient(isa, first, d_second, &mut d_params[at.head[1]..at.output])?;
        self.head[1].input_gradient(isa, second_packed, d_second, d_first)?;
        Activation::Elu.gradient(isa, first, d_first)?;
        self.head[0].weight_gradient(isa, joined, d_first, &mut d_params[at.head[0]..at.head[1]])?;
        self.head[0].input_gradient(isa, first_packed, d_first, d_joined)?;
        Activation::TANH.gradient(isa, joined, d_joined)?;
        let mut d_low = Vec::with_capacity(rows * LOW_UNITS);
        let d_state = &mut self.d_state[..rows * ACTOR_HIDDEN];
        for (d_joined, d_state) in d_joined
            .chunks_exact(JOINED)
            .zip(d_state.chunks_exact_mut(ACTOR_HIDDEN))
        {
            d_state.copy_from_slice(&d_joined[..ACTOR_HIDDEN]);
            d_low.extend_from_slice(&d_joined[ACTOR_HIDDEN..]);
        }
        self.low
            .weight_gradient(isa, &self.low_dim, &d_low, &mut d_params[at.low..at.head[0]])?;
        self.trunk.backward(
            isa,
            &params[..at.low],
            trunk_packed,
            &self.first_half,
            &mut self.tape,
            d_state,
            Some(&mut d_params[..at.low]),
            None,
        )
    }
}

/// The actor's output from what is before its last tanh.
pub fn squash(pre: &[f32]) -> [f32; ACTOR_OUTPUTS] {
    core::array::from_fn(|k| vigil_policy::actor::ACTOR_LIMIT * libm::tanhf(pre[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use vigil_nnet::{GraphBuilder, Purpose};
    use vigil_policy::actor::memory::{CONTEXT, SCAN};
    use vigil_policy::actor::senses::LOW_DIM;

    fn observations(rng: &mut ChaCha8Rng, rows: usize) -> Vec<f32> {
        (0..rows * OBSERVATION).map(|_| rng.random_range(-1.0..1.0)).collect()
    }

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
        let (x, d) = (
            observations(&mut rng, ROWS),
            [0.3, -0.7, 1.0, 0.1, -0.4, 0.2, 0.9, 0.5, -1.0, 0.6],
        );
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
