//! A run by value: fly, learn, evaluate, keep. The expert's and the pictures' actor's run are the same but for what the actor sees.

use super::actors::told_of_movers;
use super::actors::{ActorNetwork, Row};
use super::encoder::{EncoderError, teach_encoder};
use super::flyer::{Encoder, Flyer, FlyerState};
use super::slope::{Chooser, SlopeReport, fly_chooser, slope_against_truth};
use super::store::{Stored, Values, save};
use super::value_buffer::{Moment, ValueMemory};
use super::value_config::{Sees, Teacher, ValueConfig};
use super::value_learner::{Expert, ValueLearner, ValueReport};
use crate::actor_training::adam::Adam;
use crate::actor_training::checkpoint::CheckpointError;
use crate::actor_training::collector::{CollectError, FlightReport};
use crate::actor_training::config::ConfigError;
use crate::actor_training::evaluation::{EvaluatedActor, EvaluationSpec, RolloutError, evaluate};
use crate::actor_training::files::{self, FolderError, WriteError};
use crate::actor_training::learner::UpdateError;
use crate::actor_training::networks::Networks;
use crate::actor_training::progress::{FlightRow, flights_csv};
use crate::actor_training::result::FlightCount;
use crate::statistics::wilson_95;
use crate::threads::{ThreadsError, thread_pool};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use vigil_nnet::network_file::FileError;
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::FrozenActor;
use vigil_policy::actor::FRAMES_SPREAD;
use vigil_world::{Family, Outcome};

/// Updates that a row of the curve sums up.
const UPDATES_PER_ROW: u64 = 500;
/// Actors that are evaluated once more at the end.
const CANDIDATES: usize = 3;
/// Seeds of the flights that choose between them.
const FIRST_CHOOSING_SEED: u64 = 300_000;
/// Seeds of the flights that test the chosen one. Nothing is chosen by these.
const FIRST_TEST_SEED: u64 = 7_000_000;
const FORMAT: &str = "vigil value checkpoint 4";

/// Why a run by value stopped early.
#[derive(Debug, thiserror::Error)]
pub enum ValueError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A flight.
    #[error(transparent)]
    Collect(#[from] CollectError),
    /// An update.
    #[error(transparent)]
    Update(#[from] UpdateError),
    /// A judging flight.
    #[error(transparent)]
    Judge(#[from] RolloutError),
    /// Networks that do not fit.
    #[error(transparent)]
    Network(#[from] ShapeError),
    /// The encoder.
    #[error(transparent)]
    Encoder(#[from] EncoderError),
    /// Checkpoint or expert.
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
    /// An actor to begin with that sees other frames.
    #[error(
        "{path} sees five frames in a row; training by value begins with an actor that it made itself, whose frames are spread"
    )]
    OtherFrames {
        /// The actor.
        path: PathBuf,
    },
    /// An actor to begin with that is told more than the one to be trained.
    #[error("{path} is told of movers, the actor to be trained is not: set told_of_movers = true")]
    ToldOfMovers {
        /// The actor.
        path: PathBuf,
    },
    /// Imitation or critics of an expert, and none was given.
    #[error(
        "the configuration asks for an expert (learning.imitation, learning.expert_critics); name one with --expert"
    )]
    NoExpert,
}

/// Where and how to run.
#[derive(Debug, Clone)]
pub struct ValueOptions {
    /// Everything goes here.
    pub folder: PathBuf,
    /// Go on from the folder's checkpoint.
    pub resume: bool,
    /// The expert's file.
    pub expert: Option<PathBuf>,
    /// An actor's file whose encoder is taken instead of teaching one.
    pub encoder_of: Option<PathBuf>,
    /// An actor's file with which training begins, encoder and all.
    pub from: Option<PathBuf>,
    /// Commit of the program, for the frozen actor's metadata.
    pub git_commit: Option<String>,
    /// Flights of each judging family, and of the validation family, that test the chosen actor.
    pub test_flights: u64,
}

/// Completion of a family.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FamilyCount {
    /// The family.
    pub family: Family,
    /// Seed of the first course.
    pub first_seed: u64,
    /// Flights.
    pub flights: usize,
    /// Those at the goal.
    pub successes: usize,
    /// Those that hit something.
    pub collisions: usize,
    /// Those that took too long.
    pub time_outs: usize,
    /// 95 % Wilson interval of the completion.
    pub wilson_95: (f64, f64),
}

impl FamilyCount {
    /// Share of the flights at the goal.
    pub fn completion(&self) -> f64 {
        self.successes as f64 / self.flights.max(1) as f64
    }
}

impl From<&FamilyCount> for FlightCount {
    fn from(count: &FamilyCount) -> Self {
        Self {
            family: count.family.to_string(),
            first_seed: count.first_seed,
            flights: count.flights,
            successes: count.successes,
            collisions: count.collisions,
            time_outs: count.time_outs,
            completion: count.completion(),
            wilson_95: count.wilson_95,
        }
    }
}

/// One row of the curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ValueRow {
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
    pub update: ValueReport,
    /// What the expert's word counts.
    pub imitation: f32,
    /// Judging flights, if there were any at this row.
    pub judged: Vec<FamilyCount>,
    /// The critics' slope against the flights' word, if it was asked for at this row.
    pub slope: Option<SlopeReport>,
}

/// An actor that may be chosen.
#[derive(Debug, Clone, PartialEq)]
struct Candidate {
    updates: u64,
    completion: f64,
    params: Vec<f32>,
    critics: Vec<Vec<f32>>,
}

#[derive(Serialize, Deserialize)]
struct RunState {
    format: String,
    config: String,
    decisions: u64,
    updates: u64,
    elapsed_s: f64,
    random_at: (u64, u64),
    actor_steps: u64,
    readout_steps: u64,
    critic_steps: Vec<u64>,
    largest_bits: u64,
    lanes: Vec<(u64, u64)>,
    moments: Vec<Vec<Moment>>,
    flyers: Vec<FlyerState>,
    rows: Vec<ValueRow>,
    sum: ValueReport,
    summed: u32,
    ended: Vec<FlightReport>,
    flights: Vec<FlightRow>,
    candidates: Vec<(u64, f64)>,
}

/// What a run came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ValueResult {
    /// What the actor sees.
    pub sees: Sees,
    /// Seed.
    pub seed: u64,
    /// Share of the training flights with the field.
    pub apf_share: f64,
    /// Steps of 0.05 s that the decisions took, at most.
    pub steps: u64,
    /// Training flights that ended.
    pub flights: usize,
    /// Decisions.
    pub decisions: u64,
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
pub enum ValueEnd {
    /// It was stopped; its checkpoint is this file.
    Interrupted(PathBuf),
    /// It is complete; this file holds the expert or the actor.
    Complete(PathBuf, Box<ValueResult>),
}

/// Something to tell while a run goes on.
#[derive(Debug, Clone, PartialEq)]
pub enum ValueProgress<'a> {
    /// The encoder learns: updates, mean squared error of the contrast.
    Encoder(u64, f32),
    /// A row of the curve: how many updates there will be.
    Row(&'a ValueRow, u64),
}

/// Trains by value, from nothing or from a checkpoint.
///
/// # Errors
/// [`ValueError`]. The folder's last good checkpoint is kept.
pub fn run_value(
    config: &ValueConfig,
    options: &ValueOptions,
    stop: &AtomicBool,
    report: &mut (dyn FnMut(ValueProgress<'_>) + Send),
) -> Result<ValueEnd, ValueError> {
    config.check()?;
    thread_pool(config.threads)?.install(|| Run::begin(config, options, report)?.complete(stop, report))
}

struct Run<'a> {
    config: &'a ValueConfig,
    options: &'a ValueOptions,
    isa: Isa,
    encoder: Option<Arc<Encoder>>,
    encoder_params: Vec<f32>,
    rng: ChaCha8Rng,
    learner: ValueLearner,
    deciding: ActorNetwork,
    memory: ValueMemory,
    flyers: Vec<Flyer>,
    decisions: u64,
    rows: Vec<ValueRow>,
    sum: ValueReport,
    summed: u32,
    ended: Vec<FlightReport>,
    /// All training flights that ended.
    flights: Vec<FlightRow>,
    candidates: Vec<Candidate>,
    begun: Instant,
    earlier_s: f64,
    checkpoint: PathBuf,
}

impl<'a> Run<'a> {
    fn begin(
        config: &'a ValueConfig,
        options: &'a ValueOptions,
        report: &mut (dyn FnMut(ValueProgress<'_>) + Send),
    ) -> Result<Self, ValueError> {
        let folder = &options.folder;
        let checkpoint = files::begin_run(folder, options.resume)?;
        let expert = options.expert.as_deref().map(Expert::load).transpose()?;
        let l = &config.learning;
        let by_expert = l.imitation > 0.0 && config.teacher == Teacher::Expert;
        if expert.is_none() && (by_expert || l.expert_critics) {
            return Err(ValueError::NoExpert);
        }
        let (isa, begun) = (Isa::detect(), Instant::now());
        let saved = options.resume.then(|| Stored::read(&checkpoint)).transpose()?;
        let encoder_len = Networks::new()?.encoder_len();
        let first = match (&saved, config.sees, &options.from) {
            (None, Sees::Pictures, Some(path)) => Some(first_actor(path, config, encoder_len)?),
            _ => None,
        };
        let encoder_params = match (&saved, config.sees, &first, &options.encoder_of) {
            (_, Sees::Truth, ..) => Vec::new(),
            (Some(saved), ..) => saved.f32("encoder", None)?,
            (None, _, Some(first), _) => first[..encoder_len].to_vec(),
            (None, _, None, Some(path)) => FrozenActor::load(path)?.params[..encoder_len].to_vec(),
            (None, _, None, None) => teach_encoder(config, isa, &mut |updates, loss| {
                report(ValueProgress::Encoder(updates, loss));
            })?,
        };
        let encoder = match config.sees {
            Sees::Truth => None,
            Sees::Pictures => Some(Arc::new(Encoder::new(isa, &encoder_params)?)),
        };
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let mut learner = ValueLearner::new(config, isa, expert.as_ref(), &mut rng)?;
        if let Some(first) = first {
            learner.actor_target.copy_from_slice(&first[encoder_len..]);
            learner.actor.copy_from_slice(&first[encoder_len..]);
        }
        let width = encoder.as_ref().map_or(0, |e| e.width());
        let mut run = Self {
            config,
            options,
            isa,
            flyers: (0..config.environments)
                .map(|i| Flyer::new(config, encoder.clone(), i))
                .collect(),
            encoder,
            encoder_params,
            rng,
            learner,
            deciding: ActorNetwork::new(config, config.environments),
            memory: ValueMemory::new(config, width),
            decisions: 0,
            rows: Vec::new(),
            sum: ValueReport::default(),
            summed: 0,
            ended: Vec::new(),
            flights: Vec::new(),
            candidates: Vec::new(),
            begun,
            earlier_s: 0.0,
            checkpoint,
        };
        if let Some(saved) = &saved {
            run.restore(saved)?;
        }
        files::replace(&folder.join("config.toml"), config.to_toml().as_bytes())?;
        Ok(run)
    }

    fn restore(&mut self, saved: &Stored) -> Result<(), ValueError> {
        let state: RunState = saved.state()?;
        let same = state.format == FORMAT
            && toml::from_str(&state.config).is_ok_and(|saved: ValueConfig| {
                let threads = self.config.threads;
                ValueConfig { threads, ..saved } == *self.config
            });
        let counts = [state.moments.len(), state.flyers.len(), self.config.environments];
        let other = || CheckpointError::Configuration {
            path: self.checkpoint.clone(),
        };
        if !same || counts.iter().any(|n| *n != counts[0]) || state.critic_steps.len() != self.learner.critics.len() {
            return Err(other().into());
        }
        for (i, (lane, moments)) in self.memory.lanes.iter_mut().zip(state.moments).enumerate() {
            lane.truths = saved.f32(&format!("truths_{i}"), None)?;
            lane.features = saved.u16(&format!("features_{i}"))?;
            lane.moments = moments;
        }
        let largest = f64::from_bits(state.largest_bits);
        if !self.memory.restore(&saved.f64("priorities")?, largest, &state.lanes) {
            return Err(CheckpointError::Configuration {
                path: self.checkpoint.clone(),
            }
            .into());
        }
        let config = self.config;
        self.flyers
            .par_iter_mut()
            .zip(&state.flyers)
            .try_for_each(|(flyer, state)| flyer.restore(config, state))?;
        let l = &mut self.learner;
        let adam = |name: &str, len: usize, steps: u64| -> Result<Adam, CheckpointError> {
            Ok(Adam {
                mean: saved.f32(&format!("{name}_mean"), Some(len))?,
                square: saved.f32(&format!("{name}_square"), Some(len))?,
                steps,
            })
        };
        let len = l.actor.len();
        l.actor = saved.f32("actor", Some(len))?;
        l.actor_target = saved.f32("actor_target", Some(len))?;
        l.actor_adam = adam("actor", len, state.actor_steps)?;
        let readout = l.readout.len();
        l.readout = saved.f32("readout", Some(readout))?;
        l.readout_adam = adam("readout", readout, state.readout_steps)?;
        for (i, (critic, steps)) in l.critics.iter_mut().zip(&state.critic_steps).enumerate() {
            let len = critic.params.len();
            critic.params = saved.f32(&format!("critic_{i}"), Some(len))?;
            critic.target = saved.f32(&format!("critic_{i}_target"), Some(len))?;
            critic.adam = adam(&format!("critic_{i}"), len, *steps)?;
        }
        l.updates = state.updates;
        for (i, (updates, completion)) in state.candidates.into_iter().enumerate() {
            let critics = (0..l.critics.len()).map(|k| saved.f32(&format!("candidate_{i}_critic_{k}"), None));
            self.candidates.push(Candidate {
                updates,
                completion,
                params: saved.f32(&format!("candidate_{i}"), Some(len))?,
                critics: critics.collect::<Result<_, _>>()?,
            });
        }
        let (high, low) = state.random_at;
        self.rng.set_word_pos(u128::from(high) << 64 | u128::from(low));
        (self.decisions, self.earlier_s) = (state.decisions, state.elapsed_s);
        (self.rows, self.sum, self.summed) = (state.rows, state.sum, state.summed);
        (self.ended, self.flights) = (state.ended, state.flights);
        self.begun = Instant::now();
        Ok(())
    }

    fn save(&self) -> Result<(), ValueError> {
        let at = self.rng.get_word_pos();
        let (priorities, largest, lanes) = self.memory.places();
        let l = &self.learner;
        let state = RunState {
            format: FORMAT.to_owned(),
            config: self.config.to_toml(),
            decisions: self.decisions,
            updates: l.updates,
            elapsed_s: self.elapsed_s(),
            random_at: ((at >> 64) as u64, at as u64),
            actor_steps: l.actor_adam.steps,
            readout_steps: l.readout_adam.steps,
            critic_steps: l.critics.iter().map(|c| c.adam.steps).collect(),
            largest_bits: largest.to_bits(),
            lanes,
            moments: self.memory.lanes.iter().map(|l| l.moments.clone()).collect(),
            flyers: self.flyers.iter().map(Flyer::state).collect(),
            rows: self.rows.clone(),
            sum: self.sum,
            summed: self.summed,
            ended: self.ended.clone(),
            flights: self.flights.clone(),
            candidates: self.candidates.iter().map(|c| (c.updates, c.completion)).collect(),
        };
        let mut tensors = vec![
            ("encoder".to_owned(), Values::F32(&self.encoder_params)),
            ("priorities".to_owned(), Values::F64(&priorities)),
            ("actor".to_owned(), Values::F32(&l.actor)),
            ("actor_target".to_owned(), Values::F32(&l.actor_target)),
            ("actor_mean".to_owned(), Values::F32(&l.actor_adam.mean)),
            ("actor_square".to_owned(), Values::F32(&l.actor_adam.square)),
            ("readout".to_owned(), Values::F32(&l.readout)),
            ("readout_mean".to_owned(), Values::F32(&l.readout_adam.mean)),
            ("readout_square".to_owned(), Values::F32(&l.readout_adam.square)),
        ];
        for (i, critic) in l.critics.iter().enumerate() {
            tensors.extend([
                (format!("critic_{i}"), Values::F32(&critic.params)),
                (format!("critic_{i}_target"), Values::F32(&critic.target)),
                (format!("critic_{i}_mean"), Values::F32(&critic.adam.mean)),
                (format!("critic_{i}_square"), Values::F32(&critic.adam.square)),
            ]);
        }
        for (i, lane) in self.memory.lanes.iter().enumerate() {
            tensors.push((format!("truths_{i}"), Values::F32(&lane.truths)));
            tensors.push((format!("features_{i}"), Values::U16(&lane.features)));
        }
        for (i, candidate) in self.candidates.iter().enumerate() {
            tensors.push((format!("candidate_{i}"), Values::F32(&candidate.params)));
            for (k, critic) in candidate.critics.iter().enumerate() {
                tensors.push((format!("candidate_{i}_critic_{k}"), Values::F32(critic)));
            }
        }
        Ok(save(&self.checkpoint, &state, &tensors)?)
    }

    fn elapsed_s(&self) -> f64 {
        self.earlier_s + self.begun.elapsed().as_secs_f64()
    }

    fn complete(
        mut self,
        stop: &AtomicBool,
        report: &mut (dyn FnMut(ValueProgress<'_>) + Send),
    ) -> Result<ValueEnd, ValueError> {
        loop {
            while self.learner.updates < self.config.updates_due(self.decisions) {
                if stop.load(Ordering::Relaxed) {
                    self.save()?;
                    return Ok(ValueEnd::Interrupted(self.checkpoint));
                }
                self.update(report)?;
            }
            if self.decisions >= self.config.decisions {
                break;
            }
            if stop.load(Ordering::Relaxed) {
                self.save()?;
                return Ok(ValueEnd::Interrupted(self.checkpoint));
            }
            self.collect()?;
        }
        self.save()?;
        self.freeze()
    }

    /// One decision in every environment.
    fn collect(&mut self) -> Result<(), ValueError> {
        let (config, warm_up) = (self.config, self.decisions < self.config.warm_up);
        let by_noise = warm_up && !config.warm_up_by_actor;
        self.flyers
            .par_iter_mut()
            .zip(&self.memory.lanes)
            .try_for_each(|(flyer, lane)| flyer.begin(config, lane, warm_up))?;
        let mut pre = vec![0.0; 2 * self.flyers.len()];
        if !by_noise {
            let views: Vec<Row<'_>> = self
                .flyers
                .iter()
                .zip(&self.memory.lanes)
                .filter_map(|(flyer, lane)| Some((flyer.view(lane)?, false)))
                .collect();
            self.deciding.forward(self.isa, &self.learner.actor, &views, &mut pre)?;
        }
        let sigma = sigma(config, self.decisions);
        let reports = self
            .flyers
            .par_iter_mut()
            .zip(&mut self.memory.lanes)
            .zip(pre.par_chunks_exact(2))
            .map(|((flyer, lane), pre)| flyer.fly(config, (!by_noise).then(|| [pre[0], pre[1]]), sigma, lane))
            .collect::<Result<Vec<_>, CollectError>>()?;
        let updates = self.learner.updates;
        for flight in reports.into_iter().flatten() {
            self.flights.push(FlightRow { updates, flight });
            self.ended.push(flight);
        }
        self.memory.settle();
        self.decisions += config.environments as u64;
        Ok(())
    }

    fn update(&mut self, report: &mut (dyn FnMut(ValueProgress<'_>) + Send)) -> Result<(), ValueError> {
        let batch = self.memory.sample(self.config.learning.batch, &mut self.rng);
        let (update, errors) = self.learner.update(&batch, &mut self.rng)?;
        for (leaf, error) in errors {
            self.memory.set_error(leaf, error);
        }
        self.sum = self.sum.plus(&update);
        self.summed += 1;
        let updates = self.learner.updates;
        let judged = updates.is_multiple_of(self.config.evaluation.every_updates);
        if !judged && !updates.is_multiple_of(UPDATES_PER_ROW) {
            return Ok(());
        }
        let ended = core::mem::take(&mut self.ended);
        let mut row = ValueRow {
            updates,
            decisions: self.decisions,
            elapsed_s: self.elapsed_s(),
            flights: ended.len(),
            successes: ended.iter().filter(|f| f.outcome == Some(Outcome::Success)).count(),
            reward: ended.iter().map(|f| f.reward).sum::<f32>() / ended.len().max(1) as f32,
            update: self.sum.scaled(1.0 / self.summed as f32),
            imitation: self.learner.imitation(),
            judged: Vec::new(),
            slope: None,
        };
        (self.sum, self.summed) = (ValueReport::default(), 0);
        if judged {
            let e = &self.config.evaluation;
            let params = self.learner.frozen().to_vec();
            for family in &e.families {
                row.judged
                    .push(self.evaluate(&params, *family, e.first_seed, e.flights)?);
            }
            let (config, isa, encoder) = (self.config, self.isa, self.encoder.clone());
            let make = || Chooser::new(config, isa, &params, encoder.clone());
            row.slope = Some(slope_against_truth(config, &mut self.learner, &make)?);
            let mean = row.judged.iter().map(FamilyCount::completion).sum::<f64>() / row.judged.len().max(1) as f64;
            self.consider(updates, mean);
        }
        self.rows.push(row);
        let folder = &self.options.folder;
        files::replace(&folder.join("curves.csv"), csv(&self.rows).as_bytes())?;
        files::replace(&folder.join("flights.csv"), flights_csv(&self.flights).as_bytes())?;
        if judged {
            self.save()?;
        }
        if let Some(row) = self.rows.last() {
            report(ValueProgress::Row(row, self.config.updates_due(self.config.decisions)));
        }
        Ok(())
    }

    /// Keeps the actor if it is among the best; of equals the later.
    fn consider(&mut self, updates: u64, completion: f64) {
        self.candidates.push(Candidate {
            updates,
            completion,
            params: self.learner.frozen().to_vec(),
            critics: self.learner.critics.iter().map(|c| c.target.clone()).collect(),
        });
        self.candidates
            .sort_by(|a, b| b.completion.total_cmp(&a.completion).then(b.updates.cmp(&a.updates)));
        self.candidates.truncate(CANDIDATES);
    }

    /// The whole actor's parameters: the encoder's, then those behind it.
    fn whole(&self, params: &[f32]) -> Vec<f32> {
        [self.encoder_params.as_slice(), params].concat()
    }

    fn evaluate(
        &self,
        params: &[f32],
        family: Family,
        first_seed: u64,
        flights: u64,
    ) -> Result<FamilyCount, ValueError> {
        let config = self.config;
        let outcomes = match config.sees {
            Sees::Truth => {
                let make = || Chooser::new(config, self.isa, params, None);
                fly_chooser(config, &make, family, first_seed, flights)?
            }
            Sees::Pictures => {
                let what = EvaluationSpec {
                    family,
                    first_seed,
                    flights,
                    time_limit_s: config.evaluation.time_limit_s,
                    field: false,
                };
                let whole = self.whole(params);
                evaluate(EvaluatedActor::Actor(&whole, config.inputs()), self.isa, &what)?.flights
            }
        };
        let count = |outcome| outcomes.iter().filter(|(o, _)| *o == outcome).count();
        let successes = count(Outcome::Success);
        Ok(FamilyCount {
            family,
            first_seed,
            flights: outcomes.len(),
            successes,
            collisions: count(Outcome::Collision),
            time_outs: count(Outcome::TimeOut),
            wilson_95: wilson_95(successes, outcomes.len()),
        })
    }

    /// Judges the best once more over other courses, writes the one that flies best, and tests that one.
    fn freeze(mut self) -> Result<ValueEnd, ValueError> {
        if self.candidates.is_empty() {
            self.consider(self.learner.updates, 0.0);
        }
        let elapsed_s = self.elapsed_s();
        let e = &self.config.evaluation;
        let mut best: Option<(usize, &Candidate)> = None;
        for candidate in &self.candidates {
            let mut successes = 0;
            for family in &e.families {
                let flights = 2 * e.flights;
                successes += self
                    .evaluate(&candidate.params, *family, FIRST_CHOOSING_SEED, flights)?
                    .successes;
            }
            if best.is_none_or(|(most, _)| successes > most) {
                best = Some((successes, candidate));
            }
        }
        let Some((_, chosen)) = best else {
            return Ok(ValueEnd::Interrupted(self.checkpoint));
        };
        let folder = &self.options.folder;
        let path = self.write(chosen, folder)?;
        let mut families = e.families.clone();
        for family in [Family::Validation, Family::Dense, Family::Hard] {
            if !families.contains(&family) {
                families.push(family);
            }
        }
        let test = families
            .into_iter()
            .filter(|_| self.options.test_flights > 0)
            .map(|family| self.evaluate(&chosen.params, family, FIRST_TEST_SEED, self.options.test_flights))
            .collect::<Result<_, _>>()?;
        let result = ValueResult {
            sees: self.config.sees,
            seed: self.config.seed,
            apf_share: self.config.apf_share,
            steps: self.decisions * self.config.steps_per_decision as u64,
            flights: self.flights.len(),
            decisions: self.decisions,
            updates: self.learner.updates,
            frozen_after: chosen.updates,
            elapsed_s,
            test,
        };
        let text = serde_json::to_vec_pretty(&result).unwrap_or_default();
        files::replace(&folder.join("result.json"), &text)?;
        Ok(ValueEnd::Complete(path, Box::new(result)))
    }

    fn write(&self, chosen: &Candidate, folder: &Path) -> Result<PathBuf, ValueError> {
        let config = self.config.to_toml();
        match self.config.sees {
            Sees::Truth => {
                let path = folder.join("expert.safetensors");
                let expert = Expert {
                    actor: chosen.params.clone(),
                    critics: chosen.critics.clone(),
                    ..self.learner.as_expert()
                };
                expert.save(&path, &config, chosen.updates)?;
                Ok(path)
            }
            Sees::Pictures => {
                let path = folder.join("actor.safetensors");
                let actor = FrozenActor {
                    params: self.whole(&chosen.params),
                    inputs: self.config.inputs(),
                    training_config: config,
                    seed: self.config.seed,
                    updates: chosen.updates,
                    git_commit: self.options.git_commit.clone(),
                };
                actor.save(&path)?;
                Ok(path)
            }
        }
    }
}

/// The parameters of an actor that training begins with.
fn first_actor(path: &Path, config: &ValueConfig, encoder_len: usize) -> Result<Vec<f32>, ValueError> {
    let first = FrozenActor::load(path)?;
    let path = path.to_owned();
    if first.inputs.frame_ages != FRAMES_SPREAD {
        return Err(ValueError::OtherFrames { path });
    }
    match (first.inputs.told_of_movers, config.told_of_movers) {
        (true, false) => Err(ValueError::ToldOfMovers { path }),
        (false, true) => {
            let (encoder, behind) = first.params.split_at(encoder_len);
            let behind = told_of_movers(behind, &mut ChaCha8Rng::seed_from_u64(config.seed));
            Ok([encoder, &behind].concat())
        }
        _ => Ok(first.params),
    }
}

fn sigma(config: &ValueConfig, decisions: u64) -> f32 {
    let n = &config.noise;
    let own = decisions.saturating_sub(config.warm_up) as f32;
    let all = config.decisions.saturating_sub(config.warm_up).max(1) as f32;
    let done = (own / (all * n.falls_over)).min(1.0);
    n.sigma_first + (n.sigma_last - n.sigma_first) * done
}

/// The curve as comma-separated values.
pub fn csv(rows: &[ValueRow]) -> String {
    let families = rows
        .iter()
        .find(|r| !r.judged.is_empty())
        .map_or(&[][..], |r| &r.judged);
    let names: String = families.iter().map(|c| format!(",{}", c.family)).collect();
    let mut text = format!(
        "updates,decisions,elapsed_s,flights,successes,reward,critic_loss,value,imitation_loss,imitation,saturated,motion_loss,critic_norm,\
         actor_norm,value_correlation,slope_correlation,sign_agreement{names}\n"
    );
    for r in rows {
        let (u, s) = (&r.update, r.slope.as_ref());
        let slope = s.map_or(",,".to_owned(), |s| {
            format!(
                "{:.3},{:.3},{:.3}",
                s.value_correlation, s.slope_correlation, s.sign_agreement
            )
        });
        let judged: String = match r.judged.is_empty() {
            true => ",".repeat(families.len()),
            false => r.judged.iter().map(|c| format!(",{:.4}", c.completion())).collect(),
        };
        text += &format!(
            "{},{},{:.1},{},{},{:.4},{:.5},{:.4},{:.4},{:.4},{:.4},{:.5},{:.4},{:.5},{slope}{judged}\n",
            r.updates,
            r.decisions,
            r.elapsed_s,
            r.flights,
            r.successes,
            r.reward,
            u.critic_loss,
            u.value,
            u.imitation_loss,
            r.imitation,
            u.saturated,
            u.motion_loss,
            u.critic_norm,
            u.actor_norm,
        );
    }
    text
}
