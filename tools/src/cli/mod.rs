//! The `vigil` command line: everything a person does with Vigil starts here.

mod adapter;
mod bench;
mod collect;
mod courses;
mod detector;
mod doctor;
mod evaluate;
mod export;
mod family;
mod figures;
mod fly;
mod foreign;
mod import;
mod learn;
mod live;
mod log;
mod merge;
pub(crate) mod output;
mod pilot;
mod recover;
mod replay;
mod report;
mod reproduce;
mod rollout;
mod scene;
mod sensor;
mod view;

pub(crate) use log::write_report as write_flight_report;
pub(crate) use scene::of as scene_of;

use crate::attack_campaigns as attack;
use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;

/// Fly a quadcopter through obstacles in simulation, or any PX4 or ArduPilot vehicle.
///
/// Without a command, `vigil` flies one random validation course in real time (`vigil fly`).
#[derive(Parser)]
#[command(name = "vigil", version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,

    /// Log more: -v for what happens, -vv for details. RUST_LOG overrides it.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,

    /// End when the process of this number does, which started this one.
    #[arg(long, global = true, hide = true, value_name = "PID")]
    ends_with: Option<u32>,
}

const EXAMPLES: &str = "\
Examples:
  vigil                                   fly a random validation course in real time
  vigil fly --seed 7 --log runs/          fly validation course 7 and keep the log
  vigil evaluate --flights 200 --seed 1   200 flights, faster than real time, with confidence intervals
  vigil replay runs/flight.mcap           run the tick over recorded inputs and compare every byte
  vigil reproduce --committed             every table and figure from the committed data, in seconds
  vigil courses draw --seed 7 -o 7.png    see a course
  vigil sim                               the simulated vehicle alone, for MAVSDK and pymavlink scripts
  vigil firmware --link udpin://0.0.0.0:14540 --allow-unsigned always
                                          the 20 Hz loop alone, on any vehicle (docs/firmware.md, Signing)";

#[derive(Subcommand)]
enum Command {
    /// Fly one course in real time: starts simulator and firmware, shows progress, ends both.
    Fly(fly::FlyArgs),
    /// Run the simulated vehicle alone.
    Sim(vigil_sim::program::SimArgs),
    /// Run the 20 Hz loop alone (the same as the `firmware` program).
    Firmware(vigil_firmware::program::FirmwareArgs),
    /// Fly many seeded courses in lockstep, faster than real time, and tabulate the outcomes.
    Evaluate(evaluate::EvaluateArgs),
    /// Make one report of flights over several machines' seeds.
    Merge(merge::MergeArgs),
    /// Attack the actor: on states, on scenes, in campaigns of flights.
    Attack(attack::AttackCommands),
    /// Run the adversary alone: alters depth frames between the sensor and the firmware.
    Adversary(vigil_adversary::process::AdversaryArgs),
    /// Run the tick over a flight log's recorded inputs and compare every output byte.
    Replay(replay::ReplayArgs),
    /// Make a report or a film of a flight log, or complete it.
    Log(log::LogArgs),
    /// Open a flight log in the Rerun viewer, in a ready layout.
    View(view::ViewArgs),
    /// Save what is whole of a flight log that was cut off or damaged.
    Recover(recover::RecoverArgs),
    /// Import a policy of others from ONNX.
    Import(import::ImportArgs),
    /// Export an actor or an imported policy to ONNX.
    Export(export::ExportArgs),
    /// Train an expert or an actor by value: critics that see the true state, reward along the shortest free way.
    Learn(learn::LearnArgs),
    /// Every table and figure of the paper and ours, from data or flown anew, on one page.
    Reproduce(reproduce::ReproduceArgs),
    /// Table I and figures 9 and 10 from the logs of training runs of yours.
    Report(report::ReportArgs),
    /// Judge an actor alone, the potential field off and on.
    Rollout(rollout::RolloutArgs),
    /// Gather data for the detector, train it, measure how well it detects.
    Detector(detector::DetectorArgs),
    /// Look at a vehicle and its depth sensor, and say what is missing before Vigil can fly them.
    Doctor(doctor::DoctorArgs),
    /// Check a publisher of depth frames, or be one for a foreign vehicle.
    Sensor(sensor::SensorArgs),
    /// Measure what this machine makes of the loop.
    Bench(bench::BenchArgs),
    /// Draw, write or check courses.
    Courses(courses::CoursesArgs),
}

/// Reads the arguments of the process and does what they say.
pub fn main() -> ExitCode {
    let cli: Cli = vigil_firmware::removed::parse();
    output::start_tracing(cli.verbose);
    if let Some(parent) = cli.ends_with
        && let Err(error) = family::end_with(parent)
    {
        return output::finish(Err(error));
    }
    output::finish(execute(
        cli.command.unwrap_or_else(|| Command::Fly(fly::FlyArgs::default())),
    ))
}

/// Runs a command as it would be typed, the program's name first, within another one.
///
/// # Errors
/// The command's, and words that are none.
fn run_words(words: Vec<OsString>) -> Result<ExitCode> {
    let cli = Cli::try_parse_from(words)?;
    execute(cli.command.context("no command")?)
}

fn execute(command: Command) -> Result<ExitCode> {
    match command {
        Command::Fly(args) => fly::run(&args),
        Command::Sim(args) => vigil_sim::program::run(args),
        Command::Firmware(args) => vigil_firmware::program::run(args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Attack(args) => attack::run(&args),
        Command::Adversary(args) => vigil_adversary::process::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Log(args) => log::run(&args),
        Command::View(args) => view::run(&args),
        Command::Recover(args) => recover::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Learn(args) => learn::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Rollout(args) => rollout::run(&args),
        Command::Detector(args) => detector::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Sensor(args) => sensor::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Courses(args) => courses::run(&args),
        Command::Reproduce(args) => reproduce::run(&args),
    }
}
