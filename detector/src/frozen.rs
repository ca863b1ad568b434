//! The frozen detector's file: safetensors whose metadata say what it is, and whose digest covers all of it.
//!
//! Metadata: `format`, `architecture`, `normalisation` (these three must be this version's), `actor_sha256`, `threshold`,
//! `threshold_choice`, `training_config` (TOML), `seed`, `git_commit`, and `sha256` over all other entries (sorted by key;
//! key, zero byte, value, zero byte) and then all tensors' bytes: `background.state`, `background.position`, `centre`,
//! `scale`, and the parameters in the order of [`LstmAd::tensors`].

use crate::lstm_ad::{LstmAd, ROW};
use crate::{DeepShap, ShapError};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use vigil_nnet::{ACTOR_HIDDEN, ACTOR_POSITIONAL, ActorSpec, Isa, Purpose};

/// Value of the entry `format`.
pub const FORMAT: &str = "vigil detector 1";
/// Value of the entry `architecture`.
pub const ARCHITECTURE: &str = "10 rows of 48; LSTM 100 relu; dense 64, 32, 16 relu; dense 1 sigmoid";
/// Value of the entry `normalisation`.
pub const NORMALISATION: &str =
    "DeepSHAP of the yaw output at the actor's split point; (phi - centre) / scale, clipped to 10";

/// A state of the background sample: the GRU's 48 values and the two positional inputs.
pub type Background = ([f32; ACTOR_HIDDEN], [f32; ACTOR_POSITIONAL]);

/// A detector with what it needs to explain and judge one actor, and what is known of its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenDetector {
    /// Digest of the actor whose explanations it was trained on; it cannot judge another.
    pub actor_sha256: String,
    /// DeepSHAP's background sample: states of unattacked training flights.
    pub backgrounds: Vec<Background>,
    /// Subtracted from a row.
    pub centre: [f32; ROW],
    /// Divides a row; above 0.
    pub scale: [f32; ROW],
    /// A score above it is an attack.
    pub threshold: f32,
    /// How the threshold was chosen, in words.
    pub threshold_choice: String,
    /// Parameters of the network, in the order of [`LstmAd::tensors`].
    pub params: Vec<f32>,
    /// The training configuration, TOML.
    pub training_config: String,
    /// Seed of the training.
    pub seed: u64,
    /// Commit of the program that trained it, if known.
    pub git_commit: Option<String>,
}

/// Why a detector's file is refused. Every message names the file.
#[derive(Debug, thiserror::Error)]
pub enum DetectorFileError {
    /// It cannot be read or written.
    #[error("cannot access detector {file}: {source}")]
    Access {
        /// The file.
        file: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Truncated, or something else altogether.
    #[error("detector {file} is truncated or not a safetensors file: {message}")]
    Container {
        /// The file.
        file: String,
        /// What is wrong.
        message: String,
    },
    /// A metadata entry is missing or not of its kind.
    #[error("detector {file} lacks a valid metadata entry `{key}`; it was not written by this program")]
    Missing {
        /// The file.
        file: String,
        /// The entry.
        key: &'static str,
    },
    /// Another version, architecture or normalisation.
    #[error("detector {file} has {key} \"{found}\", this program runs \"{expected}\"")]
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
    #[error("detector {file}: tensor `{tensor}` is missing or not float32 of shape {shape}")]
    Tensor {
        /// The file.
        file: String,
        /// The tensor.
        tensor: String,
        /// The shape it must have.
        shape: String,
    },
    /// The background sample has no states.
    #[error("detector {file} has an empty background sample; DeepSHAP needs states to compare with: train it anew")]
    NoBackground {
        /// The file.
        file: String,
    },
    /// The digest does not match.
    #[error("detector {file} was altered: its content has SHA-256 {found}, its own entry says {expected}")]
    Altered {
        /// The file.
        file: String,
        /// Digest of the content.
        found: String,
        /// The entry.
        expected: String,
    },
    /// A number that cannot be used.
    #[error("detector {file}: `{what}` holds a value that is not {must_be}")]
    Value {
        /// The file.
        file: String,
        /// Tensor or entry.
        what: String,
        /// What it must be.
        must_be: &'static str,
    },
}

/// DeepSHAP of an actor at its split point, against a background sample.
///
/// # Errors
/// Parameters of another architecture, an empty background sample.
pub fn split_point_shap(
    isa: Isa,
    spec: ActorSpec,
    actor_params: &[f32],
    backgrounds: &[Background],
) -> Result<DeepShap, ShapError> {
    let views: Vec<[&[f32]; 2]> = backgrounds.iter().map(|(h, p)| [h.as_slice(), p.as_slice()]).collect();
    DeepShap::new(isa, spec.head_graph(Purpose::Multipliers)?, actor_params, &views)
}

/// A named tensor: shape and values.
type Tensor = (String, Vec<usize>, Vec<f32>);

/// The digest over metadata (without `sha256`) and tensors.
fn digest(entries: &BTreeMap<&str, String>, tensors: &[Tensor]) -> String {
    let mut hash = Sha256::new();
    for (key, value) in entries {
        for part in [key.as_bytes(), &[0], value.as_bytes(), &[0]] {
            hash.update(part);
        }
    }
    for (_, _, values) in tensors {
        for value in values {
            hash.update(value.to_le_bytes());
        }
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The detector that comes with this program.
const BUILT_IN: &[u8] = include_bytes!("../frozen/lstm_ad.safetensors");

impl FrozenDetector {
    /// The detector that comes with this program, of the actor that comes with it.
    ///
    /// # Errors
    /// [`DetectorFileError`] if it is another architecture's.
    pub fn built_in() -> Result<Self, DetectorFileError> {
        Self::from_bytes("built into this program", BUILT_IN)
    }

    /// DeepSHAP of the actor with these parameters at its split point, against this detector's background sample.
    ///
    /// # Errors
    /// Parameters of another architecture, an empty background sample.
    pub fn explainer(&self, isa: Isa, spec: ActorSpec, actor_params: &[f32]) -> Result<DeepShap, ShapError> {
        split_point_shap(isa, spec, actor_params, &self.backgrounds)
    }

    fn entries(&self) -> BTreeMap<&'static str, String> {
        let mut entries = BTreeMap::from([
            ("format", FORMAT.to_owned()),
            ("architecture", ARCHITECTURE.to_owned()),
            ("normalisation", NORMALISATION.to_owned()),
            ("actor_sha256", self.actor_sha256.clone()),
            ("threshold", self.threshold.to_string()),
            ("threshold_choice", self.threshold_choice.clone()),
            ("training_config", self.training_config.clone()),
            ("seed", self.seed.to_string()),
        ]);
        if let Some(commit) = &self.git_commit {
            entries.insert("git_commit", commit.clone());
        }
        entries
    }

    fn tensors(&self) -> Vec<Tensor> {
        let count = self.backgrounds.len();
        let states = self.backgrounds.iter().flat_map(|(state, _)| state).copied();
        let positions = self.backgrounds.iter().flat_map(|(_, position)| position).copied();
        let mut tensors = vec![
            (
                "background.state".to_owned(),
                vec![count, ACTOR_HIDDEN],
                states.collect(),
            ),
            (
                "background.position".to_owned(),
                vec![count, ACTOR_POSITIONAL],
                positions.collect(),
            ),
            ("centre".to_owned(), vec![ROW], self.centre.to_vec()),
            ("scale".to_owned(), vec![ROW], self.scale.to_vec()),
        ];
        let mut rest = self.params.as_slice();
        for (name, shape) in LstmAd::tensors() {
            let len: usize = shape.iter().product();
            let (own, after) = rest.split_at_checked(len).unwrap_or((rest, &[]));
            tensors.push((name, shape, own.to_vec()));
            rest = after;
        }
        tensors
    }

    /// The digest of the detector and its metadata.
    pub fn sha256(&self) -> String {
        digest(&self.entries(), &self.tensors())
    }

    /// Checks what a file's reader would refuse.
    fn check(&self, file: &str) -> Result<(), DetectorFileError> {
        let value = |what: &str, must_be| DetectorFileError::Value {
            file: file.to_owned(),
            what: what.to_owned(),
            must_be,
        };
        if self.backgrounds.is_empty() {
            return Err(DetectorFileError::NoBackground { file: file.to_owned() });
        }
        for (name, _, values) in self.tensors() {
            if !values.iter().all(|x| x.is_finite()) {
                return Err(value(&name, "finite"));
            }
        }
        if !self.scale.iter().all(|scale| *scale > 0.0) {
            return Err(value("scale", "above 0"));
        }
        if !(self.threshold > 0.0 && self.threshold < 1.0) {
            return Err(value("threshold", "between 0 and 1"));
        }
        Ok(())
    }

    /// The file's content.
    ///
    /// # Errors
    /// [`DetectorFileError`]: what a reader would refuse, parameters of another length.
    pub fn to_bytes(&self) -> Result<Vec<u8>, DetectorFileError> {
        let file = "to be written";
        self.check(file)?;
        let container = |message: String| DetectorFileError::Container {
            file: file.to_owned(),
            message,
        };
        let expected: usize = LstmAd::tensors().iter().map(|(_, s)| s.iter().product::<usize>()).sum();
        if self.params.len() != expected {
            let got = self.params.len();
            return Err(container(format!("{got} parameters instead of {expected}")));
        }
        let tensors = self.tensors();
        let bytes: Vec<Vec<u8>> = tensors
            .iter()
            .map(|(_, _, values)| values.iter().flat_map(|x| x.to_le_bytes()).collect())
            .collect();
        let mut views = Vec::new();
        for ((name, shape, _), bytes) in tensors.iter().zip(&bytes) {
            let view = TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(|e| container(e.to_string()))?;
            views.push((name.clone(), view));
        }
        let mut metadata: HashMap<String, String> =
            self.entries().into_iter().map(|(k, v)| (k.to_owned(), v)).collect();
        metadata.insert("sha256".to_owned(), self.sha256());
        safetensors::serialize(views, Some(metadata)).map_err(|e| container(e.to_string()))
    }

    /// Reads and verifies a file's content. `file` names it in errors.
    ///
    /// # Errors
    /// [`DetectorFileError`]: anything but an unaltered detector of this architecture.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, DetectorFileError> {
        let named = || file.to_owned();
        let container = |e: safetensors::SafeTensorError| DetectorFileError::Container {
            file: file.to_owned(),
            message: e.to_string(),
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(container)?;
        let content = SafeTensors::deserialize(bytes).map_err(container)?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let missing = |key: &'static str| DetectorFileError::Missing { file: named(), key };
        let entry = |key: &'static str| metadata.get(key).cloned().ok_or_else(|| missing(key));
        for (key, expected) in [
            ("format", FORMAT),
            ("architecture", ARCHITECTURE),
            ("normalisation", NORMALISATION),
        ] {
            let found = entry(key)?;
            if found != expected {
                return Err(DetectorFileError::Other {
                    file: named(),
                    key,
                    found,
                    expected,
                });
            }
        }
        // Values of a tensor whose shape is given but for the first size, which is free where it is 0.
        let read = |tensor: &str, shape: &[usize]| {
            let fits = |got: &[usize]| {
                got.len() == shape.len() && got.iter().zip(shape).all(|(got, want)| *want == 0 || got == want)
            };
            let view = content.tensor(tensor).ok();
            let view = view.filter(|view| view.dtype() == Dtype::F32 && fits(view.shape()));
            let Some(view) = view else {
                return Err(DetectorFileError::Tensor {
                    file: named(),
                    tensor: tensor.to_owned(),
                    shape: format!("{shape:?}").replace("[0,", "[any,"),
                });
            };
            let values = view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
            Ok(values.collect::<Vec<f32>>())
        };
        let states = read("background.state", &[0, ACTOR_HIDDEN])?;
        let positions = read("background.position", &[0, ACTOR_POSITIONAL])?;
        let (states, positions) = (states.as_chunks::<ACTOR_HIDDEN>().0, positions.as_chunks().0);
        if states.len() != positions.len() {
            return Err(DetectorFileError::Tensor {
                file: named(),
                tensor: "background.position".to_owned(),
                shape: format!("[{}, {ACTOR_POSITIONAL}]", states.len()),
            });
        }
        let row = |tensor: &str| {
            let values = read(tensor, &[ROW])?;
            Ok(values.first_chunk::<ROW>().copied().unwrap_or([f32::NAN; ROW]))
        };
        let (centre, scale) = (row("centre")?, row("scale")?);
        let mut params = Vec::new();
        for (tensor, shape) in LstmAd::tensors() {
            params.extend(read(&tensor, &shape)?);
        }
        let read = Self {
            actor_sha256: entry("actor_sha256")?,
            backgrounds: states.iter().copied().zip(positions.iter().copied()).collect(),
            centre,
            scale,
            threshold: entry("threshold")?.parse().map_err(|_| missing("threshold"))?,
            threshold_choice: entry("threshold_choice")?,
            params,
            training_config: entry("training_config")?,
            seed: entry("seed")?.parse().map_err(|_| missing("seed"))?,
            git_commit: metadata.get("git_commit").cloned(),
        };
        let expected = entry("sha256")?;
        let entries: BTreeMap<&str, String> = metadata
            .iter()
            .filter(|(key, _)| *key != "sha256")
            .map(|(key, value)| (key.as_str(), value.clone()))
            .collect();
        let found = digest(&entries, &read.tensors());
        if found != expected {
            return Err(DetectorFileError::Altered {
                file: named(),
                found,
                expected,
            });
        }
        read.check(file)?;
        Ok(read)
    }

    /// Reads and verifies a file.
    ///
    /// # Errors
    /// [`DetectorFileError`].
    pub fn load(path: &Path) -> Result<Self, DetectorFileError> {
        let file = path.display().to_string();
        match std::fs::read(path) {
            Ok(bytes) => Self::from_bytes(&file, &bytes),
            Err(source) => Err(DetectorFileError::Access { file, source }),
        }
    }

    /// Writes a file beside and renames it, so that an earlier one survives a full disk.
    ///
    /// # Errors
    /// [`DetectorFileError`].
    pub fn save(&self, path: &Path) -> Result<(), DetectorFileError> {
        let bytes = self.to_bytes()?;
        let beside = path.with_extension("new");
        std::fs::write(&beside, bytes)
            .and_then(|()| std::fs::rename(&beside, path))
            .map_err(|source| DetectorFileError::Access {
                file: path.display().to_string(),
                source,
            })
    }
}
