//! Environments of a run by value: training flights whose true state, and whose pictures if the actor sees them, are kept.

use super::value_buffer::{Moment, StateView, ValueLane, halve};
use super::value_config::{Along, Sees, Teacher, ValueConfig};
use crate::actor_training::collector::{CollectError, FIRST_TRAINING_SEED, FlightReport};
use crate::actor_training::flight::Flight;
use crate::actor_training::networks::squash;
use crate::actor_training::noise::OrnsteinUhlenbeck;
use crate::actor_training::replay_buffer::Next;
use crate::actor_training::reward::{DecisionResult, RewardWeights, reward};
use core::f32::consts::{PI, TAU};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vigil_nnet::{Aligned, Graph, Isa, Purpose, ShapeError};
use vigil_policy::actor::{ActorSpec, Lead, PositionalInputs};
use vigil_policy::{ActorInputs, NearestObstacle, apf};
use vigil_sim::environment::true_state::{RAYS, TRUE_STATE, TrueCourse, range_m};
use vigil_types::{Action, GoalRelative, wrap_pi};
use vigil_vehicle::{ParamsError, Wind};
use vigil_world::{Course, Family, Outcome, generate};

/// The repulsive field takes the nearest surface within this angle of the nose.
const FIELD_HALF_ANGLE_RAD: f32 = PI / 4.0;

/// The encoder of the actor that flies, from a depth frame to its features.
pub struct Encoder {
    graph: Graph,
    isa: Isa,
    /// The whole actor's parameters, of which the encoder's are the first.
    params: Vec<f32>,
}

impl Encoder {
    /// The encoder of an actor.
    ///
    /// # Errors
    /// Parameters of another architecture.
    pub fn new(isa: Isa, encoder: &[f32]) -> Result<Self, ShapeError> {
        let graph = ActorSpec::FULL.encoder_graph(Purpose::Gradients, false)?;
        let mut params = vec![0.0; graph.param_len()];
        params[..encoder.len()].copy_from_slice(encoder);
        Ok(Self { graph, isa, params })
    }

    /// Length of a tape for [`Self::encode`].
    pub fn tape_len(&self) -> usize {
        self.graph.tape_len()
    }

    /// Features of a frame.
    pub fn width(&self) -> usize {
        self.graph.output_len()
    }

    /// Encodes a depth frame.
    ///
    /// # Errors
    /// A frame or a tape of another length.
    pub fn encode(&self, depth: &[f32], tape: &mut [f32], features: &mut Vec<u16>) -> Result<(), ShapeError> {
        self.graph.forward(self.isa, &self.params, &[depth], tape)?;
        features.clear();
        features.extend(self.graph.output(tape)?.iter().map(|f| halve(*f)));
        Ok(())
    }
}

/// A course being flown, with what only training knows of it.
pub struct TrueFlight {
    /// The simulator.
    pub flight: Flight,
    /// Its true course.
    pub course: TrueCourse,
    /// Looks in every step, as in flight, if it is the path that leads the actor.
    lead: Lead,
    /// Where it leads now.
    led: GoalRelative,
    /// What the actor decides from beside its frames.
    position: PositionalInputs,
    /// Whether the pilot that plans the path teaches.
    taught: bool,
    goal: vigil_types::NedVector,
    along: Along,
    to_go_m: f32,
    checkpoints: usize,
}

impl TrueFlight {
    /// Hovers at the start of a course.
    ///
    /// # Errors
    /// None with the default vehicle.
    pub fn new(config: &ValueConfig, family: Family, seed: u64, time_limit_s: f32) -> Result<Self, ParamsError> {
        let along = config.reward.along;
        let mut course: Course = generate(family, seed);
        course.time_limit_s = time_limit_s;
        let simulated = Flight::new(&course, Wind::default(), seed)?;
        let inputs = match config.sees {
            Sees::Truth => ActorInputs::default(),
            Sees::Pictures => config.inputs(),
        };
        let mut flight = Self {
            lead: Lead::new(inputs),
            led: simulated.goal(),
            position: PositionalInputs::of_goal(simulated.goal()),
            flight: simulated,
            taught: config.teacher == Teacher::Geometric,
            goal: course.goal_ned_m(),
            course: TrueCourse::new(&course),
            along,
            to_go_m: 0.0,
            checkpoints: 0,
        };
        flight.to_go_m = flight.measure_m();
        flight.plan();
        Ok(flight)
    }

    /// Plans on, by the newest frame.
    fn plan(&mut self) {
        (self.led, self.position) = self.lead.inputs(&self.flight.input());
    }

    /// Takes a frame where the vehicle is now, if none was taken to plan by.
    pub fn look(&mut self) {
        if !self.lead.looks() {
            self.flight.look();
        }
    }

    /// Where the actor is led: the goal, or the planned path.
    pub fn led(&self) -> GoalRelative {
        self.led
    }

    /// What the actor decides from beside its frames.
    pub fn position(&self) -> PositionalInputs {
        self.position
    }

    /// What the teacher would do here, if there is one.
    fn teacher(&self) -> Option<[f32; 2]> {
        let action = self.taught.then(|| self.lead.teacher(&self.flight.input()))??;
        Some([action.forward_m_s, action.yaw])
    }

    fn measure_m(&self) -> f32 {
        match self.along {
            Along::Way => self.course.way_m(self.flight.truth().position_ned_m),
            Along::Line => self.flight.goal_distance_m(),
        }
    }

    /// Distance and bearing of the goal as they are.
    fn true_goal(&self) -> GoalRelative {
        let truth = self.flight.truth();
        let to = self.goal - truth.position_ned_m;
        GoalRelative {
            distance_m: to.horizontal_norm(),
            bearing_rad: wrap_pi(libm::atan2f(to.y, to.x) - truth.attitude.yaw_rad()),
        }
    }

    /// The true state here and now.
    pub fn state(&self) -> [f32; TRUE_STATE] {
        self.course.state(&self.flight.truth(), self.true_goal())
    }

    /// Flies so many steps under an action, or until the flight ends. Returns the reward and the outcome. The last frame is not
    /// taken.
    pub fn decide(&mut self, config: &ValueConfig, action: Action) -> (f32, Option<Outcome>) {
        let (mut outcome, mut steps) = (None, 0);
        while outcome.is_none() && steps < config.steps_per_decision {
            outcome = if self.lead.looks() {
                self.flight.advance(action)
            } else {
                self.flight.advance_unseen(action)
            };
            if matches!(outcome, None | Some(Outcome::TimeOut)) {
                self.plan();
            }
            steps += 1;
        }
        let to_go_m = self.measure_m();
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
        (reward(&RewardWeights::from(&config.reward), &result), outcome)
    }
}

/// A flight that lasts, without the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Lasting {
    seed: u64,
    family: Family,
    first: u64,
    /// The actions flown, one for each decision: they make the flight again, bit for bit.
    actions: Vec<[f32; 2]>,
    report: FlightReport,
    wander: OrnsteinUhlenbeck,
    noise_scale: f32,
}

/// An environment without its simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlyerState {
    random_at: (u64, u64),
    flights: u64,
    lasting: Option<Lasting>,
}

struct Current {
    flight: TrueFlight,
    state: Lasting,
    truth: [f32; TRUE_STATE],
    position: PositionalInputs,
    teacher: Option<[f32; 2]>,
}

/// One environment.
pub struct Flyer {
    rng: ChaCha8Rng,
    number: u64,
    environments: u64,
    flights: u64,
    encoder: Option<Arc<Encoder>>,
    tape: Aligned,
    features: Vec<u16>,
    current: Option<Current>,
}

impl Flyer {
    /// Environment `number` of a run; with an encoder frames are taken and their features kept.
    pub fn new(config: &ValueConfig, encoder: Option<Arc<Encoder>>, number: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        rng.set_stream(1 + number as u64);
        Self {
            rng,
            number: number as u64,
            environments: config.environments as u64,
            flights: 0,
            tape: Aligned::zeros(encoder.as_ref().map_or(0, |e| e.tape_len())),
            encoder,
            features: Vec::new(),
            current: None,
        }
    }

    /// What a checkpoint keeps of it.
    pub fn state(&self) -> FlyerState {
        let at = self.rng.get_word_pos();
        FlyerState {
            random_at: ((at >> 64) as u64, at as u64),
            flights: self.flights,
            lasting: self.current.as_ref().map(|c| c.state.clone()),
        }
    }

    /// Takes over a saved state; the flight that lasted is flown again.
    ///
    /// # Errors
    /// None with the default vehicle and the encoder it was saved with.
    pub fn restore(&mut self, config: &ValueConfig, state: &FlyerState) -> Result<(), CollectError> {
        let (high, low) = state.random_at;
        self.rng.set_word_pos(u128::from(high) << 64 | u128::from(low));
        self.flights = state.flights;
        self.current = None;
        let Some(lasting) = &state.lasting else {
            return Ok(());
        };
        let mut flight = TrueFlight::new(config, lasting.family, lasting.seed, config.time_limit_s)?;
        self.see(&mut flight)?;
        for &[forward_m_s, yaw] in &lasting.actions {
            flight.decide(config, Action { forward_m_s, yaw });
            self.see(&mut flight)?;
        }
        self.arrive(flight, lasting.clone())
    }

    /// Takes a frame where the flight is now.
    fn see(&mut self, flight: &mut TrueFlight) -> Result<(), CollectError> {
        if let Some(encoder) = &self.encoder {
            flight.look();
            encoder.encode(&flight.flight.frame().depth, &mut self.tape, &mut self.features)?;
        }
        Ok(())
    }

    fn arrive(&mut self, flight: TrueFlight, state: Lasting) -> Result<(), CollectError> {
        self.current = Some(Current {
            truth: flight.state(),
            position: flight.position(),
            teacher: flight.teacher(),
            flight,
            state,
        });
        Ok(())
    }

    /// Begins a flight if none lasts.
    ///
    /// # Errors
    /// [`CollectError`]; none with weights of the right networks.
    pub fn begin(&mut self, config: &ValueConfig, lane: &ValueLane, warm_up: bool) -> Result<(), CollectError> {
        if self.current.is_some() {
            return Ok(());
        }
        let run = config.seed.wrapping_mul(1 << 24);
        let seed = FIRST_TRAINING_SEED + run + self.flights * self.environments + self.number;
        self.flights += 1;
        let family = config.families[self.rng.random_range(0..config.families.len())];
        let mut flight = TrueFlight::new(config, family, seed, config.time_limit_s)?;
        let noisy = warm_up || self.rng.random_bool(config.noise.share);
        let state = Lasting {
            seed,
            family,
            first: lane.next,
            actions: Vec::new(),
            report: FlightReport {
                outcome: None,
                reward: 0.0,
                decisions: 0,
                with_apf: !warm_up && self.rng.random_bool(config.apf_share),
                warm_up,
            },
            wander: OrnsteinUhlenbeck::start(&mut self.rng),
            noise_scale: if noisy { 1.0 } else { 0.0 },
        };
        self.see(&mut flight)?;
        self.arrive(flight, state)
    }

    /// The state the actor has to decide in.
    pub fn view<'a>(&'a self, lane: &'a ValueLane) -> Option<StateView<'a>> {
        let c = self.current.as_ref()?;
        Some(StateView {
            truth: &c.truth,
            features: lane.window(c.state.first, &self.features),
            position: c.position,
            teacher: c.teacher,
        })
    }

    /// Flies one decision and keeps it. `own` is the actor's output before its last tanh, `None` in the warm-up, in which noise
    /// around a mean flies. Returns the flight's report when it ended.
    ///
    /// # Errors
    /// [`CollectError`]; none with weights of the right networks.
    pub fn fly(
        &mut self,
        config: &ValueConfig,
        own: Option<[f32; 2]>,
        sigma: f32,
        lane: &mut ValueLane,
    ) -> Result<Option<FlightReport>, CollectError> {
        let Some(Current {
            mut flight,
            state: mut c,
            truth,
            position,
            teacher,
        }) = self.current.take()
        else {
            return Ok(None);
        };
        c.wander.step(config.noise.theta, &mut self.rng);
        let noise = c.wander.at(sigma * c.noise_scale);
        let [forward_m_s, yaw] = own.map_or([config.warm_up_forward, 0.0], |pre| squash(&pre));
        let mut action = apf::add(Action { forward_m_s, yaw }, noise);
        if c.report.with_apf {
            let goal = flight.led();
            action = apf::add(action, apf::force(goal, nearest(&truth), apf::REPULSIVE_RANGE_M));
        }
        let (reward, outcome) = flight.decide(config, action);
        c.report.reward += reward;
        c.report.decisions += 1;
        c.actions.push([action.forward_m_s, action.yaw]);
        let moment = Moment {
            first: c.first,
            position,
            teacher,
            action: [action.forward_m_s, action.yaw],
            reward,
            next: match outcome {
                None => Next::Decision,
                Some(Outcome::TimeOut) => Next::CutOff,
                Some(_) => Next::Terminal,
            },
        };
        lane.push(&truth, &self.features, moment);
        match outcome {
            None => {
                self.see(&mut flight)?;
                self.arrive(flight, c)?;
                return Ok(None);
            }
            Some(Outcome::TimeOut) => {
                self.see(&mut flight)?;
                let last = Moment {
                    position: flight.position(),
                    teacher: None,
                    action: [0.0; 2],
                    reward: 0.0,
                    next: Next::Nothing,
                    ..moment
                };
                lane.push(&flight.state(), &self.features, last);
            }
            Some(_) => {}
        }
        c.report.outcome = outcome;
        Ok(Some(c.report))
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

#[cfg(test)]
mod tests {
    use super::super::value_config::Leader;
    use super::*;
    use vigil_policy::actor::WITH_MOVERS;
    use vigil_sim::environment::true_state::MOVER;

    /// What an actor is told of movers is what the simulator knows of them: the tracker's estimate against the truth, over flights that stand
    /// and look.
    #[test]
    fn what_an_actor_is_told_of_a_mover_is_where_the_mover_is() {
        let config = ValueConfig {
            sees: Sees::Pictures,
            led_by: Leader::Path,
            told_of_movers: true,
            ..ValueConfig::default()
        };
        let (mut told, mut right) = (0, 0);
        for seed in 0..12 {
            let mut flight = TrueFlight::new(&config, Family::Hard, seed, 60.0).unwrap();
            for _ in 0..40 {
                let (position, truth) = (flight.position(), flight.state());
                assert_eq!(position.len(), WITH_MOVERS);
                let truly: Vec<&[f32]> = truth[MOVER..].chunks_exact(6).collect();
                for track in position[4..].chunks_exact(6).filter(|track| track[5] == 1.0) {
                    told += 1;
                    let is_it = |mover: &&[f32]| {
                        let gap_m = |near: f32| 3.0 / near - 3.0;
                        (gap_m(track[0]) - gap_m(mover[0])).abs() < 0.3
                            && libm::hypotf(track[1] - mover[1], track[2] - mover[2]) < 0.1
                            && libm::hypotf(track[3] - mover[3], track[4] - mover[4]) < 0.25
                    };
                    right += usize::from(truly.iter().any(is_it));
                }
                if flight.decide(&config, Action::HOVER).1.is_some() {
                    break;
                }
            }
        }
        assert!(told > 100, "{told}");
        assert!(right * 10 > told * 8, "{right} of {told}");
    }

    /// The path that leads an actor in training is that of flight: planned on in every step, a decision lasting four.
    #[test]
    fn the_path_of_training_is_the_path_of_flight() {
        let led_by = |led_by| ValueConfig {
            sees: Sees::Pictures,
            led_by,
            ..ValueConfig::default()
        };
        let config = led_by(Leader::Path);
        let (family, seed) = (Family::Hard, 3);
        let mut training = TrueFlight::new(&config, family, seed, 60.0).unwrap();
        let mut by_goal = TrueFlight::new(&led_by(Leader::Goal), family, seed, 60.0).unwrap();
        let mut course = generate(family, seed);
        course.time_limit_s = 60.0;
        let mut flight = Flight::new(&course, Wind::default(), seed).unwrap();
        let mut lead = Lead::new(config.inputs());
        let mut apart: f32 = 0.0;
        let (mut led, _) = lead.inputs(&flight.input());
        for decision in 0..40 {
            assert_eq!(training.led(), led, "decision {decision}");
            assert_eq!(by_goal.led(), by_goal.flight.goal());
            apart = apart.max((led.bearing_rad - flight.goal().bearing_rad).abs());
            // Towards where the path leads, slowly.
            let action = Action {
                forward_m_s: 0.5,
                yaw: led.bearing_rad.clamp(-1.0, 1.0),
            };
            training.decide(&config, action);
            by_goal.decide(&config, action);
            for _ in 0..config.steps_per_decision {
                assert_eq!(flight.advance(action), None);
                (led, _) = lead.inputs(&flight.input());
            }
        }
        assert!(apart > 0.2, "a hall's path is not the straight line: {apart}");
    }
}
