//! Attacks on what a policy sees for Python.

use crate::actor::{Actor, Learned};
use crate::given::{Floats, array, at_moment, beside, frames, refused, values};
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};
use vigil_adversary::{AttackConfig, AttackOutcome, Beside, Method, Towards};
use vigil_nnet::Isa;
use vigil_policy::PilotInput;
use vigil_policy::actor::CONTEXT;
use vigil_types::{DEPTH_FULL_SCALE_M, DepthFrame, Nanos};

/// The method of this name, which `what` is given as.
pub fn method_named(what: &str, name: &str) -> PyResult<Method> {
    let methods = Method::ALL.map(Method::name);
    Method::from_name(name).ok_or_else(|| refused(format!("{what}: {name} is none of {}", methods.join(", "))))
}

/// Method, ε in 1/255, iterations, where to, seed.
type Given = (String, f32, u32, String, u64);

fn config((method, epsilon_255, iterations, towards, seed): Given) -> PyResult<AttackConfig> {
    Ok(AttackConfig {
        method: method_named("method", &method)?,
        epsilon_255,
        iterations,
        towards: Towards::from_name(&towards).ok_or_else(|| refused("towards: left, right or away"))?,
        seed,
        ..AttackConfig::PAPER
    })
}

/// Altered frames in metres, and the outputs before and after.
type Attacked<'py> = (Floats<'py>, [f32; 2], [f32; 2]);

fn attacked(py: Python<'_>, mut frames: Vec<f32>, outcome: AttackOutcome) -> Attacked<'_> {
    frames.iter_mut().for_each(|range| *range *= DEPTH_FULL_SCALE_M);
    (array(py, frames), outcome.clean, outcome.attacked)
}

/// Alters a frame, given what the actor holds beside it. Calls of several threads queue, without the interpreter's lock, which the call that
/// attacks wants back.
#[pyclass(frozen, module = "vigil._vigil")]
pub struct StateAttack(Mutex<vigil_adversary::StateAttack>);

#[pymethods]
impl StateAttack {
    #[new]
    fn new(actor: &Actor, given: Given) -> PyResult<Self> {
        let attack = vigil_adversary::StateAttack::new(Isa::detect(), &actor.frozen, &config(given)?);
        Ok(Self(Mutex::new(attack.map_err(refused)?)))
    }

    /// The frame altered, metres.
    fn attack<'py>(
        &self,
        py: Python<'py>,
        frame: PyReadonlyArrayDyn<'py, f32>,
        context: PyReadonlyArrayDyn<'py, f32>,
        low_dim: Vec<f32>,
    ) -> PyResult<Attacked<'py>> {
        let mut frame = frames("frame", &frame, 1)?;
        let mut held = Beside {
            context: [0.0; CONTEXT],
            low_dim: beside(&low_dim)?,
        };
        held.context.copy_from_slice(values("context", &context, CONTEXT)?);
        let outcome = py.detach(|| {
            let mut attack = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            attack.attack(&mut frame, &held)
        });
        Ok(attacked(py, frame, outcome.map_err(refused)?))
    }
}

/// Alters frames as they pass, the newest only.
#[pyclass(module = "vigil._vigil")]
pub struct FrameAttack {
    attack: vigil_adversary::FrameAttack,
    /// Time of the next frame of which none is given.
    next_ns: Nanos,
}

#[pymethods]
impl FrameAttack {
    #[new]
    fn new(pilot: Learned<'_>, given: Given) -> PyResult<Self> {
        let attack = vigil_adversary::FrameAttack::on(&pilot.frozen(), Isa::detect(), &config(given)?);
        Ok(Self {
            attack: attack.map_err(refused)?,
            next_ns: 0,
        })
    }

    /// A frame that passes as it is.
    fn pass_on(&mut self, frame: PyReadonlyArrayDyn<'_, f32>, position: Vec<f32>) -> PyResult<()> {
        let pass = |input: &PilotInput<'_>| self.attack.pass(input).map(drop).map_err(refused);
        at_moment(&frame, &position, &mut self.next_ns, pass)
    }

    /// The frame altered, metres.
    fn attack<'py>(
        &mut self,
        py: Python<'py>,
        frame: PyReadonlyArrayDyn<'py, f32>,
        position: Vec<f32>,
    ) -> PyResult<Attacked<'py>> {
        let mut delivered = Box::new(DepthFrame::EMPTY);
        let attack = |input: &PilotInput<'_>| {
            py.detach(|| self.attack.attack_while(input, &mut delivered, || true))
                .map_err(refused)
        };
        let outcome = at_moment(&frame, &position, &mut self.next_ns, attack)?;
        Ok(attacked(py, delivered.depth.to_vec(), outcome))
    }

    /// Forgets the frames: a new flight.
    fn reset(&mut self) {
        self.next_ns = 0;
        self.attack.reset();
    }
}
