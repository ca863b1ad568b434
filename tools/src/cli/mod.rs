//! The `vigil` command line: everything a person does with Vigil starts here. What the laboratory does is handed on to `vigil-lab`.

mod adapter;
pub mod child_process;
mod courses;
mod doctor;
pub mod evaluate;
mod flight_watch;
mod fly;
mod foreign;
pub mod lab;
mod live;
pub mod log;
pub mod output;
pub mod replay;
pub(crate) mod scene;
mod sensor;
mod view;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Fly a quadcopter through obstacles in simulation, or any PX4 or ArduPilot vehicle.
///
/// Without a command, `vigil` flies one random validation course in real time (`vigil fly`).
#[derive(Parser)]
#[command(name = "vigil", version, after_help = EXAMPLES, mut_subcommands(with_negative_numbers))]
struct Cli {
    #[command(subcommand)]
    command: Option<Any>,

    #[command(flatten)]
    every: EveryCommand,
}

/// A negative number behind an argument is its value, which its own parser refuses, and no argument that is unknown.
pub fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let taken = |arg: clap::Arg| {
        let is_named_value = arg.get_action().takes_values() && !arg.is_positional();
        arg.allow_negative_numbers(is_named_value)
    };
    command.mut_args(taken).mut_subcommands(with_negative_numbers)
}

/// What every command takes.
#[derive(Debug, Clone, clap::Args)]
pub struct EveryCommand {
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
enum Any {
    #[command(flatten)]
    Flight(Box<Command>),
    #[command(flatten)]
    Lab(lab::Command),
}

/// The commands of the flight tier, which `vigil-lab` has too.
#[derive(Subcommand)]
pub enum Command {
    /// Fly one course in real time: starts simulator and firmware, shows progress, ends both.
    Fly(fly::FlyArgs),
    /// Run the simulated vehicle alone.
    Sim(vigil_sim::program::SimArgs),
    /// Run the 20 Hz loop alone (the same as the `firmware` program).
    Firmware(vigil_firmware::program::FirmwareArgs),
    /// Fly many seeded courses in lockstep, faster than real time, and tabulate the outcomes.
    Evaluate(evaluate::EvaluateArgs),
    /// Run the adversary alone: alters depth frames between the sensor and the firmware.
    Adversary(vigil_adversary::process::AdversaryArgs),
    /// Run the tick over a flight log's recorded inputs and compare every output byte.
    Replay(replay::ReplayArgs),
    /// Make a report or a film of a flight log, or complete it.
    #[command(subcommand)]
    Log(log::LogCommand),
    /// Open a flight log in the Rerun viewer, in a ready layout.
    View(view::ViewArgs),
    /// Save what is whole of a flight log that was cut off or damaged.
    Recover(replay::RecoverArgs),
    /// Look at a vehicle and its depth sensor, and say what is missing before Vigil can fly them.
    Doctor(doctor::DoctorArgs),
    /// Check a publisher of depth frames, or be one for a foreign vehicle.
    #[command(subcommand)]
    Sensor(sensor::SensorCommand),
    /// Draw, write or check courses.
    #[command(subcommand, after_help = courses::EXAMPLES)]
    Courses(courses::CoursesCommand),
}

/// Reads the arguments of the process and does what they say.
pub fn main() -> ExitCode {
    if lab::is_asked_about(std::env::args_os().skip(1)) {
        return output::finish(lab::hand_on());
    }
    let mut cli: Cli = vigil_firmware::removed::parse();
    if let Some(Any::Flight(command)) = &cli.command {
        cli.every.suit(command);
    }
    cli.every.run(|| run(cli.command))
}

fn run(command: Option<Any>) -> Result<ExitCode> {
    match command {
        None => run(Cli::parse_from(["vigil", "fly"]).command),
        Some(Any::Flight(command)) => execute(*command),
        Some(Any::Lab(_)) => lab::hand_on(),
    }
}

impl EveryCommand {
    /// States and notices are what the firmware prints, as the `firmware` program does.
    pub fn suit(&mut self, command: &Command) {
        if matches!(command, Command::Firmware(_)) {
            self.verbose = self.verbose.max(1);
        }
    }

    /// Does what is asked of every command, then the command; its end is the process's.
    pub fn run(&self, command: impl FnOnce() -> Result<ExitCode>) -> ExitCode {
        vigil_io::interrupt::outlive_file_limits();
        output::start_tracing(self.verbose);
        output::finish(match self.ends_with.map(child_process::end_with) {
            Some(Err(error)) => Err(error),
            _ => command(),
        })
    }
}

/// Runs a command of the flight tier.
pub fn execute(command: Command) -> Result<ExitCode> {
    match command {
        Command::Fly(args) => fly::run(&args),
        Command::Sim(args) => vigil_sim::program::run(args),
        Command::Firmware(args) => vigil_firmware::program::run(args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Adversary(args) => vigil_adversary::process::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Log(args) => log::run(&args),
        Command::View(args) => view::run(&args),
        Command::Recover(args) => replay::recover(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Sensor(args) => sensor::run(&args),
        Command::Courses(args) => courses::run(&args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_negative_number_is_a_value_and_help_with_a_film_is_the_laboratory_s() {
        let refused = |line: &str| Cli::try_parse_from(format!("vigil {line}").split(' ')).err();
        assert!(refused("evaluate --wind -3 --noise -1").is_none());
        for line in [
            "courses write --seed -1",
            "evaluate --goal-distance -1",
            "sensor render --pose -1",
        ] {
            let error = refused(line).expect("no such value").to_string();
            assert!(error.contains("invalid value '-1'"), "{error}");
        }
        let is_asked = |line: &str| lab::is_asked_about(line.split(' ').map(std::ffi::OsString::from));
        let lines = ["help log film", "help learn", "help log report", "help fly"];
        assert_eq!(lines.map(is_asked), [true, true, false, false]);
    }
}
