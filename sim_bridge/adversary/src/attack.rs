//! Which attack is flown against: the arguments that campaigns, live flights and the adversary's own process share.

use crate::{AttackConfig, AttackError, AttackOutcome, Burst, FrameAttack, Interceptor, Method, Towards};
use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use vigil_detector::FrozenDetector;
use vigil_nnet::Isa;
use vigil_policy::FrozenPilot;
use vigil_types::NedVector;

/// An attack on the frames as they pass.
#[derive(Debug, Clone, clap::Args)]
pub struct AttackArgs {
    /// Alter the depth frames between the sensor and the firmware (docs/adversary.md).
    #[arg(long, value_enum, value_name = "METHOD")]
    pub attack: Option<Method>,

    /// Size of the attack in 1/255 of the image's range of 100 m.
    #[arg(long, value_name = "N", default_value_t = AttackConfig::PAPER.epsilon_255, requires = "attack")]
    pub epsilon: f32,

    /// Iterations of the attack on each frame.
    #[arg(long, value_name = "N", default_value_t = AttackConfig::PAPER.iterations, requires = "attack")]
    pub iterations: u32,

    /// Steps attacked, once in a flight at a moment drawn from its seed, or `continuous`.
    #[arg(long, value_name = "STEPS|continuous", default_value = "50", requires = "attack")]
    pub burst: Burst,

    /// The yaw limit aimed at; `away` is the one farther from the clean decision.
    #[arg(long, value_enum, default_value_t = AttackConfig::PAPER.towards, requires = "attack")]
    pub towards: Towards,

    /// The actor whose weights the attacker has [default: the one that flies].
    #[arg(long, value_name = "FILE", requires = "attack")]
    pub attack_actor: Option<PathBuf>,

    /// Adaptive: deceive this detector as well.
    #[arg(long, value_name = "FILE", requires = "attack")]
    pub evade: Option<PathBuf>,

    /// Pixels of squares of this side move together, so that what shows one surface goes on showing one.
    #[arg(long, value_name = "PIXELS", default_value_t = AttackConfig::PAPER.region_pixels, requires = "attack")]
    pub region: u32,

    /// Adaptive: stay within what the guard lets pass.
    #[arg(long, requires = "attack")]
    pub evade_guard: bool,

    /// Adaptive: leave what lies within so many degrees of the nose as it is, where a second sensor looks.
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, requires = "attack")]
    pub truthful_ahead: f32,
}

impl Default for AttackArgs {
    fn default() -> Self {
        #[derive(clap::Parser)]
        struct Given {
            #[command(flatten)]
            attack: AttackArgs,
        }
        <Given as clap::Parser>::parse_from([""]).attack
    }
}

impl AttackArgs {
    /// The attack, if one is asked for. `flown` is the file of the actor that flies, if it is not the built-in one.
    ///
    /// # Errors
    /// A file that is no actor or no detector, a detector of another actor; a number out of range.
    pub fn attack(&self, flown: Option<&Path>) -> Result<Option<Attack>> {
        let Some(method) = self.attack else { return Ok(None) };
        let config = AttackConfig {
            method,
            epsilon_255: self.epsilon,
            iterations: self.iterations,
            towards: self.towards,
            seed: 0,
            region_pixels: self.region,
            truthful_ahead_deg: self.truthful_ahead,
        };
        config.check()?;
        let pilot = FrozenPilot::load_or_built_in(self.attack_actor.as_deref().or(flown))?;
        let evade = self.evade.as_deref().map(FrozenDetector::load).transpose()?;
        if let Some(detector) = &evade {
            let (expected, found) = (&detector.actor_sha256, pilot.sha256());
            ensure!(
                *expected == found,
                "--evade: the detector judges the actor with SHA-256 {expected}, the attacked one has {found}"
            );
        }
        Ok(Some(Attack {
            pilot,
            config,
            burst: self.burst,
            evade,
            evades_guard: self.evade_guard,
        }))
    }

    /// The arguments again, for another process.
    pub fn hand_on(&self, command: &mut std::process::Command) {
        let Some(method) = self.attack else { return };
        command.args(["--attack", method.name(), "--towards", self.towards.name()]);
        for (name, value) in [
            ("epsilon", self.epsilon.to_string()),
            ("iterations", self.iterations.to_string()),
            ("burst", self.burst.to_string()),
            ("region", self.region.to_string()),
            ("truthful-ahead", self.truthful_ahead.to_string()),
        ] {
            command.arg(format!("--{name}={value}"));
        }
        for (name, file) in [("--attack-actor", &self.attack_actor), ("--evade", &self.evade)] {
            if let Some(file) = file {
                command.arg(name).arg(file);
            }
        }
        command.args(self.evade_guard.then_some("--evade-guard"));
    }
}

/// An attack that many flights can be flown against.
#[derive(Debug, Clone)]
pub struct Attack {
    /// The pilot whose weights the attacker has.
    pub pilot: FrozenPilot,
    /// How; the seed is each flight's own.
    pub config: AttackConfig,
    /// How long.
    pub burst: Burst,
    /// The detector to deceive along with the actor.
    pub evade: Option<FrozenDetector>,
    /// The guard is to stay silent as well.
    pub evades_guard: bool,
}

impl Attack {
    /// The adversary of one flight. Its seed decides when it attacks and what it draws.
    ///
    /// # Errors
    /// ε or iterations out of range, a detector that does not fit.
    pub fn interceptor(&self, seed: u64, goal_ned_m: NedVector) -> Result<Interceptor, AttackError> {
        let config = AttackConfig { seed, ..self.config };
        let attack = match (FrameAttack::on(&self.pilot, Isa::detect(), &config)?, &self.evade) {
            (FrameAttack::Actor(attack), Some(detector)) => FrameAttack::Actor(attack.evading(detector)?),
            (FrameAttack::Policy(_), Some(_)) => return Err(AttackError::EvadingPolicy),
            (attack, None) => attack,
        };
        let interceptor = Interceptor::new(attack, self.burst.steps(seed), goal_ned_m);
        match self.evades_guard {
            true => interceptor.evading_guard(),
            false => Ok(interceptor),
        }
    }
}

/// What an attack did in one flight.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct AttackRecord {
    /// The first step attacked; absent when the flight ended before.
    pub first_step: Option<u64>,
    /// Steps attacked.
    pub attacked_steps: u64,
    /// Steps whose yaw moved by 1.0 or more (30 °/s).
    pub effective_steps: u64,
    /// Mean of the yaw output's absolute change over the attacked steps.
    pub mean_yaw_change: f64,
}

impl AttackRecord {
    /// Takes a step into account; `None` of a frame that was not altered.
    pub fn observe(&mut self, step: u64, attacked: Option<&AttackOutcome>) {
        let Some(outcome) = attacked else { return };
        self.first_step.get_or_insert(step);
        self.attacked_steps += 1;
        self.effective_steps += u64::from(outcome.is_effective());
        let change = f64::from(outcome.yaw_change().abs());
        self.mean_yaw_change += (change - self.mean_yaw_change) / self.attacked_steps as f64;
    }
}
