//! DeepSHAP explanations and the verdict on them.
//!
//! [`DeepShap`] explains any network made of [`vigil_nnet`]'s layers. See docs/deepshap.md.
#![forbid(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod shap;

pub use shap::{DeepShap, ShapError};
