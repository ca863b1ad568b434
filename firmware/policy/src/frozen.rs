//! A learned pilot's file, of our own architecture or imported, and what detectors and adversaries need of either.

use crate::actor::{ActorSpec, Decider};
use crate::imported::Head;
#[cfg(feature = "std")]
use crate::imported::POLICY_FORMAT;
use crate::{FrozenActor, FrozenPolicy};
use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;
#[cfg(feature = "std")]
use std::path::Path;
use vigil_nnet::network_file::FileError;
use vigil_nnet::{Graph, Isa, Purpose, ShapeError};

/// A pilot that comes from a file.
#[derive(Debug, Clone, PartialEq)]
pub enum FrozenPilot {
    /// An actor of ours.
    Actor(FrozenActor),
    /// A policy of others.
    Imported(FrozenPolicy),
}

/// What decides behind a split point, with its parameters: inputs are the split point's values and the low-dimensional observation, both explained.
#[derive(Debug, Clone)]
pub struct ExplainedHead {
    /// The network, for multipliers or gradients as was asked for.
    pub graph: Graph,
    /// Its parameters.
    pub params: Vec<f32>,
}

impl ExplainedHead {
    /// Of an actor of ours.
    ///
    /// # Errors
    /// None for a valid description.
    pub fn of_actor(params: &[f32], purpose: Purpose) -> Result<Self, ShapeError> {
        Ok(Self {
            graph: ActorSpec::FULL.head_graph(purpose)?,
            params: params.to_vec(),
        })
    }
}

impl From<&FrozenActor> for FrozenPilot {
    fn from(actor: &FrozenActor) -> Self {
        Self::Actor(actor.clone())
    }
}

impl FrozenPilot {
    /// Reads and verifies a file of either kind.
    ///
    /// # Errors
    /// [`FileError`]: what is truncated, altered or of another architecture, by name.
    #[cfg(feature = "std")]
    pub fn load(path: &Path) -> Result<Self, FileError> {
        match FrozenActor::load(path) {
            Err(FileError::Other {
                key: "format", found, ..
            }) if found == POLICY_FORMAT => FrozenPolicy::load(path).map(Self::Imported),
            actor => actor.map(Self::Actor),
        }
    }

    /// The file's, or the actor that comes with this program.
    ///
    /// # Errors
    /// As [`Self::load`].
    #[cfg(feature = "std")]
    pub fn load_or_built_in(path: Option<&Path>) -> Result<Self, FileError> {
        match path {
            Some(path) => Self::load(path),
            None => FrozenActor::built_in().map(Self::Actor),
        }
    }

    /// The digest of the network and its metadata.
    pub fn sha256(&self) -> String {
        match self {
            Self::Actor(actor) => actor.sha256(),
            Self::Imported(policy) => policy.sha256(),
        }
    }

    /// What decides behind its split point; an imported policy's outputs are those before its output scale.
    ///
    /// # Errors
    /// A policy without a split point.
    pub fn head(&self, purpose: Purpose) -> Result<ExplainedHead, FileError> {
        match self {
            Self::Actor(actor) => actor.head(purpose),
            Self::Imported(policy) => {
                let Head { network, params, .. } = policy.head()?;
                let graph = network.graph(purpose).map_err(|e| policy.refused(&e))?;
                Ok(ExplainedHead { graph, params })
            }
        }
    }

    /// The pilot without the vehicle around it: frames and positions in, decisions out.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn decider(&self, isa: Isa) -> Result<Decider, FileError> {
        Ok(match self {
            Self::Actor(actor) => Decider::Actor(actor.actor(isa)?),
            Self::Imported(policy) => Decider::Imported(Box::new(policy.pilot(isa)?)),
        })
    }
}
