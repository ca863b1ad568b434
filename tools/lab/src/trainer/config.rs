//! What a run is made of: a TOML file whose every key is optional and whose unknown keys are refused.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use vigil_sim::world::Family;

/// A run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnConfig {
    /// Fixes courses, noise, initial weights and samples: the same seed trains the same actor, bit for bit, on machines with the same
    /// instruction set.
    pub seed: u64,
    /// Threads; any number trains the same actor.
    pub threads: usize,
    /// Each training flight's course is of one of these, in turn by chance.
    pub families: Vec<Family>,
    /// Decisions after which training ends; rates and noise fall by them.
    pub decisions: u64,
    /// Decisions of noise that fill the replay memory before the first update (the paper: 5 000).
    pub warm_up: u64,
    /// Mean forward output of the warm-up's noise: noise alone stays where it is.
    pub warm_up_forward: f32,
    /// Flights at the same time.
    pub environments: usize,
    /// Steps of 0.05 s that a decision lasts while training.
    pub steps_per_decision: usize,
    /// A training flight is cut off after this time, seconds. The value of its last state still counts.
    pub time_limit_s: f32,
    /// Share of the training flights whose odometry drifts, by up to `drift_scale` of the way and `drift_yaw_deg_s`.
    pub drift_share: f64,
    /// Most by which a way seems longer or shorter, as a share.
    pub drift_scale: f32,
    /// Most turning that does not happen, degrees per second.
    pub drift_yaw_deg_s: f32,
    /// Share of the training flights whose vehicle is one drawn between the models of other autopilots.
    pub drawn_vehicle_share: f64,
    /// Exploration.
    pub noise: NoiseConfig,
    /// Share of the training flights in which the potential field is added to the action (the paper: 1).
    pub apf_share: f64,
    /// Reward.
    pub reward: RewardConfig,
    /// Updates.
    pub learning: LearningConfig,
    /// Replay memory.
    pub replay: ReplayConfig,
    /// Flights that evaluate the actor.
    pub evaluation: EvaluationConfig,
    /// What the encoder learns before it is frozen.
    pub encoder: EncoderConfig,
}

/// Ornstein-Uhlenbeck noise on the action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseConfig {
    /// Share of the noise that decays per decision.
    pub theta: f32,
    /// Standard deviation at first, action units.
    pub sigma_first: f32,
    /// Standard deviation at last.
    pub sigma_last: f32,
    /// Share of the run over which it falls linearly.
    pub falls_over: f32,
    /// Share of the flights after the warm-up that have noise.
    pub share: f64,
}

/// Along what the reward measures progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Along {
    /// The shortest free path past what stands still.
    Path,
    /// The straight line to the goal (the paper).
    Line,
}

/// Reward: metres of progress, and these.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RewardConfig {
    /// Progress along what.
    pub along: Along,
    /// At the goal.
    pub success: f32,
    /// For collision and out of bounds (the paper: −2).
    pub dead: f32,
    /// For each decision (the paper: 0).
    pub decision: f32,
    /// At checkpoint C of N: this times (1 + C/N) (the paper: 2).
    pub checkpoint: f32,
    /// For each decision that ends less than 1 m from an obstacle, times the square of the share of that metre that is missing
    /// (the paper: not there).
    pub near: f32,
}

/// The updates of actor and critics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearningConfig {
    /// Discount per decision.
    pub gamma: f32,
    /// Rewards summed before the critics' value is used.
    pub n_steps: usize,
    /// Transitions in an update.
    pub batch: usize,
    /// Decisions per update.
    pub decisions_per_update: u64,
    /// Adam's rate for the actor.
    pub actor_rate: f32,
    /// Adam's rate for the critics.
    pub critic_rate: f32,
    /// Share of all updates after which the rates begin to fall linearly, to a tenth at the end; 1 keeps them.
    pub rates_fall_from: f64,
    /// Share of the weights that the target networks take over at each update.
    pub tau: f32,
    /// Longest gradient.
    pub gradient_norm: f32,
    /// Weight of the square of what exceeds 1 before the actor's last tanh.
    pub saturation_penalty: f32,
    /// Standard deviation of the noise on the target's action, cut off at twice that.
    pub smoothing: f32,
    /// Units of the critics' two layers.
    pub critic_units: [usize; 2],
    /// Half of the sampled transitions are seen in a mirror.
    pub mirror: bool,
}

/// Replay memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplayConfig {
    /// Decisions stored; one takes 1 kB.
    pub decisions: usize,
    /// Exponent of the priority; 0 samples evenly.
    pub alpha: f64,
    /// Exponent of the importance weights.
    pub beta: f64,
}

/// Flights that evaluate the actor, always over the same courses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Updates between evaluations.
    pub every_updates: u64,
    /// Families that are flown at each; the mean of their completions chooses.
    pub families: Vec<Family>,
    /// Flights of each.
    pub flights: u64,
    /// Flights of each that choose between the best at the end.
    pub final_flights: u64,
    /// Seed of the first course.
    pub first_seed: u64,
    /// A flight that takes longer has failed, seconds.
    pub time_limit_s: f32,
}

/// What the encoder learns before it is frozen: the collision scan, from single frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EncoderConfig {
    /// Updates.
    pub updates: u64,
    /// Frames in an update.
    pub batch: usize,
    /// Adam's rate.
    pub rate: f32,
}

impl Default for LearnConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            threads: 1,
            families: vec![Family::Training, Family::Hard, Family::Hard],
            decisions: 320_000,
            warm_up: 5_000,
            warm_up_forward: 0.7,
            environments: 32,
            steps_per_decision: 4,
            time_limit_s: 60.0,
            drift_share: 0.25,
            drift_scale: 0.02,
            drift_yaw_deg_s: 0.5,
            drawn_vehicle_share: 0.25,
            noise: NoiseConfig::default(),
            apf_share: 0.25,
            reward: RewardConfig::default(),
            learning: LearningConfig::default(),
            replay: ReplayConfig::default(),
            evaluation: EvaluationConfig::default(),
            encoder: EncoderConfig::default(),
        }
    }
}

impl Default for NoiseConfig {
    fn default() -> Self {
        Self {
            theta: 0.15,
            sigma_first: 1.0,
            sigma_last: 0.1,
            falls_over: 0.5,
            share: 0.7,
        }
    }
}

impl Default for RewardConfig {
    fn default() -> Self {
        Self {
            along: Along::Path,
            success: 5.0,
            dead: -6.0,
            decision: -0.02,
            checkpoint: 0.0,
            near: -0.3,
        }
    }
}

impl Default for LearningConfig {
    fn default() -> Self {
        Self {
            gamma: 0.97,
            n_steps: 3,
            batch: 128,
            decisions_per_update: 2,
            actor_rate: 3e-4,
            critic_rate: 5e-4,
            rates_fall_from: 0.6,
            tau: 0.005,
            gradient_norm: 5.0,
            saturation_penalty: 0.05,
            smoothing: 0.15,
            critic_units: [256, 256],
            mirror: true,
        }
    }
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self {
            decisions: 300_000,
            alpha: 0.0,
            beta: 0.4,
        }
    }
}

impl Default for EvaluationConfig {
    fn default() -> Self {
        Self {
            every_updates: 10_000,
            families: vec![Family::Validation, Family::Hard],
            flights: 60,
            final_flights: 200,
            first_seed: 0,
            time_limit_s: 90.0,
        }
    }
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self {
            updates: 8_000,
            batch: 48,
            rate: 2e-3,
        }
    }
}

/// What is wrong with a configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// It cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no TOML, or holds an unknown key.
    #[error("{path}: {message}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A value out of its range.
    #[error("`{key}` is {value}, must be {allowed}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        allowed: String,
    },
}

/// A configuration has a page or two.
const SIZE_LIMIT: u64 = 1 << 20;

fn load<C: DeserializeOwned>(path: &Path) -> Result<C, ConfigError> {
    let text = vigil_types::files::read_text(path, SIZE_LIMIT).map_err(|source| ConfigError::Read {
        path: path.to_owned(),
        source,
    })?;
    toml::from_str(&text).map_err(|e| ConfigError::Content {
        path: path.to_owned(),
        message: e.to_string(),
    })
}

impl LearnConfig {
    /// Reads and checks a file; what it does not name keeps its default.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let config: Self = load(path)?;
        config.check()?;
        Ok(config)
    }

    /// TOML that [`Self::load`] reads back unchanged.
    pub fn to_toml(&self) -> String {
        // Plain maps and numbers; serialisation fails for other types only.
        toml::to_string(self).unwrap_or_default()
    }

    /// Updates that belong to so many decisions.
    pub fn updates_due(&self, decisions: u64) -> u64 {
        decisions.saturating_sub(self.warm_up) / self.learning.decisions_per_update.max(1)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first one that is not allowed.
    pub fn check(&self) -> Result<(), ConfigError> {
        let (l, e, n) = (&self.learning, &self.evaluation, &self.noise);
        let least = (self.environments * (l.n_steps + 40)) as f64;
        const NO_END: f64 = f64::INFINITY;
        let rows: [(&'static str, f64, RangeInclusive<f64>); 27] = [
            ("families", self.families.len() as f64, 1.0..=NO_END),
            ("threads", self.threads as f64, 1.0..=256.0),
            ("environments", self.environments as f64, 1.0..=256.0),
            ("decisions", self.decisions as f64, self.warm_up as f64 + 1.0..=NO_END),
            ("warm_up", self.warm_up as f64, least..=NO_END),
            ("warm_up_forward", self.warm_up_forward.into(), -1.5..=1.5),
            ("steps_per_decision", self.steps_per_decision as f64, 1.0..=40.0),
            ("time_limit_s", self.time_limit_s.into(), 1.0..=3600.0),
            ("drift_share", self.drift_share, 0.0..=1.0),
            ("drift_scale", self.drift_scale.into(), 0.0..=0.5),
            ("drift_yaw_deg_s", self.drift_yaw_deg_s.into(), 0.0..=10.0),
            ("drawn_vehicle_share", self.drawn_vehicle_share, 0.0..=1.0),
            ("apf_share", self.apf_share, 0.0..=1.0),
            ("noise.theta", n.theta.into(), 0.001..=1.0),
            ("noise.sigma_first", n.sigma_first.into(), 0.0..=10.0),
            ("noise.sigma_last", n.sigma_last.into(), 0.0..=10.0),
            ("noise.falls_over", n.falls_over.into(), 0.001..=1.0),
            ("noise.share", n.share, 0.0..=1.0),
            ("learning.gamma", l.gamma.into(), 0.0..=1.0),
            ("learning.n_steps", l.n_steps as f64, 1.0..=100.0),
            ("learning.batch", l.batch as f64, 1.0..=4096.0),
            (
                "learning.decisions_per_update",
                l.decisions_per_update as f64,
                1.0..=NO_END,
            ),
            ("learning.tau", l.tau.into(), 0.0..=1.0),
            ("learning.gradient_norm", l.gradient_norm.into(), 1e-6..=1e9),
            ("replay.alpha", self.replay.alpha, 0.0..=1.0),
            ("replay.decisions", self.replay.decisions as f64, least..=NO_END),
            ("evaluation.every_updates", e.every_updates as f64, 1.0..=NO_END),
        ];
        for (key, value, range) in rows {
            if !range.contains(&value) {
                let allowed = match range.end().is_finite() {
                    true => format!("{} to {}", range.start(), range.end()),
                    false => format!("{} or more", range.start()),
                };
                return Err(ConfigError::Value { key, value, allowed });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_survives_its_own_toml_and_what_is_wrong_is_named() {
        let default = LearnConfig::default();
        let read: LearnConfig = toml::from_str(&default.to_toml()).unwrap();
        assert_eq!(read, default);
        assert!(default.check().is_ok());
        for (text, expected) in [
            ("[learning]\ngama = 0.9", "gama"),
            ("drift_share = nan", "`drift_share`"),
            ("families = []", "`families`"),
            ("warm_up = 10", "`warm_up`"),
        ] {
            let config: Result<LearnConfig, _> = toml::from_str(text);
            let error = config.map_or_else(|e| e.to_string(), |c| c.check().unwrap_err().to_string());
            assert!(error.contains(expected), "{text}\n{error}");
        }
    }
}
