//! DeepSHAP explanations and the verdict on them.
//!
//! [`DeepShap`] explains any network made of [`vigil_nnet`]'s layers (docs/deepshap.md). [`LstmAd`] judges ten steps'
//! explanations; [`FrozenDetector`] is its file (docs/detectors.md). [`Monitor`] does both in the
//! tick (docs/detection.md).
#![forbid(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod frozen;
mod lstm_ad;
mod monitor;
mod shap;

pub use frozen::{Background, DetectorFileError, FrozenDetector};
pub use lstm_ad::{LstmAd, ROW, ROW_LIMIT, WINDOW, normalise};
pub use monitor::{Monitor, MonitorError};
pub use shap::{DeepShap, ShapError};
