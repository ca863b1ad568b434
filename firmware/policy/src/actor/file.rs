//! The frozen actor's file ([`vigil_nnet::network_file`]).
//!
//! Metadata: `format`, `architecture`, `normalisation` (these three must be this version's), `training_config` (TOML),
//! `seed`, `updates`, `cruise_m_s` (1.5 where it is missing), `git_commit`, `sha256`; tensors in the order of
//! [`ActorParams`](crate::actor::ActorParams).

use crate::ExplainedHead;
use crate::actor::{ACTOR_LIMIT, Actor, ActorSpec};
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;
use vigil_nnet::network_file::{Contents, FileError, Kind, Verified};
use vigil_nnet::{Isa, Purpose};
use vigil_types::FASTEST_M_S;

/// The slowest that an actor may be trained to fly, metres per second.
pub const SLOWEST_M_S: f32 = 0.5;
/// Value of the entry `format`.
pub const FORMAT: &str = "vigil actor 2";
/// Value of the entry `format` of actors of version 0.2.0.
const FORMAT_OF_0_2_0: &str = "vigil actor 1";
/// Value of the entry `architecture`.
pub const ARCHITECTURE: &str = "frame of 128 x 256; conv 5x5/2 16, conv 3x3/2 16, 3 x conv 3x3/2 32, ELU; scan 64 sigmoid; with memory 328 \
    to 256, 128, layer norm, ELU; 48; tanh, low-dimensional 8-24 tanh; dense 64, 32 ELU; dense 2; 1.5 tanh";
/// Value of the entry `normalisation`.
pub const NORMALISATION: &str = "depth 0..1 of 100 m, proximity 1 / (1 + range / 3 m) inside; ln(1 + distance) / ln 22, sine and cosine of the \
    bearing; velocity / 1.5 m/s, yaw rate / 45 deg/s, last action / 1.5";

/// An actor with what is known of its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenActor {
    /// Parameters in the order of [`ActorParams`](crate::actor::ActorParams).
    pub params: Vec<f32>,
    /// The training configuration, TOML.
    pub training_config: String,
    /// Seed of the training.
    pub seed: u64,
    /// Updates after which it was frozen.
    pub updates: u64,
    /// What its first output is at its limit, metres per second: [`ACTOR_LIMIT`] but for one that was trained to be faster.
    pub cruise_m_s: f32,
    /// Commit of the program that trained it, if known.
    pub git_commit: Option<String>,
}

/// Names and shapes of the tensors, in the order of the parameters.
fn tensors() -> Vec<(String, Vec<usize>)> {
    let spec = ActorSpec::FULL;
    let mut tensors = Vec::new();
    for (i, c) in spec.convolutions().iter().enumerate() {
        let name = format!("convolution_{}", i + 1);
        tensors.push((
            format!("{name}.weight"),
            vec![c.kernel, c.kernel, c.channels, c.filters],
        ));
        tensors.push((format!("{name}.bias"), vec![c.filters]));
    }
    let [first, second] = spec.trunk();
    let [head_1, head_2] = spec.head();
    for (name, layer, has_norm) in [
        ("scan", spec.scan(), false),
        ("trunk_1", first, true),
        ("trunk_2", second, true),
        ("state", spec.state(), false),
        ("low_dim", spec.low(), false),
        ("head_1", head_1, false),
        ("head_2", head_2, false),
        ("output", spec.output(), false),
    ] {
        tensors.push((format!("{name}.weight"), vec![layer.inputs, layer.outputs]));
        tensors.push((format!("{name}.bias"), vec![layer.outputs]));
        if has_norm {
            tensors.push((format!("{name}.norm_scale"), vec![layer.outputs]));
            tensors.push((format!("{name}.norm_shift"), vec![layer.outputs]));
        }
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
    tensors,
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

    fn contents(&self) -> Contents {
        let commit = self.git_commit.iter().map(|commit| ("git_commit", commit.clone()));
        let entries = [
            ("training_config", self.training_config.clone()),
            ("seed", self.seed.to_string()),
            ("updates", self.updates.to_string()),
        ];
        // Actors of before have no such entry, and keep their digest.
        let is_other = self.cruise_m_s.to_bits() != ACTOR_LIMIT.to_bits();
        let cruise = is_other.then(|| ("cruise_m_s", self.cruise_m_s.to_string()));
        let mut contents = Contents::new(&KIND, entries.into_iter().chain(commit).chain(cruise));
        contents.push_all(&tensors(), &self.params);
        contents
    }

    /// Names and shapes of its tensors, in the order of its parameters.
    pub fn tensor_shapes(&self) -> Vec<(String, Vec<usize>)> {
        tensors()
    }

    /// The actor itself, ready to fly.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn actor(&self, isa: Isa) -> Result<Actor, FileError> {
        let actor = Actor::new(ActorSpec::FULL, isa, &self.params);
        let actor = actor.map_err(|e| KIND.content_error("in memory", e.to_string()))?;
        Ok(actor.cruising_at(self.cruise_m_s))
    }

    /// What decides behind its split point.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn head(&self, purpose: Purpose) -> Result<ExplainedHead, FileError> {
        ExplainedHead::of_actor(&self.params, purpose).map_err(|e| KIND.content_error("in memory", e.to_string()))
    }

    /// Reads and verifies a file's content. `file` names it in errors.
    ///
    /// # Errors
    /// [`FileError`]: anything but an unaltered actor of this architecture.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, FileError> {
        let read = Verified::from_bytes(&KIND, file, bytes).map_err(|refused| match refused {
            FileError::Other { key: "format", found, .. } if found == FORMAT_OF_0_2_0 => KIND.content_error(
                file,
                "is an actor of version 0.2.0, which decides from five frames and a planned path: fly it with that version, or train one \
                 for this by `vigil learn`",
            ),
            other => other,
        })?;
        let cruise_m_s = match read.optional("cruise_m_s") {
            None => ACTOR_LIMIT,
            Some(_) => read.number("cruise_m_s")?,
        };
        if !(SLOWEST_M_S..=FASTEST_M_S).contains(&cruise_m_s) {
            let why = format!("flies at {cruise_m_s} m/s; allowed: {SLOWEST_M_S} to {FASTEST_M_S}");
            return Err(KIND.content_error(file, why));
        }
        Ok(Self {
            cruise_m_s,
            training_config: read.text("training_config")?,
            seed: read.number("seed")?,
            updates: read.number("updates")?,
            git_commit: read.optional("git_commit"),
            params: read.into_values().flatten().collect(),
        })
    }
}

vigil_nnet::stored_network!(FrozenActor, KIND);
