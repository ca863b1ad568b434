//! `vigil fly`: one flight in real time, simulator and firmware as processes of their own.

use crate::cli::child_process::{END_LIMIT, Process, read_statuses, wait_for};
use crate::cli::flight_watch::{Flight, Terminal, TruePose, watch};
use crate::cli::foreign::ForeignArgs;
use crate::cli::lab;
use crate::cli::live::Live;
use crate::cli::log::film_name;
use crate::cli::output::{self, EXIT_ERROR, EXIT_INTERRUPTED, Interrupt, Paint, say, tell};
use crate::cli::replay::find_log;
use crate::cli::view::{self, ViewerArgs};
use crate::flight_derived::{Derivable, derive};
use crate::flight_report::{self, EXPLAINED};
use anyhow::{Context, Result, ensure};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode};
use std::sync::mpsc::Receiver;
use std::time::Instant;
use vigil_adversary::AttackArgs;
use vigil_adversary::process::RAW_TOPIC;
use vigil_firmware::FirmwareConfig;
use vigil_firmware::arguments::{PilotArgs, choice};
use vigil_log::{SideLog, merge_into};
use vigil_sim::program::{Status, ending_code};
use vigil_sim::world::{Course, FlightPath, Outcome};
use vigil_sim::{CourseChoice, SensorFault, VehicleChoice};
use vigil_types::{Choice, LogContent, Nanos};

/// What simulator and adversary know besides the firmware's log, until it is put into it.
const SIMULATOR_NOTES: &str = "simulator.part";
const ADVERSARY_NOTES: &str = "adversary.part";

/// Arguments of `vigil fly`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil fly                          a random validation course
  vigil fly --seed 7                 validation course 7
  vigil fly --pilot geometric        the geometric pilot instead of the learned actor
  vigil fly --apf off                the actor without the potential field
  vigil fly --apf off --attack bim-accumulating --burst continuous
                                     ... with an adversary between the sensor and the firmware
  vigil fly --sensor-fault frozen@12 the LiDAR shows the same image from 12 s on
  vigil fly --course my.toml         your own course (docs/courses.md)
  vigil fly --view                   in the Rerun viewer while it flies
  vigil fly --seed 7 --record 7.gif  a film of the flight, made after it; or 7.mp4, with ffmpeg
  vigil fly --log-content light      a log of a few MB, to be looked at only (docs/log.md)
  vigil fly --instance 1             beside another flight on the same machine
  vigil fly --vehicle px4 --link udpin://127.0.0.1:14540
  vigil fly --vehicle ardupilot --link tcpout://127.0.0.1:5762
                                     a vehicle that already runs in its own simulation (docs/foreign-vehicles.md)

While it flies, any MAVLink client can watch on port 14550, where all instances are heard, and command on 14540, plus the instance
number for instances 1 to 9; those from 10 on speak to 14549 (docs/scripting.md).
Exit code: 0 goal reached, 10 collision, 11 out of bounds, 12 time-out, 13 no flight, 1 error or landed elsewhere, 130 interrupted.")]
pub struct FlyArgs {
    /// Course to fly.
    #[command(flatten)]
    course: CourseChoice,

    /// Number of this set of processes; ports and shared memory follow from it.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=99))]
    instance: u32,

    /// Simulation file (TOML) that changes LiDAR, vehicle, sensors or wind.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    #[command(flatten)]
    vehicle: VehicleChoice,

    #[command(flatten)]
    foreign: ForeignArgs,

    /// Who decides.
    #[command(flatten)]
    pilot: PilotArgs,

    /// The adversary.
    #[command(flatten)]
    attack: AttackArgs,

    /// Let the LiDAR fail, from the simulator's start or from a moment on (docs/sensor-faults.md).
    #[arg(long, value_name = "MODE[@SECONDS|@random]")]
    sensor_fault: Option<SensorFault>,

    #[command(flatten)]
    second_sensor: SecondSensorArgs,

    /// File with the secret of the depth frames' key for simulator and firmware; the adversary does not have it.
    #[arg(long, value_name = "FILE")]
    frame_key: Option<PathBuf>,

    /// Show the flight in the Rerun viewer while it flies, a second late (docs/view.md).
    #[arg(long)]
    view: bool,

    #[command(flatten)]
    viewer: ViewerArgs,

    /// Film the flight from its log after it: a GIF, or an mp4 where ffmpeg is installed (`vigil log film` has more choices).
    #[arg(long, value_name = "FILE.gif|mp4", value_parser = film_name)]
    record: Option<PathBuf>,

    /// What the flight log holds (docs/log.md).
    #[arg(long, value_name = "WHAT", value_parser = choice::<LogContent>(), default_value = LogContent::Everything.name())]
    log_content: LogContent,

    /// Nothing on the terminal while it flies.
    #[arg(short = 'q', long)]
    quiet: bool,

    /// Folder in which the flight gets a folder of its own for log, course and pictures.
    #[arg(short = 'o', long, value_name = "DIR", default_value = "runs")]
    log: PathBuf,
}

/// The second sensor.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct SecondSensorArgs {
    /// So many small sensors of 45° each beside the LiDAR, side by side, which must see nothing nearer than the frames show
    /// (docs/second-sensor.md).
    #[arg(long = "second-sensor-heads", value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=5))]
    pub heads: u8,
}

/// Flies and reports.
///
/// # Errors
/// A bad course, a process that cannot be started or ends too early (with what it said last).
pub fn run(args: &FlyArgs) -> Result<ExitCode> {
    let seed = args.course.seed_or_random();
    let course = args.course.load(seed)?;
    ensure!(
        !args.foreign.is_foreign() || args.vehicle == VehicleChoice::default(),
        "--vehicle flies a vehicle that already runs: --vehicle-model and --noisy-estimate are for the simulated one"
    );
    ensure!(
        !args.foreign.is_foreign() || args.second_sensor.heads == 0,
        "--second-sensor-heads are the simulated vehicle's: a vehicle that has such a sensor sends OBSTACLE_DISTANCE"
    );
    if args.view {
        args.viewer.check_with_port()?;
    }
    if let Some(film) = &args.record {
        lab::check_film(film)?;
        output::prepare(film)?;
    }
    // A course that cannot be written is refused before there is a folder for it.
    course.to_toml_string()?;
    let interrupt = Interrupt::on_ctrl_c()?;
    let folder = output::make_folder(&args.log, "fly", seed)?;
    let mut processes = Processes::start(args, &course, seed, &folder)?;
    let follow = || args.viewer.follow(&folder, &["--follow"]);
    let mut viewer = args.view.then(follow).transpose()?;
    let mut terminal = terminal(args, &course, seed);
    let mut flight = Flight::default();
    let height_m = -course.goal_ned_m().z;
    let monitored = watch(&mut terminal, &mut processes, &interrupt, &mut flight, height_m);
    let interrupted = interrupt.came();
    let said = processes.end()?;
    let Flight { last, path, truth } = flight;
    let monitored = match monitored {
        // Nothing was there yet that could be finished.
        Err(error) if last.is_none() || find_log(&folder).is_err() => return Err(error),
        monitored => monitored,
    };
    // The path ends with the flight, the truth with the watch.
    let ended_ns = truth.get(path.len()).map(|(at_ns, ..)| *at_ns);
    let drawn = FlightPath {
        label: "flown".to_owned(),
        points_ned_m: path,
        outcome: last.as_ref().and_then(|s| s.outcome),
    };
    // The flight is over and has its own end, whatever of this fails.
    let picture = vigil_sim::world::draw(&course, &[drawn]).write_png(&folder.join("flight.png"));
    said_if_failed(picture.map_err(Into::into));
    let about = about(args, &course, seed, last.as_ref(), ended_ns);
    said_if_failed(complete_log(&folder, &truth, &about, args.log_content));
    let film = args.record.as_deref().map(|to| lab::film(&folder, to, &course.name));
    if let Some(script) = &mut viewer {
        said_if_failed(end_viewer(script, &folder));
    }
    // What ended it is reported last.
    let ended = match monitored {
        Ok(()) => summarise(&course, &last, &folder, &said, interrupted),
        Err(error) => Err(error.context(format!("{} holds the log", folder.display()))),
    };
    match film {
        Some(Ok(text)) if !text.is_empty() => say!("film      {}", text.trim_end()),
        Some(film) => said_if_failed(film.map(drop)),
        None => {}
    }
    ended
}

/// Reports an error that is not the flight's.
fn said_if_failed(result: Result<()>) {
    if let Err(error) = result {
        tell!("vigil: {}", vigil_firmware::program::in_one_line(&error));
    }
}

/// What is shown of the flight while it flies.
fn terminal(args: &FlyArgs, course: &Course, seed: u64) -> Terminal {
    let title = match &args.course.course {
        Some(file) => format!("course {}", file.display()),
        None => format!("{:?} course {seed}", args.course.family).to_lowercase(),
    };
    if args.quiet {
        Terminal::Quiet
    } else if std::io::stderr().is_terminal() {
        let size = rustix::termios::tcgetwinsize(std::io::stderr());
        let (columns, rows) = size.map_or((80, 24), |size| (size.ws_col.max(20), size.ws_row));
        let mut config = FirmwareConfig::to_goal(course.goal_ned_m());
        args.pilot.apply(&mut config);
        let threshold = config.flight_info().detector_threshold;
        Terminal::Live(Box::new(Live::new(title, course, threshold, columns, rows)))
    } else {
        // The first line comes at once.
        let printed_s = f64::NEG_INFINITY;
        Terminal::Lines { title, printed_s }
    }
}

/// The programs that fly together.
pub(super) struct Processes {
    pub(super) firmware: Process,
    pub(super) adversary: Option<Process>,
    pub(super) simulator: Process,
    pub(super) statuses: Receiver<Status>,
}

impl Processes {
    /// Starts them, each with its own part of the arguments; the course and its scene are written into the folder.
    fn start(args: &FlyArgs, course: &Course, seed: u64, folder: &Path) -> Result<Self> {
        let course_file = folder.join("course.toml");
        course.save(&course_file)?;
        let scene_file = folder.join("scene.json");
        crate::cli::scene::of(course).save(&scene_file)?;
        let instance = |c: &mut Command| {
            c.args(["--instance", &args.instance.to_string()]);
        };
        let goal = course.goal_ned_m();
        let to_goal = |c: &mut Command| {
            instance(c);
            c.arg(format!("--goal={},{}", goal.x, goal.y));
            c.arg(format!("--height={}", -goal.z));
        };
        // What simulator and sensor have in common.
        let world = |c: &mut Command| {
            c.arg("--status").arg("--course").arg(&course_file);
            instance(c);
            c.args(["--seed", &seed.to_string()]);
            if let Some(config) = &args.config {
                c.arg("--config").arg(config);
            }
            if args.attack.attack.is_some() {
                c.args(["--frames", RAW_TOPIC]);
            }
            if let Some(fault) = args.sensor_fault {
                c.args(["--sensor-fault", &fault.to_string()]);
            }
            if let Some(key) = &args.frame_key {
                c.arg("--frame-key").arg(key);
            }
        };
        let mut simulator = match args.foreign.is_foreign() {
            true => Process::start("sensor", folder, |c| {
                args.foreign.sensor(c, args.instance);
                world(c);
            })?,
            false => Process::start("simulator", folder, |c| {
                c.arg("sim");
                c.arg(format!("--second-sensor-heads={}", args.second_sensor.heads));
                args.vehicle.hand_on(c);
                world(c);
            })?,
        };
        let statuses = read_statuses(&mut simulator)?;
        let adversary = args.attack.attack.map(|_| {
            Process::start("adversary", folder, |c| {
                c.args(["adversary", "--seed", &seed.to_string()]);
                to_goal(c);
                if let Some(file) = args.pilot.actor_file() {
                    c.arg("--actor").arg(file);
                }
                args.attack.hand_on(c);
                c.arg("--record").arg(folder.join(ADVERSARY_NOTES));
            })
            .map(Process::listening)
        });

        let firmware = Process::start("firmware", folder, |c| {
            c.args(["firmware", "--engage", "auto", "--at-goal", "land"]);
            to_goal(c);
            if let Some(key) = &args.frame_key {
                c.arg("--frame-key").arg(key);
            }
            c.arg("--log").arg(folder).arg("--scene").arg(&scene_file);
            c.args(["--log-content", args.log_content.name()]);
            args.foreign.firmware(c, args.instance);
            match args.second_sensor.heads {
                0 => args.pilot.hand_on(c),
                _ => args.pilot.with_second_sensor().hand_on(c),
            }
        })?
        .listening();
        Ok(Self {
            firmware,
            adversary: adversary.transpose()?,
            simulator,
            statuses,
        })
    }

    /// The firmware ends first, so that its last setpoints still find a vehicle and its log is closed properly. What it and the
    /// adversary reported.
    fn end(&mut self) -> Result<(String, Option<String>)> {
        let firmware = self.firmware.end()?;
        self.simulator.end()?;
        let adversary = self.adversary.as_mut().map(Process::end).transpose()?;
        Ok((firmware, adversary))
    }
}

/// Puts what only the simulation knows into the flight's log, and makes the report beside it.
fn complete_log(
    folder: &Path,
    truth: &[TruePose],
    about: &BTreeMap<String, String>,
    content: LogContent,
) -> Result<()> {
    let log = find_log(folder)?;
    let truth_file = folder.join(SIMULATOR_NOTES);
    let mut notes = SideLog::create(&truth_file)?;
    for (at_ns, position_ned_m, attitude) in truth {
        notes.truth(*at_ns, *position_ned_m, Some(*attitude))?;
    }
    notes.finish()?;
    let adversary_file = folder.join(ADVERSARY_NOTES);
    let mut sides = vec![truth_file.as_path(), &adversary_file];
    sides.retain(|path| path.is_file());
    let merged = merge_into(&log, &sides, about, content);
    // Their content is in the log; one that stays behind does no harm.
    for side in sides.into_iter().filter(|_| merged.is_ok()) {
        let _ = std::fs::remove_file(side);
    }
    let derived = match content {
        LogContent::Light => Ok(()),
        _ => derive(&log, Some(Derivable::Map)).map(drop),
    };
    let report = flight_report::beside(&log);
    let reported = crate::cli::log::write_report(&log, &report, EXPLAINED);
    merged.context("the true path, the attack and the outcome are not in the log")?;
    reported?;
    derived.context("the log has no map and no planned path")
}

/// What is known of the flight as a whole, for its log.
fn about(
    args: &FlyArgs,
    course: &Course,
    seed: u64,
    last: Option<&Status>,
    ended_ns: Option<Nanos>,
) -> BTreeMap<String, String> {
    let known = [
        ("course", Some(course.name.clone())),
        ("seed", Some(seed.to_string())),
        ("vehicle", args.foreign.in_words().or_else(|| args.vehicle.name())),
        ("outcome", last.and_then(ending)),
        ("ended_ns", ended_ns.map(|ns| ns.to_string())),
    ];
    flight_report::about(command_again(args, seed), &args.attack, known)
}

/// How the flight ended, if it did.
fn ending(status: &Status) -> Option<String> {
    let outcome = status.outcome?;
    let (seconds, metres) = (status.flight_time_s, status.path_length_m);
    Some(format!("{outcome} after {seconds:.1} s and {metres:.1} m"))
}

/// The command that flies the same again, with the seed that was drawn.
fn command_again(args: &FlyArgs, seed: u64) -> String {
    let drawn = ["--seed", &seed.to_string()];
    let (dropped, added): (&[&str], &[&str]) = match args.course.course {
        // The course's file is named; the seed decides on noise and the adversary.
        Some(_) => (&["-o", "--log", "--record"], &[]),
        None => (&["-o", "--log", "--record", "--seed"], &drawn),
    };
    flight_report::command_again(std::env::args_os(), "fly", dropped, added)
}

/// What the adversary's last line says. One that was killed has none; the flight went on or held without frames.
fn adversary_in_words(said: &str) -> String {
    let mut lines = said.lines().rev();
    let Some(record) = lines.find_map(|line| serde_json::from_str::<serde_json::Value>(line).ok()) else {
        return "ended without a report: see adversary.log".to_owned();
    };
    let number = |key: &str| record[key].as_u64().unwrap_or(0);
    let (frames, attacked, effective) = (number("frames"), number("attacked_steps"), number("effective_steps"));
    if attacked == 0 {
        return format!("altered none of {frames} frames: the flight ended before its burst began");
    }
    let mut text = format!(
        "altered {attacked} of {frames} frames, from step {} at flight height on; the actor's yaw decision moved by 1.0 (30 °/s) \
         or more in {effective} of them ({:.0} %), by {:.2} on average",
        number("first_step"),
        100.0 * effective as f64 / attacked as f64,
        record["mean_yaw_change"].as_f64().unwrap_or(0.0)
    );
    match number("cut_short") {
        0 => {}
        cut => text += &format!("; {cut} iterations ended at the deadline"),
    }
    text
}

/// The script ends with the log; the viewer that it opened stays.
fn end_viewer(script: &mut Child, folder: &Path) -> Result<()> {
    let asked = Instant::now();
    match wait_for(script, || asked.elapsed() > END_LIMIT)? {
        Some(status) if status.success() => {}
        Some(_) => view::tell_ended_early(folder),
        None => tell!("vigil: the viewer is far behind and is left there; `vigil view` opens the whole flight"),
    }
    Ok(())
}

fn summarise(
    course: &Course,
    flight: &Option<Status>,
    folder: &Path,
    (of_firmware, of_adversary): &(String, Option<String>),
    interrupted: bool,
) -> Result<ExitCode> {
    let Some(status) = flight else {
        say!("no flight: interrupted before anything was reported");
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    };
    let paint = Paint::stdout();
    let success = status.outcome == Some(Outcome::Success);
    let verdict = match (ending(status), interrupted) {
        (Some(text), _) => text,
        (None, true) => format!("interrupted {:.1} m from the goal", status.goal_distance_m),
        (None, false) => match &status.pose {
            Some(pose) => format!("no verdict: {pose}; the flight is to be flown anew"),
            None => "no outcome".to_owned(),
        },
    };
    say!("{} on {}", paint.verdict(success, &verdict), course.name);
    if success {
        match status.armed {
            true if interrupted => say!("vehicle   still armed: interrupted while it landed"),
            true => say!("vehicle   still armed: it did not land in time"),
            false => say!("vehicle   landed, disarmed"),
        }
    }
    for line in of_firmware.lines().filter(|l| !l.trim().is_empty()) {
        say!("{line}");
    }
    if let Some(said) = of_adversary {
        say!("adversary {}", adversary_in_words(said));
    }
    let report = find_log(folder).map(|log| flight_report::beside(&log));
    if let Some(report) = report.ok().filter(|path| path.is_file()) {
        say!("report    {}", report.display());
    }
    say!("files     {}", folder.display());
    Ok(ExitCode::from(match (status.outcome, interrupted) {
        (outcome @ Some(_), _) => ending_code(outcome),
        (None, true) => EXIT_INTERRUPTED,
        (None, false) if status.pose.is_some() => ending_code(None),
        (None, false) => EXIT_ERROR,
    }))
}
