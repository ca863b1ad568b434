//! What a detector looks at in each step: explanations, or, to see what these are worth, something else.

use crate::explained::{Record, Step, YAW};
use anyhow::Result;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use vigil_detector::{Background, DeepShap, ROW, row_of};
use vigil_nnet::{Isa, Purpose};
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS};
use vigil_policy::{ExplainedHead, FrozenPilot};
use vigil_types::named;

named! {
    /// What a row of a window holds.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Feature {
        /// SHAP values of the yaw output at the split point.
        Shap => "SHAP values",
        /// The split point's values themselves.
        State => "actor state",
        /// The two outputs.
        Action => "actions",
        /// Gradient of the yaw output with respect to the split point.
        Gradient => "gradients",
    }
}

impl Feature {
    /// Values of a row.
    pub fn width(self) -> usize {
        match self {
            Self::Shap | Self::State | Self::Gradient => ACTOR_HIDDEN,
            Self::Action => ACTOR_OUTPUTS,
        }
    }
}

/// The rows of some flights.
pub type Rows = Vec<Vec<[f32; ROW]>>;

/// What a thread explains with: DeepSHAP, and room for its values and for a gradient's two passes.
type Explaining = (DeepShap, [Vec<f32>; 3]);

/// The rows of flights, by an actor against a background sample; what a feature does not fill is 0.
///
/// # Errors
/// Parameters of another architecture, an empty background sample, an explanation that is not finite.
pub fn rows_of(
    feature: Feature,
    isa: Isa,
    pilot: &FrozenPilot,
    backgrounds: &[Background],
    records: &[Record],
) -> Result<Rows> {
    let shap = vigil_detector::split_point_shap(isa, pilot.head(Purpose::Multipliers)?, backgrounds)?;
    let ExplainedHead { graph, params } = pilot.head(Purpose::Gradients)?;
    let mut packed = vec![0.0; graph.param_len()];
    graph.pack(&params, &mut packed)?;
    let row = |(shap, [phi, tape, work]): &mut Explaining, step: &Step| -> Result<[f32; ROW]> {
        let inputs: [&[f32]; 2] = [&step.state, &step.low_dim];
        Ok(match feature {
            Feature::Shap => {
                shap.evaluate(&inputs)?;
                shap.attribute(YAW, phi)?;
                row_of(&phi[..step.state.len()])
            }
            Feature::State => row_of(&step.state),
            Feature::Action => row_of(&step.output),
            Feature::Gradient => {
                graph.forward(isa, &params, &inputs, tape)?;
                graph.backward(isa, &packed, tape, &[0.0, 1.0], None, work)?;
                row_of(graph.input_gradient(work, 0)?)
            }
        })
    };
    let lens = [shap.phi_len(), graph.tape_len(), graph.work_len()];
    let begin = || (shap.clone(), lens.map(|len| vec![0.0; len]));
    let rows = |with: &mut Explaining, record: &Record| record.steps.iter().map(|step| row(with, step)).collect();
    records.par_iter().map_init(begin, rows).collect()
}
