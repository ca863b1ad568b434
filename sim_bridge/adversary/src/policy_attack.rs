//! The attack in flight on an imported policy: as [`crate::StreamAttack`], on its own frame, of which the newest channel is ours.

use crate::config::{AttackConfig, AttackError, AttackOutcome};
use crate::perturb::{Perturber, limit};
use crate::state_attack::check;
use crate::surrogate::{Ends, Surrogate};
use vigil_nnet::{Aligned, Graph, Isa, Purpose, ShapeError};
use vigil_policy::FrozenPolicy;
use vigil_policy::actor::{ACTOR_LIMIT, ACTOR_OUTPUTS, GOAL_INPUTS, LowDim};
use vigil_policy::imported::{Channels, PolicyInputs};
use vigil_types::DEPTH_PIXELS;

/// Alters frames as they pass to an imported policy. It remembers what it delivered and what it was given. Pixels that the policy
/// does not sample stay as they are.
#[derive(Debug, Clone)]
pub struct PolicyAttack {
    pub(crate) perturber: Perturber,
    surrogate: SurrogatePolicy,
    /// The policy itself, saturation and all.
    policy: Evaluated,
    /// The policy's own frame of what was delivered, and of what was taken.
    delivered: Vec<f32>,
    clean: Vec<f32>,
    /// Room for a decision.
    decided_on: Vec<f32>,
    direction: Option<f32>,
}

/// A network with its values.
#[derive(Debug, Clone)]
struct Evaluated {
    isa: Isa,
    inputs: PolicyInputs,
    graph: Graph,
    params: Aligned,
    tape: Aligned,
}

impl Evaluated {
    fn new(isa: Isa, policy: &FrozenPolicy, graph: Graph) -> Self {
        Self {
            isa,
            inputs: policy.inputs,
            params: Aligned::from(policy.params.as_slice()),
            tape: Aligned::zeros(graph.tape_len()),
            graph,
        }
    }

    /// Outputs for the policy's own frame.
    fn outputs(&mut self, frame: &[f32], low_dim: &LowDim) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        let low_dim: &[f32] = low_dim;
        let given = match self.inputs.frame_input {
            0 => [frame, low_dim],
            _ => [low_dim, frame],
        };
        let given = &given[..self.graph.input_count().min(2)];
        self.graph.forward(self.isa, &self.params, given, &mut self.tape)?;
        let mut outputs = [0.0; ACTOR_OUTPUTS];
        for (to, y) in outputs.iter_mut().zip(self.graph.output(&self.tape)?) {
            *to = y * self.inputs.output_scale;
        }
        Ok(outputs)
    }
}

/// The policy's newest frame to its outputs before they saturate, with the gradient at our pixels.
#[derive(Debug, Clone)]
struct SurrogatePolicy {
    network: Evaluated,
    packed: Aligned,
    work: Aligned,
    places: Vec<u32>,
    /// Its own frame before the newest came.
    before: Vec<f32>,
    started: bool,
    /// Its own frame as last looked at, and our pixels then.
    frame: Vec<f32>,
    newest: Vec<f32>,
    /// What is given beside the frame.
    low_dim: LowDim,
}

impl Surrogate for SurrogatePolicy {
    fn look(&mut self, newest: &[f32]) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        self.newest.copy_from_slice(newest);
        self.frame.copy_from_slice(&self.before);
        let inputs = self.network.inputs;
        inputs.see(&self.places, newest, !self.started, &mut self.frame);
        self.network.outputs(&self.frame, &self.low_dim)
    }

    fn state(&self) -> Result<&[f32], ShapeError> {
        Ok(&[])
    }

    fn gradient(&mut self, d: &Ends, gradient: &mut [f32]) -> Result<(), ShapeError> {
        let Evaluated {
            isa,
            inputs,
            graph,
            tape,
            ..
        } = &self.network;
        let d = [d[0] * inputs.output_scale, d[1] * inputs.output_scale];
        graph.backward(*isa, &self.packed, tape, &d, None, &mut self.work)?;
        let own = graph.input_gradient(&self.work, inputs.frame_input)?;
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
        policy.pilot(isa, false).map_err(refused)?;
        let graph = policy
            .network
            .unsaturated()
            .graph(Purpose::Gradients)
            .map_err(refused)?;
        let mut packed = Aligned::zeros(graph.param_len());
        graph.pack(&policy.params, &mut packed)?;
        let len = inputs.rows * inputs.cols * inputs.channels;
        Ok(Self {
            perturber: Perturber::new(*config)?,
            policy: Evaluated::new(isa, policy, policy.network.graph(Purpose::Gradients).map_err(refused)?),
            surrogate: SurrogatePolicy {
                packed,
                work: Aligned::zeros(graph.work_len()),
                network: Evaluated::new(isa, policy, graph),
                places: inputs.places().collect(),
                before: vec![0.0; len],
                started: false,
                frame: vec![0.0; len],
                newest: vec![0.0; DEPTH_PIXELS],
                low_dim: [0.0; GOAL_INPUTS].into(),
            },
            delivered: vec![0.0; len],
            clean: vec![0.0; len],
            decided_on: vec![0.0; len],
            direction: None,
        })
    }

    /// Lets a frame (`[rows][cols]` ranges over 100 m) pass unaltered, but remembers it. Ends a burst.
    ///
    /// # Errors
    /// A frame of another length; nothing is remembered of it.
    pub fn pass(&mut self, frame: &[f32]) -> Result<(), AttackError> {
        check(frame)?;
        self.remember(frame, None);
        self.direction = None;
        Ok(())
    }

    /// Alters a frame in place; the same as [`crate::StreamAttack::attack_while`].
    ///
    /// # Errors
    /// A frame of another length; nothing is altered or remembered.
    pub fn attack_while(
        &mut self,
        frame: &mut [f32],
        low_dim: &LowDim,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<AttackOutcome, AttackError> {
        check(frame)?;
        self.surrogate.before.copy_from_slice(&self.delivered);
        self.surrogate.low_dim = *low_dim;
        let before = self.surrogate.look(frame)?;
        self.decided_on.copy_from_slice(&self.clean);
        let inputs = self.policy.inputs;
        inputs.see(
            &self.surrogate.places,
            frame,
            !self.surrogate.started,
            &mut self.decided_on,
        );
        let clean = limited(self.policy.outputs(&self.decided_on, low_dim)?);
        let towards = self.perturber.config().towards;
        let direction = *self.direction.get_or_insert_with(|| towards.sign(clean[1]));
        self.perturber
            .run(&mut self.surrogate, limit(direction), frame, before, None, |_, _, _| {
                go_on()
            })?;
        let clean_frame = core::mem::take(&mut self.decided_on);
        self.remember(frame, Some(&clean_frame));
        self.decided_on = clean_frame;
        let attacked = limited(self.policy.outputs(&self.delivered, low_dim)?);
        Ok(AttackOutcome { clean, attacked })
    }

    /// Takes up what was delivered, and what was taken, which is the same unless it is given.
    fn remember(&mut self, delivered: &[f32], clean: Option<&[f32]>) {
        let (inputs, places, first) = (self.policy.inputs, &self.surrogate.places, !self.surrogate.started);
        inputs.see(places, delivered, first, &mut self.delivered);
        match clean {
            Some(clean) => self.clean.copy_from_slice(clean),
            None => inputs.see(places, delivered, first, &mut self.clean),
        }
        self.surrogate.started = true;
    }

    /// Forgets the frames and draws from the beginning again: another flight.
    pub fn reset(&mut self) {
        let seed = self.perturber.config().seed;
        self.perturber.reset(seed);
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
