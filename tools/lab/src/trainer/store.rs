//! Checkpoints: one safetensors file that holds everything of a run, sealed with a SHA-256 over all tensors in the order of their names
//! (name, zero byte, type, zero byte, bytes).

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Serialize, de::DeserializeOwned};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

const DIGEST: &str = "sha256";
const SIZE_LIMIT: u64 = 2 << 30;

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
    #[error("cannot write {path}: {source}; an earlier {path} is kept as it was")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
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
    /// The run had another configuration.
    #[error(
        "checkpoint {path} is of a run with another configuration: only `threads`, `families`, `decisions`, `drawn_vehicle_share` and `evaluation` may change; resume with the same one, or train in another folder"
    )]
    Configuration {
        /// The file.
        path: PathBuf,
    },
}

fn digest<S: AsRef<str>>(tensors: &[(S, TensorView<'_>)]) -> String {
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

/// A tensor's values.
pub enum Values<'a> {
    /// Numbers.
    F32(&'a [f32]),
    /// Priorities.
    F64(&'a [f64]),
    /// Stored states.
    U16(&'a [u16]),
}

/// Writes a description (JSON) and tensors beside and renames the file.
///
/// # Errors
/// `CheckpointError::Write`: an earlier file is kept.
pub fn save<S: Serialize>(path: &Path, state: &S, tensors: &[(String, Values<'_>)]) -> Result<(), CheckpointError> {
    let container = |message: String| CheckpointError::Container {
        path: path.to_owned(),
        message,
    };
    let state = serde_json::to_vec(state).map_err(|e| container(e.to_string()))?;
    let mut all: Vec<(String, Dtype, usize, Vec<u8>)> = vec![("state".into(), Dtype::U8, state.len(), state)];
    for (name, values) in tensors {
        let (dtype, len, bytes) = match values {
            Values::F32(v) => (Dtype::F32, v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::F64(v) => (Dtype::F64, v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::U16(v) => (Dtype::U16, v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
        };
        all.push((name.clone(), dtype, len, bytes));
    }
    let file = all
        .iter()
        .map(|(name, dtype, len, bytes)| Ok((name, TensorView::new(*dtype, vec![*len], bytes)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()
        .and_then(|views| {
            let seal = [(DIGEST.to_owned(), digest(&views))];
            safetensors::serialize(views, Some(seal.into()))
        })
        .map_err(|e| container(e.to_string()))?;
    vigil_types::files::replace(path, &file, vigil_types::files::Access::Shared).map_err(|source| {
        CheckpointError::Write {
            path: path.to_owned(),
            source,
        }
    })
}

/// A file that was read.
pub struct Stored {
    path: PathBuf,
    bytes: Vec<u8>,
}

impl Stored {
    /// Reads a file and verifies its seal.
    ///
    /// # Errors
    /// [`CheckpointError::Read`], truncated or altered.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let path = path.to_owned();
        let bytes = match vigil_types::files::read(&path, SIZE_LIMIT) {
            Ok(bytes) => bytes,
            Err(source) => return Err(CheckpointError::Read { path, source }),
        };
        let read = Self { path, bytes };
        let file = SafeTensors::deserialize(&read.bytes).map_err(|e| read.container(e.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(&read.bytes).map_err(|e| read.container(e.to_string()))?;
        let expected = header
            .metadata()
            .as_ref()
            .and_then(|entries| entries.get(DIGEST).cloned());
        let (found, expected) = (digest(&file.tensors()), expected.unwrap_or_default());
        if found != expected {
            return Err(CheckpointError::Altered {
                path: read.path,
                found,
                expected,
            });
        }
        Ok(read)
    }

    fn container(&self, message: String) -> CheckpointError {
        CheckpointError::Container {
            path: self.path.clone(),
            message,
        }
    }

    fn tensor(&self, name: &str, dtype: Dtype) -> Result<Vec<u8>, CheckpointError> {
        let file = SafeTensors::deserialize(&self.bytes).map_err(|e| self.container(e.to_string()))?;
        let view = file.tensor(name).map_err(|e| self.container(e.to_string()))?;
        if view.dtype() == dtype {
            Ok(view.data().to_vec())
        } else {
            Err(self.container(format!("tensor {name} is {:?}, not {dtype:?}", view.dtype())))
        }
    }

    /// The description.
    ///
    /// # Errors
    /// [`CheckpointError::Container`].
    pub fn state<S: DeserializeOwned>(&self) -> Result<S, CheckpointError> {
        serde_json::from_slice(&self.tensor("state", Dtype::U8)?).map_err(|e| self.container(e.to_string()))
    }

    /// Numbers, of a length or of any.
    ///
    /// # Errors
    /// [`CheckpointError::Container`], [`CheckpointError::Architecture`].
    pub fn f32(&self, name: &str, expected: Option<usize>) -> Result<Vec<f32>, CheckpointError> {
        let data = self.tensor(name, Dtype::F32)?;
        let values: Vec<f32> = data.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        match expected {
            Some(expected) if expected != values.len() => Err(CheckpointError::Architecture {
                path: self.path.clone(),
                tensor: name.to_owned(),
                found: values.len(),
                expected,
            }),
            _ => Ok(values),
        }
    }

    /// Priorities.
    ///
    /// # Errors
    /// [`CheckpointError::Container`].
    pub fn f64(&self, name: &str) -> Result<Vec<f64>, CheckpointError> {
        let data = self.tensor(name, Dtype::F64)?;
        Ok(data.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect())
    }

    /// Stored states.
    ///
    /// # Errors
    /// [`CheckpointError::Container`].
    pub fn u16(&self, name: &str) -> Result<Vec<u16>, CheckpointError> {
        let data = self.tensor(name, Dtype::U16)?;
        Ok(data.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect())
    }
}
