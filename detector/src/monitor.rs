//! What runs in the tick: explains the actor's decision at its split point and judges the last ten explanations.

use crate::lstm_ad::{LstmAd, ROW, WINDOW, normalise, row_of};
use crate::{DeepShap, FrozenDetector, ShapError};
use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::vec::Vec;
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::ExplainedHead;
use vigil_policy::actor::{LOW_DIM, LowDim};
use vigil_types::{Judgement, Verdict};

/// The actor's output that is explained: yaw, the one an attack aims at.
const YAW: usize = 1;

/// Why an actor cannot be monitored. All of it is found before take-off.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the texts say what the fields are")]
pub enum MonitorError {
    /// The detector was trained on another actor's explanations.
    #[error(
        "the detector judges the actor with SHA-256 {expected}, the actor that is to fly has {found}; give the detector \
         that was trained for it, or fly with the detector off"
    )]
    OtherActor { expected: String, found: String },
    /// The actor cannot be explained against the detector's background sample.
    #[error("the actor cannot be explained: {0}")]
    Shap(#[from] ShapError),
    /// Parameters of another length.
    #[error("the detector does not fit: {0}")]
    Shape(#[from] ShapeError),
}

/// Explains and judges one actor, step by step. It sees copies of what the actor decided on, and nothing of it goes back to
/// the actor. No allocation after it was made.
#[derive(Debug, Clone)]
pub struct Monitor {
    shap: DeepShap,
    lstm: LstmAd,
    centre: [f32; ROW],
    scale: [f32; ROW],
    threshold: f32,
    base: f32,
    /// The last explanation: the split point's values, then those beside it.
    phi: Vec<f32>,
    /// Values of the split point.
    width: usize,
    /// Normalised explanations, oldest first; the last `filled` of them are of this flight.
    rows: [[f32; ROW]; WINDOW],
    filled: usize,
}

impl Monitor {
    /// A monitor for the pilot with this digest, which decides by `head` (for multipliers) behind its split point. Allocates; nothing
    /// after it does.
    ///
    /// # Errors
    /// A detector that was trained for another pilot, a background sample or parameters that do not fit.
    pub fn new(
        isa: Isa,
        head: ExplainedHead,
        pilot_sha256: &str,
        detector: &FrozenDetector,
    ) -> Result<Self, MonitorError> {
        if detector.actor_sha256 != pilot_sha256 {
            return Err(MonitorError::OtherActor {
                expected: detector.actor_sha256.clone(),
                found: pilot_sha256.to_owned(),
            });
        }
        let shap = detector.explainer(isa, head)?;
        Ok(Self {
            base: shap.expected().get(YAW).copied().unwrap_or(f32::NAN),
            phi: vec![0.0; shap.phi_len()],
            width: shap.graph().input_len(0),
            shap,
            lstm: LstmAd::new(isa, &detector.params)?,
            centre: detector.centre,
            scale: detector.scale,
            threshold: detector.threshold,
            rows: [[0.0; ROW]; WINDOW],
            filled: 0,
        })
    }

    /// The score above which the verdict is attack.
    pub fn threshold(&self) -> f32 {
        self.threshold
    }

    /// Sets the score above which the verdict is attack.
    pub fn set_threshold(&mut self, threshold: f32) {
        self.threshold = threshold;
    }

    /// Judges a decision by the values at the split point (our actor's 48) and what it was made from beside them (our actor's
    /// low-dimensional observation, the goal of an imported policy). Unknown until ten decisions in a row were explained, and whenever
    /// an explanation or the score is not finite. No allocation, no panic.
    pub fn score(&mut self, state: &[f32], low_dim: impl Into<LowDim>) -> Judgement {
        let Ok(phi) = self.explain(state, &low_dim.into()) else {
            // A window has no gaps.
            self.reset();
            return Judgement {
                base: self.base,
                ..Judgement::UNKNOWN
            };
        };
        let (of_state, of_position) = phi;
        self.rows.rotate_left(1);
        if let Some(newest) = self.rows.last_mut() {
            *newest = normalise(&of_state, &self.centre, &self.scale);
        }
        self.filled = (self.filled + 1).min(WINDOW);
        let score = if self.filled == WINDOW {
            self.lstm.score(&self.rows).ok().filter(|score| score.is_finite())
        } else {
            None
        };
        let [distance, sine_or_bearing, cosine, own_motion @ ..] = of_position;
        Judgement {
            verdict: match score {
                None => Verdict::Unknown,
                Some(score) if score > self.threshold => Verdict::Attack,
                Some(_) => Verdict::Clean,
            },
            score,
            image: of_state.iter().sum(),
            // An imported policy has one value of it, and nothing behind.
            bearing: sine_or_bearing + cosine,
            distance,
            told: own_motion.iter().sum(),
            base: self.base,
            phi: of_state,
        }
    }

    fn explain(&mut self, state: &[f32], low_dim: &LowDim) -> Result<([f32; ROW], [f32; LOW_DIM]), ShapError> {
        self.shap.evaluate(&[state, low_dim])?;
        self.shap.attribute(YAW, &mut self.phi)?;
        let (of_state, of_inputs) = self.phi.split_at_checked(self.width).unwrap_or_default();
        let mut of_position = [0.0; LOW_DIM];
        for (to, from) in of_position.iter_mut().zip(of_inputs) {
            *to = *from;
        }
        Ok((row_of(of_state), of_position))
    }

    /// Forgets the explanations: a new flight, or a gap in the frames.
    pub fn reset(&mut self) {
        self.filled = 0;
    }
}
