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

/// Starts `threads` threads, or one on each core where that is 0. What runs inside the pool's `install` is spread over them,
/// and no other.
///
/// # Errors
/// [`ThreadsError`]: the system has no more.
pub fn thread_pool(threads: usize) -> Result<ThreadPool, ThreadsError> {
    let built = ThreadPoolBuilder::new().num_threads(threads).build();
    built.map_err(|source| ThreadsError { threads, source })
}

/// The same for an option `--threads` that may be absent: then one on each core.
///
/// # Errors
/// [`ThreadsError`].
pub(crate) fn thread_pool_of(option: Option<u16>) -> Result<ThreadPool, ThreadsError> {
    thread_pool(option.map_or(0, usize::from))
}
