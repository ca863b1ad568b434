//! The threads of a training or a campaign.

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// Threads could not be started.
#[derive(Debug, thiserror::Error)]
#[error("cannot start {}: {source}", in_words(*threads))]
pub struct ThreadsError {
    threads: usize,
    source: ThreadPoolBuildError,
}

fn in_words(threads: usize) -> String {
    match threads {
        0 => "a thread on each core".to_owned(),
        1 => "a thread".to_owned(),
        _ => format!("{threads} threads"),
    }
}

/// Stack of a thread, bytes: a step of the firmware beside the simulator takes more than half of the 2 MB that threads have otherwise.
const STACK_BYTES: usize = 8 << 20;

/// Starts `threads` threads, or one on each core where that is 0. What runs inside the pool's `install` is spread over them,
/// and no other.
///
/// # Errors
/// [`ThreadsError`]: the system has no more.
pub fn thread_pool(threads: usize) -> Result<ThreadPool, ThreadsError> {
    let built = ThreadPoolBuilder::new()
        .num_threads(threads)
        .stack_size(STACK_BYTES)
        .build();
    built.map_err(|source| ThreadsError { threads, source })
}

/// The same for an option `--threads` that may be absent: then one on each core.
///
/// # Errors
/// [`ThreadsError`].
pub fn thread_pool_of(option: Option<u16>) -> Result<ThreadPool, ThreadsError> {
    thread_pool(option.map_or(0, usize::from))
}
