//! `vigil detector figures`: the paper's figures 12 to 14 of one flight.

use crate::cli::output::{self, range_grey, say};
use crate::detector_training::{Adversary, ExplainedFrame, ExplainedStep, Frame, Plan, Portrait, Scenario, portray};
use crate::report::{Figure, Panel, decimals, maybe_decimals, to_csv};
use anyhow::{Context, Result};
use serde::Serialize;
use std::path::Path;
use vigil_adversary::AttackConfig;
use vigil_detector::FrozenDetector;
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, Judgement, STEP_S, Verdict};
use vigil_world::{Family, Image};

/// Steps that `--attacked` alters.
const BURST: core::ops::Range<u64> = 100..150;
/// White between the pictures of figure 12, pixels.
const GAP: usize = 4;
/// Share of the pixels whose SHAP values are not beyond the colours' full strength.
const STRONG: f64 = 0.998;

/// Flies validation course `seed`, attacked or not, and draws into the folder.
///
/// # Errors
/// A detector of another actor, a folder that cannot be written.
pub fn draw(
    isa: Isa,
    actor: &FrozenActor,
    detector: &FrozenDetector,
    (seed, attacked): (u64, bool),
    pictures: usize,
    folder: &Path,
) -> Result<()> {
    let scenario = Scenario {
        adversary: attacked.then(|| Adversary {
            config: AttackConfig::PAPER,
            bursts: vec![BURST],
        }),
        ..Scenario::unattacked(Family::Validation, seed, Plan::Actor)
    };
    let (record, portrait) = portray(isa, actor, detector, &scenario, pictures)?;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let write = |name: &str, content: &[u8]| {
        let path = folder.join(name);
        say!("{}", path.display());
        output::write(&path, content)
    };
    figure_12(&portrait.frames).write_png(&folder.join("figure-12.png"))?;
    say!("{}", folder.join("figure-12.png").display());
    let steps = &portrait.steps;
    let last_s = seconds(steps.len());
    write("figure-13.png", &over_time(contributions(steps), last_s))?;
    write("figure-14.png", &over_time(sum_and_action(steps), last_s))?;
    write("explanations.csv", explanations_csv(&portrait).as_bytes())?;
    say!(
        "validation course {seed}, {} steps{}, flight ended: {}",
        steps.len(),
        if attacked {
            format!(", those from {} to {} attacked", BURST.start, BURST.end - 1)
        } else {
            String::new()
        },
        record
            .outcome
            .map_or("cut off".to_owned(), |o| format!("{o:?}").to_lowercase())
    );
    Ok(())
}

fn seconds(step: usize) -> f64 {
    step as f64 * f64::from(STEP_S)
}

/// Beside each frame (near is bright) the SHAP values of its pixels for the yaw output: red turns right, green left. One scale for all.
fn figure_12(frames: &[ExplainedFrame]) -> Image {
    let sizes: Vec<f64> = frames.iter().flat_map(|f| &f.phi).map(|v| f64::from(v.abs())).collect();
    let full = crate::statistics::quantile(&sizes, STRONG).unwrap_or(1.0).max(1e-9) as f32;
    let row = DEPTH_ROWS + GAP;
    Image::from_fn(2 * DEPTH_COLS + GAP, frames.len() * row, |x, y| {
        let (Some(frame), y) = (frames.get(y / row), y % row) else {
            return [255; 3];
        };
        let x_of = |from: usize| x.checked_sub(from).filter(|x| *x < DEPTH_COLS && y < DEPTH_ROWS);
        if let Some(x) = x_of(0) {
            return range_grey(frame.depth[y * DEPTH_COLS + x]);
        }
        let Some(x) = x_of(DEPTH_COLS + GAP) else {
            return [255; 3];
        };
        let value = (frame.phi[y * DEPTH_COLS + x] / full).clamp(-1.0, 1.0);
        let faded = (255.0 * (1.0 - value.abs())) as u8;
        if value > 0.0 {
            [255, faded, faded]
        } else {
            [faded, 255 - (255 - faded) / 2, faded]
        }
    })
}

/// A quantity over time.
fn line(steps: &[ExplainedStep], value: impl Fn(&ExplainedStep) -> f32) -> Vec<(f64, f64)> {
    let at = |(number, step)| (seconds(number), f64::from(value(step)));
    steps.iter().enumerate().map(at).collect()
}

fn over_time(panels: Vec<Panel>, last_s: f64) -> Vec<u8> {
    Figure {
        x_label: "time (s)".to_owned(),
        x_last: last_s,
        panels,
    }
    .png()
}

fn contributions(steps: &[ExplainedStep]) -> Vec<Panel> {
    let of = |value: fn(&Judgement) -> f32| line(steps, move |s| value(&s.judgement));
    vec![
        Panel::new(
            "SHAP values of the yaw output",
            "SHAP value (action units)",
            [
                ("image", of(|j| j.image)),
                ("bearing", of(|j| j.bearing)),
                ("distance", of(|j| j.distance)),
            ],
        ),
        Panel::new(
            "Score of the detector",
            "score",
            [("score", of(|j| j.score.unwrap_or(f32::NAN)))],
        ),
        Panel::new(
            "Frames altered",
            "altered (1: yes)",
            [(
                "altered",
                line(steps, |s| f32::from(u8::from(s.step.frame == Frame::Attacked))),
            )],
        ),
    ]
}

/// By additivity the two lines are one.
fn sum_and_action(steps: &[ExplainedStep]) -> Vec<Panel> {
    let sum = |j: &Judgement| j.base + j.image + j.bearing + j.distance;
    vec![
        Panel::new(
            "Yaw output, and mean of the background plus SHAP values",
            "yaw output (units of 30 °/s)",
            [
                ("yaw output", line(steps, |s| s.step.output[1])),
                ("explained", line(steps, |s| sum(&s.judgement))),
            ],
        ),
        Panel::new(
            "Difference",
            "units of 30 °/s",
            [(
                "explained - yaw output",
                line(steps, |s| sum(&s.judgement) - s.step.output[1]),
            )],
        ),
    ]
}

/// A line of `explanations.csv`.
#[derive(Serialize)]
struct ExplanationLine {
    #[serde(serialize_with = "decimals::<2, _, _>")]
    time_s: f64,
    altered: u8,
    #[serde(serialize_with = "decimals::<5, _, _>")]
    yaw: f32,
    #[serde(serialize_with = "decimals::<5, _, _>")]
    base: f32,
    #[serde(serialize_with = "decimals::<5, _, _>")]
    image: f32,
    #[serde(serialize_with = "decimals::<5, _, _>")]
    bearing: f32,
    #[serde(serialize_with = "decimals::<5, _, _>")]
    distance: f32,
    #[serde(serialize_with = "maybe_decimals::<5, _, _>")]
    score: Option<f32>,
    verdict: &'static str,
}

fn explanations_csv(portrait: &Portrait) -> String {
    let line = |(number, ExplainedStep { step, judgement: j }): (usize, &ExplainedStep)| ExplanationLine {
        time_s: seconds(number),
        altered: (step.frame == Frame::Attacked).into(),
        yaw: step.output[1],
        base: j.base,
        image: j.image,
        bearing: j.bearing,
        distance: j.distance,
        score: j.score,
        verdict: match j.verdict {
            Verdict::Unknown => "unknown",
            Verdict::Clean => "clean",
            Verdict::Attack => "attack",
        },
    };
    to_csv(portrait.steps.iter().enumerate().map(line))
}
