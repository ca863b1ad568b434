//! `vigil recover`: a copy with an index of a log whose process was killed, or that is damaged.

use crate::cli::output::say;
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;

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
pub fn run(args: &RecoverArgs) -> Result<ExitCode> {
    let recovery = vigil_log::recover(&args.from, &args.to)?;
    say!("{}: {recovery}", args.to.display());
    Ok(ExitCode::SUCCESS)
}
