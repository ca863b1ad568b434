//! Runs the tick over a log's recorded inputs and compares every output.

use crate::config::FirmwareConfig;
use crate::stack::TickInput;
use crate::step::Firmware;
use anyhow::{Result, anyhow, bail, ensure};
use vigil_log::{LogEnd, Reader, TickRecord};
use vigil_types::{Datagrams, LogContent, Nanos, Reason, StepReport};

/// What a replay found.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ReplayReport {
    /// Steps that were run and compared.
    pub steps: u64,
    /// Bytes sent in these steps.
    pub sent_bytes: u64,
    /// The first difference; the replay ends there.
    pub difference: Option<Difference>,
    /// Step before which records are missing, because the recorder had to drop them; the replay ends there.
    pub gap_before_step: Option<u64>,
    /// How the log ends, when it was read to its end.
    pub log_end: Option<LogEnd>,
}

impl ReplayReport {
    /// Whether every recorded step was run and gave what was recorded.
    pub fn is_equal(&self) -> bool {
        self.difference.is_none() && self.gap_before_step.is_none() && self.log_end.is_some()
    }
}

/// Where the replay departs from the log.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Number of the step.
    pub step: u64,
    /// Time of the step.
    pub now_ns: Nanos,
    /// What differs: a field of the report, a byte of a datagram, its link and length, or the number of datagrams.
    pub place: String,
    /// In the log.
    pub recorded: String,
    /// In the replay.
    pub replayed: String,
}

impl std::fmt::Display for Difference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            step,
            now_ns,
            place,
            recorded,
            replayed,
        } = self;
        write!(
            f,
            "step {step} (t = {now_ns} ns): {place} is {recorded} in the log, {replayed} in the replay"
        )
    }
}

impl std::fmt::Display for ReplayReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { steps, sent_bytes, .. } = self;
        match (&self.difference, self.gap_before_step, self.log_end) {
            (Some(difference), ..) => write!(f, "{difference}; {steps} steps before it are equal"),
            (None, Some(step), _) => write!(
                f,
                "{steps} steps are equal ({sent_bytes} bytes sent); before step {step} the recorder dropped records, so \
                 what follows cannot be replayed"
            ),
            (None, None, Some(end)) => write!(f, "all {steps} steps are equal ({sent_bytes} bytes sent); {end}"),
            (None, None, None) => write!(f, "{steps} steps are equal ({sent_bytes} bytes sent)"),
        }
    }
}

/// A stack as it was before the log's first record: with the configuration in the log, and the models that flew.
///
/// # Errors
/// A configuration that is not understood (another version of the firmware flew) or must not fly, a log without its frames, or a model that
/// is not the one that flew.
pub fn firmware_of(reader: &Reader) -> Result<Firmware> {
    let info = reader.info();
    let program = &info.program;
    let config = FirmwareConfig::from_toml(&info.config_toml).map_err(|message| {
        anyhow!("the configuration in the log of `{program}` is not understood by this version: {message}")
    })?;
    ensure!(
        config.log.content != LogContent::Light,
        "the flight was recorded without its frames (log.content = \"light\"): it can be looked at, with `vigil log report` \
         and `vigil view`, but not be replayed"
    );
    let now = config.flight_info();
    let (actor, detector) = (&config.pilot.actor_file, &config.detector.file);
    for (what, file, recorded, found) in [
        ("an actor", actor, &info.actor_sha256, now.actor_sha256),
        ("a detector", detector, &info.detector_sha256, now.detector_sha256),
    ] {
        // A log of before the digests names none. A file that is gone or refused has none either: the stack below says why.
        if let (Some(recorded), Some(found)) = (recorded, found)
            && *recorded != found
        {
            let remedy = match file {
                Some(_) => "give back the file that flew".to_owned(),
                None => format!("`{program}` flew its built-in one: replay the log with that version"),
            };
            bail!("{what} with SHA-256 {recorded} flew, this program has {found}; {remedy}");
        }
    }
    Firmware::of(&config)
}

/// Replays a log from its first record with the configuration in the log, up to the first difference.
///
/// # Errors
/// A log that cannot be read, and as of [`firmware_of`]. A difference is no error.
pub fn replay(reader: &mut Reader) -> Result<ReplayReport> {
    let mut firmware = firmware_of(reader)?;
    let mut record = Box::<TickRecord>::default();
    let mut sent = Box::<Datagrams>::default();
    let mut result = ReplayReport::default();
    while reader.read_next(&mut record)? {
        if record.dropped_before > 0 {
            result.gap_before_step = Some(record.timing.step);
            return Ok(result);
        }
        let report = step_again(&mut firmware, &record, &mut sent);
        result.difference = difference(&record, &sent, report);
        if result.difference.is_some() {
            return Ok(result);
        }
        result.steps += 1;
        result.sent_bytes += sent.iter().map(|(_, datagram)| datagram.len() as u64).sum::<u64>();
    }
    result.log_end = reader.end();
    Ok(result)
}

/// Runs a recorded step: its time, frame and datagrams go in again. Overwrites `sent`.
pub fn step_again<'a>(firmware: &'a mut Firmware, record: &TickRecord, sent: &mut Datagrams) -> &'a StepReport {
    let input = TickInput {
        now_ns: record.now_ns,
        timing: record.timing,
        frame: record.frame(),
        // The key is not in the log: what the step found when it had it counts.
        frame_known_altered: record.report.reasons.contains(Reason::UnauthenticatedFrame),
        received: &record.received,
    };
    firmware.step(&input, |output| _ = sent.copy_from(output))
}

fn difference(record: &TickRecord, sent: &Datagrams, report: &StepReport) -> Option<Difference> {
    let differs = |place: String, [recorded, replayed]: [String; 2]| Difference {
        step: record.timing.step,
        now_ns: record.now_ns,
        place,
        recorded,
        replayed,
    };
    for (datagram, (recorded, replayed)) in record.sent.iter().zip(sent.iter()).enumerate() {
        if (recorded.0, recorded.1.len()) != (replayed.0, replayed.1.len()) {
            let shapes = [recorded, replayed].map(|(link, bytes)| format!("{} bytes for link {link}", bytes.len()));
            return Some(differs(format!("datagram {datagram}"), shapes));
        }
        let mut pairs = recorded.1.iter().zip(replayed.1).enumerate();
        if let Some((byte, (a, b))) = pairs.find(|(_, (a, b))| a != b) {
            let values = [a, b].map(|value| format!("0x{value:02x}"));
            return Some(differs(format!("datagram {datagram}, byte {byte}"), values));
        }
    }
    if record.sent.len() != sent.len() {
        let counts = [record.sent.len(), sent.len()].map(|count| count.to_string());
        return Some(differs("the number of datagrams".to_owned(), counts));
    }
    let (field, values) = differing_field(&record.report, report)?;
    Some(differs(format!("report: `{field}`"), values))
}

/// Compares by the printed form, which is exact for numbers and takes NaN for equal to itself.
fn differing_field(recorded: &StepReport, replayed: &StepReport) -> Option<(&'static str, [String; 2])> {
    // Taken apart by name, so that a new field does not compile until it is compared.
    macro_rules! printed {
        ($report:ident: $($field:ident),*) => {{
            let StepReport { $($field),* } = $report;
            [$((stringify!($field), format!("{:?}", $field))),*]
        }};
    }
    let fields = |report: &StepReport| {
        printed!(report: now_ns, timing, state, reasons, telemetry, goal, goal_relative, action, judgement, alarm, setpoint,
            frame_sequence, frame_age_ns, frames_refused)
    };
    if recorded == replayed {
        return None;
    }
    let mut pairs = fields(recorded).into_iter().zip(fields(replayed));
    let ((field, recorded), (_, replayed)) = pairs.find(|((_, a), (_, b))| a != b)?;
    Some((field, [recorded, replayed]))
}
