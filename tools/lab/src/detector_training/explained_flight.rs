//! One flight explained step by step: the data of the paper's figures 12 to 14.

use crate::explained::{Frame, Onlooker, PixelExplainer, Record, Scenario, Shown, Step, YAW, fly};
use anyhow::Result;
use vigil_detector::{FrozenDetector, Monitor};
use vigil_nnet::{Isa, Purpose};
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_types::Judgement;

/// A step of the flight, explained at the split point and judged.
#[derive(Debug, Clone, PartialEq)]
pub struct ExplainedStep {
    /// What the actor decided, and on which frame.
    pub step: Step,
    /// Contributions of image, bearing and distance to the yaw output, and the verdict.
    pub judgement: Judgement,
}

/// A step of which every pixel was explained.
#[derive(Debug, Clone, PartialEq)]
pub struct ExplainedFrame {
    pub number: usize,
    /// Whether the newest frame was altered.
    pub frame: Frame,
    /// The newest frame as delivered: range over full scale, row by row.
    pub depth: Vec<f32>,
    /// SHAP values of its pixels for the yaw output: positive turns right.
    pub phi: Vec<f32>,
}

#[derive(Debug, Clone, Default, PartialEq)]
pub struct Portrait {
    pub steps: Vec<ExplainedStep>,
    pub frames: Vec<ExplainedFrame>,
}

struct Explaining<'a> {
    monitor: Monitor,
    pixels: PixelExplainer,
    /// Steps whose pixels are explained.
    chosen: &'a [usize],
    portrait: Portrait,
}

impl Onlooker for Explaining<'_> {
    fn step(&mut self, step: &Step, shown: &Shown<'_>) -> Result<()> {
        let number = self.portrait.steps.len();
        self.portrait.steps.push(ExplainedStep {
            judgement: self.monitor.judge(&step.state, step.position),
            step: step.clone(),
        });
        if self.chosen.contains(&number)
            && let Some(inputs) = shown.inputs(step)
        {
            let phi = self.pixels.of_inputs(&inputs, YAW)?.to_vec();
            self.portrait.frames.push(ExplainedFrame {
                number,
                frame: step.frame,
                depth: shown.input.depth.depth.to_vec(),
                phi,
            });
        }
        Ok(())
    }
}

/// Flies a scenario and explains it: the pixels of `pictures` steps, spread evenly over the flight.
///
/// # Errors
/// A detector of another actor, a scenario out of range.
pub fn portray(
    isa: Isa,
    actor: &FrozenActor,
    detector: &FrozenDetector,
    scenario: &Scenario,
    pictures: usize,
) -> Result<(Record, Portrait)> {
    // Explaining changes nothing, so the same flight is flown first to know how long it takes.
    let pilot = FrozenPilot::from(actor);
    let steps = fly(isa, &pilot, scenario, &mut ())?.steps.len();
    let chosen: Vec<usize> = (0..pictures).map(|i| (2 * i + 1) * steps / (2 * pictures)).collect();
    let mut onlooker = Explaining {
        monitor: Monitor::new(isa, actor.head(Purpose::Multipliers)?, &actor.sha256(), detector)?,
        pixels: PixelExplainer::new(isa, actor)?,
        chosen: &chosen,
        portrait: Portrait::default(),
    };
    let record = fly(isa, &pilot, scenario, &mut onlooker)?;
    Ok((record, onlooker.portrait))
}
