//! A flight's log as ULog, which PX4's tools read: Flight Review, pyulog, PlotJuggler.
//!
//! Topics that PX4 has, by its names and fields, as far as the guidance computer knows them, and one of our own, `vigil_status`. Format:
//! <https://docs.px4.io/main/en/dev_log/ulog_file_format.html>.

use crate::{LogEnd, ReadError, Reader, Story, TickRecord};
use std::path::Path;
use vigil_types::{Nanos, VehicleMode};

/// What came of it.
#[derive(Debug)]
pub struct ULog {
    /// The file's content.
    pub bytes: Vec<u8>,
    /// Records in it.
    pub records: u64,
    /// Why it is not all of the log, if it is not.
    pub incomplete: Option<String>,
}

/// A topic: its name, its fields as ULog writes them behind the time stamp, and what fills them; `None` where nothing is known.
type Topic = (&'static str, &'static str, fn(&TickRecord) -> Option<Row>);

/// The bytes of a message behind its time stamp.
#[derive(Default)]
struct Row(Vec<u8>);

impl Row {
    fn floats(mut self, values: impl IntoIterator<Item = f32>) -> Self {
        self.0.extend(values.into_iter().flat_map(f32::to_le_bytes));
        self
    }

    fn byte(mut self, value: u8) -> Self {
        self.0.push(value);
        self
    }

    fn word(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }
}

fn heading_rad(record: &TickRecord) -> f32 {
    let attitude = record.report.telemetry.attitude;
    attitude.map_or(f32::NAN, |a| a.attitude.yaw_rad())
}

const TRUTH: &str = "vehicle_local_position_groundtruth";
const TRUTH_FIELDS: &str = "float x;float y;float z;";

const TOPICS: [Topic; 7] = [
    (
        "vehicle_local_position",
        "float x;float y;float z;float vx;float vy;float vz;float heading;bool xy_valid;bool z_valid;bool v_xy_valid;\
         bool v_z_valid;",
        |record| {
            let kinematics = record.report.telemetry.kinematics?;
            let heading = heading_rad(record);
            let (place, velocity) = (kinematics.position_ned_m, kinematics.velocity_ned_m_s);
            let row = Row::default()
                .floats(place.to_array())
                .floats(velocity.to_array())
                .floats([heading]);
            let (there, moving) = (u8::from(place.is_finite()), u8::from(velocity.is_finite()));
            Some(row.byte(there).byte(there).byte(moving).byte(moving))
        },
    ),
    ("vehicle_attitude", "float[4] q;", |record| {
        let q = record.report.telemetry.attitude?.attitude;
        Some(Row::default().floats([q.w, q.x, q.y, q.z]))
    }),
    ("vehicle_angular_velocity", "float[3] xyz;", |record| {
        Some(Row::default().floats(record.report.telemetry.attitude?.rates_frd_rad_s.to_array()))
    }),
    (
        "vehicle_local_position_setpoint",
        "float x;float y;float z;float vx;float vy;float vz;float yaw;float yawspeed;",
        |record| {
            let setpoint = record.report.setpoint?;
            let heading = heading_rad(record);
            let (forward, right) = (setpoint.velocity_m_s.x, setpoint.velocity_m_s.y);
            let (north, east) = (
                forward * heading.cos() - right * heading.sin(),
                forward * heading.sin() + right * heading.cos(),
            );
            let row = Row::default().floats([f32::NAN; 3]);
            Some(row.floats([north, east, setpoint.velocity_m_s.z, f32::NAN, setpoint.yaw_rate_rad_s]))
        },
    ),
    (
        "vehicle_status",
        "uint8_t nav_state;uint8_t arming_state;uint8_t vehicle_type;bool failsafe;",
        |record| {
            let heartbeat = record.report.telemetry.heartbeat?;
            // PX4's NAVIGATION_STATE_… and ARMING_STATE_…
            let nav_state = match heartbeat.mode {
                VehicleMode::External => 14,
                VehicleMode::Hold => 4,
                VehicleMode::Takeoff => 17,
                VehicleMode::Land => 18,
                VehicleMode::Return => 5,
                VehicleMode::Mission => 3,
                VehicleMode::Unknown | VehicleMode::Other => 2,
            };
            let row = Row::default().byte(nav_state).byte(if heartbeat.armed { 2 } else { 1 });
            Some(row.byte(1).byte(u8::from(heartbeat.failsafe)))
        },
    ),
    ("battery_status", "float remaining;bool connected;", |record| {
        let remaining = record.report.telemetry.battery_remaining?;
        Some(Row::default().floats([remaining]).byte(1))
    }),
    (
        "vigil_status",
        "float goal_distance_m;float goal_bearing_rad;float action_forward_m_s;float action_yaw;float actor_yaw;\
         float detector_score;float frame_age_s;float step_time_s;uint32_t step;uint32_t reasons;uint32_t further_reasons;\
         uint32_t frames_refused;uint8_t state;uint8_t alarm_response;bool alarm;bool attack;",
        |record| {
            let report = &record.report;
            let number = |value: Option<f32>| value.unwrap_or(f32::NAN);
            let seconds = |ns: Option<Nanos>| ns.map_or(f32::NAN, |ns| ns as f32 * 1e-9);
            let [reasons, further] = report.reasons.words();
            let row = Row::default().floats([
                number(report.goal_relative.map(|goal| goal.distance_m)),
                number(report.goal_relative.map(|goal| goal.bearing_rad)),
                number(report.action.map(|action| action.forward_m_s)),
                number(report.action.map(|action| action.yaw)),
                number(report.judgement.map(|judgement| judgement.yaw())),
                number(report.judgement.and_then(|judgement| judgement.score)),
                seconds(report.frame_age_ns),
                seconds(Some(record.timing.previous_execution_ns)),
            ]);
            // Steps and refused frames of weeks; beyond them they begin anew.
            let row = row
                .word(record.timing.step as u32)
                .word(reasons)
                .word(further)
                .word(report.frames_refused as u32);
            let response = report.alarm.map_or(0, |alarm| alarm.response as u8);
            let is_attack = report
                .judgement
                .is_some_and(|j| j.verdict == vigil_types::Verdict::Attack);
            let row = row.byte(report.state as u8).byte(response);
            Some(row.byte(u8::from(report.alarm.is_some())).byte(u8::from(is_attack)))
        },
    ),
];

/// Messages of a file, each with its length and kind before it.
struct Writer(Vec<u8>);

impl Writer {
    /// What is longer than a length says is left out.
    fn put(&mut self, kind: u8, parts: &[&[u8]]) {
        let Ok(len) = u16::try_from(parts.iter().map(|part| part.len()).sum::<usize>()) else {
            return;
        };
        self.0.extend(len.to_le_bytes());
        self.0.push(kind);
        for part in parts {
            self.0.extend(*part);
        }
    }

    fn about(&mut self, key: &str, value: &str) {
        let key = format!("char[{}] {key}", value.len());
        if let Ok(len) = u8::try_from(key.len()) {
            self.put(b'I', &[&[len], key.as_bytes(), value.as_bytes()]);
        }
    }
}

fn micros(at_ns: Nanos) -> [u8; 8] {
    (at_ns / 1000).to_le_bytes()
}

/// The log at `path` as ULog: whatever of it is whole, and why that is not all.
///
/// # Errors
/// [`ReadError`] of a file that is no log, or of which no record is whole.
pub fn ulog(path: &Path) -> Result<ULog, ReadError> {
    let story = Story::read(path)?;
    let mut reader = Reader::open(path)?;
    let mut record: Box<TickRecord> = Box::default();
    let mut is_there = reader.read_next(&mut record)?;
    let mut out = Writer(b"ULog\x01\x12\x35\x01".to_vec());
    out.0.extend(micros(record.now_ns));
    // No appended data, nothing that an older reader must know.
    out.put(b'B', &[&[0; 40]]);
    let info = reader.info();
    out.about("sys_name", "Vigil");
    out.about("ver_hw", "guidance computer");
    out.about("ver_sw", info.git_commit.as_deref().unwrap_or(&info.program));
    for (key, value) in &story.about {
        out.about(&format!("vigil_{key}"), value);
    }
    let formats = TOPICS.iter().map(|(name, fields, _)| (*name, *fields));
    for (name, fields) in formats.chain([(TRUTH, TRUTH_FIELDS)]) {
        out.put(b'F', &[format!("{name}:uint64_t timestamp;{fields}").as_bytes()]);
    }
    for (id, name) in TOPICS.iter().map(|(name, ..)| *name).chain([TRUTH]).enumerate() {
        out.put(b'A', &[&[0], &(id as u16).to_le_bytes(), name.as_bytes()]);
    }
    let mut lines = story.lines.iter().peekable();
    let mut truth = story.truth.iter().peekable();
    let (mut records, mut incomplete) = (0, None);
    while is_there {
        // In the order of time, as PX4 writes them.
        while let Some((at_ns, place)) = truth.next_if(|(at_ns, _)| *at_ns <= record.now_ns) {
            let row = Row::default().floats(place.to_array());
            out.put(b'D', &[&(TOPICS.len() as u16).to_le_bytes(), &micros(*at_ns), &row.0]);
        }
        while let Some(line) = lines.next_if(|line| line.at_ns <= record.now_ns) {
            let level = match line.weight {
                "error" => b'3',
                "warning" => b'4',
                _ => b'6',
            };
            out.put(b'L', &[&[level], &micros(line.at_ns), line.text.as_bytes()]);
        }
        for (id, (_, _, row)) in TOPICS.iter().enumerate() {
            if let Some(row) = row(&record) {
                out.put(b'D', &[&(id as u16).to_le_bytes(), &micros(record.now_ns), &row.0]);
            }
        }
        records += 1;
        is_there = match reader.read_next(&mut record) {
            Ok(more) => more,
            Err(error) => {
                incomplete = Some(error.to_string());
                false
            }
        };
    }
    if let Some(end @ LogEnd::Interrupted { .. }) = reader.end() {
        incomplete = Some(end.to_string());
    }
    Ok(ULog {
        bytes: out.0,
        records,
        incomplete,
    })
}
