//! Our side of the comparisons (docs/peers.md): writes what the other side needs, then times our programs on request.

mod cases;
mod record;
mod states;

use anyhow::{Context, Result, bail};
use clap::Parser;
use rustix::time::{ClockId, clock_gettime};
use std::io::{BufRead, Write};
use std::path::PathBuf;
use vigil_tools::threads::thread_pool;

/// Our side of the comparisons with other frameworks. tools/peers/run.sh starts it.
///
/// Writes ours.safetensors (states, weights, our results) into the folder, prints `ready`, then answers each line
/// `CASE RUNS` on standard input with the processor time of one run in nanoseconds, the mean over RUNS.
#[derive(Debug, Parser)]
#[command(after_help = "\
Example:
  echo 'actor 100' | vigil-peers target/peers

Cases: actor, shap-hidden, shap-pixels, bim, lstm-ad")]
struct Arguments {
    /// Folder for ours.safetensors.
    folder: PathBuf,
    /// The actor; default: the built-in one.
    #[arg(long, value_name = "FILE")]
    actor: Option<PathBuf>,
}

/// Processor time of this process, all threads, nanoseconds.
fn processor_ns() -> u64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.folder)
        .with_context(|| format!("cannot make {}", arguments.folder.display()))?;
    thread_pool(1)?.install(|| serve(&arguments))
}

fn serve(arguments: &Arguments) -> Result<()> {
    let mut cases = cases::prepare(arguments.actor.as_deref(), &arguments.folder.join("ours.safetensors"))?;
    let mut out = std::io::stdout();
    writeln!(out, "ready")?;
    out.flush()?;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let Some((name, runs)) = line.split_once(' ') else {
            bail!("expected `CASE RUNS`, got `{line}`");
        };
        let runs: u32 = runs
            .parse()
            .with_context(|| format!("`{runs}` is not a number of runs"))?;
        let case = cases
            .get_mut(name)
            .with_context(|| format!("there is no case `{name}`"))?;
        let before = processor_ns();
        for _ in 0..runs {
            case()?;
        }
        writeln!(out, "{}", (processor_ns() - before) as f64 / f64::from(runs.max(1)))?;
        out.flush()?;
    }
    Ok(())
}
