//! What no attack within a reach can do to a decision: bounds of the actor's outputs over all frames that he could make.

use crate::config::{AttackError, EFFECTIVE_YAW};
use vigil_nnet::{Aligned, Bounds, BoundsMut, BoundsParams, Graph, Isa, Purpose, Rounding, ShapeError};
use vigil_policy::actor::{ACTOR_FRAMES, ACTOR_OUTPUTS, ActorSpec, PositionalInputs};

/// An output as it is, and between what it can be brought.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CertifiedOutput {
    /// As decided from the frames as they are.
    pub clean: f32,
    /// No less by any frames within the reach.
    pub lower: f32,
    /// No more by any.
    pub upper: f32,
}

impl CertifiedOutput {
    /// The most that it can be moved, to either side.
    pub fn most_moved(&self) -> f32 {
        (self.upper - self.clean).max(self.clean - self.lower)
    }

    /// Whether it is proved to move by less than [`EFFECTIVE_YAW`].
    pub fn holds(&self) -> bool {
        self.most_moved() < EFFECTIVE_YAW
    }
}

/// Bounds an actor's outputs by interval arithmetic through all of its layers, rounding included ([`Graph::bounds`]). All five frames of
/// a state are altered, each pixel by up to ε and within 0 to 1, as [`crate::Method::BimClipped`] alters them. The positional inputs are
/// taken as they are: what an altered frame does to the planned path and to the tracks of movers is not in the bounds.
#[derive(Debug, Clone)]
pub struct Certificate {
    isa: Isa,
    graph: Graph,
    params: Aligned,
    magnitudes: Aligned,
    tapes: [Aligned; 2],
    work: Aligned,
    /// Frames' lower and upper ends.
    frames: [Vec<f32>; 2],
    frame_len: usize,
}

impl Certificate {
    /// For an actor's parameters. Allocates; bounding does not.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn new(spec: ActorSpec, isa: Isa, params: &[f32]) -> Result<Self, AttackError> {
        let graph = spec.graph(Purpose::Gradients, false)?;
        let mut magnitudes = Aligned::zeros(graph.param_len());
        graph.magnitudes(params, &mut magnitudes)?;
        let ends = || vec![0.0; ACTOR_FRAMES * spec.frame_len()];
        Ok(Self {
            isa,
            params: Aligned::from(params),
            magnitudes,
            tapes: [Aligned::zeros(graph.tape_len()), Aligned::zeros(graph.tape_len())],
            work: Aligned::zeros(graph.bounds_work_len()),
            graph,
            frames: [ends(), ends()],
            frame_len: spec.frame_len(),
        })
    }

    /// `[forward velocity, yaw]` in ±1.5 of a state: `frames` `[5][rows][cols]` ranges over 100 m, oldest first, each of which may be
    /// altered by up to `epsilon` (in the same unit).
    ///
    /// # Errors
    /// Frames of another length.
    pub fn outputs(
        &mut self,
        frames: &[f32],
        position: impl Into<PositionalInputs>,
        epsilon: f32,
    ) -> Result<[CertifiedOutput; ACTOR_OUTPUTS], AttackError> {
        let position = position.into();
        let [lower, upper] = &mut self.frames;
        if frames.len() != lower.len() {
            return Err(AttackError::Shape(ShapeError::Length {
                what: "state's frames",
                expected: lower.len(),
                got: frames.len(),
            }));
        }
        for (end, by) in [(lower, -epsilon), (upper, epsilon)] {
            for (end, range) in end.iter_mut().zip(frames) {
                *end = (range + by).clamp(0.0, 1.0);
            }
        }
        let [low_tape, high_tape] = &mut self.tapes;
        let mut clean: [&[f32]; ACTOR_FRAMES + 1] = [&position; ACTOR_FRAMES + 1];
        for (input, frame) in clean.iter_mut().zip(frames.chunks_exact(self.frame_len)) {
            *input = frame;
        }
        self.graph.forward(self.isa, &self.params, &clean, low_tape)?;
        let mut decided = [0.0; ACTOR_OUTPUTS];
        decided.copy_from_slice(self.graph.output(low_tape)?);

        let mut inputs = [Bounds::exactly(&position); ACTOR_FRAMES + 1];
        let [lower, upper] = &self.frames;
        let ends = lower
            .chunks_exact(self.frame_len)
            .zip(upper.chunks_exact(self.frame_len));
        for (input, (lower, upper)) in inputs.iter_mut().zip(ends) {
            *input = Bounds { lower, upper };
        }
        let params = BoundsParams {
            params: &self.params,
            magnitudes: &self.magnitudes,
        };
        let mut tapes = BoundsMut {
            lower: low_tape,
            upper: high_tape,
        };
        self.graph
            .bounds(self.isa, Rounding::Counted, params, &inputs, &mut tapes, &mut self.work)?;
        let bounds = self.graph.output_bounds(Bounds {
            lower: low_tape,
            upper: high_tape,
        })?;
        let mut ends = bounds.lower.iter().zip(bounds.upper);
        Ok(decided.map(|clean| {
            let (lower, upper) = ends.next().map_or((f32::NAN, f32::NAN), |(l, u)| (*l, *u));
            CertifiedOutput { clean, lower, upper }
        }))
    }
}
