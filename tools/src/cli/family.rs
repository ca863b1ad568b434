//! Processes that end with the one that started them, however that ends.

use anyhow::{Context, Result, ensure};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};

/// Has the system send SIGTERM to this process when its parent is gone, `kill -9` included. Called first of all.
///
/// # Errors
/// The parent is gone already, or the system knows no such signal.
pub fn end_with(parent: u32) -> Result<()> {
    set_parent_process_death_signal(Some(Signal::TERM)).context("cannot ask to be told when the parent ends")?;
    // A parent that went before the line above is told of by nobody: the process then has another one.
    let now = getppid().map_or(0, |pid| pid.as_raw_nonzero().get());
    ensure!(
        u32::try_from(now) == Ok(parent),
        "the process {parent} that started this one has ended"
    );
    Ok(())
}

/// The arguments that have a child of this process end with it.
pub fn arguments() -> [String; 2] {
    ["--ends-with".to_owned(), std::process::id().to_string()]
}
