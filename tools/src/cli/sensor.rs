//! `vigil sensor`: what a driver's author needs.

use crate::cli::adapter::{self, DepthStreamArgs, OusterArgs, ServiceArgs};
use crate::cli::output::{self, Paint, say, tell};
use crate::sensor_check::{Finding, SensorCheck, Severity};
use anyhow::Result;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use vigil_io::clock::monotonic_ns;
use vigil_io::key_file::frame_keys;
use vigil_io::shared_memory::{Domain, FrameSubscriber};
use vigil_types::{DEPTH_FULL_SCALE_M, DepthFrame};

/// How often the service is looked at; arrival is known to this.
const LOOK: Duration = Duration::from_micros(200);

/// Commands of `vigil sensor`.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum SensorCommand {
    /// Listen to a publisher of depth frames and say whether it keeps to the interface.
    Check(CheckArgs),
    /// Publish the depth frames of a course as a foreign vehicle would see it, from the pose that it reports by MAVLink.
    Render(vigil_sim::foreign::render::RenderArgs),
    /// Publish what an Ouster scanner sends by UDP.
    Ouster(OusterArgs),
    /// Publish a depth camera's raw stream of 16-bit images (V4L2 and RealSense Z16).
    Z16(DepthStreamArgs),
}

/// Arguments of `vigil sensor check`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil sensor check                        listen for 10 s: frames taken, rate, latency, clock, order, returns, field of view
  vigil sensor check --wall 2.5             a wall stands 2.5 m in front of the sensor
  vigil sensor check --frame-key depth.key  frames must be authenticated
  vigil sensor check --json -               the findings for a program

Exit code: 0 all is as it should be or only warned of, 3 something fails, 1 the check could not be made.
docs/sensor-interface.md is the interface; tools/publishers has drivers to begin with.")]
pub struct CheckArgs {
    #[command(flatten)]
    service: ServiceArgs,

    /// File with the secret of the frames' key; may be given twice.
    #[arg(long, value_name = "FILE")]
    frame_key: Vec<PathBuf>,

    /// Range of a wall straight ahead, metres.
    #[arg(long, value_name = "METRES", value_parser = wall_m)]
    wall: Option<f32>,

    /// How long to listen, seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,

    /// Where the findings go as JSON; `-` is standard output.
    #[arg(short = 'o', long, value_name = "FILE")]
    json: Option<PathBuf>,
}

fn wall_m(text: &str) -> Result<f32, String> {
    let metres = text.parse().ok();
    let metres = metres.filter(|m| (f32::MIN_POSITIVE..DEPTH_FULL_SCALE_M).contains(m));
    metres.ok_or_else(|| format!("give metres, above 0 and below {DEPTH_FULL_SCALE_M}"))
}

/// Frames of a service, checked as they come.
pub(super) struct CheckedFrames {
    subscriber: FrameSubscriber,
    pub(super) check: SensorCheck,
    /// The newest.
    pub(super) frame: Box<DepthFrame>,
    _domain: Domain,
}

impl CheckedFrames {
    /// Listens under a name of its own to a service whose frames are made with these files' keys.
    pub(super) fn open(name: &str, service: &ServiceArgs, keys: &[PathBuf], wall_m: Option<f32>) -> Result<Self> {
        let keys = frame_keys(keys, service.sensor_id)?;
        let domain = Domain::open(service.instance, name)?;
        Ok(Self {
            subscriber: FrameSubscriber::create(&domain, &service.frames)?,
            check: SensorCheck::new(service.sensor_id, keys, wall_m),
            frame: Box::new(DepthFrame::EMPTY),
            _domain: domain,
        })
    }

    /// Takes the newest frame, if one has come.
    pub(super) fn look(&mut self) -> Result<bool> {
        let Some(borrowed) = self.subscriber.newest()? else {
            return Ok(false);
        };
        let arrived_ns = monotonic_ns();
        (*self.frame).clone_from(&borrowed);
        drop(borrowed);
        self.check.observe(&self.frame, arrived_ns);
        Ok(true)
    }
}

/// Says each finding with its grade and writes all for a program; whether something fails.
pub(super) fn report<F: Serialize>(
    findings: &[F],
    fails: &str,
    line: impl Fn(&F) -> (Severity, String),
    json: Option<&Path>,
) -> Result<ExitCode> {
    let (paint, mut is_good) = (Paint::stdout(), true);
    for finding in findings {
        let (severity, line) = line(finding);
        let mark = match severity {
            Severity::Good => "good",
            Severity::Warning => "warning",
            Severity::Failure => fails,
        };
        let holds = severity < Severity::Failure;
        say!("{}", paint.verdict(holds, &format!("{mark:<7}  {line}")));
        is_good &= holds;
    }
    if let Some(path) = json {
        output::write(path, serde_json::to_string_pretty(findings)? + "\n")?;
    }
    Ok(output::checked(is_good))
}

/// Does what was asked.
///
/// # Errors
/// Shared memory that cannot be used, a key that is refused.
pub fn run(command: &SensorCommand) -> Result<ExitCode> {
    match command {
        SensorCommand::Check(args) => check(args),
        SensorCommand::Render(args) => vigil_sim::foreign::render::run(args),
        SensorCommand::Ouster(args) => adapter::ouster(args),
        SensorCommand::Z16(args) => adapter::z16(args),
    }
}

fn check(args: &CheckArgs) -> Result<ExitCode> {
    if let Some(path) = &args.json {
        output::prepare(path)?;
    }
    let (instance, topic) = (args.service.instance, &args.service.frames);
    let mut frames = CheckedFrames::open("sensor-check", &args.service, &args.frame_key, args.wall)?;
    tell!("listening to `{topic}` on instance {instance} for {} s", args.seconds);
    let end_ns = monotonic_ns() + args.seconds * 1_000_000_000;
    while monotonic_ns() < end_ns {
        if !frames.look()? {
            std::thread::sleep(LOOK);
        }
    }
    let findings = frames.check.findings(args.seconds as f64, monotonic_ns());
    let line = |f: &Finding| (f.severity, format!("{:<8} {}", f.name, f.text));
    report(&findings, "FAILS", line, args.json.as_deref())
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_wall_that_no_frame_can_show_is_refused() {
        for text in ["nan", "-2", "inf", "0", "100"] {
            assert!(super::wall_m(text).is_err(), "{text}");
        }
        assert_eq!(super::wall_m("2.5"), Ok(2.5));
    }
}
