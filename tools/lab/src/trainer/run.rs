//! A run: teach the encoder, fly, learn, evaluate, freeze.

mod resume;

use crate::cli::output::git_commit;
use crate::trainer::actor_net::ActorNet;
use crate::trainer::config::LearnConfig;
use crate::trainer::encoder::teach_encoder;
use crate::trainer::evaluation::{EvaluatedActor, EvaluationSpec, FamilyCount, evaluate};
use crate::trainer::learner::{Learner, UpdateReport};
use crate::trainer::observation::{Drift, Encoder, OBSERVATION};
use crate::trainer::replay::Replay;
use crate::trainer::store::{Stored, replace};
use crate::trainer::worker::{EnvWorker, FlightReport};
use anyhow::{Context, Result, bail, ensure};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fs::{File, TryLockError};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_sim::world::{Family, Outcome};
use vigil_types::{Ablation, settings};

/// Updates that a row of the curve sums up.
const UPDATES_PER_ROW: u64 = 1_000;
/// Actors that are evaluated once more at the end.
const CANDIDATES: usize = 3;
/// Seeds of the flights that choose between them.
const FIRST_CHOOSING_SEED: u64 = 300_000;
/// Seeds of the flights that test the chosen one. Nothing is chosen by these.
const FIRST_TEST_SEED: u64 = 7_000_000_000;

/// Where and how to run.
#[derive(Debug, Clone)]
pub struct LearnOptions {
    /// Everything goes here.
    pub folder: PathBuf,
    /// Go on from the folder's checkpoint.
    pub resume: bool,
    /// Parameters of an encoder to be taken instead of teaching one.
    pub encoder: Option<Vec<f32>>,
    /// Flights of each family that test the chosen actor.
    pub test_flights: u64,
}

/// One row of the curve.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Updates so far.
    pub updates: u64,
    /// Decisions so far.
    pub decisions: u64,
    /// Time spent, seconds, interruptions left out.
    pub elapsed_s: f64,
    /// Training flights that ended since the row before.
    pub flights: usize,
    /// Those at the goal.
    pub successes: usize,
    /// Their mean sum of rewards.
    pub reward: f32,
    /// Means over the updates.
    pub update: UpdateReport,
    /// Evaluation flights, if there were any at this row.
    pub evaluated: Vec<FamilyCount>,
}

impl Row {
    /// The mean sum of rewards, if a flight ended, with as many digits.
    pub fn reward(&self, digits: usize) -> Option<String> {
        (self.flights > 0).then(|| format!("{:.digits$}", self.reward))
    }
}

/// An actor that may be chosen.
#[derive(Debug, Clone, PartialEq)]
struct Candidate {
    updates: u64,
    completion: f64,
    params: Vec<f32>,
}

/// What a run came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LearnResult {
    /// Seed.
    pub seed: u64,
    /// Share of the training flights with the field.
    pub apf_share: f64,
    /// Decisions.
    pub decisions: u64,
    /// Steps of 0.05 s that the decisions took, at most.
    pub steps: u64,
    /// Training flights that ended.
    pub flights: usize,
    /// Updates.
    pub updates: u64,
    /// Updates after which the chosen actor was frozen.
    pub frozen_after: u64,
    /// Time spent, seconds.
    pub elapsed_s: f64,
    /// Flights that test it; nothing was chosen by them.
    pub test: Vec<FamilyCount>,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub enum LearnEnd {
    /// It was stopped; its checkpoint is this file. There is none while the encoder is taught.
    Interrupted(Option<PathBuf>),
    /// It is complete.
    Complete(Box<FrozenActor>, Box<LearnResult>),
}

/// Something to report while a run goes on.
#[derive(Debug, Clone, PartialEq)]
pub enum Progress<'a> {
    /// The encoder learns: updates, mean squared error of the proximity.
    Encoder(u64, f32),
    /// A row of the curve, and how many updates there will be.
    Row(&'a Row, u64),
}

/// Gets the progress of a run.
pub type Report<'a> = &'a mut (dyn FnMut(Progress<'_>) + Send);

/// Trains from nothing or from a checkpoint.
///
/// # Errors
/// A bad configuration, a checkpoint of another run, a file that cannot be written, a loss that is not finite. The folder's last good checkpoint is kept.
pub fn learn(config: &LearnConfig, options: &LearnOptions, stop: &AtomicBool, report: Report<'_>) -> Result<LearnEnd> {
    config.check()?;
    vigil_tools::threads::thread_pool(config.threads)?.install(|| match Run::begin(config, options, stop, report)? {
        Some(run) => run.complete(stop, report),
        None => Ok(LearnEnd::Interrupted(None)),
    })
}

/// What has come of a run so far, but for what it learned.
#[derive(Clone, Default, Serialize, Deserialize)]
struct SoFar {
    decisions: u64,
    rows: Vec<Row>,
    /// Of the updates since the last row, and how many these are.
    sum: UpdateReport,
    summed: u32,
    /// Training flights that ended since then.
    ended: Vec<FlightReport>,
    /// All training flights that ended, each with the updates made by then.
    flights: Vec<(u64, FlightReport)>,
}

struct Run<'a> {
    config: &'a LearnConfig,
    options: &'a LearnOptions,
    isa: Isa,
    encoder_params: Vec<f32>,
    rng: ChaCha8Rng,
    learner: Learner,
    deciding: ActorNet,
    replay: Replay,
    workers: Vec<EnvWorker>,
    so_far: SoFar,
    candidates: Vec<Candidate>,
    begun: Instant,
    earlier_s: f64,
    checkpoint: PathBuf,
    /// The folder, locked: two runs in it would overwrite each other's files.
    _lock: File,
}

impl<'a> Run<'a> {
    /// `None` if it was stopped while the encoder was taught.
    fn begin(
        config: &'a LearnConfig,
        options: &'a LearnOptions,
        stop: &AtomicBool,
        report: Report<'_>,
    ) -> Result<Option<Self>> {
        let folder = &options.folder;
        // A folder that holds a run is there already: a mistyped one is not made.
        if !options.resume {
            std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        }
        let lock = File::open(folder).with_context(|| format!("cannot open {}", folder.display()))?;
        if let Err(TryLockError::WouldBlock) = lock.try_lock() {
            bail!("another `vigil learn` trains in {}", folder.display());
        }
        let checkpoint = folder.join("checkpoint.safetensors");
        ensure!(
            options.resume || !checkpoint.exists(),
            "{} holds a run already; resume it, or train in another folder",
            folder.display()
        );
        let (isa, begun) = (Isa::detect(), Instant::now());
        let saved = options.resume.then(|| Stored::read(&checkpoint)).transpose()?;
        let encoder_params = match (&saved, &options.encoder) {
            (Some(saved), given) => {
                let own = saved.f32("encoder", None)?;
                ensure!(
                    given.as_ref().is_none_or(|given| *given == own),
                    "--encoder-of names another encoder than the checkpoint's: leave it out"
                );
                own
            }
            (None, Some(encoder)) => encoder.clone(),
            (None, None) => {
                let mut progress = |updates, loss| report(Progress::Encoder(updates, loss));
                match teach_encoder(&config.encoder, config.seed, isa, stop, &mut progress)? {
                    Some(params) => params,
                    None => return Ok(None),
                }
            }
        };
        let encoder = Arc::new(Encoder::new(isa, &encoder_params)?);
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let learner = Learner::new(config, isa, &mut rng);
        let workers = (0..config.environments).map(|i| EnvWorker::new(config, encoder.clone(), i));
        let mut run = Self {
            workers: workers.collect(),
            config,
            options,
            isa,
            encoder_params,
            rng,
            learner,
            deciding: ActorNet::new(config.environments),
            replay: Replay::new(config),
            so_far: SoFar::default(),
            candidates: Vec::new(),
            begun,
            earlier_s: 0.0,
            checkpoint,
            _lock: lock,
        };
        if let Some(saved) = &saved {
            run.restore(saved)?;
        }
        // It says that the run is complete: at the end it is written again.
        let _ = std::fs::remove_file(folder.join("result.json"));
        replace(&folder.join("config.toml"), settings::to_toml(config).as_bytes())?;
        Ok(Some(run))
    }

    fn elapsed_s(&self) -> f64 {
        self.earlier_s + self.begun.elapsed().as_secs_f64()
    }

    fn complete(mut self, stop: &AtomicBool, report: Report<'_>) -> Result<LearnEnd> {
        loop {
            let is_due = self.learner.updates < self.config.updates_due(self.so_far.decisions);
            if !is_due && self.so_far.decisions >= self.config.decisions {
                break;
            }
            if stop.load(Ordering::Relaxed) {
                self.save()?;
                return Ok(LearnEnd::Interrupted(Some(self.checkpoint)));
            }
            if is_due {
                self.update(report)?;
            } else {
                self.collect()?;
            }
        }
        self.save()?;
        self.freeze(stop)
    }

    /// One decision in every environment.
    fn collect(&mut self) -> Result<()> {
        let (config, warm_up) = (self.config, self.so_far.decisions < self.config.warm_up);
        let observations = self
            .workers
            .par_iter_mut()
            .map(|worker| worker.observation(config, warm_up))
            .collect::<Result<Vec<[f32; OBSERVATION]>>>()?;
        let mut pre = vec![0.0; 2 * self.workers.len()];
        if !warm_up {
            let (params, rows) = (&self.learner.actor.params, observations.as_flattened());
            pre = self.deciding.forward(self.isa, params, rows)?.to_vec();
        }
        let sigma = self.sigma();
        let ended = self
            .workers
            .par_iter_mut()
            .zip(&mut self.replay.trajectories)
            .zip(pre.par_chunks_exact(2))
            .map(|((worker, lane), pre)| worker.fly(config, (!warm_up).then(|| [pre[0], pre[1]]), sigma, lane))
            .collect::<Result<Vec<_>>>()?;
        for flight in ended.into_iter().flatten() {
            self.so_far.flights.push((self.learner.updates, flight));
            self.so_far.ended.push(flight);
        }
        self.replay.settle();
        self.so_far.decisions += config.environments as u64;
        Ok(())
    }

    /// The noise's standard deviation now.
    fn sigma(&self) -> f32 {
        let (config, n) = (self.config, &self.config.noise);
        let own = self.so_far.decisions.saturating_sub(config.warm_up) as f32;
        let all = config.decisions.saturating_sub(config.warm_up).max(1) as f32;
        n.sigma_first + (n.sigma_last - n.sigma_first) * (own / (all * n.falls_over)).min(1.0)
    }

    fn update(&mut self, report: Report<'_>) -> Result<()> {
        let batch = self.replay.sample(self.config.learning.batch, &mut self.rng);
        let (update, errors) = self.learner.update(&batch, &mut self.rng)?;
        for (leaf, error) in errors {
            self.replay.set_error(leaf, error);
        }
        self.so_far.sum = self.so_far.sum.plus(&update, 1.0);
        self.so_far.summed += 1;
        let updates = self.learner.updates;
        let evaluates = updates.is_multiple_of(self.config.evaluation.every_updates);
        if !evaluates && !updates.is_multiple_of(UPDATES_PER_ROW) {
            return Ok(());
        }
        let ended = core::mem::take(&mut self.so_far.ended);
        let mut row = Row {
            updates,
            decisions: self.so_far.decisions,
            elapsed_s: self.elapsed_s(),
            flights: ended.len(),
            successes: ended.iter().filter(|f| f.outcome == Some(Outcome::Success)).count(),
            reward: ended.iter().map(|f| f.reward).sum::<f32>() / ended.len().max(1) as f32,
            update: UpdateReport::default().plus(&self.so_far.sum, 1.0 / self.so_far.summed as f32),
            evaluated: Vec::new(),
        };
        (self.so_far.sum, self.so_far.summed) = (UpdateReport::default(), 0);
        if evaluates {
            row.evaluated = self.add_candidate(updates, self.learner.actor.target.clone())?;
        }
        self.so_far.rows.push(row);
        if evaluates {
            self.save()?;
        } else {
            self.write_tables()?;
        }
        if let Some(row) = self.so_far.rows.last() {
            report(Progress::Row(row, self.config.updates_due(self.config.decisions)));
        }
        Ok(())
    }

    /// Evaluates an actor, and keeps it if it is one of the best.
    fn add_candidate(&mut self, updates: u64, params: Vec<f32>) -> Result<Vec<FamilyCount>> {
        let e = &self.config.evaluation;
        let fly = |family: &Family| self.evaluate(&params, *family, e.first_seed, e.flights, Ablation::Nothing);
        let counts = e.families.iter().map(fly).collect::<Result<Vec<_>>>()?;
        let completion = counts.iter().map(FamilyCount::completion).sum::<f64>() / counts.len().max(1) as f64;
        self.candidates.push(Candidate {
            updates,
            completion,
            params,
        });
        // Of equals the later.
        self.candidates
            .sort_by(|a, b| b.completion.total_cmp(&a.completion).then(b.updates.cmp(&a.updates)));
        self.candidates.truncate(CANDIDATES);
        Ok(counts)
    }

    fn write_tables(&self) -> Result<()> {
        let folder = &self.options.folder;
        replace(&folder.join("curves.csv"), csv(&self.so_far.rows).as_bytes())?;
        let flights = flights_csv(&self.so_far.flights);
        replace(&folder.join("flights.csv"), flights.as_bytes())
    }

    fn evaluate(
        &self,
        params: &[f32],
        family: Family,
        first_seed: u64,
        flights: u64,
        ablation: Ablation,
    ) -> Result<FamilyCount> {
        let what = EvaluationSpec {
            family,
            first_seed,
            flights,
            time_limit_s: self.config.evaluation.time_limit_s,
            field: false,
            ablation,
            drift: Drift::default(),
        };
        let actor = self.frozen(params, self.learner.updates);
        let result = evaluate(EvaluatedActor::Actor(&actor), self.isa, &what)?;
        Ok(FamilyCount::new(&what, &result))
    }

    /// The actor of these parameters behind the encoder's, after so many updates.
    fn frozen(&self, params: &[f32], updates: u64) -> FrozenActor {
        FrozenActor {
            params: [self.encoder_params.as_slice(), params].concat(),
            training_config: settings::to_toml(self.config),
            seed: self.config.seed,
            updates,
            cruise_m_s: self.config.cruise_m_s,
            git_commit: None,
        }
    }

    /// Evaluates the best once more over other courses, takes the one that flies best, and tests that one and its blind twin. Who resumes a
    /// run that was stopped here has this to do again.
    fn freeze(mut self, stop: &AtomicBool) -> Result<LearnEnd> {
        if self.candidates.is_empty() {
            self.candidates.push(Candidate {
                updates: self.learner.updates,
                completion: 0.0,
                params: self.learner.actor.target.clone(),
            });
        }
        let e = &self.config.evaluation;
        let (mut most, mut chosen) = (None, &self.candidates[0]);
        for candidate in &self.candidates {
            let mut successes = 0;
            for family in &e.families {
                if stop.load(Ordering::Relaxed) {
                    return Ok(LearnEnd::Interrupted(Some(self.checkpoint)));
                }
                let (params, flights) = (&candidate.params, e.final_flights);
                let count = self.evaluate(params, *family, FIRST_CHOOSING_SEED, flights, Ablation::Nothing)?;
                successes += count.successes;
            }
            if most < Some(successes) {
                (most, chosen) = (Some(successes), candidate);
            }
        }
        let mut test = Vec::new();
        for family in [Family::Validation, Family::Dense, Family::Hard] {
            for ablation in [Ablation::Nothing, Ablation::Frames, Ablation::Memory] {
                if stop.load(Ordering::Relaxed) {
                    return Ok(LearnEnd::Interrupted(Some(self.checkpoint)));
                }
                if self.options.test_flights > 0 {
                    let flights = self.options.test_flights;
                    test.push(self.evaluate(&chosen.params, family, FIRST_TEST_SEED, flights, ablation)?);
                }
            }
        }
        let result = LearnResult {
            seed: self.config.seed,
            apf_share: self.config.apf_share,
            decisions: self.so_far.decisions,
            steps: self.so_far.decisions * self.config.steps_per_decision as u64,
            flights: self.so_far.flights.len(),
            updates: self.learner.updates,
            frozen_after: chosen.updates,
            elapsed_s: self.elapsed_s(),
            test,
        };
        let (folder, mut actor) = (&self.options.folder, self.frozen(&chosen.params, chosen.updates));
        actor.git_commit = git_commit();
        actor.save(&folder.join("actor.safetensors"))?;
        let text = serde_json::to_vec_pretty(&result).unwrap_or_default();
        replace(&folder.join("result.json"), &text)?;
        Ok(LearnEnd::Complete(Box::new(actor), Box::new(result)))
    }
}

/// The curve as comma-separated values.
pub fn csv(rows: &[Row]) -> String {
    // A run that goes on may evaluate other families.
    let mut families: Vec<Family> = Vec::new();
    for family in rows.iter().flat_map(|r| r.evaluated.iter().map(|c| c.family)) {
        if !families.contains(&family) {
            families.push(family);
        }
    }
    let names: String = families.iter().map(|family| format!(",{family}")).collect();
    let mut text = format!(
        "updates,decisions,elapsed_s,flights,successes,reward,critic_loss,value,saturated,critic_norm,actor_norm{names}\n"
    );
    for r in rows {
        let completion = |family: &Family| {
            let of_it = r.evaluated.iter().find(|c| c.family == *family);
            of_it.map_or(",".to_owned(), |c| format!(",{:.4}", c.completion()))
        };
        let evaluated: String = families.iter().map(completion).collect();
        let (flights, successes, reward) = (r.flights, r.successes, r.reward(4).unwrap_or_default());
        let (updates, decisions, elapsed_s, u) = (r.updates, r.decisions, r.elapsed_s, &r.update);
        text += &format!("{updates},{decisions},{elapsed_s:.1},{flights},{successes},{reward}");
        let (loss, value, saturated, critic, actor) =
            (u.critic_loss, u.value, u.saturated, u.critic_norm, u.actor_norm);
        text += &format!(",{loss:.5},{value:.4},{saturated:.4},{critic:.4},{actor:.5}{evaluated}\n");
    }
    text
}

/// The training flights as comma-separated values: the data of the paper's figures 9 and 10.
fn flights_csv(flights: &[(u64, FlightReport)]) -> String {
    let mut text = "flight,updates,warm_up,field,outcome,decisions,reward\n".to_owned();
    for (number, (updates, f)) in (1..).zip(flights) {
        let outcome = f.outcome.map_or(String::new(), |outcome| outcome.to_string());
        let (warm_up, field) = (u8::from(f.warm_up), u8::from(f.with_apf));
        text += &format!(
            "{number},{updates},{warm_up},{field},{outcome},{},{:.4}\n",
            f.decisions, f.reward
        );
    }
    text
}
