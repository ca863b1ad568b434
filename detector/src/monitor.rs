//! What runs in the tick: explains the actor's decision at its split point and judges the last ten explanations.

use crate::lstm_ad::{LstmAd, ROW, WINDOW, normalise};
use crate::{DeepShap, FrozenDetector, ShapError};
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::actor::{ACTOR_HIDDEN, GOAL_INPUTS, PositionalInputs, WITH_MOVERS};
use vigil_types::{Judgement, Verdict};

/// The actor's output that is explained: yaw, the one an attack aims at.
const YAW: usize = 1;

/// Why an actor cannot be watched. All of it is found before take-off.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MonitorError {
    /// The detector was trained on another actor's explanations.
    #[error(
        "the detector judges the actor with SHA-256 {expected}, the actor that is to fly has {found}; give the detector \
         that was trained for it, or fly with the detector off"
    )]
    OtherActor {
        /// The actor that the detector was trained for.
        expected: String,
        /// The actor that is to fly.
        found: String,
    },
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
    /// Normalised explanations, oldest first; the last `filled` of them are of this flight.
    rows: [[f32; ROW]; WINDOW],
    filled: usize,
}

impl Monitor {
    /// A monitor for the actor with these parameters and digest. Allocates; nothing after it does.
    ///
    /// # Errors
    /// A detector that was trained for another actor, a background sample or parameters that do not fit.
    pub fn new(
        isa: Isa,
        actor_params: &[f32],
        actor_sha256: &str,
        detector: &FrozenDetector,
    ) -> Result<Self, MonitorError> {
        if detector.actor_sha256 != actor_sha256 {
            return Err(MonitorError::OtherActor {
                expected: detector.actor_sha256.clone(),
                found: actor_sha256.to_owned(),
            });
        }
        let shap = detector.explainer(isa, detector.spec(), actor_params)?;
        Ok(Self {
            base: shap.expected().get(YAW).copied().unwrap_or(f32::NAN),
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

    /// Judges a decision by the GRU's state `[48]` and the positional inputs it was made from. Unknown until ten decisions in a row
    /// were explained, and whenever an explanation or the score is not finite. No allocation, no panic.
    pub fn judge(&mut self, state: &[f32; ACTOR_HIDDEN], position: impl Into<PositionalInputs>) -> Judgement {
        let Ok(phi) = self.explain(state, &position.into()) else {
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
        let [distance, bearing] = of_position;
        Judgement {
            verdict: match score {
                None => Verdict::Unknown,
                Some(score) if score > self.threshold => Verdict::Attack,
                Some(_) => Verdict::Clean,
            },
            score,
            image: of_state.iter().sum(),
            bearing,
            distance,
            base: self.base,
            phi: of_state,
        }
    }

    fn explain(
        &mut self,
        state: &[f32; ACTOR_HIDDEN],
        position: &PositionalInputs,
    ) -> Result<([f32; ROW], [f32; GOAL_INPUTS]), ShapError> {
        let mut phi = [0.0; ACTOR_HIDDEN + WITH_MOVERS];
        self.shap.evaluate(&[state, position])?;
        let explained = ACTOR_HIDDEN + position.len();
        self.shap.attribute(YAW, phi.get_mut(..explained).unwrap_or_default())?;
        let (mut of_state, mut of_position) = ([0.0; ROW], [0.0; GOAL_INPUTS]);
        for (to, from) in of_state.iter_mut().chain(&mut of_position).zip(phi) {
            *to = from;
        }
        Ok((of_state, of_position))
    }

    /// Forgets the explanations: a new flight, or a gap in the frames.
    pub fn reset(&mut self) {
        self.filled = 0;
    }
}
