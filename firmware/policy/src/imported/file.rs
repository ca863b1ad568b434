//! Files of imported policies: the network's layers, how it is given what we have, and its parameters, sealed as an actor's.

use super::network::{Network, NetworkError};
use super::pilot::{Channels, Depth, ImportedPilot, PolicyInputs};
use super::split::Head;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;
use vigil_nnet::Isa;
use vigil_nnet::network_file::{Contents, FileError, Kind, Verified};

/// An imported policy as it lies in its file.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenPolicy {
    /// Its layers.
    pub network: Network,
    /// Their parameters, one after the other.
    pub params: Vec<f32>,
    /// How it is given what we have.
    pub inputs: PolicyInputs,
    /// The layer whose values are explained ([`Network::head`]); a detector can watch a policy that has one.
    pub split: Option<usize>,
    /// What it was made of, for people.
    pub source: String,
}

const KIND: Kind = Kind {
    noun: "policy",
    identity: [
        ("format", FORMAT),
        ("architecture", "layers"),
        ("normalisation", "depth 0..1 of 100 m; distance / 20 m; bearing / 1 rad"),
    ],
    tensors: || vec![("parameters".to_string(), vec![0])],
};

/// Value of the entry `format`.
pub const FORMAT: &str = "vigil policy 1";

impl FrozenPolicy {
    fn contents(&self) -> Contents {
        let inputs = &self.inputs;
        let entries = [
            ("layers", self.network.to_string()),
            ("frame", format!("{} {} {}", inputs.rows, inputs.cols, inputs.channels)),
            ("channels", inputs.order.name().to_string()),
            ("depth", inputs.depth.name().to_string()),
            ("scale", inputs.scale.to_string()),
            ("frame_input", inputs.frame_input.to_string()),
            ("has_position", inputs.has_position.to_string()),
            ("output_scale", inputs.output_scale.to_string()),
            ("source", self.source.clone()),
        ];
        let split = self.split.map(|layer| ("split", layer.to_string()));
        let mut contents = Contents::new(&KIND, entries.into_iter().chain(split));
        contents.push("parameters", &[self.params.len()], self.params.clone());
        contents
    }

    /// Reads and verifies a file's content. `file` names it in errors.
    ///
    /// # Errors
    /// [`FileError`]: anything but an unaltered policy that fits the step.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, FileError> {
        let read = Verified::from_bytes(&KIND, file, bytes)?;
        let wrong = |key: &str, value: &str| KIND.content_error(file, format!("has the {key} \"{value}\""));
        let frame = read.text("frame")?;
        let sizes: Option<Vec<usize>> = frame.split(' ').map(|size| size.parse().ok()).collect();
        let Some([rows, cols, channels]) = sizes.as_deref().and_then(|sizes| <[usize; 3]>::try_from(sizes).ok()) else {
            return Err(wrong("frame", &frame));
        };
        let order = read.text("channels")?;
        let order = Channels::from_name(&order).ok_or_else(|| wrong("channels", &order))?;
        let depth = read.text("depth")?;
        let depth = Depth::from_name(&depth).ok_or_else(|| wrong("depth", &depth))?;
        let layers = read.text("layers")?.parse::<Network>();
        let policy = Self {
            network: layers.map_err(|e| not_flown(file, &e))?,
            inputs: PolicyInputs {
                rows,
                cols,
                channels,
                order,
                depth,
                scale: read.number("scale")?,
                frame_input: read.number("frame_input")?,
                has_position: read.number("has_position")?,
                output_scale: read.number("output_scale")?,
            },
            split: match read.optional("split") {
                None => None,
                Some(text) => Some(text.parse().map_err(|_| wrong("split", &text))?),
            },
            source: read.text("source")?,
            params: read.into_values().flatten().collect(),
        };
        // Whatever does not fit each other is found here, not in flight.
        policy.build(file, Isa::PORTABLE)?;
        Ok(policy)
    }

    fn build(&self, file: &str, isa: Isa) -> Result<ImportedPilot, FileError> {
        let pilot = ImportedPilot::new(&self.network, &self.params, self.inputs, self.split, isa);
        pilot.map_err(|e| not_flown(file, &e))
    }

    /// The policy itself, ready to fly.
    ///
    /// # Errors
    /// A network that does not fit the step or its own inputs.
    pub fn pilot(&self, isa: Isa) -> Result<ImportedPilot, FileError> {
        self.build("in memory", isa)
    }

    /// The layers behind its split point.
    ///
    /// # Errors
    /// A policy without one.
    pub fn head(&self) -> Result<Head, FileError> {
        let head = match self.split {
            Some(split) => self.network.head(&self.params, split, self.inputs.frame_input),
            None => Err(NetworkError(
                "it has no split point: no layer of a size that can be explained stands between all of the frame and the action".to_string(),
            )),
        };
        head.map_err(|e| self.refused(&e))
    }

    pub(crate) fn refused(&self, error: &NetworkError) -> FileError {
        KIND.content_error(&self.source, format!("cannot be explained: {error}"))
    }
}

fn not_flown(file: &str, error: &NetworkError) -> FileError {
    KIND.content_error(file, format!("cannot be flown: {error}"))
}

vigil_nnet::stored_network!(FrozenPolicy, KIND);
