//! `vigil fly`: one flight in real time, simulator and firmware as processes of their own.

use crate::cli::family;
use crate::cli::foreign::{ForeignArgs, PilotWatch, PoseWatch, start_sensor};
use crate::cli::lab;
use crate::cli::live::Live;
use crate::cli::log::film_name;
use crate::cli::output::{self, EXIT_ERROR, EXIT_INTERRUPTED, Interrupt, Paint, say, tell};
use crate::cli::pilot::{PilotArgs, SecondSensorArgs};
use crate::cli::view::ViewerArgs;
use crate::flight_derived::{Wanted, derive};
use crate::flight_report::{self, EXPLAINED};
use anyhow::{Context, Result, bail, ensure};
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, IsTerminal, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use vigil_adversary::AttackArgs;
use vigil_adversary::process::RAW_TOPIC;
use vigil_firmware::FirmwareConfig;
use vigil_firmware::arguments::choice;
use vigil_log::SideLog;
use vigil_sim::program::{Status, ending_code};
use vigil_sim::world::{Course, FlightPath};
use vigil_sim::{CourseChoice, SensorFault, VehicleChoice};
use vigil_types::{Attitude, Choice, LogContent, Nanos, NedVector};

/// What simulator and adversary know besides the firmware's log, until it is put into it.
const SIMULATOR_NOTES: &str = "simulator.part";
const ADVERSARY_NOTES: &str = "adversary.part";
/// After reaching the goal the vehicle may take this long to land.
const LANDING_LIMIT: Duration = Duration::from_secs(30);
/// A vehicle that flew and stands disarmed for so long does not go on: its autopilot, or a person, ended the flight.
const DISARMED_LIMIT: Duration = Duration::from_secs(5);
/// Above this height it flies, metres.
const FLIES_M: f32 = 1.0;
/// Diagnostics of a child beyond this are not shown.
const SIZE_LIMIT: u64 = 1 << 20;
/// A simulator that says nothing for so long is given up.
const SILENCE_LIMIT: Duration = Duration::from_secs(5);
/// A child that was asked to end gets this long before it is killed.
const END_LIMIT: Duration = Duration::from_secs(5);

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
Exit code: 0 goal reached, 10 collision, 11 out of bounds, 12 time-out, 13 no flight, 1 error, 130 interrupted.")]
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

impl Default for FlyArgs {
    fn default() -> Self {
        Self {
            course: CourseChoice::default(),
            instance: 0,
            config: None,
            vehicle: VehicleChoice::default(),
            foreign: ForeignArgs::default(),
            pilot: PilotArgs::default(),
            attack: AttackArgs::default(),
            sensor_fault: None,
            second_sensor: SecondSensorArgs::default(),
            frame_key: None,
            view: false,
            viewer: ViewerArgs::default(),
            record: None,
            log_content: LogContent::default(),
            quiet: false,
            log: PathBuf::from("runs"),
        }
    }
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
    if args.view {
        args.viewer.check_with_port()?;
    }
    if let Some(film) = &args.record {
        lab::check_film(film)?;
        output::prepare(film)?;
    }
    let interrupt = Interrupt::on_ctrl_c()?;
    let folder = make_folder(&args.log, seed)?;
    let course_file = folder.join("course.toml");
    course.save(&course_file)?;
    let scene_file = folder.join("scene.json");
    crate::cli::scene::of(&course).save(&scene_file)?;

    // What simulator and sensor have in common.
    let world = |c: &mut Command| {
        c.arg("--status").arg("--course").arg(&course_file);
        c.args(["--seed", &seed.to_string(), "--instance", &args.instance.to_string()]);
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
        true => start_sensor(&args.foreign, &folder, args.instance, world)?,
        false => Process::start("simulator", &folder, |c| {
            c.arg("sim");
            c.arg(format!("--second-sensor-heads={}", args.second_sensor.heads));
            args.vehicle.hand_on(c);
            world(c);
        })?,
    };
    let statuses = read_statuses(&mut simulator)?;
    let goal = course.goal_ned_m();
    let adversary = args.attack.attack.map(|_| {
        Process::start("adversary", &folder, |c| {
            c.arg("adversary").args(["--instance", &args.instance.to_string()]);
            c.args(["--seed", &seed.to_string()]);
            c.arg(format!("--goal={},{}", goal.x, goal.y))
                .arg(format!("--height={}", -goal.z));
            if let Some(file) = args.pilot.actor_file() {
                c.arg("--actor").arg(file);
            }
            args.attack.hand_on(c);
            c.arg("--record").arg(folder.join(ADVERSARY_NOTES));
        })
        .map(Process::listening)
    });
    let mut adversary = adversary.transpose()?;
    let mut firmware = Process::start("firmware", &folder, |c| {
        c.arg("firmware").args(["--instance", &args.instance.to_string()]);
        c.args(["--engage", "auto", "--at-goal", "land"]);
        c.arg(format!("--goal={},{}", goal.x, goal.y))
            .arg(format!("--height={}", -goal.z));
        if let Some(key) = &args.frame_key {
            c.arg("--frame-key").arg(key);
        }
        c.arg("--log").arg(&folder).arg("--scene").arg(&scene_file);
        c.args(["--log-content", args.log_content.name()]);
        args.foreign.firmware(c, args.instance);
        match args.second_sensor.heads {
            0 => args.pilot.hand_on(c),
            _ => args.pilot.with_second_sensor().hand_on(c),
        }
    })?
    .listening();

    let title = match &args.course.course {
        Some(file) => format!("course {}", file.display()),
        None => format!("{:?} course {seed}", args.course.family).to_lowercase(),
    };
    let mut viewer = args.view.then(|| args.viewer.follow(&folder)).transpose()?;
    let terminal = if args.quiet {
        Terminal::Quiet
    } else if std::io::stderr().is_terminal() {
        let columns = console_columns();
        Terminal::Live(Box::new(Live::new(title, &course, threshold(args, &course), columns)))
    } else {
        Terminal::Lines(title)
    };
    let watched = watch(&terminal, &statuses, &mut simulator, &mut firmware, &interrupt);
    // The firmware ends first, so that its last setpoints still find a vehicle and its log is closed properly.
    let firmware_said = firmware.end()?;
    simulator.end()?;
    let adversary_said = adversary.as_mut().map(Process::end).transpose()?;
    let Flight { last, path, truth } = watched?;
    // The path ends with the flight, the truth with the watch.
    let ended_ns = truth.get(path.len()).map(|pose| pose.at_ns);
    let outcome = last
        .as_ref()
        .and_then(|s| s.outcome.as_deref())
        .and_then(|name| name.parse().ok());
    let drawn = FlightPath {
        label: "flown".to_owned(),
        points_ned_m: path,
        outcome,
    };
    vigil_sim::world::draw(&course, &[drawn]).write_png(&folder.join("flight.png"))?;
    let about = about(args, &course, seed, last.as_ref(), ended_ns);
    if let Err(error) = complete_log(&folder, &truth, &about, args.log_content) {
        // The flight is over and its log is as the firmware left it.
        tell!("vigil: {}", vigil_firmware::program::told(&error));
    }
    let film = args.record.as_deref().map(|to| lab::film(&folder, to, &course.name));
    if let Some(script) = &mut viewer {
        end_viewer(script, &folder)?;
    }
    let code = summarise(
        &course,
        &last,
        &folder,
        (&firmware_said, adversary_said.as_deref()),
        interrupt.came(),
    )?;
    match film {
        None => {}
        Some(Ok(told)) => say!("film      {}", told.trim_end()),
        // The flight has its own end; the film can be made of its log again.
        Some(Err(error)) => tell!("vigil: {}", vigil_firmware::program::told(&error)),
    }
    Ok(code)
}

/// Puts what only the simulation knows into the flight's log, and makes the report beside it.
fn complete_log(
    folder: &Path,
    truth: &[TruePose],
    about: &BTreeMap<String, String>,
    content: LogContent,
) -> Result<()> {
    let log = crate::cli::replay::find_log(folder)?;
    let truth_file = folder.join(SIMULATOR_NOTES);
    let mut notes = SideLog::create(&truth_file)?;
    for pose in truth {
        notes.truth(pose.at_ns, pose.position_ned_m, Some(pose.attitude))?;
    }
    notes.finish()?;
    let adversary_file = folder.join(ADVERSARY_NOTES);
    let sides: Vec<&Path> = [&truth_file, &adversary_file]
        .into_iter()
        .map(PathBuf::as_path)
        .filter(|path| path.is_file())
        .collect();
    let merged = vigil_log::merge_into(&log, &sides, about);
    for side in sides {
        // Their content is in the log; one that stays behind does no harm.
        let _ = std::fs::remove_file(side);
    }
    merged?;
    if content != LogContent::Light {
        derive(&log, Wanted { map: true, shap: false })?;
    }
    let report = flight_report::beside(&log);
    crate::cli::log::write_report(&log, &report, EXPLAINED)?;
    Ok(())
}

/// What is known of the flight as a whole, for its log.
fn about(
    args: &FlyArgs,
    course: &Course,
    seed: u64,
    last: Option<&Status>,
    ended_ns: Option<Nanos>,
) -> BTreeMap<String, String> {
    let mut about = BTreeMap::from([
        ("course".to_owned(), course.name.clone()),
        ("seed".to_owned(), seed.to_string()),
        ("command".to_owned(), command_again(args, seed)),
    ]);
    if let Some(commit) = crate::cli::output::git_commit() {
        about.insert("git_commit".to_owned(), commit);
    }
    if let Some(vehicle) = args.foreign.in_words().or_else(|| args.vehicle.name()) {
        about.insert("vehicle".to_owned(), vehicle);
    }
    if let Some(attack) = args.attack.attack {
        about.insert("attack".to_owned(), attack.name().to_owned());
    }
    if let Some(outcome) = last.and_then(|s| s.outcome.as_ref().map(|outcome| (outcome, s))) {
        let (outcome, status) = outcome;
        let text = format!(
            "{outcome} after {:.1} s and {:.1} m",
            status.flight_time_s, status.path_length_m
        );
        about.insert("outcome".to_owned(), text);
    }
    if let Some(ended_ns) = ended_ns {
        about.insert("ended_ns".to_owned(), ended_ns.to_string());
    }
    about
}

/// The command that flies the same again, with the seed that was drawn.
fn command_again(args: &FlyArgs, seed: u64) -> String {
    let drawn = ["--seed".to_owned(), seed.to_string()];
    let (dropped, added): (&[&str], &[String]) = match args.course.course {
        // The course's file is named; the seed decides on noise and the adversary.
        Some(_) => (&["-o", "--log", "--record"], &[]),
        None => (&["-o", "--log", "--record", "--seed"], &drawn),
    };
    flight_report::command_again(std::env::args(), "fly", dropped, added)
}

fn make_folder(parent: &Path, seed: u64) -> Result<PathBuf> {
    let stamp = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    vigil_types::files::make_new_folder(parent, &format!("fly-{stamp}-{seed}"))
        .with_context(|| format!("cannot make a folder in {}", parent.display()))
}

/// What the adversary's last line says. One that was killed has none; the flight went on or held without frames.
fn adversary_in_words(said: &str) -> String {
    let Some(record) = said
        .lines()
        .rev()
        .find_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
    else {
        return "ended without a report: see adversary.log".to_owned();
    };
    let number = |key: &str| record[key].as_u64().unwrap_or(0);
    let (frames, attacked, effective) = (number("frames"), number("attacked_steps"), number("effective_steps"));
    if attacked == 0 {
        return format!("altered none of {frames} frames: the flight ended before its burst began");
    }
    let mut text = format!(
        "altered {attacked} of {frames} frames, from step {} on; the actor's yaw decision moved by 1.0 (30 °/s) or more in {effective} of \
         them ({:.0} %), by {:.2} on average",
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

/// A child that is asked to end, and killed if it does not, however this program ends.
pub struct Process {
    name: &'static str,
    child: Child,
    /// Its diagnostics.
    stderr_file: PathBuf,
    /// What it reports on standard output, read while it runs; the simulator's statuses are read elsewhere.
    report: Option<JoinHandle<String>>,
}

impl Process {
    /// Starts this program again as `name`, arranged; what it says on standard error goes to a file in the folder.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(name: &'static str, folder: &Path, arrange: impl FnOnce(&mut Command)) -> Result<Self> {
        let program = std::env::current_exe().context("cannot find this program's own file")?;
        let stderr_file = folder.join(format!("{name}.log"));
        let log = File::create(&stderr_file).with_context(|| format!("cannot write {}", stderr_file.display()))?;
        let mut command = Command::new(program);
        command.args(family::arguments());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(log);
        arrange(&mut command);
        let child = command.spawn().with_context(|| format!("cannot start the {name}"))?;
        Ok(Self {
            name,
            child,
            stderr_file,
            report: None,
        })
    }

    /// Keeps what it reports until it ends.
    fn listening(mut self) -> Self {
        self.report = self.child.stdout.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut text = String::new();
                // What is no text, or comes after a failure, is no report.
                let _ = pipe.read_to_string(&mut text);
                text
            })
        });
        self
    }

    /// Looks whether the child still runs.
    ///
    /// # Errors
    /// It has ended, with the last of what it said.
    pub fn check(&mut self) -> Result<()> {
        if let Some(status) = self.child.try_wait()? {
            let said = self.said();
            let lines: Vec<&str> = said.lines().collect();
            let tail = lines[lines.len().saturating_sub(6)..].join("\n  ");
            bail!("the {} ended in flight ({status}); it said last:\n  {tail}", self.name);
        }
        Ok(())
    }

    fn said(&self) -> String {
        vigil_types::files::read_text(&self.stderr_file, SIZE_LIMIT).unwrap_or_default()
    }

    /// Ends the child and returns what it reported.
    ///
    /// # Errors
    /// The system's.
    pub fn end(&mut self) -> Result<String> {
        if self.child.try_wait()?.is_none() {
            let pid = rustix::process::Pid::from_child(&self.child);
            rustix::process::kill_process(pid, rustix::process::Signal::TERM)?;
            let asked = Instant::now();
            while self.child.try_wait()?.is_none() {
                if asked.elapsed() > END_LIMIT {
                    tell!(
                        "vigil: the {} did not end within {} s and is killed",
                        self.name,
                        END_LIMIT.as_secs()
                    );
                    self.child.kill()?;
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        // The reader does not panic, and ends with the pipe.
        Ok(self
            .report
            .take()
            .and_then(|reader| reader.join().ok())
            .unwrap_or_default())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            // Nothing can be done about a child that cannot be killed.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// The simulator's statuses, as they come.
///
/// # Errors
/// They are read already.
pub fn read_statuses(simulator: &mut Process) -> Result<Receiver<Status>> {
    let pipe = simulator.child.stdout.take().context("the simulator has no output")?;
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            match serde_json::from_str(&line) {
                Ok(status) => {
                    if sender.send(status).is_err() {
                        break;
                    }
                }
                Err(error) => tracing::warn!("the simulator said something unreadable: {error}: {line}"),
            }
        }
    });
    Ok(receiver)
}

/// A true pose.
struct TruePose {
    at_ns: Nanos,
    position_ned_m: NedVector,
    attitude: Attitude,
}

/// What was seen of a flight.
#[derive(Default)]
struct Flight {
    last: Option<Status>,
    /// True poses up to the end of the watch.
    truth: Vec<TruePose>,
    /// True positions up to the ending.
    path: Vec<NedVector>,
}

/// What is shown while it flies.
enum Terminal {
    /// Nothing.
    Quiet,
    /// A line every two seconds, under this title.
    Lines(String),
    /// A picture that is drawn anew.
    Live(Box<Live>),
}

/// Columns of the terminal.
fn console_columns() -> usize {
    rustix::termios::tcgetwinsize(std::io::stderr()).map_or(80, |size| usize::from(size.ws_col).max(20))
}

/// The detector's threshold, if it flies.
fn threshold(args: &FlyArgs, course: &Course) -> Option<f32> {
    let mut config = FirmwareConfig::to_goal(course.goal_ned_m());
    args.pilot.apply(&mut config);
    config.flight_info().detector_threshold
}

/// The script ends with the log; the viewer that it opened stays.
fn end_viewer(script: &mut Child, folder: &Path) -> Result<()> {
    let asked = Instant::now();
    let status = loop {
        match script.try_wait()? {
            Some(status) => break Some(status),
            None if asked.elapsed() > END_LIMIT => break None,
            None => std::thread::sleep(Duration::from_millis(50)),
        }
    };
    match status {
        Some(status) if status.success() => {}
        Some(_) => tell!(
            "vigil: the viewer ended early: see {}",
            folder.join("viewer.log").display()
        ),
        None => {
            tell!("vigil: the viewer is far behind and is left there; `vigil view` opens the whole flight");
            script.kill()?;
            script.wait()?;
        }
    }
    Ok(())
}

/// Follows the flight until it is over.
fn watch(
    terminal: &Terminal,
    statuses: &Receiver<Status>,
    simulator: &mut Process,
    firmware: &mut Process,
    interrupt: &Interrupt,
) -> Result<Flight> {
    let bar = ProgressBar::new_spinner().with_style(ProgressStyle::with_template("{msg}")?);
    let mut flight = Flight::default();
    let mut last_printed_s = f64::NEG_INFINITY;
    let mut reached_at: Option<Instant> = None;
    let (mut has_flown, mut disarmed_at) = (false, None::<Instant>);
    let (mut pose, mut pilot) = (PoseWatch::default(), PilotWatch::default());
    while !interrupt.came() {
        match statuses.recv_timeout(SILENCE_LIMIT) {
            Ok(status) => {
                match terminal {
                    Terminal::Live(live) => {
                        bar.set_message(live.picture(&flight.path, &status));
                        bar.tick();
                    }
                    Terminal::Lines(title) if status.time_s - last_printed_s >= 2.0 => {
                        tell!("{title}  {}", state_line(&status));
                        last_printed_s = status.time_s;
                    }
                    Terminal::Lines(_) | Terminal::Quiet => {}
                }
                // Of a foreign vehicle that cannot be placed there is nothing to keep.
                if status.pose.is_none() {
                    let [x, y, z] = status.position_ned_m;
                    if status.outcome.is_none() {
                        flight.path.push(NedVector::new(x, y, z));
                    }
                    let [qw, qx, qy, qz] = status.attitude;
                    flight.truth.push(TruePose {
                        at_ns: status.at_ns,
                        position_ned_m: NedVector::new(x, y, z),
                        attitude: Attitude {
                            w: qw,
                            x: qx,
                            y: qy,
                            z: qz,
                        },
                    });
                }
                flight.last = Some(status);
            }
            Err(RecvTimeoutError::Timeout) => {
                bail!("the {} said nothing for {} s", simulator.name, SILENCE_LIMIT.as_secs())
            }
            Err(RecvTimeoutError::Disconnected) => {
                // Its pipe closes a moment before its exit status can be read.
                std::thread::sleep(Duration::from_millis(200));
                simulator.check()?;
                bail!("the {} closed its output", simulator.name);
            }
        }
        firmware.check()?;
        let Some(status) = &flight.last else { continue };
        if pose.observe(status)? {
            break;
        }
        if let Some(advice) = pilot.observe(status) {
            bar.suspend(|| say!("{advice}"));
        }
        match status.outcome.as_deref() {
            Some("success") => {
                let since = reached_at.get_or_insert_with(Instant::now);
                if !status.armed || since.elapsed() > LANDING_LIMIT {
                    break;
                }
            }
            Some(_) => break,
            None => {
                has_flown |= status.armed && status.position_ned_m[2] < -FLIES_M;
                let landed = has_flown && !status.armed && status.position_ned_m[2] > -FLIES_M;
                disarmed_at = disarmed_at.or_else(|| Some(Instant::now())).filter(|_| landed);
                if disarmed_at.is_some_and(|at| at.elapsed() > DISARMED_LIMIT) {
                    bar.suspend(|| {
                        say!(
                            "landed     the vehicle landed and disarmed {:.1} m from the goal",
                            status.goal_distance_m
                        )
                    });
                    break;
                }
            }
        }
    }
    bar.finish_and_clear();
    Ok(flight)
}

/// Where the vehicle is and what guidance does, in a line.
pub(super) fn state_line(s: &Status) -> String {
    if let Some(pose) = &s.pose {
        return format!("{:5.1} s  no frames: {pose}", s.time_s);
    }
    let guidance = match (&s.guidance, s.reasons.is_empty()) {
        (None, _) => "no firmware yet".to_owned(),
        (Some(state), true) => state.clone(),
        (Some(state), false) => format!("{state} ({})", s.reasons.join(", ")),
    };
    format!(
        "{:5.1} s  {:5.1} m to goal  {:.1} m/s  {:<8}  {guidance}  step {:.0} us, {} missed",
        s.time_s, s.goal_distance_m, s.speed_m_s, s.mode, s.step_us, s.slips
    )
}

/// The report of the flight, if there is one.
fn report(folder: &Path) -> Option<PathBuf> {
    let log = crate::cli::replay::find_log(folder).ok()?;
    Some(flight_report::beside(&log)).filter(|path| path.is_file())
}

fn summarise(
    course: &Course,
    flight: &Option<Status>,
    folder: &Path,
    (firmware_said, adversary_said): (&str, Option<&str>),
    interrupted: bool,
) -> Result<ExitCode> {
    let Some(status) = flight else {
        say!("no flight: interrupted before anything was reported");
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    };
    let paint = Paint::stdout();
    let success = status.outcome.as_deref() == Some("success");
    let verdict = match (&status.outcome, interrupted) {
        (Some(outcome), _) => {
            format!(
                "{outcome} after {:.1} s and {:.1} m",
                status.flight_time_s, status.path_length_m
            )
        }
        (None, true) => format!("interrupted {:.1} m from the goal", status.goal_distance_m),
        (None, false) => match &status.pose {
            Some(pose) => format!("no verdict: {pose}; the flight is to be flown anew"),
            None => "no outcome".to_owned(),
        },
    };
    say!("{} on {}", paint.verdict(success, &verdict), course.name);
    if success {
        say!(
            "vehicle   {}",
            if status.armed {
                "still armed: it did not land in time"
            } else {
                "landed, disarmed"
            }
        );
    }
    for line in firmware_said.lines().filter(|l| !l.trim().is_empty()) {
        say!("{line}");
    }
    if let Some(said) = adversary_said {
        say!("adversary {}", adversary_in_words(said));
    }
    if let Some(report) = report(folder) {
        say!("report    {}", report.display());
    }
    say!("files     {}", folder.display());
    Ok(ExitCode::from(match (&status.outcome, interrupted) {
        (Some(outcome), _) => ending_code(outcome.parse().ok()),
        (None, true) => EXIT_INTERRUPTED,
        (None, false) if status.pose.is_some() => ending_code(None),
        (None, false) => EXIT_ERROR,
    }))
}
