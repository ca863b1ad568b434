//! Flights of the whole stack for Python.

use crate::attack::method_named;
use crate::given::{failed, refused};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::path::PathBuf;
use vigil_adversary::{Attack, AttackArgs};
use vigil_firmware::FirmwareConfig;
use vigil_sim::world::{Family, generate};
use vigil_sim::{SimConfig, Start};
use vigil_tools::threads::thread_pool;
use vigil_types::PilotKind;

/// Seed, outcome, seconds, metres flown, closest goal, altered frames, step of the first alarm.
type FlightRow = (u64, &'static str, f64, f64, f32, u64, Option<u64>);

/// A flight in wind of so many metres per second, with so much noise, from the ground or not.
fn flown(
    (family, seed): (Family, u64),
    (wind_m_s, noise, ground): (f64, f32, bool),
    common: &FirmwareConfig,
    attack: Option<&Attack>,
) -> Result<FlightRow, String> {
    let mut config = SimConfig::new(generate(family, seed), seed);
    config.lidar.range_noise_sigma_m *= noise;
    config.lidar.dropout_probability = (config.lidar.dropout_probability * noise).min(1.0);
    if wind_m_s > 0.0 {
        config.wind = vigil_tools::campaign::wind(wind_m_s, seed);
    }
    config.start = match ground {
        true => Start::Ground,
        false => Start::Airborne,
    };
    let goal = config.course.goal_ned_m();
    let mut firmware = FirmwareConfig::to_goal(goal);
    firmware.pilot = common.pilot.clone();
    firmware.detector = common.detector.clone();
    let flight = vigil_tools::fly(&config, &firmware, attack).map_err(|e| format!("{e:#}"))?;
    let record = flight.record;
    Ok((
        seed,
        vigil_tools::campaign::outcome_name(record.outcome),
        record.flight_time_s,
        record.path_length_m,
        record.closest_goal_m,
        flight.attack.map_or(0, |attack| attack.attacked_steps),
        flight.watch.and_then(|watch| watch.first_alarm_step),
    ))
}

/// Flies generated courses with the whole stack, some after the other on each thread; Ctrl-C ends it between flights.
#[pyfunction]
#[pyo3(signature = (*, family, seeds, threads, pilot, actor, apf, detector, detector_file, guard, wind, noise, ground, attack, epsilon, iterations, burst))]
#[allow(clippy::too_many_arguments, reason = "the Python side names them")]
pub fn fly(
    py: Python<'_>,
    family: &str,
    seeds: Vec<u64>,
    threads: usize,
    pilot: &str,
    actor: Option<PathBuf>,
    apf: bool,
    detector: Option<bool>,
    detector_file: Option<PathBuf>,
    guard: Option<bool>,
    wind: f64,
    noise: f32,
    ground: bool,
    attack: Option<&str>,
    epsilon: f32,
    iterations: u32,
    burst: &str,
) -> PyResult<Vec<FlightRow>> {
    if !(0.0..=20.0).contains(&wind) || !(0.0..=100.0).contains(&noise) {
        return Err(refused("wind: 0 to 20 m/s; noise: a factor from 0 to 100"));
    }
    let mut firmware = FirmwareConfig::default();
    firmware.pilot.kind = match pilot {
        "actor" => PilotKind::Actor,
        "geometric" => PilotKind::Geometric,
        other => return Err(refused(format!("pilot: actor or geometric, got {other}"))),
    };
    (firmware.pilot.actor_file, firmware.pilot.apf) = (actor.clone(), apf);
    (firmware.detector.enabled, firmware.detector.guard) = (detector, guard);
    firmware.detector.file = detector_file;
    let method = attack.map(|name| method_named("attack", name));
    let attack = AttackArgs {
        attack: method.transpose()?,
        epsilon,
        iterations,
        burst: burst.parse().map_err(refused)?,
        ..AttackArgs::default()
    };
    let family: Family = family.parse().map_err(refused)?;
    let attack = attack.attack(actor.as_deref()).map_err(refused)?;
    let threads = threads.max(1);
    let pool = thread_pool(threads).map_err(failed)?;
    let mut rows = Vec::with_capacity(seeds.len());
    for some in seeds.chunks(4 * threads) {
        let fly = |seed: &u64| flown((family, *seed), (wind, noise, ground), &firmware, attack.as_ref());
        let all: Result<Vec<FlightRow>, String> = py.detach(|| pool.install(|| some.par_iter().map(fly).collect()));
        rows.append(&mut all.map_err(refused)?);
        py.check_signals()?;
    }
    Ok(rows)
}
