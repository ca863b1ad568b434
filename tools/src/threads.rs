//! The threads of a training or a campaign.

use anyhow::{Context, Result};
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Stack of a thread that flies, bytes: making a firmware, or a step of it beside the simulator, takes most of the 2 MB that threads have
/// otherwise.
pub const STACK_BYTES: usize = 8 << 20;

/// Starts `threads` threads, or one on each core where that is 0. What runs inside the pool's `install` is spread over them,
/// and no other.
pub fn thread_pool(threads: usize) -> Result<ThreadPool> {
    let built = ThreadPoolBuilder::new()
        .num_threads(threads)
        .stack_size(STACK_BYTES)
        .build();
    built.with_context(|| match threads {
        0 => "cannot start a thread on each core".to_owned(),
        1 => "cannot start a thread".to_owned(),
        _ => format!("cannot start {threads} threads"),
    })
}

/// The same for an option `--threads` that may be absent: then one on each core.
pub fn thread_pool_of(option: Option<u16>) -> Result<ThreadPool> {
    thread_pool(option.map_or(0, usize::from))
}
