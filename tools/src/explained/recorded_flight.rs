//! A flight flown and written down.

use super::scenario::{Adversary, Helm, Plan, Scenario};
use super::stepped::Flight;
use anyhow::Result;
use serde::{Deserialize, Serialize};
use vigil_adversary::{FrameAttack, Method};
use vigil_guidance::ROUGH_BELOW;
use vigil_nnet::Isa;
use vigil_policy::actor::memory::SCAN_AGES;
use vigil_policy::actor::{ACTOR_OUTPUTS, LowDim};
use vigil_policy::imported::Channels;
use vigil_policy::plausibility::smooth_share_of;
use vigil_policy::{Decider, FlightField, FrozenPilot, GeometricConfig, GeometricPilot, Pilot, PilotInput, RangeScan};
use vigil_sim::environment::Environment;
use vigil_sim::vehicle::{VehicleParams, Wind};
use vigil_sim::world::{LidarConfig, Outcome, generate};
use vigil_types::{Action, DepthFrame};

/// Whether a step's frame was altered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// Delivered as taken.
    Unaltered,
    /// Altered by an attack.
    Attacked,
    /// Altered at random: the control.
    Noisy,
}

/// One step: the actor's decision, whichever pilot steered.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Values at the split point: our actor's 48.
    pub state: Vec<f32>,
    /// What it decided from beside them: the low-dimensional observation, or an imported policy's goal.
    pub low_dim: LowDim,
    /// The actor's outputs, without field.
    pub output: [f32; ACTOR_OUTPUTS],
    /// Whether the frame was altered.
    pub frame: Frame,
    /// Change of the yaw output by the attack; 0 where the frame was not altered.
    pub yaw_change: f32,
    /// Whether the frame is a rough picture, by the guard's measure.
    pub rough: bool,
}

/// A flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// What was flown.
    pub scenario: Scenario,
    /// How many steps ago each frame was taken that a decision holds ([`held_frames`]), oldest first.
    pub frame_ages: Vec<usize>,
    /// How it ended; `None` when it was cut off.
    pub outcome: Option<Ending>,
    /// Its steps.
    pub steps: Vec<Step>,
}

/// How a flight ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// At the goal.
    Goal,
    /// Any other way.
    Failed,
}

impl Record {
    /// Altered frames among the last `count` up to a step.
    pub fn altered_of_last(&self, step: usize, count: usize) -> usize {
        let from = (step + 1).saturating_sub(count);
        let recent = self.steps.get(from..=step).unwrap_or_default();
        recent.iter().filter(|s| s.frame != Frame::Unaltered).count()
    }
}

/// What an onlooker is shown of a step.
pub struct Shown<'a> {
    /// What was decided on, with the frame as it was delivered.
    pub input: PilotInput<'a>,
    /// The frame as it was taken.
    pub taken: &'a DepthFrame,
    /// The pilot as of its decision.
    pub pilot: &'a Decider,
}

impl Shown<'_> {
    /// The actor's inputs in this step, as [`vigil_policy::actor::ActorSpec::graph`] takes them; `None` of an imported policy.
    pub fn inputs<'a>(&'a self, step: &'a Step) -> Option<[&'a [f32]; 3]> {
        match self.pilot {
            Decider::Actor(actor) => Some([&self.input.depth.depth, actor.context(), &step.low_dim]),
            Decider::Imported(_) => None,
        }
    }
}

/// What looks on while flying: called once a step, in order; its error ends the flight.
pub type Onlooker<'a> = &'a mut dyn FnMut(&Step, &Shown<'_>) -> Result<()>;

/// How many steps ago each frame was taken that a decision holds, oldest first: our actor's newest and older scans, an imported policy's
/// channels. What our actor remembers of surfaces out of view is made of many frames and not counted.
pub fn held_frames(pilot: &FrozenPilot) -> Vec<usize> {
    match pilot {
        FrozenPilot::Actor(_) => SCAN_AGES.into_iter().chain([0]).collect(),
        FrozenPilot::Imported(policy) => match policy.inputs.order {
            Channels::Stack => (0..policy.inputs.channels).rev().collect(),
            Channels::Repeat => vec![0],
        },
    }
}

fn flight_of(scenario: &Scenario) -> Result<Flight> {
    let mut course = generate(scenario.family, scenario.seed);
    course.time_limit_s = 90.0;
    let usual = LidarConfig::default();
    let lidar = LidarConfig {
        range_noise_sigma_m: usual.range_noise_sigma_m * scenario.range_noise,
        dropout_probability: usual.dropout_probability * scenario.range_noise,
        ..usual
    };
    let [north, east, gust_m_s] = scenario.wind_m_s;
    let wind = Wind {
        mean_ned_m_s: [north, east, 0.0],
        gust_m_s,
        ..Wind::CALM
    };
    let environment = Environment::of(&course, VehicleParams::default(), wind, lidar, scenario.seed)?;
    Ok(Flight::of(environment))
}

/// Alters the frame that is delivered, where the adversary attacks in this step; by how much that changes the yaw.
fn alter(
    adversary: &Adversary,
    attack: &mut FrameAttack,
    step: u64,
    taken: &PilotInput<'_>,
    delivered: &mut DepthFrame,
) -> Result<(Frame, f32)> {
    if !adversary.attacks(step) {
        attack.pass(taken)?;
        return Ok((Frame::Unaltered, 0.0));
    }
    let yaw_change = attack.attack_while(taken, delivered, || true)?.yaw_change();
    let frame = match adversary.config.method {
        Method::Noise => Frame::Noisy,
        _ => Frame::Attacked,
    };
    Ok((frame, yaw_change))
}

/// Flies a scenario with an actor. The same arguments give the same bits.
///
/// # Errors
/// Parameters of another architecture, wind or attack out of range.
pub fn fly(isa: Isa, frozen: &FrozenPilot, scenario: &Scenario, onlooker: Onlooker<'_>) -> Result<Record> {
    let mut flight = flight_of(scenario)?;
    let mut actor = frozen.decider(isa)?;
    let adversary = scenario.adversary.as_ref();
    let attacker = adversary.map(|by| anyhow::Ok((by, FrameAttack::on(frozen, isa, &by.config)?)));
    let mut attack = attacker.transpose()?;
    let mut helmsman = scenario.helmsman();
    // In any other plan the geometric pilot may steer at some time.
    let mut geometric = (!matches!(scenario.plan, Plan::Actor | Plan::ActorWithField))
        .then(|| Box::new(GeometricPilot::new(GeometricConfig::default())));
    let mut surroundings = Box::new(RangeScan::new());
    let mut field = FlightField::default();
    let mut delivered = Box::new(flight.frame().clone());
    let mut record = Record {
        frame_ages: held_frames(frozen),
        scenario: scenario.clone(),
        outcome: None,
        steps: Vec::new(),
    };
    let mut altered = 0;
    for number in 0..scenario.steps {
        (*delivered).clone_from(flight.frame());
        let (frame, yaw_change) = match &mut attack {
            Some((adversary, attack)) => alter(adversary, attack, number, &flight.input(), &mut delivered)?,
            None => (Frame::Unaltered, 0.0),
        };
        altered += u64::from(frame != Frame::Unaltered);
        let input = PilotInput {
            depth: &delivered,
            ..flight.input()
        };
        let output = actor.decide(&input)?;
        let [forward_m_s, yaw] = output;
        let own = Action { forward_m_s, yaw };
        let geometric = geometric.as_mut().map(|pilot| pilot.decide(&input));
        let helm = helmsman.take(number, frame != Frame::Unaltered);
        let action = match helm {
            Helm::Actor { field: false } => own,
            Helm::Actor { field: true } => field.add_to(own, actor.unit_m_s(), &input, surroundings.observe(&input)),
            Helm::Geometric => geometric.unwrap_or(Action::HOVER),
            Helm::Hover => Action::HOVER,
        };
        let step = Step {
            state: actor.state().to_vec(),
            // There is one behind a decision.
            low_dim: actor.low_dim().unwrap_or_else(|| LowDim::of_goal(input.goal)),
            output,
            frame,
            yaw_change,
            rough: smooth_share_of(&delivered).is_some_and(|share| share < ROUGH_BELOW),
        };
        let shown = Shown {
            input,
            taken: flight.frame(),
            pilot: &actor,
        };
        onlooker(&step, &shown)?;
        // As in flight, it knows of what was added to its action, not of what others did.
        if let (Helm::Actor { field: true }, Decider::Actor(actor)) = (helm, &mut actor) {
            actor.note_action(action);
        }
        record.steps.push(step);
        if altered >= scenario.altered {
            break;
        }
        if let Some(outcome) = flight.advance(action) {
            record.outcome = Some(match outcome {
                Outcome::Success => Ending::Goal,
                _ => Ending::Failed,
            });
            break;
        }
    }
    Ok(record)
}
