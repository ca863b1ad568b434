//! The 20 Hz rate loop, its wiring, and the firmware program.
//!
//! [`stack::FlightStack::tick`] is the whole of a step, pure and without allocation. [`step::Firmware`] sends and
//! records what comes of it: [`live_loop`] at a fixed rate, [`lockstep`] driven by a simulator, [`mod@replay`] driven by a log.
#![cfg_attr(not(any(feature = "std", test)), no_std)]
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)
)]

extern crate alloc;

#[cfg(feature = "std")]
mod alarms;
#[cfg(feature = "std")]
pub mod arguments;
#[cfg(feature = "std")]
pub mod config;
#[cfg(feature = "std")]
mod console;
mod deciding;
mod frame_keeper;
mod guarding;
#[cfg(feature = "std")]
pub mod live_loop;
#[cfg(feature = "std")]
pub mod lockstep;
mod motion;
pub mod pilots;
#[cfg(feature = "std")]
pub mod program;
#[cfg(feature = "std")]
pub mod rate;
#[cfg(feature = "std")]
pub mod realtime;
#[cfg(feature = "std")]
pub mod reference;
#[cfg(feature = "std")]
pub mod removed;
#[cfg(feature = "std")]
pub mod replay;
#[cfg(feature = "std")]
pub mod saved;
mod segment;
#[cfg(feature = "std")]
mod service;
pub mod stack;
#[cfg(feature = "std")]
pub mod step;
#[cfg(feature = "std")]
pub mod timing;
mod tunables;

#[cfg(feature = "std")]
pub use alarms::AlarmTally;
#[cfg(feature = "std")]
pub use config::FirmwareConfig;
pub use frame_keeper::{FrameRefusals, Refusal};
#[cfg(feature = "std")]
pub use lockstep::LockstepFirmware;
#[cfg(feature = "std")]
pub use replay::{ReplayReport, replay};
#[cfg(feature = "std")]
pub use vigil_io::{link_spec, link_url};
