//! What the configurations of training runs share.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

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

impl Default for ReplayConfig {
    fn default() -> Self {
        Self {
            decisions: 36_000,
            alpha: 0.6,
            beta: 0.4,
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
