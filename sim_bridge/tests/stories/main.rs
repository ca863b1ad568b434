//! Stories of the whole simulator.

mod packets;
mod simulator;
mod vehicle_links;
mod vehicle_models;
