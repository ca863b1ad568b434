//! States with the SHAP image of their newest frame, for the detectors that look at images.

use crate::cli::output;
use crate::detector_training::evaluation::plan_of;
use crate::detector_training::flight_files::{load_flights, not_collected, save_flights};
use crate::explained::{Adversary, Frame, MAX_STEPS, Record, Scenario, YAW, explainer, fly};
use anyhow::{Context, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::collections::HashMap;
use std::ops::ControlFlow;
use std::path::Path;
use vigil_adversary::{AttackConfig, Towards};
use vigil_detector::{DeepShap, IMAGE, WINDOW, image};
use vigil_nnet::Isa;
use vigil_policy::actor::memory::SCAN_AGES;
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_sim::world::Family;
use vigil_types::DEPTH_PIXELS;

/// Threads that share an explanation's backgrounds: fixed, since the sum's last bits depend on it.
const SHAP_THREADS: usize = 2;
/// Steps between states of one class in one flight, and how many at most.
const STRIDE: usize = 7;
/// An unattacked state's last steps, in which no frame was altered: the window's, and those whose scans the actor holds.
const HELD_STEPS: usize = 1 + SCAN_AGES[0];
const PER_FLIGHT: usize = 12;

/// A state whose newest frame was attacked, or that holds no altered one.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    pub flight: usize,
    pub step: usize,
    pub attacked: bool,
    /// Its image, [`vigil_detector::image`].
    pub image: Vec<u8>,
}

/// States with their flights.
#[derive(Debug, Clone, PartialEq)]
pub struct States {
    pub records: Vec<Record>,
    /// The states, half of them attacked.
    pub states: Vec<State>,
    /// States of the background sample; `None` in older files.
    pub backgrounds: Option<u32>,
}

/// A flight under the paper's attack, streaming, in bursts of 10 to 60 steps; the actor flies, or a recovery.
fn scenario(family: Family, seed: u64) -> Scenario {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let config = AttackConfig {
        towards: [Towards::Left, Towards::Right, Towards::Away][rng.random_range(0..3)],
        seed,
        ..AttackConfig::PAPER
    };
    let length = rng.random_range(10..60);
    Scenario {
        adversary: Some(Adversary::in_bursts(config, length, MAX_STEPS, &mut rng)),
        altered: (STRIDE * PER_FLIGHT) as u64,
        ..Scenario::unattacked(family, seed, plan_of(seed))
    }
}

/// Flies a scenario and explains states of it as they are met.
fn fly_explained(
    isa: Isa,
    pilot: &FrozenPilot,
    scenario: &Scenario,
    shap: &mut DeepShap,
    (flight, states): (usize, &mut Vec<State>),
) -> Result<Record> {
    // Its frames, altered or not; steps since the last state of each class, and how many there are.
    let (mut frames, mut since, mut taken) = (Vec::new(), [STRIDE; 2], [0; 2]);
    let mut phi = vec![0.0; shap.phi_len()];
    fly(isa, pilot, scenario, &mut |step, shown| {
        let number = frames.len();
        frames.push(step.frame);
        since = since.map(|s| s + 1);
        let attacked = step.frame == Frame::Attacked;
        let mut held = frames.iter().rev().take(HELD_STEPS);
        let class = usize::from(attacked);
        if number + 1 < WINDOW
            || !(attacked || held.all(|frame| *frame == Frame::Unaltered))
            || since[class] < STRIDE
            || taken[class] >= PER_FLIGHT
        {
            return Ok(());
        }
        let Some(inputs) = shown.inputs(step) else {
            return Ok(());
        };
        shap.evaluate(&inputs)?;
        shap.attribute_on_threads(YAW, SHAP_THREADS, &mut phi)?;
        let image = image(&phi[..DEPTH_PIXELS]).unwrap_or_else(|| unreachable!("a frame's finite pixels"));
        (since[class], taken[class]) = (0, taken[class] + 1);
        let step = number;
        states.push(State {
            flight,
            step,
            attacked,
            image,
        });
        Ok(())
    })
}

/// Flies and explains until there are `count` states of each class, or `progress` breaks it off after a flight; goes on with what was
/// `begun` by an earlier call with the same arguments. Also returns whether it is complete: what is not is to be begun with.
///
/// # Errors
/// Parameters of another architecture.
pub fn gather_states(
    isa: Isa,
    actor: &FrozenActor,
    (family, first_seed): (Family, u64),
    (count, backgrounds): (usize, usize),
    begun: Option<States>,
    progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<(States, bool)> {
    let pilot = FrozenPilot::from(actor);
    let mut shap = explainer(isa, actor, backgrounds)?;
    let (mut records, mut states) = begun.map_or_else(Default::default, |begun| (begun.records, begun.states));
    let of_class = |states: &[State], attacked: bool| states.iter().filter(|s| s.attacked == attacked).count();
    let fewer = |states: &[State]| of_class(states, true).min(of_class(states, false));
    // A flight for each seed.
    let mut seed = first_seed.wrapping_add(records.len() as u64);
    let mut flow = ControlFlow::Continue(());
    while fewer(&states) < count && flow.is_continue() {
        let to = (records.len(), &mut states);
        records.push(fly_explained(isa, &pilot, &scenario(family, seed), &mut shap, to)?);
        seed += 1;
        flow = progress(fewer(&states).min(count));
    }
    let complete = fewer(&states) >= count;
    if complete {
        let mut left = [count; 2];
        states.retain(|s| {
            let left = &mut left[usize::from(s.attacked)];
            *left = left.wrapping_sub(1);
            *left < count
        });
    }
    let backgrounds = Some(backgrounds as u32);
    let states = States {
        records,
        states,
        backgrounds,
    };
    Ok((states, complete))
}

/// A state has 16 kB.
const SIZE_LIMIT: u64 = 16 << 30;
/// Value of the metadata entry `format`.
const FORMAT: &str = "vigil detector images 2";

impl States {
    /// Writes the images to `path` and the flights beside, `.flights`.
    pub fn save(&self, path: &Path, actor: &FrozenActor) -> Result<()> {
        let flights = path.with_extension("flights");
        save_flights(&flights, &FrozenPilot::from(actor), &self.records)?;
        let images: Vec<u8> = self.states.iter().flat_map(|s| s.image.iter().copied()).collect();
        let places: Vec<u8> = self
            .states
            .iter()
            .flat_map(|s| [s.flight as u32, s.step as u32, u32::from(s.attacked)])
            .flat_map(u32::to_le_bytes)
            .collect();
        let count = self.states.len();
        let backgrounds: Vec<u8> = self.backgrounds.iter().flat_map(|n| n.to_le_bytes()).collect();
        let tensors = [
            (
                "backgrounds",
                TensorView::new(Dtype::U32, vec![backgrounds.len() / 4], &backgrounds)?,
            ),
            ("images", TensorView::new(Dtype::U8, vec![count, IMAGE], &images)?),
            ("places", TensorView::new(Dtype::U32, vec![count, 3], &places)?),
        ];
        let metadata = HashMap::from([("format".to_owned(), FORMAT.to_owned())]);
        output::write(path, safetensors::serialize(tensors, Some(metadata))?)
    }

    /// Reads them.
    ///
    /// # Errors
    /// A file that cannot be read, holds something else, or was gathered with another actor.
    pub fn load(path: &Path, actor: &FrozenActor) -> Result<Self> {
        let records = load_flights(&path.with_extension("flights"), &FrozenPilot::from(actor))?;
        let bytes =
            vigil_types::files::read(path, SIZE_LIMIT).with_context(|| format!("cannot read {}", path.display()))?;
        let data = |message: &str| not_collected(path, message);
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| data(&e.to_string()))?;
        let content = SafeTensors::deserialize(&bytes).map_err(|e| data(&e.to_string()))?;
        let format = header.metadata().as_ref().and_then(|m| m.get("format"));
        if format.map(String::as_str) != Some(FORMAT) {
            return Err(data("it is of another format"));
        }
        let tensor = |name| content.tensor(name).map_err(|e| data(&e.to_string()));
        let (images, places) = (tensor("images")?, tensor("places")?);
        let numbers = places.data().as_chunks::<4>().0.iter();
        let numbers: Vec<usize> = numbers.map(|b| u32::from_le_bytes(*b) as usize).collect();
        let places = numbers.as_chunks::<3>().0;
        let known = |[flight, step, _]: &[usize; 3]| {
            let record = records.get(*flight);
            record.is_some_and(|r| (WINDOW - 1..r.steps.len()).contains(step))
        };
        if images.data().len() != places.len() * IMAGE || !places.iter().all(known) {
            return Err(data("its images and its flights do not belong together"));
        }
        let states = images.data().chunks_exact(IMAGE).zip(places);
        let backgrounds = content.tensor("backgrounds").ok();
        let backgrounds = backgrounds.and_then(|tensor| tensor.data().first_chunk().copied());
        Ok(Self {
            backgrounds: backgrounds.map(u32::from_le_bytes),
            states: states
                .map(|(image, [flight, step, attacked])| State {
                    flight: *flight,
                    step: *step,
                    attacked: *attacked == 1,
                    image: image.to_vec(),
                })
                .collect(),
            records,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_images_says_how_many_backgrounds_they_are_against() {
        let (folder, actor) = (tempfile::tempdir().unwrap(), FrozenActor::built_in().unwrap());
        let path = folder.path().join("images.safetensors");
        let states = States {
            records: Vec::new(),
            states: Vec::new(),
            backgrounds: Some(30),
        };
        states.save(&path, &actor).unwrap();
        assert_eq!(States::load(&path, &actor).unwrap(), states);
    }
}
