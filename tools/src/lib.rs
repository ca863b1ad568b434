//! Everything a person does with Vigil: the command line, training, campaigns, reports.

pub mod actor_training;
mod attack_campaigns;
mod campaign;
pub mod cli;
pub mod detector_training;
pub mod report;
pub mod statistics;
