//! `vigil harden`: an actor whose decisions provably hold.

use crate::actor_training::robust::{RobustConfig, RobustEnd, RobustOptions, RobustRow, run_robust};
use crate::cli::output::{EXIT_INTERRUPTED, Interrupt, Paint, git_commit, put, say};
use anyhow::{Result, bail};
use std::path::PathBuf;
use std::process::ExitCode;
use vigil_policy::FrozenPilot;

/// Arguments of `vigil harden`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil harden -o runs/robust                     harden the built-in actor against frames altered by up to 1/255
  vigil harden -o runs/robust --resume            go on after an interruption, from the last whole round
  vigil harden -o runs/mine --actor mine.safetensors --config robust.toml
  vigil harden --print-config                     every key with its default
  vigil attack certify --actor runs/robust/actor.safetensors
                                                  what is proved of it, and what an attack does

The run leaves actor.safetensors, curves.csv, config.toml, checkpoint.safetensors and result.json in its folder. What it does and what
came of it: docs/robustness.md.")]
pub struct HardenArgs {
    /// The actor to harden; it teaches [default: the actor built in].
    #[arg(long, value_name = "FILE")]
    actor: Option<PathBuf>,

    /// Training file (TOML); what it does not name keeps its default.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Seed, instead of the configuration's.
    #[arg(long)]
    seed: Option<u64>,

    /// Threads, instead of the configuration's; any number trains the same.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,

    /// Folder of the run.
    #[arg(short, long, value_name = "DIR", default_value = "runs/robust")]
    output: PathBuf,

    /// Go on from the folder's checkpoint.
    #[arg(long)]
    resume: bool,

    /// Flights of each family that test the hardened actor.
    #[arg(long, value_name = "FLIGHTS", default_value_t = 200)]
    test_flights: u64,

    /// Print the configuration and end.
    #[arg(long)]
    print_config: bool,
}

/// Trains.
///
/// # Errors
/// A bad configuration or actor, a folder that cannot be written or holds another run, a loss that is not finite.
pub fn run(args: &HardenArgs) -> Result<ExitCode> {
    let mut config = match &args.config {
        Some(path) => RobustConfig::load(path)?,
        None => RobustConfig::default(),
    };
    config.seed = args.seed.unwrap_or(config.seed);
    config.threads = args.threads.map_or(config.threads, usize::from);
    config.check()?;
    if args.print_config {
        put!("{}", config.to_toml());
        return Ok(ExitCode::SUCCESS);
    }
    let FrozenPilot::Actor(actor) = FrozenPilot::load_or_built_in(args.actor.as_deref())? else {
        bail!("--actor is an imported policy; only actors of our own architecture can be hardened");
    };
    let interrupt = Interrupt::on_ctrl_c()?;
    let options = RobustOptions {
        folder: args.output.clone(),
        resume: args.resume,
        actor,
        git_commit: git_commit(),
        test_flights: args.test_flights,
    };
    let end = run_robust(&config, &options, interrupt.flag(), &mut |row, all| {
        say!("{}", told(row, all))
    });
    match end? {
        RobustEnd::Interrupted(checkpoint) => {
            say!("stopped; go on with the same command and --resume, from the last whole round");
            say!("checkpoint       {}", checkpoint.display());
            Ok(ExitCode::from(EXIT_INTERRUPTED))
        }
        RobustEnd::Complete(path, result) => {
            for count in &result.test {
                let (low, high) = count.wilson_95;
                say!(
                    "{:<10} {:.1} % of {} (95 %: {:.1} to {:.1} %), {} collisions, {} time-outs",
                    count.family,
                    100.0 * count.completion,
                    count.flights,
                    100.0 * low,
                    100.0 * high,
                    count.collisions,
                    count.time_outs,
                );
            }
            let written = format!("written    {} after {} updates", path.display(), result.updates);
            say!("{}", Paint::stdout().verdict(true, &written));
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn told(row: &RobustRow, all: u64) -> String {
    let judged: String = [("validation", row.validation), ("hard", row.hard)]
        .into_iter()
        .filter_map(|(family, completion)| Some(format!(", {family} {:.1} %", 100.0 * completion?)))
        .collect();
    format!(
        "{:>6} of {all} updates, {:.0} s: ε {:.3}/255, decision {:.4}, bounds {:.4}, certified {:.1} %{judged}",
        row.updates,
        row.elapsed_s,
        row.epsilon_255,
        row.decision_loss,
        row.bounds_loss,
        100.0 * row.certified
    )
}
