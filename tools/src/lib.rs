//! Everything a person does with Vigil: the command line, training, campaigns, reports.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod attack_campaigns;
mod campaign;
pub mod cli;
pub mod detector_training;
pub mod doctor;
pub mod flight_derived;
pub mod flight_film;
pub mod flight_report;
mod realtime_bench;
pub mod report;
mod sensor_check;
pub mod threads;

pub use campaign::{Flight, fly};
pub use vigil_learn::statistics;
