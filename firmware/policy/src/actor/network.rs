//! The actor's network: five depth frames and positional values in, two outputs in ±1.5.
//!
//! Encoder per frame: convolution 5×5 of 16 filters, then four of 3×3 and 32 filters, all with stride 2 and ELU; GRU of
//! 48 over the five frames' features; then, behind the split point of the paper, `tanh` of the state beside a positional
//! branch (2 → 6, tanh), 32 ELU, and `1.5 · tanh` of two outputs: x-velocity, yaw.

extern crate alloc;

use crate::actor::positional::{GOAL_INPUTS, PositionalInputs, WITH_MOVERS};
use alloc::vec;
use alloc::vec::Vec;
use vigil_nnet::shape::{expect, part, part_mut};
use vigil_nnet::{
    Activation, Aligned, Conv2d, Dense, Graph, GraphBuilder, Gru, Isa, NodeId, Params, Purpose, ShapeError,
};

/// Frames in one state (docs/paper.md, "State").
pub const ACTOR_FRAMES: usize = 5;
/// Length of the split point (docs/paper.md, "Actor").
pub const ACTOR_HIDDEN: usize = vigil_types::EXPLAINED_STATE;
/// Outputs: x-velocity and yaw in ±[`ACTOR_LIMIT`].
pub const ACTOR_OUTPUTS: usize = 2;
/// How many decisions ago each of the five frames was taken, oldest first: five in a row.
pub const FRAMES_IN_A_ROW: [usize; ACTOR_FRAMES] = [4, 3, 2, 1, 0];
/// Five frames over 1.6 s at 20 Hz: motion shows, and kept features cost nothing.
pub const FRAMES_SPREAD: [usize; ACTOR_FRAMES] = [32, 16, 8, 4, 0];
/// No frame may be older.
const OLDEST_FRAME: usize = 64;
/// Limit of both outputs.
pub const ACTOR_LIMIT: f32 = vigil_types::ACTION_LIMIT;

/// Kernel, filters of each convolution; all have stride 2 and half the kernel as padding.
const ENCODER: [(usize, usize); 5] = [(5, 16), (3, 32), (3, 32), (3, 32), (3, 32)];
const POSITIONAL_UNITS: usize = 6;
/// Units of the positional branch of an actor that is told of movers.
const POSITIONAL_UNITS_WITH_MOVERS: usize = 24;
const DENSE_UNITS: usize = 32;

/// The actor's dimensions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ActorSpec {
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub cols: usize,
    /// Whether the first layer turns normalised range into `1 / (1 + range / 3 m)` ([`Activation::NEAR_CONTRAST`]).
    pub near_contrast: bool,
    /// Whether it is told, beside the goal, what moves near it ([`PositionalInputs`]).
    pub told_of_movers: bool,
}

/// Where the actor's layers keep their parameters; all graphs of one actor share one parameter slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ActorParams {
    /// The five convolutions.
    pub convolutions: [Params; 5],
    /// The GRU.
    pub gru: Params,
    /// The positional branch.
    pub positional: Params,
    /// State and positional branch to 32.
    pub dense: Params,
    /// 32 → 2.
    pub output: Params,
}

impl ActorSpec {
    /// The actor for the depth frames of this project, 128 × 256.
    pub const FULL: Self = Self {
        rows: 128,
        cols: 256,
        near_contrast: true,
        told_of_movers: false,
    };

    /// The same, told of movers.
    pub const FULL_WITH_MOVERS: Self = Self {
        told_of_movers: true,
        ..Self::FULL
    };

    /// The five convolutions.
    pub fn convolutions(&self) -> [Conv2d; 5] {
        let (mut rows, mut cols, mut channels) = (self.rows, self.cols, 1);
        ENCODER.map(|(kernel, filters)| {
            let layer = Conv2d {
                rows,
                cols,
                channels,
                filters,
                kernel,
                stride: 2,
                padding: kernel / 2,
            };
            (rows, cols, channels) = (rows.div_ceil(2), cols.div_ceil(2), filters);
            layer
        })
    }

    /// Values in a frame.
    pub fn frame_len(&self) -> usize {
        self.rows * self.cols
    }

    /// Values that the encoder makes of a frame, `[row][column][channel]`.
    pub fn features(&self) -> usize {
        let [.., last] = self.convolutions();
        last.output_len()
    }

    /// The recurrent layer.
    pub fn gru(&self) -> Gru {
        Gru {
            inputs: self.features(),
            hidden: ACTOR_HIDDEN,
        }
    }

    /// The positional branch.
    pub fn positional(&self) -> Dense {
        let (inputs, outputs) = if self.told_of_movers {
            (WITH_MOVERS, POSITIONAL_UNITS_WITH_MOVERS)
        } else {
            (GOAL_INPUTS, POSITIONAL_UNITS)
        };
        Dense { inputs, outputs }
    }

    /// The layer behind the split point, of the state beside the positional branch.
    pub fn dense(&self) -> Dense {
        Dense {
            inputs: ACTOR_HIDDEN + self.positional().outputs,
            outputs: DENSE_UNITS,
        }
    }

    /// The last layer.
    pub fn output(&self) -> Dense {
        Dense {
            inputs: DENSE_UNITS,
            outputs: ACTOR_OUTPUTS,
        }
    }

    /// Reserves the parameters, in the order of the fields of [`ActorParams`].
    pub fn reserve(&self, builder: &mut GraphBuilder) -> ActorParams {
        ActorParams {
            convolutions: self.convolutions().map(|layer| builder.params(layer.param_len())),
            gru: builder.params(self.gru().param_len()),
            positional: builder.params(self.positional().param_len()),
            dense: builder.params(self.dense().param_len()),
            output: builder.params(self.output().param_len()),
        }
    }

    /// Adds the encoder of one frame; returns its features.
    ///
    /// # Errors
    /// A frame of another size.
    pub fn encode(
        &self,
        builder: &mut GraphBuilder,
        params: &ActorParams,
        frame: NodeId,
    ) -> Result<NodeId, ShapeError> {
        let mut x = frame;
        if self.near_contrast {
            x = builder.activation(x, Activation::NEAR_CONTRAST)?;
        }
        for (layer, params) in self.convolutions().into_iter().zip(params.convolutions) {
            x = builder.conv2d(x, layer, Activation::Elu, params)?;
        }
        Ok(x)
    }

    /// Adds the GRU over several frames' features, oldest first, from a zero state; returns its last state.
    ///
    /// # Errors
    /// Features of another length.
    pub fn recur(
        &self,
        builder: &mut GraphBuilder,
        params: &ActorParams,
        features: &[NodeId],
    ) -> Result<NodeId, ShapeError> {
        let mut h = builder.zeros(ACTOR_HIDDEN)?;
        for x in features {
            h = builder.gru(*x, h, self.gru(), params.gru)?;
        }
        Ok(h)
    }

    /// Adds the second half model: GRU state and positional values to the outputs.
    ///
    /// # Errors
    /// Nodes of other lengths.
    pub fn head(
        &self,
        builder: &mut GraphBuilder,
        params: &ActorParams,
        state: NodeId,
        position: NodeId,
    ) -> Result<NodeId, ShapeError> {
        self.head_with(
            builder,
            params,
            state,
            position,
            Activation::Tanh { scale: ACTOR_LIMIT },
        )
    }

    /// The same without the saturation: the outputs are `1.5 · tanh` of what this node gives.
    ///
    /// # Errors
    /// Nodes of other lengths.
    pub fn head_before_saturation(
        &self,
        builder: &mut GraphBuilder,
        params: &ActorParams,
        state: NodeId,
        position: NodeId,
    ) -> Result<NodeId, ShapeError> {
        self.head_with(builder, params, state, position, Activation::Identity)
    }

    fn head_with(
        &self,
        builder: &mut GraphBuilder,
        params: &ActorParams,
        state: NodeId,
        position: NodeId,
        last: Activation,
    ) -> Result<NodeId, ShapeError> {
        let state = builder.activation(state, Activation::TANH)?;
        let position = builder.dense(position, self.positional(), Activation::TANH, params.positional)?;
        let joined = builder.concat(&[state, position])?;
        let hidden = builder.dense(joined, self.dense(), Activation::Elu, params.dense)?;
        builder.dense(hidden, self.output(), last, params.output)
    }

    /// The whole actor: inputs are the frames, oldest first, then the positional values.
    ///
    /// # Errors
    /// A frame too small for the encoder.
    pub fn graph(&self, purpose: Purpose, explained: bool) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = self.reserve(&mut b);
        let mut features = Vec::with_capacity(ACTOR_FRAMES);
        for _ in 0..ACTOR_FRAMES {
            let frame = b.input(self.frame_len(), explained)?;
            features.push(self.encode(&mut b, &params, frame)?);
        }
        let position = b.input(self.positional().inputs, explained)?;
        let state = self.recur(&mut b, &params, &features)?;
        let output = self.head(&mut b, &params, state, position)?;
        b.finish(output, purpose)
    }

    /// The actor from the features of the four older frames, oldest first, the newest frame, and the positional values:
    /// what is new in a step, at a fifth of the whole actor's cost. All inputs are explained.
    ///
    /// # Errors
    /// A frame too small for the encoder.
    pub fn newest_frame_graph(&self, purpose: Purpose) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = self.reserve(&mut b);
        let mut features = Vec::with_capacity(ACTOR_FRAMES);
        for _ in 1..ACTOR_FRAMES {
            features.push(b.input(self.features(), true)?);
        }
        let frame = b.input(self.frame_len(), true)?;
        features.push(self.encode(&mut b, &params, frame)?);
        let position = b.input(self.positional().inputs, true)?;
        let state = self.recur(&mut b, &params, &features)?;
        let output = self.head(&mut b, &params, state, position)?;
        b.finish(output, purpose)
    }

    /// The encoder alone: one frame to its features.
    ///
    /// # Errors
    /// A frame too small for the encoder.
    pub fn encoder_graph(&self, purpose: Purpose, explained: bool) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = self.reserve(&mut b);
        let frame = b.input(self.frame_len(), explained)?;
        let features = self.encode(&mut b, &params, frame)?;
        b.finish(features, purpose)
    }

    /// The second half model: inputs are the GRU's state and the positional values.
    ///
    /// # Errors
    /// None for a valid description.
    pub fn head_graph(&self, purpose: Purpose) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let params = self.reserve(&mut b);
        let state = b.input(ACTOR_HIDDEN, true)?;
        let position = b.input(self.positional().inputs, true)?;
        let output = self.head(&mut b, &params, state, position)?;
        b.finish(output, purpose)
    }
}

/// A frozen actor in flight: encodes only the new frame and remembers what the four older ones gave the GRU.
#[derive(Debug, Clone)]
pub struct Actor {
    spec: ActorSpec,
    isa: Isa,
    params: Aligned,
    layout: ActorParams,
    encoder: Graph,
    encoder_tape: Aligned,
    head: Graph,
    head_tape: Vec<f32>,
    /// How many decisions ago each frame was taken, oldest first.
    ages: [usize; ACTOR_FRAMES],
    /// Frames remembered.
    kept: usize,
    /// Features of each remembered frame; a ring of `kept`.
    features: Vec<f32>,
    /// What each remembered frame contributes to the GRU's gates, in the same ring.
    projections: Vec<f32>,
    /// A frame was seen since the last reset.
    started: bool,
    /// Slot of the oldest frame.
    oldest: usize,
    gates: Vec<f32>,
    state: [f32; ACTOR_HIDDEN],
}

impl Actor {
    /// Takes the parameters (in the order of [`ActorSpec::reserve`]). Allocates; nothing after it does.
    ///
    /// # Errors
    /// A parameter slice of another length.
    pub fn new(spec: ActorSpec, isa: Isa, params: &[f32]) -> Result<Self, ShapeError> {
        Self::with_frame_ages(spec, isa, params, FRAMES_IN_A_ROW)
    }

    /// The same for an actor whose five frames are not in a row: how many decisions ago each was taken, oldest first, the last 0.
    ///
    /// # Errors
    /// A parameter slice of another length; ages that do not fall to 0, or begin above 64.
    pub fn with_frame_ages(
        spec: ActorSpec,
        isa: Isa,
        params: &[f32],
        ages: [usize; ACTOR_FRAMES],
    ) -> Result<Self, ShapeError> {
        let falls = ages.windows(2).all(|pair| pair.first() > pair.last());
        let (first, last) = (ages.first().copied(), ages.last().copied());
        let kept = first.filter(|age| *age <= OLDEST_FRAME && falls && last == Some(0));
        let Some(kept) = kept.map(|age| age + 1) else {
            return Err(ShapeError::Description {
                what: "the frames' ages",
                why: "they have to fall from at most 64 to 0",
            });
        };
        let encoder = spec.encoder_graph(Purpose::Gradients, false)?;
        let head = spec.head_graph(Purpose::Gradients)?;
        expect("actor parameters", params, head.param_len())?;
        let layout = spec.reserve(&mut GraphBuilder::new());
        Ok(Self {
            isa,
            params: Aligned::from(params),
            layout,
            encoder_tape: Aligned::zeros(encoder.tape_len()),
            encoder,
            head_tape: vec![0.0; head.tape_len()],
            head,
            features: vec![0.0; kept * spec.features()],
            projections: vec![0.0; kept * spec.gru().projection_len()],
            ages,
            kept,
            started: false,
            oldest: 0,
            gates: vec![0.0; spec.gru().gates_len()],
            state: [0.0; ACTOR_HIDDEN],
            spec,
        })
    }

    /// Forgets the frames.
    pub fn reset(&mut self) {
        self.started = false;
        self.oldest = 0;
    }

    /// One decision: x-velocity and yaw in ±[`ACTOR_LIMIT`]. The first frame after a reset stands for the missing older
    /// ones as well.
    ///
    /// # Errors
    /// A frame of another size: nothing is remembered of it. Positional inputs that are not this actor's.
    pub fn decide(
        &mut self,
        frame: &[f32],
        position: impl Into<PositionalInputs>,
    ) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        let gru = self.spec.gru();
        let len = gru.projection_len();
        self.encoder
            .forward(self.isa, &self.params, &[frame], &mut self.encoder_tape)?;
        let features = self.encoder.output(&self.encoder_tape)?;
        let gru_params = part(
            "actor parameters",
            &self.params,
            self.layout.gru.at,
            self.layout.gru.len,
        )?;
        let slot = part_mut("actor memory", &mut self.projections, self.oldest * len, len)?;
        gru.project(self.isa, gru_params, features, slot)?;
        let width = features.len();
        part_mut("actor memory", &mut self.features, self.oldest * width, width)?.copy_from_slice(features);
        if !self.started {
            for (memory, len) in [(&mut self.features, width), (&mut self.projections, len)] {
                for slot in 0..self.kept {
                    memory.copy_within(self.oldest * len..(self.oldest + 1) * len, slot * len);
                }
            }
            self.started = true;
        }
        self.oldest = (self.oldest + 1) % self.kept;
        self.state.fill(0.0);
        for age in self.ages {
            let slot = (self.oldest + self.kept - 1 - age) % self.kept;
            let projection = part("actor memory", &self.projections, slot * len, len)?;
            let previous = self.state;
            gru.step(
                self.isa,
                gru_params,
                projection,
                &previous,
                &mut self.gates,
                &mut self.state,
            )?;
        }
        self.head.forward(
            self.isa,
            &self.params,
            &[&self.state, &position.into()],
            &mut self.head_tape,
        )?;
        let mut action = [0.0; ACTOR_OUTPUTS];
        action.copy_from_slice(self.head.output(&self.head_tape)?);
        Ok(action)
    }

    /// The GRU's state of the last decision: the split point, input of the second half model.
    pub fn state(&self) -> &[f32; ACTOR_HIDDEN] {
        &self.state
    }

    /// Features of the frame of `age` decisions ago: 0 is the newest. `None` for one older than the oldest that counts.
    pub fn features(&self, age: usize) -> Option<&[f32]> {
        let slot = (self.oldest + self.kept).checked_sub(age + 1)? % self.kept;
        let width = self.spec.features();
        let memory = self.features.get(slot * width..(slot + 1) * width);
        memory.filter(|_| age < self.kept)
    }

    /// How many decisions ago each of the five frames was taken, oldest first.
    pub fn frame_ages(&self) -> [usize; ACTOR_FRAMES] {
        self.ages
    }

    /// The parameters.
    pub fn params(&self) -> &[f32] {
        &self.params
    }

    /// The dimensions.
    pub fn spec(&self) -> ActorSpec {
        self.spec
    }
}
