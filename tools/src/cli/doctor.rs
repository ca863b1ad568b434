//! `vigil doctor`: what a vehicle and its depth sensor lack before a flight.

use crate::cli::adapter::ServiceArgs;
use crate::cli::output::{self, Interrupt, Paint, say, tell};
use crate::cli::sensor::{self, CheckedFrames};
use crate::doctor::{Examination, ExaminationConfig, Finding, Severity};
use crate::sensor_check::SensorCheck;
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use vigil_firmware::arguments::choice;
use vigil_io::clock::{monotonic_ns, unix_us_at_zero};
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::link_spec::LinkSpec;
use vigil_io::links::{LinkAdmission, PeerRule, open_wire, somebody_is_heard};
use vigil_mavlink::Flavour;
use vigil_mavlink::signing::SigningCounters;
use vigil_types::{AutopilotChoice, Datagrams, Nanos};

/// Time between two looks at link and frames.
const LOOK: Duration = Duration::from_millis(1);

/// Arguments of `vigil doctor`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil doctor --link udpin://127.0.0.1:14540   PX4's simulation, and the frames on this machine
  vigil doctor --link tcpout://127.0.0.1:5762 --vehicle ardupilot --no-sensor
                                                ArduPilot's, the vehicle alone
  vigil doctor --link serial:///dev/ttyUSB0:921600 --signing-key vigil.key --json -
                                                over a serial line, for a program

It commands nothing: it asks for messages, their rates and parameters. Run it on the link that the firmware will have, while the
firmware does not run.
Exit code: 0 nothing is missing or only warned of, 3 something is missing, 1 it could not be looked at, 130 interrupted.")]
pub struct DoctorArgs {
    /// Where the vehicle's MAVLink is: a URL as of `vigil firmware --link`, with the options system=ID and
    /// unsigned=loopback|never|always.
    #[arg(long, value_name = "URL[,OPTION]")]
    link: LinkSpec,

    /// The autopilot that the vehicle must have.
    #[arg(long, value_parser = choice::<AutopilotChoice>(), default_value = "auto")]
    vehicle: AutopilotChoice,

    /// File with the key of MAVLink signing.
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,

    /// From whom packets without a signature are accepted: from this machine, nobody, everybody.
    #[arg(long, value_name = "WHO", value_enum, default_value_t)]
    allow_unsigned: AllowUnsigned,

    #[command(flatten)]
    service: ServiceArgs,

    /// File with the secret of the frames' key; may be given twice.
    #[arg(long, value_name = "FILE")]
    frame_key: Vec<PathBuf>,

    /// Look at the vehicle alone.
    #[arg(long)]
    no_sensor: bool,

    /// How long to look, seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 10, value_parser = clap::value_parser!(u64).range(5..=600))]
    seconds: u64,

    /// Where the findings go as JSON; `-` is standard output.
    #[arg(short = 'o', long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Looks and reports.
///
/// # Errors
/// A link, a key or shared memory that cannot be used.
pub fn run(args: &DoctorArgs) -> Result<ExitCode> {
    if let Some(path) = &args.json {
        output::prepare(path)?;
    }
    let policy = args.link.allow_unsigned.unwrap_or(args.allow_unsigned);
    let mut gate = match &args.signing_key {
        Some(path) => SigningGate::with_key_file(path, "doctor", policy)?,
        None => SigningGate::new(None, policy),
    };
    somebody_is_heard(&args.link.url, gate.has_key(), policy)?;
    let system = args.link.system;
    let mut wire = open_wire(&args.link.url, PeerRule::Vehicle { system })?;
    let frames = || CheckedFrames::open("doctor", &args.service, &args.frame_key, None);
    let mut frames = (!args.no_sensor).then(frames).transpose()?;
    let interrupt = Interrupt::on_ctrl_c()?;
    let started_ns = monotonic_ns();
    let mut examination = Examination::new(
        ExaminationConfig {
            flavour: match args.vehicle {
                AutopilotChoice::Auto => None,
                AutopilotChoice::Px4 => Some(Flavour::Px4),
                AutopilotChoice::ArduPilot => Some(Flavour::ArduPilot),
            },
            system,
            is_local: args.link.url.is_on_this_machine(),
            has_key: gate.has_key(),
            unix_time_at_zero_us: unix_us_at_zero(started_ns),
        },
        started_ns,
    );
    tell!("looking at {} for {} s", args.link, args.seconds);
    let (mut received, mut questions) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
    let mut now_ns = started_ns;
    while now_ns - started_ns < args.seconds * 1_000_000_000 && !interrupt.came() {
        gate.begin(now_ns);
        received.clear();
        let mut admission = LinkAdmission {
            gate: &mut gate,
            allow_unsigned: policy,
            link: 0,
        };
        wire.receive(now_ns, &mut admission, &mut received);
        for (_, datagram) in received.iter() {
            examination.receive(now_ns, datagram);
        }
        questions.clear();
        examination.ask(now_ns, &mut questions);
        wire.send(&mut gate, &questions);
        if let Some(frames) = &mut frames
            && frames.look()?
            && frames.frame.check(args.service.sensor_id).is_ok()
        {
            examination.observe_frame(&frames.frame);
        }
        std::thread::sleep(LOOK);
        now_ns = monotonic_ns();
    }
    let mut findings = examination.findings(now_ns);
    findings.extend(of_link(wire.statistics().0.other_system, &gate.counters()));
    if let Some(frames) = &frames {
        findings.extend(of_sensor(&frames.check, started_ns, now_ns));
    }
    let code = report(args, &findings)?;
    Ok(if interrupt.came() { interrupt.exit_code() } else { code })
}

/// What the examination does not see: packets that wire and gate kept from it.
fn of_link(other_system: Option<u8>, signing: &SigningCounters) -> impl Iterator<Item = Finding> {
    let warning = |name, value, wanted, why| Finding::new(name, Severity::Warning, Some(value), wanted, why);
    let other = other_system.map(|other| {
        let why = "its packets are not read: is system=ID of the link right?";
        warning(
            "system",
            format!("system {other} calls too"),
            "the vehicle that was named",
            why,
        )
    });
    let (refusals, refused) = (signing.refusals().into_iter(), signing.refused());
    let most = refusals.clone().max_by_key(|(_, count)| *count);
    let refused = most.filter(|_| refused > 0).map(|(reason, _)| {
        let counts = refusals.filter(|(_, count)| *count > 0);
        let counts: Vec<_> = counts.map(|(reason, count)| format!("{count} {reason}")).collect();
        let value = format!("packets refused: {}", counts.join(", "));
        let why = match reason {
            "from the future" | "outdated" => {
                "this machine's clock and the vehicle's differ by more than a minute: set it"
            }
            "wrong signature" => "the vehicle signs with another key than --signing-key",
            "replayed" => "the vehicle's clock went back, or somebody repeats its packets: set its clock",
            _ => {
                "give --signing-key, or --allow-unsigned always if only the vehicle reaches the link \
                 (docs/firmware.md, Signing)"
            }
        };
        warning("refused packets", value, "packets that the link accepts", why)
    });
    other.into_iter().chain(refused)
}

/// What the sensor's own check says, as findings of the doctor's.
fn of_sensor(check: &SensorCheck, started_ns: Nanos, ended_ns: Nanos) -> impl Iterator<Item = Finding> {
    let seconds = (ended_ns - started_ns) as f64 * 1e-9;
    let (wanted, why) = ("what docs/sensor-interface.md says", "`vigil sensor check` says more");
    let found = check.findings(seconds, ended_ns).into_iter();
    found.map(move |f| Finding::new(&format!("sensor {}", f.name), f.severity, Some(f.text), wanted, why))
}

fn report(args: &DoctorArgs, findings: &[Finding]) -> Result<ExitCode> {
    let line = |finding: &Finding| (finding.severity, finding.line());
    let code = sensor::report(findings, "MISSING", line, args.json.as_deref())?;
    let count = |severity| findings.iter().filter(|f| f.severity == severity).count();
    let (missing, warned) = (count(Severity::Failure), count(Severity::Warning));
    let sum = format!("{missing} missing, {warned} warnings, {} good", count(Severity::Good));
    say!("{}", Paint::stdout().verdict(missing == 0, &sum));
    Ok(code)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_clock_is_named_and_no_reason_to_switch_signing_off() {
        let of = |from_the_future, unsigned| {
            let signing = SigningCounters {
                from_the_future,
                unsigned,
                ..SigningCounters::default()
            };
            of_link(None, &signing).next().map(|finding| finding.line())
        };
        let line = of(20, 3).unwrap();
        assert!(
            line.contains("3 unsigned, 20 from the future") && line.contains("clock"),
            "{line}"
        );
        assert!(!line.contains("--allow-unsigned") && of(0, 3).unwrap().contains("--allow-unsigned"));
        assert_eq!(of(0, 0), None);
    }
}
