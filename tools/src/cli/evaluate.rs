//! `vigil evaluate`: many seeded flights in lockstep over all cores.

mod report;
mod shown;

use crate::campaign::flights::{Campaign, Existing, Jobs, difference, sha256};
use crate::campaign::{self, FaultChoice, Flight, Recording, outcome_name, spread};
use crate::cli::fly::SecondSensorArgs;
use crate::cli::output::{self, tell};
use crate::cli::view::ViewerArgs;
use crate::flight_report;
use crate::threads::thread_pool_of;
use anyhow::{Context, Result, ensure};
use report::{NO_FAULT, report};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;
use shown::Shown;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use vigil_adversary::{Attack, AttackArgs, AttackConfig, Burst};
use vigil_detector::FrozenDetector;
use vigil_firmware::arguments::PilotArgs;
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_sim::world::{Family, FlightPath, LONG_GOAL_M, generate, generate_long};
use vigil_sim::{LIDAR_SENSOR_ID, Models, SensorFault, SimConfig, Simulator, Start, VehicleChoice, family_parser};
use vigil_types::{FrameKey, NedVector};

/// Beyond it the report would not fit the memory.
const MOST_FLIGHTS: u64 = 10_000_000;

/// More logs than this fill most disks.
const MOST_LOGS: u64 = 100;
/// More flights than this are not seen beside each other.
const MOST_SHOWN: u64 = 16;

/// Arguments of `vigil evaluate`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil evaluate --flights 500 --seed 1000000           500 validation courses, seeds 1000000 to 1000499
  vigil evaluate --flights 200 --wind 4                 the same in a mean wind of 4 m/s
  vigil evaluate --flights 200 --noise 2                LiDAR range noise and dropouts doubled
  vigil evaluate --flights 200 --family hard            narrow doors, dead ends, moving obstacles; or dense, forest
  vigil evaluate --flights 200 --goal-distance 30..300  goals 30 to 300 m away, as dense all the way
  vigil evaluate --flights 200 --vehicle-model px4-sih --noisy-estimate
                                                        a vehicle that answers as PX4's own simulated one does
  vigil evaluate --flights 200 --pilot geometric        the geometric pilot
  vigil evaluate --flights 200 --apf off --detector off the frozen actor alone
  vigil evaluate --apf off --attack bim-accumulating --burst 50
                                                        frames altered for 50 steps of each flight
  vigil evaluate --flights 200 --sensor-fault frozen@random
                                                        the LiDAR shows the same image from a random moment on
  vigil evaluate --flights 20 --sensor-fault all        a table of all faults of the LiDAR
  vigil evaluate --flights 100 --draw-failures runs/f   a picture of every flight that failed
  vigil evaluate --flights 3 --logs runs/logs           each flight's log and its report
  vigil evaluate --flights 20 --view 4                  the first four in the Rerun viewer, while they fly
  vigil evaluate --flights 9000 -o runs/big.json --resume
                                                        go on after an interruption, flying what is missing

Three of four flights begin hovering at the start, the others, whose seeds divide by --ground-every, on the ground: they
arm and take off first. Each ends as success, collision, out of bounds or time-out (docs/courses.md).
The same seeds give the same flights, bit for bit, and the same JSON, byte for byte, on any number of threads or machines:
other machines fly other seeds, and `vigil merge` makes one report of all (docs/cluster.md).

Each flight is a line beside the JSON, NAME.jsonl, as soon as it has ended. Ctrl-C ends the campaign with the flights that had
begun: the report then says how many were asked for, and that it was interrupted.
Exit code: 0 all flights were flown (however they ended), 1 error, 130 interrupted.")]
pub struct EvaluateArgs {
    /// Number of flights; flight i uses seed SEED + i.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=MOST_FLIGHTS))]
    flights: u64,

    /// First seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Family of generated courses.
    #[arg(long, value_parser = family_parser(), default_value_t = Family::Validation)]
    family: Family,

    /// Threads; all cores when absent.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    /// Simulation file (TOML) that changes LiDAR, vehicle, sensors or wind.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    #[command(flatten)]
    vehicle: VehicleChoice,

    /// Mean wind in m/s from a direction drawn per flight, with gusts.
    #[arg(long, value_name = "M_S", default_value_t = 0.0)]
    wind: f64,

    /// Multiplies the LiDAR's range noise and dropouts.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    noise: f32,

    /// Take the moving obstacles out of the courses: what do they cost?
    #[arg(long)]
    still: bool,

    /// Courses to goals this far north, metres (5 to 400), of the family's density all the way; a range spreads its flights
    /// evenly over it. Not for the hard family.
    #[arg(long, value_name = "M|FROM..TO", value_parser = GoalDistance::parse)]
    goal_distance: Option<GoalDistance>,

    /// Flights whose seed divides by this begin on the ground, disarmed, all others in the air; 0: none, 1: all.
    #[arg(long, value_name = "N", default_value_t = 4)]
    ground_every: u64,

    #[command(flatten)]
    pilot: PilotArgs,

    #[command(flatten)]
    attack: AttackArgs,

    /// Let the LiDAR fail, from the start, from a moment on, or from one drawn from each flight's seed; `all` flies every
    /// fault in turn (docs/sensor-faults.md). Such a flight is over after 45 s.
    #[arg(long, value_name = "MODE[@SECONDS|@random]", value_parser = FaultChoice::parse)]
    sensor_fault: Option<FaultChoice>,

    #[command(flatten)]
    second_sensor: SecondSensorArgs,

    /// The LiDAR's driver authenticates its frames, and the firmware refuses others; the attacker does not have the key
    /// (docs/frame-authentication.md).
    #[arg(long)]
    authenticate_frames: bool,

    /// Where the JSON goes; `-` is standard output, the table then goes to standard error.
    #[arg(short = 'o', long, value_name = "FILE", default_value = "runs/evaluate.json")]
    json: PathBuf,

    /// Keep the flights in NAME.jsonl beside the JSON, and fly only what it does not have yet.
    #[arg(long)]
    resume: bool,

    /// Draw the course and path of every flight that failed into this folder.
    #[arg(long, value_name = "DIR")]
    draw_failures: Option<PathBuf>,

    /// Keep the log of every flight in this folder, SEED.mcap, with its report beside it: about 100 MB for a minute of flight.
    #[arg(long, value_name = "DIR")]
    logs: Option<PathBuf>,

    /// Show the first N flights in one Rerun viewer while they fly: side by side, and each in a tab with all of its plots
    /// (docs/view.md). Their logs are kept, in the folder of --logs or in one of their own beside the JSON.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_SHOWN))]
    view: Option<u64>,

    #[command(flatten)]
    viewer: ViewerArgs,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct AttackReport {
    #[serde(flatten)]
    config: AttackConfig,
    burst: Burst,
    /// Whether it deceives a detector as well.
    adaptive: bool,
    /// Whether it stays within what the guard lets pass.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    evades_guard: bool,
}

/// Everything that decides what the flights are, wherever they are flown: files by their content.
#[derive(Serialize, Deserialize)]
struct Settings {
    family: Family,
    /// Where it is not the default one.
    #[serde(skip_serializing_if = "Option::is_none")]
    vehicle_model: Option<String>,
    wind_m_s: f64,
    noise_factor: f32,
    still: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    goal_distance: Option<GoalDistance>,
    ground_every: u64,
    second_sensor_heads: u8,
    authenticated_frames: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensor_fault: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    simulation_sha256: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    actor_sha256: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    detector_sha256: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    attack: Option<AttackReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    attacked_actor_sha256: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    evaded_detector_sha256: Option<String>,
    /// The configuration of the firmware without its files.
    #[serde(deserialize_with = "as_written")]
    firmware: Value,
}

impl Settings {
    /// What the arguments ask for.
    fn of(args: &EvaluateArgs, attack: Option<&Attack>) -> Result<Self> {
        // A new argument has to be thought of here: does it decide what a flight is?
        let EvaluateArgs {
            flights: _,
            seed: _,
            family,
            threads: _,
            config,
            vehicle,
            wind,
            noise,
            still,
            goal_distance,
            ground_every,
            pilot,
            attack: _,
            sensor_fault,
            second_sensor,
            authenticate_frames,
            json: _,
            resume: _,
            draw_failures: _,
            logs: _,
            view: _,
            viewer: _,
        } = args;
        let mut firmware = FirmwareConfig::to_goal(NedVector::default());
        pilot.apply(&mut firmware);
        let (actor, detector) = (firmware.frozen_pilot()?, firmware.frozen_detector()?);
        if let Some(note) = actor.as_ref().and_then(|pilot| firmware.slowed(pilot)) {
            tracing::warn!("the actor: {note}");
        }
        (firmware.pilot.actor_file, firmware.detector.file) = (None, None);
        let attacked = attack.map(|attack| attack.pilot.sha256());
        let simulation = config.as_ref().map(|file| {
            vigil_types::files::read(file, 1 << 20).with_context(|| format!("cannot read {}", file.display()))
        });
        Ok(Self {
            family: *family,
            vehicle_model: vehicle.name(),
            wind_m_s: *wind,
            noise_factor: *noise,
            still: *still,
            goal_distance: *goal_distance,
            ground_every: *ground_every,
            second_sensor_heads: second_sensor.heads,
            authenticated_frames: *authenticate_frames,
            sensor_fault: sensor_fault.as_ref().map(|choice| choice.name.clone()),
            simulation_sha256: simulation.transpose()?.map(|text| sha256(&text)),
            actor_sha256: actor.map(|actor| actor.sha256()),
            detector_sha256: detector.as_ref().map(FrozenDetector::sha256),
            attack: attack.map(|attack| AttackReport {
                config: attack.config,
                burst: attack.burst,
                adaptive: attack.evade.is_some(),
                evades_guard: attack.evades_guard,
            }),
            attacked_actor_sha256: attacked,
            evaded_detector_sha256: attack.and_then(|a| a.evade.as_ref()).map(FrozenDetector::sha256),
            firmware: toml::from_str(&firmware.to_toml())?,
        })
    }
}

/// The firmware's configuration as this program writes it: another writer drops `.0`, and lines name their heading by its text.
fn as_written<'de, D: Deserializer<'de>>(from: D) -> Result<Value, D::Error> {
    let found = Value::deserialize(from)?;
    let again = |mut known: Value| {
        // The height is each flight's own; none, as it stands here, is refused.
        let height = std::mem::replace(known.get_mut("height_m")?, 1.0.into());
        let config = FirmwareConfig::from_toml(&toml::to_string(&known).ok()?).ok()?;
        let mut again: Value = toml::from_str(&config.to_toml()).ok()?;
        *again.get_mut("height_m")? = height;
        Some(again).filter(|again| difference(again, &found, "").is_none())
    };
    Ok(again(found.clone()).unwrap_or(found))
}

/// How far away the goals are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct GoalDistance {
    from_m: f32,
    to_m: f32,
}

impl GoalDistance {
    fn parse(text: &str) -> Result<Self, String> {
        let (from, to) = text.split_once("..").unwrap_or((text, text));
        let length = |text: &str| match text.trim().parse::<f32>() {
            Ok(length_m) if LONG_GOAL_M.contains(&length_m) => Ok(length_m),
            _ => Err(format!(
                "a distance is a number from {} to {} metres, a range two of them: 150 or 30..300",
                LONG_GOAL_M.start(),
                LONG_GOAL_M.end()
            )),
        };
        let (from_m, to_m) = (length(from)?, length(to)?);
        if from_m > to_m {
            return Err(format!("the range {text} is empty: the nearer distance comes first"));
        }
        Ok(Self { from_m, to_m })
    }

    /// The distance of a flight.
    fn of(self, seed: u64) -> f32 {
        self.from_m + (self.to_m - self.from_m) * spread(seed) as f32
    }
}

/// Longest flight with a fault of the sensor, seconds: one that is held stays where it is.
const FAULT_TIME_LIMIT_S: f32 = 45.0;

/// Makes the folders, before a flight is flown for nothing.
fn prepare(args: &EvaluateArgs, faults: &[Option<SensorFault>]) -> Result<()> {
    if args.view.is_some() {
        args.viewer.check_with_port()?;
    }
    ensure!(
        !args.resume || output::is_file(&args.json),
        "--resume goes on from the flights beside a report in a file: name one with -o"
    );
    output::prepare(&args.json)?;
    if let Some(folder) = &args.logs {
        ensure!(
            args.flights.saturating_mul(faults.len() as u64) <= MOST_LOGS,
            "--logs keeps at most {MOST_LOGS} flights: their logs have some 100 MB each; fewer --flights, please"
        );
        // Before flights of an earlier campaign are replaced.
        let names = faults
            .iter()
            .flat_map(|fault| (0..args.flights).map(|i| log_name(args, *fault, args.seed.saturating_add(i))));
        for log in names.map(|name| folder.join(name + ".mcap")) {
            ensure!(
                args.resume || !log.exists(),
                "{} is there and is kept: name another folder with --logs",
                log.display()
            );
        }
    }
    for folder in args.draw_failures.iter().chain(&args.logs) {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    Ok(())
}

/// Where the flights go, a line each.
fn lines_beside(args: &EvaluateArgs) -> Result<PathBuf> {
    let lines = args.json.with_extension("jsonl");
    ensure!(
        lines != args.json,
        "-o names the JSON report, and the flights go beside it to {}: give it another ending",
        lines.display()
    );
    Ok(match output::is_file(&args.json) {
        true => lines,
        false => args.json.clone(),
    })
}

/// Flies the campaign, prints the table and writes the JSON.
///
/// # Errors
/// A bad configuration, or a folder that cannot be written.
pub fn run(args: &EvaluateArgs) -> Result<ExitCode> {
    let (wind, noise) = (args.wind, args.noise);
    ensure!(
        (0.0..=20.0).contains(&wind),
        "--wind must be between 0 and 20 m/s, got {wind}"
    );
    ensure!(
        (0.0..=100.0).contains(&noise),
        "--noise must be between 0 and 100, got {noise}"
    );
    let flying = Flying {
        args,
        models: args.vehicle.models(args.config.as_deref())?,
        attack: args.attack.attack(args.pilot.actor_file())?,
    };
    let chosen = args.sensor_fault.iter().flat_map(|choice| &choice.faults);
    let mut faults: Vec<Option<SensorFault>> = chosen.copied().map(Some).collect();
    if faults.is_empty() {
        faults.push(None);
    }
    prepare(args, &faults)?;
    let name = |fault: &Option<SensorFault>| fault.map_or_else(|| NO_FAULT.to_owned(), |fault| fault.to_string());
    let jobs = Jobs {
        first_seed: args.seed,
        flights: args.flights,
        arms: faults.iter().map(name).collect(),
    };
    let settings = Settings::of(args, flying.attack.as_ref())?;
    let pool = thread_pool_of(args.threads)?;
    pool.install(|| flying.check_first(faults[0]))?;
    let mut campaign = Campaign::new(COMMAND, settings, jobs)?
        .keep_in(&lines_beside(args)?, Existing::replaced_unless(args.resume))?;
    if campaign.flights().next().is_some() && (args.logs.is_some() || args.draw_failures.is_some()) {
        tell!(
            "vigil: flights that are there already are not flown again: --logs and --draw-failures have the others only"
        );
    }
    let mut shown = args.view.map(|count| Shown::begin(args, count, &faults)).transpose()?;
    let live = shown.as_ref().map(|shown| (shown.count, shown.folder.clone()));
    let (begun, before_s) = (Instant::now(), report::simulated_s(&campaign));
    let interrupt = campaign.fly(&pool, |seed, arm, bar| {
        let number = (seed - args.seed) * faults.len() as u64 + arm as u64;
        let of_shown = live.as_ref().filter(|(count, _)| number < *count);
        let logs = args.logs.as_deref().or(of_shown.map(|(_, folder)| folder.as_path()));
        let flight = flying.fly(faults[arm], seed, logs)?;
        if !flight.record.is_success() {
            let how = outcome_name(flight.record.outcome);
            bar.set_message(format!("last failure: seed {seed} ({how})"));
        }
        Ok(flight)
    })?;
    let took = (begun.elapsed().as_secs_f64(), pool.current_num_threads(), before_s);
    report(&campaign, &args.json, Some(took))?;
    if let Some(shown) = &mut shown {
        shown.end(&interrupt)?;
    }
    Ok(interrupt.exit_code())
}

/// What lines of it call this command.
pub const COMMAND: &str = "evaluate";

/// Makes one report of the flights in several files.
///
/// # Errors
/// Flights that contradict each other or are not all; a file that cannot be written.
pub fn merge(files: &[PathBuf], json: &Path) -> Result<ExitCode> {
    let campaign = Campaign::load(files, json)?;
    report(&campaign, json, None)?;
    Ok(ExitCode::SUCCESS)
}

/// What all flights have in common.
struct Flying<'a> {
    args: &'a EvaluateArgs,
    models: Models,
    attack: Option<Attack>,
}

impl Flying<'_> {
    /// Makes what the first flight is flown with: what refuses it does so before earlier flights are replaced.
    fn check_first(&self, fault: Option<SensorFault>) -> Result<()> {
        let (config, firmware) = self.configured(fault, self.args.seed)?;
        Simulator::new(&config, 0)?;
        LockstepFirmware::new(&firmware)?;
        if let Some(attack) = &self.attack {
            attack.interceptor(config.seed, config.course.goal_ned_m())?;
        }
        Ok(())
    }

    /// What a flight is flown with.
    fn configured(&self, fault: Option<SensorFault>, seed: u64) -> Result<(SimConfig, FirmwareConfig)> {
        let args = self.args;
        let mut course = match args.goal_distance {
            None => generate(args.family, seed),
            Some(distance) => generate_long(args.family, seed, distance.of(seed)).with_context(|| {
                format!(
                    "--goal-distance: courses of the family {} cannot be made longer",
                    args.family
                )
            })?,
        };
        if args.still {
            course.movers.clear();
        }
        let mut models = self.models.clone();
        models.lidar.range_noise_sigma_m *= args.noise;
        models.lidar.dropout_probability = (models.lidar.dropout_probability * args.noise).min(1.0);
        if args.wind > 0.0 {
            models.wind = campaign::wind(args.wind, seed);
        }
        let mut config = SimConfig::with_models(course, seed, models);
        let from_ground = args.ground_every > 0 && seed.is_multiple_of(args.ground_every);
        config.start = if from_ground { Start::Ground } else { Start::Airborne };
        if let Some(fault) = fault {
            config.sensor_fault = Some(fault);
            config.course.time_limit_s = config.course.time_limit_s.min(FAULT_TIME_LIMIT_S);
        }
        if args.authenticate_frames {
            // Both sides of the flight run in this process: any secret does.
            config.frame_key = Some(FrameKey::new(&[0x5A; 32], LIDAR_SENSOR_ID, b"campaign"));
        }
        let mut firmware = FirmwareConfig::to_goal(config.course.goal_ned_m());
        config.second_sensor_heads = args.second_sensor.heads.into();
        firmware.second_sensor = args.second_sensor.heads > 0;
        args.pilot.apply(&mut firmware);
        Ok((config, firmware))
    }

    fn fly(&self, fault: Option<SensorFault>, seed: u64, logs: Option<&Path>) -> Result<Flight> {
        let (args, (config, firmware)) = (self.args, self.configured(fault, seed)?);
        let recording = logs.map(|folder| recording(args, folder, fault, seed)).transpose()?;
        let flight = campaign::fly_recorded(&config, &firmware, self.attack.as_ref(), recording)?;
        if let Some(folder) = args.draw_failures.as_ref().filter(|_| !flight.record.is_success()) {
            let outcome = outcome_name(flight.record.outcome).replace(' ', "-");
            let file = format!("{}-{outcome}.png", log_name(args, fault, seed));
            let flown = FlightPath {
                label: outcome_name(flight.record.outcome).to_owned(),
                points_ned_m: flight.record.path_ned_m.clone(),
                outcome: flight.record.outcome,
            };
            vigil_sim::world::draw(&config.course, &[flown]).write_png(&folder.join(file))?;
        }
        Ok(flight)
    }
}

/// The name of a flight's log, without its ending.
fn log_name(args: &EvaluateArgs, fault: Option<SensorFault>, seed: u64) -> String {
    let choice = args.sensor_fault.as_ref();
    match fault.filter(|_| choice.is_some_and(|choice| choice.faults.len() > 1)) {
        Some(fault) => format!("{seed}-{}", fault.to_string().replace('@', "-at-")),
        None => seed.to_string(),
    }
}

/// Arguments that the command for a single flight does not have, or has of its own.
const REPLACED: &str = "--flights --seed --logs --threads -o --json --draw-failures --view --view-port --python";

/// What to keep of a flight.
fn recording(args: &EvaluateArgs, folder: &Path, fault: Option<SensorFault>, seed: u64) -> Result<Recording> {
    let name = log_name(args, fault, seed);
    let log = folder.join(format!("{name}.mcap"));
    if args.resume && log.exists() {
        // The flight is not among those that ended: it was cut short, or the log is another campaign's.
        Recording::set_aside(folder, &name)?;
    }
    let (seed, fault) = (seed.to_string(), fault.map(|fault| fault.to_string()));
    let mut dropped: Vec<&str> = REPLACED.split(' ').collect();
    let mut added = vec!["--flights", "1", "--seed", &seed];
    if let Some(fault) = &fault {
        dropped.push("--sensor-fault");
        added.extend(["--sensor-fault", fault]);
    }
    let words = std::env::args_os().filter(|word| word != "--resume");
    let command = flight_report::command_again(words, "evaluate", &dropped, &added);
    let about = flight_report::about(command, &args.attack, []);
    Ok(Recording { log, about })
}
