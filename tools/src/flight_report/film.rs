//! The frames that a report shows, and what their pixels did to the actor's decision.

use crate::flight_derived::ExplainedReplay;
use crate::flight_report::log_seen::{LogSeen, StepSeen, WHO};
use crate::report::png_bytes;
use anyhow::Result;
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::Path;
use vigil_log::{Reader, TickRecord};
use vigil_types::{DEPTH_COLS, DEPTH_PIXELS, DEPTH_ROWS};

/// Steps before and after the moment of interest that are shown one by one.
const BEFORE: usize = 20;
const AFTER: usize = 40;
/// Besides these, a frame a second, and never more than so many.
const OVERVIEW_STEPS: usize = 20;
const OVERVIEW_LIMIT: usize = 120;
/// Share of the pixels whose SHAP values are not beyond the colours' full strength.
const STRONG: f64 = 0.99;
/// Side of the squares over which pixels' SHAP values are summed.
const SQUARE: usize = 4;

#[derive(Default)]
pub struct Film {
    /// Its pictures are `data:` addresses.
    pub frames: Vec<Value>,
    /// The frame to show first.
    pub first_frame: usize,
    /// Why there is no film.
    pub film_none: &'static str,
    /// Why pixels are not explained.
    pub note: Option<String>,
}

/// The step of most interest: the first alarm, else the first altered frame.
fn moment(log: &LogSeen) -> Option<usize> {
    let raised = log.alarms().first().copied();
    raised.or_else(|| log.steps.iter().position(|s| log.is_altered(s)))
}

/// The steps to show, in order.
fn chosen(log: &LogSeen, moment: Option<usize>) -> Vec<usize> {
    let stride = OVERVIEW_STEPS.max(log.steps.len().div_ceil(OVERVIEW_LIMIT));
    let close = moment.map_or(0..0, |at| at.saturating_sub(BEFORE)..at + AFTER);
    (0..log.steps.len())
        .filter(|i| close.contains(i) || i.is_multiple_of(stride))
        .filter(|i| log.steps[*i].has_frame)
        .collect()
}

/// Reads the log once more and makes the pictures.
pub fn take(path: &Path, log: &LogSeen, explained_frames: usize) -> Result<Film> {
    let moment = moment(log);
    let steps = chosen(log, moment);
    if steps.is_empty() {
        return Ok(Film {
            film_none: "The log holds no depth frames.",
            ..Film::default()
        });
    }
    let middle = moment.map_or(0, |at| steps.partition_point(|i| *i < at));
    let mut reader = Reader::open(path)?;
    let reach = moment.map_or(0, |_| explained_frames);
    // Every second frame around the alarm: from just before the attack shows to where recovery flies.
    let around = steps.iter().skip(middle.saturating_sub(reach)).step_by(2).take(reach);
    let explained: Vec<usize> = around.copied().collect();
    let mut replay = (!explained.is_empty()).then(|| ExplainedReplay::of(&reader));
    // By the number of the picture.
    let mut explanations = Vec::new();
    let mut why_not = None;
    let clean: HashMap<u32, &[f32]> = log.story.clean.iter().map(|c| (c.sequence, &c.depth[..])).collect();
    let mut pictures = Vec::with_capacity(steps.len());
    let mut record = Box::<TickRecord>::default();
    let last = *steps.last().unwrap_or(&0);
    let mut wanted = steps.iter().copied().peekable();
    for number in 0..=last {
        // The same records were read before.
        if !reader.read_next(&mut record)? {
            break;
        }
        if let Some(Ok(replay)) = &mut replay {
            replay.step(&record);
        }
        let Some(frame) = record.frame() else { continue };
        if wanted.peek() != Some(&number) {
            continue;
        }
        wanted.next();
        let step = &log.steps[number];
        let near = moment.is_some_and(|at| number + BEFORE >= at && number < at + AFTER);
        let before = clean.get(&(frame.header.sequence as u32));
        if let Some(Ok(replay)) = replay.as_mut().filter(|_| explained.contains(&number)) {
            match replay.squares() {
                Ok(phi) => explanations.extend(phi.map(|phi| (pictures.len(), phi))),
                Err(error) => why_not = Some(error.to_string()),
            }
        }
        let change = log.yaw_change(step);
        pictures.push(json!({
            "t": log.seconds(step.now_ns),
            "who": log.who(&step.report),
            "altered": change.is_some(),
            "text": caption(log, step, change),
            "depth": depth_picture(&frame.depth, near),
            // Before it was altered, if that was kept.
            "clean": before.map(|depth| depth_picture(depth, near)),
            "shap": null,
        }));
    }
    draw_explanations(&explanations, &mut pictures);
    if let Some(Err(error)) = replay {
        why_not = Some(format!("{error:#}"));
    }
    // The first to be shown says most: an altered frame beside what it was, soon after the alarm.
    let telling = |p: &Value| p["clean"].is_string() && p["shap"].is_string() != explanations.is_empty();
    let found = pictures.iter().skip(middle).position(telling);
    Ok(Film {
        first_frame: (middle + found.unwrap_or(0)).min(pictures.len().saturating_sub(1)),
        frames: pictures,
        film_none: "",
        note: why_not.map(|why| format!("The pixels of the frames are not explained: {why}.")),
    })
}

/// Draws what each pixel did for the decision, all on one scale.
fn draw_explanations(explanations: &[(usize, Vec<f32>)], pictures: &mut [Value]) {
    let values = explanations.iter().flat_map(|(_, phi)| phi);
    let sizes: Vec<f64> = values.map(|v| f64::from(v.abs())).collect();
    let full = crate::statistics::quantile(&sizes, STRONG).unwrap_or(1.0).max(1e-9) as f32;
    for (place, phi) in explanations {
        if let Some(picture) = pictures.get_mut(*place) {
            picture["shap"] = shap_picture(phi, full).into();
        }
    }
}

fn caption(log: &LogSeen, step: &StepSeen, change: Option<f32>) -> String {
    let who = WHO[usize::from(log.who(&step.report))];
    let mut text = format!("{:.2} s, step {}: {who}", log.seconds(step.now_ns), step.step);
    if let Some(judgement) = step.report.judgement {
        match (judgement.score, log.threshold()) {
            (Some(score), Some(threshold)) => text += &format!("; score {score:.3}, threshold {threshold:.3}"),
            (Some(score), None) => text += &format!("; score {score:.3}"),
            (None, _) => text += "; no score",
        }
        text += &format!(", verdict {}", judgement.verdict.name());
    }
    if let Some(alarm) = step.report.alarm {
        text += &format!("; alarm: {}, {}", alarm.cause.name(), alarm.response.name());
    }
    if let Some(nearest) = step.nearest_return_m {
        text += &format!("; nearest return {nearest:.1} m");
    }
    if let Some(change) = change {
        text += &format!("; frame altered: the actor's yaw moved by {change:+.2}");
    }
    text
}

/// Near is bright, as in the contrast that the actor sees. 64 greys: the LiDAR's noise would only swell the file.
fn depth_picture(depth: &[f32], full_size: bool) -> String {
    let step = if full_size { 1 } else { 2 };
    let grey = |range: f32| (crate::cli::output::range_grey(range)[0] / 4).saturating_mul(4);
    let mut pixels = Vec::with_capacity(DEPTH_PIXELS / (step * step));
    for row in depth.chunks_exact(DEPTH_COLS).step_by(step) {
        pixels.extend(row.iter().step_by(step).map(|range| grey(*range)));
    }
    picture(&pixels, step, png::ColorType::Grayscale)
}

/// Orange turns right, blue turns left, white moves nothing: safe for the colour-blind.
fn shap_picture(sums: &[f32], full: f32) -> String {
    let mut pixels = Vec::with_capacity(3 * sums.len());
    for value in sums {
        let share = (value / full).clamp(-1.0, 1.0);
        let end: [f32; 3] = match share < 0.0 {
            true => [0.0, 90.0, 160.0],
            false => [200.0, 80.0, 0.0],
        };
        // 32 shades each, the weak ones lifted.
        let shade = (share.abs().sqrt() * 32.0).round() / 32.0;
        pixels.extend(end.map(|end| (255.0 + (end - 255.0) * shade) as u8));
    }
    picture(&pixels, SQUARE, png::ColorType::Rgb)
}

fn picture(pixels: &[u8], step: usize, colour: png::ColorType) -> String {
    let size = ((DEPTH_COLS / step) as u32, (DEPTH_ROWS / step) as u32);
    let bytes = png_bytes(size, pixels, |encoder| encoder.set_color(colour));
    format!("data:image/png;base64,{}", BASE64.encode(bytes))
}
