//! The attack in flight on an imported policy: as [`crate::StreamAttack`], on its own frame, of which the newest channel is ours.

use crate::config::{AttackConfig, AttackError, AttackOutcome};
use crate::perturb::{Perturber, limit};
use crate::surrogate::{Ends, Evaluated, Surrogate};
use vigil_nnet::{Isa, Purpose, ShapeError};
use vigil_policy::actor::{ACTOR_LIMIT, ACTOR_OUTPUTS, GOAL_INPUTS, LowDim};
use vigil_policy::imported::{Channels, Network, PolicyInputs};
use vigil_policy::{FrozenPolicy, PilotInput};
use vigil_types::{DEPTH_PIXELS, DepthFrame};

/// Alters frames as they pass to an imported policy. It remembers what it delivered and what it was given. Pixels that the policy
/// does not sample stay as they are.
#[derive(Debug, Clone)]
pub struct PolicyAttack {
    perturber: Perturber,
    surrogate: SurrogatePolicy,
    /// The policy itself, saturation and all.
    policy: Evaluated,
    /// The policy's own frame of what was taken.
    clean: Vec<f32>,
    direction: Option<f32>,
}

/// The policy's newest frame to its outputs before they saturate, with the gradient at our pixels.
#[derive(Debug, Clone)]
struct SurrogatePolicy {
    network: Evaluated,
    inputs: PolicyInputs,
    places: Vec<u32>,
    /// Its own frame of what was delivered, before the newest came.
    delivered: Vec<f32>,
    started: bool,
    /// Its own frame as last looked at, and our pixels then.
    frame: Vec<f32>,
    newest: Vec<f32>,
    /// What is given beside the frame.
    low_dim: LowDim,
}

/// A network's outputs for the policy's own frame.
fn outputs(
    network: &mut Evaluated,
    inputs: &PolicyInputs,
    frame: &[f32],
    low_dim: &LowDim,
) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
    let low_dim: &[f32] = low_dim;
    let given = match inputs.frame_input {
        0 => [frame, low_dim],
        _ => [low_dim, frame],
    };
    let given = &given[..network.graph.input_count().min(2)];
    Ok(network.outputs(given)?.map(|y| y * inputs.output_scale))
}

impl Surrogate for SurrogatePolicy {
    fn look(&mut self, newest: &[f32]) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        self.newest.copy_from_slice(newest);
        self.frame.copy_from_slice(&self.delivered);
        self.inputs.see(&self.places, newest, !self.started, &mut self.frame);
        outputs(&mut self.network, &self.inputs, &self.frame, &self.low_dim)
    }

    fn state(&self) -> Result<&[f32], ShapeError> {
        Ok(&[])
    }

    fn gradient(&mut self, d: &Ends, gradient: &mut [f32]) -> Result<(), ShapeError> {
        let inputs = &self.inputs;
        let d = [d[0] * inputs.output_scale, d[1] * inputs.output_scale];
        let own = self.network.gradient(&d, inputs.frame_input)?;
        let all = inputs.order == Channels::Repeat || !self.started;
        gradient.fill(0.0);
        for (pixel, place) in own.chunks_exact(inputs.channels.max(1)).zip(&self.places) {
            let sum: f32 = match all {
                true => pixel.iter().sum(),
                false => pixel.last().copied().unwrap_or(0.0),
            };
            let place = *place as usize;
            gradient[place] += sum * inputs.slope(self.newest[place]);
        }
        Ok(())
    }
}

impl PolicyAttack {
    /// An attack on an imported policy. Allocates; attacking and passing do not.
    ///
    /// # Errors
    /// A configuration out of range, a policy that does not fit itself.
    pub fn new(isa: Isa, policy: &FrozenPolicy, config: &AttackConfig) -> Result<Self, AttackError> {
        let inputs = policy.inputs;
        policy.pilot(isa).map_err(refused)?;
        let evaluated = |network: &Network| -> Result<_, AttackError> {
            let graph = network.graph(Purpose::Gradients).map_err(refused)?;
            Ok(Evaluated::new(isa, graph, &policy.params)?)
        };
        let len = inputs.rows * inputs.cols * inputs.channels;
        Ok(Self {
            perturber: Perturber::new(*config)?,
            policy: evaluated(&policy.network)?,
            surrogate: SurrogatePolicy {
                network: evaluated(&policy.network.unsaturated(&policy.params))?,
                inputs,
                places: inputs.places().collect(),
                delivered: vec![0.0; len],
                started: false,
                frame: vec![0.0; len],
                newest: vec![0.0; DEPTH_PIXELS],
                low_dim: [0.0; GOAL_INPUTS].into(),
            },
            clean: vec![0.0; len],
            direction: None,
        })
    }

    /// Lets what the policy is given pass unaltered, but remembers it. Ends a burst.
    pub fn pass(&mut self, taken: &PilotInput<'_>) {
        let (surrogate, frame) = (&mut self.surrogate, &taken.depth.depth);
        for own in [&mut surrogate.delivered, &mut self.clean] {
            surrogate.inputs.see(&surrogate.places, frame, !surrogate.started, own);
        }
        surrogate.started = true;
        self.direction = None;
    }

    /// The same as [`crate::StreamAttack::attack_while`].
    ///
    /// # Errors
    /// None for a policy that fits itself.
    pub fn attack_while(
        &mut self,
        taken: &PilotInput<'_>,
        delivered: &mut DepthFrame,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<AttackOutcome, AttackError> {
        delivered.clone_from(taken.depth);
        self.perturber.see_from(taken.depth.header.attitude, taken.height_m);
        let (surrogate, frame) = (&mut self.surrogate, &mut delivered.depth);
        let low_dim = LowDim::of_goal(taken.goal);
        surrogate.low_dim = low_dim;
        let before = surrogate.look(frame)?;
        let (inputs, first) = (surrogate.inputs, !surrogate.started);
        inputs.see(&surrogate.places, frame, first, &mut self.clean);
        let clean = limited(outputs(&mut self.policy, &inputs, &self.clean, &low_dim)?);
        let towards = self.perturber.config.towards;
        let direction = *self.direction.get_or_insert_with(|| towards.sign(clean[1]));
        self.perturber
            .run(surrogate, limit(direction), frame, before, None, |_, _, _| go_on())?;
        inputs.see(&surrogate.places, frame, first, &mut surrogate.delivered);
        surrogate.started = true;
        let attacked = limited(outputs(&mut self.policy, &inputs, &surrogate.delivered, &low_dim)?);
        Ok(AttackOutcome { clean, attacked })
    }

    /// Forgets the frames and draws from the beginning again: another flight.
    pub fn reset(&mut self) {
        self.perturber.reset();
        self.surrogate.started = false;
        self.direction = None;
    }
}

fn refused(error: impl ToString) -> AttackError {
    AttackError::Policy(error.to_string())
}

fn limited(outputs: [f32; ACTOR_OUTPUTS]) -> [f32; ACTOR_OUTPUTS] {
    outputs.map(|y| y.clamp(-ACTOR_LIMIT, ACTOR_LIMIT))
}
