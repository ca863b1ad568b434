//! The run: fly, learn, judge, keep, round by round.

use super::bounded_learner::{BoundedLearner, BoundedReport};
use super::kept_flights::{KeptFlights, Pair};
use super::robust_config::RobustConfig;
use crate::actor_training::checkpoint::CheckpointError;
use crate::actor_training::collector::CollectError;
use crate::actor_training::config::ConfigError;
use crate::actor_training::evaluation::{EvaluatedActor, EvaluationSpec, RolloutError, evaluate};
use crate::actor_training::files::{self, FolderError, WriteError};
use crate::actor_training::learner::UpdateError;
use crate::actor_training::result::FlightCount;
use crate::actor_training::value::store::{Stored, Values, save};
use crate::report::to_csv;
use crate::threads::{ThreadsError, thread_pool};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use vigil_nnet::network_file::FileError;
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::FrozenActor;
use vigil_world::Family;

/// Updates that a row of the curve sums up.
const UPDATES_PER_ROW: u64 = 250;
/// Seeds of the flights that follow the run's course.
const FIRST_JUDGING_SEED: u64 = 300_000;
/// Seeds of the flights that test its end. Nothing is chosen by these.
const FIRST_TEST_SEED: u64 = 7_000_000;
const FORMAT: &str = "vigil robust checkpoint 1";
/// Streams of the batches' draws, apart from those of the flights.
const STREAM: u64 = 1 << 40;

/// Why a run stopped early.
#[derive(Debug, thiserror::Error)]
pub enum RobustError {
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
    /// The checkpoint.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// A checkpoint of another run.
    #[error("{path} is of another configuration, actor or version: resume with that, or train in another folder")]
    OtherRun {
        /// The checkpoint.
        path: PathBuf,
    },
    /// Curves.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The actor.
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
pub struct RobustOptions {
    /// Everything goes here.
    pub folder: PathBuf,
    /// Go on from the folder's checkpoint.
    pub resume: bool,
    /// The actor to harden, which teaches.
    pub actor: FrozenActor,
    /// Commit of this program, if known.
    pub git_commit: Option<String>,
    /// Flights of each family that test the end.
    pub test_flights: u64,
}

/// A row of the curve: means over its updates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobustRow {
    /// Updates made.
    pub updates: u64,
    /// Time spent, seconds, interruptions left out.
    pub elapsed_s: f64,
    /// ε of the last update, in 255ths of 100 m.
    pub epsilon_255: f32,
    /// Squared distance of the decision from the teacher's.
    pub decision_loss: f32,
    /// Weighted squared distance of the bounds' ends.
    pub bounds_loss: f32,
    /// Share of the states whose yaw is proved to move by less than 1.0 within ε.
    pub certified: f32,
    /// Length of the gradient.
    pub norm: f32,
    /// Completion of validation and hard courses, at the end of a round.
    pub validation: Option<f64>,
    /// See above.
    pub hard: Option<f64>,
}

/// What a run came to: `result.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobustResult {
    /// Its seed.
    pub seed: u64,
    /// The actor that was hardened.
    pub teacher_sha256: String,
    /// Updates.
    pub updates: u64,
    /// Time spent, seconds, interruptions left out.
    pub elapsed_s: f64,
    /// The flights that tested it.
    pub test: Vec<FlightCount>,
}

/// How a run ended.
#[derive(Debug)]
pub enum RobustEnd {
    /// The actor's file, and what it came to.
    Complete(PathBuf, Box<RobustResult>),
    /// Stopped; the checkpoint to go on from, if a round was completed.
    Interrupted(PathBuf),
}

#[derive(Serialize, Deserialize)]
struct State {
    format: String,
    config: String,
    teacher_sha256: String,
    rounds: u64,
    optimiser_steps: u64,
    elapsed_s: f64,
    rows: Vec<RobustRow>,
}

/// Trains.
///
/// # Errors
/// [`RobustError`].
pub fn run_robust(
    config: &RobustConfig,
    options: &RobustOptions,
    stop: &AtomicBool,
    report: &mut (dyn FnMut(&RobustRow, u64) + Send),
) -> Result<RobustEnd, RobustError> {
    config.check()?;
    let checkpoint = files::begin_run(&options.folder, options.resume)?;
    files::replace(&options.folder.join("config.toml"), config.to_toml().as_bytes())?;
    thread_pool(config.threads)?.install(|| rounds(config, options, &checkpoint, stop, report))
}

fn rounds(
    config: &RobustConfig,
    options: &RobustOptions,
    checkpoint: &Path,
    stop: &AtomicBool,
    report: &mut (dyn FnMut(&RobustRow, u64) + Send),
) -> Result<RobustEnd, RobustError> {
    let teacher = &options.actor;
    let mut learner = BoundedLearner::new(teacher.inputs.spec(), teacher.params.clone())?;
    let mut state = State {
        format: FORMAT.to_owned(),
        config: config.to_toml(),
        teacher_sha256: teacher.sha256(),
        rounds: 0,
        optimiser_steps: 0,
        elapsed_s: 0.0,
        rows: Vec::new(),
    };
    if options.resume && checkpoint.exists() {
        state = restore(checkpoint, &state, &mut learner)?;
    }
    let begun = Instant::now();
    let before_s = state.elapsed_s;
    let elapsed_s = || before_s + begun.elapsed().as_secs_f64();
    while state.rounds < config.rounds {
        let pair = Pair {
            student: &learner.params,
            teacher: &teacher.params,
            inputs: teacher.inputs,
        };
        let states = KeptFlights::fly(config, state.rounds, pair)?;
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        rng.set_stream(STREAM + state.rounds);
        let mut sum = Vec::with_capacity(UPDATES_PER_ROW as usize);
        for update in state.rounds * config.updates..(state.rounds + 1) * config.updates {
            if stop.load(Ordering::Relaxed) {
                return Ok(RobustEnd::Interrupted(checkpoint.to_owned()));
            }
            sum.push(learner.update(config, update, &states, &mut rng)?);
            let last = update + 1 == (state.rounds + 1) * config.updates;
            if last || (update + 1).is_multiple_of(UPDATES_PER_ROW) {
                let mut row = row_of(config, update + 1, elapsed_s(), &sum);
                sum.clear();
                if last && config.evaluation_flights > 0 {
                    let judge = |family| {
                        judged(
                            teacher,
                            &learner.params,
                            family,
                            FIRST_JUDGING_SEED,
                            config.evaluation_flights,
                        )
                        .map(|count| Some(count.completion))
                    };
                    (row.validation, row.hard) = (judge(Family::Validation)?, judge(Family::Hard)?);
                }
                report(&row, config.all_updates());
                state.rows.push(row);
            }
        }
        state.rounds += 1;
        state.optimiser_steps = learner.adam.steps;
        state.elapsed_s = elapsed_s();
        let tensors = [
            ("actor".to_owned(), Values::F32(&learner.params)),
            ("mean".to_owned(), Values::F32(&learner.adam.mean)),
            ("square".to_owned(), Values::F32(&learner.adam.square)),
        ];
        save(checkpoint, &state, &tensors)?;
        files::replace(&options.folder.join("curves.csv"), to_csv(&state.rows).as_bytes())?;
    }
    let path = options.folder.join("actor.safetensors");
    let actor = FrozenActor {
        params: learner.params.clone(),
        training_config: config.to_toml(),
        seed: config.seed,
        updates: config.all_updates(),
        git_commit: options.git_commit.clone(),
        ..teacher.clone()
    };
    actor.save(&path)?;
    let test = [Family::Validation, Family::Hard, Family::Dense]
        .into_iter()
        .filter(|_| options.test_flights > 0)
        .map(|family| judged(teacher, &learner.params, family, FIRST_TEST_SEED, options.test_flights))
        .collect::<Result<_, _>>()?;
    let result = RobustResult {
        seed: config.seed,
        teacher_sha256: state.teacher_sha256,
        updates: config.all_updates(),
        elapsed_s: state.elapsed_s,
        test,
    };
    let text = serde_json::to_vec_pretty(&result).unwrap_or_default();
    files::replace(&options.folder.join("result.json"), &text)?;
    Ok(RobustEnd::Complete(path, Box::new(result)))
}

fn restore(checkpoint: &Path, expected: &State, learner: &mut BoundedLearner) -> Result<State, RobustError> {
    let file = Stored::read(checkpoint)?;
    let state: State = file.state()?;
    let same = |of: fn(&State) -> &String| of(&state) == of(expected);
    if !(same(|s| &s.format) && same(|s| &s.config) && same(|s| &s.teacher_sha256)) {
        return Err(RobustError::OtherRun {
            path: checkpoint.to_owned(),
        });
    }
    let len = Some(learner.params.len());
    learner.params = file.f32("actor", len)?;
    learner.adam.mean = file.f32("mean", len)?;
    learner.adam.square = file.f32("square", len)?;
    learner.adam.steps = state.optimiser_steps;
    Ok(state)
}

fn row_of(config: &RobustConfig, updates: u64, elapsed_s: f64, reports: &[BoundedReport]) -> RobustRow {
    let mean = |of: fn(&BoundedReport) -> f32| reports.iter().map(of).sum::<f32>() / reports.len().max(1) as f32;
    RobustRow {
        updates,
        elapsed_s,
        epsilon_255: 255.0 * config.epsilon_at(updates.saturating_sub(1)),
        decision_loss: mean(|r| r.decision_loss),
        bounds_loss: mean(|r| r.bounds_loss),
        certified: mean(|r| r.certified),
        norm: mean(|r| r.norm),
        validation: None,
        hard: None,
    }
}

fn judged(
    teacher: &FrozenActor,
    params: &[f32],
    family: Family,
    first_seed: u64,
    flights: u64,
) -> Result<FlightCount, RolloutError> {
    let what = EvaluationSpec {
        family,
        first_seed,
        flights,
        time_limit_s: 90.0,
        field: false,
    };
    let result = evaluate(EvaluatedActor::Actor(params, teacher.inputs), Isa::detect(), &what)?;
    Ok(FlightCount::new(&what, &result))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(folder: &Path, resume: bool) -> RobustOptions {
        RobustOptions {
            folder: folder.to_owned(),
            resume,
            actor: FrozenActor::built_in().unwrap(),
            git_commit: None,
            test_flights: 0,
        }
    }

    /// Stopped in its second round, a run goes on from the first one's end and ends with the same actor; it
    /// does not go on with another configuration, and does not begin in another run's folder.
    #[test]
    fn a_run_that_was_interrupted_ends_as_one_that_was_not() {
        let config = RobustConfig {
            rounds: 2,
            states: 16,
            updates: 3,
            batch: 3,
            evaluation_flights: 0,
            ..RobustConfig::default()
        };
        let scratch = tempfile::tempdir().unwrap();
        let (whole, parts) = (scratch.path().join("whole"), scratch.path().join("parts"));
        let (stop, never) = (AtomicBool::new(false), AtomicBool::new(false));
        let end = run_robust(&config, &options(&whole, false), &never, &mut |_, _| {}).unwrap();
        assert!(matches!(end, RobustEnd::Complete(..)), "{end:?}");
        let end = run_robust(&config, &options(&parts, false), &stop, &mut |row, _| {
            stop.store(row.updates == config.updates, Ordering::Relaxed);
        });
        assert!(matches!(end.unwrap(), RobustEnd::Interrupted(_)));

        let other = RobustConfig {
            rate: 1e-4,
            ..config.clone()
        };
        let refused = run_robust(&other, &options(&parts, true), &never, &mut |_, _| {});
        assert!(matches!(refused, Err(RobustError::OtherRun { .. })));
        let refused = run_robust(&config, &options(&parts, false), &never, &mut |_, _| {});
        assert!(matches!(
            refused,
            Err(RobustError::Folder(FolderError::Occupied { .. }))
        ));

        let resumed = run_robust(&config, &options(&parts, true), &never, &mut |_, _| {}).unwrap();
        assert!(matches!(resumed, RobustEnd::Complete(..)));
        let params = |folder: &Path| FrozenActor::load(&folder.join("actor.safetensors")).unwrap().params;
        assert_eq!(params(&whole), params(&parts));
        assert_ne!(params(&whole), options(&whole, false).actor.params);
    }
}
