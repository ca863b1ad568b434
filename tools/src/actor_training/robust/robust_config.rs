//! What a run that hardens an actor is made of: a TOML file whose every key is optional and whose unknown keys are refused.

use crate::actor_training::config::ConfigError;
use crate::actor_training::limits::{self, Limits};
use serde::{Deserialize, Serialize};
use std::path::Path;
use vigil_world::Family;

/// A run that hardens an actor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobustConfig {
    /// Fixes courses, noise and samples.
    pub seed: u64,
    /// Threads; any number trains the same actor.
    pub threads: usize,
    /// Each flight's course is of one of these, in turn by chance.
    pub families: Vec<Family>,
    /// The run goes in rounds: the actor of its beginning flies, then learns on what it met. A checkpoint follows each.
    pub rounds: u64,
    /// States met in a round; a flight gives five a second.
    pub states: usize,
    /// Updates in a round.
    pub updates: u64,
    /// States in an update.
    pub batch: usize,
    /// A flight is cut off after this time, seconds.
    pub time_limit_s: f32,
    /// Share of the flights in which noise is added to the action.
    pub noise_share: f64,
    /// Its standard deviation.
    pub noise_sigma: f32,
    /// How far each pixel may be altered at the end, in 255ths of 100 m.
    pub epsilon_255: f32,
    /// Share of the updates over which ε rises from 0, by the third power of time.
    pub epsilon_rises_over: f32,
    /// Weight of the squared distance of the bounds' ends from what the teacher does, yaw and forward velocity; that of the decision
    /// itself is 1.
    pub bounds_weight: [f32; 2],
    /// Weight of the bounds' width before the last tanh: it teaches where that is saturated.
    pub width_weight: f32,
    /// Learning rate of Adam.
    pub rate: f32,
    /// From this share of the updates on the rate falls, to a twentieth.
    pub rate_falls_from: f32,
    /// Longest gradient.
    pub gradient_norm: f32,
    /// Flights of each family after each round.
    pub evaluation_flights: u64,
}

impl Default for RobustConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            threads: 1,
            families: vec![Family::Training, Family::Hard],
            rounds: 6,
            states: 3_000,
            updates: 1_000,
            batch: 16,
            time_limit_s: 60.0,
            noise_share: 0.5,
            noise_sigma: 0.3,
            epsilon_255: 1.1,
            epsilon_rises_over: 0.6,
            bounds_weight: [0.5, 0.1],
            width_weight: 0.01,
            rate: 5e-4,
            rate_falls_from: 0.6,
            gradient_norm: 5.0,
            evaluation_flights: 30,
        }
    }
}

impl RobustConfig {
    /// Updates of the whole run.
    pub fn all_updates(&self) -> u64 {
        self.rounds.saturating_mul(self.updates)
    }

    /// ε of an update, as a share of 100 m.
    pub fn epsilon_at(&self, update: u64) -> f32 {
        let done = update as f32 / (self.all_updates() as f32 * self.epsilon_rises_over).max(1.0);
        self.epsilon_255 / 255.0 * done.min(1.0).powi(3)
    }

    /// Learning rate of an update.
    pub fn rate_at(&self, update: u64) -> f32 {
        let all = self.all_updates() as f32;
        let left = (all - update as f32) / (all * (1.0 - self.rate_falls_from)).max(1.0);
        self.rate * left.clamp(0.05, 1.0)
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

    /// Checks every value.
    ///
    /// # Errors
    /// The first one that is not allowed.
    pub fn check(&self) -> Result<(), ConfigError> {
        let [yaw, forward] = self.bounds_weight;
        Limits::new()
            .some("families", self.families.len() as u64)
            .count("threads", self.threads, 1..=256)
            .some("rounds", self.rounds)
            .count("states", self.states, 1..=100_000)
            .some("updates", self.updates)
            .count("batch", self.batch, 1..=4096)
            .number("time_limit_s", self.time_limit_s, 1.0..=3600.0)
            .share("noise_share", self.noise_share)
            .number("noise_sigma", self.noise_sigma, 0.0..=10.0)
            .number("epsilon_255", self.epsilon_255, 0.0..=255.0)
            .number("epsilon_rises_over", self.epsilon_rises_over, 0.001..=1.0)
            .number("bounds_weight", yaw.min(forward), 0.0..=1e6)
            .number("width_weight", self.width_weight, 0.0..=1e6)
            .number("rate", self.rate, 0.0..=1.0)
            .number("rate_falls_from", self.rate_falls_from, 0.0..=1.0)
            .number("gradient_norm", self.gradient_norm, 1e-6..=1e9)
            .end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_survives_its_own_toml_and_what_is_wrong_is_named() {
        let default = RobustConfig::default();
        let read: RobustConfig = toml::from_str(&default.to_toml()).unwrap();
        assert_eq!(read, default);
        assert!(default.check().is_ok());
        for (text, expected) in [
            ("epsilon = 1", "epsilon"),
            ("rounds = 0", "`rounds`"),
            ("rate = nan", "`rate`"),
        ] {
            let config: Result<RobustConfig, _> = toml::from_str(text);
            let error = config.map_or_else(|e| e.to_string(), |c| c.check().unwrap_err().to_string());
            assert!(error.contains(expected), "{text}\n{error}");
        }
    }

    #[test]
    fn epsilon_rises_and_the_rate_falls() {
        let config = RobustConfig::default();
        let end = config.all_updates();
        assert_eq!(config.epsilon_at(0), 0.0);
        assert!(config.epsilon_at(end / 4) < config.epsilon_at(end / 2));
        assert_eq!(config.epsilon_at(end), 1.1 / 255.0);
        assert_eq!(config.rate_at(0), config.rate);
        assert!((config.rate_at(end) - 0.05 * config.rate).abs() < 1e-9);
    }
}
