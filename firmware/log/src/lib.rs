//! The flight log: one MCAP file and a tlog, written off the loop's path.
//!
//! The loop fills a [`TickRecord`] each step through its [`Recorder`]; a thread writes it with the standard Foxglove
//! schemas, so that viewers open the file as it is, and with everything a replay needs. [`Reader`] gives the records
//! back bit for bit. `docs/log.md` describes the channels and the format.
//!
//! ```
//! use vigil_log::{FlightInfo, LogPlace, Reader, Recorder, RecorderConfig};
//! use vigil_types::{Datagrams, StepReport, StepTiming};
//!
//! let folder = tempfile::tempdir()?;
//! let place = LogPlace::Directory(folder.path().to_owned());
//! let mut recorder = Recorder::start(RecorderConfig::new(place, FlightInfo::default()))?;
//! let nothing = Datagrams::default();
//! for step in 0..3 {
//!     let timing = StepTiming { step, ..StepTiming::default() };
//!     let report = StepReport { timing, ..StepReport::default() };
//!     recorder.record(|slot| slot.fill(50_000_000 * step, timing, None, &nothing, &nothing, &report));
//! }
//! let summary = recorder.finish();
//! assert_eq!((summary.records, summary.failure), (3, None));
//! let steps: Vec<u64> = Reader::open(&summary.path)?.map(|r| r.map(|r| r.timing.step)).collect::<Result<_, _>>()?;
//! assert_eq!(steps, [0, 1, 2]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)
)]

mod container;
mod convert;
mod derived;
mod display;
mod info;
mod log_file;
mod proto;
mod reader;
mod record;
mod recorder;
mod recover;
mod salvage;
mod scene;
mod side;
mod story;
mod tlog;
mod ulog;

pub use derived::{DerivedLog, MapSeen, SHAP_COLS, SHAP_ROWS};
pub use info::FlightInfo;
pub use log_file::LOG_FORMAT;
pub use reader::{Damage, LogEnd, ReadError, Reader};
pub use record::TickRecord;
pub use recorder::{LogPlace, Recorder, RecorderConfig, StartError, Summary, WhenFull, epoch_offset_ns};
pub use recover::{Gap, RecoverError, Recovery, recover, recover_until};
pub use scene::{Scene, SceneError, SceneSolid};
pub use side::{SideError, SideLog, merge_derived, merge_into};
pub use story::{AttackMark, CleanFrame, Line, Story};
pub use ulog::{ULog, ulog};
