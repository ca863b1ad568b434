//! The frozen actor's file: safetensors whose metadata say what it is, and whose digest covers all of it.
//!
//! Metadata: `format`, `architecture`, `normalisation` (these three must be this version's), `training_config` (TOML),
//! `seed`, `updates`, `git_commit`, and `sha256` over all other entries (sorted by key; key, zero byte, value, zero byte) and
//! then all tensors' bytes in the order of [`vigil_nnet::ActorParams`].

extern crate std;

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use sha2::{Digest, Sha256};
use std::borrow::ToOwned;
use std::collections::{BTreeMap, HashMap};
use std::format;
use std::path::Path;
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;
use vigil_nnet::{ACTOR_HIDDEN, ACTOR_POSITIONAL, Actor, ActorSpec, GraphBuilder, Isa};

/// Value of the entry `format`.
pub const FORMAT: &str = "vigil actor 1";
/// Value of the entry `architecture`.
pub const ARCHITECTURE: &str = "5 frames of 128 x 256; conv 5x5/2 16, 4 x conv 3x3/2 32, ELU; GRU 48; tanh, position 2-6 \
    tanh; dense 32 ELU; dense 2; 1.5 tanh";
/// Value of the entry `normalisation`.
pub const NORMALISATION: &str =
    "depth 0..1 of 100 m, contrast 1 / (1 + range / 3 m) inside; distance / 20 m; bearing / 1 rad";

/// An actor with what is known of its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenActor {
    /// Parameters in the order of [`vigil_nnet::ActorParams`].
    pub params: Vec<f32>,
    /// The training configuration, TOML.
    pub training_config: String,
    /// Seed of the training.
    pub seed: u64,
    /// Updates after which it was frozen.
    pub updates: u64,
    /// Commit of the program that trained it, if known.
    pub git_commit: Option<String>,
}

/// Why an actor's file is refused. Every message names the file.
#[derive(Debug, thiserror::Error)]
pub enum ActorFileError {
    /// It cannot be read or written.
    #[error("cannot access actor {file}: {source}")]
    Access {
        /// The file.
        file: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Truncated, or something else altogether.
    #[error("actor {file} is truncated or not a safetensors file: {message}")]
    Container {
        /// The file.
        file: String,
        /// What is wrong.
        message: String,
    },
    /// A metadata entry is missing.
    #[error("actor {file} lacks the metadata entry `{key}`; it was not written by this program")]
    Missing {
        /// The file.
        file: String,
        /// The entry.
        key: &'static str,
    },
    /// Another version, architecture or normalisation.
    #[error("actor {file} has {key} \"{found}\", this program flies \"{expected}\"")]
    Other {
        /// The file.
        file: String,
        /// The entry.
        key: &'static str,
        /// Its value.
        found: String,
        /// What it must be.
        expected: &'static str,
    },
    /// A tensor is missing or has another shape.
    #[error("actor {file}: tensor `{tensor}` is missing or not float32 of shape {shape:?}")]
    Tensor {
        /// The file.
        file: String,
        /// The tensor.
        tensor: String,
        /// The shape it must have.
        shape: Vec<usize>,
    },
    /// The digest does not match.
    #[error("actor {file} was altered: its content has SHA-256 {found}, its own entry says {expected}")]
    Altered {
        /// The file.
        file: String,
        /// Digest of the content.
        found: String,
        /// The entry.
        expected: String,
    },
    /// A parameter is NaN or infinite.
    #[error("actor {file}: tensor `{tensor}` holds a number that is not finite")]
    NotFinite {
        /// The file.
        file: String,
        /// The tensor.
        tensor: String,
    },
}

/// Names and shapes of the tensors, in the order of the parameters.
fn tensors() -> Vec<(String, Vec<usize>)> {
    let spec = ActorSpec::FULL;
    let layout = spec.reserve(&mut GraphBuilder::new());
    let mut tensors = Vec::new();
    for (i, c) in spec.convolutions().iter().enumerate() {
        let name = format!("convolution_{}", i + 1);
        tensors.push((
            format!("{name}.weight"),
            vec![c.kernel, c.kernel, c.channels, c.filters],
        ));
        tensors.push((format!("{name}.bias"), vec![c.filters]));
    }
    let gates = 3 * ACTOR_HIDDEN;
    tensors.push(("gru.input_weight".to_owned(), vec![spec.features(), gates]));
    tensors.push(("gru.recurrent_weight".to_owned(), vec![ACTOR_HIDDEN, gates]));
    tensors.push(("gru.input_bias".to_owned(), vec![gates]));
    tensors.push(("gru.recurrent_bias".to_owned(), vec![gates]));
    // A dense layer holds inputs × outputs weights and outputs biases.
    let positional = layout.positional.len / (ACTOR_POSITIONAL + 1);
    let joined = ACTOR_HIDDEN + positional;
    let hidden = layout.dense.len / (joined + 1);
    let outputs = layout.output.len / (hidden + 1);
    for (name, inputs, outputs) in [
        ("positional", ACTOR_POSITIONAL, positional),
        ("dense", joined, hidden),
        ("output", hidden, outputs),
    ] {
        tensors.push((format!("{name}.weight"), vec![inputs, outputs]));
        tensors.push((format!("{name}.bias"), vec![outputs]));
    }
    tensors
}

/// The digest over metadata (without `sha256`) and parameters.
fn digest(entries: &BTreeMap<&str, String>, params: &[f32]) -> String {
    let mut hash = Sha256::new();
    for (key, value) in entries {
        for part in [key.as_bytes(), &[0], value.as_bytes(), &[0]] {
            hash.update(part);
        }
    }
    for p in params {
        hash.update(p.to_le_bytes());
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The actor that comes with this program.
const BUILT_IN: &[u8] = include_bytes!("../actor/actor.safetensors");

impl FrozenActor {
    /// The actor that comes with this program.
    ///
    /// # Errors
    /// [`ActorFileError`] if it is another architecture's.
    pub fn built_in() -> Result<Self, ActorFileError> {
        Self::from_bytes("built into this program", BUILT_IN)
    }

    fn entries(&self) -> BTreeMap<&'static str, String> {
        let mut entries = BTreeMap::from([
            ("format", FORMAT.to_owned()),
            ("architecture", ARCHITECTURE.to_owned()),
            ("normalisation", NORMALISATION.to_owned()),
            ("training_config", self.training_config.clone()),
            ("seed", self.seed.to_string()),
            ("updates", self.updates.to_string()),
        ]);
        if let Some(commit) = &self.git_commit {
            entries.insert("git_commit", commit.clone());
        }
        entries
    }

    /// The actor itself, ready to fly.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn actor(&self, isa: Isa) -> Result<Actor, ActorFileError> {
        Actor::new(ActorSpec::FULL, isa, &self.params).map_err(|e| ActorFileError::Container {
            file: "in memory".to_owned(),
            message: e.to_string(),
        })
    }

    /// The digest of the actor and its metadata.
    pub fn sha256(&self) -> String {
        digest(&self.entries(), &self.params)
    }

    /// The file's content.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn to_bytes(&self) -> Result<Vec<u8>, ActorFileError> {
        let container = |message: String| ActorFileError::Container {
            file: "to be written".to_owned(),
            message,
        };
        let bytes: Vec<u8> = self.params.iter().flat_map(|p| p.to_le_bytes()).collect();
        let mut views = Vec::new();
        let mut rest = bytes.as_slice();
        for (name, shape) in tensors() {
            let len = 4 * shape.iter().product::<usize>();
            let (own, after) = rest
                .split_at_checked(len)
                .ok_or_else(|| container("too few parameters".to_owned()))?;
            rest = after;
            let view = TensorView::new(Dtype::F32, shape, own).map_err(|e| container(e.to_string()))?;
            views.push((name, view));
        }
        if !rest.is_empty() {
            return Err(container("too many parameters".to_owned()));
        }
        let mut metadata: HashMap<String, String> =
            self.entries().into_iter().map(|(k, v)| (k.to_owned(), v)).collect();
        metadata.insert("sha256".to_owned(), self.sha256());
        safetensors::serialize(views, Some(metadata)).map_err(|e| container(e.to_string()))
    }

    /// Reads and verifies a file's content. `file` names it in errors.
    ///
    /// # Errors
    /// [`ActorFileError`]: anything but an unaltered actor of this architecture.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, ActorFileError> {
        let named = || file.to_owned();
        let container = |e: safetensors::SafeTensorError| ActorFileError::Container {
            file: file.to_owned(),
            message: e.to_string(),
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(container)?;
        let content = SafeTensors::deserialize(bytes).map_err(container)?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let entry = |key: &'static str| {
            metadata
                .get(key)
                .cloned()
                .ok_or_else(|| ActorFileError::Missing { file: named(), key })
        };
        for (key, expected) in [
            ("format", FORMAT),
            ("architecture", ARCHITECTURE),
            ("normalisation", NORMALISATION),
        ] {
            let found = entry(key)?;
            if found != expected {
                return Err(ActorFileError::Other {
                    file: named(),
                    key,
                    found,
                    expected,
                });
            }
        }
        let mut params = Vec::new();
        for (tensor, shape) in tensors() {
            let view = content
                .tensor(&tensor)
                .ok()
                .filter(|view| view.dtype() == Dtype::F32 && view.shape() == shape);
            let Some(view) = view else {
                return Err(ActorFileError::Tensor {
                    file: named(),
                    tensor,
                    shape,
                });
            };
            let from = params.len();
            params.extend(view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)));
            if !params.iter().skip(from).all(|p: &f32| p.is_finite()) {
                return Err(ActorFileError::NotFinite { file: named(), tensor });
            }
        }
        let expected = entry("sha256")?;
        let entries: BTreeMap<&str, String> = metadata
            .iter()
            .filter(|(key, _)| *key != "sha256")
            .map(|(key, value)| (key.as_str(), value.clone()))
            .collect();
        let found = digest(&entries, &params);
        if found != expected {
            return Err(ActorFileError::Altered {
                file: named(),
                found,
                expected,
            });
        }
        let number = |key: &'static str| {
            let text = entry(key)?;
            text.parse().map_err(|_| ActorFileError::Missing { file: named(), key })
        };
        Ok(Self {
            params,
            training_config: entry("training_config")?,
            seed: number("seed")?,
            updates: number("updates")?,
            git_commit: metadata.get("git_commit").cloned(),
        })
    }

    /// Reads and verifies a file.
    ///
    /// # Errors
    /// [`ActorFileError`].
    pub fn load(path: &Path) -> Result<Self, ActorFileError> {
        let file = path.display().to_string();
        match std::fs::read(path) {
            Ok(bytes) => Self::from_bytes(&file, &bytes),
            Err(source) => Err(ActorFileError::Access { file, source }),
        }
    }

    /// Writes a file beside and renames it, so that an earlier one survives a full disk.
    ///
    /// # Errors
    /// [`ActorFileError`].
    pub fn save(&self, path: &Path) -> Result<(), ActorFileError> {
        let bytes = self.to_bytes()?;
        let beside = path.with_extension("new");
        std::fs::write(&beside, bytes)
            .and_then(|()| std::fs::rename(&beside, path))
            .map_err(|source| ActorFileError::Access {
                file: path.display().to_string(),
                source,
            })
    }
}
