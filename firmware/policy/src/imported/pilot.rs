//! The pilot that flies an imported policy: our depth frames in the policy's own format, and its decision in ours.

use super::network::{Network, NetworkError};
use crate::actor::LowDim;
use crate::{Pilot, PilotInput};
use alloc::format;
use alloc::vec;
use alloc::vec::Vec;
use vigil_nnet::{Activation, Aligned, Graph, Isa, NodeId, Purpose};
use vigil_types::named;
use vigil_types::{Action, DEPTH_COLS, DEPTH_ROWS};

named! {
    /// What a policy's pixels are.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum Depth {
        /// The range over 100 m, 0 to 1: as our frames are.
        #[default]
        Range => "range",
        /// `1 / (1 + range / 3 m)`: near is bright.
        Contrast => "contrast",
    }
}

named! {
    /// What a policy's channels are, if it has several.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum Channels {
        /// The last frames, the newest in the last channel.
        #[default]
        Stack => "stack",
        /// The newest frame in each.
        Repeat => "repeat",
    }
}

/// How a policy is given what we have, and how its output is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PolicyInputs {
    /// Rows of its frame; ours are sampled at the middle of each of its pixels.
    pub rows: usize,
    /// Columns of its frame.
    pub cols: usize,
    /// Channels of its frame.
    pub channels: usize,
    /// What they are.
    pub order: Channels,
    /// What a pixel is.
    pub depth: Depth,
    /// Every pixel is multiplied by it: 255 for a policy that learned from bytes.
    pub scale: f32,
    /// Place of the frame among the network's inputs, 0 or 1.
    pub frame_input: usize,
    /// The other input gets distance and bearing of the goal ([`LowDim`]).
    pub has_position: bool,
    /// The two outputs are multiplied by it: 1.5 for a policy with outputs in ±1.
    pub output_scale: f32,
}

/// Flies what an imported policy decides. No allocation after it was made.
#[derive(Debug, Clone)]
pub struct ImportedPilot {
    isa: Isa,
    inputs: PolicyInputs,
    graph: Graph,
    params: Aligned,
    tape: Aligned,
    /// `[row][column][channel]`.
    frame: Vec<f32>,
    /// Where each of its pixels is in our frame.
    places: Vec<u32>,
    /// The split point, if it has one.
    split: Option<NodeId>,
    low_dim: Option<LowDim>,
}

impl PolicyInputs {
    /// Where each of its frame's pixels `[row][column]` is in ours.
    pub fn places(&self) -> impl Iterator<Item = u32> + use<> {
        let Self { rows, cols, .. } = *self;
        (0..rows.saturating_mul(cols)).map(move |pixel| {
            let of = |at: usize, own: usize, ours: usize| (2 * at + 1) * ours / (2 * own);
            (of(pixel / cols, rows, DEPTH_ROWS) * DEPTH_COLS + of(pixel % cols, cols, DEPTH_COLS)) as u32
        })
    }

    /// A pixel's value for a range over 100 m.
    pub fn value(&self, range: f32) -> f32 {
        self.scale * self.unscaled(range)
    }

    /// Change of [`Self::value`] over that of the range.
    pub fn slope(&self, range: f32) -> f32 {
        self.scale
            * match self.depth {
                Depth::Range => 1.0,
                Depth::Contrast => -Activation::NEAR_GAIN * self.unscaled(range) * self.unscaled(range),
            }
    }

    fn unscaled(&self, range: f32) -> f32 {
        match self.depth {
            Depth::Range => range,
            Depth::Contrast => 1.0 / (1.0 + Activation::NEAR_GAIN * range),
        }
    }

    /// Takes our newest frame into the policy's, `[row][column][channel]`; `first` if no frame came before it.
    pub fn see(&self, places: &[u32], depth: &[f32], first: bool, frame: &mut [f32]) {
        let all = self.order == Channels::Repeat || first;
        for (pixel, place) in frame.chunks_exact_mut(self.channels.max(1)).zip(places) {
            let value = self.value(depth.get(*place as usize).copied().unwrap_or(f32::NAN));
            if all {
                pixel.fill(value);
            } else {
                pixel.copy_within(1.., 0);
                if let Some(newest) = pixel.last_mut() {
                    *newest = value;
                }
            }
        }
    }
}

impl ImportedPilot {
    /// A pilot that has seen nothing. Allocates; nothing after it does.
    ///
    /// # Errors
    /// A network that is too large for the step, or that has other inputs and outputs than `inputs` says; a layer that cannot be its split
    /// point.
    pub fn new(
        network: &Network,
        params: &[f32],
        inputs: PolicyInputs,
        split: Option<usize>,
        isa: Isa,
    ) -> Result<Self, NetworkError> {
        let (graph, nodes) = network.graph_and_nodes(Purpose::Gradients)?;
        let (rows, cols) = (inputs.rows, inputs.cols);
        let pixels = rows.saturating_mul(cols);
        let expected = 1 + usize::from(inputs.has_position);
        let frame_len = pixels.saturating_mul(inputs.channels);
        let fits = graph.input_count() == expected
            && inputs.frame_input < expected
            && graph.input_len(inputs.frame_input) == frame_len
            && (!inputs.has_position || graph.input_len(1 - inputs.frame_input) == 2)
            && graph.output_len() == 2
            && graph.param_len() == params.len()
            && [inputs.scale, inputs.output_scale]
                .iter()
                .all(|factor| factor.is_finite())
            && pixels > 0
            && inputs.channels > 0;
        if !fits {
            return Err(NetworkError(format!(
                "its network has {} inputs, {} outputs and {} parameters (here {}), which is not what it says of a frame of \
                 {rows} × {cols} × {}",
                graph.input_count(),
                graph.output_len(),
                graph.param_len(),
                params.len(),
                inputs.channels
            )));
        }
        if let Some(layer) = split {
            network.head(params, layer, inputs.frame_input)?;
        }
        Ok(Self {
            isa,
            inputs,
            params: Aligned::from(params),
            tape: Aligned::zeros(graph.tape_len()),
            graph,
            frame: vec![0.0; frame_len],
            places: inputs.places().collect(),
            split: split.and_then(|layer| nodes.get(layer).copied()),
            low_dim: None,
        })
    }

    /// The values at the split point, of the last decision; `None` without either.
    pub fn state(&self) -> Option<&[f32]> {
        self.low_dim?;
        self.graph.value(&self.tape, self.split?).ok()
    }

    /// The low-dimensional observation of the last decision; `None` before the first.
    pub fn low_dim(&self) -> Option<LowDim> {
        self.low_dim
    }

    /// Decides on our newest frame, ranges over 100 m; within ±1.5. Not finite if its network does not give a number.
    pub fn decide_on(&mut self, depth: &[f32], low_dim: LowDim) -> Action {
        let first = self.low_dim.replace(low_dim).is_none();
        self.inputs.see(&self.places, depth, first, &mut self.frame);
        let own = self.evaluate(&low_dim).unwrap_or(Action::new(f32::NAN, f32::NAN));
        // What is not finite makes the caller hold, and stays what it is.
        if own.is_finite() { own.clipped() } else { own }
    }

    fn evaluate(&mut self, low_dim: &[f32]) -> Option<Action> {
        let frame = self.frame.as_slice();
        let given: [&[f32]; 2] = match self.inputs.frame_input {
            0 => [frame, low_dim],
            _ => [low_dim, frame],
        };
        let given = given.get(..self.graph.input_count())?;
        self.graph.forward(self.isa, &self.params, given, &mut self.tape).ok()?;
        let output = self.graph.output(&self.tape).ok()?;
        let scaled = |i: usize| output.get(i).map(|value| value * self.inputs.output_scale);
        Some(Action::new(scaled(0)?, scaled(1)?))
    }
}

impl Pilot for ImportedPilot {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        self.decide_on(&input.depth.depth, LowDim::of_goal(input.goal))
    }

    fn reset(&mut self) {
        self.low_dim = None;
    }
}
