//! Sans-IO MAVLink: framing and the guidance computer's side of the protocol.
//!
//! Bytes in, bytes out; time is an argument. Both ends of Vigil's link use [`framing`].
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing))]

pub mod framing;

pub use mavlink;
pub use mavlink::MavHeader;
pub use mavlink::dialects::common::{self, MavMessage};
