//! An environment: flies one training flight after the other and keeps what happened.

use crate::actor_training::config::TrainConfig;
use crate::actor_training::decider::Decider;
use crate::actor_training::flight::Flight;
use crate::actor_training::networks::Networks;
use crate::actor_training::noise::OrnsteinUhlenbeck;
use crate::actor_training::replay_buffer::{Lane, Next, Record, State};
use crate::actor_training::reward::{DecisionResult, RewardWeights, reward};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::actor::goal_inputs;
use vigil_policy::{GeometricPilot, Pilot, apf};
use vigil_types::Action;
use vigil_vehicle::{ParamsError, Wind};
use vigil_world::{Family, Outcome, generate};

/// The wind's stream of a flight's random numbers.
const WIND_STREAM: u64 = 1 << 32;

/// Seeds of training flights begin here; those below are for judging.
pub const FIRST_TRAINING_SEED: u64 = 1_000_000;

/// Why a decision could not be flown.
#[derive(Debug, thiserror::Error)]
pub enum CollectError {
    /// The vehicle.
    #[error(transparent)]
    Vehicle(#[from] ParamsError),
    /// The networks.
    #[error(transparent)]
    Network(#[from] ShapeError),
}

/// A training flight.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FlightReport {
    /// How it ended; `None` while it lasts.
    #[serde(with = "outcome_name")]
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

/// Who decides and how loud the noise is.
#[derive(Clone, Copy)]
pub struct Policy<'a> {
    /// Networks.
    pub networks: &'a Networks,
    /// Instruction set.
    pub isa: Isa,
    /// The actor's weights; `None` during warm-up.
    pub actor: Option<&'a [f32]>,
    /// Standard deviation of the noise.
    pub sigma: f32,
}

/// A flight that lasts, without the simulator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Lasting {
    first_frame: u64,
    newest_frame: u64,
    distance_m: f32,
    checkpoints: usize,
    report: FlightReport,
    wander: OrnsteinUhlenbeck,
    /// Scales the flight's noise.
    noise_scale: f32,
}

/// An environment without its simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CollectorState {
    /// Position in the random stream, high and low half.
    random_at: (u64, u64),
    flights: u64,
    lasting: Option<Lasting>,
}

impl CollectorState {
    /// Whether it is in the middle of a flight.
    pub fn is_flying(&self) -> bool {
        self.lasting.is_some()
    }
}

struct Current {
    flight: Flight,
    state: Lasting,
}

/// One environment.
pub struct Collector {
    rng: ChaCha8Rng,
    number: u64,
    environments: u64,
    flights: u64,
    pilot: Box<GeometricPilot>,
    decider: Decider,
    current: Option<Current>,
}

/// The simulator of a training flight.
fn simulate(config: &TrainConfig, seed: u64) -> Result<Flight, ParamsError> {
    let mut course = generate(Family::Training, seed);
    course.time_limit_s = config.time_limit_s;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(WIND_STREAM);
    let wind = if config.wind_m_s > 0.0 && rng.random_bool(0.5) {
        let towards_rad = rng.random_range(0.0..core::f64::consts::TAU);
        Wind::gusty(rng.random_range(0.0..=config.wind_m_s), towards_rad)
    } else {
        Wind::default()
    };
    Flight::new(&course, wind, seed)
}

impl Collector {
    /// Environment `number` of the run.
    pub fn new(config: &TrainConfig, networks: &Networks, number: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        rng.set_stream(1 + number as u64);
        Self {
            rng,
            number: number as u64,
            environments: config.environments as u64,
            flights: 0,
            pilot: Box::new(config.teacher.pilot()),
            decider: Decider::new(networks),
            current: None,
        }
    }

    /// What a checkpoint keeps of it.
    pub fn state(&self) -> CollectorState {
        let at = self.rng.get_word_pos();
        CollectorState {
            random_at: ((at >> 64) as u64, at as u64),
            flights: self.flights,
            lasting: self.current.as_ref().map(|c| c.state),
        }
    }

    /// Takes over a saved state, and flies all flights again whose frames the lane keeps.
    ///
    /// # Errors
    /// None with the default vehicle.
    pub fn restore(
        &mut self,
        config: &TrainConfig,
        state: &CollectorState,
        lane: &mut Lane,
    ) -> Result<(), ParamsError> {
        let (high, low) = state.random_at;
        self.rng.set_word_pos(u128::from(high) << 64 | u128::from(low));
        self.flights = state.flights;
        self.current = None;
        let episodes = lane.state().episodes.clone();
        let last = episodes.len().saturating_sub(1);
        for (i, episode) in episodes.iter().enumerate() {
            let mut flight = simulate(config, episode.seed)?;
            let lasting = state.lasting.filter(|_| i == last);
            self.pilot.reset();
            lane.write_frame(episode.first_frame, &flight.frame().depth);
            for (number, &[forward_m_s, yaw]) in (episode.first_frame + 1..).zip(&episode.actions) {
                // The pilot remembers what it saw, so it has to see it again.
                if lasting.is_some() && config.needs_pilot(episode.warm_up) {
                    self.pilot.decide(&flight.input());
                }
                if matches!(
                    flight.advance(Action { forward_m_s, yaw }),
                    None | Some(Outcome::TimeOut)
                ) {
                    lane.write_frame(number, &flight.frame().depth);
                }
            }
            self.current = lasting.map(|state| Current { flight, state });
        }
        Ok(())
    }

    fn begin(&mut self, config: &TrainConfig, lane: &mut Lane, warm_up: bool) -> Result<Current, ParamsError> {
        // Runs of different seeds fly different courses.
        let run = config.seed.wrapping_mul(1 << 24);
        let flight = self.flights.wrapping_mul(self.environments).wrapping_add(self.number);
        let seed = FIRST_TRAINING_SEED.wrapping_add(run).wrapping_add(flight);
        self.flights += 1;
        let flight = simulate(config, seed)?;
        self.pilot.reset();
        let first_frame = lane.begin(seed, warm_up, &flight.frame().depth);
        let state = Lasting {
            first_frame,
            newest_frame: first_frame,
            distance_m: flight.goal_distance_m(),
            checkpoints: 0,
            report: FlightReport {
                outcome: None,
                reward: 0.0,
                decisions: 0,
                with_apf: !warm_up && self.rng.random_bool(config.apf.share),
                warm_up,
            },
            wander: OrnsteinUhlenbeck::start(&mut self.rng),
            noise_scale: if warm_up {
                self.rng.random_range(0.0..1.0)
            } else if self.rng.random_bool(config.noise.share) {
                1.0
            } else {
                0.0
            },
        };
        Ok(Current { flight, state })
    }

    /// Flies one decision and keeps it. Returns the flight's report when it ended.
    ///
    /// # Errors
    /// [`CollectError`]; none with weights of the right networks.
    pub fn decide(
        &mut self,
        config: &TrainConfig,
        policy: Policy<'_>,
        lane: &mut Lane,
    ) -> Result<Option<FlightReport>, CollectError> {
        let Current {
            mut flight,
            state: mut c,
        } = match self.current.take() {
            Some(current) => current,
            None => self.begin(config, lane, policy.actor.is_none())?,
        };
        let position = goal_inputs(flight.goal());
        let record = Record {
            newest_frame: c.newest_frame,
            first_frame: c.first_frame,
            position,
            action: [0.0; 2],
            teacher_action: None,
            reward: 0.0,
            next: Next::Nothing,
        };
        let own = match policy.actor {
            Some(actor) => {
                let state = State {
                    frames: lane.window(c.newest_frame, c.first_frame),
                    position,
                };
                let [forward_m_s, yaw] = self.decider.decide(policy.networks, policy.isa, actor, &state)?;
                Some(Action { forward_m_s, yaw })
            }
            None => None,
        };
        c.wander.step(config.noise.theta, &mut self.rng);
        let noise = c.wander.at(policy.sigma * c.noise_scale);
        let mut flown = [0.0_f32; 2];
        let mut teacher_action = [0.0_f32; 2];
        let guided = config.needs_pilot(own.is_none());
        let mut steps = 0.0_f32;
        let mut outcome = None;
        while outcome.is_none() && (steps as usize) < config.steps_per_decision {
            let pilot = if guided {
                self.pilot.decide(&flight.input())
            } else {
                Action::HOVER
            };
            teacher_action[0] += pilot.forward_m_s;
            teacher_action[1] += pilot.yaw;
            let wanted = own.unwrap_or(pilot);
            let mut action = apf::add(wanted, noise);
            if c.report.with_apf {
                action = apf::add(
                    action,
                    flight.field(config.apf.half_angle_deg.to_radians(), apf::REPULSIVE_RANGE_M),
                );
            }
            flown[0] += action.forward_m_s;
            flown[1] += action.yaw;
            steps += 1.0;
            lane.push_action([action.forward_m_s, action.yaw]);
            outcome = flight.advance(action);
            if matches!(outcome, None | Some(Outcome::TimeOut)) {
                c.newest_frame = lane.push_frame(&flight.frame().depth);
            }
        }
        let distance_m = flight.goal_distance_m();
        let (checkpoints, all_checkpoints) = flight.checkpoints();
        let result = DecisionResult {
            progress_m: c.distance_m - distance_m,
            checkpoints_before: c.checkpoints,
            checkpoints,
            all_checkpoints,
            obstacle_distance_m: flight.obstacle_distance_m(),
            outcome,
        };
        (c.distance_m, c.checkpoints) = (distance_m, checkpoints);
        let reward = reward(&RewardWeights::from(&config.reward), &result);
        c.report.reward += reward;
        c.report.decisions += 1;
        lane.push(Record {
            action: flown.map(|sum| sum / steps),
            teacher_action: guided.then(|| teacher_action.map(|sum| sum / steps)),
            reward,
            next: match outcome {
                None => Next::Decision,
                Some(Outcome::TimeOut) => Next::CutOff,
                Some(_) => Next::Terminal,
            },
            ..record
        });
        let Some(outcome) = outcome else {
            self.current = Some(Current { flight, state: c });
            return Ok(None);
        };
        if outcome == Outcome::TimeOut {
            lane.push(Record {
                newest_frame: c.newest_frame,
                first_frame: c.first_frame,
                position: goal_inputs(flight.goal()),
                action: [0.0; 2],
                teacher_action: None,
                reward: 0.0,
                next: Next::Nothing,
            });
        }
        c.report.outcome = Some(outcome);
        Ok(Some(c.report))
    }
}

/// Outcomes by their name, since the simulator's type has no serial form.
mod outcome_name {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use vigil_world::Outcome;

    pub fn serialize<S: Serializer>(outcome: &Option<Outcome>, s: S) -> Result<S::Ok, S::Error> {
        outcome.map(|o| o.to_string()).serialize(s)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Option<Outcome>, D::Error> {
        let name = Option::<String>::deserialize(d)?;
        let outcome = name.map(|name| name.parse()).transpose();
        outcome.map_err(serde::de::Error::custom)
    }
}
