//! Flights stepped side by side for `vigil.gym`.

use crate::given::{POSITION, array, failed, refused};
use numpy::{PyArray1, PyArray3, PyArrayMethods, PyReadonlyArrayDyn, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use vigil_lab::trainer::config::{Along, RewardConfig};
use vigil_lab::trainer::reward::{DecisionResult, reward};
use vigil_lab::trainer::worker::seen_from;
use vigil_sim::environment::Environment;
use vigil_sim::environment::true_state::{TRUE_STATE, TrueCourse};
use vigil_sim::vehicle::{VehicleParams, Wind};
use vigil_sim::world::{Course, Family, FlightPath, Lidar, LidarConfig, Outcome, generate};
use vigil_tools::explained::Flight;
use vigil_tools::threads::thread_pool;
use vigil_types::{ACTION_LIMIT, Action, DEPTH_FULL_SCALE_M, NedVector};

/// Steps between two points of a drawn path.
const PATH_STRIDE: usize = 4;
/// The goal's distance that is 1 in a normalised observation, as the networks take it.
const GOAL_SCALE_M: f32 = 20.0;

/// What an environment of `vigil.gym` is given.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Options {
    family: String,
    /// A file, flown instead of generated courses.
    course: Option<PathBuf>,
    wind: f64,
    noise: f32,
    time_limit: Option<f32>,
    success: f32,
    dead: f32,
    decision: f32,
    checkpoint: f32,
    near: f32,
    along_way: bool,
    /// The true state is given.
    privileged: bool,
    /// Actions and what is observed are within ±1.
    normalized: bool,
    frames: usize,
    every: usize,
}

/// What all flights have in common.
struct Conditions {
    course: Option<Course>,
    family: Family,
    weights: RewardConfig,
    options: Options,
}

/// Range noise and dropouts, so many times as much.
pub fn noisier(lidar: &mut LidarConfig, factor: f32) {
    lidar.range_noise_sigma_m *= factor;
    lidar.dropout_probability = (lidar.dropout_probability * factor).min(1.0);
}

/// A flight's wind of this mean.
pub fn wind(mean_m_s: f64, seed: u64) -> Wind {
    match mean_m_s > 0.0 {
        true => vigil_tools::campaign::wind(mean_m_s, seed),
        false => Wind::default(),
    }
}

/// A flight that has begun.
struct Begun {
    course: Course,
    flight: Flight,
    truth: Option<TrueCourse>,
    left_m: f32,
    steps: usize,
    path_ned_m: Vec<NedVector>,
    outcome: Option<Outcome>,
}

impl Conditions {
    fn begin(&self, seed: u64) -> Result<Begun, String> {
        let mut course = match &self.course {
            Some(course) => course.clone(),
            None => generate(self.family, seed),
        };
        course.time_limit_s = self.options.time_limit.unwrap_or(course.time_limit_s);
        let wind = wind(self.options.wind, seed);
        let environment = Environment::unseen(&course, VehicleParams::default(), wind, seed);
        let flight = Flight::of(environment.map_err(|e| e.to_string())?);
        let truth = (self.weights.along == Along::Path || self.options.privileged).then(|| TrueCourse::new(&course));
        let mut begun = Begun {
            path_ned_m: vec![flight.truth().position_ned_m],
            course,
            flight,
            truth,
            left_m: 0.0,
            steps: 0,
            outcome: None,
        };
        begun.left_m = begun.left_m(self.weights.along);
        Ok(begun)
    }
}

impl Begun {
    /// What is left of the way, metres.
    fn left_m(&self, along: Along) -> f32 {
        match &self.truth {
            Some(course) if along == Along::Path => course.path_m(self.flight.truth().position_ned_m),
            _ => self.flight.goal_distance_m(),
        }
    }

    fn step(&mut self, conditions: &Conditions, action: Action) -> f32 {
        let before = self.flight.checkpoints().0;
        self.outcome = self.flight.advance_unseen(action);
        let left_m = self.left_m(conditions.weights.along);
        let (checkpoints, all_checkpoints) = self.flight.checkpoints();
        let result = DecisionResult {
            progress_m: self.left_m - left_m,
            checkpoints_before: before,
            checkpoints,
            all_checkpoints,
            obstacle_distance_m: match conditions.weights.near {
                0.0 => f32::INFINITY,
                _ => self.flight.obstacle_distance_m(),
            },
            outcome: self.outcome,
        };
        self.left_m = left_m;
        self.steps += 1;
        if self.steps.is_multiple_of(PATH_STRIDE) || self.outcome.is_some() {
            self.path_ned_m.push(self.flight.truth().position_ned_m);
        }
        reward(&conditions.weights, &result)
    }

    /// Goal, odometry and time as a pilot is given them.
    fn position(&self) -> [f32; POSITION] {
        let input = self.flight.input();
        let here = self.flight.estimate().position_ned_m;
        [
            input.goal.distance_m,
            input.goal.bearing_rad,
            here.x,
            here.y,
            input.height_m,
            input.attitude.yaw_rad(),
            input.velocity_m_s.x,
            input.velocity_m_s.y,
            (input.now_ns as f64 * 1e-9) as f32,
        ]
    }

    fn true_state(&self) -> [f32; TRUE_STATE] {
        let truth = self.flight.truth();
        let goal = seen_from(self.flight.goal().position_ned_m, &truth);
        self.truth
            .as_ref()
            .map_or([0.0; TRUE_STATE], |course| course.state(&truth, goal))
    }
}

type Given<'py> = PyReadwriteArrayDyn<'py, f32>;

/// What a call has of one flight: what is asked of it, and its part of the caller's arrays.
struct Row<'a> {
    flight: &'a mut Option<Box<Begun>>,
    seed: Option<u64>,
    action: Option<&'a [f32]>,
    older: Option<&'a [f32]>,
    frames: &'a mut [f32],
    goal: &'a mut [f32],
    position: Option<&'a mut [f32]>,
    state: Option<&'a mut [f32]>,
    reward: &'a mut f32,
    /// How the flight ended, as its place in [`Outcome`]; −1: it goes on.
    end: &'a mut i8,
}

impl Row<'_> {
    /// Begins a flight, flies a step of it, or leaves it as it is; writes all that is observed.
    fn advance(&mut self, conditions: &Conditions, lidar: &Mutex<Lidar>) -> Result<(), String> {
        let normalized = conditions.options.normalized;
        let scale = if normalized { 1.0 } else { DEPTH_FULL_SCALE_M };
        // A sensor holds nothing of the last picture, so that one a panic has left can be used again.
        let mut lidar = lidar.lock().unwrap_or_else(PoisonError::into_inner);
        let (pixels, len) = (lidar.shape().iter().product(), self.frames.len());
        if let Some(seed) = self.seed {
            let begun = self.flight.insert(Box::new(conditions.begin(seed)?));
            begun
                .flight
                .look_through(&mut lidar, scale, &mut self.frames[len - pixels..]);
            for older in (0..len - pixels).step_by(pixels) {
                self.frames.copy_within(len - pixels.., older);
            }
            if self.action.is_some() {
                (*self.reward, *self.end) = (0.0, -1);
            }
        } else if let (Some(begun), Some(action)) = (self.flight.as_mut(), self.action) {
            let unit = if normalized { ACTION_LIMIT } else { 1.0 };
            let action = Action::new(action[0] * unit, action[1] * unit).clipped();
            *self.reward = begun.step(conditions, action);
            *self.end = begun.outcome.map_or(-1, |outcome| outcome as i8);
            match self.older {
                Some(older) => self.frames[..len - pixels].copy_from_slice(&older[pixels..]),
                None => self.frames.copy_within(pixels.., 0),
            }
            // The state in which a flight is cut off still counts.
            if matches!(begun.outcome, None | Some(Outcome::TimeOut)) {
                begun
                    .flight
                    .look_through(&mut lidar, scale, &mut self.frames[len - pixels..]);
            } else if let Some(older) = self.older {
                self.frames[len - pixels..].copy_from_slice(&older[len - pixels..]);
            }
        } else if let Some(older) = self.older {
            self.frames.copy_from_slice(older);
        }
        drop(lidar);
        let Some(begun) = self.flight else { return Ok(()) };
        let goal = begun.flight.goal_relative();
        self.goal.copy_from_slice(&match normalized {
            true => {
                [goal.distance_m / GOAL_SCALE_M, goal.bearing_rad / std::f32::consts::PI].map(|x| x.clamp(-1.0, 1.0))
            }
            false => [goal.distance_m, goal.bearing_rad],
        });
        if let Some(position) = &mut self.position {
            position.copy_from_slice(&begun.position());
        }
        if let Some(state) = &mut self.state {
            state.copy_from_slice(&begun.true_state());
        }
        Ok(())
    }
}

/// All values of an array, if it was given.
fn whole<'a>(array: &'a Option<PyReadonlyArrayDyn<'_, f32>>) -> PyResult<Option<&'a [f32]>> {
    array
        .as_ref()
        .map(|array| array.as_slice())
        .transpose()
        .map_err(refused)
}

/// An array that was given, in parts of `len` values.
fn parts<'a>(array: &'a mut Option<Given<'_>>, len: usize) -> PyResult<Option<std::slice::ChunksExactMut<'a, f32>>> {
    let slices = array.as_mut().map(|array| array.as_slice_mut());
    Ok(slices
        .transpose()
        .map_err(refused)?
        .map(|all| all.chunks_exact_mut(len)))
}

/// Several flights at once. They share nothing but the LiDARs, one a thread, that look for one after another; the same seeds and actions give
/// the same bits on any number of threads.
#[pyclass(module = "vigil._vigil")]
pub struct Flights {
    conditions: Conditions,
    flights: Vec<Option<Box<Begun>>>,
    lidars: Vec<Mutex<Lidar>>,
    pool: Option<rayon::ThreadPool>,
    /// The process that has the threads: not the one that forked off.
    process: u32,
    shape: [usize; 4],
}

#[pymethods]
impl Flights {
    #[new]
    fn new(count: usize, options: Options, threads: usize) -> PyResult<Self> {
        let mut lidar = LidarConfig::default();
        noisier(&mut lidar, options.noise);
        let threads = threads.min(count);
        let sensor = || Ok(Mutex::new(Lidar::new(lidar, 0).map_err(refused)?.every(options.every)));
        let lidars = (0..threads).map(|_| sensor()).collect::<PyResult<Vec<_>>>()?;
        let [rows, columns] = Lidar::shape_of(options.every);
        let shape = [count, options.frames, rows, columns];
        let pool = (threads > 1)
            .then(|| thread_pool(threads))
            .transpose()
            .map_err(failed)?;
        let course = options.course.as_deref().map(Course::load);
        Ok(Self {
            conditions: Conditions {
                course: course.transpose().map_err(refused)?,
                family: options.family.parse().map_err(refused)?,
                weights: RewardConfig {
                    along: if options.along_way { Along::Path } else { Along::Line },
                    success: options.success,
                    dead: options.dead,
                    decision: options.decision,
                    checkpoint: options.checkpoint,
                    near: options.near,
                },
                options,
            },
            flights: (0..count).map(|_| None).collect(),
            lidars,
            pool,
            process: std::process::id(),
            shape,
        })
    }

    /// Begins the flights that have a seed; flies one step of 50 ms of the others where there are actions. Writes into the caller's arrays what is
    /// observed of all, and, where there are actions, rewards and how flights ended (−1: not). `older`: the frames of the last call, where
    /// `frames` does not hold them.
    #[pyo3(signature = (seeds, actions, older, frames, goals, positions, states, rewards, ends))]
    #[allow(clippy::too_many_arguments, reason = "the caller's arrays")]
    fn advance(
        &mut self,
        py: Python<'_>,
        seeds: Vec<Option<u64>>,
        actions: Option<PyReadonlyArrayDyn<'_, f32>>,
        older: Option<PyReadonlyArrayDyn<'_, f32>>,
        mut frames: Given<'_>,
        mut goals: Given<'_>,
        mut positions: Option<Given<'_>>,
        mut states: Option<Given<'_>>,
        mut rewards: Given<'_>,
        mut ends: PyReadwriteArrayDyn<'_, i8>,
    ) -> PyResult<()> {
        if self.pool.is_some() && self.process != std::process::id() {
            return Err(refused(
                "these flights' threads stayed in the process that made them: make the environment after the fork, or with \
                 threads=1",
            ));
        }
        let count = self.flights.len();
        let deep = self.shape[1..].iter().product();
        let (older, actions) = (whole(&older)?, whole(&actions)?);
        if frames.shape() != self.shape || older.is_some_and(|older| older.len() != count * deep) {
            return Err(refused(format!(
                "frames: expected shape {:?}, got {:?}",
                self.shape,
                frames.shape()
            )));
        }
        for (number, (flight, seed)) in self.flights.iter().zip(&seeds).enumerate() {
            if actions.is_some() && seed.is_none() && flight.as_ref().is_none_or(|flight| flight.outcome.is_some()) {
                return Err(refused(format!(
                    "flight {number} has not begun or has ended: reset it first"
                )));
            }
        }
        let (mut positions, mut states) = (parts(&mut positions, POSITION)?, parts(&mut states, TRUE_STATE)?);
        let frames = frames.as_slice_mut().map_err(refused)?.chunks_exact_mut(deep);
        let goals = goals.as_slice_mut().map_err(refused)?.chunks_exact_mut(2);
        let rewards = rewards.as_slice_mut().map_err(refused)?.iter_mut();
        let ends = ends.as_slice_mut().map_err(refused)?.iter_mut();
        let answers = frames.zip(goals).zip(rewards.zip(ends)).zip(seeds);
        let rows = self.flights.iter_mut().zip(answers).enumerate();
        let mut rows: Vec<Row<'_>> = rows
            .map(|(number, (flight, (((frames, goal), (reward, end)), seed)))| Row {
                flight,
                seed,
                action: actions.map(|actions| &actions[2 * number..][..2]),
                older: older.map(|older| &older[number * deep..][..deep]),
                frames,
                goal,
                position: positions.as_mut().and_then(Iterator::next),
                state: states.as_mut().and_then(Iterator::next),
                reward,
                end,
            })
            .collect();
        if rows.len() != count {
            let text = format!("{count} flights need as many seeds, goals, rewards and ends");
            return Err(refused(text));
        }
        let (conditions, lidars) = (&self.conditions, &self.lidars);
        // Without a pool no thread is started: a process that forks after it, as others' vectorised environments do, stays whole.
        py.detach(|| match &self.pool {
            None => rows.iter_mut().try_for_each(|row| row.advance(conditions, &lidars[0])),
            Some(pool) => pool.install(|| {
                let own = || &lidars[rayon::current_thread_index().unwrap_or(0)];
                let each = rows.par_iter_mut().with_max_len(1);
                each.try_for_each(|row| row.advance(conditions, own()))
            }),
        })
        .map_err(refused)
    }

    /// What is known of a flight.
    fn info<'py>(&mut self, py: Python<'py>, number: usize) -> PyResult<Bound<'py, PyDict>> {
        let begun = self.begun(number)?;
        let truth = begun.flight.truth();
        let (passed, all) = begun.flight.checkpoints();
        let (info, floats) = (PyDict::new(py), |ned: NedVector| array(py, ned.to_array().to_vec()));
        info.set_item("time_s", begun.flight.time_s())?;
        info.set_item("goal_distance_m", begun.flight.goal_distance_m())?;
        info.set_item("checkpoints", passed)?;
        info.set_item("checkpoints_of", all)?;
        info.set_item("position_ned_m", floats(truth.position_ned_m))?;
        info.set_item("velocity_ned_m_s", floats(truth.velocity_ned_m_s))?;
        info.set_item("heading_rad", truth.attitude.yaw_rad())?;
        Ok(info)
    }

    /// The action of the paper's potential field here and now.
    fn field(&mut self, number: usize, half_angle_rad: f32, range_m: f32) -> PyResult<(f32, f32)> {
        let flight = &mut self.begun(number)?.flight;
        flight.look_again();
        let action = flight.field(half_angle_rad, range_m).clipped();
        Ok((action.forward_m_s, action.yaw))
    }

    /// The course from above with the way flown, `[rows][columns][red, green, blue]`.
    fn map<'py>(&mut self, py: Python<'py>, number: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let begun = self.begun(number)?;
        let path = FlightPath {
            label: begun.outcome.map(|o| o.to_string()).unwrap_or_default(),
            points_ned_m: begun.path_ned_m.clone(),
            outcome: begun.outcome,
        };
        let image = py.detach(|| vigil_sim::world::draw(&begun.course, &[path]));
        PyArray1::from_slice(py, image.rgb()).reshape([image.height(), image.width(), 3])
    }

    /// Values of a true state.
    #[classattr]
    const TRUE_STATE: usize = TRUE_STATE;

    /// Values of a position.
    #[classattr]
    const POSITION: usize = POSITION;
}

impl Flights {
    fn begun(&mut self, number: usize) -> PyResult<&mut Begun> {
        let flight = self.flights.get_mut(number).and_then(Option::as_deref_mut);
        flight.ok_or_else(|| refused("no such flight has begun: reset first"))
    }
}
