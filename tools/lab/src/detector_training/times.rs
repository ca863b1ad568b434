//! The paper's table IV: how long deciding, explaining and scoring take, one thread, on the states of a flight.

use crate::detector_training::comparison::ImageNetwork;
use crate::explained::{BACKGROUNDS, Plan, Record, Scenario, YAW, explainer, fly};
use anyhow::Result;
use std::time::Instant;
use vigil_detector::{FrozenDetector, LstmAd, ROW, WINDOW, image, normalise};
use vigil_nnet::{Activation, Isa, Purpose, ShapeError};
use vigil_policy::actor::LOW_DIM;
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_sim::world::Family;
use vigil_types::DEPTH_PIXELS;

/// Seconds of one thread, one value a measurement: in each step the actor's decision on a new frame, the yaw decision's explanation at the
/// split point, and LSTM-AD's verdict on the last ten explanations; in some steps the exact explanation of all pixels of the newest frame,
/// CNN-AD's verdict on their image, and FCN-AD's.
pub type Times = [Vec<f64>; 6];

/// Scores an image; how long it takes does not depend on its weights, which are drawn.
fn image_detector(isa: Isa, network: ImageNetwork) -> Result<impl FnMut(&[f32]) -> Result<(), ShapeError>> {
    let (graph, params) = network.drawn(Activation::Sigmoid, 1)?;
    let mut tape = vec![0.0; graph.tape_len()];
    Ok(move |image: &[f32]| graph.forward(isa, &params, &[image], &mut tape))
}

/// Steps between two explanations of all pixels.
const STRIDE: usize = 10;

/// Runs something and notes how long it took.
fn timed<T>(times: &mut Vec<f64>, work: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let result = work();
    times.push(begun.elapsed().as_secs_f64());
    result
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
    let mut deciding = actor.actor(isa)?;
    let mut shap = detector.explainer(isa, actor.head(Purpose::Multipliers)?)?;
    let (mut lstm, mut rows) = (LstmAd::new(isa, &detector.params)?, [[0.0; ROW]; WINDOW]);
    let mut pixels = explainer(isa, actor, BACKGROUNDS)?;
    let mut phi_of_pixels = vec![0.0; pixels.phi_len()];
    let mut cnn = image_detector(isa, ImageNetwork::CNN)?;
    let mut fcn = image_detector(isa, ImageNetwork::FCN)?;
    let mut times = Times::default();
    let [action_s, explanation_s, verdict_s, pixels_s, cnn_s, fcn_s] = &mut times;
    let scenario = Scenario::unattacked(Family::Validation, seed, Plan::Actor);
    let record = fly(isa, &FrozenPilot::from(actor), &scenario, &mut |step, shown| {
        timed(action_s, || deciding.decide(&shown.input))?;
        let mut phi = [0.0; ROW + LOW_DIM];
        timed(explanation_s, || {
            shap.evaluate(&[&step.state, &step.low_dim])?;
            shap.attribute(YAW, &mut phi)
        })?;
        rows.rotate_left(1);
        rows[WINDOW - 1].copy_from_slice(&phi[..ROW]);
        rows[WINDOW - 1] = normalise(&rows[WINDOW - 1], &detector.centre, &detector.scale);
        timed(verdict_s, || lstm.score(&rows))?;

        let due = action_s.len().is_multiple_of(STRIDE) && pixels_s.len() < pictures;
        if due && let Some(inputs) = shown.inputs(step) {
            timed(pixels_s, || {
                pixels.evaluate(&inputs)?;
                pixels.attribute(YAW, &mut phi_of_pixels)
            })?;
            let bytes = image(&phi_of_pixels[..DEPTH_PIXELS]);
            let bytes = bytes.unwrap_or_else(|| unreachable!("a frame's finite pixels"));
            let values: Vec<f32> = bytes.iter().map(|byte| f32::from(*byte) / 255.0).collect();
            timed(cnn_s, || cnn(&values))?;
            timed(fcn_s, || fcn(&values))?;
        }
        Ok(())
    })?;
    Ok((record, times))
}
