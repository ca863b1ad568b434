//! Completion under attack: the four cells of the paper's claim, and the streaming attack that hurts most.

use super::{Common, write_json};
use crate::campaign::part::{self, Part, Shard, Unit};
use crate::campaign::{self, Tally};
use crate::cli::output::{Interrupt, Progress, say};
use crate::report::{TextTable, words};
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use vigil_adversary::Attack;
use vigil_adversary::{AttackConfig, Burst, Method, Towards};
use vigil_policy::FrozenPilot;
use vigil_sim::lockstep_flight::FlightRecord;

/// Arguments of `vigil attack completion`.
#[derive(Debug, Clone, clap::Args)]
pub struct CompletionArgs {
    /// Flights of each cell, on the same courses in all cells.
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u64).range(1..))]
    flights: u64,

    /// Seed of the first validation course.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

    /// The attack.
    #[arg(long, value_enum, value_name = "METHOD", default_value_t = Method::BimAccumulating)]
    attack: Method,

    /// ε in 1/255 of the image's range.
    #[arg(long, default_value_t = 1.0)]
    epsilon: f32,

    /// Iterations.
    #[arg(long, default_value_t = 20)]
    iterations: u32,

    /// Fly part K of N only and leave it in the folder as NAME.K-of-N.part.json; `vigil merge` makes the whole of all parts.
    /// A part that is there already is gone on with.
    #[arg(long, value_name = "K/N")]
    shard: Option<Shard>,

    #[command(flatten)]
    common: Common,
}

/// Arguments of `vigil attack search`.
#[derive(Debug, Clone, clap::Args)]
pub struct SearchArgs {
    /// Flights of each attack, on the same courses.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    flights: u64,

    /// Seed of the first validation course.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

    /// Attacks to try.
    #[arg(
        long,
        value_enum,
        value_name = "METHOD,…",
        value_delimiter = ',',
        default_value = "bim-accumulating,pgd"
    )]
    attack: Vec<Method>,

    /// Lengths to try, in steps.
    #[arg(
        long,
        value_name = "STEPS|continuous,…",
        value_delimiter = ',',
        default_value = "5,50,100,continuous"
    )]
    burst: Vec<Burst>,

    /// Directions to try.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "away")]
    towards: Vec<Towards>,

    /// ε in 1/255 of the image's range.
    #[arg(long, default_value_t = 1.0)]
    epsilon: f32,

    /// Iterations.
    #[arg(long, default_value_t = 20)]
    iterations: u32,

    /// Add the potential field to the actor.
    #[arg(long)]
    apf: bool,

    /// Fly part K of N only and leave it in the folder as NAME.K-of-N.part.json; `vigil merge` makes the whole of all parts.
    /// A part that is there already is gone on with.
    #[arg(long, value_name = "K/N")]
    shard: Option<Shard>,

    #[command(flatten)]
    common: Common,
}

/// Flights of one setting, all over the same courses.
#[derive(Serialize, Deserialize)]
pub struct Row {
    pub apf: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attack: Option<Setting>,
    #[serde(flatten)]
    pub tally: Tally,
    attacked_steps: u64,
    effective_steps: u64,
    /// Of those that failed.
    failed_seeds: Vec<u64>,
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Setting {
    #[serde(flatten)]
    pub config: AttackConfig,
    pub burst: Burst,
}

/// What `completion.json` and `search.json` hold. Nothing in it depends on the machine or on the time that it took.
#[derive(Serialize, Deserialize)]
pub struct Report {
    version: String,
    actor_sha256: String,
    first_seed: u64,
    /// Ctrl-C came: rows are missing, or of fewer flights.
    #[serde(default)]
    interrupted: bool,
    pub rows: Vec<Row>,
}

/// Everything that decides what the flights are, wherever they are flown.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Plan {
    first_seed: u64,
    /// With each setting.
    flights: u64,
    actor_sha256: String,
    /// Whether the potential field is on, and the attack; a row each.
    settings: Vec<(bool, Option<Setting>)>,
}

impl Plan {
    /// Of an actor whose digest is not known yet.
    fn new(first_seed: u64, flights: u64, settings: Vec<(bool, Option<Setting>)>) -> Self {
        Self {
            first_seed,
            flights,
            actor_sha256: String::new(),
            settings,
        }
    }

    fn units(&self) -> u64 {
        self.flights.saturating_mul(self.settings.len() as u64)
    }

    /// The number of a unit's row, and its seed.
    fn place(&self, unit: u64) -> (usize, u64) {
        let row = (unit / self.flights) as usize;
        (row, self.first_seed.wrapping_add(unit % self.flights))
    }
}

/// A flight as its row needs it.
#[derive(Debug, Serialize, Deserialize)]
struct RowFlight {
    row: usize,
    seed: u64,
    record: FlightRecord,
    attacked_steps: u64,
    effective_steps: u64,
}

impl Unit for RowFlight {
    fn name(&self) -> String {
        format!("the flight of seed {} in row {}", self.seed, self.row + 1)
    }
}

impl Row {
    fn table(rows: &[Self]) -> TextTable {
        let names = ["field", "attack", "burst", "towards"].map(words);
        let columns = names
            .into_iter()
            .chain(Tally::columns())
            .chain([words("yaw moved ≥ 1.0")]);
        let mut table = TextTable::new(columns);
        for row in rows {
            let (attack, burst, towards) = row.attack.map_or(("none", "—".to_owned(), "—"), |s| {
                (s.config.method.name(), s.burst.to_string(), s.config.towards.name())
            });
            let field = if row.apf { "on" } else { "off" };
            let names = [field.to_owned(), attack.to_owned(), burst, towards.to_owned()];
            let effective = campaign::effective_share(row.attacked_steps, row.effective_steps);
            table.row(names.into_iter().chain(row.tally.cells()).chain([effective]));
        }
        table
    }
}

impl Row {
    fn of((apf, attack): (bool, Option<Setting>), flights: &[&RowFlight]) -> Self {
        let outcomes: Vec<_> = flights.iter().map(|flight| flight.record.outcome).collect();
        Self {
            apf,
            attack,
            tally: Tally::of(&outcomes),
            attacked_steps: flights.iter().map(|flight| flight.attacked_steps).sum(),
            effective_steps: flights.iter().map(|flight| flight.effective_steps).sum(),
            failed_seeds: flights
                .iter()
                .filter(|flight| !flight.record.is_success())
                .map(|flight| flight.seed)
                .collect(),
        }
    }
}

/// Flies one unit.
fn fly(plan: &Plan, (actor, victim): (Option<&Path>, &FrozenPilot), unit: u64) -> Result<RowFlight> {
    let (row, seed) = plan.place(unit);
    let (apf, setting) = plan.settings.get(row).copied().context("a row for each flight")?;
    let attack = setting.map(|s| Attack {
        pilot: victim.clone(),
        config: s.config,
        burst: s.burst,
        evade: None,
        evades_guard: false,
    });
    // Undefended; with a detector: `vigil attack defended`.
    let (config, firmware) = campaign::actor_flight(actor, apf, seed);
    let flown = campaign::fly(&config, &firmware, attack.as_ref())?;
    let done = flown.attack.unwrap_or_default();
    Ok(RowFlight {
        row,
        seed,
        record: flown.record,
        attacked_steps: done.attacked_steps,
        effective_steps: done.effective_steps,
    })
}

/// Flies every setting over the same courses, prints and writes the table; or a shard of it.
fn fly_all(common: &Common, mut plan: Plan, shard: Option<Shard>, command: &str) -> Result<ExitCode> {
    let victim = common.pilot()?;
    plan.actor_sha256 = victim.sha256();
    // The file is called as the last word of the command.
    let name = command.rsplit(' ').next().unwrap_or(command);
    let path = common.folder()?.join(format!("{name}.json"));
    let units = plan.units();
    let (pool, bar, interrupt) = (
        common.pool()?,
        Progress::new(units, "flights")?,
        Interrupt::on_ctrl_c()?,
    );
    let with = (common.actor.as_deref(), &victim);
    say!(
        "{} validation courses from seed {}, the same for every row",
        plan.flights,
        plan.first_seed
    );
    if let Some(shard) = shard {
        let path = shard.file(&path);
        let part = Part::begin(command, plan.clone(), (shard, units), &path)?;
        bar.set_length(part.missing().len() as u64);
        part.fly(&path, (&pool, &bar, &interrupt), |unit| fly(&plan, with, unit))?;
        return Ok(interrupt.exit_code());
    }
    let begun = Instant::now();
    let flown = part::fly_units((0..units).collect(), (&pool, &bar, &interrupt), |unit| {
        fly(&plan, with, unit)
    })?;
    bar.finish();
    let flights: Vec<RowFlight> = flown.into_iter().map(|(_, flight)| flight).collect();
    report(&plan, &flights, &path)?;
    say!("{:.0} s", begun.elapsed().as_secs_f64());
    Ok(interrupt.exit_code())
}

/// Prints and writes the table.
fn report(plan: &Plan, flights: &[RowFlight], path: &Path) -> Result<()> {
    let rows: Vec<Row> = plan
        .settings
        .iter()
        .enumerate()
        .map(|(row, setting)| {
            let of_it: Vec<&RowFlight> = flights.iter().filter(|flight| flight.row == row).collect();
            (setting, of_it)
        })
        .filter(|(_, of_it)| !of_it.is_empty())
        .map(|(setting, of_it)| Row::of(*setting, &of_it))
        .collect();
    say!("{}", Row::table(&rows));
    let interrupted = (flights.len() as u64) < plan.units();
    if interrupted {
        say!("interrupted: {} of {} flights were flown", flights.len(), plan.units());
    }
    write_json(
        path,
        &Report {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            actor_sha256: plan.actor_sha256.clone(),
            first_seed: plan.first_seed,
            interrupted,
            rows,
        },
    )
}

/// What parts call these commands.
pub const COMMANDS: [&str; 2] = ["attack completion", "attack search"];

/// Makes the whole of its parts: the table, and the JSON as one machine would have written it.
///
/// # Errors
/// Parts that contradict each other or are not all; a file that cannot be written.
pub fn merge(parts: &[PathBuf], json: &Path) -> Result<ExitCode> {
    let (plan, flights) = part::join::<Plan, RowFlight>(parts)?;
    report(&plan, &flights, json)?;
    Ok(ExitCode::SUCCESS)
}

/// Field on and off, times no attack, 5 and 50 steps.
///
/// # Errors
/// A file that is no actor, a folder that cannot be written.
pub fn run_completion(args: &CompletionArgs) -> Result<ExitCode> {
    let config = AttackConfig {
        method: args.attack,
        epsilon_255: args.epsilon,
        iterations: args.iterations,
        ..AttackConfig::PAPER
    };
    let bursts = [None, Some(5), Some(50)].map(|steps| {
        steps.map(|steps| Setting {
            config,
            burst: Burst::Steps(steps),
        })
    });
    let settings: Vec<_> = [true, false]
        .into_iter()
        .flat_map(|apf| bursts.map(|setting| (apf, setting)))
        .collect();
    let plan = Plan::new(args.seed, args.flights, settings);
    fly_all(&args.common, plan, args.shard, COMMANDS[0])
}

/// Every method, burst and direction asked for, after a row without an attack.
///
/// # Errors
/// A file that is no actor, a folder that cannot be written.
pub fn run_search(args: &SearchArgs) -> Result<ExitCode> {
    let mut settings = vec![(args.apf, None)];
    for method in &args.attack {
        for towards in &args.towards {
            for burst in &args.burst {
                let config = AttackConfig {
                    method: *method,
                    epsilon_255: args.epsilon,
                    iterations: args.iterations,
                    towards: *towards,
                    ..AttackConfig::PAPER
                };
                settings.push((args.apf, Some(Setting { config, burst: *burst })));
            }
        }
    }
    let plan = Plan::new(args.seed, args.flights, settings);
    fly_all(&args.common, plan, args.shard, COMMANDS[1])
}
