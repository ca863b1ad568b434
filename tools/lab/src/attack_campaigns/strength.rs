//! The paper's figure 11: how many states are deceived, by size and iterations of the attack.

use super::pictures::change_colour;
use super::states::{STATES_PER_FLIGHT, State, met_in_flight};
use super::{Common, write_json};
use crate::campaign::flights::check_seeds;
use crate::report::TextTable;
use crate::statistics::wilson_95;
use anyhow::Result;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::process::ExitCode;
use std::time::Instant;
use vigil_adversary::{AttackConfig, AttackOutcome, EFFECTIVE_YAW, Method, StateAttack};
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_sim::world::Image;
use vigil_tools::cli::output::{self, Interrupt, Progress, range_grey, say};
use vigil_types::{DEPTH_COLS, DEPTH_PIXELS, DEPTH_ROWS};

const EPSILONS_255: [f32; 6] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0];
const ITERATIONS: [u32; 5] = [1, 2, 5, 10, 20];
/// The two readings of the paper's attack, and noise as large as the second.
const METHODS: [Method; 3] = [Method::BimClipped, Method::BimAccumulating, Method::Noise];

/// Arguments of `vigil attack table`.
#[derive(Debug, Clone, clap::Args)]
pub struct TableArgs {
    /// States under attack, five from each flight.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    states: u64,

    /// Seed of the first flight over a validation course.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

    #[command(flatten)]
    common: Common,
}

/// As JSON, and a line of `figure-11.csv`.
#[derive(Serialize, Deserialize)]
pub struct Cell {
    pub method: Method,
    pub epsilon_255: f32,
    pub iterations: u32,
    pub states: usize,
    pub effective: usize,
    pub share: f64,
    pub wilson_95: (f64, f64),
    pub mean_yaw_change: f64,
}

/// The lines' heading; an interval has two columns.
const HEADING: &[u8] = b"method,epsilon_255,iterations,states,effective,share,low_95,high_95,mean_yaw_change\n";

impl Cell {
    /// Reads the lines.
    ///
    /// # Errors
    /// A line that does not fit.
    pub fn of_csv(text: &str) -> Result<Vec<Self>, csv::Error> {
        let lines = csv::Reader::from_reader(text.as_bytes()).into_records();
        lines.map(|line| line?.deserialize(None)).collect()
    }
}

#[derive(Serialize)]
struct Report<'a> {
    version: &'static str,
    actor_sha256: String,
    first_seed: u64,
    states: usize,
    wall_s: f64,
    /// Ctrl-C came: it is of fewer states.
    interrupted: bool,
    cells: &'a [Cell],
}

/// Attacks every state at every setting.
pub fn run(args: &TableArgs) -> Result<ExitCode> {
    let victim = args.common.victim()?;
    let folder = args.common.folder()?;
    let flights = args.states.div_ceil(STATES_PER_FLIGHT as u64);
    check_seeds(args.seed, flights)?;
    let interrupt = Interrupt::on_ctrl_c()?;
    let bar = Progress::new(args.states, "states")?;
    let begun = Instant::now();
    let mut attacked: Vec<Vec<f32>> = args.common.pool()?.install(|| {
        (0..flights)
            .into_par_iter()
            .filter(|_| !interrupt.came())
            .map(|i| {
                let mut rows = Vec::new();
                for state in met_in_flight(&victim, args.seed.wrapping_add(i))? {
                    rows.push(yaw_changes(&victim, &state)?);
                    bar.inc(1);
                }
                Ok(rows)
            })
            .collect::<Result<Vec<_>>>()
            .map(|rows| rows.into_iter().flatten().collect())
    })?;
    attacked.truncate(args.states as usize);
    bar.finish();
    let wall_s = begun.elapsed().as_secs_f64();
    if interrupt.came() {
        let (done, all) = (attacked.len(), args.states);
        say!("interrupted: {done} of {all} states were attacked");
    }
    if attacked.is_empty() {
        return Ok(interrupt.exit_code());
    }

    let cells: Vec<Cell> = settings()
        .enumerate()
        .map(|(i, (method, epsilon_255, iterations))| {
            let changes = || attacked.iter().map(|row| f64::from(row[i].abs()));
            let effective = changes().filter(|c| *c >= f64::from(EFFECTIVE_YAW)).count();
            Cell {
                method,
                epsilon_255,
                iterations,
                states: attacked.len(),
                effective,
                share: effective as f64 / attacked.len() as f64,
                wilson_95: wilson_95(effective, attacked.len()),
                mean_yaw_change: changes().sum::<f64>() / attacked.len() as f64,
            }
        })
        .collect();
    print(&cells, attacked.len(), args.seed, wall_s);
    let mut lines = csv::WriterBuilder::new()
        .has_headers(false)
        .from_writer(HEADING.to_vec());
    cells.iter().try_for_each(|cell| lines.serialize(cell))?;
    output::write(&folder.join("figure-11.csv"), lines.into_inner()?)?;
    if let Some(state) = met_in_flight(&victim, args.seed)?.first() {
        picture(&victim, state)?.write_png(&folder.join("frames.png"))?;
    }
    let report = Report {
        version: env!("CARGO_PKG_VERSION"),
        actor_sha256: victim.sha256(),
        first_seed: args.seed,
        states: attacked.len(),
        wall_s,
        interrupted: interrupt.came(),
        cells: &cells,
    };
    write_json(&folder.join("figure-11.json"), &report)?;
    Ok(interrupt.exit_code())
}

/// Method, ε, iterations of every cell, in the order of the report.
fn settings() -> impl Iterator<Item = (Method, f32, u32)> {
    METHODS.into_iter().flat_map(|method| {
        EPSILONS_255
            .into_iter()
            .flat_map(move |epsilon| ITERATIONS.map(|iterations| (method, epsilon, iterations)))
    })
}

/// Change of the yaw output at each of [`settings`].
fn yaw_changes(victim: &FrozenActor, state: &State) -> Result<Vec<f32>> {
    let mut attack = StateAttack::new(Isa::detect(), victim, &AttackConfig::PAPER)?;
    let mut frame = state.frame.clone();
    let mut changes = Vec::new();
    let mut each: Vec<AttackOutcome> = Vec::new();
    for (method, epsilon_255, iterations) in settings() {
        let config = AttackConfig {
            method,
            epsilon_255,
            iterations,
            seed: state.seed,
            ..AttackConfig::PAPER
        };
        if method != Method::BimAccumulating {
            attack.configure(&config)?;
            frame.copy_from_slice(&state.frame);
            changes.push(attack.attack(&mut frame, &state.beside)?.yaw_change());
            continue;
        }
        // Its iteration k is what an attack of k iterations gives: one run holds all of them.
        if iterations == ITERATIONS[0] {
            attack.configure(&AttackConfig {
                iterations: ITERATIONS[ITERATIONS.len() - 1],
                ..config
            })?;
            frame.copy_from_slice(&state.frame);
            each.clear();
            attack.attack_each(&mut frame, &state.beside, |_, outcome, _| each.push(outcome))?;
        }
        changes.push(each[iterations as usize - 1].yaw_change());
    }
    Ok(changes)
}

fn print(cells: &[Cell], states: usize, seed: u64, wall_s: f64) {
    say!(
        "share of {states} states whose yaw moves by 1.0 (30 °/s) or more, validation courses from seed {seed}, {wall_s:.0} s"
    );
    let iterations = ITERATIONS.map(|n| format!("{n} iterations")).join(" | ");
    let mut table = TextTable::new(&format!("method | > ε · 255 | {iterations}"));
    for row in cells.chunks(ITERATIONS.len()) {
        let shares = row.iter().map(|c| {
            let (low, high) = c.wilson_95;
            format!("{:.1} % ({:.0} to {:.0})", 100.0 * c.share, 100.0 * low, 100.0 * high)
        });
        let name = [row[0].method.name().to_owned(), row[0].epsilon_255.to_string()];
        table.row(name.into_iter().chain(shares));
    }
    say!("{table}");
}

/// Clean above altered, and the difference below: near is bright, red is nearer and blue farther.
fn picture(victim: &FrozenActor, state: &State) -> Result<Image> {
    let mut frame = state.frame.clone();
    StateAttack::new(Isa::detect(), victim, &AttackConfig::PAPER)?.attack(&mut frame, &state.beside)?;
    let (clean, altered) = (&state.frame, frame);
    let reach = AttackConfig::PAPER.reach(DEPTH_PIXELS);
    Ok(Image::from_fn(DEPTH_COLS, 3 * DEPTH_ROWS, |x, y| {
        let at = y % DEPTH_ROWS * DEPTH_COLS + x;
        match y / DEPTH_ROWS {
            0 => range_grey(clean[at]),
            1 => range_grey(altered[at]),
            _ => change_colour((altered[at] - clean[at]) / reach),
        }
    }))
}
