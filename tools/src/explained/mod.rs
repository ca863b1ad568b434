//! Flights that are flown to be explained: a pilot's steps as they were seen, and DeepSHAP of the pixels against what was seen on others.

mod pixels;
mod recorded_flight;
mod scenario;
mod stepped;

pub use pixels::{BACKGROUNDS, PixelExplainer, YAW, explainer};
pub use recorded_flight::{Ending, Frame, Onlooker, Record, Shown, Step, fly, held_frames};
pub use scenario::{Adversary, MAX_STEPS, Plan, Scenario};
pub use stepped::Flight;
