//! Actors and imported policies for Python.

use crate::given::{Floats, array, at_moment, failed, frames, refused, values};
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;
use std::path::PathBuf;
use vigil_adversary::Evaluated;
use vigil_nnet::{Graph, Isa, Purpose};
use vigil_policy::actor::ACTOR_OUTPUTS;
use vigil_policy::imported::Network;
use vigil_policy::{FrozenActor, FrozenPilot, FrozenPolicy, ImportedPilot, Pilot, PilotInput};
use vigil_types::{DEPTH_PIXELS, Nanos};

/// A frozen actor of Vigil's architecture.
#[pyclass(module = "vigil._vigil")]
pub struct Actor {
    pub frozen: FrozenActor,
    actor: vigil_policy::actor::Actor,
    /// Time of the next decision of which none is given.
    next_ns: Nanos,
}

#[pymethods]
impl Actor {
    #[new]
    #[pyo3(signature = (path=None))]
    fn new(path: Option<PathBuf>) -> PyResult<Self> {
        let frozen = path.map_or_else(FrozenActor::built_in, |path| FrozenActor::load(&path));
        let frozen = frozen.map_err(refused)?;
        Ok(Self {
            actor: frozen.actor(Isa::detect()).map_err(refused)?,
            frozen,
            next_ns: 0,
        })
    }

    /// One decision on the newest frame, metres, and a position, or a goal alone.
    fn decide(
        &mut self,
        py: Python<'_>,
        frame: PyReadonlyArrayDyn<'_, f32>,
        position: Vec<f32>,
    ) -> PyResult<(f32, f32)> {
        let actor = &mut self.actor;
        let decide = |input: &PilotInput<'_>| py.detach(|| actor.decide(input)).map_err(refused);
        at_moment(&frame, &position, &mut self.next_ns, decide).map(Into::into)
    }

    /// Forgets what it saw.
    fn reset(&mut self) {
        self.actor.reset();
        self.next_ns = 0;
    }

    /// The values at the split point of the last decision.
    fn state<'py>(&self, py: Python<'py>) -> Floats<'py> {
        array(py, self.actor.state().to_vec())
    }

    /// What it remembered in the last decision.
    fn context<'py>(&self, py: Python<'py>) -> Floats<'py> {
        array(py, self.actor.context().to_vec())
    }

    /// The low-dimensional observation of the last decision.
    fn low_dim<'py>(&self, py: Python<'py>) -> Floats<'py> {
        array(py, self.actor.low_dim().to_vec())
    }

    /// Its digest.
    #[getter]
    fn sha256(&self) -> String {
        self.frozen.sha256()
    }

    /// Names, shapes and values of its tensors, in their order.
    fn tensors<'py>(&self, py: Python<'py>) -> Vec<(String, Vec<usize>, Floats<'py>)> {
        let mut rest = self.frozen.params.as_slice();
        let shapes = self.frozen.tensor_shapes().into_iter();
        shapes
            .map(|(name, shape)| {
                let (own, after) = rest.split_at(shape.iter().product());
                rest = after;
                (name, shape, array(py, own.to_vec()))
            })
            .collect()
    }

    /// Writes an actor that decides from what this one does, with other parameters; its digest.
    fn write(
        &self,
        path: PathBuf,
        params: PyReadonlyArrayDyn<'_, f32>,
        training_config: String,
        seed: u64,
        updates: u64,
    ) -> PyResult<String> {
        let frozen = FrozenActor {
            params: values("parameters", &params, self.frozen.params.len())?.to_vec(),
            training_config,
            seed,
            updates,
            cruise_m_s: self.frozen.cruise_m_s,
            git_commit: None,
        };
        frozen.save(&path).map_err(refused)?;
        Ok(frozen.sha256())
    }
}

/// An imported policy (docs/import.md).
#[pyclass(module = "vigil._vigil")]
pub struct Policy {
    pub frozen: FrozenPolicy,
    pilot: ImportedPilot,
    network: Evaluated,
    /// Its network before the outputs saturate.
    unsaturated: Evaluated,
}

/// Either.
#[derive(FromPyObject)]
pub enum Learned<'py> {
    /// Ours.
    Actor(PyRef<'py, Actor>),
    /// Of others.
    Policy(PyRef<'py, Policy>),
}

impl Learned<'_> {
    /// What its file says.
    pub fn frozen(&self) -> FrozenPilot {
        match self {
            Self::Actor(actor) => FrozenPilot::Actor(actor.frozen.clone()),
            Self::Policy(policy) => FrozenPilot::Imported(policy.frozen.clone()),
        }
    }
}

#[pymethods]
impl Policy {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        let frozen = FrozenPolicy::load(&path).map_err(refused)?;
        let params = &frozen.params;
        let evaluated = |network: &Network| {
            let graph = network.graph(Purpose::Gradients).map_err(refused)?;
            Evaluated::new(Isa::detect(), graph, params).map_err(refused)
        };
        Ok(Self {
            pilot: frozen.pilot(Isa::detect()).map_err(refused)?,
            network: evaluated(&frozen.network)?,
            unsaturated: evaluated(&frozen.network.unsaturated(params))?,
            frozen,
        })
    }

    /// Its frame's rows, columns and channels; what pixels and outputs are multiplied by; the frame's place among its inputs; whether it
    /// is given the goal.
    fn inputs(&self) -> ((usize, usize, usize), f32, f32, usize, bool) {
        let own = &self.frozen.inputs;
        let shape = (own.rows, own.cols, own.channels);
        (shape, own.scale, own.output_scale, own.frame_input, own.has_position)
    }

    /// Its own frame of as many of ours, metres, as it has channels, the newest last.
    fn own_frame<'py>(&self, py: Python<'py>, given: PyReadonlyArrayDyn<'py, f32>) -> PyResult<Floats<'py>> {
        let inputs = &self.frozen.inputs;
        let places: Vec<u32> = inputs.places().collect();
        let mut own = vec![0.0; inputs.rows * inputs.cols * inputs.channels];
        for frame in frames("frames", &given, inputs.channels)?.chunks_exact(DEPTH_PIXELS) {
            inputs.see(&places, frame, false, &mut own);
        }
        Ok(array(py, own))
    }

    /// One decision on the newest frame, metres, as in flight.
    fn decide(
        &mut self,
        frame: PyReadonlyArrayDyn<'_, f32>,
        distance_m: f32,
        bearing_rad: f32,
    ) -> PyResult<(f32, f32)> {
        let decide = |input: &PilotInput<'_>| Ok(self.pilot.decide(input));
        let action = at_moment(&frame, &[distance_m, bearing_rad], &mut 0, decide)?;
        Ok((action.forward_m_s, action.yaw))
    }

    /// Forgets the frames.
    fn reset(&mut self) {
        self.pilot.reset();
    }

    /// The values at the split point of the last decision.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Floats<'py>> {
        let state = self.pilot.state();
        let state = state.ok_or_else(|| {
            refused("nothing was decided yet, or the policy has no split point (vigil import --split)")
        })?;
        Ok(array(py, state.to_vec()))
    }

    /// The network's outputs for its own inputs.
    fn forward<'py>(&mut self, py: Python<'py>, inputs: Vec<PyReadonlyArrayDyn<'py, f32>>) -> PyResult<Floats<'py>> {
        let inputs = own_inputs(&self.network.graph, &inputs)?;
        let outputs: [f32; ACTOR_OUTPUTS] = self.network.outputs(&inputs).map_err(failed)?;
        Ok(array(py, outputs.to_vec()))
    }

    /// Gradient of the outputs, weighted, at its own frame; of what the outputs are before they saturate, where that is wanted.
    fn gradient<'py>(
        &mut self,
        py: Python<'py>,
        inputs: Vec<PyReadonlyArrayDyn<'py, f32>>,
        weights: [f32; ACTOR_OUTPUTS],
        unsaturated: bool,
    ) -> PyResult<Floats<'py>> {
        let network = if unsaturated {
            &mut self.unsaturated
        } else {
            &mut self.network
        };
        let inputs = own_inputs(&network.graph, &inputs)?;
        let looked: Result<[f32; ACTOR_OUTPUTS], _> = network.outputs(&inputs);
        let gradient = looked.and_then(|_| network.gradient(&weights, self.frozen.inputs.frame_input));
        Ok(array(py, gradient.map_err(failed)?.to_vec()))
    }

    /// What it was made of.
    #[getter]
    fn source(&self) -> &str {
        &self.frozen.source
    }

    /// Its digest.
    #[getter]
    fn sha256(&self) -> String {
        self.frozen.sha256()
    }
}

/// The inputs of a network, as many and as long as it has them.
pub fn own_inputs<'a>(graph: &Graph, inputs: &'a [PyReadonlyArrayDyn<'_, f32>]) -> PyResult<Vec<&'a [f32]>> {
    if inputs.len() != graph.input_count() {
        let count = graph.input_count();
        return Err(refused(format!("the network has {count} inputs, got {}", inputs.len())));
    }
    let each = inputs.iter().enumerate();
    each.map(|(i, input)| values(&format!("input {i}"), input, graph.input_len(i)))
        .collect()
}
