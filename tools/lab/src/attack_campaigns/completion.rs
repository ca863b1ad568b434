//! Completion under attack: the four cells of the paper's claim, and the streaming attack that hurts most.

use super::{Common, Seeds, Strength, write_json};
use crate::campaign::flights::{Campaign, Existing, Jobs};
use crate::campaign::{self, Flight, Tally};
use crate::report::TextTable;
use anyhow::Result;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;
use vigil_adversary::{Attack, AttackConfig, Burst, Method, Towards};
use vigil_tools::cli::output::say;

/// Arguments of `vigil attack completion`.
#[derive(Debug, Clone, clap::Args)]
pub struct CompletionArgs {
    /// Flights of each cell, on the same courses in all cells.
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u64).range(1..))]
    flights: u64,

    /// The attack.
    #[arg(long, value_enum, value_name = "METHOD", default_value_t = Method::BimAccumulating)]
    attack: Method,

    #[command(flatten)]
    strength: Strength,

    #[command(flatten)]
    seeds: Seeds,

    #[command(flatten)]
    common: Common,
}

/// Arguments of `vigil attack search`.
#[derive(Debug, Clone, clap::Args)]
pub struct SearchArgs {
    /// Flights of each attack, on the same courses.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    flights: u64,

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

    #[command(flatten)]
    strength: Strength,

    /// Add the potential field to the actor.
    #[arg(long)]
    apf: bool,

    #[command(flatten)]
    seeds: Seeds,

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
    interrupted: bool,
    pub rows: Vec<Row>,
}

/// Everything that decides what a flight of a seed is.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Settings {
    actor_sha256: String,
    /// Whether the potential field is on, and the attack; an arm and a row each.
    arms: Vec<(bool, Option<Setting>)>,
}

impl Row {
    fn table(rows: &[Self]) -> TextTable {
        let columns = format!(
            "field | attack | burst | towards | {} | yaw moved ≥ 1.0",
            Tally::COLUMNS
        );
        let mut table = TextTable::new(&columns);
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

    fn of((apf, attack): (bool, Option<Setting>), flights: &[&Flight]) -> Self {
        let outcomes: Vec<_> = flights.iter().map(|flight| flight.record.outcome).collect();
        let attacks = || flights.iter().filter_map(|flight| flight.attack);
        let failed = flights.iter().filter(|flight| !flight.record.is_success());
        Self {
            apf,
            attack,
            tally: Tally::of(&outcomes),
            attacked_steps: attacks().map(|attack| attack.attacked_steps).sum(),
            effective_steps: attacks().map(|attack| attack.effective_steps).sum(),
            failed_seeds: failed.map(|flight| flight.seed).collect(),
        }
    }
}

/// Flies every arm over the same courses, prints and writes the table.
fn fly_all(
    common: &Common,
    (seeds, flights): (&Seeds, u64),
    arms: Vec<(bool, Option<Setting>)>,
    command: &str,
) -> Result<ExitCode> {
    let victim = common.pilot()?;
    // Before flights of an earlier campaign are replaced.
    for setting in arms.iter().filter_map(|(_, setting)| *setting) {
        setting.config.check()?;
    }
    // The files are called as the last word of the command.
    let name = command.rsplit(' ').next().unwrap_or(command);
    let lines = common.folder()?.join(format!("{name}.jsonl"));
    let jobs = Jobs {
        first_seed: seeds.seed,
        flights,
        arms: arms.iter().map(|arm| arm_name(*arm)).collect(),
    };
    let settings = Settings {
        actor_sha256: victim.sha256(),
        arms,
    };
    let existing = Existing::replaced_unless(seeds.resume);
    let mut campaign = Campaign::new(command, settings.clone(), jobs)?.keep_in(&lines, existing)?;
    let seed = seeds.seed;
    say!("{flights} validation courses from seed {seed}, the same for every row");
    let begun = Instant::now();
    let interrupt = campaign.fly(&common.pool()?, |seed, arm, _| {
        let (apf, setting) = settings.arms[arm];
        let attack = setting.map(|s| Attack {
            pilot: victim.clone(),
            config: s.config,
            burst: s.burst,
            evade: None,
            evades_guard: false,
        });
        // Undefended; with a detector: `vigil attack defended`.
        let (config, firmware) = campaign::actor_flight(common.actor.as_deref(), apf, seed);
        campaign::fly(&config, &firmware, attack.as_ref())
    })?;
    report(&campaign, &lines.with_extension("json"))?;
    say!("{:.0} s", begun.elapsed().as_secs_f64());
    Ok(interrupt.exit_code())
}

fn arm_name((apf, attack): (bool, Option<Setting>)) -> String {
    let field = if apf { "field on" } else { "field off" };
    let attack = attack.map_or("no attack".to_owned(), |Setting { config, burst }| {
        format!("{} {burst} {}", config.method.name(), config.towards.name())
    });
    format!("{field}, {attack}")
}

/// Prints and writes the table.
pub fn report(campaign: &Campaign<Settings, Flight>, path: &Path) -> Result<()> {
    let settings = campaign.settings();
    let rows = settings.arms.iter().filter_map(|arm| {
        let name = arm_name(*arm);
        let flights: Vec<&Flight> = campaign.flights_of(&name).collect();
        (!flights.is_empty()).then(|| Row::of(*arm, &flights))
    });
    let rows: Vec<Row> = rows.collect();
    say!("{}", Row::table(&rows));
    let report = Report {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        actor_sha256: settings.actor_sha256.clone(),
        first_seed: campaign.jobs().first_seed,
        interrupted: campaign.is_interrupted(),
        rows,
    };
    write_json(path, &report)
}

/// What lines call these commands.
pub const COMMANDS: [&str; 2] = ["attack completion", "attack search"];

/// Field on and off, times no attack, 5 and 50 steps.
pub fn run_completion(args: &CompletionArgs) -> Result<ExitCode> {
    let config = args.strength.of(args.attack);
    let bursts = [None, Some(Burst::Steps(5)), Some(Burst::Steps(50))];
    let arms = |apf| bursts.map(|burst| (apf, burst.map(|burst| Setting { config, burst })));
    let settings = [true, false].map(arms).concat();
    fly_all(&args.common, (&args.seeds, args.flights), settings, COMMANDS[0])
}

/// Every method, burst and direction asked for, after a row without an attack.
pub fn run_search(args: &SearchArgs) -> Result<ExitCode> {
    let mut settings = vec![(args.apf, None)];
    for method in &args.attack {
        for towards in &args.towards {
            for burst in &args.burst {
                let config = AttackConfig {
                    towards: *towards,
                    ..args.strength.of(*method)
                };
                let arm = (args.apf, Some(Setting { config, burst: *burst }));
                // One that is given twice is flown once.
                if settings.iter().all(|known| arm_name(*known) != arm_name(arm)) {
                    settings.push(arm);
                }
            }
        }
    }
    fly_all(&args.common, (&args.seeds, args.flights), settings, COMMANDS[1])
}
