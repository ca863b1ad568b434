//! What happens in a flight that is gathered: course, weather, who steers, who attacks.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use vigil_adversary::{AttackConfig, Method, Towards};
use vigil_sim::world::Family;

/// Who steers. The actor decides in each step, whichever pilot steers, since its decision is what is explained.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Plan {
    /// The actor alone.
    Actor,
    /// The actor with the potential field added.
    ActorWithField,
    /// The geometric pilot, on the same frames.
    Geometric,
    /// What a recovery does: the actor until `delay` frames were altered, `hover` steps of hovering, then the geometric pilot
    /// until `trust` frames in a row were not altered.
    Recovering {
        /// Altered frames until it stops.
        delay: u64,
        /// Steps of hovering.
        hover: u64,
        /// Unaltered frames until the actor flies again.
        trust: u64,
    },
    /// Actor, geometric pilot and hovering in turns of drawn lengths.
    Switching,
}

/// Who steers in one step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Helm {
    Actor { field: bool },
    Geometric,
    Hover,
}

/// Who alters frames, and when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Adversary {
    /// How.
    pub config: AttackConfig,
    /// Steps in which frames are altered, in order.
    pub bursts: Vec<Range<u64>>,
}

impl Adversary {
    /// Bursts of `length` steps until `last`, the first and the gaps between them drawn.
    pub fn in_bursts(config: AttackConfig, length: u64, last: u64, rng: &mut impl Rng) -> Self {
        let mut bursts = Vec::new();
        let mut step = rng.random_range(10..70);
        while step < last {
            bursts.push(step..(step + length).min(last));
            step += length + rng.random_range(15..60);
        }
        Self { config, bursts }
    }

    /// Whether a step's frame is altered.
    pub fn attacks(&self, step: u64) -> bool {
        self.bursts.iter().any(|burst| burst.contains(&step))
    }
}

/// One flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scenario {
    /// Family of the course.
    pub family: Family,
    /// Seed of course and noise.
    pub seed: u64,
    /// Who steers.
    pub plan: Plan,
    /// Mean wind towards north and east, and gusts, m/s.
    pub wind_m_s: [f64; 3],
    /// The LiDAR's noise and dropouts over its usual ones.
    pub range_noise: f32,
    /// Who alters frames.
    pub adversary: Option<Adversary>,
    /// The flight is cut off after so many steps.
    pub steps: u64,
    /// ... or after so many altered frames.
    pub altered: u64,
}

impl Scenario {
    /// Calm air, the usual LiDAR, no altered frames.
    pub fn unattacked(family: Family, seed: u64, plan: Plan) -> Self {
        Self {
            family,
            seed,
            plan,
            wind_m_s: [0.0; 3],
            range_noise: 1.0,
            adversary: None,
            steps: MAX_STEPS,
            altered: u64::MAX,
        }
    }

    /// Draws a flight for training, attacked or not. Everything follows from the seed.
    pub fn drawn(seed: u64, attacked: bool) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // What the actor remembers before a dead end is as much its everyday as what it remembers in the open.
        let family = match rng.random_bool(0.5) {
            true => Family::Hard,
            false => Family::Training,
        };
        let plan = match rng.random_range(0..100) {
            0..30 => Plan::Actor,
            30..45 => Plan::ActorWithField,
            45..60 => Plan::Geometric,
            60..85 => Plan::Recovering {
                delay: rng.random_range(1..8),
                hover: rng.random_range(10..40),
                trust: rng.random_range(5..40),
            },
            _ => Plan::Switching,
        };
        let mut scenario = Self::unattacked(family, seed, plan);
        if rng.random_bool(0.3) {
            let speed = rng.random_range(0.5..3.0);
            let towards = rng.random_range(0.0..core::f64::consts::TAU);
            scenario.wind_m_s = [speed * libm::cos(towards), speed * libm::sin(towards), 0.2 * speed];
        }
        if rng.random_bool(0.3) {
            scenario.range_noise = rng.random_range(0.5..2.5);
        }
        let towards = [Towards::Left, Towards::Right, Towards::Away][rng.random_range(0..3)];
        // Fewer iterations with a larger ε reach as far as the paper's twenty with 1, and are gathered faster.
        let (iterations, share) = [(5, 4.0), (10, 2.0), (10, 2.0), (20, 1.0)][rng.random_range(0..4)];
        let method = match (attacked, rng.random_range(0..100)) {
            // Noise is no attack: a share of the other flights has it, so that what is only unusual is not taken for one.
            (false, 0..30) => Some((Method::Noise, share * [0.25, 0.5, 1.0, 1.0][rng.random_range(0..4)])),
            (false, _) => None,
            (true, 0..60) => Some((
                Method::BimAccumulating,
                share * [0.25, 0.5, 1.0, 1.0, 1.0, 2.0][rng.random_range(0..6)],
            )),
            (true, 60..75) => Some((Method::BimClipped, [1.0, 2.0, 5.0, 10.0][rng.random_range(0..4)])),
            (true, 75..90) => Some((Method::Fgsm, [2.0, 5.0, 10.0, 20.0][rng.random_range(0..4)])),
            (true, _) => Some((Method::Patch, [2.0, 5.0, 5.0, 10.0][rng.random_range(0..4)])),
        };
        scenario.adversary = method.map(|(method, epsilon_255)| {
            let config = AttackConfig {
                method,
                epsilon_255,
                iterations,
                towards,
                seed,
                ..AttackConfig::PAPER
            };
            let length = [3, 5, 10, 20, 50, 100, MAX_STEPS][rng.random_range(0..7)];
            Adversary::in_bursts(config, length, MAX_STEPS, &mut rng)
        });
        scenario.altered = MAX_ALTERED;
        scenario
    }

    /// Who steers, step by step.
    pub(crate) fn helmsman(&self) -> Helmsman {
        Helmsman {
            plan: self.plan,
            rng: ChaCha8Rng::seed_from_u64(self.seed ^ 0x4845_4c4d),
            helm: match self.plan {
                Plan::Geometric => Helm::Geometric,
                Plan::ActorWithField => Helm::Actor { field: true },
                _ => Helm::Actor { field: false },
            },
            until: 0,
            altered: 0,
            unaltered: 0,
        }
    }
}

/// Longest flight, in steps: 30 s.
pub const MAX_STEPS: u64 = 600;
/// Altered frames after which a flight for training is cut off, so that the data come from many flights.
const MAX_ALTERED: u64 = 80;

/// Carries out a plan.
pub(crate) struct Helmsman {
    plan: Plan,
    rng: ChaCha8Rng,
    helm: Helm,
    /// Step at which the helm changes.
    until: u64,
    /// Altered frames since the last unaltered one, and the other way round.
    altered: u64,
    unaltered: u64,
}

impl Helmsman {
    pub fn take(&mut self, step: u64, altered: bool) -> Helm {
        (self.altered, self.unaltered) = match altered {
            true => (self.altered + 1, 0),
            false => (0, self.unaltered + 1),
        };
        match self.plan {
            Plan::Actor | Plan::ActorWithField | Plan::Geometric => {}
            Plan::Recovering { delay, hover, trust } => match self.helm {
                Helm::Actor { .. } if self.altered >= delay => {
                    self.helm = Helm::Hover;
                    self.until = step + hover;
                }
                Helm::Hover if step >= self.until => self.helm = Helm::Geometric,
                Helm::Geometric if self.unaltered >= trust => self.helm = Helm::Actor { field: false },
                _ => {}
            },
            Plan::Switching if step >= self.until => {
                let (helm, steps) = match self.rng.random_range(0..5) {
                    0 | 1 => (Helm::Actor { field: false }, 20..100),
                    2 | 3 => (Helm::Geometric, 20..100),
                    _ => (Helm::Hover, 5..30),
                };
                self.helm = helm;
                self.until = step + self.rng.random_range(steps);
            }
            Plan::Switching => {}
        }
        self.helm
    }
}
