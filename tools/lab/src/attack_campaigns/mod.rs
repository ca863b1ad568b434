//! `vigil attack`: how far the actor can be deceived. One command for each table of docs/adversary.md.

mod completion;
mod defended;
mod deflection;
mod pictures;
mod states;
mod strength;

pub use completion::Report as CompletionReport;
pub use defended::Arm;
pub use deflection::{GAPS as PAPER_DEFLECTION, Report as DeflectionReport};
pub use strength::Cell as StrengthCell;

use crate::campaign::flights::Campaign;
use crate::threads::thread_pool_of;
use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_adversary::{AttackConfig, Method};
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_tools::cli::output::{self, say};

/// Arguments of `vigil attack`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil attack table                     share of states deceived, by size and iterations (the paper's figure 11)
  vigil attack table --states 1000       the same on more states
  vigil attack deflection                yaw deflection in front of a wall (the paper's table II)
  vigil attack completion --flights 200       completion: potential field on and off, attacked and not, bursts of 5 and 50
  vigil attack completion --seed 5200 --flights 200
                                         other courses, on another machine, for `vigil merge` (docs/cluster.md)
  vigil attack search                     which streaming attack hurts most
  vigil attack defended --flights 500 --burst continuous
                                         completion undefended, with the stop alone, with recovery, and not attacked
  vigil attack defended --flights 500 --burst continuous --resume
                                         go on after an interruption
  vigil attack pictures -o runs/pictures what each attack makes of a frame, as a picture
  vigil attack defended --flights 500 --actor mine.safetensors --detector mine-detector.safetensors
                                         an imported policy with the detector that was trained for it

One flight under attack: vigil evaluate --attack …, vigil fly --attack …. The same seeds give the same figures on any
number of threads.")]
pub struct AttackCommands {
    #[command(subcommand)]
    command: AttackCommand,
}

#[derive(Debug, Clone, clap::Subcommand)]
enum AttackCommand {
    /// Share of states met in flight whose yaw moves by 1.0 or more, by method, ε and iterations.
    Table(strength::TableArgs),
    /// Yaw deflection in front of a wall, by gap and bearing of the goal.
    Deflection(deflection::DeflectionArgs),
    /// Completion with the potential field on and off, attacked and not.
    Completion(completion::CompletionArgs),
    /// Completion under each streaming attack: method, burst and direction.
    Search(completion::SearchArgs),
    /// Completion attacked and not, undefended, with the stop alone and with recovery, on the same courses.
    Defended(defended::DefendedArgs),
    /// Draws what each attack makes of a frame.
    Pictures(pictures::PicturesArgs),
}

/// What all of them take.
#[derive(Debug, Clone, clap::Args)]
struct Common {
    /// The actor under attack, in flights (completion, search, defended) also an imported policy [default: the actor built in].
    #[arg(long, value_name = "FILE")]
    actor: Option<PathBuf>,

    /// Threads; all cores when absent.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    /// Folder for JSON, CSV and pictures.
    #[arg(short, long, value_name = "DIR", default_value = "runs/attack")]
    output: PathBuf,
}

/// Which courses a campaign flies over.
#[derive(Debug, Clone, clap::Args)]
struct Seeds {
    /// Seed of the first validation course.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

    /// Fly only what the folder's NAME.jsonl does not have yet, once Ctrl-C or a kill ended an earlier run.
    #[arg(long)]
    resume: bool,
}

/// How strong an attack is.
#[derive(Debug, Clone, clap::Args)]
struct Strength {
    /// ε in 1/255 of the image's range.
    #[arg(long, default_value_t = 1.0)]
    epsilon: f32,

    /// Iterations.
    #[arg(long, default_value_t = 20)]
    iterations: u32,
}

impl Strength {
    /// For an attack as strong as that.
    fn of(&self, method: Method) -> AttackConfig {
        AttackConfig {
            method,
            epsilon_255: self.epsilon,
            iterations: self.iterations,
            ..AttackConfig::PAPER
        }
    }
}

impl Common {
    fn pilot(&self) -> Result<FrozenPilot> {
        Ok(FrozenPilot::load_or_built_in(self.actor.as_deref())?)
    }

    fn victim(&self) -> Result<FrozenActor> {
        match self.pilot()? {
            FrozenPilot::Actor(actor) => Ok(actor),
            FrozenPilot::Imported(_) => bail!(
                "this attacks single states of our own actor, and --actor is an imported policy: attack it in flight, by \
                 `vigil attack completion`, `search` or `defended`"
            ),
        }
    }

    fn pool(&self) -> Result<rayon::ThreadPool> {
        thread_pool_of(self.threads)
    }

    /// Makes the folder before the work, so that the work is not lost.
    fn folder(&self) -> Result<&Path> {
        std::fs::create_dir_all(&self.output).with_context(|| format!("cannot make {}", self.output.display()))?;
        Ok(&self.output)
    }
}

/// Runs the command.
///
/// # Errors
/// A file that is no actor, a folder that cannot be written.
pub fn run(args: &AttackCommands) -> Result<ExitCode> {
    match &args.command {
        AttackCommand::Table(args) => strength::run(args),
        AttackCommand::Deflection(args) => deflection::run(args),
        AttackCommand::Completion(args) => completion::run_completion(args),
        AttackCommand::Search(args) => completion::run_search(args),
        AttackCommand::Defended(args) => defended::run(args),
        AttackCommand::Pictures(args) => pictures::run(args),
    }
}

/// Makes one table of the flights of one of these commands.
///
/// # Errors
/// Another command; flights that contradict each other or are not all; a file that cannot be written.
pub fn merge(command: &str, files: &[PathBuf], json: &Path) -> Result<ExitCode> {
    match command {
        defended::COMMAND => defended::report(&Campaign::load(files, json)?, json)?,
        command if completion::COMMANDS.contains(&command) => completion::report(&Campaign::load(files, json)?, json)?,
        _ => {
            let first = files.first().map_or(json, PathBuf::as_path).display();
            bail!("{first} is of `vigil {command}`, which this program does not know");
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn write_json(path: &Path, report: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(report)?;
    output::write(path, text)?;
    say!("details   {}", path.display());
    Ok(())
}
