//! One flight explained step by step: the data of the paper's figures 12 to 14.

use crate::detector_training::error::DetectError;
use crate::detector_training::features::YAW;
use crate::detector_training::pixels::{BACKGROUNDS, Memory, explainer};
use crate::detector_training::recorded_flight::{Frame, Onlooker, Record, Step, fly};
use crate::detector_training::scenario::Scenario;
use vigil_detector::{DeepShap, FrozenDetector, Monitor};
use vigil_nnet::{Isa, Purpose};
use vigil_policy::actor::ACTOR_FRAMES;
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_types::{DEPTH_PIXELS, DepthFrame, Judgement};

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
    /// Number of the step.
    pub number: usize,
    /// Whether the newest frame was altered.
    pub frame: Frame,
    /// The newest frame as delivered: range over full scale, row by row.
    pub depth: Vec<f32>,
    /// SHAP values of its pixels for the yaw output: positive turns right.
    pub phi: Vec<f32>,
}

/// A flight explained.
#[derive(Debug, Clone, PartialEq)]
pub struct Portrait {
    /// Each step.
    pub steps: Vec<ExplainedStep>,
    /// Some steps' pixels.
    pub frames: Vec<ExplainedFrame>,
}

struct Explaining<'a> {
    monitor: Monitor,
    pixels: DeepShap,
    phi: Vec<f32>,
    memory: Memory,
    /// Steps whose pixels are explained.
    chosen: &'a [usize],
    portrait: Portrait,
}

impl Onlooker for Explaining<'_> {
    fn step(&mut self, step: &Step, delivered: &DepthFrame, _: &DepthFrame) -> Result<(), DetectError> {
        self.memory.push(delivered);
        let number = self.portrait.steps.len();
        self.portrait.steps.push(ExplainedStep {
            judgement: self.monitor.judge(&step.state, step.position),
            step: step.clone(),
        });
        if self.chosen.contains(&number)
            && let Some(inputs) = self.memory.inputs(&step.position)
        {
            self.pixels.evaluate(&inputs)?;
            self.pixels.attribute(YAW, &mut self.phi)?;
            let newest = self.phi.len() - step.position.len() - DEPTH_PIXELS;
            self.portrait.frames.push(ExplainedFrame {
                number,
                frame: step.frame,
                depth: delivered.depth.to_vec(),
                phi: self.phi[newest..newest + DEPTH_PIXELS].to_vec(),
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
) -> Result<(Record, Portrait), DetectError> {
    // Explaining changes nothing, so the same flight is flown first to know how long it takes.
    let pilot = FrozenPilot::from(actor);
    let steps = fly(isa, &pilot, scenario, &mut ())?.steps.len();
    let chosen: Vec<usize> = (0..pictures)
        .map(|i| (ACTOR_FRAMES + (2 * i + 1) * steps.saturating_sub(ACTOR_FRAMES) / (2 * pictures)).min(steps - 1))
        .collect();
    let pixels = explainer(isa, actor, BACKGROUNDS)?;
    let mut onlooker = Explaining {
        monitor: Monitor::new(isa, actor.head(Purpose::Multipliers)?, &actor.sha256(), detector)?,
        phi: vec![0.0; pixels.phi_len()],
        pixels,
        memory: Memory::new(actor.inputs.frame_ages),
        chosen: &chosen,
        portrait: Portrait {
            steps: Vec::new(),
            frames: Vec::new(),
        },
    };
    let record = fly(isa, &pilot, scenario, &mut onlooker)?;
    Ok((record, onlooker.portrait))
}
