//! The `firmware` program, which is also `vigil firmware`.

use crate::arguments::{PilotArgs, choice, help, number};
use crate::config::{FirmwareConfig, GoalConfig};
use crate::link_spec::LinkSpec;
use crate::live_loop::{self, recorder_config};
use crate::lockstep::{self, LockstepFirmware};
use crate::reference;
use anyhow::{Result, ensure};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tracing_subscriber::filter::{LevelFilter, Targets};
use vigil_io::gate::AllowUnsigned;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain};
use vigil_log::{Recorder, RecorderConfig, WhenFull};
use vigil_types::parameters;
use vigil_types::{
    AtGoal, AutopilotChoice, Choice, Duty, EngagePolicy, LogContent, ObstacleReports, PilotKind, StepReport,
};

/// Arguments of `vigil firmware` and of the `firmware` program.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(after_help = "\
Examples:
  firmware                                  on the simulator of instance 0, waiting for an operator to engage it
  firmware --engage auto --goal 20,5        take off and fly to 20 m north, 5 m east of home
  firmware --link udpin://0.0.0.0:14540 --allow-unsigned always --goal 50,0 --height 5
                                            on a vehicle of yours, over a network that only it reaches
  firmware --link serial:///dev/ttyUSB0:921600 --signing-key vigil.key
                                            over a serial line, with MAVLink signing
  firmware --link udpin://127.0.0.1:14030 --link tcpin://127.0.0.1:5760 --link serial:///dev/ttyUSB0:57600,unsigned=always
                                            with two further links for ground stations
  firmware --lockstep                       answer a simulator that sets the pace
  firmware --config my.toml                 with a configuration file (docs/firmware.md); flags override it

Ctrl-C, SIGTERM, SIGHUP: brakes, has the vehicle hold by itself (3 s at most), closes the log.
Exit code: 0 ended on request, 1 error, 2 wrong arguments.")]
pub struct FirmwareArgs {
    /// Configuration file (TOML).
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    #[arg(long, value_name = "N", value_parser = number::<u32>(&parameters::INSTANCE), help = help(&parameters::INSTANCE))]
    instance: Option<u32>,

    /// Where the vehicle's MAVLink is: udpin://ADDRESS:PORT, udpout://HOST:PORT, tcpin://ADDRESS:PORT, tcpout://HOST:PORT
    /// or serial:///dev/DEVICE:BAUD [default: udpin://127.0.0.1:14030, the port plus the instance]. May be repeated: the
    /// first is the vehicle's, the others are for ground stations. Options follow, separated by commas:
    /// unsigned=loopback|never|always, rate=BYTES_PER_SECOND, values=PER_SECOND (how often the guidance computer's values are
    /// sent, at most 4; fewer by default where the link leaves this machine), and of the vehicle's link system=ID.
    #[arg(long, value_name = "URL[,OPTION]", conflicts_with = "lockstep")]
    link: Vec<LinkSpec>,

    #[arg(long, value_name = "FILE", conflicts_with = "lockstep", help = help(&parameters::KEY_FILE))]
    signing_key: Option<PathBuf>,

    /// From whom packets without a signature are accepted: from this machine, nobody, everybody [default: loopback].
    #[arg(long, value_enum, value_name = "WHO", conflicts_with = "lockstep")]
    allow_unsigned: Option<AllowUnsigned>,

    #[arg(long, conflicts_with = "lockstep", help = help(&parameters::ACCEPT_FIRST_KEY))]
    accept_first_key: bool,

    #[arg(long, value_name = "FILE", help = help(&parameters::FRAME_KEY_FILES))]
    frame_key: Vec<PathBuf>,

    #[arg(long, value_parser = choice::<AutopilotChoice>(), help = help(&parameters::VEHICLE))]
    vehicle: Option<AutopilotChoice>,

    #[arg(long, value_parser = choice::<Duty>(), help = help(&parameters::DUTY))]
    duty: Option<Duty>,

    #[arg(long, value_name = "WHEN", value_parser = choice::<ObstacleReports>(), help = help(&parameters::OBSTACLE_DISTANCE))]
    obstacle_distance: Option<ObstacleReports>,

    #[arg(long, value_parser = choice::<EngagePolicy>(), help = help(&parameters::ENGAGE))]
    engage: Option<EngagePolicy>,

    /// Where to fly: metres north and east of home.
    #[arg(long, value_name = "N,E", value_parser = parse_goal, allow_hyphen_values = true)]
    goal: Option<[f32; 2]>,

    #[arg(long, value_name = "METRES", value_parser = number::<f32>(&parameters::HEIGHT), allow_hyphen_values = true,
        help = help(&parameters::HEIGHT))]
    height: Option<f32>,

    #[arg(long, value_parser = choice::<AtGoal>(), help = help(&parameters::AT_GOAL))]
    at_goal: Option<AtGoal>,

    #[command(flatten)]
    pilot: PilotArgs,

    #[arg(long, value_name = "PRIORITY", value_parser = number::<u8>(&parameters::PRIORITY), conflicts_with = "lockstep",
        help = help(&parameters::PRIORITY))]
    priority: Option<u8>,

    #[arg(long, value_name = "DIR", help = help(&parameters::LOG))]
    log: Option<PathBuf>,

    #[arg(long, value_name = "WHAT", value_parser = choice::<LogContent>(), help = help(&parameters::LOG_CONTENT))]
    log_content: Option<LogContent>,

    #[arg(long, value_name = "DIR", conflicts_with = "lockstep", help = help(&parameters::STATE))]
    state: Option<PathBuf>,

    #[arg(long, value_name = "FILE", help = help(&parameters::SCENE))]
    scene: Option<PathBuf>,

    /// Answer a simulator in lockstep instead of running in real time; ends with its flight.
    #[arg(long)]
    lockstep: bool,

    /// How long lockstep waits for the simulator before it names it as missing.
    #[arg(long, value_name = "SECONDS", default_value_t = DEFAULT_LOCKSTEP_TIMEOUT_S, requires = "lockstep",
        value_parser = clap::value_parser!(u64).range(1..=3600))]
    lockstep_timeout: u64,

    /// Print a configuration file with every key, its default and what it accepts, and end.
    #[arg(long, exclusive = true)]
    print_config: bool,
}

const DEFAULT_LOCKSTEP_TIMEOUT_S: u64 = 10;

fn parse_goal(text: &str) -> Result<[f32; 2], String> {
    let allowed = "give NORTH,EAST in metres, each within ±10000, for example 20,-5";
    let (north, east) = text.split_once(',').ok_or(allowed)?;
    let number = |text: &str| match text.trim().parse::<f32>() {
        Ok(v) if v.abs() <= 10_000.0 => Ok(v),
        _ => Err(allowed.to_owned()),
    };
    Ok([number(north)?, number(east)?])
}

impl FirmwareArgs {
    /// The configuration: the file's, with the flags over it.
    ///
    /// # Errors
    /// An unreadable or wrong configuration file, with file, line and field; what a log is to hold, without a log.
    pub fn resolve(&self) -> Result<FirmwareConfig> {
        let mut config = match &self.config {
            Some(path) => FirmwareConfig::load(path)?,
            None => FirmwareConfig::default(),
        };
        config.instance = self.instance.unwrap_or(config.instance);
        if let Some((vehicle, ground)) = self.link.split_first() {
            config.link = Some(vehicle.clone());
            if !ground.is_empty() {
                config.links = ground.to_vec();
            }
        }
        config.signing.key_file = self.signing_key.clone().or(config.signing.key_file);
        config.signing.allow_unsigned = self.allow_unsigned.unwrap_or(config.signing.allow_unsigned);
        config.signing.accept_first_key |= self.accept_first_key;
        if !self.frame_key.is_empty() {
            config.frame_key_files = self.frame_key.clone();
        }
        config.vehicle = self.vehicle.unwrap_or(config.vehicle);
        config.duty = self.duty.unwrap_or(config.duty);
        config.obstacle_distance = self.obstacle_distance.unwrap_or(config.obstacle_distance);
        config.engage = self.engage.unwrap_or(config.engage);
        config.at_goal = self.at_goal.unwrap_or(config.at_goal);
        self.pilot.apply(&mut config);
        config.rate.priority = self.priority.unwrap_or(config.rate.priority);
        if let Some([north_m, east_m]) = self.goal {
            config.goal = Some(GoalConfig {
                north_m,
                east_m,
                height_m: None,
            });
        }
        if let Some(height_m) = self.height {
            config.height_m = height_m;
            config.goal.iter_mut().for_each(|goal| goal.height_m = None);
        }
        config.state.directory = self.state.clone().or(config.state.directory);
        config.log.directory = self.log.clone().or(config.log.directory);
        config.log.content = self.log_content.unwrap_or(config.log.content);
        config.log.scene = self.scene.clone().or(config.log.scene);
        ensure!(
            config.log.directory.is_some() || (self.log_content.is_none() && self.scene.is_none()),
            "--log-content and --scene are of a log: give --log DIR"
        );
        Ok(config)
    }
}

/// Whether there are colours: on a terminal that has them, where `NO_COLOR` does not forbid them.
pub fn colours(is_terminal: bool) -> bool {
    let is_forbidden = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    is_terminal && !is_forbidden && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Which diagnostics are shown: `RUST_LOG` (a level, or `target=level` with commas between), or else `default`, a level. One that is
/// neither is named on standard error.
pub fn diagnostics(default: &str) -> Targets {
    let wanted = std::env::var("RUST_LOG").ok().map(|wanted| wanted.replace(' ', ""));
    let is_given = wanted.as_ref().is_some_and(|wanted| !wanted.is_empty());
    // A word that is no level would be the name of a target, and hide everything else.
    let is_level = |part: &str| !part.is_empty() && part.parse::<LevelFilter>().is_ok();
    let is_filter = |part: &str| part.contains('=') || is_level(part);
    let wanted = wanted.filter(|wanted| wanted.split(',').all(is_filter));
    let parsed = wanted.and_then(|wanted| wanted.parse().ok());
    if is_given && parsed.is_none() {
        let what = "error, warn, info, debug, trace, off, or target=level with commas between";
        announce(&format!("RUST_LOG is not understood, {default} taken: give {what}"));
    }
    parsed.unwrap_or_else(|| default.parse().unwrap_or_default())
}

/// An error and its causes in one line, each thing once: a message that holds its cause says it already, and so does a
/// cause that begins with what names it.
pub fn in_one_line(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if text.contains(&cause) {
            continue;
        }
        // A name that the cause begins with is in it already.
        if cause.starts_with(&text) {
            text.clear();
        }
        if !text.is_empty() {
            text += ": ";
        }
        text += &cause;
    }
    text
}

/// Runs the firmware until it is asked to end (Ctrl-C, SIGTERM; in lockstep also by the simulator).
///
/// # Errors
/// Whatever keeps the flight from beginning, each telling what to do; in lockstep also a simulator that fell silent.
pub fn run(args: FirmwareArgs) -> Result<ExitCode> {
    if args.print_config {
        vigil_types::files::print_line(reference::configuration().trim_end())?;
        return Ok(ExitCode::SUCCESS);
    }
    let config = args.resolve()?;
    let stop = vigil_io::interrupt::set_by_interrupt()?;
    if args.lockstep {
        run_lockstep(&config, Duration::from_secs(args.lockstep_timeout), &stop)?;
    } else {
        let summary = live_loop::fly(&config, &stop, |config, granted| {
            announce(&format!("{}\nscheduling {granted}", Start(config)));
            let of_others = match config.duty {
                Duty::Fly => "",
                Duty::JustStop | Duty::FlyAround => " (a flight that it only guards goes on unguarded)",
            };
            announce(&format!(
                "end        Ctrl-C or SIGTERM: it brakes, has the vehicle hold by itself{of_others} and closes the log"
            ));
        })?;
        vigil_types::files::print_line(&summary.to_string())?;
    }
    Ok(ExitCode::SUCCESS)
}

fn run_lockstep(config: &FirmwareConfig, timeout: Duration, stop: &AtomicBool) -> Result<()> {
    let domain = Domain::open(config.instance, "firmware")?;
    let mut firmware = LockstepFirmware::new(config)?;
    firmware.require_frame_keys(config.frame_keys()?);
    if let Some(recorder) = recorder_config(config)? {
        firmware.record(Recorder::start(RecorderConfig {
            when_full: WhenFull::Wait,
            ..recorder
        })?);
    }
    let mut last = StepReport::default();
    let cancelled = || stop.load(Ordering::Relaxed);
    announce(&format!(
        "lockstep   instance {}: waits for a simulator that sets the pace, {} s at most; {}\nend        Ctrl-C or SIGTERM",
        config.instance,
        timeout.as_secs(),
        pilot_line(config)
    ));
    let served = lockstep::serve(&mut firmware, &domain, timeout, cancelled, |report| last = *report);
    let steps = firmware.steps();
    // The log is closed whatever ended the flight.
    let log = firmware.finish();
    served?;
    let mut text = format!("lockstep  {steps} steps, ended in {}", last.state.name());
    if let Some(log) = log {
        text += &format!("\nlog       {} ({} records)", log.path.display(), log.records);
        log.failure
            .iter()
            .for_each(|failure| text += &format!("\nlog       {failure}"));
    }
    Ok(vigil_types::files::print_line(&text)?)
}

/// Prints something for a person at once.
fn announce(text: &str) {
    // Where nobody listens, nothing can be said; a flight does not end for it.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// What a person reads at start: a line for each of vehicle and links, frames, pilot, signing.
struct Start<'a>(&'a FirmwareConfig);

impl std::fmt::Display for Start<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let config = self.0;
        let ground: Vec<_> = config.links.iter().map(ToString::to_string).collect();
        writeln!(
            f,
            "firmware   instance {}: {} on {}{}; engages {}",
            config.instance,
            match config.vehicle {
                AutopilotChoice::Auto => "any vehicle",
                AutopilotChoice::Px4 => "PX4",
                AutopilotChoice::ArduPilot => "ArduPilot",
            },
            config.vehicle_link(),
            match ground.is_empty() {
                true => String::new(),
                false => format!(", ground stations on {}", ground.join(" and ")),
            },
            match config.engage {
                _ if config.duty == Duty::JustStop => "on command only: it guards somebody else's flight",
                _ if config.duty == Duty::FlyAround => "to fly a guarded mission around what is there, or on command",
                EngagePolicy::Auto => "by itself",
                EngagePolicy::Command => "on command",
            },
        )?;
        writeln!(
            f,
            "frames     of sensor {} on `{DEPTH_TOPIC}` in shared memory, {}",
            config.sensor_id,
            match config.frame_key_files.len() {
                0 => "not authenticated (no --frame-key)",
                1 => "authenticated with one key",
                _ => "authenticated with one of two keys",
            }
        )?;
        writeln!(f, "pilot      {}", pilot_line(config))?;
        let kept = config.kept_key().is_some_and(|path| path.exists());
        let signed = match &config.signing.key_file {
            Some(_) => "signed",
            None if kept => "signed with the key that SETUP_SIGNING brought",
            None => "not signed",
        };
        write!(f, "signing    {signed}, {}", config.signing.allow_unsigned.in_words())
    }
}

/// Who flies, and what watches.
fn pilot_line(config: &FirmwareConfig) -> String {
    if config.pilot.kind == PilotKind::Geometric {
        return "the geometric pilot; nothing watches it".to_owned();
    }
    let named = |file: &Option<PathBuf>| match file {
        Some(path) => path.display().to_string(),
        None => "built in".to_owned(),
    };
    let field = if config.pilot.apf { "with" } else { "without" };
    let frozen = config.frozen_pilot().ok().flatten();
    let slowed = frozen.and_then(|pilot| config.slowed(&pilot));
    let slowed = slowed.map(|note| format!("; {note}")).unwrap_or_default();
    let actor = format!(
        "the actor ({}), {field} the potential field{slowed}",
        named(&config.pilot.actor_file)
    );
    let detector = config
        .has_detector()
        .then(|| format!("the detector ({})", named(&config.detector.file)));
    let watching = match (detector, config.has_guard()) {
        (None, false) => return format!("{actor}; nothing watches it"),
        (Some(detector), false) => format!("{detector} watches it"),
        (None, true) => "the guard watches it".to_owned(),
        (Some(detector), true) => format!("{detector} and the guard watch it"),
    };
    format!(
        "{actor}; {watching}, an alarm brings about: {}",
        config.detector.alarm.name()
    )
}
