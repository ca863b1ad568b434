//! The `vigil-lab` command line: the flight tier's commands, and the laboratory's.

mod bench;
mod collect;
pub(crate) mod detector;
mod export;
mod figures;
mod film;
mod import;
mod learn;
mod merge;
mod report;
mod reproduce;
mod rollout;

pub(crate) use vigil_tools::cli::{child_process, evaluate, output};

use crate::attack_campaigns as attack;
use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;
use vigil_tools::cli::{EveryCommand, lab, with_negative_numbers};

/// Train, attack, explain, measure: Vigil's laboratory. `vigil` starts it for each of its commands.
#[derive(Parser)]
#[command(name = "vigil", bin_name = "vigil", version, mut_subcommands(with_negative_numbers))]
struct Cli {
    #[command(subcommand)]
    command: Command,

    #[command(flatten)]
    every: EveryCommand,
}

#[derive(Subcommand)]
enum Command {
    /// Train an actor by value: critics that see the true state, reward along the shortest free path.
    Learn(learn::LearnArgs),
    /// Evaluate an actor alone, the potential field off and on.
    Rollout(rollout::RolloutArgs),
    /// Table I and figures 9 and 10 from the logs of training runs of yours.
    Report(report::ReportArgs),
    /// Attack the actor: on states, on scenes, in campaigns of flights.
    Attack(attack::AttackCommands),
    /// Gather data for the detector, train it, measure how well it detects.
    Detector(detector::DetectorArgs),
    /// Every table and figure of the paper and ours, from data or flown anew, on one page.
    Reproduce(reproduce::ReproduceArgs),
    /// Make one report of flights over several machines' seeds.
    Merge(merge::MergeArgs),
    /// Import a policy of others from ONNX.
    Import(import::ImportArgs),
    /// Export an actor or an imported policy to ONNX.
    Export(export::ExportArgs),
    /// Measure what this machine makes of the loop.
    Bench(bench::BenchArgs),
    /// An animated picture (GIF) or a video (mp4) of a flight; `vigil log film` and `vigil fly --record` start it.
    #[command(hide = true)]
    Film(film::FilmArgs),
    #[command(flatten)]
    Flight(Box<vigil_tools::cli::Command>),
}

/// Reads the arguments of the process and does what they say.
pub fn main() -> ExitCode {
    if let Err(error) = lab::check_caller() {
        return output::finish(Err(error));
    }
    let mut cli: Cli = vigil_firmware::removed::parse();
    if let Command::Flight(command) = &cli.command {
        cli.every.suit(command);
    }
    cli.every.run(|| execute(cli.command))
}

/// Runs a command as it would be typed, the program's name first, within another one.
fn run_words(words: Vec<OsString>) -> Result<ExitCode> {
    execute(Cli::try_parse_from(words).context("no command")?.command)
}

fn execute(command: Command) -> Result<ExitCode> {
    match command {
        Command::Learn(args) => learn::run(&args),
        Command::Rollout(args) => rollout::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Attack(args) => attack::run(&args),
        Command::Detector(args) => detector::run(&args),
        Command::Reproduce(args) => reproduce::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Film(args) => film::run(&args),
        Command::Flight(command) => vigil_tools::cli::execute(*command),
    }
}
