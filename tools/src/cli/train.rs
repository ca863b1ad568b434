//! `vigil train`: the actor from nothing, and how it flies.

use crate::actor_training::{Progress, RunEnd, RunOptions, TrainConfig};
use crate::cli::output::{self, EXIT_INTERRUPTED, Interrupt, Paint, git_commit, put, say};
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vigil train`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil train                                   the shipped actor's run, into runs/train
  vigil train --config my.toml -o runs/mine     another configuration
  vigil train -o runs/mine --resume             go on after an interruption
  vigil train --print-config                    every key with its default

The run leaves actor.safetensors, result.json, curves.csv, curves.png, flights.csv, config.toml and checkpoint.safetensors in
its folder. Ctrl-C stops it after the
update being made; --resume goes on as if it had never stopped. docs/learning.md explains the method.
Exit code: 0 the actor is trained, 1 error, 130 interrupted, with a checkpoint to go on from.")]
pub struct TrainArgs {
    /// Training file (TOML); what it does not name keeps its default.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Seed, instead of the configuration's.
    #[arg(long)]
    seed: Option<u64>,

    /// Threads, instead of the configuration's; any number trains the same actor.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,

    /// Folder of the run.
    #[arg(short, long, value_name = "DIR", default_value = "runs/train")]
    output: PathBuf,

    /// Go on from the folder's checkpoint.
    #[arg(long)]
    resume: bool,

    /// Flights over unseen validation courses that test the frozen actor at the end.
    #[arg(long, value_name = "FLIGHTS", default_value_t = 400)]
    test_flights: u64,

    /// Print the configuration and end.
    #[arg(long)]
    print_config: bool,
}

/// Trains.
///
/// # Errors
/// A bad configuration, a folder that cannot be written or holds another run, a loss that is not finite.
pub fn run(args: &TrainArgs) -> Result<ExitCode> {
    let mut config = args
        .config
        .as_deref()
        .map(TrainConfig::load)
        .transpose()?
        .unwrap_or_default();
    config.seed = args.seed.unwrap_or(config.seed);
    config.threads = args.threads.map_or(config.threads, usize::from);
    config.check()?;
    if args.print_config {
        put!("{}", config.to_toml());
        return Ok(ExitCode::SUCCESS);
    }
    let interrupt = Interrupt::on_ctrl_c()?;
    let options = RunOptions {
        folder: args.output.clone(),
        resume: args.resume,
        git_commit: git_commit(),
        test_flights: args.test_flights,
    };
    let bar = output::Progress::new(0, "updates")?;
    let end = crate::actor_training::run(&config, &options, interrupt.flag(), &mut |progress| {
        show(&bar, progress)
    });
    bar.finish();
    match end? {
        RunEnd::Interrupted(checkpoint) => {
            say!("stopped; go on with: vigil train --resume -o {}", args.output.display());
            say!("checkpoint       {}", checkpoint.display());
            Ok(ExitCode::from(EXIT_INTERRUPTED))
        }
        RunEnd::Complete { actor, result } => {
            for count in [&result.chosen_by, &result.test] {
                let (low, high) = count.wilson_95;
                say!(
                    "completion       {:.1} % of {} {} courses without the field (95 %: {:.1} to {:.1} %)",
                    100.0 * count.completion,
                    count.flights,
                    count.family,
                    100.0 * low,
                    100.0 * high,
                );
            }
            say!(
                "{}",
                Paint::stdout().verdict(
                    true,
                    &format!(
                        "actor            {} after {} updates",
                        actor.display(),
                        result.frozen_after
                    )
                )
            );
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn show(bar: &output::Progress, progress: &Progress<'_>) {
    bar.set_length(progress.all_updates);
    let left = progress
        .left_s
        .map_or("gathering".to_owned(), |s| format!("{:.0} min left", (s / 60.0).ceil()));
    bar.set_message(format!(
        "{left}, decision {}/{}",
        progress.decisions, progress.all_decisions
    ));
    bar.set_position(progress.updates);
    if let Some(row) = progress.row {
        let u = &row.update;
        let judged = row.completion.map_or(String::new(), |c| {
            format!(", completes {:.1} % without the field", 100.0 * c)
        });
        let line = format!(
            "{:>6} updates: {} of {} training flights at the goal, reward {:.1}, critic {:.3}, imitation {:.3}, value {:.2}{judged}",
            row.updates, row.successes, row.flights, row.reward, u.critic_loss, u.imitation_loss, u.value
        );
        bar.suspend(|| say!("{line}"));
    }
}
