//! What a report says in words.

use crate::flight_report::log_seen::{LogSeen, StepSeen, WHO, rounded};
use crate::statistics::quantile;
use serde_json::{Value, json};
use std::path::Path;
use vigil_log::LogEnd;
use vigil_types::{Choice, GuidanceState, Landed, PilotKind, Reason, Reasons, STEP_S};

pub fn title(path: &Path, log: &LogSeen) -> String {
    let about = &log.story.about;
    let log_name = || path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let name = about.get("course").cloned().unwrap_or_else(log_name);
    format!("Flight report: {name}")
}

/// How it went, in a sentence, and whether that is good.
pub fn verdict(log: &LogSeen) -> (String, bool) {
    let about = &log.story.about;
    if let Some(outcome) = about.get("outcome") {
        let mut text = outcome.clone();
        // The outcome's own words are lower case.
        if let Some(first) = text.get_mut(..1) {
            first.make_ascii_uppercase();
        }
        if let Some(alarm) = log.alarms().first().and_then(|i| log.steps[*i].report.alarm) {
            text += &format!("; an alarm was raised ({})", alarm.cause.name());
        }
        (text + ".", outcome.starts_with("success"))
    } else if !log.took_off() {
        ("The vehicle never took off.".to_owned(), false)
    } else if log.steps.iter().any(|s| s.report.reasons.contains(Reason::GoalReached)) {
        ("The goal was reached.".to_owned(), true)
    } else {
        let last = log.steps.last().map(|s| (s.report.state, s.report.reasons));
        let (state, reasons) = last.unwrap_or_default();
        let left = log.steps.iter().rev().find_map(|s| s.report.goal_relative);
        let left = left.map_or(String::new(), |g| format!(", {:.1} m from the goal", g.distance_m));
        let (state, why) = (state.name(), why(reasons));
        let text = format!("Guidance did not hold at the goal; the log ends in {state}{why}{left}.");
        (text, false)
    }
}

fn why(reasons: Reasons) -> String {
    let names: Vec<&str> = reasons.iter().map(Reason::name).collect();
    match names.is_empty() {
        true => String::new(),
        false => format!(" ({})", names.join(", ")),
    }
}

pub fn notes(log: &LogSeen) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some(damage) = &log.damage {
        notes.push(format!("The log is shown as far as it is whole: {damage}."));
    }
    if let Some(end @ (LogEnd::Interrupted { .. } | LogEnd::Closed { dropped: 1.. })) = log.end {
        notes.push(format!("Note: {end}."));
    }
    if !log.took_off() {
        notes.push(format!("The vehicle never took off. {}", standby_reasons(log)));
    }
    if !log.steps.iter().any(|s| s.has_frame) {
        notes.push(
            "No step of this log has a depth frame: there is no film, and the distance to obstacles is that of the course alone."
                .to_owned(),
        );
    }
    if log.config.is_none() {
        notes.push(
            "The configuration in the log is not understood by this version: who flew is taken to be the actor."
                .to_owned(),
        );
    }
    notes
}

/// What kept the vehicle on the ground.
fn standby_reasons(log: &LogSeen) -> String {
    let steps_with = |reason| log.steps.iter().filter(|s| s.report.reasons.contains(reason)).count();
    let counted = Reason::ALL.into_iter().map(|reason| (steps_with(reason), reason));
    let mut named: Vec<(usize, Reason)> = counted.filter(|(n, _)| *n > 0).collect();
    named.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    let last = log.steps.last().map_or(GuidanceState::Standby, |s| s.report.state);
    let list: Vec<String> = named
        .iter()
        .take(4)
        .map(|(count, reason)| format!("{} for {:.1} s", reason.name(), *count as f64 * f64::from(STEP_S)))
        .collect();
    let (last, list) = (last.name(), list.join(", "));
    match list.is_empty() {
        true => format!("Guidance ended in {last} and named no reason: it was not engaged."),
        false => format!("Guidance ended in {last} and named: {list}."),
    }
}

/// What the flight was, by name. When it began is in seconds since 1970, which the page shows as a date.
pub fn facts(path: &Path, log: &LogSeen) -> Vec<(String, String)> {
    let mut facts: Vec<(String, String)> = Vec::new();
    let mut put = |name: &str, value: String| facts.push((name.to_owned(), value));
    let (first, last) = (log.steps.first(), log.steps.last());
    let span_s = last.map_or(0.0, |s| log.seconds(s.now_ns));
    if let Some(first) = first.filter(|_| log.epoch_offset_ns > 0) {
        let began_ns = first.now_ns.saturating_add(log.epoch_offset_ns);
        put("Began", (began_ns / 1_000_000_000).to_string());
    }
    put("Length", format!("{span_s:.1} s, {} steps", log.steps.len()));
    let info = &log.info;
    let commit = info.git_commit.as_ref().or_else(|| log.story.about.get("git_commit"));
    let of_commit = commit.map_or(String::new(), |c| format!(" ({})", short(c)));
    put("Program", format!("{}{of_commit}", info.program));
    let noted = log.story.about.get("seed").cloned();
    if let Some(seed) = noted.or(info.seed.map(|s| s.to_string())) {
        put("Seed", seed);
    }
    put("Instance", info.instance.to_string());
    if let Some(config) = &log.config {
        put("Pilot", pilot(config));
    }
    if let Some(actor) = &info.actor_sha256 {
        put("Actor", format!("SHA-256 {}…", short(actor)));
    }
    let threshold = log.threshold().map_or(String::new(), |t| format!(", threshold {t:.3}"));
    let detector = info.detector_sha256.as_deref();
    let detector = detector.map_or("none".to_owned(), |d| format!("SHA-256 {}…{threshold}", short(d)));
    put("Detector", detector);
    put("Attack", attack(log));
    put("Alarms", alarms(log));
    put("Who flew", who_flew(log));
    put("Path", path_flown(log));
    if let Some((_, closest)) = closest(log) {
        let text = format!("{closest:.2} m, by the vehicle's own estimate of where it is");
        put("Closest to an obstacle", text);
    }
    put("Step time", step_times(log));
    let bytes = std::fs::metadata(path).map_or(0, |m| m.len());
    let frames = log.steps.iter().filter(|s| s.has_frame).count();
    let per_minute = bytes as f64 / span_s.max(1.0) * 60.0 / 1e6;
    let megabytes = bytes as f64 / 1e6;
    let text = format!("{megabytes:.1} MB ({per_minute:.0} MB a minute), {frames} frames");
    put("Log", text);
    facts
}

fn short(digest: &str) -> &str {
    digest.get(..12).unwrap_or(digest)
}

/// The step in flight that was closest to an obstacle, and its distance.
fn closest(log: &LogSeen) -> Option<(&StepSeen, f32)> {
    let took_off = log.took_off();
    let flies = |s: &&StepSeen| matches!(s.report.state, GuidanceState::Guided | GuidanceState::Hold);
    let flown = log.steps.iter().filter(|s| took_off && flies(s));
    let clear = flown.filter_map(|s| Some((s, s.clearance_m?)));
    clear.min_by(|a, b| a.1.total_cmp(&b.1))
}

fn pilot(config: &vigil_firmware::FirmwareConfig) -> String {
    let apf = match (config.pilot.kind, config.pilot.apf) {
        (PilotKind::Actor, true) => ", potential field on",
        (PilotKind::Actor, false) => ", potential field off",
        _ => "",
    };
    format!("{}{apf}", config.pilot.kind.name())
}

fn attack(log: &LogSeen) -> String {
    let Some(altered) = &log.altered else {
        return match log.story.about.contains_key("command") {
            true => "none".to_owned(),
            false => "not known: nobody noted in this log whether frames were altered".to_owned(),
        };
    };
    let strength = altered.values().fold(0.0, |sum, v| sum + f64::from(v.abs())) / altered.len().max(1) as f64;
    let name = log.story.about.get("attack").map_or("frames altered", String::as_str);
    let (altered, all) = (altered.len(), log.story.attack.len());
    format!("{name}: {altered} of {all} frames, the yaw output moved by {strength:.2} on average")
}

fn alarms(log: &LogSeen) -> String {
    let raised = log.alarms();
    let Some(first) = raised.first().and_then(|i| log.steps.get(*i)) else {
        return "none".to_owned();
    };
    let cause = first.report.alarm.map_or("", |a| a.cause.name());
    let (count, first_s) = (raised.len(), log.seconds(first.now_ns));
    let delay = delay(log).map_or(String::new(), |text| format!(", {text}"));
    format!("{count}; the first at {first_s:.2} s ({cause}){delay}")
}

/// From the first altered frame that was used to the first alarm after it.
fn delay(log: &LogSeen) -> Option<String> {
    let from = log.steps.iter().position(|s| log.is_altered(s))?;
    let raised = log.alarms().into_iter().find(|i| *i >= from)?;
    let at_ns = |step: usize| log.steps.get(step).map(|s| s.now_ns);
    let seconds = at_ns(raised)?.saturating_sub(at_ns(from)?) as f64 * 1e-9;
    let steps = raised - from;
    Some(format!("{seconds:.2} s ({steps} steps) after the first altered frame"))
}

fn who_flew(log: &LogSeen) -> String {
    let who: Vec<u8> = log.steps.iter().map(|step| log.who(&step.report)).collect();
    let steps = (0..)
        .zip(WHO)
        .skip(1)
        .map(|(n, name)| (who.iter().filter(|who| **who == n).count(), name));
    let listed = steps.filter(|(count, _)| *count > 0);
    let listed: Vec<String> = listed
        .map(|(count, name)| format!("{name} {:.1} s", count as f64 * f64::from(STEP_S)))
        .collect();
    match listed.is_empty() {
        true => "nobody: guidance never engaged".to_owned(),
        false if !log.took_off() => "nobody: the vehicle never took off".to_owned(),
        false => listed.join(", "),
    }
}

fn path_flown(log: &LogSeen) -> String {
    let kinematics = log.steps.iter().filter_map(StepSeen::moves);
    // On the ground only the estimate moves.
    let flown = log
        .steps
        .iter()
        .filter(|s| s.report.telemetry.landed != Landed::OnGround);
    let positions: Vec<_> = flown.filter_map(StepSeen::position_ned_m).collect();
    let steps = positions.windows(2).map(|w| f64::from((w[1] - w[0]).norm()));
    // An empty sum is -0.0.
    let length = steps.fold(0.0, |sum, step| sum + step);
    let fastest = kinematics.map(|k| k.velocity_ned_m_s.horizontal_norm());
    let fastest = fastest.filter(|v| v.is_finite()).fold(0.0, f32::max);
    format!("{length:.1} m, at most {fastest:.1} m/s")
}

fn step_times(log: &LogSeen) -> String {
    let took = log.steps.iter().map(|s| s.report.timing.previous_execution_ns);
    let times: Vec<f64> = took.filter(|ns| *ns > 0).map(|ns| ns as f64 * 1e-6).collect();
    let (Some(p50), Some(p99)) = (quantile(&times, 0.5), quantile(&times, 0.99)) else {
        return "not measured (lockstep)".to_owned();
    };
    let max = times.iter().fold(0.0, |a: f64, b| a.max(*b));
    let slips = log.steps.last().map_or(0, |s| s.report.timing.slips);
    format!("p50 {p50:.2} ms, p99 {p99:.2} ms, max {max:.2} ms of 50; {slips} missed")
}

/// What happened, as time, weight (`info`, `warning` or `error`) and text.
pub fn events(log: &LogSeen) -> Vec<Value> {
    let mut events: Vec<(f64, &str, String)> = Vec::new();
    let mut put = |at_ns: u64, weight, text| events.push((log.seconds(at_ns), weight, text));
    for line in &log.story.lines {
        put(line.at_ns, line.weight, line.text.clone());
    }
    // Runs of altered frames.
    let marks = &log.story.attack;
    for (i, mark) in marks.iter().enumerate() {
        if mark.altered == (i > 0 && marks[i - 1].altered) {
            continue;
        }
        let (weight, what) = match mark.altered {
            true => ("warning", format!("altered from frame {} on", mark.frame_sequence)),
            false => ("info", "as they were again".to_owned()),
        };
        put(mark.at_ns, weight, format!("adversary: frames are {what}"));
    }
    if let Some((step, clearance)) = closest(log) {
        let text = format!("closest to an obstacle: {} m", rounded(clearance.into(), 2));
        put(step.now_ns, "info", text);
    }
    if let (Some(outcome), Some(last)) = (log.story.about.get("outcome"), log.steps.last()) {
        let weight = if verdict(log).1 { "info" } else { "error" };
        let ended_ns = log.ended_ns().unwrap_or(last.now_ns);
        put(ended_ns, weight, format!("the flight ended: {outcome}"));
    }
    events.sort_by(|a, b| a.0.total_cmp(&b.0));
    let shown = |(t, weight, text)| json!({ "t": t, "weight": weight, "text": text });
    events.into_iter().map(shown).collect()
}
