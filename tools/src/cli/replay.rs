//! `vigil replay`, which asks whether the tick gives the same bytes again, and `vigil recover`, which copies a log that was not closed or
//! is damaged.

use crate::cli::output::{Interrupt, Paint, checked, say, tell};
use anyhow::{Context, Result, ensure};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_log::{Reader, RecoverError};

/// Arguments of `vigil replay`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil replay runs/fly-1760000000-7             the log in a flight's folder
  vigil replay flight.mcap                       a log file

Exit code: 0 every byte is equal, 3 something differs, 1 the log cannot be read.")]
pub struct ReplayArgs {
    /// A flight log (MCAP), or a folder that holds one.
    log: PathBuf,
}

/// Replays the log and compares.
///
/// # Errors
/// A log that is missing, unreadable, of another version, or without a step.
pub fn run(args: &ReplayArgs) -> Result<ExitCode> {
    let path = find_log(&args.log)?;
    let mut reader = Reader::open(&path)?;
    let report = vigil_firmware::replay(&mut reader).with_context(|| path.display().to_string())?;
    // Without a step, only a log that is read to its end is equal.
    let (is_empty, name) = (report.steps == 0 && report.is_equal(), path.display());
    ensure!(!is_empty, "{name} holds no step: there is nothing to compare");
    say!("{}", Paint::stdout().verdict(report.is_equal(), &report.to_string()));
    Ok(checked(report.is_equal()))
}

/// Arguments of `vigil recover`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Example:
  vigil recover runs/fly-1760000000-7/flight-0001.mcap whole.mcap

`vigil replay` reads an unclosed log as it is; some viewers do not. Of a damaged log everything is saved but the pieces that are
damaged themselves, and what is lost is given in steps, records and seconds.")]
pub struct RecoverArgs {
    /// The log that was not closed, or is damaged.
    from: PathBuf,
    /// A copy with an index; where the log was not closed, the copy goes on saying so. Must not exist yet.
    to: PathBuf,
}

/// Writes the copy.
///
/// # Errors
/// A log that is missing or unreadable, a copy that exists or cannot be written.
pub fn recover(args: &RecoverArgs) -> Result<ExitCode> {
    let interrupt = Interrupt::on_ctrl_c()?;
    match vigil_log::recover_until(&args.from, &args.to, interrupt.flag()) {
        Ok(recovery) => say!("{}: {recovery}", args.to.display()),
        Err(interrupted @ RecoverError::Interrupted) => {
            tell!("{interrupted}");
            return Ok(interrupt.exit_code());
        }
        Err(error) => return Err(error.into()),
    }
    Ok(ExitCode::SUCCESS)
}

/// The path itself, or the one MCAP file in it if it is a folder.
///
/// # Errors
/// A folder that holds no log, or several.
pub fn find_log(path: &Path) -> Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let mut logs: Vec<PathBuf> = std::fs::read_dir(path)
        .with_context(|| format!("cannot read {}", path.display()))?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "mcap"))
        .collect();
    match (logs.pop(), logs.len()) {
        (Some(log), 0) => Ok(log),
        (None, _) => anyhow::bail!("no .mcap file in {}", path.display()),
        (Some(_), more) => anyhow::bail!("{} holds {} logs: name one", path.display(), more + 1),
    }
}

/// Whether what is made of a log goes elsewhere than into the log itself.
///
/// # Errors
/// `to` is the log, by whatever name.
pub fn check_not_over(log: &Path, to: &Path) -> Result<()> {
    let is_same = match (std::fs::canonicalize(log), std::fs::canonicalize(to)) {
        (Ok(log), Ok(to)) => log == to,
        _ => false,
    };
    ensure!(!is_same, "{} is the log itself: give another name", to.display());
    Ok(())
}
