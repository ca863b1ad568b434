//! What a vehicle and its depth sensor lack before Vigil can fly them (docs/foreign-vehicles.md, "vigil doctor").
//!
//! [`Examination`] is sans-IO: datagrams, frames and time in, questions and [`Finding`]s out. It commands nothing: it asks for
//! messages and parameters.
#![forbid(unsafe_code)]

mod examination;
mod finding;
mod ground;
mod parameters;

pub use examination::{Examination, ExaminationConfig};
pub use finding::{Finding, Severity};
pub use ground::{GroundTilt, ground_tilt};
