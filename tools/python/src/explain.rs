//! DeepSHAP for Python.

use crate::actor::{Learned, own_inputs};
use crate::given::{Floats, array, refused};
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;
use vigil_detector::DeepShap;
use vigil_nnet::{Graph, Isa, Purpose};
use vigil_policy::actor::ActorSpec;

/// DeepSHAP of one network against one background sample, over the network's own inputs.
#[pyclass(module = "vigil._vigil")]
pub struct Explainer(DeepShap);

type Inputs<'py> = Vec<PyReadonlyArrayDyn<'py, f32>>;

fn explainer(py: Python<'_>, graph: Graph, params: &[f32], backgrounds: &[Inputs<'_>]) -> PyResult<Explainer> {
    let views: Vec<Vec<&[f32]>> = backgrounds
        .iter()
        .map(|inputs| own_inputs(&graph, inputs))
        .collect::<PyResult<_>>()?;
    let shap = py.detach(|| DeepShap::new(Isa::detect(), graph, params, &views));
    Ok(Explainer(shap.map_err(refused)?))
}

#[pymethods]
impl Explainer {
    /// What lies behind the split point: inputs are the values of the state and those beside it (8, or 2 of an imported policy).
    #[staticmethod]
    fn split_point(py: Python<'_>, pilot: Learned<'_>, backgrounds: Vec<Inputs<'_>>) -> PyResult<Self> {
        let head = pilot.frozen().head(Purpose::Multipliers).map_err(refused)?;
        explainer(py, head.graph, &head.params, &backgrounds)
    }

    /// All of it: inputs are an imported policy's own, or the frame over 100 m, what is remembered and the low-dimensional observation.
    #[staticmethod]
    fn whole(py: Python<'_>, pilot: Learned<'_>, backgrounds: Vec<Inputs<'_>>) -> PyResult<Self> {
        let of = Purpose::Multipliers;
        let (graph, params) = match &pilot {
            Learned::Actor(actor) => (ActorSpec::FULL.graph(of).map_err(refused)?, &actor.frozen.params),
            Learned::Policy(policy) => (policy.frozen.network.graph(of).map_err(refused)?, &policy.frozen.params),
        };
        explainer(py, graph, params, &backgrounds)
    }

    /// The network's outputs for a state, and what each value of its inputs contributed to one of them.
    fn explain<'py>(
        &mut self,
        py: Python<'py>,
        inputs: Inputs<'py>,
        output: usize,
    ) -> PyResult<(Floats<'py>, Floats<'py>)> {
        let slices = own_inputs(self.0.graph(), &inputs)?;
        let mut phi = vec![0.0; self.0.phi_len()];
        let shap = &mut self.0;
        let outputs = py.detach(|| {
            let outputs = shap.evaluate(&slices)?.to_vec();
            shap.attribute(output, &mut phi).map(|()| outputs)
        });
        Ok((array(py, outputs.map_err(refused)?), array(py, phi)))
    }

    /// Mean outputs of the background sample.
    fn expected<'py>(&self, py: Python<'py>) -> Floats<'py> {
        array(py, self.0.expected().to_vec())
    }

    /// Lengths of the network's inputs.
    #[getter]
    fn input_lengths(&self) -> Vec<usize> {
        let graph = self.0.graph();
        (0..graph.input_count()).map(|i| graph.input_len(i)).collect()
    }
}
