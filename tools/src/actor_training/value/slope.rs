//! Does the critic know which way to turn? Its slope over the yaw output against what flights tell.
//!
//! The simulator is deterministic: from one state five yaw values are flown for a decision each, then the actor goes on without
//! noise, and the five returns are compared with what the critics say of the five.

use super::actors::ActorNetwork;
use super::flyer::{Encoder, TrueFlight};
use super::value_buffer::{Moment, ValueLane};
use super::value_config::ValueConfig;
use super::value_learner::ValueLearner;
use crate::actor_training::collector::CollectError;
use crate::actor_training::networks::squash;
use crate::actor_training::noise::OrnsteinUhlenbeck;
use crate::actor_training::replay_buffer::Next;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use vigil_nnet::{Aligned, Isa, ShapeError};
use vigil_policy::actor::PositionalInputs;
use vigil_policy::apf;
use vigil_sim::environment::true_state::TRUE_STATE;
use vigil_types::{ACTION_LIMIT, Action};
use vigil_world::{Family, Outcome};

/// Differences in yaw output that are flown.
const YAWS: [f32; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];
/// Decisions flown on after the one that differs.
const DECISIONS_ON: usize = 25;
/// Seeds of the flights from which states are taken; nothing is trained or chosen by them.
const FIRST_SEED: u64 = 600_000;
/// A state lies within so many decisions of the start.
const LATEST: usize = 60;
/// Noise on the way to the state, so that not all states are those of a good flight.
const NOISE: f32 = 0.4;
/// Returns that differ by less over the five say nothing about a direction.
const LEAST_SPREAD: f32 = 0.1;

/// An actor that decides as it does in training: once every few steps.
pub struct Chooser {
    isa: Isa,
    network: ActorNetwork,
    params: Vec<f32>,
    encoder: Option<Arc<Encoder>>,
    tape: Aligned,
    features: Vec<u16>,
    lane: ValueLane,
}

impl Chooser {
    /// For these trained parameters.
    pub fn new(config: &ValueConfig, isa: Isa, params: &[f32], encoder: Option<Arc<Encoder>>) -> Self {
        Self {
            isa,
            network: ActorNetwork::new(config, 1),
            params: params.to_vec(),
            tape: Aligned::zeros(encoder.as_ref().map_or(0, |e| e.tape_len())),
            lane: ValueLane::new(64, encoder.as_ref().map_or(0, |e| e.width())),
            encoder,
            features: Vec::new(),
        }
    }

    /// Begins a flight.
    pub fn reset(&mut self) {
        self.lane.next = 0;
        self.lane.moments.clear();
        self.lane.truths.clear();
        self.lane.features.clear();
    }

    /// Looks, and decides. To be called at every decision of a flight, its own or not.
    ///
    /// # Errors
    /// Weights of other networks.
    pub fn choose(&mut self, flight: &mut TrueFlight) -> Result<[f32; 2], ShapeError> {
        let truth = flight.state();
        if let Some(encoder) = &self.encoder {
            flight.look();
            encoder.encode(&flight.flight.frame().depth, &mut self.tape, &mut self.features)?;
        }
        let moment = Moment {
            first: 0,
            position: flight.position(),
            teacher: None,
            action: [0.0; 2],
            reward: 0.0,
            next: Next::Decision,
        };
        let number = self.lane.next;
        self.lane.push(&truth, &self.features, moment);
        let mut pre = [0.0; 2];
        self.network
            .forward(self.isa, &self.params, &[(self.lane.view(number), false)], &mut pre)?;
        Ok(squash(&pre))
    }
}

/// Flies courses with an actor as it decides in training, without noise: an expert cannot fly otherwise.
///
/// # Errors
/// Weights of other networks.
pub fn fly_chooser(
    config: &ValueConfig,
    make: &(dyn Fn() -> Chooser + Sync),
    family: Family,
    first_seed: u64,
    flights: u64,
) -> Result<Vec<(Outcome, f64)>, CollectError> {
    (0..flights)
        .into_par_iter()
        .map_init(make, |chooser, i| {
            chooser.reset();
            let limit_s = config.evaluation.time_limit_s;
            let mut flight = TrueFlight::new(config, family, first_seed + i, limit_s)?;
            loop {
                let [forward_m_s, yaw] = chooser.choose(&mut flight)?;
                if let (_, Some(outcome)) = flight.decide(config, Action { forward_m_s, yaw }) {
                    return Ok((outcome, flight.flight.time_s()));
                }
            }
        })
        .collect()
}

/// How well the critics' word agrees with the flights'.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SlopeReport {
    /// States compared.
    pub states: usize,
    /// Pearson correlation over all states and yaw values of the critics' values with the returns, each less its state's mean.
    pub value_correlation: f64,
    /// Spearman correlation over the states of the critics' slope over yaw with that of the returns.
    pub slope_correlation: f64,
    /// Of the states in which yaw matters, the share in which both slopes have the same sign.
    pub sign_agreement: f64,
}

struct Compared {
    truth: [f32; TRUE_STATE],
    position: PositionalInputs,
    action: [f32; 2],
    returns: [f32; 5],
    yaws: [f32; 5],
}

/// Compares at `config.evaluation.slope_states` states, in the current thread pool.
///
/// # Errors
/// None with weights of the right networks.
pub fn slope_against_truth(
    config: &ValueConfig,
    learner: &mut ValueLearner,
    make: &(dyn Fn() -> Chooser + Sync),
) -> Result<SlopeReport, CollectError> {
    let found = (0..config.evaluation.slope_states)
        .into_par_iter()
        .map_init(make, |chooser, i| branch(config, chooser, i))
        .collect::<Result<Vec<_>, CollectError>>()?;
    let mut states = Vec::new();
    for (compared, last) in found.into_iter().flatten() {
        let mut returns = compared.returns;
        for (value, last) in returns.iter_mut().zip(&last) {
            // Flights that went on are worth what the critics say of where they got to.
            if let Some((truth, position, action, discount)) = last {
                *value += discount * learner.slope(truth, position, *action)?.0;
            }
        }
        states.push(Compared { returns, ..compared });
    }
    let (mut said, mut flown) = (Vec::new(), Vec::new());
    let (mut slopes_said, mut slopes_flown) = (Vec::new(), Vec::new());
    let (mut same, mut matter) = (0, 0);
    for c in &states {
        let mut values = [0.0; 5];
        for (value, yaw) in values.iter_mut().zip(c.yaws) {
            *value = learner.slope(&c.truth, &c.position, [c.action[0], yaw])?.0;
        }
        let (_, slope) = learner.slope(&c.truth, &c.position, c.action)?;
        let less_mean = |v: [f32; 5]| v.map(|x| f64::from(x - v.iter().sum::<f32>() / 5.0));
        said.extend(less_mean(values));
        flown.extend(less_mean(c.returns));
        let tells = regression(&c.yaws, &c.returns);
        slopes_said.push(f64::from(slope[1]));
        slopes_flown.push(f64::from(tells));
        let highest = c.returns.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let lowest = c.returns.iter().copied().fold(f32::INFINITY, f32::min);
        if highest - lowest > LEAST_SPREAD {
            matter += 1;
            same += usize::from(slope[1] * tells > 0.0);
        }
    }
    Ok(SlopeReport {
        states: states.len(),
        value_correlation: pearson(&said, &flown),
        slope_correlation: pearson(&ranks(&slopes_said), &ranks(&slopes_flown)),
        sign_agreement: f64::from(same as u32) / f64::from(matter.max(1) as u32),
    })
}

/// Where a flight that went on got to: true state, the actor's action there, what its value counts.
type Last = Option<([f32; TRUE_STATE], PositionalInputs, [f32; 2], f32)>;

/// One state: the five flights from it.
fn branch(config: &ValueConfig, chooser: &mut Chooser, i: u64) -> Result<Option<(Compared, [Last; 5])>, CollectError> {
    let seed = FIRST_SEED + i;
    let family = config.families[i as usize % config.families.len()];
    let begin = || TrueFlight::new(config, family, seed, config.evaluation.time_limit_s);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // The way to the state.
    let mut actions = Vec::new();
    let mut flight = begin()?;
    chooser.reset();
    let mut wander = OrnsteinUhlenbeck::start(&mut rng);
    while actions.len() < LATEST {
        let [forward_m_s, yaw] = chooser.choose(&mut flight)?;
        wander.step(config.noise.theta, &mut rng);
        let action = apf::add(Action { forward_m_s, yaw }, wander.at(NOISE));
        actions.push(action);
        if flight.decide(config, action).1.is_some() {
            break;
        }
    }
    if actions.len() < 3 {
        return Ok(None);
    }
    actions.truncate(rng.random_range(1..actions.len() - 1));
    let mut compared = None;
    let mut last: [Last; 5] = [None; 5];
    for (k, difference) in YAWS.into_iter().enumerate() {
        let mut flight = begin()?;
        chooser.reset();
        for action in &actions {
            chooser.choose(&mut flight)?;
            flight.decide(config, *action);
        }
        let own = chooser.choose(&mut flight)?;
        // A turn that the limit takes away is flown the other way round: always five different ones.
        let middle = own[1].clamp(-ACTION_LIMIT + 1.0, ACTION_LIMIT - 1.0);
        let state = compared.get_or_insert_with(|| Compared {
            truth: flight.state(),
            position: flight.position(),
            action: [own[0], middle],
            returns: [0.0; 5],
            yaws: YAWS.map(|d| middle + d),
        });
        let mut action = Action {
            forward_m_s: own[0],
            yaw: middle + difference,
        };
        let mut discount = 1.0;
        for n in 0..=DECISIONS_ON {
            let (reward, outcome) = flight.decide(config, action);
            state.returns[k] += discount * reward;
            discount *= config.learning.gamma;
            if outcome.is_some() {
                break;
            }
            let [forward_m_s, yaw] = chooser.choose(&mut flight)?;
            action = Action { forward_m_s, yaw };
            if n == DECISIONS_ON {
                last[k] = Some((flight.state(), flight.position(), [forward_m_s, yaw], discount));
            }
        }
    }
    Ok(compared.map(|c| (c, last)))
}

/// Slope of the least squares line.
fn regression(x: &[f32; 5], y: &[f32; 5]) -> f32 {
    let (mx, my) = (x.iter().sum::<f32>() / 5.0, y.iter().sum::<f32>() / 5.0);
    let over: f32 = x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum();
    over / x.iter().map(|x| (x - mx) * (x - mx)).sum::<f32>()
}

fn pearson(x: &[f64], y: &[f64]) -> f64 {
    let n = x.len().max(1) as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let product =
        |a: &[f64], ma: f64, b: &[f64], mb: f64| -> f64 { a.iter().zip(b).map(|(a, b)| (a - ma) * (b - mb)).sum() };
    let spread = (product(x, mx, x, mx) * product(y, my, y, my)).sqrt();
    if spread > 0.0 {
        product(x, mx, y, my) / spread
    } else {
        0.0
    }
}

fn ranks(x: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
    let mut ranks = vec![0.0; x.len()];
    for (rank, i) in order.into_iter().enumerate() {
        ranks[i] = rank as f64;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlations_are_those_of_the_textbook() {
        assert!((pearson(&[1.0, 2.0, 3.0], &[2.0, 4.0, 6.0]) - 1.0).abs() < 1e-12);
        assert!((pearson(&[1.0, 2.0, 3.0], &[1.0, 0.0, 1.0])).abs() < 1e-12);
        assert_eq!(pearson(&[1.0, 1.0], &[0.0, 1.0]), 0.0);
        assert_eq!(ranks(&[3.0, -1.0, 10.0]), vec![1.0, 0.0, 2.0]);
        assert!((regression(&[-1.0, -0.5, 0.0, 0.5, 1.0], &[-2.0, -1.0, 0.0, 1.0, 2.0]) - 2.0).abs() < 1e-6);
    }
}
