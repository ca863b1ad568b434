//! When frames are attacked.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::fmt;
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

/// Which steps are attacked. The same seed gives the same steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BurstPlan(Plan);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Plan {
    Once { first: u64, steps: u64 },
    Repeated { seed: u64, steps: u64, period: u64 },
    Continuous,
}

impl BurstPlan {
    /// One burst that begins at a step drawn evenly from [`SINGLE_BURST_FIRST`] to [`SINGLE_BURST_LAST`], or all steps.
    pub fn new(burst: Burst, seed: u64) -> Self {
        Self(match burst {
            Burst::Continuous => Plan::Continuous,
            Burst::Steps(steps) => Plan::Once {
                first: ChaCha8Rng::seed_from_u64(seed).random_range(SINGLE_BURST_FIRST..=SINGLE_BURST_LAST),
                steps,
            },
        })
    }

    /// A burst of `steps` in each `period`, somewhere within it, the first period apart; at most one step fewer than the period. For
    /// gathering many bursts from one flight.
    pub fn repeated(steps: u64, period: u64, seed: u64) -> Self {
        let period = period.max(2);
        Self(Plan::Repeated {
            seed,
            steps: steps.min(period - 1),
            period,
        })
    }

    /// Whether step number `step` is attacked.
    pub fn attacks(&self, step: u64) -> bool {
        match self.0 {
            Plan::Continuous => true,
            Plan::Once { first, steps } => (first..first.saturating_add(steps)).contains(&step),
            Plan::Repeated { seed, steps, period } => {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                rng.set_stream(step / period);
                let first = rng.random_range(0..=period - steps);
                step >= period && (first..first + steps).contains(&(step % period))
            }
        }
    }
}
