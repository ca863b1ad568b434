//! A learned adversary: a small policy that sees each frame and shows what stands there nearer or farther, found by evolution from how flights
//! against everything that defends end (evolution strategies: Rechenberg, 1973; Salimans et al., 2017). A black box: it asks for no gradient
//! and no decision of the actor, and its questions are flights, which are counted.

use super::{Common, write_json};
use crate::campaign;
use crate::cli::output::{self, Interrupt, Progress, say};
use crate::report::{Figure, Panel, Picture, to_csv};
use anyhow::{Context, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use vigil_adversary::{Attack, AttackConfig, Burst, LearnedAdversary, Method};
use vigil_types::AlarmPolicy;
use vigil_world::Outcome;

/// Standard deviation of what is tried around the adversary's weights. With three times as much nearly all that is tried is held for pictures that
/// do not fit each other, and nothing is learned.
const SPREAD: f32 = 0.08;
/// Root mean square of the first generation's step; the last one's is a fifth of it.
const FIRST_STEP: f32 = 0.06;
const LAST_STEP: f32 = 0.2 * FIRST_STEP;
/// A vehicle's middle that comes so near touches, metres; and how fast what a near miss is worth falls from there.
const TOUCHING_M: f32 = 0.3;
const NEAR_MISS_M: f32 = 0.4;

/// Arguments of `vigil attack learn`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil attack learn -o runs/learned                       against the default stack
  vigil attack learn -o runs/learned-2 --second-sensor-heads 1 --from runs/learned/adversary.json
                                                           goes on from there, against a second sensor as well
  vigil attack learn -o runs/try --generations 3 --pairs 2 --flights 2

What it learned is flown by `vigil attack defended --attack learned --learned FILE`; on fresh seeds, for it has learned on the
courses from --seed on.")]
pub struct LearnArgs {
    /// Generations, each on courses of its own.
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    generations: u32,

    /// Pairs of adversaries tried in a generation, the same change of weights once added and once taken away.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pairs: u32,

    /// Flights of each adversary tried, on the same courses for all of a generation.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    flights: u32,

    /// Seed of the first validation course; what is drawn follows from it too.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

    /// ε in 1/255 of the image's range.
    #[arg(long, default_value_t = AttackConfig::PAPER.epsilon_255)]
    epsilon: f32,

    /// Iterations: a range is moved by ε times as many at the most.
    #[arg(long, default_value_t = AttackConfig::PAPER.iterations)]
    iterations: u32,

    /// So many small sensors of 45° each, side by side, defend as well (docs/second-sensor.md).
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=5))]
    second_sensor_heads: u8,

    /// The detector that judges the actor [default: the one built in].
    #[arg(long, value_name = "FILE")]
    detector: Option<PathBuf>,

    /// Begin with this adversary instead of one that shows everything farther away.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,

    #[command(flatten)]
    common: Common,
}

/// A generation: a line of `learning.csv`.
#[derive(Serialize)]
struct Generation {
    generation: u32,
    /// Flights until then, all generations together.
    flights: u64,
    /// Mean over all that was tried: 1 is a collision.
    score: f64,
    /// Shares of the generation's flights.
    collided: f64,
    out_of_bounds: f64,
    arrived: f64,
}

#[derive(Serialize)]
struct Report<'a> {
    version: &'static str,
    actor_sha256: String,
    first_seed: u64,
    /// Ctrl-C came: generations are missing.
    interrupted: bool,
    /// Flights that it asked for.
    queries: u64,
    second_sensor_heads: u8,
    attack: AttackConfig,
    pairs: u32,
    flights_each: u32,
    generations: &'a [Generation],
}

/// How one flight ended.
struct Ended {
    outcome: Option<Outcome>,
    closest_obstacle_m: f32,
}

impl Ended {
    /// What the adversary is after: a collision, or at least a vehicle that is lost, does not arrive, or passes something closely.
    fn score(&self) -> f64 {
        let near_miss = (-(self.closest_obstacle_m - TOUCHING_M).max(0.0) / NEAR_MISS_M).exp();
        match self.outcome {
            Some(Outcome::Collision) => 1.0,
            Some(Outcome::OutOfBounds) => 0.6,
            Some(Outcome::Success | Outcome::TimeOut) => 0.4 * f64::from(near_miss),
            None => 0.0,
        }
    }
}

/// Learns an adversary, and writes it after each generation.
///
/// # Errors
/// A file that is no actor or no adversary, a folder that cannot be written.
pub fn run(args: &LearnArgs) -> Result<ExitCode> {
    let folder = args.common.folder()?;
    let (pool, interrupt) = (args.common.pool()?, Interrupt::on_ctrl_c()?);
    let victim = args.common.pilot()?;
    let begin = match &args.from {
        Some(file) => LearnedAdversary::load(file)?,
        None => LearnedAdversary::receding(),
    };
    let mut weights = begin.weights().to_vec();
    let attack = Attack {
        config: AttackConfig {
            method: Method::Learned,
            epsilon_255: args.epsilon,
            iterations: args.iterations,
            ..AttackConfig::PAPER
        },
        burst: Burst::Continuous,
        evade: None,
        evades_guard_m: None,
        learned: None,
        pilot: victim,
    };
    // A wrong ε is told before the work.
    attack_by(&attack, &weights)?.interceptor(0, vigil_types::NedVector::ZERO)?;
    let each = 2 * u64::from(args.pairs) * u64::from(args.flights);
    let bar = Progress::new(u64::from(args.generations) * each, "flights")?;
    let file = folder.join("adversary.json");
    let mut rng = ChaCha8Rng::seed_from_u64(args.seed);
    let mut generations: Vec<Generation> = Vec::new();
    for generation in 0..args.generations {
        let changes: Vec<Vec<f32>> = (0..args.pairs).map(|_| normal(&mut rng, weights.len())).collect();
        let first_seed = args.seed.wrapping_add(u64::from(generation * args.flights));
        let tried = changes.iter().flat_map(|change| [(change, SPREAD), (change, -SPREAD)]);
        let units: Vec<(Vec<f32>, u64)> = tried
            .flat_map(|(change, by)| {
                let tried: Vec<f32> = weights.iter().zip(change).map(|(w, c)| w + by * c).collect();
                (0..u64::from(args.flights)).map(move |i| (tried.clone(), first_seed.wrapping_add(i)))
            })
            .collect();
        let ended: Vec<Ended> = pool.install(|| {
            units
                .into_par_iter()
                .filter(|_| !interrupt.came())
                .map(|(weights, seed)| {
                    let ended = fly(args, &attack_by(&attack, &weights)?, seed)?;
                    bar.inc(1);
                    Ok(ended)
                })
                .collect::<Result<_>>()
        })?;
        if interrupt.came() {
            break;
        }
        let scores: Vec<f64> = ended
            .chunks_exact(args.flights as usize)
            .map(|flights| flights.iter().map(Ended::score).sum::<f64>() / flights.len() as f64)
            .collect();
        let share = f64::from(generation) / f64::from(args.generations.max(2) - 1);
        let step = FIRST_STEP + (LAST_STEP - FIRST_STEP) * share as f32;
        evolve(&mut weights, &changes, &scores, step);
        let of = |outcome| ended.iter().filter(|e| e.outcome == Some(outcome)).count() as f64 / ended.len() as f64;
        let line = Generation {
            generation: generation + 1,
            flights: u64::from(generation + 1) * each,
            score: scores.iter().sum::<f64>() / scores.len() as f64,
            collided: of(Outcome::Collision),
            out_of_bounds: of(Outcome::OutOfBounds),
            arrived: of(Outcome::Success),
        };
        bar.set_message(format!("{:.0} % collide", 100.0 * line.collided));
        generations.push(line);
        let report = report(args, &attack, &generations, false);
        LearnedAdversary::new(weights.clone())?.save(&file, report)?;
    }
    bar.finish();
    let last = generations
        .last()
        .context("interrupted before the first generation ended")?;
    say!(
        "{} generations, {} flights; of the last one's {} % collided, {} % left the bounds, {} % arrived",
        generations.len(),
        last.flights,
        (100.0 * last.collided).round(),
        (100.0 * last.out_of_bounds).round(),
        (100.0 * last.arrived).round()
    );
    say!("adversary {}", file.display());
    output::write(&folder.join("learning.csv"), to_csv(&generations))?;
    output::write(&folder.join("learning.svg"), figure(&generations).svg())?;
    write_json(
        &folder.join("learning.json"),
        &report(args, &attack, &generations, interrupt.came()),
    )?;
    Ok(interrupt.exit_code())
}

fn report<'a>(args: &LearnArgs, attack: &Attack, generations: &'a [Generation], interrupted: bool) -> Report<'a> {
    Report {
        version: env!("CARGO_PKG_VERSION"),
        actor_sha256: attack.pilot.sha256(),
        first_seed: args.seed,
        interrupted,
        queries: generations.last().map_or(0, |g| g.flights),
        second_sensor_heads: args.second_sensor_heads,
        attack: attack.config,
        pairs: args.pairs,
        flights_each: args.flights,
        generations,
    }
}

fn attack_by(attack: &Attack, weights: &[f32]) -> Result<Attack> {
    Ok(Attack {
        learned: Some(LearnedAdversary::new(weights.to_vec())?),
        ..attack.clone()
    })
}

/// One flight against everything that defends.
fn fly(args: &LearnArgs, attack: &Attack, seed: u64) -> Result<Ended> {
    let (mut config, mut firmware) = campaign::actor_flight(args.common.actor.as_deref(), false, seed);
    firmware.detector.enabled = Some(true);
    firmware.detector.alarm = AlarmPolicy::Recover;
    firmware.detector.file.clone_from(&args.detector);
    config.second_sensor_heads = args.second_sensor_heads.into();
    firmware.second_sensor = args.second_sensor_heads > 0;
    let record = campaign::fly(&config, &firmware, Some(attack))?.record;
    Ok(Ended {
        outcome: record.outcome,
        closest_obstacle_m: record.closest_obstacle_m,
    })
}

/// One step of the strategy: each pair's change counts by the difference of its two ranks; the sum is scaled to a root mean square of `step`.
fn evolve(weights: &mut [f32], changes: &[Vec<f32>], scores: &[f64], step: f32) {
    let rank = |score: f64| {
        let below = scores.iter().filter(|s| **s < score).count();
        let same = scores.iter().filter(|s| **s == score).count();
        below as f32 + 0.5 * (same as f32 - 1.0)
    };
    let mut direction = vec![0.0_f32; weights.len()];
    for (change, pair) in changes.iter().zip(scores.chunks_exact(2)) {
        let better = rank(pair[0]) - rank(pair[1]);
        for (d, c) in direction.iter_mut().zip(change) {
            *d += better * c;
        }
    }
    let rms = (direction.iter().map(|d| d * d).sum::<f32>() / direction.len().max(1) as f32).sqrt();
    if rms > 0.0 {
        for (w, d) in weights.iter_mut().zip(&direction) {
            *w += step * d / rms;
        }
    }
}

/// Normally distributed numbers (Box and Muller, 1958).
fn normal(rng: &mut ChaCha8Rng, count: usize) -> Vec<f32> {
    let mut numbers = Vec::with_capacity(count + 1);
    while numbers.len() < count {
        let (u, v): (f32, f32) = (1.0 - rng.random::<f32>(), rng.random());
        let (radius, angle) = ((-2.0 * u.ln()).sqrt(), std::f32::consts::TAU * v);
        numbers.extend([radius * angle.cos(), radius * angle.sin()]);
    }
    numbers.truncate(count);
    numbers
}

fn figure(generations: &[Generation]) -> Figure {
    let points = |of: fn(&Generation) -> f64| generations.iter().map(|g| (g.flights as f64, of(g))).collect();
    let mut panel = Panel::new(
        "What the adversaries that were tried came to",
        "share of flights",
        [
            ("collided", points(|g| g.collided)),
            ("out of bounds", points(|g| g.out_of_bounds)),
            ("arrived", points(|g| g.arrived)),
        ],
    );
    panel.top = Some(1.0);
    let last = generations.last().map_or(0, |g| g.flights);
    Figure::over("flights asked for", last as f64, vec![panel])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evolution_climbs_a_hill_that_it_sees_by_its_heights_alone() {
        let top: Vec<f32> = (0..20).map(|i| (i as f32 * 0.7).sin()).collect();
        let height = |w: &[f32]| {
            -w.iter()
                .zip(&top)
                .map(|(w, t)| f64::from((w - t) * (w - t)))
                .sum::<f64>()
        };
        let (mut weights, mut rng) = (vec![0.0; 20], ChaCha8Rng::seed_from_u64(1));
        let before = height(&weights);
        for _ in 0..60 {
            let changes: Vec<_> = (0..8).map(|_| normal(&mut rng, 20)).collect();
            let scores: Vec<f64> = changes
                .iter()
                .flat_map(|c| {
                    [0.25, -0.25].map(|by| height(&weights.iter().zip(c).map(|(w, c)| w + by * c).collect::<Vec<_>>()))
                })
                .collect();
            evolve(&mut weights, &changes, &scores, 0.05);
        }
        assert!(height(&weights) > 0.2 * before, "{} from {before}", height(&weights));
    }

    #[test]
    fn scores_that_are_all_the_same_change_nothing() {
        let mut weights = vec![0.5; 4];
        evolve(&mut weights, &[vec![1.0, -1.0, 2.0, 0.0]], &[0.4, 0.4], 0.1);
        assert_eq!(weights, [0.5; 4]);
    }

    #[test]
    fn a_collision_is_worth_more_than_any_vehicle_that_is_lost_otherwise_and_a_near_miss_more_than_a_wide_one() {
        let score = |outcome, closest_obstacle_m| {
            Ended {
                outcome,
                closest_obstacle_m,
            }
            .score()
        };
        let collision = score(Some(Outcome::Collision), 0.3);
        let lost = score(Some(Outcome::OutOfBounds), 3.0);
        let near = score(Some(Outcome::Success), 0.35);
        let wide = score(Some(Outcome::Success), 1.2);
        assert!(collision > lost && lost > near && near > wide && wide > score(None, 9.0));
    }

    #[test]
    fn what_is_drawn_is_normally_distributed() {
        let numbers = normal(&mut ChaCha8Rng::seed_from_u64(3), 10_001);
        assert_eq!(numbers.len(), 10_001);
        let mean = numbers.iter().sum::<f32>() / 10_001.0;
        let variance = numbers.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / 10_001.0;
        let within = numbers.iter().filter(|x| x.abs() < 1.0).count() as f32 / 10_001.0;
        assert!(mean.abs() < 0.04 && (variance - 1.0).abs() < 0.06 && (within - 0.683).abs() < 0.02);
    }
}
