//! Requests on standard input for the processor time of what was prepared (shared with `tract/`).

use anyhow::{Context, Result};
use rustix::time::{ClockId, clock_gettime};
use std::io::{BufRead, Write};

/// Says what is ready, then answers each line of standard input.
pub fn answer(ready: &str, mut ask: impl FnMut(&str) -> Result<f64>) -> Result<()> {
    // Flushed at each line's end.
    let mut out = std::io::stdout();
    writeln!(out, "{ready}")?;
    for line in std::io::stdin().lock().lines() {
        writeln!(out, "{}", ask(&line?)?)?;
    }
    Ok(())
}

/// Processor time of one run in nanoseconds, all threads, the mean over so many.
pub fn mean_ns(runs: &str, mut run: impl FnMut() -> Result<()>) -> Result<f64> {
    let now_ns = || {
        let now = clock_gettime(ClockId::ProcessCPUTime);
        now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
    };
    let count = runs.trim().parse::<u32>();
    let count = count.with_context(|| format!("`{runs}` is not a number of runs"))?;
    let before_ns = now_ns();
    for _ in 0..count {
        run()?;
    }
    Ok((now_ns() - before_ns) as f64 / f64::from(count.max(1)))
}
