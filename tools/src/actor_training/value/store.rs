//! Files of a run by value: experts, and checkpoints that hold the memory as well. They are sealed as `vigil train`'s checkpoints are.

use super::mlp::Mlp;
use super::value_learner::Expert;
use crate::actor_training::checkpoint::{CheckpointError, DIGEST, SIZE_LIMIT, digest};
use crate::actor_training::files;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Serialize, de::DeserializeOwned};
use std::path::{Path, PathBuf};
use vigil_sim::environment::true_state::TRUE_STATE;

/// A tensor's values.
pub enum Values<'a> {
    /// Numbers.
    F32(&'a [f32]),
    /// Priorities.
    F64(&'a [f64]),
    /// Kept features.
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
    Ok(files::replace(path, &file)?)
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
        let bytes = match vigil_files::read(&path, SIZE_LIMIT) {
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

    /// Kept features.
    ///
    /// # Errors
    /// [`CheckpointError::Container`].
    pub fn u16(&self, name: &str) -> Result<Vec<u16>, CheckpointError> {
        let data = self.tensor(name, Dtype::U16)?;
        Ok(data.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect())
    }
}

const EXPERT_FORMAT: &str = "vigil expert 2";

#[derive(Serialize, serde::Deserialize)]
struct ExpertState {
    format: String,
    config: String,
    updates: u64,
    actor_units: [usize; 2],
    critic_units: [usize; 2],
    critics: usize,
}

impl Expert {
    /// Writes it with the configuration and the updates that made it.
    ///
    /// # Errors
    /// `CheckpointError::Write`.
    pub fn save(&self, path: &Path, config: &str, updates: u64) -> Result<(), CheckpointError> {
        let state = ExpertState {
            format: EXPERT_FORMAT.to_owned(),
            config: config.to_owned(),
            updates,
            actor_units: self.actor_units,
            critic_units: self.critic_units,
            critics: self.critics.len(),
        };
        let mut tensors = vec![("actor".to_owned(), Values::F32(&self.actor))];
        for (i, critic) in self.critics.iter().enumerate() {
            tensors.push((format!("critic_{i}"), Values::F32(critic)));
        }
        save(path, &state, &tensors)
    }

    /// Reads one.
    ///
    /// # Errors
    /// `CheckpointError`: unreadable, truncated, another architecture.
    pub fn load(path: &Path) -> Result<Self, CheckpointError> {
        let file = Stored::read(path)?;
        let state: ExpertState = file.state()?;
        if state.format != EXPERT_FORMAT {
            return Err(file.container(format!("its format is \"{}\", not \"{EXPERT_FORMAT}\"", state.format)));
        }
        let actor = Mlp::new(TRUE_STATE, &state.actor_units, 2);
        let critic = Mlp::new(TRUE_STATE + 2, &state.critic_units, 1);
        Ok(Self {
            actor_units: state.actor_units,
            actor: file.f32("actor", Some(actor.param_len()))?,
            critic_units: state.critic_units,
            critics: (0..state.critics)
                .map(|i| file.f32(&format!("critic_{i}"), Some(critic.param_len())))
                .collect::<Result<_, _>>()?,
        })
    }
}
