//! A run that can go on exactly where it was: one safetensors file, sealed with a digest as models are.
//!
//! The metadata entry `sha256` is over all tensors in the order of their names: name, zero byte, type, zero byte, bytes.
//!
//! Frames are not saved. Every flight that has frames in the memory is saved as its seed and its actions, and is flown again
//! when the run resumes; the simulator gives the same bits.

use crate::actor_training::adam::Adam;
use crate::actor_training::collector::CollectorState;
use crate::actor_training::files::{self, WriteError};
use crate::actor_training::networks::Networks;
use crate::actor_training::progress::{FlightRow, Row, RowSum};
use crate::actor_training::replay_buffer::LaneState;
use crate::actor_training::weights::Weights;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

const FORMAT: &str = "vigil training checkpoint 3";
/// Metadata entries.
const FORMAT_ENTRY: &str = "format";
pub(super) const DIGEST: &str = "sha256";
/// A run has some megabytes; its priorities have 8 bytes a decision, its flights 8 bytes a step.
pub(super) const SIZE_LIMIT: u64 = 2 << 30;

/// An actor that may be the one to freeze.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Updates after which it was evaluated.
    pub updates: u64,
    /// Its completion then.
    pub completion: f64,
    /// Its parameters.
    pub params: Vec<f32>,
}

/// Everything of a run but its weights and frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunState {
    /// The configuration, TOML.
    pub config: String,
    /// Decisions flown.
    pub decisions: u64,
    /// Updates made.
    pub updates: u64,
    /// Time spent, seconds.
    pub elapsed_s: f64,
    /// Position in the learner's random stream, high and low half.
    pub random_at: (u64, u64),
    /// Steps of the three optimisers: encoder, actor, critic.
    optimiser_steps: [u64; 3],
    /// Bits of the largest priority.
    pub largest_priority_bits: u64,
    /// The environments.
    pub collectors: Vec<CollectorState>,
    /// What they lived through.
    pub lanes: Vec<LaneState>,
    /// The learning curve.
    pub rows: Vec<Row>,
    /// The row being summed.
    pub row: RowSum,
    /// The training flights that ended.
    pub flights: Vec<FlightRow>,
    /// Updates and completion of each candidate, in the order of their tensors.
    candidates: Vec<(u64, f64)>,
}

/// A run at rest.
pub struct Checkpoint {
    /// All but the following.
    pub state: RunState,
    /// Networks and optimisers.
    pub weights: Weights,
    /// Priorities of the memory.
    pub priorities: Vec<f64>,
    /// Actors that may be the one to freeze.
    pub candidates: Vec<Candidate>,
}

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

impl RunState {
    /// A state to be completed by [`Checkpoint::save`].
    #[expect(clippy::too_many_arguments, reason = "one argument for each field, none optional")]
    pub fn new(
        config: String,
        (decisions, updates): (u64, u64),
        elapsed_s: f64,
        random_at: (u64, u64),
        largest_priority: f64,
        collectors: Vec<CollectorState>,
        lanes: Vec<LaneState>,
        (rows, row, flights): (Vec<Row>, RowSum, Vec<FlightRow>),
    ) -> Self {
        Self {
            config,
            decisions,
            updates,
            elapsed_s,
            random_at,
            optimiser_steps: [0; 3],
            largest_priority_bits: largest_priority.to_bits(),
            collectors,
            lanes,
            rows,
            row,
            flights,
            candidates: Vec::new(),
        }
    }

    /// What does not belong together, whatever the configuration.
    fn check(&self) -> Result<(), &'static str> {
        let largest = f64::from_bits(self.largest_priority_bits);
        if !(largest > 0.0 && largest.is_finite()) {
            return Err("its largest priority is no number above 0");
        }
        if !self.elapsed_s.is_finite() {
            return Err("its time is no number");
        }
        if !self.rows.is_sorted_by_key(|row| row.updates) {
            return Err("its learning curve is not in order");
        }
        if self.collectors.len() != self.lanes.len() {
            return Err("it has another number of environments than of lanes");
        }
        let both = self.collectors.iter().zip(&self.lanes);
        for (collector, lane) in both {
            lane.check()?;
            if collector.is_flying() && lane.episodes.is_empty() {
                return Err("a flight that lasts is not among those of its lane");
            }
        }
        Ok(())
    }
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

fn bytes_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

impl Checkpoint {
    /// Writes the file beside and renames it.
    ///
    /// # Errors
    /// [`CheckpointError::Write`]: an earlier checkpoint is kept.
    pub fn save(
        path: &Path,
        mut state: RunState,
        weights: &Weights,
        priorities: &[f64],
        candidates: &[Candidate],
    ) -> Result<(), CheckpointError> {
        let adams = [&weights.encoder_adam, &weights.actor_adam, &weights.critic_adam];
        state.optimiser_steps = adams.map(|a| a.steps);
        state.candidates = candidates.iter().map(|c| (c.updates, c.completion)).collect();
        let container = |message: String| CheckpointError::Container {
            path: path.to_owned(),
            message,
        };
        let state = serde_json::to_vec(&state).map_err(|e| container(e.to_string()))?;
        let mut tensors: Vec<(String, Dtype, usize, Vec<u8>)> = vec![("state".into(), Dtype::U8, state.len(), state)];
        for (name, values) in weights.parts() {
            tensors.push((name.into(), Dtype::F32, values.len(), bytes_of(values)));
        }
        for (i, c) in candidates.iter().enumerate() {
            tensors.push((
                format!("candidate_{i}"),
                Dtype::F32,
                c.params.len(),
                bytes_of(&c.params),
            ));
        }
        let bits: Vec<u8> = priorities.iter().flat_map(|p| p.to_le_bytes()).collect();
        tensors.push(("priorities".into(), Dtype::F64, priorities.len(), bits));
        let views = tensors
            .iter()
            .map(|(name, dtype, len, bytes)| Ok((name, TensorView::new(*dtype, vec![*len], bytes)?)))
            .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()
            .and_then(|views| {
                let metadata = [(FORMAT_ENTRY, FORMAT.to_owned()), (DIGEST, digest(&views))];
                let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value));
                safetensors::serialize(views, Some(metadata.collect()))
            })
            .map_err(|e| container(e.to_string()))?;
        Ok(files::replace(path, &views)?)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`CheckpointError`]: unreadable, truncated, another architecture.
    pub fn load(path: &Path, networks: &Networks) -> Result<Self, CheckpointError> {
        let bytes = vigil_files::read(path, SIZE_LIMIT).map_err(|source| CheckpointError::Read {
            path: path.to_owned(),
            source,
        })?;
        let container = |message: String| CheckpointError::Container {
            path: path.to_owned(),
            message,
        };
        let file = SafeTensors::deserialize(&bytes).map_err(|e| container(e.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| container(e.to_string()))?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let format = metadata.get(FORMAT_ENTRY).map_or("unknown", String::as_str);
        if format != FORMAT {
            return Err(container(format!("its format is \"{format}\", not \"{FORMAT}\"")));
        }
        let (found, expected) = (
            digest(&file.tensors()),
            metadata.get(DIGEST).cloned().unwrap_or_default(),
        );
        if found != expected {
            return Err(CheckpointError::Altered {
                path: path.to_owned(),
                found,
                expected,
            });
        }
        let tensor = |name: &str, dtype: Dtype| {
            let view = file.tensor(name).map_err(|e| container(e.to_string()))?;
            if view.dtype() == dtype {
                Ok(view.data().to_vec())
            } else {
                Err(container(format!("tensor {name} is {:?}, not {dtype:?}", view.dtype())))
            }
        };
        let floats = |name: &str, expected: usize| {
            let data = tensor(name, Dtype::F32)?;
            let values: Vec<f32> = data.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            if values.len() == expected {
                Ok(values)
            } else {
                Err(CheckpointError::Architecture {
                    path: path.to_owned(),
                    tensor: name.to_owned(),
                    found: values.len(),
                    expected,
                })
            }
        };
        let state: RunState =
            serde_json::from_slice(&tensor("state", Dtype::U8)?).map_err(|e| container(e.to_string()))?;
        let inconsistent = |what| CheckpointError::Inconsistent {
            path: path.to_owned(),
            what,
        };
        state.check().map_err(inconsistent)?;
        let mut weights = Weights::zeros(networks);
        for (name, values) in weights.parts_mut() {
            let read = floats(name, values.len())?;
            *values = read;
        }
        let adams: [&mut Adam; 3] = [
            &mut weights.encoder_adam,
            &mut weights.actor_adam,
            &mut weights.critic_adam,
        ];
        for (adam, steps) in adams.into_iter().zip(state.optimiser_steps) {
            adam.steps = steps;
        }
        let mut candidates = Vec::new();
        for (i, &(updates, completion)) in state.candidates.iter().enumerate() {
            let params = floats(&format!("candidate_{i}"), networks.actor_len())?;
            candidates.push(Candidate {
                updates,
                completion,
                params,
            });
        }
        let priorities = tensor("priorities", Dtype::F64)?;
        let priorities = priorities
            .as_chunks::<8>()
            .0
            .iter()
            .map(|b| f64::from_le_bytes(*b))
            .collect();
        if !weights
            .parts()
            .iter()
            .all(|(_, values)| values.iter().all(|v| v.is_finite()))
        {
            return Err(inconsistent("a weight is not finite"));
        }
        Ok(Self {
            state,
            weights,
            priorities,
            candidates,
        })
    }
}
