//! Configurations of training runs: read from files, checked value by value.

use crate::actor_training::config::{ConfigError, NoiseConfig};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ops::RangeInclusive;
use std::path::Path;

/// A training file has a page or two.
const SIZE_LIMIT: u64 = 1 << 20;
/// A range that ends here has no end.
const NO_END: f32 = 1e6;

/// Reads a file; what it does not name keeps its default.
///
/// # Errors
/// [`ConfigError::Read`], [`ConfigError::Content`].
pub fn load<C: DeserializeOwned>(path: &Path) -> Result<C, ConfigError> {
    let text = vigil_files::read_text(path, SIZE_LIMIT).map_err(|source| ConfigError::Read {
        path: path.to_owned(),
        source,
    })?;
    toml::from_str(&text).map_err(|e| ConfigError::Content {
        path: path.to_owned(),
        message: e.to_string(),
    })
}

/// Writes TOML that [`load`] reads back unchanged.
pub fn to_toml<C: Serialize>(config: &C) -> String {
    // Plain maps and numbers; serialisation fails for other types only.
    toml::to_string(config).unwrap_or_default()
}

/// Checks values one after the other; the first that is not allowed counts.
pub struct Limits(Result<(), ConfigError>);

impl Limits {
    /// Nothing is wrong yet.
    pub fn new() -> Self {
        Self(Ok(()))
    }

    /// A value that is `good` or not.
    pub fn that(mut self, key: &'static str, value: f64, good: bool, allowed: impl Into<String>) -> Self {
        if self.0.is_ok() && !good {
            let allowed = allowed.into();
            self.0 = Err(ConfigError::Value { key, value, allowed });
        }
        self
    }

    /// A number within a range; NaN is within none.
    pub fn number(self, key: &'static str, value: f32, range: RangeInclusive<f32>) -> Self {
        let (low, high) = (range.start(), range.end());
        let allowed = match *high < NO_END {
            true => format!("{low} to {high}"),
            false => format!("{low} or more"),
        };
        self.that(key, value.into(), range.contains(&value), allowed)
    }

    /// A share: 0 to 1.
    pub fn share(self, key: &'static str, value: f64) -> Self {
        self.that(key, value, (0.0..=1.0).contains(&value), "0 to 1")
    }

    /// A count within a range.
    pub fn count(self, key: &'static str, value: usize, range: RangeInclusive<usize>) -> Self {
        let allowed = format!("{} to {}", range.start(), range.end());
        self.that(key, value as f64, range.contains(&value), allowed)
    }

    /// A count that is not 0.
    pub fn some(self, key: &'static str, value: u64) -> Self {
        self.that(key, value as f64, value > 0, "1 or more")
    }

    /// A count that is not below another.
    pub fn least(self, key: &'static str, value: u64, least: u64, allowed: &'static str) -> Self {
        self.that(key, value as f64, value >= least, allowed)
    }

    /// The exploration of every run.
    pub fn noise(self, n: &NoiseConfig) -> Self {
        self.number("noise.theta", n.theta, 0.001..=1.0)
            .number("noise.sigma_first", n.sigma_first, 0.0..=10.0)
            .number("noise.sigma_last", n.sigma_last, 0.0..=10.0)
            .number("noise.falls_over", n.falls_over, 0.001..=1.0)
            .share("noise.share", n.share)
    }

    /// What came of it.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn end(self) -> Result<(), ConfigError> {
        self.0
    }
}
