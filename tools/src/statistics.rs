//! Intervals and quantiles for campaign tables.

pub use vigil_train::statistics::*;
