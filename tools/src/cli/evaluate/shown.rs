//! The first flights of a campaign in the viewer while they fly.

use super::{EvaluateArgs, log_name};
use crate::cli::child_process::wait_for;
use crate::cli::output::{self, Interrupt, say, tell};
use crate::cli::view::tell_ended_early;
use anyhow::Result;
use rustix::process::{Pid, Signal, kill_process};
use std::path::{Path, PathBuf};
use std::process::Child;
use vigil_sim::SensorFault;

/// Flights in the viewer while they fly.
pub(super) struct Shown {
    pub count: u64,
    pub folder: PathBuf,
    script: Child,
}

impl Shown {
    /// Opens the viewer for the first `count` flights.
    pub fn begin(args: &EvaluateArgs, count: u64, faults: &[Option<SensorFault>]) -> Result<Self> {
        let count = count.min(args.flights * faults.len() as u64);
        let folder = match &args.logs {
            Some(folder) => folder.clone(),
            None => {
                let parent = args.json.parent();
                let parent = parent.filter(|p| !p.as_os_str().is_empty() && !output::is_stdout(&args.json));
                output::make_folder(parent.unwrap_or(Path::new("runs")), "evaluate", args.seed)?
            }
        };
        let names: Vec<String> = (0..count)
            .map(|number| {
                let (seed, arm) = (number / faults.len() as u64, number % faults.len() as u64);
                log_name(args, faults[arm as usize], args.seed.wrapping_add(seed))
            })
            .collect();
        let script = args.viewer.follow(&folder, &["--flights", &names.join(",")])?;
        Ok(Self { count, folder, script })
    }

    /// All flights are over: the script shows what it has not yet, and ends; the viewer stays open.
    pub fn end(&mut self, interrupt: &Interrupt) -> Result<()> {
        if self.script.try_wait()?.is_none() {
            // A log that is not there by now does not come any more.
            kill_process(Pid::from_child(&self.script), Signal::TERM)?;
        }
        let mut said = false;
        let status = wait_for(&mut self.script, || {
            if !said && !interrupt.came() {
                tell!("vigil: the viewer reads the rest of the logs; Ctrl-C leaves it there");
                said = true;
            }
            interrupt.came()
        })?;
        say!("logs             {}", self.folder.display());
        if status.is_some_and(|status| !status.success()) && !interrupt.came() {
            tell_ended_early(&self.folder);
        }
        Ok(())
    }
}
