//! Everything a person does with Vigil: the command line, campaigns, reports. The laboratory is `lab`.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod campaign;
pub mod cli;
pub mod doctor;
pub mod explained;
pub mod flight_derived;
pub mod flight_report;
pub mod report;
mod sensor_check;
pub mod threads;

pub use campaign::{Flight, fly};
pub use vigil_sim::statistics;
