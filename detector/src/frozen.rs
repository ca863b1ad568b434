//! The frozen detector's file ([`vigil_nnet::network_file`]).
//!
//! Metadata: `format`, `architecture`, `normalisation` (these three must be this version's), `actor_sha256`, `threshold`,
//! `threshold_choice`, `training_config` (TOML), `seed`, `git_commit`, `sha256`; tensors: `background.state`,
//! `background.position`, `centre`, `scale`, and the parameters in the order of [`LstmAd::tensors`].

use crate::lstm_ad::{LstmAd, ROW};
use crate::{DeepShap, ShapError};
use std::path::Path;
use vigil_nnet::network_file::{Contents, FileError, Kind, Verified};
use vigil_nnet::{Isa, Purpose};
use vigil_policy::actor::{ACTOR_HIDDEN, ActorSpec, GOAL_INPUTS, PositionalInputs, WITH_MOVERS};

/// Value of the entry `format`.
pub const FORMAT: &str = "vigil detector 1";
/// Value of the entry `architecture`.
pub const ARCHITECTURE: &str = "10 rows of 48; LSTM 100 relu; dense 64, 32, 16 relu; dense 1 sigmoid";
/// Value of the entry `normalisation`.
pub const NORMALISATION: &str =
    "DeepSHAP of the yaw output at the actor's split point; (phi - centre) / scale, clipped to 10";
/// Value of the entry `normalisation` of a detector of an actor that is told of movers.
pub const NORMALISATION_WITH_MOVERS: &str = "DeepSHAP of the yaw output at the split point of an actor that is told of movers; \
    (phi - centre) / scale, clipped to 10";

/// A state of the background sample: the GRU's 48 values and the positional inputs.
pub type Background = ([f32; ACTOR_HIDDEN], PositionalInputs);

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

/// The dimensions of the actor that met these states.
pub fn spec_of(backgrounds: &[Background]) -> ActorSpec {
    match backgrounds.first() {
        Some((_, position)) if position.len() == WITH_MOVERS => ActorSpec::FULL_WITH_MOVERS,
        _ => ActorSpec::FULL,
    }
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
    let views: Vec<[&[f32]; 2]> = backgrounds.iter().map(|(h, p)| [h.as_slice(), &**p]).collect();
    DeepShap::new(isa, spec.head_graph(Purpose::Multipliers)?, actor_params, &views)
}

const KIND: Kind = Kind {
    noun: "detector",
    identity: [
        ("format", FORMAT),
        ("architecture", ARCHITECTURE),
        ("normalisation", NORMALISATION),
    ],
    tensors: || tensors(GOAL_INPUTS),
};

/// Of an actor that is told of movers.
const KIND_WITH_MOVERS: Kind = Kind {
    identity: [
        ("format", FORMAT),
        ("architecture", ARCHITECTURE),
        ("normalisation", NORMALISATION_WITH_MOVERS),
    ],
    tensors: || tensors(WITH_MOVERS),
    ..KIND
};

/// Names and shapes of the tensors: any number of background states.
fn tensors(positional: usize) -> Vec<(String, Vec<usize>)> {
    let own = [
        ("background.state", vec![0, ACTOR_HIDDEN]),
        ("background.position", vec![0, positional]),
        ("centre", vec![ROW]),
        ("scale", vec![ROW]),
    ];
    let own = own.into_iter().map(|(name, shape)| (name.to_owned(), shape));
    own.chain(LstmAd::tensors()).collect()
}

/// The detector that comes with this program.
const BUILT_IN: &[u8] = include_bytes!("../frozen/lstm_ad.safetensors");

impl FrozenDetector {
    /// The detector that comes with this program, of the actor that comes with it.
    ///
    /// # Errors
    /// [`FileError`] if it is another architecture's.
    pub fn built_in() -> Result<Self, FileError> {
        Self::from_bytes("built into this program", BUILT_IN)
    }

    /// DeepSHAP of the actor with these parameters at its split point, against this detector's background sample.
    ///
    /// # Errors
    /// Parameters of another architecture, an empty background sample.
    pub fn explainer(&self, isa: Isa, spec: ActorSpec, actor_params: &[f32]) -> Result<DeepShap, ShapError> {
        split_point_shap(isa, spec, actor_params, &self.backgrounds)
    }

    /// The dimensions of the actors that it can judge.
    pub fn spec(&self) -> ActorSpec {
        spec_of(&self.backgrounds)
    }

    fn kind(&self) -> &'static Kind {
        if self.spec().told_of_movers {
            &KIND_WITH_MOVERS
        } else {
            &KIND
        }
    }

    fn contents(&self) -> Contents {
        let commit = self.git_commit.iter().map(|commit| ("git_commit", commit.clone()));
        let entries = [
            ("actor_sha256", self.actor_sha256.clone()),
            ("threshold", self.threshold.to_string()),
            ("threshold_choice", self.threshold_choice.clone()),
            ("training_config", self.training_config.clone()),
            ("seed", self.seed.to_string()),
        ];
        let mut contents = Contents::new(self.kind(), entries.into_iter().chain(commit));
        let count = self.backgrounds.len();
        let states = self.backgrounds.iter().flat_map(|(state, _)| state).copied();
        let positions = self
            .backgrounds
            .iter()
            .flat_map(|(_, position)| position.iter())
            .copied();
        contents.push("background.state", &[count, ACTOR_HIDDEN], states.collect());
        contents.push(
            "background.position",
            &[count, self.spec().positional().inputs],
            positions.collect(),
        );
        contents.push("centre", &[ROW], self.centre.to_vec());
        contents.push("scale", &[ROW], self.scale.to_vec());
        contents.push_all(&LstmAd::tensors(), &self.params);
        contents
    }

    /// The digest of the detector and its metadata.
    pub fn sha256(&self) -> String {
        self.contents().sha256()
    }

    /// Checks what a file's reader would refuse.
    fn check(&self, file: &str) -> Result<(), FileError> {
        let refused = |message: &str| Err(KIND.content_error(file, message));
        if self.backgrounds.is_empty() {
            return refused("has an empty background sample; DeepSHAP needs states to compare with: train it anew");
        }
        if !self.scale.iter().all(|scale| *scale > 0.0) {
            return refused("has a value in `scale` that is not above 0");
        }
        if !(self.threshold > 0.0 && self.threshold < 1.0) {
            return refused("has a `threshold` that is not between 0 and 1");
        }
        Ok(())
    }

    /// The file's content.
    ///
    /// # Errors
    /// [`FileError`]: what a reader would refuse, parameters of another length.
    pub fn to_bytes(&self) -> Result<Vec<u8>, FileError> {
        self.check("to be written")?;
        self.contents().to_bytes(self.kind())
    }

    /// Reads and verifies a file's content. `file` names it in errors.
    ///
    /// # Errors
    /// [`FileError`]: anything but an unaltered detector of this architecture.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, FileError> {
        let (read, told_of_movers) = Verified::of_either(&KIND, &KIND_WITH_MOVERS, file, bytes)?;
        let spec = if told_of_movers {
            ActorSpec::FULL_WITH_MOVERS
        } else {
            ActorSpec::FULL
        };
        let mut detector = Self {
            actor_sha256: read.text("actor_sha256")?,
            backgrounds: Vec::new(),
            centre: [0.0; ROW],
            scale: [0.0; ROW],
            threshold: read.number("threshold")?,
            threshold_choice: read.text("threshold_choice")?,
            params: Vec::new(),
            training_config: read.text("training_config")?,
            seed: read.number("seed")?,
            git_commit: read.optional("git_commit"),
        };
        let mut values = read.into_values();
        // The reader has checked every length but the number of states.
        let mut next = || values.next().unwrap_or_default();
        let (states, positions) = (next(), next());
        let states = states.as_chunks().0;
        let positions = positions.chunks_exact(spec.positional().inputs);
        let positions: Vec<PositionalInputs> = positions.filter_map(PositionalInputs::from_values).collect();
        if states.len() != positions.len() {
            let message = format!(
                "has {} background states, but positions of {}",
                states.len(),
                positions.len()
            );
            return Err(KIND.content_error(file, message));
        }
        detector.backgrounds = states.iter().copied().zip(positions).collect();
        detector.centre.copy_from_slice(&next());
        detector.scale.copy_from_slice(&next());
        detector.params = values.flatten().collect();
        detector.check(file)?;
        Ok(detector)
    }

    /// Reads and verifies a file.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn load(path: &Path) -> Result<Self, FileError> {
        Self::from_bytes(&path.display().to_string(), &KIND.load(path)?)
    }

    /// Writes a file beside and renames it, so that an earlier one survives a full disk.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn save(&self, path: &Path) -> Result<(), FileError> {
        KIND.save(path, &self.to_bytes()?)
    }
}
