//! `vigil learn`: an expert or an actor by value.

use crate::actor_training::value::{Recipe, ValueConfig, ValueEnd, ValueOptions, ValueProgress, ValueRow, run_value};
use crate::cli::output::{EXIT_INTERRUPTED, Interrupt, Paint, git_commit, put, say};
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vigil learn`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil learn expert -o runs/expert                  an expert that sees the true state, by DDPG from nothing
  vigil learn actor -o runs/actor --expert runs/expert/expert.safetensors
                                                     the pictures' actor, taught by the expert's critics
  vigil learn nothing -o runs/nothing                the pictures' actor from nothing, without any teacher
  vigil learn nothing -o runs/nothing --resume       go on after an interruption, bit for bit
  vigil learn actor --print-config                   every key with the recipe's value

The run leaves curves.csv, flights.csv, config.toml, checkpoint.safetensors, result.json and expert.safetensors or
actor.safetensors in its folder; `vigil report` reads it. The curve tells at each evaluation how well the critics' slope over
yaw agrees with what flights from the same state tell. `vigil rollout --actor` flies the actor. docs/learning.md explains the
method.")]
pub struct LearnArgs {
    /// What to train.
    #[arg(value_enum)]
    recipe: RecipeName,

    /// Training file (TOML) instead of the recipe's; what it does not name keeps its default.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Seed, instead of the configuration's.
    #[arg(long)]
    seed: Option<u64>,

    /// Threads, instead of the configuration's; any number trains the same.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,

    /// Folder of the run.
    #[arg(short, long, value_name = "DIR", default_value = "runs/learn")]
    output: PathBuf,

    /// The expert that teaches.
    #[arg(long, value_name = "FILE")]
    expert: Option<PathBuf>,

    /// Take the encoder of this actor instead of teaching one.
    #[arg(long, value_name = "FILE")]
    encoder_of: Option<PathBuf>,

    /// Begin with this actor, one that `vigil learn` made, instead of from nothing.
    #[arg(long, value_name = "FILE", conflicts_with = "encoder_of")]
    from: Option<PathBuf>,

    /// Go on from the folder's checkpoint.
    #[arg(long)]
    resume: bool,

    /// Flights of each family that test what was chosen at the end.
    #[arg(long, value_name = "FLIGHTS", default_value_t = 400)]
    test_flights: u64,

    /// Print the configuration and end.
    #[arg(long)]
    print_config: bool,
}

/// What `vigil learn` trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum RecipeName {
    /// An expert that sees the true state.
    Expert,
    /// The pictures' actor, taught by an expert's critics.
    Actor,
    /// The pictures' actor from nothing, without any teacher.
    Nothing,
}

/// Trains.
///
/// # Errors
/// A bad configuration, a folder that cannot be written or holds another run, a loss that is not finite.
pub fn run(args: &LearnArgs) -> Result<ExitCode> {
    let mut config = match &args.config {
        Some(path) => ValueConfig::load(path)?,
        None => ValueConfig::recipe(match args.recipe {
            RecipeName::Expert => Recipe::Expert,
            RecipeName::Actor => Recipe::Actor,
            RecipeName::Nothing => Recipe::Nothing,
        }),
    };
    config.seed = args.seed.unwrap_or(config.seed);
    config.threads = args.threads.map_or(config.threads, usize::from);
    config.check()?;
    if args.print_config {
        put!("{}", config.to_toml());
        return Ok(ExitCode::SUCCESS);
    }
    let interrupt = Interrupt::on_ctrl_c()?;
    let options = ValueOptions {
        folder: args.output.clone(),
        resume: args.resume,
        expert: args.expert.clone(),
        encoder_of: args.encoder_of.clone(),
        from: args.from.clone(),
        git_commit: git_commit(),
        test_flights: args.test_flights,
    };
    let end = run_value(&config, &options, interrupt.flag(), &mut |progress| match progress {
        ValueProgress::Encoder(updates, loss) => {
            say!("encoder, {updates} updates: mean squared error of the contrast {loss:.5}");
        }
        ValueProgress::Row(row, all) => say!("{}", told(row, all)),
    });
    match end? {
        ValueEnd::Interrupted(checkpoint) => {
            say!("stopped; go on with the same command and --resume");
            say!("checkpoint       {}", checkpoint.display());
            Ok(ExitCode::from(EXIT_INTERRUPTED))
        }
        ValueEnd::Complete(path, result) => {
            for count in &result.test {
                let (low, high) = count.wilson_95;
                say!(
                    "{:<10} {:.1} % of {} (95 %: {:.1} to {:.1} %), {} collisions, {} time-outs",
                    count.family.name(),
                    100.0 * count.completion(),
                    count.flights,
                    100.0 * low,
                    100.0 * high,
                    count.collisions,
                    count.time_outs,
                );
            }
            let written = format!("written    {} after {} updates", path.display(), result.frozen_after);
            say!("{}", Paint::stdout().verdict(true, &written));
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn told(row: &ValueRow, all: u64) -> String {
    let u = &row.update;
    let judged: String = row
        .judged
        .iter()
        .map(|c| format!(", {} {:.1} %", c.family, 100.0 * c.completion()))
        .collect();
    let slope = row.slope.map_or(String::new(), |s| {
        format!(
            "; slope against flights: correlation {:.2}, same sign {:.0} %",
            s.slope_correlation,
            100.0 * s.sign_agreement
        )
    });
    format!(
        "{:>6} of {all} updates, {:.0} s: {} of {} training flights at the goal, reward {:.1}, critic {:.3}, value {:.2}{judged}{slope}",
        row.updates, row.elapsed_s, row.successes, row.flights, row.reward, u.critic_loss, u.value
    )
}
