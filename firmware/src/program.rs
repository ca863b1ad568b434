//! The `firmware` program, which is also `vigil firmware`.

use crate::config::{
    AlarmChoice, AtGoalChoice, Engage, FirmwareConfig, GoalConfig, MAX_INSTANCE, ObstacleDistance, PilotKind,
    SigningConfig, Vehicle,
};
use crate::link_spec::LinkSpec;
use crate::live::{self, recorder_config};
use crate::lockstep::{self, LockstepFirmware};
use crate::ports::gate::AllowUnsigned;
use crate::tunables::{GREATEST_THRESHOLD, LEAST_THRESHOLD};
use anyhow::{Context, Result, ensure};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain};
use vigil_log::{Recorder, RecorderConfig, WhenFull};
use vigil_types::StepReport;

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

Ctrl-C or SIGTERM: brakes, sends zeros for a quarter of a second, closes the log.
Exit code: 0 ended on request, 1 error, 2 wrong arguments.")]
pub struct FirmwareArgs {
    /// Configuration file (TOML).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Number of this set of processes; port and shared memory follow from it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_INSTANCE)))]
    pub instance: Option<u32>,

    /// Where the vehicle's MAVLink is: udpin://ADDRESS:PORT, udpout://HOST:PORT, tcpin://ADDRESS:PORT, tcpout://HOST:PORT
    /// or serial:///dev/DEVICE:BAUD [default: udpin://127.0.0.1:14030, the port plus the instance]. May be repeated: the
    /// first is the vehicle's, the others are for ground stations. Options follow, separated by commas:
    /// unsigned=loopback|never|always, rate=BYTES_PER_SECOND, values=PER_SECOND (how often the guidance computer's values are
    /// sent, at most 4; fewer by default where the link leaves this machine), and of the vehicle's link system=ID.
    #[arg(long, value_name = "URL[,OPTION]")]
    pub link: Vec<LinkSpec>,

    /// File with the key of MAVLink signing: 64 hexadecimal digits or 32 bytes, mode 0600. Without it nothing is signed.
    #[arg(long, value_name = "FILE")]
    pub signing_key: Option<PathBuf>,

    /// From whom packets without a signature are accepted: from this machine, nobody, everybody [default: loopback].
    #[arg(long, value_enum, value_name = "WHO")]
    pub allow_unsigned: Option<AllowUnsigned>,

    /// While there is no signing key, take one by SETUP_SIGNING from whoever may speak without a signature. Without this,
    /// and once there is a key, only a packet signed with it brings another.
    #[arg(long)]
    pub accept_first_key: bool,

    /// File with the secret of the depth frames' key: 64 hexadecimal digits or 32 bytes, mode 0600. Frames that were not made with it are
    /// refused. Given twice while a key is exchanged: either is accepted. Without it frames are not authenticated.
    #[arg(long, value_name = "FILE")]
    pub frame_key: Vec<PathBuf>,

    /// Which autopilot the vehicle has; a vehicle of another one is not flown [default: auto].
    #[arg(long, value_enum)]
    pub vehicle: Option<Vehicle>,

    /// When OBSTACLE_DISTANCE is sent (docs/firmware.md, "Obstacles for the autopilot") [default: flight].
    #[arg(long, value_enum, value_name = "WHEN")]
    pub obstacle_distance: Option<ObstacleDistance>,

    /// Who starts a flight: guidance itself as soon as it is ready and no person has the vehicle (docs/guidance.md, "Where
    /// auto engages"), or an operator's command [default: command].
    #[arg(long, value_enum)]
    pub engage: Option<Engage>,

    /// Where to fly: metres north and east of home.
    #[arg(long, value_name = "N,E", value_parser = parse_goal, allow_hyphen_values = true)]
    pub goal: Option<[f32; 2]>,

    /// Height to fly at, metres above home [default: 2.5].
    #[arg(long, value_name = "METRES", value_parser = parse_height, allow_hyphen_values = true)]
    pub height: Option<f32>,

    /// What to do at the goal [default: hold].
    #[arg(long, value_enum)]
    pub at_goal: Option<AtGoalChoice>,

    /// Who decides [default: actor].
    #[arg(long, value_enum)]
    pub pilot: Option<PilotKind>,

    /// The frozen actor to fly [default: the one built in].
    #[arg(long, value_name = "FILE")]
    pub actor: Option<PathBuf>,

    /// Whether the potential field is added to the actor's action [default: on].
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    pub apf: Option<bool>,

    /// Whether a detector watches the actor [default: on, where the actor flies].
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    pub detector: Option<bool>,

    /// The frozen detector [default: the one built in].
    #[arg(long, value_name = "FILE")]
    pub detector_file: Option<PathBuf>,

    /// Score above which a verdict is attack, 0.01 to 0.999 [default: the detector's own].
    #[arg(long, value_name = "SCORE", value_parser = parse_threshold)]
    pub threshold: Option<f32>,

    /// Raise the alarm when COUNT of the last WINDOW verdicts are attack [default: as in docs/guidance.md].
    #[arg(long, value_name = "COUNT/WINDOW", value_parser = parse_raise)]
    pub raise: Option<(u8, u8)>,

    /// Whether the recovery pilot raises the alarm as well when the actor is about to fly into something [default: on, with the
    /// detector].
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    pub guard: Option<bool>,

    /// What an alarm brings about [default: recover].
    #[arg(long, value_enum)]
    pub alarm: Option<AlarmChoice>,

    /// Whether frames are judged before the pilots see them, so that a sensor that is dead, frozen or wrong holds the flight
    /// [default: on].
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    pub plausibility: Option<bool>,

    /// FIFO priority of the loop, 1 to 99; 0 for ordinary scheduling [default: 50].
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(u8).range(0..=99))]
    pub priority: Option<u8>,

    /// Folder for the flight log; without it there is none.
    #[arg(long, value_name = "DIR")]
    pub log: Option<PathBuf>,

    /// Folder that keeps over restarts a signing key that came by SETUP_SIGNING, parameters that were set, and that a person
    /// took the vehicle over. Without it they end with the process.
    #[arg(long, value_name = "DIR", conflicts_with = "lockstep")]
    pub state: Option<PathBuf>,

    /// File with the course's obstacles, for display in the log only.
    #[arg(long, value_name = "FILE", requires = "log")]
    pub scene: Option<PathBuf>,

    /// Answer a simulator in lockstep instead of running in real time; ends with its flight.
    #[arg(long)]
    pub lockstep: bool,

    /// How long lockstep waits for the simulator before it names it as missing.
    #[arg(long, value_name = "SECONDS", default_value_t = DEFAULT_LOCKSTEP_TIMEOUT_S, requires = "lockstep",
        value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub lockstep_timeout: u64,
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

/// `on` or `off`.
///
/// # Errors
/// Anything else, with what is allowed.
pub fn parse_switch(text: &str) -> Result<bool, String> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("give on or off".to_owned()),
    }
}

/// A detector's threshold.
///
/// # Errors
/// Anything that is not a number in the parameter's range, with what is allowed.
pub fn parse_threshold(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(v) if (LEAST_THRESHOLD..=GREATEST_THRESHOLD).contains(&v) => Ok(v),
        _ => Err(format!("give a score, {LEAST_THRESHOLD} to {GREATEST_THRESHOLD}")),
    }
}

/// `COUNT/WINDOW`: so many attack verdicts of so many.
///
/// # Errors
/// Anything else, with what is allowed.
pub fn parse_raise(text: &str) -> Result<(u8, u8), String> {
    let parsed = text
        .split_once('/')
        .and_then(|(count, window)| Some((count.parse().ok()?, window.parse().ok()?)));
    match parsed {
        Some((count, window)) if (1..=32).contains(&window) && (1..=window).contains(&count) => Ok((count, window)),
        _ => Err("give COUNT/WINDOW, 1 to 32 each and the count not above the window, for example 5/6".to_owned()),
    }
}

fn parse_height(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(v) if (0.1..=1000.0).contains(&v) => Ok(v),
        _ => Err("give metres above home, 0.1 to 1000".to_owned()),
    }
}

impl FirmwareArgs {
    /// The configuration: the file's, with the flags over it.
    ///
    /// # Errors
    /// An unreadable or wrong configuration file, with file, line and field.
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
        config.obstacle_distance = self.obstacle_distance.unwrap_or(config.obstacle_distance);
        config.engage = self.engage.unwrap_or(config.engage);
        config.at_goal = self.at_goal.unwrap_or(config.at_goal);
        config.pilot.kind = self.pilot.unwrap_or(config.pilot.kind);
        config.pilot.actor_file = self.actor.clone().or(config.pilot.actor_file);
        config.pilot.apf = self.apf.unwrap_or(config.pilot.apf);
        config.detector.enabled = self.detector.or(config.detector.enabled);
        config.detector.file = self.detector_file.clone().or(config.detector.file);
        config.detector.threshold = self.threshold.or(config.detector.threshold);
        config.detector.guard = self.guard.unwrap_or(config.detector.guard);
        if let Some((count, window)) = self.raise {
            (config.detector.raise_count, config.detector.raise_window) = (count, window);
        }
        config.detector.alarm = self.alarm.unwrap_or(config.detector.alarm);
        config.plausibility = self.plausibility.unwrap_or(config.plausibility);
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
        config.log.scene = self.scene.clone().or(config.log.scene);
        Ok(config)
    }
}

/// An error and its causes in one line, each thing told once: a message that ends with its cause holds it already, and so does a
/// cause that begins with what names it.
pub fn told(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if text.ends_with(&cause) {
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

/// Runs the firmware until it is told to end (Ctrl-C, SIGTERM; in lockstep also by the simulator).
///
/// # Errors
/// Whatever keeps the flight from beginning, each telling what to do; in lockstep also a simulator that fell silent.
pub fn run(args: FirmwareArgs) -> Result<ExitCode> {
    let config = args.resolve()?;
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("cannot install the Ctrl-C handler")?;
    if args.lockstep {
        ensure!(
            args.link.is_empty(),
            "--lockstep takes the simulator's MAVLink from shared memory: leave --link out"
        );
        run_lockstep(&config, Duration::from_secs(args.lockstep_timeout), &stop)?;
    } else {
        let summary = live::fly(&config, &stop, |granted| {
            announce(&format!("{}\nscheduling {granted}", Start(&config)));
            announce(
                "end        Ctrl-C or SIGTERM: it brakes, sends zeros for a quarter of a second and closes the log",
            );
        })?;
        vigil_files::print_line(&summary.to_string())?;
    }
    Ok(ExitCode::SUCCESS)
}

fn run_lockstep(config: &FirmwareConfig, timeout: Duration, stop: &AtomicBool) -> Result<()> {
    let domain = Domain::open(config.instance, "firmware")?;
    let recorder = recorder_config(config)?
        .map(|recorder| {
            Recorder::start(RecorderConfig {
                when_full: WhenFull::Wait,
                ..recorder
            })
        })
        .transpose()?;
    let mut firmware = LockstepFirmware::recording(config, recorder)?;
    firmware.require_frame_keys(config.frame_keys()?);
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
    Ok(vigil_files::print_line(&text)?)
}

/// Tells a person something at once.
fn announce(text: &str) {
    // Where nobody listens, nothing can be told; a flight does not end for it.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// What a person is told at start: a line for each of vehicle and links, frames, pilot, signing.
struct Start<'a>(&'a FirmwareConfig);

impl std::fmt::Display for Start<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let config = self.0;
        writeln!(
            f,
            "firmware   instance {}: {} on {}{}; engages {}",
            config.instance,
            config.vehicle.name(),
            config.vehicle_link(),
            ground_links(&config.links),
            config.engage.name(),
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
        write!(f, "signing    {}", config.signing)
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
    let actor = format!(
        "the actor ({}), {field} the potential field",
        named(&config.pilot.actor_file)
    );
    if !config.is_watched() {
        return format!("{actor}; nothing watches it");
    }
    format!(
        "{actor}; the detector ({}) {}, an alarm brings about: {}",
        named(&config.detector.file),
        if config.detector.guard {
            "and the guard watch it"
        } else {
            "watches it"
        },
        config.detector.alarm.name()
    )
}

impl Vehicle {
    fn name(self) -> &'static str {
        match self {
            Self::Auto => "any vehicle",
            Self::Px4 => "PX4",
            Self::ArduPilot => "ArduPilot",
        }
    }
}

/// Those links as the terminal is told of them.
fn ground_links(links: &[LinkSpec]) -> String {
    let listed: Vec<_> = links.iter().map(ToString::to_string).collect();
    match listed.is_empty() {
        true => String::new(),
        false => format!(", ground stations on {}", listed.join(" and ")),
    }
}

impl std::fmt::Display for SigningConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self.key_file {
            Some(_) => "signed",
            None => "not signed",
        })?;
        f.write_str(match self.allow_unsigned {
            AllowUnsigned::Loopback => ", unsigned packets from this machine only",
            AllowUnsigned::Never => ", no unsigned packets",
            AllowUnsigned::Always => ", unsigned packets from everybody",
        })
    }
}

impl Engage {
    fn name(self) -> &'static str {
        match self {
            Self::Auto => "by itself",
            Self::Command => "on command",
        }
    }
}
