//! `vigil rollout`: how an actor flies alone, without MAVLink and guidance around it.

use crate::campaign::Tally;
use crate::campaign::flights::check_seeds;
use crate::cli::output::{or_dash, say};
use crate::report::TextTable;
use crate::threads::thread_pool_of;
use crate::trainer::evaluation::{EvaluatedActor, EvaluationSpec, evaluate, mean_time_s, tally};
use crate::trainer::observation::Drift;
use crate::trainer::probe::{Readout, probe};
use anyhow::{Result, bail, ensure};
use std::path::Path;
use std::process::ExitCode;
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_types::Ablation;

/// Arguments of `vigil rollout`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil rollout --actor runs/learn/actor.safetensors    100 validation courses, the field off and on
  vigil rollout --actor runs/learn/actor.safetensors --ablate frames
                                                        ... blind
  vigil rollout --actor zero                            what the field does without any actor
  vigil rollout --actor random                          ... and with one that draws its action evenly each step
  vigil rollout --actor geometric --family hard         the geometric pilot
  vigil rollout --actor built-in --family hard --flights 180 --probe
                                                        what its 48 values hold of what it saw 5 to 30 s ago

The actor decides every step on the simulator's own frames and estimates. `vigil evaluate` flies the whole stack.")]
pub struct RolloutArgs {
    /// A frozen actor, or `built-in`, `zero`, `random` or `geometric`.
    #[arg(long, value_name = "FILE")]
    actor: String,

    #[command(flatten)]
    what: EvaluationSpec,

    /// Threads; all cores when absent.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    /// Tell instead how much a linear read-out of the actor's 48 values says of surfaces that it saw 5, 15 and 30 s ago and that now lie
    /// out of view; two flights of three are fitted on.
    #[arg(long, conflicts_with_all = ["ablation", "scale", "yaw_rad_s"])]
    probe: bool,
}

/// Flies the courses without and with the field and prints both.
pub fn run(args: &RolloutArgs) -> Result<ExitCode> {
    let what = args.what;
    ensure!(
        what.time_limit_s > 0.0 && what.time_limit_s <= 3600.0,
        "--time-limit must be above 0, at most 3600 s, got {}",
        what.time_limit_s
    );
    ensure!(
        what.drift.scale.abs() <= 0.5 && what.drift.yaw_rad_s.abs() <= 10_f32.to_radians(),
        "--drift-scale must be within 0.5, --drift-yaw within 10 degrees per second"
    );
    check_seeds(what.first_seed, what.flights)?;
    let frozen;
    let evaluated = match args.actor.as_str() {
        "zero" => EvaluatedActor::Zero,
        "random" => EvaluatedActor::Random,
        "geometric" => EvaluatedActor::Geometric,
        name => {
            frozen = match name {
                "built-in" => FrozenActor::built_in()?,
                file => FrozenActor::load(Path::new(file))?,
            };
            EvaluatedActor::Actor(&frozen)
        }
    };
    let controlled = what.ablation != Ablation::Nothing || what.drift != Drift::default();
    ensure!(
        !controlled || matches!(evaluated, EvaluatedActor::Actor(..)),
        "--ablate, --drift-scale and --drift-yaw are for actors, and {} is none",
        args.actor
    );
    let pool = thread_pool_of(args.threads)?;
    let mut table = TextTable::new(&format!("field | {} | > mean time", Tally::COLUMNS));
    // The geometric pilot has the field in it.
    let fields: &[bool] = match evaluated {
        EvaluatedActor::Geometric => &[false],
        _ => &[false, true],
    };
    if args.probe {
        let EvaluatedActor::Actor(frozen) = evaluated else {
            bail!("--probe is for actors, and {} is none", args.actor);
        };
        ensure!(
            what.flights >= 4,
            "--probe needs 4 flights or more: two of three are fitted on, and each is compared with another one"
        );
        let readouts = pool.install(|| probe(frozen, Isa::detect(), &what))?;
        say!("{}", probed(&readouts));
        return Ok(ExitCode::SUCCESS);
    }
    for &field in fields {
        let what = EvaluationSpec { field, ..what };
        let flights = pool.install(|| evaluate(evaluated, Isa::detect(), &what))?;
        let field = [if field { "on" } else { "off" }.to_owned()];
        let mean_time = [or_dash(mean_time_s(&flights).unwrap_or(f64::NAN), 1, " s")];
        table.row(field.into_iter().chain(tally(&flights).cells()).chain(mean_time));
    }
    say!("{table}");
    Ok(ExitCode::SUCCESS)
}

/// Shares of variance, with their controls.
fn probed(readouts: &[Readout]) -> TextTable {
    let mut table = TextTable::new(
        "R² of what was seen | > moments | > 48 values | > memory wiped | > newest scan | > another flight's past",
    );
    for readout in readouts {
        let cells = [format!("{} s ago", readout.lag_s), readout.samples.to_string()];
        let shares = readout.shares.map(|share| or_dash(share, 2, ""));
        table.row(cells.into_iter().chain(shares));
    }
    table
}
