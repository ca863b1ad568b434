//! Policies of others: any network of this project's layers, its file, and the pilot that flies it (docs/import.md).

#[cfg(feature = "actor-file")]
mod file;
mod network;
mod network_text;
mod pilot;
mod split;

#[cfg(feature = "actor-file")]
pub use file::{FORMAT as POLICY_FORMAT, FrozenPolicy};
pub use network::{Layer, MOST_MULTIPLY_ADDS, MOST_VALUES, Network, NetworkError, SPLIT_VALUES, refuse_more};
pub use pilot::{Channels, Depth, ImportedPilot, PolicyInputs};
pub use split::Head;
