//! The frozen detector's file ([`vigil_nnet::network_file`]).
//!
//! Metadata: `format`, `architecture`, `normalisation` (these three must be this version's), `actor_sha256`, `threshold`,
//! `threshold_choice`, `training_config` (TOML), `seed`, `git_commit`, `sha256`; tensors: `background.state`,
//! `background.position`, `centre`, `scale`, and the parameters in the order of [`LstmAd::tensors`].

use crate::lstm_ad::{LstmAd, ROW};
use crate::{DeepShap, ShapError};
use alloc::borrow::ToOwned;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use vigil_nnet::Isa;
use vigil_nnet::network_file::{Contents, FileError, Kind, Verified};
use vigil_policy::actor::{ACTOR_HIDDEN, GOAL_INPUTS, LOW_DIM, LowDim};
use vigil_policy::{ExplainedHead, FrozenPilot};

/// Value of the entry `format`.
pub const FORMAT: &str = "vigil detector 2";
/// Of the actors that decided from five frames, and the version that flies them.
const FORMAT_BEFORE: (&str, &str) = ("vigil detector 1", "0.2.0");
/// Value of the entry `architecture`.
pub const ARCHITECTURE: &str = "10 rows of 48; LSTM 100 relu; dense 64, 32, 16 relu; dense 1 sigmoid";
/// Value of the entry `normalisation`.
pub const NORMALISATION: &str =
    "DeepSHAP of the yaw output at the actor's split point; (phi - centre) / scale, clipped to 10";
/// Value of the entry `normalisation` of a detector of an imported policy.
pub const NORMALISATION_IMPORTED: &str = "DeepSHAP of the yaw output at an imported policy's split point in rows of 48; (phi - centre) / scale, clipped to 10";

/// A state of the background sample: the split point's values (48 of our actor), and what decides beside them (8 values, or 2 of an
/// imported policy).
pub type Background = (Vec<f32>, LowDim);

/// A detector with what it needs to explain and score one actor, and what is known of its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenDetector {
    /// Whose explanations it judges.
    pub of: Of,
    /// Digest of the pilot whose explanations it was trained on; it cannot score another.
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

/// DeepSHAP of a pilot at its split point, against a background sample.
///
/// # Errors
/// Parameters of another architecture, an empty background sample.
pub fn split_point_shap(isa: Isa, head: ExplainedHead, backgrounds: &[Background]) -> Result<DeepShap, ShapError> {
    let views: Vec<[&[f32]; 2]> = backgrounds.iter().map(|(h, p)| [h.as_slice(), &**p]).collect();
    DeepShap::new(isa, head.graph, &head.params, &views)
}

/// Whose explanations a detector judges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Of {
    /// An actor of ours.
    Actor,
    /// A policy of others.
    Imported,
}

impl Of {
    /// Its kind of file, and how many values decide beside a split point.
    fn parts(self) -> (&'static Kind, usize) {
        match self {
            Self::Actor => (&KIND, LOW_DIM),
            Self::Imported => (&KIND_IMPORTED, GOAL_INPUTS),
        }
    }

    /// Of whom a file's detector is.
    pub fn pilot(pilot: &FrozenPilot) -> Self {
        match pilot {
            FrozenPilot::Imported(_) => Self::Imported,
            FrozenPilot::Actor(_) => Self::Actor,
        }
    }
}

const KIND: Kind = kind(NORMALISATION, || tensors(ACTOR_HIDDEN, LOW_DIM));
/// Of an imported policy, whose split point has any width.
const KIND_IMPORTED: Kind = kind(NORMALISATION_IMPORTED, || tensors(0, GOAL_INPUTS));

const fn kind(normalisation: &'static str, tensors: fn() -> Vec<(String, Vec<usize>)>) -> Kind {
    Kind {
        noun: "detector",
        identity: [
            ("format", FORMAT),
            ("architecture", ARCHITECTURE),
            ("normalisation", normalisation),
        ],
        tensors,
    }
}

/// Says of a file of the format before which version flies it.
fn of_before(file: &str, refused: FileError) -> FileError {
    let (format, version) = FORMAT_BEFORE;
    match refused {
        FileError::Other { key: "format", found, .. } if found == format => KIND.content_error(
            file,
            format!(
                "has format \"{format}\", of an actor that decides from five frames: Vigil {version} flies it. This program takes \
                 \"{FORMAT}\": train one for the actor that is to fly (vigil detector train)"
            ),
        ),
        other => other,
    }
}

/// Names and shapes of the tensors: any number of background states; 0 stands for any width.
fn tensors(state: usize, low_dim: usize) -> Vec<(String, Vec<usize>)> {
    let own = [
        ("background.state", vec![0, state]),
        ("background.position", vec![0, low_dim]),
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

    /// DeepSHAP of the pilot that decides so behind its split point, against this detector's background sample.
    ///
    /// # Errors
    /// Parameters of another architecture, an empty background sample.
    pub fn explainer(&self, isa: Isa, head: ExplainedHead) -> Result<DeepShap, ShapError> {
        split_point_shap(isa, head, &self.backgrounds)
    }

    /// Values of the split point.
    fn width(&self) -> usize {
        self.backgrounds.first().map_or(ACTOR_HIDDEN, |(state, _)| state.len())
    }

    fn contents(&self) -> Contents {
        let (kind, low_dim) = self.of.parts();
        let commit = self.git_commit.iter().map(|commit| ("git_commit", commit.clone()));
        let entries = [
            ("actor_sha256", self.actor_sha256.clone()),
            ("threshold", self.threshold.to_string()),
            ("threshold_choice", self.threshold_choice.clone()),
            ("training_config", self.training_config.clone()),
            ("seed", self.seed.to_string()),
        ];
        let mut contents = Contents::new(kind, entries.into_iter().chain(commit));
        let count = self.backgrounds.len();
        let states = self.backgrounds.iter().flat_map(|(state, _)| state).copied();
        let low_dims = self.backgrounds.iter().flat_map(|(_, low_dim)| low_dim.iter()).copied();
        contents.push("background.state", &[count, self.width()], states.collect());
        contents.push("background.position", &[count, low_dim], low_dims.collect());
        contents.push("centre", &[ROW], self.centre.to_vec());
        contents.push("scale", &[ROW], self.scale.to_vec());
        contents.push_all(&LstmAd::tensors(), &self.params);
        contents
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

    /// Reads and verifies a file's content. `file` names it in errors.
    ///
    /// # Errors
    /// [`FileError`]: anything but an unaltered detector of this architecture.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, FileError> {
        let (read, of) = match Verified::from_bytes(&KIND, file, bytes) {
            Err(refused @ FileError::Other { .. }) => match Verified::from_bytes(&KIND_IMPORTED, file, bytes) {
                // Of neither: in the first one's words.
                Err(FileError::Other { .. }) => return Err(of_before(file, refused)),
                read => (read?, Of::Imported),
            },
            read => (read?, Of::Actor),
        };
        let mut detector = Self {
            of,
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
        let (states, low_dims) = (next(), next());
        let low_dims = low_dims.chunks_exact(of.parts().1);
        let low_dims: Vec<LowDim> = low_dims.filter_map(LowDim::from_values).collect();
        let width = states.len() / low_dims.len().max(1);
        // An empty sample is refused by its own name, below.
        let is_empty = states.is_empty() && low_dims.is_empty();
        let is_known = of == Of::Imported && width > 0 || width == ACTOR_HIDDEN;
        if !is_empty && (!is_known || states.len() != width * low_dims.len()) {
            let message = format!(
                "has {} values of background states, but positions of {}",
                states.len(),
                low_dims.len()
            );
            return Err(KIND.content_error(file, message));
        }
        let states = states.chunks_exact(width.max(1)).map(<[f32]>::to_vec);
        detector.backgrounds = states.zip(low_dims).collect();
        detector.centre.copy_from_slice(&next());
        detector.scale.copy_from_slice(&next());
        detector.params = values.flatten().collect();
        detector.check(file)?;
        Ok(detector)
    }
}

vigil_nnet::stored_network!(FrozenDetector, KIND, check);
