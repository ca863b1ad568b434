//! What a training run is made of: a TOML file whose every key is optional and whose unknown keys are refused.

use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use vigil_policy::{GeometricConfig, GeometricPilot};
use vigil_types::DEPTH_PIXELS;

/// A training file has a page or two.
const SIZE_LIMIT: u64 = 1 << 20;
/// Most memory that the frames of the replay memory may take.
const LARGEST_MEMORY: u64 = 64 << 30;
/// Most flights that an evaluation may have.
const MOST_FLIGHTS: u64 = 1_000_000;

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
        allowed: &'static str,
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
        let text = vigil_files::read_text(path, SIZE_LIMIT).map_err(|source| ConfigError::Read {
            path: path.to_owned(),
            source,
        })?;
        let config: Self = toml::from_str(&text).map_err(|e| ConfigError::Content {
            path: path.to_owned(),
            message: e.to_string(),
        })?;
        config.check()?;
        Ok(config)
    }

    /// Writes TOML that [`Self::load`] reads back unchanged.
    pub fn to_toml(&self) -> String {
        // Plain maps and numbers; serialisation fails for other types only.
        toml::to_string(self).unwrap_or_default()
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
        let (l, r, n) = (&self.learning, &self.replay, &self.noise);
        let least_memory = self.environments as f64 * (l.n_steps as f64 + l.batch as f64 + 2.0);
        // A decision keeps one frame of a byte a pixel for each of its steps.
        let frames = (r.decisions as u64).saturating_mul(self.steps_per_decision as u64);
        let memory = frames.saturating_mul(DEPTH_PIXELS as u64);
        let checks: [(&'static str, f64, bool, &'static str); 39] = [
            ("decisions", self.decisions as f64, self.decisions > 0, "1 or more"),
            (
                "environments",
                self.environments as f64,
                (1..=256).contains(&self.environments),
                "1 to 256",
            ),
            (
                "threads",
                self.threads as f64,
                (1..=256).contains(&self.threads),
                "1 to 256",
            ),
            (
                "steps_per_decision",
                self.steps_per_decision as f64,
                (1..=40).contains(&self.steps_per_decision),
                "1 to 40",
            ),
            number("time_limit_s", self.time_limit_s, 1.0, 3600.0, "1 to 3600"),
            number("wind_m_s", self.wind_m_s as f32, 0.0, 20.0, "0 to 20"),
            (
                "learning.rates_fall_from",
                l.rates_fall_from,
                (0.0..=1.0).contains(&l.rates_fall_from),
                "0 to 1",
            ),
            (
                "warm_up.decisions",
                self.warm_up.decisions as f64,
                self.warm_up.decisions as f64 >= least_memory,
                "environments x (batch + n_steps + 2) or more",
            ),
            number("noise.theta", n.theta, 0.001, 1.0, "0.001 to 1"),
            number("noise.sigma_first", n.sigma_first, 0.0, 10.0, "0 to 10"),
            number("noise.sigma_last", n.sigma_last, 0.0, 10.0, "0 to 10"),
            number("noise.falls_over", n.falls_over, 0.001, 1.0, "0.001 to 1"),
            ("noise.share", n.share, (0.0..=1.0).contains(&n.share), "0 to 1"),
            number("apf.share", self.apf.share as f32, 0.0, 1.0, "0 to 1"),
            number("apf.half_angle_deg", self.apf.half_angle_deg, 0.0, 180.0, "0 to 180"),
            number("reward.success", self.reward.success, -1000.0, 1000.0, "-1000 to 1000"),
            number("reward.dead", self.reward.dead, -1000.0, 1000.0, "-1000 to 1000"),
            number(
                "reward.checkpoint",
                self.reward.checkpoint,
                -1000.0,
                1000.0,
                "-1000 to 1000",
            ),
            number("learning.gamma", l.gamma, 0.0, 1.0, "0 to 1"),
            (
                "learning.n_steps",
                l.n_steps as f64,
                (1..=100).contains(&l.n_steps),
                "1 to 100",
            ),
            (
                "learning.batch",
                l.batch as f64,
                (1..=4096).contains(&l.batch),
                "1 to 4096",
            ),
            (
                "learning.decisions_per_update",
                l.decisions_per_update as f64,
                l.decisions_per_update > 0,
                "1 or more",
            ),
            (
                "learning.encoder_frames",
                l.encoder_frames as f64,
                (1..=5).contains(&l.encoder_frames),
                "1 to 5",
            ),
            number("learning.actor_rate", l.actor_rate, 0.0, 1.0, "0 to 1"),
            number("learning.critic_rate", l.critic_rate, 0.0, 1.0, "0 to 1"),
            number("learning.tau", l.tau, 0.0, 1.0, "0 to 1"),
            number("learning.gradient_norm", l.gradient_norm, 1e-6, 1e9, "above 0"),
            number("warm_up.actor_rate", self.warm_up.actor_rate, 0.0, 1.0, "0 to 1"),
            (
                "evaluation.every_updates",
                self.evaluation.every_updates as f64,
                self.evaluation.every_updates > 0,
                "1 or more",
            ),
            number(
                "learning.saturation_penalty",
                l.saturation_penalty,
                0.0,
                1e6,
                "0 or more",
            ),
            number("learning.value_weight", l.value_weight, 0.0, 1e6, "0 or more"),
            number("learning.imitation", l.imitation, 0.0, 1e6, "0 or more"),
            number("learning.imitation_width", l.imitation_width, 0.0, 10.0, "0 to 10"),
            (
                "replay.decisions",
                r.decisions as f64,
                r.decisions as f64 >= least_memory,
                "environments x (batch + n_steps + 2) or more",
            ),
            (
                "replay.decisions",
                r.decisions as f64,
                memory <= LARGEST_MEMORY,
                "at most as many as fit 64 GiB: decisions x steps_per_decision x 32 KiB",
            ),
            (
                "evaluation.flights",
                self.evaluation.flights as f64,
                self.evaluation.flights <= MOST_FLIGHTS,
                "0 to 1000000",
            ),
            (
                "evaluation.final_flights",
                self.evaluation.final_flights as f64,
                self.evaluation.final_flights <= MOST_FLIGHTS,
                "0 to 1000000",
            ),
            ("replay.alpha", r.alpha, (0.0..=1.0).contains(&r.alpha), "0 to 1"),
            ("replay.beta", r.beta, (0.0..=1.0).contains(&r.beta), "0 to 1"),
        ];
        for (key, value, good, allowed) in checks {
            if !good {
                return Err(ConfigError::Value { key, value, allowed });
            }
        }
        Ok(())
    }
}

/// A number within limits; NaN is within none.
fn number(
    key: &'static str,
    value: f32,
    low: f32,
    high: f32,
    allowed: &'static str,
) -> (&'static str, f64, bool, &'static str) {
    (key, f64::from(value), (low..=high).contains(&value), allowed)
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
