//! Policies in ONNX become networks of Vigil's layers (docs/import.md).
//!
//! ```no_run
//! use vigil_onnx::{Adapter, import};
//!
//! let bytes = std::fs::read("policy.onnx")?;
//! let policy = import("policy.onnx", &bytes, &Adapter::default())?;
//! policy.save("policy.safetensors".as_ref())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod constant;
mod import;
mod movement;
mod proto;

pub use import::{Adapter, ImportError, import};
