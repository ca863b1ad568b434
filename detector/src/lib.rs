//! DeepSHAP explanations and the verdict on them.
//!
//! [`DeepShap`] explains any network made of [`vigil_nnet`]'s layers (docs/deepshap.md). [`LstmAd`] judges ten steps'
//! explanations; [`FrozenDetector`] is its file (docs/detectors.md). [`Monitor`] does both in the
//! tick (docs/detection.md).
//!
//! ```
//! use vigil_detector::{FrozenDetector, LstmAd, WINDOW, normalise, row_of};
//! use vigil_nnet::Isa;
//!
//! let detector = FrozenDetector::built_in()?;
//! let mut lstm = LstmAd::new(Isa::detect(), &detector.params)?;
//! // Ten explanations of 48 values like those of unattacked flights, oldest first.
//! let usual = normalise(&detector.centre, &detector.centre, &detector.scale);
//! assert!(lstm.score(&[usual; WINDOW])? < detector.threshold);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![cfg_attr(not(any(feature = "std", test)), no_std)]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing))]

#[cfg_attr(not(any(feature = "std", test)), macro_use)]
extern crate alloc;

#[cfg(feature = "std")]
mod cnn_ad;
mod frozen;
#[cfg(feature = "std")]
mod images;
mod lstm_ad;
mod monitor;
#[cfg(feature = "std")]
mod pca;
mod shap;

#[cfg(feature = "std")]
pub use cnn_ad::{cnn_ad, fcn_ad};
pub use frozen::{Background, FrozenDetector, Of, split_point_shap};
#[cfg(feature = "std")]
pub use images::{IMAGE, IMAGE_CHANNELS, IMAGE_COLS, IMAGE_ROWS, image};
pub use lstm_ad::{LstmAd, ROW, ROW_LIMIT, WINDOW, normalise, row_of};
pub use monitor::{Monitor, MonitorError};
#[cfg(feature = "std")]
pub use pca::Pca;
pub use shap::{DeepShap, ShapError};
