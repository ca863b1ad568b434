//! `vigil sensor`: what a driver's author needs.

use crate::cli::adapter::{self, DepthStreamArgs, OusterArgs, ServiceArgs};
use crate::cli::output::{self, EXIT_DIFFERS, Paint, say, tell};
use crate::sensor_check::{Expected, SensorCheck, Severity};
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use vigil_io::clock::monotonic_ns;
use vigil_io::key_file::frame_keys;
use vigil_io::shared_memory::{Domain, FrameSubscriber};
use vigil_types::DepthFrame;

/// How often the service is looked at; arrival is known to this.
const LOOK: Duration = Duration::from_micros(200);

/// Arguments of `vigil sensor`.
#[derive(Debug, Clone, clap::Args)]
#[command(arg_required_else_help = true)]
pub struct SensorArgs {
    #[command(subcommand)]
    command: SensorCommand,
}

#[derive(Debug, Clone, clap::Subcommand)]
enum SensorCommand {
    /// Listen to a publisher of depth frames and say whether it keeps to the interface.
    Check(CheckArgs),
    /// Publish the depth frames of a course as a foreign vehicle would see it, from the pose that it reports by MAVLink.
    Render(vigil_sim::foreign::render::RenderArgs),
    /// Publish what an Ouster scanner sends by UDP.
    Ouster(OusterArgs),
    /// Publish a depth camera's raw stream of 16-bit images (V4L2 and RealSense Z16).
    Z16(DepthStreamArgs),
}

#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil sensor check                        listen for 10 s: frames taken, rate, latency, clock, order, returns, field of view
  vigil sensor check --wall 2.5             a wall stands 2.5 m in front of the sensor
  vigil sensor check --frame-key depth.key  frames must be authenticated
  vigil sensor check --json -               the findings for a program

Exit code: 0 all is as it should be or only warned of, 3 something fails, 1 the check could not be made.
docs/sensor-interface.md is the interface; tools/publishers has drivers to begin with.")]
struct CheckArgs {
    #[command(flatten)]
    service: ServiceArgs,

    /// File with the secret of the frames' key; may be given twice.
    #[arg(long, value_name = "FILE")]
    frame_key: Vec<PathBuf>,

    /// Range of a wall straight ahead, metres.
    #[arg(long, value_name = "METRES")]
    wall: Option<f32>,

    /// How long to listen, seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,

    /// Where the findings go as JSON; `-` is standard output.
    #[arg(short = 'o', long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Does what was asked.
///
/// # Errors
/// Shared memory that cannot be used, a key that is refused.
pub fn run(args: &SensorArgs) -> Result<ExitCode> {
    match &args.command {
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
    let mut check = SensorCheck::new(Expected {
        sensor_id: args.service.sensor_id,
        keys: frame_keys(&args.frame_key, args.service.sensor_id)?,
        wall_m: args.wall,
    });
    let domain = Domain::open(args.service.instance, "sensor-check")?;
    let mut frames = FrameSubscriber::create(&domain, &args.service.frames)?;
    tell!(
        "listening to `{}` on instance {} for {} s",
        args.service.frames,
        args.service.instance,
        args.seconds
    );
    let end_ns = monotonic_ns() + args.seconds * 1_000_000_000;
    let mut frame = Box::new(DepthFrame::EMPTY);
    while monotonic_ns() < end_ns {
        match frames.newest()? {
            Some(borrowed) => {
                let arrived_ns = monotonic_ns();
                (*frame).clone_from(&borrowed);
                drop(borrowed);
                check.observe(&frame, arrived_ns);
            }
            None => std::thread::sleep(LOOK),
        }
    }
    let findings = check.findings(args.seconds as f64, monotonic_ns());
    let paint = Paint::stdout();
    for finding in &findings {
        let mark = match finding.severity {
            Severity::Good => "good   ",
            Severity::Warning => "warning",
            Severity::Failure => "FAILS  ",
        };
        let line = format!("{mark}  {:<8} {}", finding.name, finding.text);
        say!("{}", paint.verdict(finding.severity < Severity::Failure, &line));
    }
    if let Some(path) = &args.json {
        output::write(path, serde_json::to_vec_pretty(&findings)?)?;
    }
    let fails = findings.iter().any(|f| f.severity == Severity::Failure);
    Ok(if fails {
        ExitCode::from(EXIT_DIFFERS)
    } else {
        ExitCode::SUCCESS
    })
}
