//! Trains LSTM-AD on gathered flights.

use crate::detector_training::features::{Extractor, Feature, Rows};
use crate::detector_training::fit::{Epoch, Examples, FitConfig, Fitted, fit, outputs};
use crate::detector_training::flight_files::{Class, counts_of};
use crate::detector_training::metrics::moments;
use crate::explained::Record;
use anyhow::{Result, bail};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use vigil_detector::{Background, FrozenDetector, LstmAd, Of, ROW, WINDOW};
use vigil_nnet::{Activation, Isa};
use vigil_policy::FrozenPilot;
use vigil_types::parameters;

/// How LSTM-AD is trained. Kept in the frozen file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LstmConfig {
    /// Attacked windows to learn from, at most.
    pub windows: usize,
    /// Unattacked windows to one attacked: in flight nearly all are, and a false alarm stops the vehicle.
    pub unattacked: usize,
    /// States of the background sample.
    pub backgrounds: usize,
    /// The optimiser's.
    pub fit: FitConfig,
}

impl Default for LstmConfig {
    fn default() -> Self {
        Self {
            windows: 60_000,
            unattacked: 4,
            backgrounds: 30,
            fit: FitConfig {
                epochs: 2,
                batch: 64,
                rate: 1e-3,
                gradient_norm: 5.0,
                weight_decay: 0.01,
                seed: 1,
            },
        }
    }
}

/// Windows of normalised rows: of each the flight, the newest step, whether it was attacked.
struct Windows<'a>(&'a Rows, Vec<(usize, usize, bool)>);

impl Examples for Windows<'_> {
    fn count(&self) -> usize {
        self.1.len()
    }

    fn inputs<'a>(&'a self, i: usize, _: &'a mut Vec<f32>) -> Vec<&'a [f32]> {
        let (flight, step, _) = self.1[i];
        (step + 1 - WINDOW..=step).map(|s| self.0.row(flight, s)).collect()
    }

    fn attacked(&self, i: usize) -> bool {
        self.1[i].2
    }
}

/// Windows of both classes in the configured proportion, drawn.
pub fn draw_windows(records: &[Record], config: &LstmConfig) -> Vec<(usize, usize, bool)> {
    let (mut attacked, mut unattacked) = (Vec::new(), Vec::new());
    for (flight, record) in records.iter().enumerate() {
        for (step, class) in Class::of_windows(record) {
            match class {
                Class::Attacked => attacked.push((flight, step, true)),
                Class::Unattacked => unattacked.push((flight, step, false)),
                Class::Weak | Class::Lingering => {}
            }
        }
    }
    let mut rng = ChaCha8Rng::seed_from_u64(config.fit.seed);
    attacked.shuffle(&mut rng);
    unattacked.shuffle(&mut rng);
    attacked.truncate(config.windows.min(unattacked.len()));
    unattacked.truncate(config.unattacked * attacked.len());
    attacked.append(&mut unattacked);
    attacked
}

/// Draws the background sample from unattacked flights without noise.
fn draw_backgrounds(records: &[Record], count: usize, seed: u64) -> Vec<Background> {
    let quiet = records.iter().filter(|r| r.scenario.adversary.is_none());
    let mut steps: Vec<_> = quiet.flat_map(|r| &r.steps).collect();
    steps.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    let chosen = steps.iter().take(count);
    chosen.map(|s| (s.state.clone(), s.low_dim)).collect()
}

/// Mean and standard deviation of each value over the unattacked windows' newest rows.
fn statistics(rows: &Rows, at: &[(usize, usize, bool)]) -> (Vec<f32>, Vec<f32>) {
    let quiet = at.iter().filter(|(.., attacked)| !attacked);
    let quiet = quiet.map(|(flight, step, _)| rows.row(*flight, *step).iter().map(|x| f64::from(*x)));
    // A value that never changes is not scaled up to noise.
    let scale = |variance: f64| (variance.max(0.0).sqrt() as f32).max(1e-4);
    let moments = moments(rows.width, quiet).into_iter();
    moments.map(|(mean, variance)| (mean as f32, scale(variance))).unzip()
}

/// A trained network over one kind of rows, and all that is needed to use it.
#[derive(Debug, Clone)]
pub struct WindowScorer {
    /// What it looks at.
    pub feature: Feature,
    /// DeepSHAP's background sample.
    pub backgrounds: Vec<Background>,
    /// Subtracted from a row.
    pub centre: Vec<f32>,
    /// Divides a row.
    pub scale: Vec<f32>,
    /// The network's.
    pub params: Vec<f32>,
}

/// Highest threshold: an attack's score still passes it.
const HIGHEST_THRESHOLD: f32 = 0.999;

/// Trains; also how that went.
///
/// # Errors
/// Too few windows, parameters of another architecture, a loss that is not finite.
pub fn train(
    isa: Isa,
    pilot: &FrozenPilot,
    feature: Feature,
    (learn, choose): (&[Record], &[Record]),
    config: &LstmConfig,
    progress: &mut dyn FnMut(usize, Option<&Epoch>),
) -> Result<(WindowScorer, Fitted)> {
    let seed = config.fit.seed;
    let (learn_at, choose_at) = (draw_windows(learn, config), draw_windows(choose, config));
    for (purpose, at, records) in [("training", &learn_at, learn), ("choosing", &choose_at, choose)] {
        if at.is_empty() {
            let [attacked, .., unattacked] = counts_of(records);
            bail!("the data hold {attacked} attacked and {unattacked} unattacked windows for {purpose}; collect more");
        }
    }
    let backgrounds = draw_backgrounds(learn, config.backgrounds, seed);
    let extractor = Extractor::new(feature, isa, pilot, &backgrounds)?;
    let (mut learn_rows, mut choose_rows) = (Rows::of(&extractor, learn)?, Rows::of(&extractor, choose)?);
    let (centre, scale) = statistics(&learn_rows, &learn_at);
    learn_rows.normalise(&centre, &scale);
    choose_rows.normalise(&centre, &scale);
    let graph = LstmAd::graph(feature.width(), LstmAd::CELL, Activation::Identity)?;
    let mut first = vec![0.0; graph.param_len()];
    graph.initialize(&mut ChaCha8Rng::seed_from_u64(seed), &mut first)?;
    let (learn, choose) = (Windows(&learn_rows, learn_at), Windows(&choose_rows, choose_at));
    let fitted = fit(&graph, isa, first, &learn, &choose, &config.fit, progress)?;
    let scorer = WindowScorer {
        feature,
        backgrounds,
        centre,
        scale,
        params: fitted.params.clone(),
    };
    Ok((scorer, fitted))
}

impl WindowScorer {
    /// Its file's content.
    pub fn freeze(
        &self,
        pilot: &FrozenPilot,
        config: &LstmConfig,
        threshold: f32,
        git_commit: Option<String>,
    ) -> FrozenDetector {
        let row = |values: &[f32]| *values.first_chunk::<ROW>().unwrap_or(&[f32::NAN; ROW]);
        FrozenDetector {
            of: Of::pilot(pilot),
            actor_sha256: pilot.sha256(),
            backgrounds: self.backgrounds.clone(),
            centre: row(&self.centre),
            scale: row(&self.scale),
            threshold,
            threshold_choice: format!(
                "raises no alarm in the unattacked windows of the flights that choose; 0.5 to {HIGHEST_THRESHOLD}"
            ),
            params: self.params.clone(),
            training_config: toml::to_string(config).unwrap_or_else(|e| unreachable!("plain numbers: {e}")),
            seed: config.fit.seed,
            git_commit,
        }
    }

    /// The threshold for flight: the unattacked windows of the flights that choose raise no alarm, which takes
    /// [`RAISE_COUNT`](parameters::RAISE_COUNT) of [`RAISE_WINDOW`](parameters::RAISE_WINDOW) verdicts in a row. An hour of flight has 72 000
    /// windows, and few false alarms count for more there than a few attacked windows missed, since an attack that matters lasts.
    ///
    /// # Errors
    /// Parameters of another architecture.
    pub fn threshold(&self, isa: Isa, pilot: &FrozenPilot, choose: &[Record]) -> Result<f32> {
        let count = parameters::RAISE_COUNT.number() as usize;
        let window = parameters::RAISE_WINDOW.number() as usize;
        let scores = self.scores(isa, pilot, choose)?;
        let mut highest = 0.5_f32;
        for (record, scores) in choose.iter().zip(&scores) {
            let unattacked = |step: &usize| {
                Class::of(record, *step) == Class::Unattacked && record.altered_of_last(*step, WINDOW) == 0
            };
            let scored: Vec<Option<f32>> = scores
                .iter()
                .enumerate()
                .map(|(step, score)| score.filter(|_| unattacked(&step)))
                .collect();
            for verdicts in scored.windows(window) {
                let Some(mut verdicts) = verdicts.iter().copied().collect::<Option<Vec<f32>>>() else {
                    continue;
                };
                verdicts.sort_by(f32::total_cmp);
                highest = highest.max(verdicts[window - count]);
            }
        }
        Ok(highest.min(HIGHEST_THRESHOLD))
    }

    /// From its file.
    pub fn from_frozen(frozen: &FrozenDetector) -> Self {
        Self {
            feature: Feature::Shap,
            backgrounds: frozen.backgrounds.clone(),
            centre: frozen.centre.to_vec(),
            scale: frozen.scale.to_vec(),
            params: frozen.params.clone(),
        }
    }

    /// Scores of all steps of all flights; `None` until the window is full.
    ///
    /// # Errors
    /// Parameters of another architecture.
    pub fn scores(&self, isa: Isa, pilot: &FrozenPilot, records: &[Record]) -> Result<Vec<Vec<Option<f32>>>> {
        let extractor = Extractor::new(self.feature, isa, pilot, &self.backgrounds)?;
        let mut rows = Rows::of(&extractor, records)?;
        rows.normalise(&self.centre, &self.scale);
        let all = records.iter().enumerate();
        let at = all.flat_map(|(flight, r)| (WINDOW - 1..r.steps.len()).map(move |step| (flight, step, false)));
        let windows = Windows(&rows, at.collect());
        let graph = LstmAd::graph(self.feature.width(), LstmAd::CELL, Activation::Sigmoid)?;
        let outputs = outputs(&graph, isa, &self.params, &windows)?;
        let mut scores: Vec<Vec<Option<f32>>> = records.iter().map(|r| vec![None; r.steps.len()]).collect();
        for ((flight, step, _), score) in windows.1.iter().zip(outputs) {
            scores[*flight][*step] = Some(score);
        }
        Ok(scores)
    }
}
