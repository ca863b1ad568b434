//! Flight logs as columns for Python.

use crate::given::{array, refused};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};
use std::path::{Path, PathBuf};
use vigil_log::{Reader, Story, TickRecord};
use vigil_types::{DEPTH_FULL_SCALE_M, Verdict};

/// Columns of numbers in the order in which they first came: name, values a step, values.
type Columns = Vec<(&'static str, usize, Vec<f32>)>;

fn put<const N: usize>(columns: &mut Columns, name: &'static str, values: Option<[f32; N]>) {
    let at = columns.iter().position(|column| column.0 == name).unwrap_or_else(|| {
        columns.push((name, N, Vec::new()));
        columns.len() - 1
    });
    columns[at].2.extend(values.unwrap_or([f32::NAN; N]));
}

/// What a log holds.
#[derive(Default)]
struct Content {
    step: Vec<u64>,
    now_ns: Vec<u64>,
    columns: Columns,
    /// State, reasons, cause of the alarm, verdict.
    words: [Vec<Option<String>>; 4],
    frame_steps: Vec<u64>,
    frames: Vec<f32>,
    end: String,
    info: Vec<(&'static str, Option<String>)>,
}

fn read(path: &Path, with_frames: bool) -> Result<Content, vigil_log::ReadError> {
    let mut reader = Reader::open(path)?;
    let mut record = Box::new(TickRecord::default());
    // A log without steps has the columns of one with them.
    let mut content = Content::default();
    content.take(&record, false);
    content.columns.iter_mut().for_each(|column| column.2.clear());
    content = Content {
        columns: content.columns,
        ..Content::default()
    };
    while reader.read_next(&mut record)? {
        content.take(&record, with_frames);
    }
    content.end = reader.end().map(|end| end.to_string()).unwrap_or_default();
    let (info, mut about) = (reader.info(), Story::about(path)?);
    // Firmware that flew in a process of its own does not know them all.
    let mut or_about = |name: &'static str, known: Option<String>| (name, known.or_else(|| about.remove(name)));
    content.info = vec![
        ("program", Some(info.program.clone())),
        or_about("git_commit", info.git_commit.clone()),
        or_about("seed", info.seed.map(|seed| seed.to_string())),
        or_about("course", None),
        or_about("outcome", None),
        ("actor_sha256", info.actor_sha256.clone()),
        ("detector_sha256", info.detector_sha256.clone()),
        ("detector_threshold", info.detector_threshold.map(|t| t.to_string())),
        ("config_toml", Some(info.config_toml.clone())),
    ];
    Ok(content)
}

impl Content {
    fn take(&mut self, record: &TickRecord, with_frames: bool) {
        let report = &record.report;
        self.step.push(record.timing.step);
        self.now_ns.push(record.now_ns);
        let reasons: Vec<&str> = report.reasons.iter().map(|reason| reason.name()).collect();
        let verdict = report.judgement.map_or(Verdict::Unknown, |j| j.verdict);
        let words = [
            Some(report.state.name().to_owned()),
            Some(reasons.join(", ")),
            report.alarm.map(|alarm| alarm.cause.name().to_owned()),
            Some(verdict.name().to_owned()),
        ];
        for (column, word) in self.words.iter_mut().zip(words) {
            column.push(word);
        }
        let c = &mut self.columns;
        let (kinematics, judgement) = (report.telemetry.kinematics, report.judgement);
        put(c, "position_ned_m", kinematics.map(|k| k.position_ned_m.to_array()));
        put(c, "velocity_ned_m_s", kinematics.map(|k| k.velocity_ned_m_s.to_array()));
        let attitude = report.telemetry.attitude.map(|a| a.attitude);
        let euler = attitude.map(|a| [a.roll_rad(), a.pitch_rad(), a.yaw_rad()]);
        put(c, "roll_pitch_yaw_rad", euler);
        put(c, "goal_ned_m", report.goal.map(|g| g.position_ned_m.to_array()));
        put(c, "goal", report.goal_relative.map(|g| [g.distance_m, g.bearing_rad]));
        put(c, "action", report.action.map(|a| [a.forward_m_s, a.yaw]));
        let setpoint = report.setpoint;
        put(c, "setpoint_velocity_m_s", setpoint.map(|s| s.velocity_m_s.to_array()));
        put(c, "setpoint_yaw_rate_rad_s", setpoint.map(|s| [s.yaw_rate_rad_s]));
        put(c, "score", judgement.and_then(|j| j.score).map(|score| [score]));
        let contributions = judgement.map(|j| [j.image, j.bearing, j.distance, j.told, j.base]);
        put(c, "contributions", contributions);
        put(c, "phi", judgement.map(|j| j.phi));
        put(c, "frame_age_s", report.frame_age_ns.map(|age| [age as f32 * 1e-9]));
        put(
            c,
            "execution_s",
            Some([record.timing.previous_execution_ns as f32 * 1e-9]),
        );
        if let Some(frame) = record.frame().filter(|_| with_frames) {
            self.frame_steps.push(record.timing.step);
            self.frames
                .extend(frame.depth.iter().map(|range| range * DEPTH_FULL_SCALE_M));
        }
    }
}

/// The columns of a log: name to values, one after the other, and how many values a step has of each.
#[pyfunction]
pub fn read_log<'py>(py: Python<'py>, path: PathBuf, frames: bool) -> PyResult<Bound<'py, PyDict>> {
    let content = py.detach(|| read(&path, frames)).map_err(refused)?;
    let log = PyDict::new(py);
    log.set_item("step", PyArray1::from_vec(py, content.step))?;
    log.set_item("now_ns", PyArray1::from_vec(py, content.now_ns))?;
    let numbers = content.columns.into_iter();
    let numbers = numbers.map(|(name, width, values)| (name, (width, array(py, values))));
    log.set_item("numbers", numbers.into_py_dict(py)?)?;
    log.set_item("words", content.words)?;
    log.set_item("frame_steps", PyArray1::from_vec(py, content.frame_steps))?;
    log.set_item("frames", array(py, content.frames))?;
    log.set_item("end", content.end)?;
    log.set_item("info", content.info.into_py_dict(py)?)?;
    Ok(log)
}
