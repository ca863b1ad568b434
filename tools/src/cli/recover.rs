//! `vigil recover`: close a log whose process was killed.

use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vigil recover`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Example:
  vigil recover runs/fly-1760000000-7/flight-0001.mcap whole.mcap

`vigil replay` reads an unclosed log as it is; some viewers do not.")]
pub struct RecoverArgs {
    /// The log that was not closed.
    from: PathBuf,
    /// The closed copy; must not exist yet.
    to: PathBuf,
}

/// Writes the closed copy.
///
/// # Errors
/// A log that is missing or unreadable, a copy that exists or cannot be written.
pub fn run(args: &RecoverArgs) -> Result<ExitCode> {
    let end = vigil_log::recover(&args.from, &args.to)?;
    println!("{}: {end}", args.to.display());
    Ok(ExitCode::SUCCESS)
}
