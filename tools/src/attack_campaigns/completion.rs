//! Completion under attack: the four cells of the paper's claim, and the streaming attack that hurts most.

use super::{Common, Victim, write_json};
use crate::campaign::{self, Flown, Tally};
use crate::cli::output::{Interrupt, Progress, say};
use crate::report::{TextTable, words};
use anyhow::Result;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::process::ExitCode;
use std::time::Instant;
use vigil_adversary::Attack;
use vigil_adversary::{AttackConfig, Burst, Method, Towards};

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

/// What `completion.json` and `search.json` hold.
#[derive(Serialize, Deserialize)]
pub struct Report {
    version: String,
    actor_sha256: String,
    first_seed: u64,
    wall_s: f64,
    /// Ctrl-C came: rows are missing, and the last is of fewer flights.
    #[serde(default)]
    interrupted: bool,
    pub rows: Vec<Row>,
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

struct Campaign<'a> {
    common: &'a Common,
    victim: &'a Victim,
    seed: u64,
    flights: u64,
    pool: rayon::ThreadPool,
    bar: Progress,
    interrupt: Interrupt,
}

impl Campaign<'_> {
    fn row(&self, apf: bool, setting: Option<Setting>) -> Result<Row> {
        let attack = setting.map(|s| Attack {
            params: self.victim.params.clone(),
            inputs: self.victim.inputs,
            config: s.config,
            burst: s.burst,
            evade: None,
        });
        let flown: Vec<(u64, Flown)> = self.pool.install(|| {
            (0..self.flights)
                .into_par_iter()
                .filter(|_| !self.interrupt.came())
                .map(|i| {
                    let seed = self.seed.wrapping_add(i);
                    // Undefended; with a detector: `vigil attack defended`.
                    let (config, firmware) = campaign::actor_flight(self.common.actor.as_deref(), apf, seed);
                    let flown = campaign::fly(&config, &firmware, attack.as_ref())?;
                    self.bar.inc(1);
                    Ok((seed, flown))
                })
                .collect::<Result<_>>()
        })?;
        let outcomes: Vec<_> = flown.iter().map(|(_, flown)| flown.record.outcome).collect();
        let steps = |of: fn(&vigil_adversary::AttackRecord) -> u64| {
            flown.iter().filter_map(|(_, f)| f.attack.as_ref()).map(of).sum()
        };
        Ok(Row {
            apf,
            attack: setting,
            tally: Tally::of(&outcomes),
            attacked_steps: steps(|a| a.attacked_steps),
            effective_steps: steps(|a| a.effective_steps),
            failed_seeds: flown
                .iter()
                .filter(|(_, f)| !f.record.is_success())
                .map(|(seed, _)| *seed)
                .collect(),
        })
    }
}

/// Flies every setting over the same courses, prints and writes the table.
fn fly_all(
    common: &Common,
    (seed, flights): (u64, u64),
    settings: &[(bool, Option<Setting>)],
    name: &str,
) -> Result<ExitCode> {
    let victim = common.victim()?;
    let folder = common.folder()?;
    let campaign = Campaign {
        common,
        victim: &victim,
        seed,
        flights,
        pool: common.pool()?,
        bar: Progress::new(flights.saturating_mul(settings.len() as u64), "flights")?,
        interrupt: Interrupt::on_ctrl_c()?,
    };
    let begun = Instant::now();
    say!("{flights} validation courses from seed {seed}, the same for every row");
    let rows: Vec<Row> = settings
        .iter()
        .take_while(|_| !campaign.interrupt.came())
        .map(|(apf, setting)| campaign.row(*apf, *setting))
        .collect::<Result<_>>()?;
    campaign.bar.finish();
    say!("{}", Row::table(&rows));
    let interrupted = campaign.interrupt.came();
    if interrupted {
        let flown: usize = rows.iter().map(|row: &Row| row.tally.flights).sum();
        say!(
            "interrupted: {flown} of {} flights were flown",
            flights * settings.len() as u64
        );
    }
    let wall_s = begun.elapsed().as_secs_f64();
    say!("{wall_s:.0} s");
    write_json(
        &folder.join(name),
        &Report {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            actor_sha256: victim.sha256.clone(),
            first_seed: seed,
            wall_s,
            interrupted,
            rows,
        },
    )?;
    Ok(campaign.interrupt.exit_code())
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
    fly_all(&args.common, (args.seed, args.flights), &settings, "completion.json")
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
                    seed: 0,
                };
                settings.push((args.apf, Some(Setting { config, burst: *burst })));
            }
        }
    }
    fly_all(&args.common, (args.seed, args.flights), &settings, "search.json")
}
