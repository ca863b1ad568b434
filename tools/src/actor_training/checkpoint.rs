//! Checkpoints: one safetensors file, sealed with a digest as models are.
//!
//! The metadata entry `sha256` is over all tensors in the order of their names: name, zero byte, type, zero byte, bytes.

use crate::actor_training::files::WriteError;
use safetensors::tensor::TensorView;
use sha2::{Digest, Sha256};
use std::path::PathBuf;

pub(super) const DIGEST: &str = "sha256";
/// A run has some megabytes; its priorities have 8 bytes a decision, its flights 8 bytes a step.
pub(super) const SIZE_LIMIT: u64 = 2 << 30;

/// Why a checkpoint is refused.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// It cannot be read.
    #[error("cannot read checkpoint {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Truncated, or something else altogether.
    #[error("checkpoint {path} is truncated or not a checkpoint: {message}")]
    Container {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// Networks of other sizes.
    #[error(
        "checkpoint {path} is of another architecture: {tensor} holds {found} values, this program's has {expected}"
    )]
    Architecture {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// Values in the file.
        found: usize,
        /// Values expected.
        expected: usize,
    },
    /// The digest does not match.
    #[error(
        "checkpoint {path} was altered: its content has SHA-256 {found}, its own entry says {expected}; it cannot be gone on with, \
         train anew in another folder"
    )]
    Altered {
        /// The file.
        path: PathBuf,
        /// Digest of the content.
        found: String,
        /// The entry.
        expected: String,
    },
    /// Unaltered, but what it holds does not belong together.
    #[error("checkpoint {path} does not hold together: {what}")]
    Inconsistent {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: &'static str,
    },
    /// The run had another configuration.
    #[error(
        "checkpoint {path} is of a run with another configuration; resume with the same one, or train in another folder"
    )]
    Configuration {
        /// The file.
        path: PathBuf,
    },
}

/// SHA-256 over tensors, whatever their order.
pub(super) fn digest<S: AsRef<str>>(tensors: &[(S, TensorView<'_>)]) -> String {
    let mut sorted: Vec<_> = tensors.iter().map(|(name, view)| (name.as_ref(), view)).collect();
    sorted.sort_by_key(|(name, _)| *name);
    let mut hash = Sha256::new();
    for (name, view) in sorted {
        let kind = format!("{:?}", view.dtype());
        for part in [name.as_bytes(), &[0], kind.as_bytes(), &[0], view.data()] {
            hash.update(part);
        }
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}
