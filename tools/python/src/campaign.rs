//! Flights of the whole stack for Python.

use crate::attack::method_named;
use crate::environment::{noisier, wind};
use crate::given::{failed, refused};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::path::PathBuf;
use vigil_adversary::{Attack, AttackArgs};
use vigil_firmware::FirmwareConfig;
use vigil_firmware::program::in_one_line;
use vigil_policy::FrozenPilot;
use vigil_sim::world::{Family, generate};
use vigil_sim::{SimConfig, Start};
use vigil_tools::threads::thread_pool;
use vigil_types::PilotKind;

/// Seed, outcome, seconds, metres flown, closest goal, altered frames, step of the first alarm.
type FlightRow = (u64, &'static str, f64, f64, f32, u64, Option<u64>);

/// What `vigil.evaluate.completion` is given.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Options {
    family: String,
    pilot: String,
    actor: Option<PathBuf>,
    apf: bool,
    detector: Option<bool>,
    detector_file: Option<PathBuf>,
    guard: Option<bool>,
    wind: f64,
    noise: f32,
    ground: bool,
    attack: Option<String>,
    epsilon: f32,
    iterations: u32,
    burst: String,
}

fn flown(
    (family, seed): (Family, u64),
    options: &Options,
    common: &FirmwareConfig,
    attack: Option<&Attack>,
) -> Result<FlightRow, String> {
    let mut config = SimConfig::new(generate(family, seed), seed);
    noisier(&mut config.lidar, options.noise);
    config.wind = wind(options.wind, seed);
    config.start = match options.ground {
        true => Start::Ground,
        false => Start::Airborne,
    };
    let mut firmware = FirmwareConfig::to_goal(config.course.goal_ned_m());
    firmware.pilot = common.pilot.clone();
    firmware.detector = common.detector.clone();
    let flight = vigil_tools::fly(&config, &firmware, attack).map_err(|e| in_one_line(&e))?;
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

/// Flies generated courses with the whole stack, some after the other on each thread; Ctrl-C ends it after at most four of each.
#[pyfunction]
pub fn fly(py: Python<'_>, seeds: Vec<u64>, threads: usize, options: Options) -> PyResult<Vec<FlightRow>> {
    let mut firmware = FirmwareConfig::default();
    firmware.pilot.kind = match options.pilot.as_str() {
        "actor" => PilotKind::Actor,
        "geometric" => PilotKind::Geometric,
        other => return Err(refused(format!("pilot: actor or geometric, got {other}"))),
    };
    (firmware.pilot.actor_file, firmware.pilot.apf) = (options.actor.clone(), options.apf);
    (firmware.detector.enabled, firmware.detector.guard) = (options.detector, options.guard);
    firmware.detector.file = options.detector_file.clone();
    let of_others = matches!(firmware.frozen_pilot(), Ok(Some(FrozenPilot::Imported(_))));
    if of_others && firmware.has_detector() && firmware.detector.file.is_none() {
        return Err(refused(
            "detector: the built-in one scores the built-in actor, not an imported policy: give detector=FILE, the policy's own, or \
             detector=False, and guard=True to have the recovery pilot warn and take over before a collision",
        ));
    }
    let method = options.attack.as_ref().map(|name| method_named("attack", name));
    let burst = options.burst.parse();
    let attack = AttackArgs {
        attack: method.transpose()?,
        epsilon: options.epsilon,
        iterations: options.iterations,
        burst: burst.map_err(|e| refused(format!("burst: {e}, got {}", options.burst)))?,
        ..AttackArgs::default()
    };
    let family: Family = options.family.parse().map_err(refused)?;
    let attack = attack.attack(options.actor.as_deref()).map_err(refused)?;
    let pool = thread_pool(threads).map_err(failed)?;
    let mut rows = Vec::with_capacity(seeds.len());
    for some in seeds.chunks(4 * threads) {
        let fly = |seed: &u64| flown((family, *seed), &options, &firmware, attack.as_ref());
        let all: Result<Vec<FlightRow>, String> = py.detach(|| pool.install(|| some.par_iter().map(fly).collect()));
        rows.append(&mut all.map_err(refused)?);
        py.check_signals()?;
    }
    Ok(rows)
}
