//! The 20 Hz rate loop, its wiring, and the firmware program.
//!
//! [`stack::FlightStack::tick`] is the whole of a step, pure and without allocation. [`step::Firmware`] runs it over
//! [`ports`]: [`live_loop`] at a fixed rate, [`lockstep`] driven by a simulator, [`mod@replay`] driven by a log.
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)
)]

mod alarms;
pub mod arguments;
pub mod config;
mod console;
pub mod crew;
mod frame_keeper;
mod guarding;
mod leg;
pub mod live_loop;
pub mod lockstep;
pub mod ports;
pub mod program;
pub mod rate;
pub mod realtime;
pub mod reference;
pub mod replay;
pub mod saved;
pub mod stack;
pub mod step;
pub mod timing;
mod tunables;

pub use alarms::AlarmTally;
pub use config::FirmwareConfig;
pub use frame_keeper::{FrameRefusals, Refusal};
pub use lockstep::LockstepFirmware;
pub use replay::{ReplayReport, replay};
pub use vigil_io::{link_spec, link_url};
