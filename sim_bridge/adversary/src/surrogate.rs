//! The actor as the adversary sees it: differentiable down to the pixels, its outputs before saturation.

use vigil_nnet::{Aligned, Graph, GraphBuilder, Isa, NodeId, Purpose, ShapeError};
use vigil_policy::actor::{ACTOR_FRAMES, ACTOR_HIDDEN, ACTOR_OUTPUTS, ActorSpec, PositionalInputs};

/// A weight for each output before saturation, and for each value of the GRU's last state.
pub(crate) type Ends = [f32; ACTOR_OUTPUTS + ACTOR_HIDDEN];

/// A pilot as the adversary sees it: pixels to outputs before saturation, and back.
pub(crate) trait Surrogate {
    /// Outputs before saturation, for frames one after the other, oldest first. `older` is the GRU's state before them, where one is
    /// taken.
    fn look(
        &mut self,
        older: &[f32; ACTOR_HIDDEN],
        frames: &[f32],
        position: &PositionalInputs,
    ) -> Result<[f32; ACTOR_OUTPUTS], ShapeError>;

    /// The GRU's last state, as last looked at; empty where an evasion of the detector is not known.
    fn state(&self) -> Result<&[f32], ShapeError>;

    /// Gradient of `d · (outputs, state)` at what was last looked at, written beside each other for all frames.
    fn gradient(&mut self, d: &Ends, gradient: &mut [f32]) -> Result<(), ShapeError>;
}

/// Frames to outputs, with the gradient at the pixels.
#[derive(Debug, Clone)]
pub(crate) struct SurrogateActor {
    isa: Isa,
    params: Aligned,
    packed: Aligned,
    graph: Graph,
    tape: Aligned,
    work: Aligned,
    /// Frames among the inputs, and whether a GRU state comes before them.
    frames: usize,
    from_state: bool,
    frame_len: usize,
    /// The newest frame's features.
    features: NodeId,
    /// The GRU's last state: the split point.
    state: NodeId,
}

impl SurrogateActor {
    /// The actor over all of its frames, from a zero state.
    pub fn on_state(spec: ActorSpec, isa: Isa, params: &[f32]) -> Result<Self, ShapeError> {
        Self::new(spec, isa, params, ACTOR_FRAMES, false)
    }

    /// The actor over its newest frame, from the GRU's state after the older ones: nothing that the newest frame cannot
    /// change is computed again.
    pub fn on_newest(spec: ActorSpec, isa: Isa, params: &[f32]) -> Result<Self, ShapeError> {
        Self::new(spec, isa, params, 1, true)
    }

    fn new(spec: ActorSpec, isa: Isa, given: &[f32], frames: usize, from_state: bool) -> Result<Self, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = spec.reserve(&mut b);
        let mut state = if from_state {
            b.input(ACTOR_HIDDEN, false)?
        } else {
            b.zeros(ACTOR_HIDDEN)?
        };
        let mut features = state;
        for _ in 0..frames {
            let frame = b.input(spec.frame_len(), true)?;
            features = spec.encode(&mut b, &params, frame)?;
            state = b.gru(features, state, spec.gru(), params.gru)?;
        }
        let position = b.input(spec.positional().inputs, false)?;
        let outputs = spec.head_before_saturation(&mut b, &params, state, position)?;
        // The state beside the outputs, so that a gradient can begin at either.
        let outputs = b.concat(&[outputs, state])?;
        let graph = b.finish(outputs, Purpose::Gradients)?;
        let mut packed = Aligned::zeros(graph.param_len());
        graph.pack(given, &mut packed)?;
        Ok(Self {
            isa,
            params: Aligned::from(given),
            packed,
            tape: Aligned::zeros(graph.tape_len()),
            work: Aligned::zeros(graph.work_len()),
            graph,
            frames,
            from_state,
            frame_len: spec.frame_len(),
            features,
            state,
        })
    }

    /// Pixels in all frames together.
    pub fn pixels(&self) -> usize {
        self.frames * self.frame_len
    }

    /// The newest frame's features, as last looked at.
    pub fn features(&self) -> Result<&[f32], ShapeError> {
        self.graph.value(&self.tape, self.features)
    }
}

impl Surrogate for SurrogateActor {
    fn look(
        &mut self,
        older: &[f32; ACTOR_HIDDEN],
        frames: &[f32],
        position: &PositionalInputs,
    ) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        let mut inputs: [&[f32]; ACTOR_FRAMES + 2] = [&[]; ACTOR_FRAMES + 2];
        let first = usize::from(self.from_state);
        inputs[0] = older;
        let mut count = first;
        for frame in frames.chunks(self.frame_len).take(self.frames) {
            inputs[count] = frame;
            count += 1;
        }
        inputs[count] = position;
        count += 1;
        self.graph
            .forward(self.isa, &self.params, &inputs[..count], &mut self.tape)?;
        let mut outputs = [0.0; ACTOR_OUTPUTS];
        let ends = self.graph.output(&self.tape)?;
        outputs.copy_from_slice(&ends[..ACTOR_OUTPUTS]);
        Ok(outputs)
    }

    fn state(&self) -> Result<&[f32], ShapeError> {
        self.graph.value(&self.tape, self.state)
    }

    fn gradient(&mut self, d: &Ends, gradient: &mut [f32]) -> Result<(), ShapeError> {
        self.graph
            .backward(self.isa, &self.packed, &self.tape, d, None, &mut self.work)?;
        for (i, to) in gradient.chunks_exact_mut(self.frame_len).enumerate() {
            let input = i + usize::from(self.from_state);
            to.copy_from_slice(self.graph.input_gradient(&self.work, input)?);
        }
        Ok(())
    }
}
