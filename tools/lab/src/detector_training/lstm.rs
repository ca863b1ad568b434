//! Trains LSTM-AD on gathered flights.

use crate::detector_training::features::{Feature, Rows, rows_of};
use crate::detector_training::fit::{Epoch, Examples, FitConfig, Fitted, fit, outputs};
use crate::detector_training::flight_files::{Class, counts_of};
use crate::detector_training::metrics::moments;
use crate::explained::Record;
use anyhow::{Result, bail};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use vigil_detector::{Background, FrozenDetector, LstmAd, Of, ROW, WINDOW, normalise};
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

/// Windows of normalised rows, of which so many values count: of each window the flight, the newest step, and whether it was attacked.
struct Windows(Rows, usize, Vec<(usize, usize, bool)>);

impl Windows {
    fn of(mut rows: Rows, feature: Feature, at: Vec<(usize, usize, bool)>, detector: &FrozenDetector) -> Self {
        let FrozenDetector { centre, scale, .. } = detector;
        let all = rows.iter_mut().flatten();
        all.for_each(|row| *row = normalise(row, centre, scale));
        Self(rows, feature.width(), at)
    }
}

impl Examples for Windows {
    fn count(&self) -> usize {
        self.2.len()
    }

    fn inputs<'a>(&'a self, i: usize, _: &'a mut Vec<f32>) -> Vec<&'a [f32]> {
        let (flight, step, _) = self.2[i];
        let rows = self.0[flight][step + 1 - WINDOW..=step].iter();
        rows.map(|row| &row[..self.1]).collect()
    }

    fn attacked(&self, i: usize) -> bool {
        self.2[i].2
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
fn statistics(rows: &Rows, at: &[(usize, usize, bool)]) -> [[f32; ROW]; 2] {
    let quiet = at.iter().filter(|(.., attacked)| !attacked);
    let quiet = quiet.map(|(flight, step, _)| rows[*flight][*step].iter().map(|x| f64::from(*x)));
    let moments = moments(ROW, quiet);
    // A value that never changes is not scaled up to noise.
    let scale = |variance: f64| (variance.max(0.0).sqrt() as f32).max(1e-4);
    [
        core::array::from_fn(|i| moments[i].0 as f32),
        core::array::from_fn(|i| scale(moments[i].1)),
    ]
}

/// A detector whose network looks at one kind of rows; what flies looks at SHAP values.
#[derive(Debug, Clone)]
pub struct WindowScorer {
    /// What it looks at.
    pub feature: Feature,
    /// Its network, and all that is needed to use it.
    pub detector: FrozenDetector,
}

/// Highest threshold: an attack's score still passes it.
const HIGHEST_THRESHOLD: f32 = 0.999;

/// Trains; also how that went. The threshold is to be chosen yet.
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
    let rows = |records| rows_of(feature, isa, pilot, &backgrounds, records);
    let (learn_rows, choose_rows) = (rows(learn)?, rows(choose)?);
    let [centre, scale] = statistics(&learn_rows, &learn_at);
    let mut detector = FrozenDetector {
        of: Of::pilot(pilot),
        actor_sha256: pilot.sha256(),
        backgrounds,
        centre,
        scale,
        threshold: 0.5,
        threshold_choice: format!(
            "raises no alarm in the unattacked windows of the flights that choose; 0.5 to {HIGHEST_THRESHOLD}"
        ),
        params: Vec::new(),
        training_config: toml::to_string(config).unwrap_or_else(|e| unreachable!("plain numbers: {e}")),
        seed,
        git_commit: None,
    };
    let graph = LstmAd::graph(feature.width(), LstmAd::CELL, Activation::Identity)?;
    let mut first = vec![0.0; graph.param_len()];
    graph.initialize(&mut ChaCha8Rng::seed_from_u64(seed), &mut first)?;
    let learn = Windows::of(learn_rows, feature, learn_at, &detector);
    let choose = Windows::of(choose_rows, feature, choose_at, &detector);
    let fitted = fit(&graph, isa, first, &learn, &choose, &config.fit, progress)?;
    detector.params.clone_from(&fitted.params);
    Ok((WindowScorer { feature, detector }, fitted))
}

impl WindowScorer {
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

    /// One that flies.
    pub fn from_frozen(detector: FrozenDetector) -> Self {
        let feature = Feature::Shap;
        Self { feature, detector }
    }

    /// Scores of all steps of all flights; `None` until the window is full.
    ///
    /// # Errors
    /// Parameters of another architecture.
    pub fn scores(&self, isa: Isa, pilot: &FrozenPilot, records: &[Record]) -> Result<Vec<Vec<Option<f32>>>> {
        let rows = rows_of(self.feature, isa, pilot, &self.detector.backgrounds, records)?;
        let all = records.iter().enumerate();
        let at = all.flat_map(|(flight, r)| (WINDOW - 1..r.steps.len()).map(move |step| (flight, step, false)));
        let windows = Windows::of(rows, self.feature, at.collect(), &self.detector);
        let graph = LstmAd::graph(self.feature.width(), LstmAd::CELL, Activation::Sigmoid)?;
        let outputs = outputs(&graph, isa, &self.detector.params, &windows)?;
        let mut scores: Vec<Vec<Option<f32>>> = records.iter().map(|r| vec![None; r.steps.len()]).collect();
        for ((flight, step, _), score) in windows.2.iter().zip(outputs) {
            scores[*flight][*step] = Some(score);
        }
        Ok(scores)
    }
}
