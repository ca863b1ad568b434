//! The training run: collect, learn, evaluate, keep.

use crate::actor_training::checkpoint::{Candidate, Checkpoint, CheckpointError, RunState};
use crate::actor_training::collector::{CollectError, Collector, FlightReport, Policy};
use crate::actor_training::config::TrainConfig;
use crate::actor_training::evaluation::{EvaluatedActor, EvaluationResult, EvaluationSpec, RolloutError, evaluate};
use crate::actor_training::files::{self, FolderError, WriteError};
use crate::actor_training::learner::{Learner, UpdateError};
use crate::actor_training::networks::Networks;
use crate::actor_training::progress::{self, FlightRow, Progress, Row, RowSum, UPDATES_PER_ROW};
use crate::actor_training::replay_buffer::Memory;
use crate::actor_training::result::{FlightCount, RunResult};
use crate::threads::{ThreadsError, thread_pool};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use vigil_nnet::network_file::FileError;
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::{ActorInputs, FrozenActor};
use vigil_world::Family;

/// Actors that are evaluated once more at the end.
const CANDIDATES: usize = 3;
/// Seed of the first course that tests the frozen actor, the same for every run. Nothing is chosen by these flights.
const FIRST_TEST_SEED: u64 = 7_000_000;
/// A test flight that takes longer has failed, seconds: the courses' own limit.
const TEST_TIME_LIMIT_S: f32 = 90.0;

/// Why training stopped early.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A training flight.
    #[error(transparent)]
    Collect(#[from] CollectError),
    /// An update.
    #[error(transparent)]
    Update(#[from] UpdateError),
    /// A judging flight.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    /// Networks that do not fit.
    #[error(transparent)]
    Network(#[from] ShapeError),
    /// The checkpoint.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Curves.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The frozen actor.
    #[error(transparent)]
    Actor(#[from] FileError),
    /// Threads.
    #[error(transparent)]
    Threads(#[from] ThreadsError),
    /// The folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
}

/// Where and how to run.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Checkpoint, curves and actor go here.
    pub folder: PathBuf,
    /// Go on from the folder's checkpoint.
    pub resume: bool,
    /// Commit of the program, for the frozen actor's metadata.
    pub git_commit: Option<String>,
    /// Flights over validation courses that test the frozen actor without the field.
    pub test_flights: u64,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub enum RunEnd {
    /// It was stopped; its checkpoint is this file.
    Interrupted(PathBuf),
    /// It is complete.
    Complete {
        /// The frozen actor.
        actor: PathBuf,
        /// What the run came to, as in `result.json`.
        result: Box<RunResult>,
    },
}

/// Trains an actor from nothing, or goes on.
///
/// # Errors
/// [`TrainError`]. The folder's last good checkpoint is kept.
pub fn run(
    config: &TrainConfig,
    options: &RunOptions,
    stop: &AtomicBool,
    report: &mut (dyn FnMut(&Progress<'_>) + Send),
) -> Result<RunEnd, TrainError> {
    thread_pool(config.threads)?.install(|| Run::begin(config, options)?.complete(options, stop, report))
}

struct Run<'a> {
    config: &'a TrainConfig,
    isa: Isa,
    networks: Arc<Networks>,
    rng: ChaCha8Rng,
    learner: Learner,
    memory: Memory,
    collectors: Vec<Collector>,
    decisions: u64,
    rows: Vec<Row>,
    row: RowSum,
    flights: Vec<FlightRow>,
    candidates: Vec<Candidate>,
    begun: Instant,
    /// Time spent and updates made before this session.
    earlier_s: f64,
    earlier_updates: u64,
    checkpoint: PathBuf,
}

impl<'a> Run<'a> {
    fn begin(config: &'a TrainConfig, options: &RunOptions) -> Result<Self, TrainError> {
        let folder = &options.folder;
        let checkpoint = files::begin_run(folder, options.resume)?;
        let isa = Isa::detect();
        let networks = Arc::new(Networks::new()?);
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let learner = Learner::new(networks.clone(), isa, config, &mut rng)?;
        let mut run = Self {
            config,
            isa,
            learner,
            memory: Memory::new(config),
            collectors: (0..config.environments)
                .map(|i| Collector::new(config, &networks, i))
                .collect(),
            networks,
            rng,
            decisions: 0,
            rows: Vec::new(),
            row: RowSum::default(),
            flights: Vec::new(),
            candidates: Vec::new(),
            begun: Instant::now(),
            earlier_s: 0.0,
            earlier_updates: 0,
            checkpoint,
        };
        if options.resume {
            run.restore()?;
        }
        // After that: a run that is refused keeps its own.
        files::replace(&folder.join("config.toml"), config.to_toml().as_bytes())?;
        Ok(run)
    }

    fn restore(&mut self) -> Result<(), TrainError> {
        let path = &self.checkpoint;
        let saved = Checkpoint::load(path, &self.networks)?;
        let state = saved.state;
        let other = || CheckpointError::Configuration { path: path.clone() };
        // Threads change nothing but the time.
        let same = toml::from_str(&state.config).is_ok_and(|saved: TrainConfig| {
            let threads = self.config.threads;
            TrainConfig { threads, ..saved } == *self.config
        });
        if !same || state.collectors.len() != self.collectors.len() {
            return Err(other().into());
        }
        let largest = f64::from_bits(state.largest_priority_bits);
        if !self.memory.restore(state.lanes, &saved.priorities, largest) {
            let what = "its decisions and priorities do not belong together";
            let path = path.clone();
            return Err(CheckpointError::Inconsistent { path, what }.into());
        }
        let config = self.config;
        self.collectors
            .par_iter_mut()
            .zip(&mut self.memory.lanes)
            .zip(&state.collectors)
            .try_for_each(|((collector, lane), state)| collector.restore(config, state, lane))
            .map_err(CollectError::from)?;
        let (high, low) = state.random_at;
        self.rng.set_word_pos(u128::from(high) << 64 | u128::from(low));
        self.learner = Learner::with_weights(self.networks.clone(), self.isa, config, saved.weights, state.updates)?;
        self.decisions = state.decisions;
        self.rows = state.rows;
        self.row = state.row;
        self.flights = state.flights;
        self.candidates = saved.candidates;
        self.earlier_s = state.elapsed_s;
        self.earlier_updates = state.updates;
        // Flying the memory's flights again is no training.
        self.begun = Instant::now();
        Ok(())
    }

    fn save(&self) -> Result<(), TrainError> {
        let at = self.rng.get_word_pos();
        let (priorities, largest) = self.memory.priorities();
        let state = RunState::new(
            self.config.to_toml(),
            (self.decisions, self.learner.updates()),
            self.elapsed_s(),
            ((at >> 64) as u64, at as u64),
            largest,
            self.collectors.iter().map(Collector::state).collect(),
            self.memory.lanes.iter().map(|l| l.state().clone()).collect(),
            (self.rows.clone(), self.row.clone(), self.flights.clone()),
        );
        Checkpoint::save(
            &self.checkpoint,
            state,
            self.learner.weights(),
            &priorities,
            &self.candidates,
        )?;
        Ok(())
    }

    /// Time spent on training so far, seconds.
    fn elapsed_s(&self) -> f64 {
        self.earlier_s + self.begun.elapsed().as_secs_f64()
    }

    fn complete(
        mut self,
        options: &RunOptions,
        stop: &AtomicBool,
        report: &mut (dyn FnMut(&Progress<'_>) + Send),
    ) -> Result<RunEnd, TrainError> {
        // Decisions are flown only when the updates that are due have been made, so a run can stop after any update.
        loop {
            while self.learner.updates() < self.config.updates_due(self.decisions) {
                if stop.load(Ordering::Relaxed) {
                    self.save()?;
                    return Ok(RunEnd::Interrupted(self.checkpoint));
                }
                self.update(options, report)?;
            }
            if self.decisions >= self.config.decisions {
                break;
            }
            self.collect()?;
            self.tell(report, None);
        }
        self.save()?;
        self.freeze(options)
    }

    /// One decision in every environment.
    fn collect(&mut self) -> Result<(), TrainError> {
        let (config, decisions) = (self.config, self.decisions);
        let warm_up = decisions < config.warm_up.decisions;
        let policy = Policy {
            networks: &self.networks,
            isa: self.isa,
            actor: (!warm_up).then(|| self.learner.actor()),
            sigma: sigma(config, decisions),
        };
        let finished: Vec<Option<FlightReport>> = self
            .collectors
            .par_iter_mut()
            .zip(&mut self.memory.lanes)
            .map(|(collector, lane)| collector.decide(config, policy, lane))
            .collect::<Result<_, _>>()?;
        let updates = self.learner.updates();
        for flight in finished.into_iter().flatten() {
            self.row.add_flight(flight);
            self.flights.push(FlightRow { updates, flight });
        }
        self.memory.settle();
        self.decisions += config.environments as u64;
        Ok(())
    }

    fn update(
        &mut self,
        options: &RunOptions,
        report: &mut (dyn FnMut(&Progress<'_>) + Send),
    ) -> Result<(), TrainError> {
        let batch = self.memory.sample(self.config.learning.batch, &mut self.rng);
        let (update, errors) = self.learner.update(&batch, &mut self.rng)?;
        for (leaf, error) in errors {
            self.memory.set_error(leaf, error);
        }
        self.row.add_update(&update);
        let updates = self.learner.updates();
        let evaluated = updates.is_multiple_of(self.config.evaluation.every_updates);
        if !evaluated && !updates.is_multiple_of(UPDATES_PER_ROW) {
            return Ok(());
        }
        let mut row = self.row.finish(updates, self.decisions, self.elapsed_s());
        if evaluated {
            let completion = self
                .evaluate(
                    self.learner.frozen(),
                    &self.evaluation_spec(self.config.evaluation.flights),
                )?
                .completion();
            row.completion = Some(completion);
            self.consider(updates, completion);
        }
        self.rows.push(row);
        self.write_curves(&options.folder, evaluated)?;
        if evaluated {
            self.save()?;
        }
        self.tell(report, self.rows.last());
        Ok(())
    }

    fn write_curves(&self, folder: &Path, picture: bool) -> Result<(), WriteError> {
        files::replace(&folder.join("curves.csv"), progress::csv(&self.rows).as_bytes())?;
        files::replace(
            &folder.join("flights.csv"),
            progress::flights_csv(&self.flights).as_bytes(),
        )?;
        if picture {
            files::replace(
                &folder.join("curves.png"),
                &crate::actor_training::curves::png(&self.rows),
            )?;
        }
        Ok(())
    }

    fn tell(&self, report: &mut (dyn FnMut(&Progress<'_>) + Send), row: Option<&Row>) {
        let (updates, all_updates) = (self.learner.updates(), self.config.updates_due(self.config.decisions));
        let here = updates - self.earlier_updates;
        // The pace of the last rows, which warm-up and start do not distort.
        let pace = || {
            let recent = self.rows.get(self.rows.len().saturating_sub(10)..)?;
            let (first, last) = (recent.first()?, recent.last()?);
            let made = (last.updates - first.updates) as f64;
            (made > 0.0).then(|| (last.elapsed_s - first.elapsed_s) / made)
        };
        let left = all_updates.saturating_sub(updates) as f64;
        report(&Progress {
            decisions: self.decisions,
            all_decisions: self.config.decisions,
            updates,
            all_updates,
            left_s: (here > 0).then(pace).flatten().map(|s| s * left),
            row,
        });
    }

    /// So many judging courses without the field.
    fn evaluation_spec(&self, flights: u64) -> EvaluationSpec {
        let e = &self.config.evaluation;
        EvaluationSpec {
            family: Family::Training,
            first_seed: e.first_seed,
            flights,
            time_limit_s: e.time_limit_s,
            field: false,
        }
    }

    fn evaluate(&self, actor: &[f32], what: &EvaluationSpec) -> Result<EvaluationResult, RolloutError> {
        evaluate(EvaluatedActor::Actor(actor, ActorInputs::default()), self.isa, what)
    }

    /// Keeps the actor if it is among the best; of equals the later.
    fn consider(&mut self, updates: u64, completion: f64) {
        self.candidates.push(Candidate {
            updates,
            completion,
            params: self.learner.frozen().to_vec(),
        });
        self.candidates.sort_by(|a, b| {
            let order = b.completion.total_cmp(&a.completion);
            order.then(b.updates.cmp(&a.updates))
        });
        self.candidates.truncate(CANDIDATES);
    }

    /// Judges the best once more over more courses, writes the one that flies best, and tests that one.
    fn freeze(mut self, options: &RunOptions) -> Result<RunEnd, TrainError> {
        if self.candidates.is_empty() {
            self.consider(self.learner.updates(), 0.0);
        }
        let mut best: Option<(EvaluationResult, &Candidate)> = None;
        let elapsed_s = self.elapsed_s();
        let choice = self.evaluation_spec(self.config.evaluation.final_flights);
        for candidate in &self.candidates {
            let result = self.evaluate(&candidate.params, &choice)?;
            if best.as_ref().is_none_or(|(b, _)| result.completion() > b.completion()) {
                best = Some((result, candidate));
            }
        }
        let (result, candidate) = best.unwrap_or_else(|| unreachable!("there is always a candidate"));
        let path = options.folder.join("actor.safetensors");
        let actor = FrozenActor {
            params: candidate.params.clone(),
            inputs: ActorInputs::default(),
            training_config: self.config.to_toml(),
            seed: self.config.seed,
            updates: candidate.updates,
            git_commit: options.git_commit.clone(),
        };
        actor.save(&path)?;
        let test = EvaluationSpec {
            family: Family::Validation,
            first_seed: FIRST_TEST_SEED,
            flights: options.test_flights,
            time_limit_s: TEST_TIME_LIMIT_S,
            field: false,
        };
        let tested = self.evaluate(&candidate.params, &test)?;
        let result = RunResult {
            seed: self.config.seed,
            apf_share: self.config.apf.share,
            decisions: self.decisions,
            steps: self.decisions * self.config.steps_per_decision as u64,
            flights: self.flights.len(),
            updates: self.learner.updates(),
            elapsed_s,
            threads: self.config.threads,
            frozen_after: candidate.updates,
            chosen_by: FlightCount::new(&choice, &result),
            test: FlightCount::new(&test, &tested),
        };
        // Numbers, names and plain structures always have a JSON form.
        let json = serde_json::to_string_pretty(&result).unwrap_or_else(|e| unreachable!("{e}"));
        files::replace(&options.folder.join("result.json"), json.as_bytes())?;
        Ok(RunEnd::Complete {
            actor: path,
            result: Box::new(result),
        })
    }
}

/// Standard deviation of the noise after so many decisions.
fn sigma(config: &TrainConfig, decisions: u64) -> f32 {
    let n = &config.noise;
    let own = decisions.saturating_sub(config.warm_up.decisions) as f32;
    let all = config.decisions.saturating_sub(config.warm_up.decisions).max(1) as f32;
    let done = (own / (all * n.falls_over)).min(1.0);
    n.sigma_first + (n.sigma_last - n.sigma_first) * done
}
