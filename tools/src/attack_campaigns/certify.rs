//! What is proved and what is done: states in which no attack within ε can turn the actor, and states in which one does.

use super::states::{STATES_PER_FLIGHT, State, met_in_flight};
use super::{Common, Victim, write_json};
use crate::cli::output::{self, Interrupt, Progress, say};
use crate::report::{Figure, Panel, Picture, Scale, TextTable, numbers, to_csv};
use crate::statistics::wilson_95;
use anyhow::{Result, ensure};
use rayon::prelude::*;
use serde::Serialize;
use std::process::ExitCode;
use std::time::Instant;
use vigil_adversary::{AttackConfig, Certificate, CertifiedOutput, EFFECTIVE_YAW, Method, StateAttack};
use vigil_nnet::Isa;

/// Arguments of `vigil attack certify`.
#[derive(Debug, Clone, clap::Args)]
pub struct CertifyArgs {
    /// States, five from each flight.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    states: u64,

    /// Seed of the first flight over a validation course.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

    /// Each ε in 1/255 of the image's range, rising.
    #[arg(long, value_delimiter = ',', default_value = "0.02,0.05,0.1,0.25,0.5,1,2,5,20")]
    epsilon: Vec<f32>,

    /// Iterations of the attack that is made beside the proof.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,

    #[command(flatten)]
    common: Common,
}

/// Of one state at one ε.
struct Judged {
    proved: CertifiedOutput,
    attacked_yaw: f32,
}

#[derive(Serialize)]
struct Line {
    epsilon_255: f32,
    /// The same as a range, metres.
    epsilon_m: f32,
    states: usize,
    certified: usize,
    certified_share: f64,
    certified_low_95: f64,
    certified_high_95: f64,
    attacked: usize,
    attacked_share: f64,
    attacked_low_95: f64,
    attacked_high_95: f64,
    /// Mean of the most that the yaw output may move, by proof; 3 is all of its range.
    mean_most_moved: f64,
}

#[derive(Serialize)]
struct Report<'a> {
    version: &'static str,
    actor_sha256: &'a str,
    first_seed: u64,
    states: usize,
    iterations: u32,
    wall_s: f64,
    /// Ctrl-C came: it is of fewer states.
    interrupted: bool,
    lines: &'a [Line],
}

/// Bounds and attacks every state at every ε.
///
/// # Errors
/// A file that is no actor, a folder that cannot be written, an attack that leaves the bounds, which would be a mistake in them.
pub fn run(args: &CertifyArgs) -> Result<ExitCode> {
    ensure!(
        args.epsilon.is_sorted_by(|a, b| a < b) && args.epsilon.first().is_some_and(|first| *first > 0.0),
        "--epsilon: sizes above 0 that rise, separated by commas"
    );
    let victim = args.common.victim()?;
    let folder = args.common.folder()?;
    let flights = args.states.div_ceil(STATES_PER_FLIGHT as u64);
    let interrupt = Interrupt::on_ctrl_c()?;
    let bar = Progress::new(args.states, "states")?;
    let begun = Instant::now();
    let mut judged: Vec<Vec<Judged>> = args.common.pool()?.install(|| {
        (0..flights)
            .into_par_iter()
            .filter(|_| !interrupt.came())
            .map(|i| {
                let mut rows = Vec::new();
                let mut certificate = Certificate::new(victim.inputs.spec(), Isa::detect(), &victim.params)?;
                for state in met_in_flight((&victim.params, victim.inputs), args.seed.wrapping_add(i))? {
                    rows.push(judge((&victim, &mut certificate), &state, args)?);
                    bar.inc(1);
                }
                Ok(rows)
            })
            .collect::<Result<Vec<_>>>()
            .map(|rows| rows.into_iter().flatten().collect())
    })?;
    judged.truncate(args.states as usize);
    bar.finish();
    let wall_s = begun.elapsed().as_secs_f64();
    if judged.is_empty() {
        return Ok(interrupt.exit_code());
    }
    let lines: Vec<Line> = args
        .epsilon
        .iter()
        .enumerate()
        .map(|(i, epsilon_255)| line(*epsilon_255, judged.iter().filter_map(|row| row.get(i))))
        .collect();
    print(&lines, judged.len(), args, wall_s);
    output::write(&folder.join("certified.csv"), to_csv(&lines))?;
    let figure = figure(&lines);
    output::write(&folder.join("certified.svg"), figure.svg())?;
    write_json(
        &folder.join("certified.json"),
        &Report {
            version: env!("CARGO_PKG_VERSION"),
            actor_sha256: &victim.sha256,
            first_seed: args.seed,
            states: judged.len(),
            iterations: args.iterations,
            wall_s,
            interrupted: interrupt.came(),
            lines: &lines,
        },
    )?;
    Ok(interrupt.exit_code())
}

/// One state at each ε.
fn judge((victim, certificate): (&Victim, &mut Certificate), state: &State, args: &CertifyArgs) -> Result<Vec<Judged>> {
    let isa = Isa::detect();
    let mut attack = StateAttack::on(victim.inputs.spec(), isa, &victim.params, &AttackConfig::PAPER)?;
    let mut frames = state.frames.clone();
    args.epsilon
        .iter()
        .map(|epsilon_255| {
            let [_, proved] = certificate.outputs(&state.frames, state.position, epsilon_255 / 255.0)?;
            attack.configure(&AttackConfig {
                method: Method::BimClipped,
                epsilon_255: *epsilon_255,
                iterations: args.iterations,
                seed: state.seed,
                ..AttackConfig::PAPER
            })?;
            frames.copy_from_slice(&state.frames);
            let [_, attacked_yaw] = attack.attack(&mut frames, state.position)?.attacked;
            // An oracle that costs nothing: what an attack does is possible.
            ensure!(
                (proved.lower..=proved.upper).contains(&attacked_yaw),
                "an attack of ε = {epsilon_255}/255 brought the yaw output to {attacked_yaw}, outside of its bounds {} to {}: the \
                 bounds are wrong, report this with --seed {}",
                proved.lower,
                proved.upper,
                state.seed,
            );
            Ok(Judged { proved, attacked_yaw })
        })
        .collect()
}

fn line<'a>(epsilon_255: f32, judged: impl Iterator<Item = &'a Judged>) -> Line {
    let judged: Vec<&Judged> = judged.collect();
    let states = judged.len();
    let count = |of: &dyn Fn(&Judged) -> bool| judged.iter().filter(|j| of(j)).count();
    let certified = count(&|j| j.proved.holds());
    let attacked = count(&|j| (j.attacked_yaw - j.proved.clean).abs() >= EFFECTIVE_YAW);
    let (certified_low_95, certified_high_95) = wilson_95(certified, states);
    let (attacked_low_95, attacked_high_95) = wilson_95(attacked, states);
    let share = |count: usize| count as f64 / states.max(1) as f64;
    Line {
        epsilon_255,
        epsilon_m: epsilon_255 / 255.0 * vigil_types::DEPTH_FULL_SCALE_M,
        states,
        certified,
        certified_share: share(certified),
        certified_low_95,
        certified_high_95,
        attacked,
        attacked_share: share(attacked),
        attacked_low_95,
        attacked_high_95,
        mean_most_moved: judged.iter().map(|j| f64::from(j.proved.most_moved())).sum::<f64>() / states.max(1) as f64,
    }
}

fn print(lines: &[Line], states: usize, args: &CertifyArgs, wall_s: f64) {
    let (seed, iterations) = (args.seed, args.iterations);
    say!(
        "of {states} states, validation courses from seed {seed}: share whose yaw no frames within ε can move by 1.0 (30 °/s) or more, \
         and share that BIM of {iterations} iterations within ε does move so; {wall_s:.0} s"
    );
    let heads = [
        "ε · 255",
        "ε in m",
        "certified",
        "moved by attack",
        "most by proof, mean",
    ];
    let mut table = TextTable::new(heads.map(numbers));
    for l in lines {
        let share = |share: f64, low: f64, high: f64| {
            format!("{:.1} % ({:.0} to {:.0})", 100.0 * share, 100.0 * low, 100.0 * high)
        };
        table.row([
            l.epsilon_255.to_string(),
            format!("{:.3}", l.epsilon_m),
            share(l.certified_share, l.certified_low_95, l.certified_high_95),
            share(l.attacked_share, l.attacked_low_95, l.attacked_high_95),
            format!("{:.2}", l.mean_most_moved),
        ]);
    }
    say!("{table}");
}

/// Between both lines lies what neither is proved nor done.
fn figure(lines: &[Line]) -> Figure {
    let points = |of: fn(&Line) -> f64| lines.iter().map(|l| (f64::from(l.epsilon_255), of(l))).collect();
    let mut panel = Panel::new(
        "States whose yaw output stays within 1.0",
        "share",
        [
            ("proved", points(|l| l.certified_share)),
            ("not moved by BIM", points(|l| 1.0 - l.attacked_share)),
        ],
    );
    let band = |of: fn(&Line) -> (f64, f64)| {
        let ends = |l: &Line| (f64::from(l.epsilon_255), of(l).0, of(l).1);
        lines.iter().map(ends).collect()
    };
    panel.series[0].band = band(|l| (l.certified_low_95, l.certified_high_95));
    panel.series[1].band = band(|l| (1.0 - l.attacked_high_95, 1.0 - l.attacked_low_95));
    panel.top = Some(1.0);
    let ticks: Vec<f64> = lines.iter().map(|l| f64::from(l.epsilon_255)).collect();
    let last = ticks.last().copied().unwrap_or(1.0);
    let mut figure = Figure::over("ε · 255, logarithmic (1 is 0.39 m)", last, vec![panel]);
    figure.x_scale = Scale::Logarithmic(ticks);
    figure
}
