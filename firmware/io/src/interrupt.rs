//! The end that a person or the system asks a program for: Ctrl-C, SIGTERM, SIGHUP.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Runs `handler` on each; a SIGHUP that whoever began the process had it ignore (`nohup`) stays ignored.
///
/// # Errors
/// A handler that cannot be installed: there is one already.
pub fn on_interrupt(handler: impl FnMut() + Send + 'static) -> io::Result<()> {
    outlive_file_limits();
    let before = ignore(libc::SIGHUP);
    ctrlc::set_handler(handler).map_err(|e| io::Error::other(format!("cannot install the Ctrl-C handler: {e}")))?;
    if before == libc::SIG_IGN {
        ignore(libc::SIGHUP);
    }
    Ok(())
}

/// Has a file that may grow no further (`ulimit -f`, LimitFSIZE=) be an error of its writing, as a full disk is. To be called first of all:
/// who takes no interrupts writes files, too.
pub fn outlive_file_limits() {
    ignore(libc::SIGXFSZ);
}

fn ignore(signal: libc::c_int) -> libc::sighandler_t {
    // SAFETY: to ignore a signal runs no code of this process.
    unsafe { libc::signal(signal, libc::SIG_IGN) }
}

/// What each of them sets.
///
/// # Errors
/// Those of [`on_interrupt`].
pub fn set_by_interrupt() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    on_interrupt(move || flag.store(true, Ordering::Relaxed))?;
    Ok(stop)
}
