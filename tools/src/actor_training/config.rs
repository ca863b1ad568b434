//! What a training run is made of: a TOML file whose every key is optional and whose unknown keys are refused.

use crate::actor_training::limits::{self, Limits};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use vigil_policy::{GeometricConfig, GeometricPilot};
use vigil_types::DEPTH_PIXELS;

/// Most memory that the frames of the replay memory may take.
const LARGEST_MEMORY: u64 = 64 << 30;
/// Most flights that an evaluation may have.
const MOST_FLIGHTS: usize = 1_000_000;

/// A training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Fixes courses, noise, initial weights and samples: the same seed trains the same actor, bit for bit, on machines
    /// with the same instruction set.
    pub seed: u64,
    /// Decisions after which training ends.
    pub decisions: u64,
    /// Flights at the same time.
    pub environments: usize,
    /// Threads; any number trains the same actor.
    pub threads: usize,
    /// Steps of 0.05 s that a decision lasts while training; the frozen actor decides every step.
    pub steps_per_decision: usize,
    /// A training flight is cut off after this time, seconds. The value of its last state still counts.
    pub time_limit_s: f32,
    /// Half of the training flights have a mean wind of up to this, metres per second, with gusts.
    pub wind_m_s: f64,
    /// The geometric pilot that warms up and is imitated.
    pub teacher: Teacher,
    /// The first decisions.
    pub warm_up: WarmUp,
    /// Exploration.
    pub noise: NoiseConfig,
    /// The potential field in training.
    pub apf: ApfConfig,
    /// Reward.
    pub reward: RewardConfig,
    /// Updates.
    pub learning: LearningConfig,
    /// Replay memory.
    pub replay: ReplayConfig,
    /// Flights that judge the actor.
    pub evaluation: EvaluationConfig,
}

/// Which geometric pilot teaches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Teacher {
    /// One that decides by the newest frame: the actor sees all that it decides by.
    Memoryless,
    /// The one that flies, with its map of where it has been, which the actor does not have.
    Mapping,
}

impl Teacher {
    pub(crate) fn pilot(self) -> GeometricPilot {
        let config = GeometricConfig::default();
        match self {
            Self::Memoryless => GeometricPilot::teacher(config),
            Self::Mapping => GeometricPilot::new(config),
        }
    }
}

/// Who flies while the memory fills.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WarmUpPilot {
    /// The geometric pilot with noise.
    Geometric,
    /// Noise alone, as in the paper.
    Noise,
}

/// Filling the memory before the first update.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WarmUp {
    /// Decisions (the paper: 5 000).
    pub decisions: u64,
    /// Who flies.
    pub pilot: WarmUpPilot,
    /// Updates on what was gathered, before the actor flies. With an imitation, it alone trains the actor in these.
    pub updates: u64,
    /// Adam's rate for the actor in these.
    pub actor_rate: f32,
}

/// Ornstein-Uhlenbeck noise on the action, one step per decision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseConfig {
    /// Share of the noise that decays per decision.
    pub theta: f32,
    /// Standard deviation of the noise at first, action units.
    pub sigma_first: f32,
    /// Standard deviation at last.
    pub sigma_last: f32,
    /// Share of the run over which it falls linearly.
    pub falls_over: f32,
    /// Share of the flights after the warm-up that have noise. In the others the actor gets to where it takes itself, and stays
    /// where it stands still by itself.
    pub share: f64,
}

/// The potential field added to the actor's action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ApfConfig {
    /// Share of the training flights in which it is added (the paper: 1).
    pub share: f64,
    /// It takes the nearest surface within this angle of the nose, degrees.
    pub half_angle_deg: f32,
}

/// Reward: metres of progress towards the goal, and these.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RewardConfig {
    /// At the goal.
    pub success: f32,
    /// For collision and out of bounds.
    pub dead: f32,
    /// At checkpoint C of N: this times (1 + C/N) (the paper: 2).
    pub checkpoint: f32,
}

/// The updates of actor and critic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearningConfig {
    /// Discount per decision.
    pub gamma: f32,
    /// Rewards summed before the critic's value is used.
    pub n_steps: usize,
    /// Transitions in an update.
    pub batch: usize,
    /// Decisions per update.
    pub decisions_per_update: u64,
    /// Adam's rate for the actor.
    pub actor_rate: f32,
    /// Adam's rate for critic and encoder.
    pub critic_rate: f32,
    /// Share of all updates after which the rates begin to fall linearly, to a twentieth at the end; 1 keeps them.
    pub rates_fall_from: f64,
    /// Share of the weights that the target networks take over at each update.
    pub tau: f32,
    /// Longest gradient.
    pub gradient_norm: f32,
    /// Weight of the square of what exceeds 1 before the actor's last tanh.
    pub saturation_penalty: f32,
    /// Weight of the critic's value in the actor's loss after the warm-up (the paper: 1).
    pub value_weight: f32,
    /// Weight of the squared distance between the actor's action and what the geometric pilot would do, at first (the
    /// paper: 0). The pilot looks on in every training flight.
    pub imitation: f32,
    /// Distance between the two from which on it counts as it is, not squared: where the pilot may pass on either side, the
    /// actor takes one of them and not the middle. 0 counts it squared throughout.
    pub imitation_width: f32,
    /// Updates over which this weight falls linearly to 0.
    pub imitation_updates: u64,
    /// The imitation's loss trains the encoder as well.
    pub imitation_trains_encoder: bool,
    /// Frames of a state, 1 to 5, whose gradient reaches the encoder: the newest, and others drawn and weighted so that all
    /// five count on average. They are 0.05 s apart and nearly the same, and encoding backwards is what an update costs.
    pub encoder_frames: usize,
    /// Half of the sampled transitions are seen in a mirror.
    pub mirror: bool,
    /// Judge and freeze the actor's target network, a mean over the last 1/τ updates, instead of the actor itself.
    pub freeze_target: bool,
}

/// Prioritised replay.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplayConfig {
    /// Decisions kept. One takes 131 kB with four steps per decision.
    pub decisions: usize,
    /// Exponent of the priority; 0 samples evenly.
    pub alpha: f64,
    /// Exponent of the importance weights.
    pub beta: f64,
}

/// Flights without the field that judge the actor, always over the same courses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Updates between evaluations.
    pub every_updates: u64,
    /// Flights over courses of the training family.
    pub flights: u64,
    /// Flights that choose between the best actors at the end.
    pub final_flights: u64,
    /// Seed of the first course. Training itself uses seeds from 1 000 000 on.
    pub first_seed: u64,
    /// A flight that takes longer has failed, seconds.
    pub time_limit_s: f32,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            decisions: 24_000,
            environments: 8,
            threads: 1,
            steps_per_decision: 4,
            time_limit_s: 45.0,
            wind_m_s: 0.0,
            teacher: Teacher::Memoryless,
            warm_up: WarmUp::default(),
            noise: NoiseConfig::default(),
            apf: ApfConfig::default(),
            reward: RewardConfig::default(),
            learning: LearningConfig::default(),
            replay: ReplayConfig::default(),
            evaluation: EvaluationConfig::default(),
        }
    }
}

impl Default for WarmUp {
    fn default() -> Self {
        Self {
            decisions: 12_000,
            pilot: WarmUpPilot::Geometric,
            updates: 900,
            actor_rate: 1e-3,
        }
    }
}

impl Default for NoiseConfig {
    fn default() -> Self {
        Self {
            theta: 0.15,
            sigma_first: 0.8,
            sigma_last: 0.2,
            falls_over: 0.6,
            share: 0.5,
        }
    }
}

impl Default for ApfConfig {
    fn default() -> Self {
        Self {
            share: 0.25,
            half_angle_deg: 45.0,
        }
    }
}

impl Default for RewardConfig {
    fn default() -> Self {
        Self {
            success: 5.0,
            dead: -2.0,
            checkpoint: 0.0,
        }
    }
}

impl Default for LearningConfig {
    fn default() -> Self {
        Self {
            gamma: 0.97,
            n_steps: 3,
            batch: 32,
            decisions_per_update: 4,
            actor_rate: 1e-3,
            critic_rate: 5e-4,
            rates_fall_from: 0.3,
            tau: 0.005,
            gradient_norm: 5.0,
            saturation_penalty: 0.05,
            value_weight: 0.05,
            imitation: 1.0,
            imitation_width: 0.2,
            imitation_updates: 20_000,
            imitation_trains_encoder: true,
            encoder_frames: 2,
            mirror: true,
            freeze_target: false,
        }
    }
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self {
            decisions: 36_000,
            alpha: 0.6,
            beta: 0.4,
        }
    }
}

impl Default for EvaluationConfig {
    fn default() -> Self {
        Self {
            every_updates: 300,
            flights: 40,
            final_flights: 100,
            first_seed: 0,
            time_limit_s: 45.0,
        }
    }
}

/// Why a configuration is not accepted.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The parser's report with line, key and what is allowed.
    #[error("{path}: {message}")]
    Content {
        /// The file.
        path: PathBuf,
        /// The report.
        message: String,
    },
    /// A value that cannot be trained with.
    #[error("training configuration: `{key}` is {value}, allowed is {allowed}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        allowed: String,
    },
}

impl TrainConfig {
    /// Updates that belong to so many decisions.
    pub(crate) fn updates_due(&self, decisions: u64) -> u64 {
        match decisions.checked_sub(self.warm_up.decisions) {
            Some(own) => self.warm_up.updates + own / self.learning.decisions_per_update.max(1),
            None => 0,
        }
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let config: Self = limits::load(path)?;
        config.check()?;
        Ok(config)
    }

    /// Writes TOML that [`Self::load`] reads back unchanged.
    pub fn to_toml(&self) -> String {
        limits::to_toml(self)
    }

    /// Whether the geometric pilot has to decide, to fly itself or to be imitated.
    pub(crate) fn needs_pilot(&self, warm_up: bool) -> bool {
        let flies = warm_up && self.warm_up.pilot == WarmUpPilot::Geometric;
        flies || (self.learning.imitation > 0.0 && !warm_up)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first one that is not allowed.
    pub fn check(&self) -> Result<(), ConfigError> {
        const LEAST: &str = "environments x (batch + n_steps + 2) or more";
        let (l, r) = (&self.learning, &self.replay);
        let steps = l.n_steps.saturating_add(l.batch).saturating_add(2);
        let least = self.environments.saturating_mul(steps) as u64;
        // A decision keeps one frame of a byte a pixel for each of its steps.
        let frames = (r.decisions as u64).saturating_mul(self.steps_per_decision as u64);
        let memory = frames.saturating_mul(DEPTH_PIXELS as u64);
        let e = &self.evaluation;
        Limits::new()
            .some("decisions", self.decisions)
            .count("environments", self.environments, 1..=256)
            .count("threads", self.threads, 1..=256)
            .count("steps_per_decision", self.steps_per_decision, 1..=40)
            .number("time_limit_s", self.time_limit_s, 1.0..=3600.0)
            .number("wind_m_s", self.wind_m_s as f32, 0.0..=20.0)
            .least("warm_up.decisions", self.warm_up.decisions, least, LEAST)
            .number("warm_up.actor_rate", self.warm_up.actor_rate, 0.0..=1.0)
            .noise(&self.noise)
            .share("apf.share", self.apf.share)
            .number("apf.half_angle_deg", self.apf.half_angle_deg, 0.0..=180.0)
            .number("reward.success", self.reward.success, -1000.0..=1000.0)
            .number("reward.dead", self.reward.dead, -1000.0..=1000.0)
            .number("reward.checkpoint", self.reward.checkpoint, -1000.0..=1000.0)
            .number("learning.gamma", l.gamma, 0.0..=1.0)
            .count("learning.n_steps", l.n_steps, 1..=100)
            .count("learning.batch", l.batch, 1..=4096)
            .some("learning.decisions_per_update", l.decisions_per_update)
            .number("learning.actor_rate", l.actor_rate, 0.0..=1.0)
            .number("learning.critic_rate", l.critic_rate, 0.0..=1.0)
            .share("learning.rates_fall_from", l.rates_fall_from)
            .number("learning.tau", l.tau, 0.0..=1.0)
            .number("learning.gradient_norm", l.gradient_norm, 1e-6..=1e9)
            .number("learning.saturation_penalty", l.saturation_penalty, 0.0..=1e6)
            .number("learning.value_weight", l.value_weight, 0.0..=1e6)
            .number("learning.imitation", l.imitation, 0.0..=1e6)
            .number("learning.imitation_width", l.imitation_width, 0.0..=10.0)
            .count("learning.encoder_frames", l.encoder_frames, 1..=5)
            .least("replay.decisions", r.decisions as u64, least, LEAST)
            .that(
                "replay.decisions",
                r.decisions as f64,
                memory <= LARGEST_MEMORY,
                "at most as many as fit 64 GiB: decisions x steps_per_decision x 32 KiB",
            )
            .share("replay.alpha", r.alpha)
            .share("replay.beta", r.beta)
            .some("evaluation.every_updates", e.every_updates)
            .count("evaluation.flights", e.flights as usize, 0..=MOST_FLIGHTS)
            .count("evaluation.final_flights", e.final_flights as usize, 0..=MOST_FLIGHTS)
            .end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<TrainConfig, String> {
        let config: TrainConfig = toml::from_str(text).map_err(|e| e.to_string())?;
        config.check().map_err(|e| e.to_string())?;
        Ok(config)
    }

    #[test]
    fn an_empty_file_is_the_default_which_survives_its_own_toml() {
        assert_eq!(load(""), Ok(TrainConfig::default()));
        assert_eq!(load(&TrainConfig::default().to_toml()), Ok(TrainConfig::default()));
    }

    #[test]
    fn what_is_not_accepted_is_told_with_its_key() {
        for (text, expected) in [
            ("seed = 1\ndecision = 5", "decision"),
            ("[learning]\ngama = 0.9", "gama"),
            ("[learning]\ngamma = 1.5", "`learning.gamma` is 1.5"),
            ("[learning]\ntau = nan", "learning.tau"),
            ("[warm_up]\npilot = \"human\"", "geometric"),
            ("environments = 0", "`environments` is 0"),
            ("[replay]\ndecisions = 10", "replay.decisions"),
            ("[replay]\ndecisions = 1000000000000", "64 GiB"),
            ("[evaluation]\nflights = 1000000000000", "`evaluation.flights`"),
            ("environments = 18446744073709551615", "environments"),
        ] {
            let error = load(text).unwrap_err();
            assert!(error.contains(expected), "{text}\n{error}");
        }
    }
}
