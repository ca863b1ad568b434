//! The actor's network: a depth frame, what is remembered, and what the vehicle knows of itself in, two outputs in ±1.5.
//!
//! Encoder: convolution 5×5 of 16 filters, 3×3 of 16, then three of 3×3 and 32, all with stride 2 and ELU; a dense layer gives the
//! collision scan, [`SCAN`] proximities. First half: scan and memory ([`CONTEXT`]) → 256 → 128, each with layer norm and ELU → 48 values,
//! the paper's split point. Second half: `tanh` of the 48 beside a branch of the low-dimensional observation ([`LOW_DIM`] → 24, tanh) →
//! 64 → 32, ELU → `1.5 · tanh` of two outputs: x-velocity, yaw.

use crate::PilotInput;
use crate::actor::memory::{CONTEXT, OLDER_SCANS, Odometry, SCAN};
use crate::actor::senses::{LOW_DIM, LowDim, Senses};
use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;
use vigil_nnet::shape::{expect, part};
use vigil_nnet::{
    Activation, Aligned, Conv2d, ConvChain, Dense, Graph, GraphBuilder, Isa, LayerNorm, NodeId, Params, Purpose,
    ShapeError,
};
use vigil_types::{Ablation, Action, DepthFrame};

/// Length of the split point (docs/paper.md, "Actor").
pub const ACTOR_HIDDEN: usize = vigil_types::EXPLAINED_STATE;
/// Outputs: x-velocity and yaw in ±[`ACTOR_LIMIT`].
pub const ACTOR_OUTPUTS: usize = 2;
/// Limit of both outputs.
pub const ACTOR_LIMIT: f32 = vigil_types::ACTION_LIMIT;

/// Kernel, filters of each convolution; all have stride 2 and half the kernel as padding.
const ENCODER: [(usize, usize); 5] = [(5, 16), (3, 16), (3, 32), (3, 32), (3, 32)];
/// Units of the two layers between scan and memory and the split point.
pub const TRUNK: [usize; 2] = [256, 128];
/// Added to the variance of a layer norm.
pub const EPSILON: f32 = 1e-5;
/// Units of the low-dimensional branch, and of the two layers behind the split point.
pub const LOW_UNITS: usize = 24;
/// Units of the two layers behind the split point.
const HEAD: [usize; 2] = [64, 32];

/// The actor's dimensions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ActorSpec {
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub cols: usize,
}

/// Where the actor's layers keep their parameters; all graphs of one actor share one parameter slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ActorParams {
    /// The five convolutions.
    pub convolutions: [Params; 5],
    /// Features to the scan.
    pub scan: Params,
    /// Of the two layers of the trunk the dense layer and the norm.
    pub trunk: [(Params, Params); 2],
    /// Trunk to the 48 values.
    pub state: Params,
    /// The low-dimensional branch.
    pub low: Params,
    /// The two layers behind the split point.
    pub head: [Params; 2],
    /// 32 → 2.
    pub output: Params,
}

impl ActorSpec {
    /// The actor for the depth frames of this project, 128 × 256.
    pub const FULL: Self = Self { rows: 128, cols: 256 };

    /// The five convolutions.
    pub fn convolutions(&self) -> [Conv2d; 5] {
        let (mut rows, mut cols, mut channels) = (self.rows, self.cols, 1);
        ENCODER.map(|(kernel, filters)| {
            let layer = Conv2d::new([rows, cols, channels], filters, kernel, 2, kernel / 2);
            (rows, cols, channels) = (rows.div_ceil(2), cols.div_ceil(2), filters);
            layer
        })
    }

    /// Values in a frame.
    pub fn frame_len(&self) -> usize {
        self.rows * self.cols
    }

    /// From the convolutions' features, `[row][column][channel]`, to the scan.
    pub fn scan(&self) -> Dense {
        let [.., last] = self.convolutions();
        Dense::new(last.output_len(), SCAN)
    }

    /// The trunk's dense layers.
    pub fn trunk(&self) -> [Dense; 2] {
        let [first, second] = TRUNK;
        [Dense::new(SCAN + CONTEXT, first), Dense::new(first, second)]
    }

    /// The norm behind a dense layer.
    pub fn norm(layer: Dense) -> LayerNorm {
        LayerNorm {
            width: layer.outputs,
            epsilon: EPSILON,
        }
    }

    /// From the trunk to the split point.
    pub fn state(&self) -> Dense {
        let [.., last] = TRUNK;
        Dense::new(last, ACTOR_HIDDEN)
    }

    /// The low-dimensional branch.
    pub fn low(&self) -> Dense {
        Dense::new(LOW_DIM, LOW_UNITS)
    }

    /// The layers behind the split point, of the 48 values beside the low-dimensional branch.
    pub fn head(&self) -> [Dense; 2] {
        let [first, second] = HEAD;
        [Dense::new(ACTOR_HIDDEN + LOW_UNITS, first), Dense::new(first, second)]
    }

    /// The last layer.
    pub fn output(&self) -> Dense {
        let [.., last] = HEAD;
        Dense::new(last, ACTOR_OUTPUTS)
    }

    /// Reserves the parameters, in the order of the fields of [`ActorParams`].
    pub fn reserve(&self, builder: &mut GraphBuilder) -> ActorParams {
        let mut of = |len: usize| builder.params(len);
        ActorParams {
            convolutions: self.convolutions().map(|layer| of(layer.param_len())),
            scan: of(self.scan().param_len()),
            trunk: (self.trunk()).map(|layer| (of(layer.param_len()), of(Self::norm(layer).param_len()))),
            state: of(self.state().param_len()),
            low: of(self.low().param_len()),
            head: self.head().map(|layer| of(layer.param_len())),
            output: of(self.output().param_len()),
        }
    }

    /// Number of parameters of the encoder: convolutions and scan.
    pub fn encoder_len(&self) -> usize {
        let convolutions: usize = self.convolutions().iter().map(Conv2d::param_len).sum();
        convolutions + self.scan().param_len()
    }

    /// Adds the encoder of one frame; returns its scan.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn encode(
        &self,
        builder: &mut GraphBuilder,
        params: &ActorParams,
        frame: NodeId,
    ) -> Result<NodeId, ShapeError> {
        let mut x = builder.activation(frame, Activation::NEAR_CONTRAST)?;
        for (layer, params) in self.convolutions().into_iter().zip(params.convolutions) {
            x = builder.conv2d(x, layer, Activation::Elu, params)?;
        }
        builder.dense(x, self.scan(), Activation::Sigmoid, params.scan)
    }

    /// Adds the rest of the first half: scan and memory to the 48 values.
    ///
    /// # Errors
    /// Nodes of other lengths.
    pub fn trunk_to_state(
        &self,
        builder: &mut GraphBuilder,
        params: &ActorParams,
        scan: NodeId,
        context: NodeId,
    ) -> Result<NodeId, ShapeError> {
        let mut x = builder.concat(&[scan, context])?;
        for (layer, (dense, norm)) in self.trunk().into_iter().zip(params.trunk) {
            x = builder.dense(x, layer, Activation::Identity, dense)?;
            x = builder.layer_norm(x, Self::norm(layer), norm)?;
            x = builder.activation(x, Activation::Elu)?;
        }
        builder.dense(x, self.state(), Activation::Identity, params.state)
    }

    /// Adds the second half: the 48 values and the low-dimensional observation to the outputs; `last` is [`Activation::Identity`] for the
    /// outputs before their saturation.
    ///
    /// # Errors
    /// Nodes of other lengths.
    pub fn decide(
        &self,
        builder: &mut GraphBuilder,
        params: &ActorParams,
        state: NodeId,
        low: NodeId,
        last: Activation,
    ) -> Result<NodeId, ShapeError> {
        let state = builder.activation(state, Activation::TANH)?;
        let low = builder.dense(low, self.low(), Activation::TANH, params.low)?;
        let mut x = builder.concat(&[state, low])?;
        for (layer, params) in self.head().into_iter().zip(params.head) {
            x = builder.dense(x, layer, Activation::Elu, params)?;
        }
        builder.dense(x, self.output(), last, params.output)
    }

    /// The whole actor: inputs are the frame, the memory's values and the low-dimensional observation.
    ///
    /// # Errors
    /// A frame too small for the encoder.
    pub fn graph(&self, purpose: Purpose) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = self.reserve(&mut b);
        let frame = b.input(self.frame_len(), true)?;
        let context = b.input(CONTEXT, true)?;
        let low = b.input(LOW_DIM, true)?;
        let scan = self.encode(&mut b, &params, frame)?;
        let state = self.trunk_to_state(&mut b, &params, scan, context)?;
        let output = self.decide(&mut b, &params, state, low, Activation::Tanh { scale: ACTOR_LIMIT })?;
        b.finish(output, purpose)
    }

    /// The encoder alone: one frame to its scan.
    ///
    /// # Errors
    /// A frame too small for the encoder.
    pub fn encoder_graph(&self, purpose: Purpose, explained: bool) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = self.reserve(&mut b);
        let frame = b.input(self.frame_len(), explained)?;
        let scan = self.encode(&mut b, &params, frame)?;
        b.finish(scan, purpose)
    }

    /// The first half behind the encoder: inputs are the scan and the memory's values, output the 48 values.
    fn trunk_graph(&self, purpose: Purpose) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = self.reserve(&mut b);
        let scan = b.input(SCAN, true)?;
        let context = b.input(CONTEXT, true)?;
        let state = self.trunk_to_state(&mut b, &params, scan, context)?;
        b.finish(state, purpose)
    }

    /// The second half: inputs are the 48 values and the low-dimensional observation.
    ///
    /// # Errors
    /// None for a valid description.
    pub fn head_graph(&self, purpose: Purpose) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = self.reserve(&mut b);
        let state = b.input(ACTOR_HIDDEN, true)?;
        let low = b.input(LOW_DIM, true)?;
        let output = self.decide(&mut b, &params, state, low, Activation::Tanh { scale: ACTOR_LIMIT })?;
        b.finish(output, purpose)
    }
}

/// The encoder as it is evaluated in flight, row by row: the scan of [`ActorSpec::encoder_graph`], to the bit, in less time, above all when the
/// caches are cold. Allocates when it is made; nothing after it does.
#[derive(Debug, Clone)]
pub struct FrameEncoder {
    features: ConvChain,
    scan: Dense,
    scan_params: Params,
}

impl FrameEncoder {
    /// Of an actor.
    ///
    /// # Errors
    /// A frame too small for the encoder.
    pub fn new(spec: ActorSpec) -> Result<Self, ShapeError> {
        let params = spec.reserve(&mut GraphBuilder::new());
        let layers = spec.convolutions().into_iter().zip(params.convolutions);
        let layers: Vec<_> = layers.map(|(layer, at)| (layer, Activation::Elu, at)).collect();
        Ok(Self {
            features: ConvChain::new(Activation::NEAR_CONTRAST, &layers)?,
            scan: spec.scan(),
            scan_params: params.scan,
        })
    }

    /// A frame's collision scan; `params` are an actor's, or the first [`ActorSpec::encoder_len`] of them.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn encode(
        &mut self,
        isa: Isa,
        params: &[f32],
        frame: &[f32],
        scan: &mut [f32; SCAN],
    ) -> Result<(), ShapeError> {
        let features = self.features.forward(isa, params, frame)?;
        let own = part("scan parameters", params, self.scan_params.at, self.scan_params.len)?;
        self.scan.forward(isa, own, Activation::Sigmoid, features, None, scan)
    }
}

/// A frozen actor in flight: encodes the new frame, remembers what the frames before it showed, and decides. Allocates when it is made;
/// nothing after it does.
#[derive(Debug, Clone)]
pub struct Actor {
    isa: Isa,
    params: Aligned,
    encoder: FrameEncoder,
    trunk: Graph,
    trunk_tape: Vec<f32>,
    head: Graph,
    head_tape: Vec<f32>,
    senses: Box<Senses>,
    scan: [f32; SCAN],
    context: [f32; CONTEXT],
    state: [f32; ACTOR_HIDDEN],
    low: [f32; LOW_DIM],
    /// The last action, in units.
    last: Action,
    /// Metres per second that one unit of the first output is.
    unit_m_s: f32,
    ablation: Ablation,
}

/// Takes something from what is remembered and from the low-dimensional observation; frames are replaced before they are encoded.
fn take(what: Ablation, context: &mut [f32; CONTEXT], low: &mut [f32; LOW_DIM]) {
    let (older, remembered) = context.split_at_mut(OLDER_SCANS);
    match what {
        Ablation::Nothing | Ablation::Frames => {}
        Ablation::Memory => remembered.fill(0.0),
        Ablation::Motion => {
            older.fill(0.0);
            let [_, _, _, own @ ..] = low;
            own.fill(0.0);
        }
        Ablation::Goal => {
            let [distance, sine, cosine, ..] = low;
            (*distance, *sine, *cosine) = (1.0, 0.0, 1.0);
        }
    }
}

/// A frame that shows nothing.
static BLANK: DepthFrame = DepthFrame::EMPTY;

impl Actor {
    /// Takes the parameters (in the order of [`ActorSpec::reserve`]).
    ///
    /// # Errors
    /// A parameter slice of another length.
    pub fn new(spec: ActorSpec, isa: Isa, params: &[f32]) -> Result<Self, ShapeError> {
        let (trunk, head) = (
            spec.trunk_graph(Purpose::Gradients)?,
            spec.head_graph(Purpose::Gradients)?,
        );
        expect("actor parameters", params, head.param_len())?;
        Ok(Self {
            isa,
            params: Aligned::from(params),
            encoder: FrameEncoder::new(spec)?,
            trunk_tape: vec![0.0; trunk.tape_len()],
            trunk,
            head_tape: vec![0.0; head.tape_len()],
            head,
            senses: Box::default(),
            scan: [0.0; SCAN],
            context: [0.0; CONTEXT],
            state: [0.0; ACTOR_HIDDEN],
            low: [0.0; LOW_DIM],
            last: Action::HOVER,
            unit_m_s: 1.0,
            ablation: Ablation::Nothing,
        })
    }

    /// The same actor, trained to fly `cruise_m_s` where the paper's flies [`ACTOR_LIMIT`].
    #[must_use]
    pub fn cruising_at(mut self, cruise_m_s: f32) -> Self {
        self.unit_m_s = cruise_m_s / ACTOR_LIMIT;
        self
    }

    /// Metres per second that one unit of its first output is: 1 for the paper's.
    pub fn unit_m_s(&self) -> f32 {
        self.unit_m_s
    }

    /// The same actor without something.
    #[must_use]
    pub fn without(mut self, ablation: Ablation) -> Self {
        self.ablation = ablation;
        self
    }

    /// Forgets everything that it has seen.
    pub fn reset(&mut self) {
        self.senses.reset();
        self.pause();
    }

    /// Goes on after a gap: of its own motion it knows nothing, what it remembers of places has aged.
    pub fn pause(&mut self) {
        self.senses.yaw_before = None;
        self.last = Action::HOVER;
    }

    /// Takes over what another actor has observed, without allocating; the next decision is then the one that the other would make.
    pub fn remember_as(&mut self, other: &Self) {
        self.senses.copy_from(&other.senses);
        self.last = other.last;
    }

    /// How often a jump of the odometry made it forget everything.
    pub fn forgotten(&self) -> u32 {
        self.senses.forgotten()
    }

    /// One decision: x-velocity in metres per second, up to [`ACTOR_LIMIT`] times [`Self::unit_m_s`], and yaw in ±[`ACTOR_LIMIT`].
    ///
    /// # Errors
    /// A frame of another size: nothing is remembered of it.
    pub fn decide(&mut self, input: &PilotInput<'_>) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        let depth = match self.ablation {
            Ablation::Frames => &BLANK.depth,
            _ => &input.depth.depth,
        };
        self.encoder.encode(self.isa, &self.params, depth, &mut self.scan)?;
        self.decide_on_scan(input)
    }

    /// The same on a frame that another actor with this one's encoder has just decided on: its scan is taken over, so that neither
    /// may be one without frames ([`Ablation::Frames`]).
    ///
    /// # Errors
    /// None for a valid description.
    pub fn decide_beside(&mut self, other: &Self, input: &PilotInput<'_>) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        self.scan = other.scan;
        self.decide_on_scan(input)
    }

    fn decide_on_scan(&mut self, input: &PilotInput<'_>) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        self.low = self.senses.observe(&self.scan, Odometry::of(input), input, self.last);
        self.context = *self.senses.context();
        take(self.ablation, &mut self.context, &mut self.low);
        self.trunk.forward(
            self.isa,
            &self.params,
            &[&self.scan, &self.context],
            &mut self.trunk_tape,
        )?;
        self.state.copy_from_slice(self.trunk.output(&self.trunk_tape)?);
        self.head
            .forward(self.isa, &self.params, &[&self.state, &self.low], &mut self.head_tape)?;
        let mut action = [0.0; ACTOR_OUTPUTS];
        action.copy_from_slice(self.head.output(&self.head_tape)?);
        let [forward, yaw] = action;
        let decided = Action::new(forward, yaw).scaled(self.unit_m_s);
        self.note_action(decided);
        Ok([decided.forward_m_s, yaw])
    }

    /// The 48 values of the last decision: the split point, input of the second half.
    pub fn state(&self) -> &[f32; ACTOR_HIDDEN] {
        &self.state
    }

    /// The collision scan of the last decision, proximities from left to right.
    pub fn scan(&self) -> &[f32; SCAN] {
        &self.scan
    }

    /// What was remembered in the last decision.
    pub fn context(&self) -> &[f32; CONTEXT] {
        &self.context
    }

    /// The low-dimensional observation of the last decision.
    pub fn low_dim(&self) -> LowDim {
        LowDim::from(self.low)
    }

    /// Takes note of the action that is flown after the last decision, if it is not the actor's own. One that is not finite is not flown:
    /// the vehicle holds.
    pub fn note_action(&mut self, flown: Action) {
        self.last = if flown.is_finite() {
            flown.scaled(1.0 / self.unit_m_s)
        } else {
            Action::HOVER
        };
    }

    /// The parameters.
    pub fn params(&self) -> &[f32] {
        &self.params
    }
}
