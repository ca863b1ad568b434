//! Our side of the comparisons (docs/peers.md): writes what the other side needs, then times our programs on request.

mod cases;
mod record;
mod states;
mod timing;

use anyhow::{Context, Result};
use clap::Parser;
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

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.folder)
        .with_context(|| format!("cannot make {}", arguments.folder.display()))?;
    thread_pool(1)?.install(|| serve(&arguments))
}

fn serve(arguments: &Arguments) -> Result<()> {
    let mut cases = cases::prepare(arguments.actor.as_deref(), &arguments.folder.join("ours.safetensors"))?;
    timing::answer("ready", |line| {
        let parts = line.split_once(' ');
        let (name, runs) = parts.with_context(|| format!("expected `CASE RUNS`, got `{line}`"))?;
        let case = cases.get_mut(name);
        timing::mean_ns(runs, case.with_context(|| format!("there is no case `{name}`"))?)
    })
}
