//! `vigil detector figures`: the paper's figures 12 to 14 of one flight. What they are drawn from is left beside them, so that
//! `vigil reproduce` draws the same.

use crate::cli::detector::Stage;
use crate::cli::output::{range_grey, say};
use crate::detector_training::{Adversary, Frame, PixelExplainer, Plan, Record, Scenario, YAW, fly};
use crate::report::{ColourScale, Figure, Panel, Picture, Plate, decimals, maybe_decimals, png_bytes, to_csv};
use anyhow::{Result, ensure};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde::{Deserialize, Serialize};
use std::path::Path;
use vigil_adversary::AttackConfig;
use vigil_detector::{FrozenDetector, Monitor};
use vigil_nnet::{Isa, Purpose};
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_sim::world::Family;
use vigil_types::{DEPTH_COLS, DEPTH_PIXELS, DEPTH_ROWS, STEP_S};

/// Steps that `--attacked` alters.
const BURST: core::ops::Range<u64> = 100..150;
/// Share of the pixels whose SHAP values are not beyond the colours' full strength.
const STRONG: f64 = 0.998;
/// A SHAP value of nothing, and a byte's steps on either side of it.
const NOTHING: u8 = 128;
const LEVELS: f32 = 127.0;
/// Colours of pixels that turn right and left, distinguishable with every kind of colour vision.
const RIGHT: [f32; 3] = [213.0, 94.0, 0.0];
const LEFT: [f32; 3] = [0.0, 114.0, 178.0];

/// The flight that figures 12 to 14 show, as `pixels.json` has it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Pixels {
    pub version: String,
    pub actor_sha256: String,
    pub detector_sha256: String,
    /// Validation course.
    pub seed: u64,
    /// Steps of the flight, and those attacked.
    pub steps: usize,
    pub attacked: Option<(u64, u64)>,
    pub outcome: String,
    /// A score above it is an attack.
    pub threshold: f32,
    /// SHAP value of the colours' full strength, action units.
    pub full_strength: f64,
    pub frames: Vec<PixelFrame>,
}

/// A frame and what its pixels contributed: grey PNGs of 256 × 128, in base64.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct PixelFrame {
    pub step: usize,
    pub altered: bool,
    /// As it is shown: near is bright.
    depth_png: String,
    /// 128 is nothing, 255 turns right and 1 left at full strength.
    shap_png: String,
}

fn packed(pixels: &[u8]) -> String {
    let size = (DEPTH_COLS as u32, DEPTH_ROWS as u32);
    let png = png_bytes(size, pixels, |encoder| encoder.set_color(png::ColorType::Grayscale));
    BASE64.encode(png)
}

fn unpacked(text: &str) -> Result<Vec<u8>> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(BASE64.decode(text)?)).read_info()?;
    let mut pixels = vec![0; DEPTH_PIXELS];
    ensure!(
        reader.output_buffer_size() == Some(DEPTH_PIXELS),
        "a picture of another size"
    );
    reader.next_frame(&mut pixels)?;
    Ok(pixels)
}

/// A step whose pixels were explained: its number, whether its frame was altered, the frame as delivered (range over full scale), and the
/// SHAP values of its pixels for the yaw output: positive turns right.
type Explained = (usize, bool, Vec<f32>, Vec<f32>);

/// Flies a scenario, explains and scores each step, and of some spread evenly over the flight every pixel.
fn explained(
    isa: Isa,
    (actor, detector): (&FrozenActor, &FrozenDetector),
    scenario: &Scenario,
    pictures: usize,
) -> Result<(Record, Vec<ExplanationLine>, Vec<Explained>)> {
    // Explaining changes nothing, so the same flight is flown first to know how long it takes.
    let pilot = FrozenPilot::from(actor);
    let steps = fly(isa, &pilot, scenario, &mut |_, _| Ok(()))?.steps.len();
    let chosen: Vec<usize> = (0..pictures).map(|i| (2 * i + 1) * steps / (2 * pictures)).collect();
    let mut monitor = Monitor::new(isa, actor.head(Purpose::Multipliers)?, &actor.sha256(), detector)?;
    let mut pixels = PixelExplainer::new(isa, actor)?;
    let (mut lines, mut frames) = (Vec::new(), Vec::new());
    let record = fly(isa, &pilot, scenario, &mut |step, shown| {
        let (number, altered) = (lines.len(), step.frame == Frame::Attacked);
        let j = monitor.score(&step.state, step.low_dim);
        lines.push(ExplanationLine {
            time_s: seconds(number),
            altered: altered.into(),
            yaw: step.output[YAW],
            base: j.base,
            image: j.image,
            bearing: j.bearing,
            distance: j.distance,
            told: j.told,
            score: j.score,
            verdict: j.verdict.name().to_owned(),
        });
        if chosen.contains(&number)
            && let Some(inputs) = shown.inputs(step)
        {
            let phi = pixels.of_inputs(&inputs, YAW)?.to_vec();
            frames.push((number, altered, shown.input.depth.depth.to_vec(), phi));
        }
        Ok(())
    })?;
    Ok((record, lines, frames))
}

impl Pixels {
    fn of(frames: &[Explained]) -> (f64, Vec<PixelFrame>) {
        let sizes: Vec<f64> = frames.iter().flat_map(|f| &f.3).map(|v| f64::from(v.abs())).collect();
        let full = crate::statistics::quantile(&sizes, STRONG).unwrap_or(1.0).max(1e-9);
        let level = |value: f32| (LEVELS * (value / full as f32).clamp(-1.0, 1.0)).round() as i16 + i16::from(NOTHING);
        let frame = |(step, altered, depth, phi): &Explained| PixelFrame {
            step: *step,
            altered: *altered,
            depth_png: packed(&depth.iter().map(|range| range_grey(*range)[0]).collect::<Vec<_>>()),
            shap_png: packed(&phi.iter().map(|value| level(*value) as u8).collect::<Vec<_>>()),
        };
        (full, frames.iter().map(frame).collect())
    }
}

impl Stage<'_> {
    /// Flies validation course `seed`, attacked or not, and draws into the folder.
    pub fn figures(&self, seed: u64, attacked: bool, pictures: usize, detector: Option<&Path>) -> Result<()> {
        let (actor, detector) = (self.actor("figures")?, self.detector(detector)?);
        let scenario = Scenario {
            adversary: attacked.then(|| Adversary {
                config: AttackConfig::PAPER,
                bursts: vec![BURST],
            }),
            ..Scenario::unattacked(Family::Validation, seed, Plan::Actor)
        };
        let (record, lines, frames) = explained(self.isa, (actor, &detector), &scenario, pictures)?;
        let steps = record.steps.len();
        let write = |name: &str, content: &[u8]| {
            self.write(name, content)?;
            say!("{}", self.path(name).display());
            Ok::<_, anyhow::Error>(())
        };
        let (full_strength, frames) = Pixels::of(&frames);
        let pixels = Pixels {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            actor_sha256: actor.sha256(),
            detector_sha256: detector.sha256(),
            seed,
            steps,
            attacked: attacked.then_some((BURST.start, BURST.end)),
            outcome: record
                .outcome
                .map_or("cut off".to_owned(), |o| format!("{o:?}").to_lowercase()),
            threshold: detector.threshold,
            full_strength,
            frames,
        };
        write("pixels.json", &serde_json::to_vec_pretty(&pixels)?)?;
        write("explanations.csv", to_csv(&lines).as_bytes())?;
        let drawn = [
            figure_12(&pixels)?.save(self.folder, "figure-12")?,
            figure_13(&pixels, &lines).save(self.folder, "figure-13")?,
            figure_14(&pixels, &lines).save(self.folder, "figure-14")?,
        ];
        for path in drawn.as_flattened() {
            say!("{}", path.display());
        }
        let burst = attacked.then(|| format!(", those from {} to {} attacked", BURST.start, BURST.end - 1));
        let (burst, outcome) = (burst.unwrap_or_default(), pixels.outcome);
        say!("validation course {seed}, {steps} steps{burst}, flight ended: {outcome}");
        Ok(())
    }
}

fn seconds(step: usize) -> f64 {
    step as f64 * f64::from(STEP_S)
}

/// White to the colour of the direction, by how strong.
fn shap_colour(level: u8) -> [u8; 3] {
    let value = (f32::from(level) - f32::from(NOTHING)) / LEVELS;
    let full = if value > 0.0 { RIGHT } else { LEFT };
    full.map(|c| (255.0 + value.abs().min(1.0) * (c - 255.0)).round() as u8)
}

/// Beside each frame the SHAP values of its pixels for the yaw output. One scale for all.
pub(crate) fn figure_12(pixels: &Pixels) -> Result<Plate> {
    let row = |frame: &PixelFrame| {
        let depth: Vec<u8> = unpacked(&frame.depth_png)?.iter().flat_map(|grey| [*grey; 3]).collect();
        let shap = unpacked(&frame.shap_png)?
            .iter()
            .flat_map(|level| shap_colour(*level))
            .collect();
        let mut words = vec![format!("{:.1} s", seconds(frame.step))];
        if frame.altered {
            words.push("attacked".to_owned());
        }
        Ok((words, [depth, shap]))
    };
    let full = format!("{:.4}", pixels.full_strength);
    let values = ColourScale {
        label: "SHAP value of a pixel (action units): blue turns left, orange right".to_owned(),
        ticks: vec![(0.0, format!("−{full}")), (0.5, "0".to_owned()), (1.0, full)],
        colours: (1..=255).map(shap_colour).collect(),
    };
    Ok(Plate {
        title: format!("Pixels that turn the vehicle, validation course {}", pixels.seed),
        columns: [
            ("newest depth frame", ColourScale::of_ranges()),
            ("SHAP values for the yaw output", values),
        ],
        rows: pixels.frames.iter().map(row).collect::<Result<_>>()?,
    })
}

fn over_time(pixels: &Pixels, panels: Vec<Panel>) -> Figure {
    let span = |(from, to)| ("attacked".to_owned(), seconds(from as usize), seconds(to as usize));
    Figure {
        span: pixels.attacked.map(span),
        ..Figure::over("time (s)", seconds(pixels.steps), panels)
    }
}

/// A quantity over time.
fn line(lines: &[ExplanationLine], value: impl Fn(&ExplanationLine) -> f32) -> Vec<(f64, f64)> {
    lines.iter().map(|l| (l.time_s, f64::from(value(l)))).collect()
}

/// What moved the yaw output, and what the detector made of it.
pub(crate) fn figure_13(pixels: &Pixels, lines: &[ExplanationLine]) -> Figure {
    let mut score = Panel::new(
        "Score of the detector",
        "score",
        [("score", line(lines, |l| l.score.unwrap_or(f32::NAN)))],
    );
    let threshold = f64::from(pixels.threshold);
    score.thresholds.push((format!("threshold {threshold:.3}"), threshold));
    let contributions = Panel::new(
        "SHAP values of the yaw output",
        "SHAP (units of 30 °/s)",
        [
            ("image", line(lines, |l| l.image)),
            ("bearing", line(lines, |l| l.bearing)),
            ("distance", line(lines, |l| l.distance)),
            ("told", line(lines, |l| l.told)),
        ],
    );
    over_time(pixels, vec![contributions, score])
}

/// By additivity the two lines are one.
pub(crate) fn figure_14(pixels: &Pixels, lines: &[ExplanationLine]) -> Figure {
    let sum = ExplanationLine::sum;
    let mut both = Panel::new(
        "Yaw output, and the sum that explains it",
        "yaw (units of 30 °/s)",
        [
            ("yaw output", line(lines, |l| l.yaw)),
            ("constant + SHAP values", line(lines, sum)),
        ],
    );
    both.series[1].dashed = true;
    let difference = Panel::new(
        "Sum less yaw output",
        "millionths of 30 °/s",
        [("difference", line(lines, |l| 1e6 * (sum(l) - l.yaw)))],
    );
    over_time(pixels, vec![both, difference])
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct ExplanationLine {
    #[serde(serialize_with = "decimals::<2, _, _>")]
    pub time_s: f64,
    pub altered: u8,
    #[serde(serialize_with = "decimals::<7, _, _>")]
    pub yaw: f32,
    #[serde(serialize_with = "decimals::<7, _, _>")]
    pub base: f32,
    #[serde(serialize_with = "decimals::<7, _, _>")]
    pub image: f32,
    #[serde(serialize_with = "decimals::<7, _, _>")]
    pub bearing: f32,
    #[serde(serialize_with = "decimals::<7, _, _>")]
    pub distance: f32,
    /// Of actors that observe more than the goal.
    #[serde(serialize_with = "decimals::<7, _, _>")]
    pub told: f32,
    #[serde(serialize_with = "maybe_decimals::<7, _, _>")]
    pub score: Option<f32>,
    pub verdict: String,
}

impl ExplanationLine {
    /// What explains the yaw output, put together again.
    pub fn sum(&self) -> f32 {
        self.base + self.image + self.bearing + self.distance + self.told
    }
}
