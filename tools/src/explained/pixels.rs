//! DeepSHAP of the newest frame's pixels, against states of unattacked flights.

use super::recorded_flight::fly;
use super::scenario::{Plan, Scenario};
use anyhow::Result;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use vigil_detector::DeepShap;
use vigil_nnet::{Isa, Purpose};
use vigil_policy::actor::{Actor, ActorSpec};
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_sim::world::Family;
use vigil_types::{DEPTH_PIXELS, DepthFrame};

/// The output that is explained: the yaw rate.
pub const YAW: usize = 1;
/// States of the background sample, where nothing else is asked for.
pub const BACKGROUNDS: usize = 30;
/// First seed of the unattacked training flights that backgrounds come from, and how many.
const BACKGROUND_SEED: u64 = 2900;
const BACKGROUND_FLIGHTS: u64 = 6;
/// Steps between states of one flight.
const STRIDE: usize = 14;

/// The explainer of the newest frame's pixels and of what the actor holds beside them, with backgrounds of unattacked training flights.
pub fn explainer(isa: Isa, actor: &FrozenActor, count: usize) -> Result<DeepShap> {
    let (pilot, mut inputs) = (FrozenPilot::from(actor), Vec::<Vec<Vec<f32>>>::new());
    for seed in BACKGROUND_SEED..BACKGROUND_SEED + BACKGROUND_FLIGHTS {
        let mut steps = 0_usize;
        let scenario = Scenario::unattacked(Family::Training, seed, Plan::Actor);
        fly(isa, &pilot, &scenario, &mut |step, shown| {
            steps += 1;
            let seen = shown.inputs(step).filter(|_| steps.is_multiple_of(STRIDE));
            inputs.extend(seen.map(|seen| seen.map(<[f32]>::to_vec).into()));
            Ok(())
        })?;
    }
    inputs.shuffle(&mut ChaCha8Rng::seed_from_u64(BACKGROUND_SEED));
    inputs.truncate(count);
    let backgrounds: Vec<Vec<&[f32]>> = inputs.iter().map(|i| i.iter().map(Vec::as_slice).collect()).collect();
    let graph = ActorSpec::FULL.graph(Purpose::Multipliers)?;
    Ok(DeepShap::new(isa, graph, &actor.params, &backgrounds)?)
}

/// Explains single states of an actor by their pixels.
pub struct PixelExplainer {
    shap: DeepShap,
    phi: Vec<f32>,
}

impl PixelExplainer {
    /// With the background sample of the paper's figures: states of unattacked training flights, which are flown for it.
    ///
    /// # Errors
    /// Parameters of another architecture.
    pub fn new(isa: Isa, actor: &FrozenActor) -> Result<Self> {
        let shap = explainer(isa, actor, BACKGROUNDS)?;
        let phi = vec![0.0; shap.phi_len()];
        Ok(Self { shap, phi })
    }

    /// SHAP values `[128][256]` of a frame's pixels for one of the actor's outputs; the actor has just decided on it.
    ///
    /// # Errors
    /// An explanation that is not finite.
    pub fn newest_frame(&mut self, actor: &Actor, frame: &DepthFrame, output: usize) -> Result<&[f32]> {
        self.of_inputs(&[&frame.depth, actor.context(), &actor.low_dim()], output)
    }

    /// The same of the network's inputs.
    pub fn of_inputs(&mut self, inputs: &[&[f32]; 3], output: usize) -> Result<&[f32]> {
        self.shap.evaluate(inputs)?;
        self.shap.attribute(output, &mut self.phi)?;
        Ok(&self.phi[..DEPTH_PIXELS])
    }
}
