//! When frames are attacked.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// The first step at which a flight's one burst may begin: the vehicle is under way and the actor's memory is full.
pub const SINGLE_BURST_FIRST: u64 = 20;
/// The last step at which it may begin, 10 s after the start: a flight over 20 m at 1.5 m/s is not over before 13 s.
pub const SINGLE_BURST_LAST: u64 = 200;

/// How long an attack lasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum Burst {
    /// So many consecutive steps, once in a flight.
    Steps(u64),
    /// From the first step to the last.
    Continuous,
}

impl fmt::Display for Burst {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Steps(steps) => steps.fmt(f),
            Self::Continuous => f.pad("continuous"),
        }
    }
}

impl From<Burst> for String {
    fn from(burst: Burst) -> Self {
        burst.to_string()
    }
}

impl TryFrom<String> for Burst {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl FromStr for Burst {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.parse()) {
            ("continuous", _) => Ok(Self::Continuous),
            (_, Ok(steps)) if steps > 0 => Ok(Self::Steps(steps)),
            _ => Err("give a number of steps above 0, or `continuous`".to_owned()),
        }
    }
}

impl Burst {
    /// Which steps are attacked: one burst that begins at a step drawn evenly from [`SINGLE_BURST_FIRST`] to [`SINGLE_BURST_LAST`], or all
    /// steps. The same seed gives the same steps.
    pub fn steps(self, seed: u64) -> Range<u64> {
        match self {
            Self::Continuous => 0..u64::MAX,
            Self::Steps(steps) => {
                let first = ChaCha8Rng::seed_from_u64(seed).random_range(SINGLE_BURST_FIRST..=SINGLE_BURST_LAST);
                first..first.saturating_add(steps)
            }
        }
    }
}
