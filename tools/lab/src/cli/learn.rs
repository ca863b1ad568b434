//! `vigil learn`: an actor by value, from nothing.

use crate::cli::output::{EXIT_INTERRUPTED, Interrupt, Paint, put, say};
use crate::trainer::config::LearnConfig;
use crate::trainer::evaluation::FamilyCount;
use crate::trainer::run::{LearnEnd, LearnOptions, Progress, Row, learn};
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use vigil_policy::FrozenActor;
use vigil_policy::actor::ActorSpec;

/// Arguments of `vigil learn`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil learn -o runs/mine                     an actor from nothing: encoder, then value
  vigil learn -o runs/mine --resume            go on after an interruption, bit for bit
  vigil learn -o runs/two --seed 2 --encoder-of runs/mine/actor.safetensors
                                               another seed behind the same encoder
  vigil learn --print-config                   every key with its default

The run leaves curves.csv, flights.csv, config.toml, checkpoint.safetensors, result.json and actor.safetensors in its folder;
`vigil report` reads it. At the end the chosen actor is tested, and so is the same actor blind and without its memory.
`vigil rollout --actor` flies it. docs/learning.md explains the method.")]
pub struct LearnArgs {
    /// Training file (TOML); what it does not name keeps its default.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Seed, instead of the configuration's; below 2⁶³, as TOML's integers.
    #[arg(long, value_parser = clap::value_parser!(u64).range(..1 << 63))]
    seed: Option<u64>,

    /// Threads, instead of the configuration's; any number trains the same.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,

    /// Share of the training flights with the potential field, instead of the configuration's.
    #[arg(long, value_name = "SHARE")]
    apf_share: Option<f64>,

    /// Folder of the run.
    #[arg(short, long, value_name = "DIR", default_value = "runs/learn")]
    output: PathBuf,

    /// Take the encoder of this actor instead of teaching one.
    #[arg(long, value_name = "FILE")]
    encoder_of: Option<PathBuf>,

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

/// Trains.
///
/// # Errors
/// A bad configuration, a folder that cannot be written or holds another run, a loss that is not finite.
pub fn run(args: &LearnArgs) -> Result<ExitCode> {
    let mut config = match &args.config {
        Some(path) => LearnConfig::load(path)?,
        None => LearnConfig::default(),
    };
    config.seed = args.seed.unwrap_or(config.seed);
    config.threads = args.threads.map_or(config.threads, usize::from);
    config.apf_share = args.apf_share.unwrap_or(config.apf_share);
    config.check()?;
    if args.print_config {
        put!("{}", vigil_types::settings::to_toml(&config));
        return Ok(ExitCode::SUCCESS);
    }
    let whole = args.encoder_of.as_deref().map(FrozenActor::load).transpose()?;
    let encoder = whole.map(|mut actor| {
        actor.params.truncate(ActorSpec::FULL.encoder_len());
        actor.params
    });
    let interrupt = Interrupt::on_ctrl_c()?;
    let options = LearnOptions {
        folder: args.output.clone(),
        resume: args.resume,
        encoder,
        test_flights: args.test_flights,
    };
    let end = learn(&config, &options, interrupt.flag(), &mut |progress| match progress {
        Progress::Encoder(updates, loss) => {
            say!("encoder, {updates} updates: mean squared error of the proximity {loss:.5}");
        }
        Progress::Row(row, all) => say!("{}", line(row, all)),
    });
    match end? {
        LearnEnd::Interrupted(None) => {
            say!("stopped while the encoder was taught, of which nothing is kept: the same command begins anew");
            Ok(ExitCode::from(EXIT_INTERRUPTED))
        }
        LearnEnd::Interrupted(Some(checkpoint)) => {
            say!("stopped; go on with the same command and --resume");
            say!("checkpoint       {}", checkpoint.display());
            Ok(ExitCode::from(EXIT_INTERRUPTED))
        }
        LearnEnd::Complete(actor, result) => {
            for count in &result.test {
                say!("{}", completion(count));
            }
            let path = args.output.join("actor.safetensors");
            let written = format!("written    {} after {} updates", path.display(), actor.updates);
            say!("{}", Paint::stdout().verdict(true, &written));
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn completion(count: &FamilyCount) -> String {
    let (low, high) = count.wilson_95;
    let taken = count.ablation.as_ref().map(|taken| format!("without {taken}"));
    format!(
        "{:<10} {:<16} {:.1} % of {} (95 %: {:.1} to {:.1} %), {} collisions, {} time-outs",
        count.family.name(),
        taken.unwrap_or_default(),
        100.0 * count.completion(),
        count.flights,
        100.0 * low,
        100.0 * high,
        count.collisions,
        count.time_outs,
    )
}

fn line(row: &Row, all: u64) -> String {
    let share = |c: &FamilyCount| format!(", {} {:.1} %", c.family, 100.0 * c.completion());
    let evaluated: String = row.evaluated.iter().map(share).collect();
    let reward = row.reward(1).unwrap_or_else(|| "-".to_owned());
    format!(
        "{:>6} of {all} updates, {:.0} s: {} of {} training flights at the goal, reward {reward}, critic {:.3}, value {:.2}{evaluated}",
        row.updates, row.elapsed_s, row.successes, row.flights, row.update.critic_loss, row.update.value
    )
}
