//! Policies in ONNX become networks of Vigil's layers, and networks of Vigil's layers ONNX (docs/import.md).
//!
//! ```no_run
//! use vigil_onnx::{Adapter, import};
//!
//! let bytes = std::fs::read("policy.onnx")?;
//! let beside = |name: &str| std::fs::read(name).map_err(|e| e.to_string());
//! let policy = import("policy.onnx", &bytes, &beside, &Adapter::default())?;
//! policy.save("policy.safetensors".as_ref())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod adapter;
mod beside;
mod constant;
mod export;
mod fold;
mod import;
mod movement;
mod proto;

pub use adapter::{Adapter, Flat};
pub use export::export;
pub use import::{ImportError, import};
