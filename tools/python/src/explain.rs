//! DeepSHAP for Python.

use crate::actor::{Learned, own_inputs};
use crate::given::{Floats, array, refused};
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};
use vigil_detector::DeepShap;
use vigil_nnet::{Graph, Isa, Purpose};
use vigil_policy::actor::ActorSpec;

/// DeepSHAP of one network against one background sample, over the network's own inputs. Calls of several threads queue.
#[pyclass(frozen, module = "vigil._vigil")]
pub struct Explainer {
    graph: Graph,
    /// Waited for without the interpreter's lock only, which the call that has it wants back.
    shap: Mutex<DeepShap>,
}

type Inputs<'py> = Vec<PyReadonlyArrayDyn<'py, f32>>;

#[pymethods]
impl Explainer {
    /// Of the whole network inputs are an imported policy's own, or the frame over 100 m, what is remembered and the low-dimensional
    /// observation; of what lies behind the split point the values of the state and those beside it (8, or 2 of an imported policy).
    #[new]
    fn new(py: Python<'_>, pilot: Learned<'_>, whole: bool, backgrounds: Vec<Inputs<'_>>) -> PyResult<Self> {
        let of = Purpose::Multipliers;
        let head;
        let (graph, params) = match &pilot {
            pilot if !whole => {
                head = pilot.frozen().head(of).map_err(refused)?;
                (head.graph, &head.params)
            }
            Learned::Actor(actor) => (ActorSpec::FULL.graph(of).map_err(refused)?, &actor.frozen.params),
            Learned::Policy(policy) => (policy.frozen.network.graph(of).map_err(refused)?, &policy.frozen.params),
        };
        let views = backgrounds.iter().map(|inputs| own_inputs(&graph, inputs));
        let views: Vec<Vec<&[f32]>> = views.collect::<PyResult<_>>()?;
        let shap = py.detach(|| DeepShap::new(Isa::detect(), graph.clone(), params, &views));
        let shap = Mutex::new(shap.map_err(refused)?);
        Ok(Self { graph, shap })
    }

    /// One of the network's outputs for a state, its mean over the background sample, and what each value of the inputs contributed to it.
    fn explain<'py>(&self, py: Python<'py>, inputs: Inputs<'py>, output: usize) -> PyResult<(f32, f32, Floats<'py>)> {
        let slices = own_inputs(&self.graph, &inputs)?;
        let explained = py.detach(|| {
            let mut shap = self.shap.lock().unwrap_or_else(PoisonError::into_inner);
            let mut phi = vec![0.0; shap.phi_len()];
            let outputs = shap.evaluate(&slices)?.to_vec();
            let explained = shap.attribute(output, &mut phi);
            explained.map(|()| (outputs[output], shap.expected()[output], phi))
        });
        let (made, base, phi) = explained.map_err(refused)?;
        Ok((made, base, array(py, phi)))
    }

    /// Lengths of the network's inputs.
    #[getter]
    fn input_lengths(&self) -> Vec<usize> {
        (0..self.graph.input_count()).map(|i| self.graph.input_len(i)).collect()
    }
}
