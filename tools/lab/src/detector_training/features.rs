//! What a detector looks at in each step: explanations, or, to see what these are worth, something else.

use crate::explained::{Record, Step, YAW};
use anyhow::Result;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use vigil_detector::{Background, DeepShap, ROW, row_of};
use vigil_nnet::{Graph, Isa, Purpose};
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

#[derive(Debug, Clone)]
pub struct Extractor {
    feature: Feature,
    isa: Isa,
    shap: DeepShap,
    phi: Vec<f32>,
    row: [f32; ROW],
    /// For the gradient.
    head: Graph,
    params: Vec<f32>,
    packed: Vec<f32>,
    tape: Vec<f32>,
    work: Vec<f32>,
}

impl Extractor {
    /// For an actor and a background sample.
    ///
    /// # Errors
    /// Parameters of another architecture, an empty background sample.
    pub fn new(feature: Feature, isa: Isa, pilot: &FrozenPilot, backgrounds: &[Background]) -> Result<Self> {
        let shap = vigil_detector::split_point_shap(isa, pilot.head(Purpose::Multipliers)?, backgrounds)?;
        let ExplainedHead { graph: head, params } = pilot.head(Purpose::Gradients)?;
        let mut packed = vec![0.0; head.param_len()];
        head.pack(&params, &mut packed)?;
        Ok(Self {
            feature,
            isa,
            phi: vec![0.0; shap.phi_len()],
            shap,
            row: [0.0; ROW],
            params,
            packed,
            tape: vec![0.0; head.tape_len()],
            work: vec![0.0; head.work_len()],
            head,
        })
    }

    /// A step's row.
    ///
    /// # Errors
    /// An explanation that is not finite.
    pub fn row(&mut self, step: &Step) -> Result<&[f32]> {
        match self.feature {
            Feature::Shap => {
                self.shap.evaluate(&[&step.state, &step.low_dim])?;
                self.shap.attribute(YAW, &mut self.phi)?;
                self.row = row_of(&self.phi[..step.state.len()]);
            }
            Feature::State => self.row = row_of(&step.state),
            Feature::Action => self.row[..ACTOR_OUTPUTS].copy_from_slice(&step.output),
            Feature::Gradient => {
                let (isa, tape, work) = (self.isa, &mut self.tape, &mut self.work);
                self.head
                    .forward(isa, &self.params, &[&step.state, &step.low_dim], tape)?;
                self.head.backward(isa, &self.packed, tape, &[0.0, 1.0], None, work)?;
                self.row = row_of(self.head.input_gradient(work, 0)?);
            }
        }
        Ok(&self.row[..self.feature.width()])
    }
}

/// Rows of flights, one slice for each flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Rows {
    /// Values of a row.
    pub width: usize,
    /// Rows of each flight, one after the other.
    pub flights: Vec<Vec<f32>>,
}

impl Rows {
    /// Of all steps of all flights.
    ///
    /// # Errors
    /// An explanation that is not finite.
    pub fn of(extractor: &Extractor, records: &[Record]) -> Result<Self> {
        let flights = records
            .par_iter()
            .map_init(
                || extractor.clone(),
                |extractor, record| {
                    let mut rows = Vec::with_capacity(record.steps.len() * extractor.feature.width());
                    for step in &record.steps {
                        rows.extend_from_slice(extractor.row(step)?);
                    }
                    Ok(rows)
                },
            )
            .collect::<Result<_>>()?;
        Ok(Self {
            width: extractor.feature.width(),
            flights,
        })
    }

    pub fn row(&self, flight: usize, step: usize) -> &[f32] {
        &self.flights[flight][step * self.width..(step + 1) * self.width]
    }

    /// Subtracts `centre`, divides by `scale` and clips.
    pub fn normalise(&mut self, centre: &[f32], scale: &[f32]) {
        let limit = vigil_detector::ROW_LIMIT;
        for row in self.flights.iter_mut().flat_map(|f| f.chunks_exact_mut(self.width)) {
            for (x, (centre, scale)) in row.iter_mut().zip(centre.iter().zip(scale)) {
                *x = ((*x - centre) / scale).clamp(-limit, limit);
            }
        }
    }
}
