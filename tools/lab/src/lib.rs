//! The laboratory: training, attacks, detectors, tables and figures, films, and what a machine makes of the loop.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod attack_campaigns;
pub mod cli;
pub mod detector_training;
mod flight_film;
mod realtime_bench;
mod report;
pub mod trainer;

pub(crate) use vigil_tools::{campaign, explained, flight_derived, flight_report, statistics, threads};
