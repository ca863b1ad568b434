//! Policies in ONNX become networks of Vigil's layers, and networks of Vigil's layers ONNX (docs/import.md).
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
mod export;
mod fold;
mod import;
mod movement;
mod proto;

pub use export::{ExportError, export};
pub use import::{Adapter, ImportError, import};
