//! Flights stepped side by side for `vigil.gym`.

use crate::actor::Actor;
use crate::given::{POSITION, array, failed, refused};
use numpy::{PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadwriteArray4, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rayon::prelude::*;
use vigil_lab::trainer::config::{Along, RewardConfig};
use vigil_lab::trainer::reward::{DecisionResult, reward};
use vigil_sim::environment::true_state::{TRUE_STATE, TrueCourse};
use vigil_sim::vehicle::{Truth, Wind};
use vigil_sim::world::{Course, Family, FlightPath, LidarConfig, Outcome, generate};
use vigil_tools::explained::Flight;
use vigil_types::{
    Action, AttitudeSample, DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DEPTH_ROWS, Goal, GoalRelative, Kinematics,
    NedVector,
};

/// Steps between two points of a drawn path.
const PATH_STRIDE: usize = 4;

/// What all flights have in common.
struct Conditions {
    /// Flown instead of generated ones.
    course: Option<Course>,
    family: Family,
    wind_m_s: f64,
    lidar: LidarConfig,
    time_limit_s: Option<f32>,
    weights: RewardConfig,
    /// Progress along the shortest free way, not the straight line.
    along_way: bool,
    /// The true state is told.
    privileged: bool,
    /// Positions are given.
    with_position: bool,
}

/// A flight that has begun.
struct Begun {
    course: Course,
    flight: Flight,
    goal: Goal,
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
        course.time_limit_s = self.time_limit_s.unwrap_or(course.time_limit_s);
        let wind = match self.wind_m_s > 0.0 {
            // Multiples of the golden ratio spread the directions of neighbouring seeds evenly, as `vigil evaluate` does.
            true => {
                let turn = (seed as f64 * 0.618_033_988_749_895) % 1.0;
                Wind::gusty(self.wind_m_s, std::f64::consts::TAU * turn)
            }
            false => Wind::default(),
        };
        let flight = Flight::with_lidar(&course, wind, self.lidar, seed).map_err(|e| e.to_string())?;
        let truth = (self.along_way || self.privileged).then(|| TrueCourse::new(&course));
        let mut begun = Begun {
            goal: Goal {
                position_ned_m: course.goal_ned_m(),
            },
            path_ned_m: vec![flight.truth().position_ned_m],
            course,
            flight,
            truth,
            left_m: 0.0,
            steps: 0,
            outcome: None,
        };
        begun.left_m = begun.left_m(self.along_way);
        Ok(begun)
    }
}

impl Begun {
    /// What is left of the way, metres.
    fn left_m(&self, along_way: bool) -> f32 {
        match &self.truth {
            Some(course) if along_way => course.way_m(self.flight.truth().position_ned_m),
            _ => self.flight.goal_distance_m(),
        }
    }

    fn step(&mut self, conditions: &Conditions, action: Action) -> f32 {
        let before = self.flight.checkpoints().0;
        self.outcome = self.flight.advance(action);
        let left_m = self.left_m(conditions.along_way);
        let (checkpoints, all_checkpoints) = self.flight.checkpoints();
        let result = DecisionResult {
            progress_m: self.left_m - left_m,
            checkpoints_before: before,
            checkpoints,
            all_checkpoints,
            obstacle_distance_m: self.flight.obstacle_distance_m(),
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
        let (header, yaw_rad) = (&input.depth.header, input.attitude.yaw_rad());
        let since_s = input.now_ns.saturating_sub(header.stamp_ns) as f32 * 1e-9;
        let here = header.position_ned_m + input.velocity_m_s.to_ned(yaw_rad) * since_s;
        [
            input.goal.distance_m,
            input.goal.bearing_rad,
            here.x,
            here.y,
            input.height_m,
            yaw_rad,
            input.velocity_m_s.x,
            input.velocity_m_s.y,
            (input.now_ns as f64 * 1e-9) as f32,
        ]
    }

    /// Writes the newest frame, metres.
    fn show(&self, frame_m: &mut [f32]) {
        for (metres, range) in frame_m.iter_mut().zip(&self.flight.frame().depth) {
            *metres = range * DEPTH_FULL_SCALE_M;
        }
    }

    fn true_state(&self) -> [f32; TRUE_STATE] {
        let truth = self.flight.truth();
        let goal = seen_from(&self.goal, &truth);
        self.truth
            .as_ref()
            .map_or([0.0; TRUE_STATE], |course| course.state(&truth, goal))
    }
}

/// The goal as it is, not as it is estimated.
fn seen_from(goal: &Goal, truth: &Truth) -> GoalRelative {
    let kinematics = Kinematics {
        at_ns: truth.at_ns,
        position_ned_m: truth.position_ned_m,
        velocity_ned_m_s: truth.velocity_ned_m_s,
    };
    let attitude = AttitudeSample {
        at_ns: truth.at_ns,
        attitude: truth.attitude,
        rates_frd_rad_s: truth.rates_frd_rad_s,
    };
    goal.relative_to(&kinematics, &attitude)
}

/// How a flight ended, as a number; −1: it goes on.
fn code(outcome: Option<Outcome>) -> i8 {
    match outcome {
        None => -1,
        Some(Outcome::Success) => 0,
        Some(Outcome::Collision) => 1,
        Some(Outcome::OutOfBounds) => 2,
        Some(Outcome::TimeOut) => 3,
    }
}

/// A flight, if it has begun, and its frames.
type Place<'a> = (&'a mut Option<Box<Begun>>, &'a mut [f32]);
type Frames<'py> = PyReadwriteArray4<'py, f32>;
/// Seconds, metres to the goal, checkpoints passed and all, position NED, velocity NED, heading.
type Info = (f64, f32, usize, usize, [f32; 3], [f32; 3], f32);

/// Several flights at once. They share nothing; the same seeds and actions give the same bits on any number of threads.
#[pyclass(module = "vigil._vigil")]
pub struct Flights {
    conditions: Conditions,
    flights: Vec<Option<Box<Begun>>>,
    pool: Option<rayon::ThreadPool>,
}

#[pymethods]
impl Flights {
    #[new]
    #[pyo3(signature = (count, *, family, course, wind, noise, time_limit, success, dead, decision, checkpoint, near, along_way, privileged, actor, threads))]
    #[allow(clippy::too_many_arguments, reason = "the Python side names them")]
    fn new(
        count: usize,
        family: &str,
        course: Option<&str>,
        wind: f64,
        noise: f32,
        time_limit: Option<f32>,
        success: f32,
        dead: f32,
        decision: f32,
        checkpoint: f32,
        near: f32,
        along_way: bool,
        privileged: bool,
        actor: Option<PyRef<'_, Actor>>,
        threads: usize,
    ) -> PyResult<Self> {
        if !(0.0..=20.0).contains(&wind) {
            return Err(refused(format!("wind: 0 to 20 m/s, got {wind}")));
        }
        if !(0.0..=100.0).contains(&noise) {
            return Err(refused(format!("noise: a factor from 0 to 100, got {noise}")));
        }
        if time_limit.is_some_and(|limit| !(limit > 0.0 && limit <= 3600.0)) {
            return Err(refused("time_limit: above 0 and at most 3600 s"));
        }
        if [success, dead, decision, checkpoint, near]
            .iter()
            .any(|w| !w.is_finite())
        {
            return Err(refused("reward: every weight has to be a finite number"));
        }
        let mut lidar = LidarConfig::default();
        lidar.range_noise_sigma_m *= noise;
        lidar.dropout_probability = (lidar.dropout_probability * noise).min(1.0);
        let pool = match threads.min(count) {
            0 | 1 => None,
            threads => Some(
                rayon::ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .build()
                    .map_err(failed)?,
            ),
        };
        Ok(Self {
            conditions: Conditions {
                course: course
                    .map(|text| Course::from_toml_str(text, "course"))
                    .transpose()
                    .map_err(refused)?,
                family: family.parse().map_err(refused)?,
                wind_m_s: wind,
                lidar,
                time_limit_s: time_limit,
                weights: RewardConfig {
                    along: if along_way { Along::Path } else { Along::Line },
                    success,
                    dead,
                    decision,
                    checkpoint,
                    near,
                },
                along_way,
                privileged,
                with_position: actor.is_some(),
            },
            flights: (0..count).map(|_| None).collect(),
            pool,
        })
    }

    /// Begins the flights that have a seed and writes their first frame into `frames[flight, slot - back : slot + 1]`.
    fn reset(
        &mut self,
        py: Python<'_>,
        seeds: Vec<Option<u64>>,
        mut frames: Frames<'_>,
        slot: usize,
        back: usize,
    ) -> PyResult<()> {
        let deep = self.depth(&frames, slot)?;
        if seeds.len() != self.flights.len() || back > slot {
            return Err(refused("seeds: one for each flight"));
        }
        let all = frames.as_slice_mut().map_err(refused)?;
        let (conditions, flights, pool) = (&self.conditions, &mut self.flights, &self.pool);
        let one = |((flight, frames), seed): (Place<'_>, Option<u64>)| {
            let Some(seed) = seed else { return Ok(()) };
            let begun = conditions.begin(seed)?;
            for frame in frames[(slot - back) * DEPTH_PIXELS..]
                .chunks_exact_mut(DEPTH_PIXELS)
                .take(back + 1)
            {
                begun.show(frame);
            }
            *flight = Some(Box::new(begun));
            Ok(())
        };
        // Without a pool no thread is started: a process that forks after it, as others' vectorised environments do, stays whole.
        py.detach(|| match pool {
            None => {
                let each = flights.iter_mut().zip(all.chunks_exact_mut(deep));
                each.zip(seeds).try_for_each(one)
            }
            Some(pool) => pool.install(|| {
                let each = flights.par_iter_mut().zip(all.par_chunks_exact_mut(deep));
                each.zip(seeds).try_for_each(one)
            }),
        })
        .map_err(|e: String| refused(e))
    }

    /// Flies one step of 50 ms of the flights whose seed is not asked for otherwise (`flies`) and writes their frames into
    /// `frames[flight, slot]`; those that do not fly keep their last frame. Returns rewards and outcomes.
    #[allow(clippy::type_complexity, reason = "two arrays")]
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        actions: PyReadonlyArray2<'py, f32>,
        flies: Vec<bool>,
        mut frames: Frames<'py>,
        slot: usize,
    ) -> PyResult<(Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<i8>>)> {
        let count = self.flights.len();
        let deep = self.depth(&frames, slot)?;
        if actions.shape() != [count, 2] || flies.len() != count {
            return Err(refused(format!(
                "actions: expected shape ({count}, 2), got {:?}",
                actions.shape()
            )));
        }
        let actions = actions.as_slice().map_err(refused)?;
        if actions.iter().any(|x| !x.is_finite()) {
            return Err(refused("actions: forward speed and yaw have to be finite numbers"));
        }
        for (number, (flight, flies)) in self.flights.iter().zip(&flies).enumerate() {
            if *flies && flight.as_ref().is_none_or(|flight| flight.outcome.is_some()) {
                return Err(refused(format!(
                    "flight {number} has not begun or has ended: reset it first"
                )));
            }
        }
        let all = frames.as_slice_mut().map_err(refused)?;
        let (conditions, flights, pool) = (&self.conditions, &mut self.flights, &self.pool);
        let results: Vec<(f32, i8)> = py.detach(|| {
            let one = |((flight, frames), (action, flies)): (Place<'_>, (&[f32], bool))| {
                let Some(flight) = flight else { return (0.0, -1) };
                let mut reward = 0.0;
                if flies {
                    let action = Action {
                        forward_m_s: action[0],
                        yaw: action[1],
                    };
                    reward = flight.step(conditions, action);
                }
                flight.show(&mut frames[slot * DEPTH_PIXELS..][..DEPTH_PIXELS]);
                (reward, code(flight.outcome))
            };
            match pool {
                None => {
                    let each = flights.iter_mut().zip(all.chunks_exact_mut(deep));
                    each.zip(actions.chunks_exact(2).zip(flies)).map(one).collect()
                }
                Some(pool) => pool.install(|| {
                    let each = flights.par_iter_mut().zip(all.par_chunks_exact_mut(deep));
                    each.zip(actions.par_chunks_exact(2).zip(flies)).map(one).collect()
                }),
            }
        });
        let (rewards, outcomes): (Vec<f32>, Vec<i8>) = results.into_iter().unzip();
        Ok((array(py, rewards), PyArray1::from_vec(py, outcomes)))
    }

    /// Distance in metres and bearing in radians of the goal as the vehicles believe, flight after flight.
    fn goals<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        let goal = |flight: &Option<Box<Begun>>| {
            let goal = flight.as_ref().map(|flight| flight.flight.goal());
            goal.map_or([0.0; 2], |goal| [goal.distance_m, goal.bearing_rad])
        };
        array(py, self.flights.iter().flat_map(goal).collect())
    }

    /// Goal, odometry and time ([`POSITION`] values) that an actor decides from beside its frames, flight after flight.
    fn positions<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        let each = self.flights.iter().flatten().filter(|_| self.conditions.with_position);
        array(py, each.flat_map(|flight| flight.position()).collect())
    }

    /// The true states, flight after flight.
    fn true_states<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        let state = |flight: &Option<Box<Begun>>| flight.as_ref().map_or([0.0; TRUE_STATE], |f| f.true_state());
        array(py, self.flights.iter().flat_map(state).collect())
    }

    /// What is known of a flight.
    fn info(&self, number: usize) -> PyResult<Info> {
        let begun = self.begun(number)?;
        let truth = begun.flight.truth();
        let (passed, all) = begun.flight.checkpoints();
        Ok((
            begun.flight.time_s(),
            begun.flight.goal_distance_m(),
            passed,
            all,
            truth.position_ned_m.to_array(),
            truth.velocity_ned_m_s.to_array(),
            truth.attitude.yaw_rad(),
        ))
    }

    /// The action of the paper's potential field here and now.
    fn field(&mut self, number: usize, half_angle_rad: f32, range_m: f32) -> PyResult<(f32, f32)> {
        let flight = self.flights.get_mut(number).and_then(Option::as_mut);
        let flight = flight.ok_or_else(|| refused("no such flight has begun"))?;
        let action = flight.flight.field(half_angle_rad, range_m).clipped();
        Ok((action.forward_m_s, action.yaw))
    }

    /// The course from above with the way flown, `[rows][columns][red, green, blue]`.
    fn map<'py>(&self, py: Python<'py>, number: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
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
    fn begun(&self, number: usize) -> PyResult<&Begun> {
        let flight = self.flights.get(number).and_then(Option::as_deref);
        flight.ok_or_else(|| refused("no such flight has begun: reset first"))
    }

    /// Values of a flight's frames in the array, which has to fit.
    fn depth(&self, frames: &Frames<'_>, slot: usize) -> PyResult<usize> {
        match *frames.shape() {
            [count, slots, DEPTH_ROWS, DEPTH_COLS] if count == self.flights.len() && slot < slots => {
                Ok(slots * DEPTH_PIXELS)
            }
            ref shape => Err(refused(format!(
                "frames: {shape:?} does not hold slot {slot} of each flight"
            ))),
        }
    }
}
