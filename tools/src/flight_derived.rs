//! What a flight log does not hold and a replay of it gives: the pilot's map and planned path, and the pixels' SHAP values.

use crate::explained::{PixelExplainer, YAW};
use crate::flight_report::LogSeen;
use anyhow::{Context, Result, ensure};
use std::path::Path;
use vigil_firmware::FirmwareConfig;
use vigil_firmware::replay::{firmware_of, step_again};
use vigil_firmware::step::Firmware;
use vigil_log::{DerivedLog, MapSeen, Reader, SHAP_COLS, SHAP_ROWS, TickRecord, merge_derived};
use vigil_nnet::Isa;
use vigil_policy::geometric::{CELL_M, SCORE_LIMIT, SIDE};
use vigil_types::{DEPTH_COLS, Datagrams, Nanos};

/// Map and way are kept this often.
const MAP_NS: Nanos = 500_000_000;
/// Frames are explained this often.
const SHAP_NS: Nanos = 1_000_000_000;
/// And never more than so many of a flight, besides those around alarms.
const SHAP_LIMIT: usize = 120;
/// Each frame is explained that is no further from an alarm, of the first ones of a flight.
const AROUND_ALARM_NS: Nanos = 1_000_000_000;
const ALARMS: usize = 3;

/// What can be derived.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Derivable {
    /// The map and the planned path.
    Map,
    /// SHAP of the pixels.
    Shap,
}

/// What became of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Derived {
    /// Maps.
    pub maps: usize,
    /// Explained frames.
    pub explained: usize,
    /// The step before which records are missing: what follows it cannot be replayed.
    pub gap_before_step: Option<u64>,
}

/// Replays `log` and puts what follows from it, or `only` that, into it, in the place of what was derived of it earlier. What a replay
/// reads stays as it is.
///
/// # Errors
/// A log that cannot be read or replayed, a file that cannot be written; the log is then as it was.
pub fn derive(log: &Path, only: Option<Derivable>) -> Result<Derived> {
    let [map, shap] = [Derivable::Shap, Derivable::Map].map(|other| only != Some(other));
    let mut reader = Reader::open(log)?;
    let mut replay = ExplainedReplay::with(&reader, shap)?;
    let seen = replay.explainer.is_some().then(|| LogSeen::read(log)).transpose()?;
    let alarms = seen
        .iter()
        .flat_map(|seen| seen.alarms().into_iter().map(|i| seen.steps[i].now_ns));
    let alarms_ns: Vec<Nanos> = alarms.take(ALARMS).collect();
    let mut sparse = 0;
    let mut to = DerivedLog::create(log)?;
    let mut derived = Derived::default();
    let mut record = Box::<TickRecord>::default();
    let (mut next_map_ns, mut next_shap_ns) = (0, 0);
    while reader.read_next(&mut record)? {
        let (now_ns, step) = (record.now_ns, record.timing.step as u32);
        replay.step(&record);
        let Some(firmware) = &replay.firmware else {
            derived.gap_before_step = Some(record.timing.step);
            break;
        };
        if map
            && now_ns >= next_map_ns
            && let Some(pilot) = firmware.mapping()
            && let Some(corner_ned_m) = pilot.grid().corner_ned_m()
        {
            next_map_ns = now_ns + MAP_NS;
            derived.maps += 1;
            let seen = MapSeen {
                corner_ned_m,
                cell_m: CELL_M,
                cols: SIDE,
                scores: pilot.grid().scores(),
                score_limit: SCORE_LIMIT,
            };
            to.map(now_ns, step, &seen)?;
            let kinematics = record.report.telemetry.kinematics;
            let down_m = kinematics.map_or(0.0, |kinematics| kinematics.position_ned_m.z);
            to.way(now_ns, step, pilot.path_ned_m(), down_m)?;
        }
        let near = alarms_ns.iter().any(|at_ns| at_ns.abs_diff(now_ns) <= AROUND_ALARM_NS);
        let due = now_ns >= next_shap_ns && sparse < SHAP_LIMIT;
        if record.frame().is_some()
            && (near || due)
            && let Some(squares) = replay.squares()?
        {
            if due {
                next_shap_ns = now_ns + SHAP_NS;
                sparse += 1;
            }
            derived.explained += 1;
            to.shap(now_ns, step, &squares)?;
        }
    }
    merge_derived(log, to, map, shap)?;
    Ok(derived)
}

/// Replays a log beside whoever reads it and explains its frames: what the actor remembered is not in the log.
pub struct ExplainedReplay {
    /// `None` behind a gap in the log.
    firmware: Option<Firmware>,
    /// Of the actor that flew.
    explainer: Option<PixelExplainer>,
    sent: Box<Datagrams>,
}

impl ExplainedReplay {
    /// From the log's first step on, with the actor that flew.
    ///
    /// # Errors
    /// Why it cannot be replayed, or that no actor flew.
    pub fn of(reader: &Reader) -> Result<Self> {
        let replay = Self::with(reader, true)?;
        ensure!(replay.explainer.is_some(), "no actor flew");
        Ok(replay)
    }

    /// With explanations where they are wanted and an actor flew.
    fn with(reader: &Reader, explains: bool) -> Result<Self> {
        let firmware = Some(firmware_of(reader)?);
        // Understood before: the stack was made of it.
        let config = || FirmwareConfig::from_toml(&reader.info().config_toml).map_err(anyhow::Error::msg);
        let actor = if explains { config()?.frozen_actor()? } else { None };
        let explainer = actor.map(|actor| PixelExplainer::new(Isa::detect(), &actor));
        Ok(Self {
            firmware,
            explainer: explainer.transpose().context("the pixels cannot be explained")?,
            sent: Box::default(),
        })
    }

    /// Takes the next step, which has to be every one.
    pub fn step(&mut self, record: &TickRecord) {
        if record.dropped_before > 0 {
            self.firmware = None;
        }
        if let Some(firmware) = &mut self.firmware {
            step_again(firmware, record, &mut self.sent);
        }
    }

    /// The yaw output's SHAP values of the frame that the actor decided on in the last step, summed over squares; `None` where it did not
    /// decide.
    ///
    /// # Errors
    /// An explanation that is not finite.
    pub fn squares(&mut self) -> Result<Option<Vec<f32>>> {
        let decided = self.firmware.as_ref().and_then(Firmware::actor);
        let (Some(explainer), Some((actor, frame))) = (&mut self.explainer, decided) else {
            return Ok(None);
        };
        Ok(Some(squares(explainer.newest_frame(actor, frame, YAW)?)))
    }
}

/// Sums over 4 × 4 pixels, which keep the sum of all: single pixels are too small to see.
fn squares(phi: &[f32]) -> Vec<f32> {
    let mut sums = vec![0.0; SHAP_ROWS * SHAP_COLS];
    for (i, value) in phi.iter().enumerate() {
        let (row, col) = (i / DEPTH_COLS / 4, i % DEPTH_COLS / 4);
        sums[row * SHAP_COLS + col] += value;
    }
    sums
}
