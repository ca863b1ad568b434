//! The frozen actor's file ([`vigil_nnet::network_file`]).
//!
//! Metadata: `format`, `architecture`, `normalisation` (these three must be this version's), `training_config` (TOML),
//! `seed`, `updates`, `git_commit`, `sha256`, `frame_ages` where the five frames are not in a row, and `led_by` where it is not the
//! goal whose bearing it is given; tensors in the order of [`ActorParams`](crate::actor::ActorParams).

extern crate alloc;
#[cfg(feature = "std")]
extern crate std;

use crate::ExplainedHead;
use crate::actor::{ACTOR_HIDDEN, Actor, ActorInputs, ActorSpec, FRAMES_IN_A_ROW, LedBy};
use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;
#[cfg(feature = "std")]
use std::path::Path;
use vigil_nnet::network_file::{Contents, FileError, Kind, Verified};
use vigil_nnet::{Isa, Purpose};

/// Value of the entry `format`.
pub const FORMAT: &str = "vigil actor 1";
/// Value of the entry `architecture`.
pub const ARCHITECTURE: &str = "5 frames of 128 x 256; conv 5x5/2 16, 4 x conv 3x3/2 32, ELU; GRU 48; tanh, position 2-6 \
    tanh; dense 32 ELU; dense 2; 1.5 tanh";
/// Value of the entry `normalisation`.
pub const NORMALISATION: &str =
    "depth 0..1 of 100 m, contrast 1 / (1 + range / 3 m) inside; distance / 20 m; bearing / 1 rad";

/// Value of the entry `architecture` of an actor that is told of movers.
pub const ARCHITECTURE_WITH_MOVERS: &str = "5 frames of 128 x 256; conv 5x5/2 16, 4 x conv 3x3/2 32, ELU; GRU 48; tanh, position \
    and movers 16-24 tanh; dense 32 ELU; dense 2; 1.5 tanh";
/// Value of the entry `normalisation` of an actor that is told of movers.
pub const NORMALISATION_WITH_MOVERS: &str = "depth 0..1 of 100 m, contrast 1 / (1 + range / 3 m) inside; distance / 20 m; \
    bearing / 1 rad; own velocity / 1.5 m/s; 2 movers of contrast, direction times contrast, velocity / 1 m/s, seen";

/// Value of the entry `led_by`.
const PATH: &str = "path";

/// An actor with what is known of its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenActor {
    /// Parameters in the order of [`ActorParams`](crate::actor::ActorParams).
    pub params: Vec<f32>,
    /// What it decides from.
    pub inputs: ActorInputs,
    /// The training configuration, TOML.
    pub training_config: String,
    /// Seed of the training.
    pub seed: u64,
    /// Updates after which it was frozen.
    pub updates: u64,
    /// Commit of the program that trained it, if known.
    pub git_commit: Option<String>,
}

/// Names and shapes of the tensors, in the order of the parameters.
fn tensors(spec: ActorSpec) -> Vec<(String, Vec<usize>)> {
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
    for (name, layer) in [
        ("positional", spec.positional()),
        ("dense", spec.dense()),
        ("output", spec.output()),
    ] {
        tensors.push((format!("{name}.weight"), vec![layer.inputs, layer.outputs]));
        tensors.push((format!("{name}.bias"), vec![layer.outputs]));
    }
    tensors
}

const KIND: Kind = Kind {
    noun: "actor",
    identity: [
        ("format", FORMAT),
        ("architecture", ARCHITECTURE),
        ("normalisation", NORMALISATION),
    ],
    tensors: || tensors(ActorSpec::FULL),
};

const KIND_WITH_MOVERS: Kind = Kind {
    identity: [
        ("format", FORMAT),
        ("architecture", ARCHITECTURE_WITH_MOVERS),
        ("normalisation", NORMALISATION_WITH_MOVERS),
    ],
    tensors: || tensors(ActorSpec::FULL_WITH_MOVERS),
    ..KIND
};

/// The actor that comes with this program.
const BUILT_IN: &[u8] = include_bytes!("../../actor/actor.safetensors");

impl FrozenActor {
    /// The actor that comes with this program.
    ///
    /// # Errors
    /// [`FileError`] if it is another architecture's.
    pub fn built_in() -> Result<Self, FileError> {
        Self::from_bytes("built into this program", BUILT_IN)
    }

    fn kind(&self) -> &'static Kind {
        if self.inputs.told_of_movers {
            &KIND_WITH_MOVERS
        } else {
            &KIND
        }
    }

    fn contents(&self) -> Contents {
        let commit = self.git_commit.iter().map(|commit| ("git_commit", commit.clone()));
        let ActorInputs { frame_ages, led_by, .. } = self.inputs;
        let ages =
            (frame_ages != FRAMES_IN_A_ROW).then(|| ("frame_ages", frame_ages.map(|age| age.to_string()).join(" ")));
        let led_by = (led_by == LedBy::Path).then(|| ("led_by", PATH.to_owned()));
        let entries = [
            ("training_config", self.training_config.clone()),
            ("seed", self.seed.to_string()),
            ("updates", self.updates.to_string()),
        ];
        let mut contents = Contents::new(self.kind(), entries.into_iter().chain(ages).chain(led_by).chain(commit));
        contents.push_all(&tensors(self.inputs.spec()), &self.params);
        contents
    }

    /// Names and shapes of its tensors, in the order of its parameters.
    pub fn tensor_shapes(&self) -> Vec<(String, Vec<usize>)> {
        tensors(self.inputs.spec())
    }

    /// The actor itself, ready to fly.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn actor(&self, isa: Isa) -> Result<Actor, FileError> {
        Actor::with_frame_ages(self.inputs.spec(), isa, &self.params, self.inputs.frame_ages)
            .map_err(|e| self.kind().content_error("in memory", e.to_string()))
    }

    /// What decides behind its split point.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn head(&self, purpose: Purpose) -> Result<ExplainedHead, FileError> {
        ExplainedHead::of_actor(self.inputs.spec(), &self.params, purpose)
            .map_err(|e| self.kind().content_error("in memory", e.to_string()))
    }

    /// The digest of the actor and its metadata.
    pub fn sha256(&self) -> String {
        self.contents().sha256()
    }

    /// The file's content.
    ///
    /// # Errors
    /// Parameters of another length, or not finite.
    #[cfg(feature = "std")]
    pub fn to_bytes(&self) -> Result<Vec<u8>, FileError> {
        self.contents().to_bytes(self.kind())
    }

    /// Reads and verifies a file's content. `file` names it in errors.
    ///
    /// # Errors
    /// [`FileError`]: anything but an unaltered actor of this architecture.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, FileError> {
        let (read, which) = Verified::of_any(&KIND, &[&KIND_WITH_MOVERS], file, bytes)?;
        let told_of_movers = which == 1;
        let frame_ages = match read.optional("frame_ages") {
            None => FRAMES_IN_A_ROW,
            Some(text) => {
                let ages: Option<Vec<usize>> = text.split(' ').map(|age| age.parse().ok()).collect();
                let ages = ages.and_then(|ages| ages.try_into().ok());
                ages.ok_or_else(|| KIND.content_error(file, format!("has frames of the ages \"{text}\"")))?
            }
        };
        let led_by = match read.optional("led_by").as_deref() {
            None => LedBy::Goal,
            Some(PATH) => LedBy::Path,
            Some(other) => {
                let message = format!("is led by \"{other}\"; this program knows \"{PATH}\"");
                return Err(KIND.content_error(file, message));
            }
        };
        Ok(Self {
            inputs: ActorInputs {
                frame_ages,
                led_by,
                told_of_movers,
            },
            training_config: read.text("training_config")?,
            seed: read.number("seed")?,
            updates: read.number("updates")?,
            git_commit: read.optional("git_commit"),
            params: read.into_values().flatten().collect(),
        })
    }

    /// Reads and verifies a file.
    ///
    /// # Errors
    /// [`FileError`].
    #[cfg(feature = "std")]
    pub fn load(path: &Path) -> Result<Self, FileError> {
        Self::from_bytes(&path.display().to_string(), &KIND.load(path)?)
    }

    /// Writes a file beside and renames it, so that an earlier one survives a full disk.
    ///
    /// # Errors
    /// [`FileError`].
    #[cfg(feature = "std")]
    pub fn save(&self, path: &Path) -> Result<(), FileError> {
        KIND.save(path, &self.to_bytes()?)
    }
}
