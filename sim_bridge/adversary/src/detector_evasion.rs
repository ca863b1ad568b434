//! The attacker who knows the detector: what its score will be, and which way to bend the actor's state to lower it.

use crate::config::AttackError;
use crate::surrogate::Evaluated;
use vigil_detector::{DeepShap, FrozenDetector, LstmAd, ROW, ROW_LIMIT, WINDOW, normalise};
use vigil_nnet::{Activation, Isa, Purpose};
use vigil_policy::ExplainedHead;
use vigil_policy::actor::{ACTOR_HIDDEN, LOW_DIM, LowDim};

/// The actor's output that the detector explains.
const YAW: usize = 1;
/// Step of the one-sided differences of the explanation, in units of the values at the split point.
const DIFFERENCE: f32 = 1e-3;
/// The attacker lowers the score while its logit is above the threshold's less this margin, and bends the yaw otherwise.
const MARGIN: f32 = 1.0;

/// A copy of the detector's window, and its gradient.
///
/// Score: LSTM-AD through its own layers, back to the newest row; from there through DeepSHAP by one-sided differences over
/// the 48 values of the state, which the pixels' gradient then takes up. Nothing is approximated but those differences.
#[derive(Debug, Clone)]
pub(crate) struct DetectorEvasion {
    shap: DeepShap,
    /// LSTM-AD without its sigmoid: the score's logit.
    network: Evaluated,
    centre: [f32; ROW],
    scale: [f32; ROW],
    /// Logit above which the attacker takes care.
    limit: f32,
    /// Normalised explanations of what was delivered, oldest first; the last one is the step under way.
    rows: [[f32; ROW]; WINDOW],
    filled: usize,
    /// What the actor observes beside frames in the step under way.
    low_dim: LowDim,
}

impl DetectorEvasion {
    pub fn new(isa: Isa, actor: &[f32], detector: &FrozenDetector) -> Result<Self, AttackError> {
        let graph = LstmAd::graph(ROW, LstmAd::CELL, Activation::Identity)?;
        let network = Evaluated::new(isa, graph, &detector.params)?;
        let threshold = detector.threshold;
        Ok(Self {
            shap: detector.explainer(isa, ExplainedHead::of_actor(actor, Purpose::Multipliers)?)?,
            network,
            centre: detector.centre,
            scale: detector.scale,
            limit: (threshold / (1.0 - threshold)).ln() - MARGIN,
            rows: [[0.0; ROW]; WINDOW],
            filled: 0,
            low_dim: [0.0; LOW_DIM].into(),
        })
    }

    /// Makes room for the explanation of a step with this low-dimensional observation.
    pub fn begin_step(&mut self, low_dim: LowDim) {
        self.low_dim = low_dim;
        self.rows.rotate_left(1);
        self.filled = (self.filled + 1).min(WINDOW);
    }

    /// Forgets the steps.
    pub fn reset(&mut self) {
        self.filled = 0;
    }

    /// Takes the state that the actor will have in the step under way; returns how far the score's logit is above what the
    /// attacker allows itself, 0 or less while the score is low enough (a window that is not full is not scored).
    pub fn look(&mut self, state: &[f32]) -> Result<f32, AttackError> {
        let phi = self.explain(state)?;
        if let Some(newest) = self.rows.last_mut() {
            *newest = normalise(&phi, &self.centre, &self.scale);
        }
        if self.filled < WINDOW {
            return Ok(0.0);
        }
        let inputs = self.rows.each_ref().map(|row| row.as_slice());
        let [logit] = self.network.outputs(&inputs)?;
        Ok(logit - self.limit)
    }

    /// Gradient of the logit with respect to the state last looked at.
    pub fn gradient(&mut self, state: &[f32]) -> Result<[f32; ACTOR_HIDDEN], AttackError> {
        let mut d_phi = [0.0; ROW];
        d_phi.copy_from_slice(self.network.gradient(&[1.0], WINDOW - 1)?);
        for ((d, scale), x) in d_phi.iter_mut().zip(&self.scale).zip(&self.rows[WINDOW - 1]) {
            // A clipped value does not move.
            *d = if x.abs() < ROW_LIMIT { *d / scale } else { 0.0 };
        }
        let along = |phi: &[f32; ROW]| phi.iter().zip(&d_phi).map(|(phi, d)| phi * d).sum::<f32>();
        let here = along(&self.explain(state)?);
        let mut moved = [0.0; ACTOR_HIDDEN];
        moved.copy_from_slice(state);
        let mut gradient = [0.0; ACTOR_HIDDEN];
        for i in 0..ACTOR_HIDDEN {
            let kept = moved[i];
            moved[i] = kept + DIFFERENCE;
            gradient[i] = (along(&self.explain(&moved)?) - here) / DIFFERENCE;
            moved[i] = kept;
        }
        Ok(gradient)
    }

    /// SHAP values of the state, yaw output.
    fn explain(&mut self, state: &[f32]) -> Result<[f32; ROW], AttackError> {
        let mut phi = [0.0; ROW + LOW_DIM];
        self.shap.evaluate(&[state, &self.low_dim])?;
        self.shap.attribute(YAW, &mut phi)?;
        let mut of_state = [0.0; ROW];
        of_state.copy_from_slice(&phi[..ROW]);
        Ok(of_state)
    }
}
