//! Environment workers: training flights whose true states and observations are stored.

use crate::explained::Flight;
use crate::trainer::actor_net::squash;
use crate::trainer::config::{Along, LearnConfig};
use crate::trainer::noise::OrnsteinUhlenbeck;
use crate::trainer::observation::{Drift, Encoder, OBSERVATION, Observer};
use crate::trainer::replay::{Next, Trajectory, Transition};
use crate::trainer::reward::{DecisionResult, reward};
use anyhow::Result;
use core::f32::consts::{PI, TAU};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vigil_nnet::ShapeError;
use vigil_policy::{NearestObstacle, apf};
use vigil_sim::environment::Environment;
use vigil_sim::environment::true_state::{RAYS, TRUE_STATE, TrueCourse, range_m};
use vigil_sim::vehicle::{Truth, VehicleParams, Wind};
use vigil_sim::world::{Family, LidarConfig, Outcome, generate};
use vigil_types::{ACTION_LIMIT, Action, GoalRelative, NedVector, wrap_pi};

/// Seeds of the training courses begin here; those that evaluate an actor are below it or above 7 000 000 000.
const FIRST_TRAINING_SEED: u64 = 1_000_000;
/// The repulsive field takes the nearest surface within this angle of the nose.
const FIELD_HALF_ANGLE_RAD: f32 = PI / 4.0;

/// A training flight that lasts, without the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Episode {
    seed: u64,
    drift: Drift,
    /// The vehicle is one drawn by the course's seed.
    #[serde(default)]
    drawn_vehicle: bool,
    /// The actions flown, one for each decision: they make the flight again, bit for bit.
    actions: Vec<[f32; 2]>,
    report: FlightReport,
    ou_state: OrnsteinUhlenbeck,
    noise_scale: f32,
}

/// A training flight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FlightReport {
    /// Family of the course.
    pub family: Family,
    /// How it ended; `None` while it lasts.
    pub outcome: Option<Outcome>,
    /// Sum of rewards, not discounted.
    pub reward: f32,
    /// Decisions.
    pub decisions: u32,
    /// The field was added.
    pub with_apf: bool,
    /// It was part of the warm-up.
    pub warm_up: bool,
}

/// An environment without its simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WorkerState {
    random_at: (u64, u64),
    flights: u64,
    episode: Option<Episode>,
}

/// A flight that lasts, as its actor observes it.
struct Current {
    flight: Flight,
    observer: Observer,
    course: TrueCourse,
    goal: NedVector,
    to_go_m: f32,
    checkpoints: usize,
    episode: Episode,
}

impl Current {
    /// Hovers at the start of its course, the first frame taken.
    fn begin(config: &LearnConfig, encoder: Arc<Encoder>, episode: Episode) -> Result<Self> {
        let mut course = generate(episode.report.family, episode.seed);
        course.time_limit_s = config.time_limit_s;
        let drawn = episode.drawn_vehicle.then(|| VehicleParams::drawn(episode.seed));
        let vehicle = drawn.unwrap_or_default();
        let environment = Environment::of(&course, vehicle, Wind::default(), LidarConfig::default(), episode.seed)?;
        let mut current = Self {
            flight: Flight::of(environment),
            observer: Observer::new(encoder, episode.drift),
            goal: course.goal_ned_m(),
            course: TrueCourse::new(&course),
            to_go_m: 0.0,
            checkpoints: 0,
            episode,
        };
        current.to_go_m = current.measure_m(config.reward.along);
        current.observer.observe(&current.flight.input(), Action::HOVER)?;
        Ok(current)
    }

    fn measure_m(&self, along: Along) -> f32 {
        match along {
            Along::Path => self.course.path_m(self.flight.truth().position_ned_m),
            Along::Line => self.flight.goal_distance_m(),
        }
    }

    /// The true state here and now.
    fn truth(&self) -> [f32; TRUE_STATE] {
        let truth = self.flight.truth();
        self.course.state(&truth, seen_from(self.goal, &truth))
    }

    /// Flies a decision's steps; the action is in units. Returns the reward and the outcome.
    fn step(&mut self, config: &LearnConfig, action: Action) -> Result<(f32, Option<Outcome>), ShapeError> {
        let (mut outcome, mut steps) = (None, 0);
        while outcome.is_none() && steps < config.steps_per_decision {
            outcome = self.flight.advance(action.scaled(config.cruise_m_s / ACTION_LIMIT));
            // The state in which it is cut off is observed as well.
            if matches!(outcome, None | Some(Outcome::TimeOut)) {
                self.observer.observe(&self.flight.input(), action)?;
            }
            steps += 1;
        }
        let to_go_m = self.measure_m(config.reward.along);
        let (checkpoints, all_checkpoints) = self.flight.checkpoints();
        let result = DecisionResult {
            progress_m: self.to_go_m - to_go_m,
            checkpoints_before: self.checkpoints,
            checkpoints,
            all_checkpoints,
            obstacle_distance_m: self.flight.obstacle_distance_m(),
            outcome,
        };
        (self.to_go_m, self.checkpoints) = (to_go_m, checkpoints);
        Ok((reward(&config.reward, &result), outcome))
    }
}

/// One environment.
pub struct EnvWorker {
    rng: ChaCha8Rng,
    number: u64,
    flights: u64,
    encoder: Arc<Encoder>,
    current: Option<Current>,
}

impl EnvWorker {
    /// Environment `number` of a run.
    pub fn new(config: &LearnConfig, encoder: Arc<Encoder>, number: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        rng.set_stream(1 + number as u64);
        Self {
            rng,
            number: number as u64,
            flights: 0,
            encoder,
            current: None,
        }
    }

    /// What a checkpoint keeps of it.
    pub fn state(&self) -> WorkerState {
        let at = self.rng.get_word_pos();
        WorkerState {
            random_at: ((at >> 64) as u64, at as u64),
            flights: self.flights,
            episode: self.current.as_ref().map(|c| c.episode.clone()),
        }
    }

    /// Takes over a saved state; the flight that lasted is flown again.
    pub fn restore(&mut self, config: &LearnConfig, state: &WorkerState) -> Result<()> {
        let (high, low) = state.random_at;
        self.rng.set_word_pos(u128::from(high) << 64 | u128::from(low));
        self.flights = state.flights;
        self.current = None;
        if let Some(episode) = &state.episode {
            let mut current = Current::begin(config, self.encoder.clone(), episode.clone())?;
            for &[forward_m_s, yaw] in &episode.actions {
                current.step(config, Action { forward_m_s, yaw })?;
            }
            self.current = Some(current);
        }
        Ok(())
    }

    /// Begins a flight if none lasts; its observation.
    pub fn observation(&mut self, config: &LearnConfig, warm_up: bool) -> Result<[f32; OBSERVATION]> {
        if self.current.is_none() {
            let run = config.seed.wrapping_mul(1 << 24);
            let seed = FIRST_TRAINING_SEED.wrapping_add(run) + self.flights * config.environments as u64 + self.number;
            self.flights += 1;
            let rng = &mut self.rng;
            let family = config.families[rng.random_range(0..config.families.len())];
            let noisy = warm_up || rng.random_bool(config.noise.share);
            let mut within = |most: f32| most * rng.random_range(-1.0_f32..=1.0);
            let drift = Drift {
                scale: within(config.drift_scale),
                yaw_rad_s: within(config.drift_yaw_deg_s.to_radians()),
            };
            let drifts = rng.random_bool(config.drift_share).then_some(drift);
            let episode = Episode {
                seed,
                drift: drifts.unwrap_or_default(),
                // No number is drawn at 0, so that runs of before are trained again bit for bit.
                drawn_vehicle: config.drawn_vehicle_share > 0.0 && rng.random_bool(config.drawn_vehicle_share),
                actions: Vec::new(),
                report: FlightReport {
                    family,
                    outcome: None,
                    reward: 0.0,
                    decisions: 0,
                    with_apf: !warm_up && rng.random_bool(config.apf_share),
                    warm_up,
                },
                ou_state: OrnsteinUhlenbeck::start(rng),
                noise_scale: if noisy { 1.0 } else { 0.0 },
            };
            self.current = Some(Current::begin(config, self.encoder.clone(), episode)?);
        }
        Ok(self.current.as_ref().map_or([0.0; OBSERVATION], |c| c.observer.now))
    }

    /// Flies one decision and stores it. `own` is the actor's output before its last tanh, `None` in the warm-up, in which noise
    /// around a mean flies. Returns the flight's report when it ended.
    pub fn fly(
        &mut self,
        config: &LearnConfig,
        own: Option<[f32; 2]>,
        sigma: f32,
        trajectory: &mut Trajectory,
    ) -> Result<Option<FlightReport>> {
        let Some(mut c) = self.current.take() else {
            return Ok(None);
        };
        let (truth, observation) = (c.truth(), c.observer.now);
        c.episode.ou_state.step(config.noise.theta, &mut self.rng);
        let noise = c.episode.ou_state.at(sigma * c.episode.noise_scale);
        let [forward_m_s, yaw] = own.map_or([config.warm_up_forward, 0.0], |pre| squash(&pre));
        let mut action = apf::add(Action { forward_m_s, yaw }, noise);
        if c.episode.report.with_apf {
            let force = apf::force(c.flight.goal_relative(), nearest(&truth), apf::REPULSIVE_RANGE_M);
            action = apf::add(action, force);
        }
        let (reward, outcome) = c.step(config, action)?;
        c.episode.report.reward += reward;
        c.episode.report.decisions += 1;
        let action = [action.forward_m_s, action.yaw];
        c.episode.actions.push(action);
        let next = match outcome {
            None => Next::Decision,
            Some(Outcome::TimeOut) => Next::CutOff,
            Some(_) => Next::Terminal,
        };
        trajectory.push(&truth, &observation, Transition { action, reward, next });
        if outcome == Some(Outcome::TimeOut) {
            let (action, reward, next) = ([0.0; 2], 0.0, Next::Nothing);
            trajectory.push(&c.truth(), &c.observer.now, Transition { action, reward, next });
        }
        if outcome.is_none() {
            self.current = Some(c);
            return Ok(None);
        }
        c.episode.report.outcome = outcome;
        Ok(Some(c.episode.report))
    }
}

/// The goal as it is, not as it is estimated.
pub fn seen_from(goal_ned_m: NedVector, truth: &Truth) -> GoalRelative {
    let to = goal_ned_m - truth.position_ned_m;
    GoalRelative {
        distance_m: to.horizontal_norm(),
        bearing_rad: wrap_pi(libm::atan2f(to.y, to.x) - truth.attitude.yaw_rad()),
    }
}

/// The nearest surface within the field's angle of the nose, of the true ranges.
fn nearest(truth: &[f32; TRUE_STATE]) -> Option<NearestObstacle> {
    (0..RAYS)
        .filter_map(|k| {
            let bearing_rad = wrap_pi(k as f32 * (TAU / RAYS as f32));
            (bearing_rad.abs() <= FIELD_HALF_ANGLE_RAD && truth[k] > 0.0).then(|| NearestObstacle {
                distance_m: range_m(truth[k]),
                bearing_rad,
            })
        })
        .min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
}
