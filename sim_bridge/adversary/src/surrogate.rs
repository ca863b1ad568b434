//! The actor as the adversary sees it: differentiable down to the pixels, its outputs before saturation.

use vigil_nnet::{Activation, Aligned, Graph, GraphBuilder, Isa, NodeId, Purpose, ShapeError};
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS, Actor, ActorSpec, CONTEXT, LOW_DIM, LowDim};

/// A weight for each output before saturation, and for each of the 48 values at the split point.
pub(crate) type Ends = [f32; ACTOR_OUTPUTS + ACTOR_HIDDEN];

/// A pilot as the adversary sees it: the newest frame's pixels to outputs before saturation, and back.
pub(crate) trait Surrogate {
    /// Outputs before saturation for a newest frame `[128][256]`.
    fn look(&mut self, frame: &[f32]) -> Result<[f32; ACTOR_OUTPUTS], ShapeError>;

    /// The 48 values at the split point, as last looked at; empty where an evasion of the detector is not known.
    fn state(&self) -> Result<&[f32], ShapeError>;

    /// Gradient of `d · (outputs, state)` at the pixels of the frame last looked at.
    fn gradient(&mut self, d: &Ends, gradient: &mut [f32]) -> Result<(), ShapeError>;
}

/// A network with its values, forwards and back.
#[derive(Debug, Clone)]
pub struct Evaluated {
    isa: Isa,
    /// The network.
    pub graph: Graph,
    params: Aligned,
    packed: Aligned,
    tape: Aligned,
    work: Aligned,
}

impl Evaluated {
    /// One that has computed nothing yet.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn new(isa: Isa, graph: Graph, params: &[f32]) -> Result<Self, ShapeError> {
        let mut packed = Aligned::zeros(graph.param_len());
        graph.pack(params, &mut packed)?;
        Ok(Self {
            isa,
            params: Aligned::from(params),
            packed,
            tape: Aligned::zeros(graph.tape_len()),
            work: Aligned::zeros(graph.work_len()),
            graph,
        })
    }

    /// The first outputs.
    ///
    /// # Errors
    /// Inputs of other lengths.
    pub fn outputs<const N: usize>(&mut self, inputs: &[&[f32]]) -> Result<[f32; N], ShapeError> {
        self.graph.forward(self.isa, &self.params, inputs, &mut self.tape)?;
        let mut first = [0.0; N];
        for (to, y) in first.iter_mut().zip(self.graph.output(&self.tape)?) {
            *to = *y;
        }
        Ok(first)
    }

    /// Gradient of `d · outputs`, as last computed, at an input.
    ///
    /// # Errors
    /// Another number of outputs, or no such input.
    pub fn gradient(&mut self, d: &[f32], input: usize) -> Result<&[f32], ShapeError> {
        self.graph
            .backward(self.isa, &self.packed, &self.tape, d, None, &mut self.work)?;
        self.graph.input_gradient(&self.work, input)
    }
}

/// What an actor decides from beside its newest frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beside {
    /// What it remembers ([`Actor::context`]).
    pub context: [f32; CONTEXT],
    /// The low-dimensional observation ([`Actor::low_dim`]).
    pub low_dim: LowDim,
}

impl Beside {
    /// What the last decision was made from.
    pub fn of(actor: &Actor) -> Self {
        Self {
            context: *actor.context(),
            low_dim: actor.low_dim(),
        }
    }
}

/// The actor from the newest frame on, with the gradient at its pixels. What it remembers does not depend on that frame, so the gradient goes
/// through the scan alone.
#[derive(Debug, Clone)]
pub(crate) struct SurrogateActor {
    network: Evaluated,
    /// The split point.
    state: NodeId,
    /// What stands beside the frames that are looked at from now on.
    pub beside: Beside,
}

impl SurrogateActor {
    pub fn new(isa: Isa, given: &[f32]) -> Result<Self, ShapeError> {
        let spec = ActorSpec::FULL;
        let mut b = GraphBuilder::new();
        let params = spec.reserve(&mut b);
        let frame = b.input(spec.frame_len(), true)?;
        let context = b.input(CONTEXT, false)?;
        let low = b.input(LOW_DIM, false)?;
        let scan = spec.encode(&mut b, &params, frame)?;
        let state = spec.trunk_to_state(&mut b, &params, scan, context)?;
        let outputs = spec.decide(&mut b, &params, state, low, Activation::Identity)?;
        // The state beside the outputs, so that a gradient can begin at either.
        let ends = b.concat(&[outputs, state])?;
        Ok(Self {
            network: Evaluated::new(isa, b.finish(ends, Purpose::Gradients)?, given)?,
            state,
            beside: Beside {
                context: [0.0; CONTEXT],
                low_dim: [0.0; LOW_DIM].into(),
            },
        })
    }
}

impl Surrogate for SurrogateActor {
    fn look(&mut self, frame: &[f32]) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        let Beside { context, low_dim } = &self.beside;
        self.network.outputs(&[frame, context, low_dim])
    }

    fn state(&self) -> Result<&[f32], ShapeError> {
        self.network.graph.value(&self.network.tape, self.state)
    }

    fn gradient(&mut self, d: &Ends, gradient: &mut [f32]) -> Result<(), ShapeError> {
        gradient.copy_from_slice(self.network.gradient(d, 0)?);
        Ok(())
    }
}
