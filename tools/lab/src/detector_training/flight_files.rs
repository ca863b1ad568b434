//! Gathering flights and keeping them in files.

use crate::cli::output;
use crate::explained::{Ending, Frame, Record, Scenario, Step, held_frames};
use anyhow::{Context, Error, Result, anyhow, ensure};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;
use vigil_detector::WINDOW;
use vigil_policy::FrozenPilot;
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS, GOAL_INPUTS, LOW_DIM, LowDim};

/// How many windows there are of each [`Class`], in the order of these.
pub type Counts = [usize; 4];

/// Of some flights.
pub fn counts_of(records: &[Record]) -> Counts {
    let mut counts = [0; 4];
    for (_, class) in records.iter().flat_map(Class::of_windows) {
        counts[class as usize] += 1;
    }
    counts
}

/// What a window is, by its newest step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// Its frame was attacked, and the yaw output moved by [`WEAK_YAW`] or more.
    Attacked,
    /// Its frame was attacked, but to little effect: nothing is learned from it. Scored apart.
    Weak,
    /// Its frame was delivered as taken, but an older one, which the actor's state holds too, was attacked.
    /// Nothing is learned from it. Scored apart.
    Lingering,
    /// No attacked frame is in the actor's state.
    Unattacked,
}

/// A change of the yaw output below it is next to no attack: 3 °/s.
pub const WEAK_YAW: f32 = 0.1;

impl Class {
    /// Of a flight's windows, each with its newest step.
    pub fn of_windows(record: &Record) -> impl Iterator<Item = (usize, Self)> + use<'_> {
        (WINDOW - 1..record.steps.len()).map(|step| (step, Self::of(record, step)))
    }

    /// Of a flight's step.
    pub fn of(record: &Record, step: usize) -> Self {
        let taken = |age: &usize| record.steps.get(step.saturating_sub(*age));
        let held = || record.frame_ages.iter().filter_map(taken);
        match record.steps.get(step) {
            Some(newest) if newest.frame == Frame::Attacked && newest.yaw_change.abs() >= WEAK_YAW => Self::Attacked,
            Some(newest) if newest.frame == Frame::Attacked => Self::Weak,
            _ if held().any(|s| s.frame == Frame::Attacked) => Self::Lingering,
            _ => Self::Unattacked,
        }
    }
}

/// Flights flown at once; fixed, so that what is gathered does not depend on the number of threads.
pub const BLOCK: u64 = 12;

/// An hour of flight has 15 MB.
const SIZE_LIMIT: u64 = 4 << 30;

/// Key of the only metadata entry: with several the order, and so the file, would be another in each process.
const FORMAT: &str = "vigil detector data 2";
/// Beside what a frame is: it is a rough picture.
const ROUGH: u8 = 4;
/// Numbers kept of a step beside the split point's values and the low-dimensional observation.
const BESIDE_STATE: usize = ACTOR_OUTPUTS + 1;

/// Refuses a file of something else, or of an older version.
pub(super) fn not_collected(path: &Path, message: &str) -> Error {
    let path = path.display();
    anyhow!("{path} holds no data of `vigil detector collect`: {message}; remove it and collect anew")
}

/// What a pilot's flights have in common: whose they are, and how wide their steps.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recorded {
    pub actor_sha256: String,
    /// Values of its split point.
    pub state: usize,
    /// Its low-dimensional observation.
    pub low_dim: usize,
    /// How many steps ago each frame was taken that a decision holds, oldest first.
    pub frame_ages: Vec<usize>,
}

impl Recorded {
    /// By a pilot.
    ///
    /// # Errors
    /// A policy without a split point.
    pub fn by(pilot: &FrozenPilot) -> Result<Self> {
        let (state, low_dim) = match pilot {
            FrozenPilot::Actor(_) => (ACTOR_HIDDEN, LOW_DIM),
            FrozenPilot::Imported(policy) => (policy.head()?.width, GOAL_INPUTS),
        };
        Ok(Self {
            actor_sha256: pilot.sha256(),
            state,
            low_dim,
            frame_ages: held_frames(pilot),
        })
    }
}

/// The metadata entry, JSON.
#[derive(Serialize, Deserialize)]
struct About {
    actor_sha256: String,
    flights: Vec<Entry>,
}

/// A flight's entry in the file.
#[derive(Serialize, Deserialize)]
struct Entry {
    scenario: Scenario,
    outcome: Option<Ending>,
    steps: usize,
}

/// Writes a pilot's flights.
pub fn save_flights(path: &Path, pilot: &FrozenPilot, records: &[Record]) -> Result<()> {
    let bytes = to_bytes(pilot, records)?;
    output::prepare(path)?;
    output::write(path, bytes)
}

/// A file's content: `steps` (float32: split point's values, low-dimensional observation, outputs, change of yaw), `frames` (0 unaltered, 1
/// attacked, 2 noisy; and 4 where the picture is rough), and what was flown as JSON in the metadata.
pub fn to_bytes(pilot: &FrozenPilot, records: &[Record]) -> Result<Vec<u8>> {
    let steps = || records.iter().flat_map(|r| &r.steps);
    let count = steps().count();
    let width = BESIDE_STATE + steps().next().map_or(0, |step| step.state.len() + step.low_dim.len());
    let mut values = Vec::with_capacity(4 * width * count);
    let mut frames = Vec::with_capacity(count);
    for step in steps() {
        let numbers = step.state.iter().chain(&step.low_dim[..]).chain(&step.output);
        for number in numbers.chain([&step.yaw_change]) {
            values.extend(number.to_le_bytes());
        }
        frames.push(step.frame as u8 | if step.rough { ROUGH } else { 0 });
    }
    let entry = |r: &Record| Entry {
        scenario: r.scenario.clone(),
        outcome: r.outcome,
        steps: r.steps.len(),
    };
    let about = About {
        actor_sha256: pilot.sha256(),
        flights: records.iter().map(entry).collect(),
    };
    let json = serde_json::to_string(&about)?;
    let metadata = HashMap::from([(FORMAT.to_owned(), json)]);
    let tensors = [
        ("steps", TensorView::new(Dtype::F32, vec![count, width], &values)?),
        ("frames", TensorView::new(Dtype::U8, vec![count], &frames)?),
    ];
    Ok(safetensors::serialize(tensors, Some(metadata))?)
}

/// Reads a pilot's flights.
///
/// # Errors
/// A file that cannot be read, holds something else, or was gathered with another actor.
pub fn load_flights(path: &Path, pilot: &FrozenPilot) -> Result<Vec<Record>> {
    let bytes =
        vigil_types::files::read(path, SIZE_LIMIT).with_context(|| format!("cannot read {}", path.display()))?;
    from_bytes(path, &bytes, &Recorded::by(pilot)?)
}

/// Reads a file's content. `path` names it in errors.
///
/// # Errors
/// Something else, or flights of another actor.
pub fn from_bytes(path: &Path, bytes: &[u8], recorded: &Recorded) -> Result<Vec<Record>> {
    let data = |message: &str| not_collected(path, message);
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| data(&e.to_string()))?;
    let content = SafeTensors::deserialize(bytes).map_err(|e| data(&e.to_string()))?;
    let metadata = header.metadata().as_ref();
    let json = metadata
        .and_then(|entries| entries.get(FORMAT))
        .ok_or_else(|| data("it is of another format"))?;
    let about: About = serde_json::from_str(json).map_err(|e| data(&e.to_string()))?;
    let (path, found, expected) = (path.display(), &about.actor_sha256, &recorded.actor_sha256);
    ensure!(
        found == expected,
        "{path} was collected with the actor {found}, this is the actor {expected}; remove it, or name another folder \
         with -o, and collect anew"
    );
    let entries = about.flights;
    let tensor = |name| content.tensor(name).map_err(|e| data(&e.to_string()));
    let (values, frames) = (tensor("steps")?, tensor("frames")?);
    let numbers = values.data().as_chunks::<4>().0.iter();
    let values: Vec<f32> = numbers.map(|b| f32::from_le_bytes(*b)).collect();
    let (hidden, low_dim) = (recorded.state, recorded.low_dim);
    let width = BESIDE_STATE + hidden + low_dim;
    if entries.iter().map(|e| e.steps).sum::<usize>() * width != values.len()
        || frames.data().len() * width != values.len()
    {
        return Err(data("its flights and its steps do not belong together"));
    }
    let mut steps = values.chunks_exact(width).zip(frames.data()).map(|(values, frame)| {
        let (state, rest) = values.split_at(hidden);
        let (low_dim, rest) = rest.split_at(low_dim);
        let (output, yaw_change) = rest.split_at(ACTOR_OUTPUTS);
        Step {
            state: state.to_vec(),
            low_dim: LowDim::from_values(low_dim).unwrap_or_else(|| unreachable!("as many as an actor has")),
            output: core::array::from_fn(|k| output[k]),
            frame: match frame & !ROUGH {
                1 => Frame::Attacked,
                2 => Frame::Noisy,
                _ => Frame::Unaltered,
            },
            yaw_change: yaw_change[0],
            rough: frame & ROUGH != 0,
        }
    });
    let record = |entry: Entry| Record {
        frame_ages: recorded.frame_ages.clone(),
        scenario: entry.scenario,
        outcome: entry.outcome,
        steps: steps.by_ref().take(entry.steps).collect(),
    };
    Ok(entries.into_iter().map(record).collect())
}
