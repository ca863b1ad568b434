//! The paper's table III: four detectors on the same states.

use crate::detector_training::fit::{Epoch, Examples, FitConfig, Fitted, fit, outputs};
use crate::detector_training::lstm::WindowScorer;
use crate::detector_training::metrics::{Separation, moments};
use crate::detector_training::pixels::{State, States};
use anyhow::Result;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use vigil_detector::{IMAGE_CHANNELS, IMAGE_COLS, IMAGE_ROWS, Pca, cnn_ad, fcn_ad};
use vigil_nnet::{Activation, Graph, Isa, ShapeError};
use vigil_policy::FrozenPilot;

/// A detector's row of the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TableRow {
    pub detector: String,
    pub paper: f64,
    pub separation: Separation,
}

impl Examples for &[State] {
    fn count(&self) -> usize {
        (**self).len()
    }

    fn inputs<'a>(&'a self, i: usize, buffer: &'a mut Vec<f32>) -> Vec<&'a [f32]> {
        buffer.clear();
        buffer.extend(self[i].image.iter().map(|b| f32::from(*b) / 255.0));
        vec![buffer.as_slice()]
    }

    fn attacked(&self, i: usize) -> bool {
        self[i].attacked
    }
}

/// An image network: its name, and its graph with this curve at the output.
#[derive(Clone, Copy)]
pub struct ImageNetwork(pub &'static str, fn(Activation) -> Result<Graph, ShapeError>);

impl ImageNetwork {
    /// Convolutions.
    pub const CNN: Self = Self("CNN-AD", cnn_ad);
    /// Dense layers only.
    pub const FCN: Self = Self("FCN-AD", fcn_ad);

    /// It, with drawn weights.
    pub(crate) fn drawn(self, output: Activation, seed: u64) -> Result<(Graph, Vec<f32>)> {
        let graph = self.1(output)?;
        let mut params = vec![0.0; graph.param_len()];
        graph.initialize(&mut ChaCha8Rng::seed_from_u64(seed), &mut params)?;
        Ok((graph, params))
    }

    /// Trains it.
    ///
    /// # Errors
    /// A loss that is not finite.
    pub fn train(
        self,
        isa: Isa,
        (learn, choose): (&States, &States),
        config: &FitConfig,
        progress: &mut dyn FnMut(usize, Option<&Epoch>),
    ) -> Result<Fitted> {
        let (graph, mut params) = self.drawn(Activation::Identity, config.seed)?;
        if self.0 == Self::CNN.0 {
            // Batch norm is the first layer: scale, shift, mean, variance of both channels.
            let pixels = learn.states.iter().flat_map(|s| s.image.chunks_exact(IMAGE_CHANNELS));
            let pixels = pixels.map(|pixel| pixel.iter().map(|byte| f64::from(*byte) / 255.0));
            for (channel, (mean, variance)) in moments(IMAGE_CHANNELS, pixels).into_iter().enumerate() {
                params[2 * IMAGE_CHANNELS + channel] = mean as f32;
                params[3 * IMAGE_CHANNELS + channel] = variance.max(1e-6) as f32;
            }
        }
        let (learn, choose) = (learn.states.as_slice(), choose.states.as_slice());
        fit(&graph, isa, params, &learn, &choose, config, progress)
    }

    /// Scores of states, 0 to 1.
    ///
    /// # Errors
    /// Parameters of another network.
    pub fn scores(self, isa: Isa, params: &[f32], states: &States) -> Result<Vec<f32>> {
        outputs(&self.1(Activation::Sigmoid)?, isa, params, &states.states.as_slice())
    }
}

/// Components of the PCA detector.
const COMPONENTS: usize = 32;
/// Side of the blocks of image values that it sums: a state is 16 × 32 × 2 numbers.
const BLOCK: usize = 4;

/// A state's image, coarse.
fn coarse(state: &State) -> Vec<f32> {
    let (rows, cols) = (IMAGE_ROWS / BLOCK, IMAGE_COLS / BLOCK);
    let mut sums = vec![0.0f32; rows * cols * IMAGE_CHANNELS];
    for (i, byte) in state.image.iter().enumerate() {
        let (channel, pixel) = (i % IMAGE_CHANNELS, i / IMAGE_CHANNELS);
        let (col, row) = (pixel % IMAGE_COLS, pixel / IMAGE_COLS);
        let block = row / BLOCK * cols + col / BLOCK;
        sums[block * IMAGE_CHANNELS + channel] += f32::from(*byte) / 255.0;
    }
    sums
}

/// Scores of the PCA detector on states: how badly unattacked training states' components explain them, over the value that
/// separates the choosing states best. Above 1 is an attack.
pub fn pca_scores(learn: &States, choose: &States, test: &States) -> Vec<f32> {
    let unattacked: Vec<f32> = learn.states.iter().filter(|s| !s.attacked).flat_map(coarse).collect();
    let width = learn.states.first().map_or(1, |s| coarse(s).len());
    let pca = Pca::fit(&unattacked, width, COMPONENTS);
    let score = |states: &States| -> Vec<f32> { states.states.iter().map(|s| pca.score(&coarse(s))).collect() };
    let chosen = score(choose);
    let right = |limit: f32| {
        let verdicts = chosen.iter().zip(&choose.states);
        verdicts.filter(|(score, s)| (**score > limit) == s.attacked).count()
    };
    let limit = chosen.iter().copied().max_by_key(|limit| right(*limit)).unwrap_or(1.0);
    let limit = limit.max(f32::MIN_POSITIVE);
    score(test).into_iter().map(|s| s / limit).collect()
}

/// LSTM-AD's scores of the windows that end in the states.
///
/// # Errors
/// Parameters of another architecture.
pub fn lstm_scores(isa: Isa, pilot: &FrozenPilot, scorer: &WindowScorer, states: &States) -> Result<Vec<f32>> {
    let scores = scorer.scores(isa, pilot, &states.records)?;
    let of = |s: &State| scores.get(s.flight).and_then(|f| *f.get(s.step)?);
    Ok(states.states.iter().map(|s| of(s).unwrap_or(f32::NAN)).collect())
}

/// A row from scores of the states, in their order.
pub fn row(detector: &str, paper: f64, threshold: f32, states: &States, scores: &[f32]) -> TableRow {
    let of = |attacked: bool| -> Vec<f32> {
        let class = states.states.iter().zip(scores).filter(|(s, _)| s.attacked == attacked);
        class.map(|(_, score)| *score).collect()
    };
    TableRow {
        detector: detector.to_owned(),
        paper,
        separation: Separation::of(threshold, &of(true), &of(false)),
    }
}
