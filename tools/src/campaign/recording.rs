//! The log of a flight in lockstep, with what only the simulation knows, and the report beside it.

use crate::flight_report;
use anyhow::{Context, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use vigil_adversary::AttackOutcome;
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_log::{Recorder, RecorderConfig, SideError, SideLog, merge_into};
use vigil_sim::SimConfig;
use vigil_sim::lockstep_flight::{FlightRecord, PATH_STRIDE};
use vigil_types::{DepthFrame, LogContent, STEP_NS};

/// What to keep of a flight.
pub struct Recording {
    /// The log; it must not exist yet.
    pub log: PathBuf,
    /// What is known of the flight, for its metadata: `command` and others.
    pub about: BTreeMap<String, String>,
}

/// What a flight leaves: log, packets, report.
const LEFT: [&str; 3] = ["mcap", "tlog", "html"];

impl Recording {
    /// Renames a log that a killed process left, whole or not, and what lies beside it, to the first name that is free.
    ///
    /// # Errors
    /// A file that cannot be renamed.
    pub fn set_aside(folder: &Path, name: &str) -> Result<()> {
        let file = |name: &str, ending: &str| folder.join(format!("{name}.{ending}"));
        let (mut free, mut number) = (format!("{name}-cut-short"), 2);
        while LEFT.iter().any(|ending| file(&free, ending).exists()) {
            free = format!("{name}-cut-short-{number}");
            number += 1;
        }
        for ending in LEFT {
            let from = file(name, ending);
            if from.exists() {
                let renamed = std::fs::rename(&from, file(&free, ending));
                renamed.with_context(|| format!("cannot rename {}", from.display()))?;
            }
        }
        Ok(())
    }

    /// Has `flying`, which is of the configuration `firmware`, recorded.
    pub(super) fn begin(
        self,
        config: &SimConfig,
        firmware: &FirmwareConfig,
        flying: &mut LockstepFirmware,
    ) -> Result<Begun> {
        let mut info = firmware.flight_info();
        info.seed = Some(config.seed);
        let recorder = Recorder::start(RecorderConfig {
            scene: Some(crate::cli::scene::of(&config.course)),
            ..RecorderConfig::lossless(&self.log, info)
        })?;
        flying.record(recorder);
        Ok(Begun {
            notes: SideLog::create(&self.log.with_extension("part"))?,
            failure: None,
            recording: self,
        })
    }
}

/// A recording that runs.
pub(super) struct Begun {
    notes: SideLog,
    failure: Option<SideError>,
    recording: Recording,
}

impl Begun {
    /// Notes what became of a frame; a failure is reported at the end.
    pub fn note(&mut self, attacked: Option<&AttackOutcome>, clean: &DepthFrame) {
        let altered = attacked.map(|outcome| (outcome.yaw_change(), clean));
        let header = &clean.header;
        if let Err(error) = self.notes.frame(header.stamp_ns, header.sequence, altered) {
            self.failure.get_or_insert(error);
        }
    }

    /// Puts the notes into the log and makes the report, without an explanation of pixels, which takes long.
    pub fn end(self, config: &SimConfig, record: &FlightRecord) -> Result<()> {
        let Recording { log, mut about } = self.recording;
        if let Some(failure) = self.failure {
            return Err(failure.into());
        }
        let [notes_file, truth_file] = ["part", "truth.part"].map(|ending| log.with_extension(ending));
        let mut truth = SideLog::create(&truth_file)?;
        // A point is where a step ended; the path's last one is that of the ending.
        for (point, step) in record.path_ned_m.iter().zip((0..).step_by(PATH_STRIDE as usize)) {
            truth.truth((step + 1).min(record.steps) * STEP_NS, *point, None)?;
        }
        truth.finish()?;
        self.notes.finish()?;
        about.insert("course".to_owned(), config.course.name.clone());
        about.insert("seed".to_owned(), config.seed.to_string());
        let (how, seconds, metres) = (record.outcome, record.flight_time_s, record.path_length_m);
        let text = format!("{} after {seconds:.1} s and {metres:.1} m", super::outcome_name(how));
        about.insert("outcome".to_owned(), text);
        let sides: [&Path; 2] = [&truth_file, &notes_file];
        let merged = merge_into(&log, &sides, &about, LogContent::Everything);
        for side in sides {
            // What they hold is in the log.
            let _ = std::fs::remove_file(side);
        }
        merged.with_context(|| format!("cannot complete {}", log.display()))?;
        crate::cli::log::write_report(&log, &flight_report::beside(&log), 0)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_half_of_a_log_takes_the_place_of_another_and_one_without_a_tlog_is_set_aside_too() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = |name: &str| folder.path().join(name);
        for half in ["one", "two"] {
            std::fs::write(file("7.mcap"), half).expect("written");
            Recording::set_aside(folder.path(), "7").expect("renamed");
        }
        let text = |name| std::fs::read_to_string(file(name)).expect("kept");
        assert_eq!([text("7-cut-short.mcap"), text("7-cut-short-2.mcap")], ["one", "two"]);
    }
}
