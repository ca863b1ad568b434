//! What a report shows of a flight, taken from its log.

use crate::flight_report::film::{self, Film};
use crate::flight_report::log_seen::{LogSeen, StepSeen, WHO, rounded};
use crate::flight_report::page::DATA_LIMIT;
use crate::flight_report::words;
use anyhow::{Result, bail};
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use vigil_log::{LogEnd, SceneSolid};
use vigil_types::{EXPLAINED_STATE, Nanos, NedVector};

/// Reads a log and makes of it what a report shows. A log that was cut off or is damaged shows what is whole, and says so. The pixels
/// of so many frames around the first alarm are explained; each costs about as much as a step has time.
///
/// Also returns why it is not all of the flight, where it is not.
///
/// # Errors
/// A file that is no log of this version, or holds no whole step.
pub fn read(path: &Path, explained_frames: usize) -> Result<(Value, Option<String>)> {
    let log = LogSeen::read(path)?;
    if log.steps.is_empty() {
        match log.damage {
            Some(damage) => bail!("{damage}, so there is nothing to show yet"),
            None => bail!(
                "{} holds no step: the recording ended before the first one, so there is nothing to show",
                path.display()
            ),
        }
    }
    let film = film::take(path, &log, explained_frames)?;
    let incomplete = log.damage.clone().or_else(|| match log.end {
        Some(end @ LogEnd::Interrupted { .. }) => Some(end.to_string()),
        _ => None,
    });
    Ok((flight(path, &log, film), incomplete))
}

/// What the page's script shows. Times are seconds since the first step.
fn flight(path: &Path, log: &LogSeen, film: Film) -> Value {
    let stride = log.steps.len().div_ceil(DATA_LIMIT);
    let kept: Vec<&StepSeen> = log.steps.iter().step_by(stride).collect();
    let attack = log.altered.as_ref();
    let attack = attack.map(|_| kept.iter().map(|s| u8::from(log.is_altered(s))).collect::<Vec<_>>());
    let mut notes = words::notes(log);
    if stride > 1 {
        let all = log.steps.len();
        notes.push(format!("The plots show one step of {stride} of the log's {all}."));
    }
    notes.extend(film.note);
    let raised = |i: usize| {
        let step = log.steps.get(i)?;
        Some((log.seconds(step.now_ns), step.report.alarm?.cause.name()))
    };
    let (verdict, is_good) = words::verdict(log);
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    json!({
        "title": words::title(path, log),
        "verdict": { "text": verdict, "good": is_good },
        // What the reader must know of the log: damage, gaps, what is missing.
        "notes": notes,
        "facts": words::facts(path, log),
        // That flies it again, if it is known.
        "command": log.story.about.get("command"),
        "config": log.info.config_toml,
        "footer": format!(
            "Made by vigil {} from {file}. Times are seconds since the log's first step.",
            env!("CARGO_PKG_VERSION")
        ),
        // Of the numbers in `who`: who had the vehicle in each step.
        "who_names": WHO,
        "t": kept.iter().map(|s| log.seconds(s.now_ns)).collect::<Vec<_>>(),
        "columns": columns(&kept, log.threshold(), log.steps.iter().skip(1).step_by(stride)),
        "who": kept.iter().map(|s| log.who(&s.report)).collect::<Vec<_>>(),
        // Whether each step's frame was altered, where that is known.
        "attack": attack,
        "alarms": log.alarms().into_iter().filter_map(raised).collect::<Vec<_>>(),
        "phi": explanations(&kept),
        "map": map(log),
        "frames": film.frames,
        "first_frame": film.first_frame,
        "film_none": film.film_none,
        "events": words::events(log),
    })
}

fn ms(ns: Nanos) -> f32 {
    (ns as f64 * 1e-6) as f32
}

/// Quantities by their names, a value for each of these steps, nothing where there is none; of the steps that come next the time.
fn columns<'a>(
    steps: &[&StepSeen],
    threshold: Option<f32>,
    next: impl Iterator<Item = &'a StepSeen>,
) -> BTreeMap<&'static str, Vec<Option<f64>>> {
    type Value = fn(&StepSeen) -> Option<f32>;
    let columns: [(&str, Value); 23] = [
        ("detector_score", |s| s.report.judgement?.score),
        ("contribution_image", |s| s.report.judgement.map(|j| j.image)),
        ("contribution_bearing", |s| s.report.judgement.map(|j| j.bearing)),
        ("contribution_distance", |s| s.report.judgement.map(|j| j.distance)),
        ("contribution_told", |s| s.report.judgement.map(|j| j.told)),
        ("actor_yaw", |s| s.report.judgement.map(|j| j.yaw())),
        ("action_yaw", |s| s.report.action.map(|a| a.yaw)),
        ("action_forward_m_s", |s| s.report.action.map(|a| a.forward_m_s)),
        ("setpoint_forward_m_s", |s| s.report.setpoint.map(|p| p.velocity_m_s.x)),
        ("setpoint_yaw_rate_deg_s", |s| {
            s.report.setpoint.map(|p| p.yaw_rate_rad_s.to_degrees())
        }),
        ("speed_m_s", |s| Some(s.moves()?.velocity_ned_m_s.horizontal_norm())),
        ("climb_m_s", |s| s.moves().map(|k| -k.velocity_ned_m_s.z)),
        ("north_m", |s| s.moves().map(|k| k.position_ned_m.x)),
        ("east_m", |s| s.moves().map(|k| k.position_ned_m.y)),
        ("height_m", |s| s.moves().map(|k| -k.position_ned_m.z)),
        ("heading_deg", |s| {
            s.report.telemetry.attitude.map(|a| a.attitude.yaw_rad().to_degrees())
        }),
        ("yaw_rate_deg_s", |s| {
            s.report.telemetry.attitude.map(|a| a.rates_frd_rad_s.z.to_degrees())
        }),
        ("goal_distance_m", |s| s.report.goal_relative.map(|g| g.distance_m)),
        ("clearance_m", |s| s.clearance_m),
        ("nearest_return_m", |s| s.nearest_return_m),
        ("frame_age_ms", |s| s.report.frame_age_ns.map(ms)),
        ("telemetry_age_ms", |s| {
            s.report.telemetry.flight_data_age_ns(s.now_ns).map(ms)
        }),
        ("wake_late_ms", |s| timed(s).then_some(ms(s.report.timing.wake_late_ns))),
    ];
    let number = |value: Option<f32>| {
        let value = value.map(f64::from).filter(|v| v.is_finite());
        value.map(|v| rounded(v, 4))
    };
    let mut table: BTreeMap<&'static str, Vec<Option<f64>>> = columns
        .into_iter()
        .map(|(name, value)| (name, steps.iter().map(|s| number(value(s))).collect()))
        .collect();
    let scored = |s: &&StepSeen| s.report.judgement.and(threshold);
    table.insert("detector_threshold", steps.iter().map(|s| number(scored(s))).collect());
    // A step knows how long the one before it took.
    let took = |s: &StepSeen| timed(s).then_some(ms(s.report.timing.previous_execution_ns));
    let mut times: Vec<Option<f64>> = next.map(|s| number(took(s))).collect();
    times.resize(steps.len(), None);
    table.insert("step_time_ms", times);
    table
}

/// Whether the loop measured itself: in lockstep it does not.
fn timed(step: &StepSeen) -> bool {
    step.report.timing.previous_execution_ns > 0
}

/// The explained values of each step as signed bytes, step by step, in base64, −128 where there is none; `full` is what 127 stands for,
/// action units.
fn explanations(steps: &[&StepSeen]) -> Option<Value> {
    let phi = |s: &&StepSeen| {
        let phi = s.report.judgement?.phi;
        phi.iter().all(|v| v.is_finite()).then_some(phi)
    };
    let values = steps.iter().filter_map(phi).flatten();
    let sizes: Vec<f64> = values.map(|v| f64::from(v.abs())).collect();
    // A few steps' extremes must not pale all others.
    let full = crate::statistics::quantile(&sizes, 0.995).filter(|full| *full > 0.0)?;
    let byte = |v: f32| ((f64::from(v) / full).clamp(-1.0, 1.0) * 127.0).round() as i8 as u8;
    let none = [i8::MIN as u8; EXPLAINED_STATE];
    let bytes = steps.iter().flat_map(|s| phi(s).map_or(none, |phi| phi.map(byte)));
    let values = BASE64.encode(bytes.collect::<Vec<u8>>());
    Some(json!({ "rows": EXPLAINED_STATE, "full": full, "values": values }))
}

/// The course and the true path, where the simulator noted it, from above: north, east in metres.
fn map(log: &LogSeen) -> Value {
    let pair = |p: NedVector| [rounded(p.x.into(), 2), rounded(p.y.into(), 2)];
    let corner = |p: [f64; 2]| p.map(|v| rounded(v, 2));
    let outline = |solid| outline_of(solid).into_iter().map(corner).collect::<Vec<_>>();
    // Before take-off and after landing the vehicle stands still: one point of many says that as well.
    let mut truth: Vec<[f64; 2]> = log.story.truth.iter().map(|(_, p)| pair(*p)).collect();
    truth.dedup();
    let stride = truth.len().div_ceil(DATA_LIMIT).max(1);
    json!({
        "solids": log.story.solids.iter().map(outline).collect::<Vec<_>>(),
        "goal": log.goal_ned_m().map(pair),
        "truth": truth.into_iter().step_by(stride).collect::<Vec<_>>(),
    })
}

/// Corners of a solid seen from above: north, east in metres.
pub fn outline_of(solid: &SceneSolid) -> Vec<[f64; 2]> {
    let ([north, east, _], [length, width, _], yaw_rad) = solid.parts();
    let points: Vec<[f32; 2]> = match solid {
        SceneSolid::Cuboid { .. } => {
            let (sin, cos) = yaw_rad.sin_cos();
            [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]
                .map(|(a, b): (f32, f32)| (a * length, b * width))
                .map(|(x, y)| [north + cos * x - sin * y, east + sin * x + cos * y])
                .to_vec()
        }
        SceneSolid::Cylinder { .. } => (0..20_u8)
            .map(|i| (f32::from(i) * std::f32::consts::TAU / 20.0).sin_cos())
            .map(|(sin, cos)| [north + length * cos, east + length * sin])
            .collect(),
    };
    points.into_iter().map(|p| p.map(f64::from)).collect()
}
