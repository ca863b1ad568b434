//! Attacks on what a policy sees for Python.

use crate::actor::{Actor, Learned};
use crate::given::{array, frames, position, refused};
use numpy::{PyArray1, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use vigil_adversary::{AttackConfig, AttackOutcome, Method, Towards};
use vigil_nnet::Isa;
use vigil_policy::ActorInputs;
use vigil_policy::actor::ACTOR_FRAMES;
use vigil_types::DEPTH_FULL_SCALE_M;

fn config(method: &str, epsilon_255: f32, iterations: u32, towards: &str, seed: u64) -> PyResult<AttackConfig> {
    let methods = Method::ALL.map(Method::name);
    let found = Method::ALL.into_iter().find(|m| m.name() == method);
    let method = found.ok_or_else(|| refused(format!("method: {method} is none of {}", methods.join(", "))))?;
    let all = [Towards::Left, Towards::Right, Towards::Away];
    let towards = all.into_iter().find(|t| t.name() == towards);
    Ok(AttackConfig {
        method,
        epsilon_255,
        iterations,
        towards: towards.ok_or_else(|| refused("towards: left, right or away"))?,
        seed,
        ..AttackConfig::PAPER
    })
}

/// Altered frames in metres, and the outputs before and after.
type Attacked<'py> = (Bound<'py, PyArray1<f32>>, [f32; 2], [f32; 2]);

fn attacked(py: Python<'_>, mut frames: Vec<f32>, outcome: AttackOutcome) -> Attacked<'_> {
    frames.iter_mut().for_each(|range| *range *= DEPTH_FULL_SCALE_M);
    (array(py, frames), outcome.clean, outcome.attacked)
}

/// Alters all five frames of a state.
#[pyclass(module = "vigil._vigil")]
pub struct StateAttack {
    attack: vigil_adversary::StateAttack,
    inputs: ActorInputs,
}

#[pymethods]
impl StateAttack {
    #[new]
    fn new(actor: &Actor, method: &str, epsilon_255: f32, iterations: u32, towards: &str, seed: u64) -> PyResult<Self> {
        let config = config(method, epsilon_255, iterations, towards, seed)?;
        let attack = vigil_adversary::StateAttack::new(Isa::detect(), &actor.frozen, &config);
        Ok(Self {
            attack: attack.map_err(refused)?,
            inputs: actor.frozen.inputs,
        })
    }

    /// The frames altered, metres.
    fn attack<'py>(
        &mut self,
        py: Python<'py>,
        state: PyReadonlyArrayDyn<'py, f32>,
        goal: Vec<f32>,
    ) -> PyResult<Attacked<'py>> {
        let mut state = frames("frames", &state, ACTOR_FRAMES)?;
        let position = position(&goal, self.inputs)?;
        let attack = &mut self.attack;
        let outcome = py.detach(|| attack.attack(&mut state, position)).map_err(refused)?;
        Ok(attacked(py, state, outcome))
    }
}

/// Alters frames as they pass, the newest only.
#[pyclass(module = "vigil._vigil")]
pub struct FrameAttack {
    attack: vigil_adversary::FrameAttack,
    inputs: ActorInputs,
}

#[pymethods]
impl FrameAttack {
    #[new]
    fn new(
        pilot: Learned<'_>,
        method: &str,
        epsilon_255: f32,
        iterations: u32,
        towards: &str,
        seed: u64,
    ) -> PyResult<Self> {
        let config = config(method, epsilon_255, iterations, towards, seed)?;
        let pilot = pilot.frozen();
        let attack = vigil_adversary::FrameAttack::on(&pilot, Isa::detect(), &config);
        Ok(Self {
            attack: attack.map_err(refused)?,
            inputs: pilot.inputs(),
        })
    }

    /// A frame that passes as it is.
    fn pass_on(&mut self, frame: PyReadonlyArrayDyn<'_, f32>, goal: Vec<f32>) -> PyResult<()> {
        let mut frame = frames("frame", &frame, 1)?;
        let position = position(&goal, self.inputs)?;
        self.attack.pass(&mut frame, position).map_err(refused)
    }

    /// The frame altered, metres.
    fn attack<'py>(
        &mut self,
        py: Python<'py>,
        frame: PyReadonlyArrayDyn<'py, f32>,
        goal: Vec<f32>,
    ) -> PyResult<Attacked<'py>> {
        let mut frame = frames("frame", &frame, 1)?;
        let position = position(&goal, self.inputs)?;
        let attack = &mut self.attack;
        let outcome = py.detach(|| attack.attack_while(&mut frame, position, || true));
        Ok(attacked(py, frame, outcome.map_err(refused)?))
    }

    /// Forgets the frames: a new flight.
    fn reset(&mut self) {
        self.attack.reset();
    }
}
