//! `vigil bench`: what this machine makes of the loop.

use crate::cli::child_process::{Process, next_status, read_statuses};
use crate::cli::output::{self, EXIT_DIFFERS, Interrupt, say};
use crate::flight_report::command_again;
use crate::realtime_bench::{Machine, ObservedStep, ProcessorTime, RealtimeReport, RunFacts, ThreadCounters, Work};
use crate::report::Picture as _;
use anyhow::{Context, Result, ensure};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vigil_firmware::FirmwareConfig;
use vigil_firmware::arguments::{PilotArgs, help, number};
use vigil_firmware::live_loop::LiveLoop;
use vigil_firmware::realtime::Granted;
use vigil_io::clock::monotonic_ns;
use vigil_sim::CourseChoice;
use vigil_types::{STEP_NS, parameters};

/// A simulator that says nothing for so long is given up: it may have to wait for a processor behind the load.
const SILENCE_LIMIT: Duration = Duration::from_secs(30);
/// Reports beyond this are not read.
const SIZE_LIMIT: u64 = 1 << 20;

/// Arguments of `vigil bench`.
#[derive(Debug, Clone, clap::Args)]
pub struct BenchArgs {
    #[command(subcommand)]
    what: Bench,
}

#[derive(Debug, Clone, clap::Subcommand)]
enum Bench {
    /// Fly in real time and tell how punctual the loop is on this machine, what made it late, and what would help.
    Realtime(RealtimeArgs),
}

/// Arguments of `vigil bench realtime`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil bench realtime                          a minute, with whatever else runs
  vigil bench realtime --minutes 60 --load 'taskset -c 1 stress-ng --cpu 1 --vm 1 --vm-bytes 1G --hdd 1'
                                                an hour beside a load on processor 1
  vigil bench realtime --priority 0             without FIFO priority and locked memory
  vigil bench realtime -o pi.json --figure pi.svg
  vigil bench realtime --from pi.json --figure pi.png
                                                an earlier run again

It flies course after course against the simulator, with log and everything else as in flight. FIFO priority and locked memory need
rights (docs/real-time.md); without them it measures what a flight without them would have.
Exit code: 0 no step was missed, 3 steps were missed, 1 it could not fly or its load ended, 130 interrupted (what was measured
until then is shown in each case).")]
struct RealtimeArgs {
    /// How long to fly, minutes.
    #[arg(long, value_name = "MINUTES", default_value_t = 1.0, value_parser = minutes)]
    minutes: f64,

    /// A shell command that runs meanwhile, to load the machine; it is ended with the run.
    #[arg(long, value_name = "COMMAND")]
    load: Option<String>,

    /// Course to fly; of generated ones each flight takes the next seed.
    #[command(flatten)]
    course: CourseChoice,

    /// Number of this set of processes; ports and shared memory follow from it.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=99))]
    instance: u32,

    /// Who decides.
    #[command(flatten)]
    pilot: PilotArgs,

    /// Folder in which a folder for the flight logs is made, and removed at the end.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    log: PathBuf,

    #[arg(long, value_name = "PRIORITY", value_parser = number::<u8>(&parameters::PRIORITY), help = help(&parameters::PRIORITY))]
    priority: Option<u8>,

    /// Where the report goes as JSON; `-` is standard output.
    #[arg(short = 'o', long, value_name = "FILE")]
    json: Option<PathBuf>,

    /// Draw the histograms.
    #[arg(long, value_name = "FILE.svg|png", value_parser = figure_name)]
    figure: Option<PathBuf>,

    /// Tell and draw an earlier report instead of flying.
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["minutes", "load", "priority", "json"])]
    from: Option<PathBuf>,
}

fn minutes(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(minutes) if (0.05..=1440.0).contains(&minutes) => Ok(minutes),
        _ => Err("give minutes from 0.05 to 1440".to_owned()),
    }
}

fn figure_name(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let ending = path.extension();
    match ending.is_some_and(|ending| ending == "svg" || ending == "png") {
        true => Ok(path),
        false => Err("give a file that ends in .svg or .png".to_owned()),
    }
}

/// Runs `vigil bench`.
///
/// # Errors
/// A process that cannot be started, an earlier report that cannot be read, a file that cannot be written.
pub fn run(args: &BenchArgs) -> Result<ExitCode> {
    let Bench::Realtime(args) = &args.what;
    for file in args.json.iter().chain(&args.figure) {
        output::prepare(file)?;
    }
    let interrupt = Interrupt::on_ctrl_c()?;
    let report = match &args.from {
        Some(file) => read(file)?,
        None => measure(args, &interrupt)?,
    };
    say!("{report}");
    if let Some(file) = &args.json {
        output::write(file, serde_json::to_string_pretty(&report)? + "\n")?;
    }
    if let Some(file) = &args.figure {
        match file.extension().is_some_and(|ending| ending == "png") {
            true => output::write(file, report.figure().png())?,
            false => output::write(file, report.figure().svg())?,
        }
    }
    if let (None, Some(reason)) = (&args.from, &report.run.ended_early) {
        anyhow::bail!(
            "the run ended after {:.1} of {} minutes: {reason}",
            report.run.minutes,
            args.minutes
        );
    }
    Ok(match report.missed {
        _ if interrupt.came() => interrupt.exit_code(),
        0 => ExitCode::SUCCESS,
        _ => ExitCode::from(EXIT_DIFFERS),
    })
}

fn read(file: &Path) -> Result<RealtimeReport> {
    let text =
        vigil_types::files::read_text(file, SIZE_LIMIT).with_context(|| format!("cannot read {}", file.display()))?;
    serde_json::from_str(&text)
        .with_context(|| format!("{} is no report of `vigil bench realtime --json`", file.display()))
}

fn measure(args: &RealtimeArgs, interrupt: &Interrupt) -> Result<RealtimeReport> {
    let folder = vigil_types::files::make_new_folder(&args.log, "bench")
        .with_context(|| format!("cannot make a folder in {}", args.log.display()))?;
    let seed = args.course.seed_or_random();
    let length = Duration::from_secs_f64(args.minutes * 60.0);
    // Everything that is measured has its place before the start.
    let steps = length.as_nanos() as usize / STEP_NS as usize + 1000;
    let mut bench = RealtimeBench {
        args,
        interrupt,
        folder: folder.clone(),
        began_ns: monotonic_ns(),
        ends: Instant::now() + length,
        steps: Vec::with_capacity(steps),
        granted: None,
    };
    let drawn = ["--seed", &seed.to_string()];
    let mut run = RunFacts {
        command: command_again(
            std::env::args_os(),
            "bench",
            &["-o", "--json", "--figure"],
            if args.course.seed.is_none() { &drawn } else { &[] },
        ),
        load: args.load.clone(),
        machine: Machine::here(),
        ..RunFacts::default()
    };
    let mut load = args.load.as_deref().map(Load::start).transpose()?;
    let before = ProcessorTime::now();
    let mut flight = 0;
    while !interrupt.came() && Instant::now() < bench.ends {
        match bench.fly(seed.wrapping_add(flight), load.as_mut()) {
            Ok(outcome) => *run.flights.entry(outcome).or_default() += 1,
            // What was measured until then holds, and is shown.
            Err(error) if bench.granted.is_some() && !bench.steps.is_empty() => {
                run.ended_early = Some(format!("{error:#}"));
                break;
            }
            Err(error) => {
                let _ = std::fs::remove_dir_all(&folder);
                return Err(error);
            }
        }
        flight += 1;
    }
    run.busy = ProcessorTime::now().busy_since(&before);
    drop(load);
    // The logs were written as in any flight, and are of no use to anybody.
    std::fs::remove_dir_all(&folder).with_context(|| format!("cannot remove {}", folder.display()))?;
    let granted = bench.granted.context("the loop did not run: give it more minutes")?;
    run.fifo = granted.fifo.as_ref().ok().copied();
    run.locked = granted.locked.is_ok();
    run.granted = granted.to_string();
    run.minutes = bench.steps.len() as f64 * STEP_NS as f64 * 1e-9 / 60.0;
    Ok(RealtimeReport::of(run, &bench.steps))
}

/// Flights one after another, whose steps are kept.
struct RealtimeBench<'a> {
    args: &'a RealtimeArgs,
    interrupt: &'a Interrupt,
    folder: PathBuf,
    began_ns: u64,
    ends: Instant,
    steps: Vec<ObservedStep>,
    granted: Option<Granted>,
}

impl RealtimeBench<'_> {
    /// One flight, to its end or the run's; how it ended.
    ///
    /// # Errors
    /// A process that cannot be started or ends too early, the load among them.
    fn fly(&mut self, seed: u64, mut load: Option<&mut Load>) -> Result<String> {
        let (args, interrupt, ends) = (self.args, self.interrupt, self.ends);
        let course = args.course.load(seed)?;
        let folder = vigil_types::files::make_new_folder(&self.folder, &seed.to_string())?;
        let course_file = folder.join("course.toml");
        course.save(&course_file)?;
        let mut config = FirmwareConfig::to_goal(course.goal_ned_m());
        config.instance = args.instance;
        args.pilot.apply(&mut config);
        config.rate.priority = args.priority.unwrap_or(config.rate.priority);
        config.log.directory = Some(folder.clone());
        let mut simulator = Process::start("simulator", &folder, |c| {
            c.args(["sim", "--status", "--course"]).arg(&course_file);
            c.args(["--seed", &seed.to_string(), "--instance", &args.instance.to_string()]);
        })?;
        let statuses = read_statuses(&mut simulator)?;
        let stop = AtomicBool::new(false);
        let (granted, monitored) = std::thread::scope(|scope| {
            let looping = std::thread::Builder::new()
                .name("loop".to_owned())
                .stack_size(vigil_tools::threads::STACK_BYTES)
                .spawn_scoped(scope, || self.run_loop(&config, &stop))?;
            let mut watch = || -> Result<String> {
                let mut heard = Instant::now();
                while !interrupt.came() && Instant::now() < ends && !looping.is_finished() {
                    if let Some(load) = &mut load {
                        load.check()?;
                    }
                    let Some(status) = next_status(&mut simulator, &statuses, "in flight")? else {
                        let limit_s = SILENCE_LIMIT.as_secs();
                        ensure!(
                            heard.elapsed() < SILENCE_LIMIT,
                            "the simulator said nothing for {limit_s} s"
                        );
                        continue;
                    };
                    heard = Instant::now();
                    if let Some(outcome) = status.outcome {
                        return Ok(outcome.to_string());
                    }
                }
                Ok("cut short".to_owned())
            };
            let monitored = watch();
            stop.store(true, Ordering::Relaxed);
            let granted = looping
                .join()
                .map_err(|_| anyhow::anyhow!("the loop's thread failed"))??;
            Ok::<_, anyhow::Error>((granted, monitored))
        })?;
        self.granted = Some(granted);
        let outcome = monitored?;
        simulator.end()?;
        std::fs::remove_dir_all(&folder).with_context(|| format!("cannot remove {}", folder.display()))?;
        Ok(outcome)
    }

    /// The loop as in `vigil firmware`, each step looked at from outside once it has ended.
    fn run_loop(&mut self, config: &FirmwareConfig, stop: &AtomicBool) -> Result<Granted> {
        let mut flight = LiveLoop::open(config)?;
        let mut counters = ThreadCounters::open()?;
        let granted = flight.start();
        let (mut counted, mut missed, mut frame, mut held_up) = (counters.read(), 0, None, false);
        while !stop.load(Ordering::Relaxed) && self.steps.len() < self.steps.capacity() {
            let report = flight.step();
            let mut step = ObservedStep {
                at_ns: report.now_ns.saturating_sub(self.began_ns),
                late_ns: report.timing.wake_late_ns,
                missed: report.timing.slips - missed,
                held_up,
                work: Work::of(report, frame),
                ..ObservedStep::default()
            };
            (missed, frame) = (report.timing.slips, report.frame_sequence);
            step.took_ns = flight.last_execution_ns();
            held_up = step.late_ns + step.took_ns > STEP_NS;
            let now = counters.read();
            step.counted = now.since(&counted);
            counted = now;
            self.steps.push(step);
        }
        let _ = flight.finish();
        Ok(granted)
    }
}

/// A load that runs in a process group of its own, ended when it is dropped.
struct Load(Child);

impl Load {
    fn start(command: &str) -> Result<Self> {
        let child = Command::new("sh")
            .args(["-c", command])
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .context("cannot start a shell for the load")?;
        Ok(Self(child))
    }

    /// Fails when the load has ended: what came after would have been measured without it.
    fn check(&mut self) -> Result<()> {
        match self.0.try_wait()? {
            None => Ok(()),
            Some(status) => {
                anyhow::bail!("the load ended before the run did ({status}): give a command that lasts as long")
            }
        }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        // Of a load that has gone there is nothing to end.
        if let Ok(None) = self.0.try_wait() {
            let group = rustix::process::Pid::from_child(&self.0);
            let _ = rustix::process::kill_process_group(group, rustix::process::Signal::TERM);
            let _ = self.0.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_that_ends_early_is_reported_and_one_that_lasts_is_ended_with_all_its_children() {
        let mut short = Load::start("true").unwrap();
        let _ = short.0.wait();
        assert!(short.check().unwrap_err().to_string().contains("the load ended"));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pid");
        let mut lasting = Load::start(&format!("sleep 600 & echo $! > {}; wait", file.display())).unwrap();
        let child = loop {
            match std::fs::read_to_string(&file).unwrap_or_default().trim().parse::<u32>() {
                Ok(pid) => break pid,
                Err(_) => std::thread::sleep(Duration::from_millis(10)),
            }
        };
        lasting.check().unwrap();
        drop(lasting);
        // It may be nobody's child any more, but it does not run.
        let ran_on = || std::fs::read_to_string(format!("/proc/{child}/stat")).is_ok_and(|stat| !stat.contains(") Z "));
        let asked = Instant::now();
        while ran_on() && asked.elapsed() < Duration::from_secs(60) {
            std::thread::sleep(Duration::from_millis(10));
        }
        assert!(!ran_on());
    }

    #[test]
    fn what_makes_no_sense_is_refused_with_what_does() {
        assert_eq!((minutes("60"), minutes("0.05")), (Ok(60.0), Ok(0.05)));
        for text in ["0", "-1", "1441", "NaN", "long"] {
            assert!(minutes(text).unwrap_err().contains("0.05 to 1440"), "{text}");
        }
        assert!(figure_name("a.svg").is_ok() && figure_name("b/c.png").is_ok());
        assert!(figure_name("a.pdf").unwrap_err().contains(".svg or .png"));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("other.json");
        std::fs::write(&file, "{\"steps\": 3}").unwrap();
        let refusal = vigil_firmware::program::in_one_line(&read(&file).unwrap_err());
        assert!(
            refusal.contains("other.json is no report of `vigil bench realtime --json`"),
            "{refusal}"
        );
    }
}
