//! The flight log: one MCAP file and a tlog, written off the loop's path.
//!
//! The loop fills a [`TickRecord`] each step through its [`Recorder`]; a thread writes it with the standard Foxglove
//! schemas, so that viewers open the file as it is, and with everything a replay needs. [`Reader`] gives the records
//! back bit for bit. `docs/log.md` describes the channels and the format.
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)
)]

mod container;
mod convert;
mod display;
mod file;
mod info;
mod reader;
mod record;
mod recorder;
mod recover;
mod salvage;
mod scene;
mod tlog;
mod wire;

pub use convert::RecordDefect;
pub use file::LOG_FORMAT;
pub use info::FlightInfo;
pub use reader::{Damage, LogEnd, ReadError, Reader};
pub use record::TickRecord;
pub use recorder::{
    LogPlace, Recorder, RecorderConfig, RecorderStatus, StartError, Summary, WhenFull, epoch_offset_ns,
};
pub use recover::{Gap, RecoverError, Recovery, recover};
pub use scene::{Scene, SceneError, SceneSolid};
