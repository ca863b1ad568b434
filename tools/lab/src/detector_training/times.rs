//! The paper's table IV: how long deciding, explaining and scoring take, one thread, on the states of a flight.

use crate::detector_training::comparison::ImageNetwork;
use crate::explained::{BACKGROUNDS, Onlooker, Plan, Record, Scenario, Shown, Step, YAW, explainer, fly};
use anyhow::Result;
use std::time::Instant;
use vigil_detector::{DeepShap, FrozenDetector, LstmAd, ROW, WINDOW, image, normalise};
use vigil_nnet::{Activation, Isa, Purpose, ShapeError};
use vigil_policy::actor::{Actor, LOW_DIM};
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_sim::world::Family;
use vigil_types::DEPTH_PIXELS;

/// Seconds of one thread, one value a measurement.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Times {
    /// The actor's decision on a new frame, each step.
    pub action_s: Vec<f64>,
    /// The yaw decision's explanation at the split point, each step.
    pub explanation_s: Vec<f64>,
    /// LSTM-AD's verdict on the last ten explanations, each step.
    pub verdict_s: Vec<f64>,
    /// Exact explanation of all pixels of the newest frame, some steps.
    pub pixels_s: Vec<f64>,
    /// CNN-AD's verdict on the images of these.
    pub cnn_s: Vec<f64>,
    /// FCN-AD's.
    pub fcn_s: Vec<f64>,
}

/// Judges an image; how long it takes does not depend on its weights, which are drawn.
type ImageDetector = Box<dyn FnMut(&[f32]) -> Result<(), ShapeError>>;

fn image_detector(isa: Isa, network: ImageNetwork) -> Result<ImageDetector> {
    let (graph, params) = network.drawn(Activation::Sigmoid, 1)?;
    let mut tape = vec![0.0; graph.tape_len()];
    Ok(Box::new(move |image| graph.forward(isa, &params, &[image], &mut tape)))
}

/// Steps between two explanations of all pixels.
const STRIDE: usize = 10;

struct Timing {
    actor: Actor,
    shap: DeepShap,
    detector: FrozenDetector,
    lstm: LstmAd,
    rows: [[f32; ROW]; WINDOW],
    pixels: DeepShap,
    phi: Vec<f32>,
    cnn: ImageDetector,
    fcn: ImageDetector,
    /// How many explanations of all pixels there shall be.
    pictures: usize,
    times: Times,
}

/// Runs something and notes how long it took.
fn timed<T>(times: &mut Vec<f64>, work: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let result = work();
    times.push(begun.elapsed().as_secs_f64());
    result
}

impl Onlooker for Timing {
    fn step(&mut self, step: &Step, shown: &Shown<'_>) -> Result<()> {
        let Self { times, .. } = self;
        timed(&mut times.action_s, || self.actor.decide(&shown.input))?;
        let mut phi = [0.0; ROW + LOW_DIM];
        timed(&mut times.explanation_s, || {
            self.shap.evaluate(&[&step.state, &step.low_dim])?;
            self.shap.attribute(YAW, &mut phi)
        })?;
        self.rows.rotate_left(1);
        self.rows[WINDOW - 1].copy_from_slice(&phi[..ROW]);
        self.rows[WINDOW - 1] = normalise(&self.rows[WINDOW - 1], &self.detector.centre, &self.detector.scale);
        timed(&mut times.verdict_s, || self.lstm.score(&self.rows))?;

        let due = times.action_s.len().is_multiple_of(STRIDE) && times.pixels_s.len() < self.pictures;
        if due && let Some(inputs) = shown.inputs(step) {
            timed(&mut times.pixels_s, || {
                self.pixels.evaluate(&inputs)?;
                self.pixels.attribute(YAW, &mut self.phi)
            })?;
            let bytes = image(&self.phi[..DEPTH_PIXELS]).unwrap_or_else(|| unreachable!("a frame's finite pixels"));
            let values: Vec<f32> = bytes.iter().map(|byte| f32::from(*byte) / 255.0).collect();
            timed(&mut times.cnn_s, || (self.cnn)(&values))?;
            timed(&mut times.fcn_s, || (self.fcn)(&values))?;
        }
        Ok(())
    }
}

/// Flies a validation course unattacked and times every part on its states; all pixels of `pictures` of them.
///
/// # Errors
/// An actor or a detector of another architecture.
pub fn time(
    isa: Isa,
    actor: &FrozenActor,
    detector: &FrozenDetector,
    seed: u64,
    pictures: usize,
) -> Result<(Record, Times)> {
    let pixels = explainer(isa, actor, BACKGROUNDS)?;
    let mut timing = Timing {
        actor: actor.actor(isa)?,
        shap: detector.explainer(isa, actor.head(Purpose::Multipliers)?)?,
        detector: detector.clone(),
        lstm: LstmAd::new(isa, &detector.params)?,
        rows: [[0.0; ROW]; WINDOW],
        phi: vec![0.0; pixels.phi_len()],
        pixels,
        cnn: image_detector(isa, ImageNetwork::Cnn)?,
        fcn: image_detector(isa, ImageNetwork::Fcn)?,
        pictures,
        times: Times::default(),
    };
    let scenario = Scenario::unattacked(Family::Validation, seed, Plan::Actor);
    let record = fly(isa, &FrozenPilot::from(actor), &scenario, &mut timing)?;
    Ok((record, timing.times))
}
