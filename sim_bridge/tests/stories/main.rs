//! Stories of the whole simulator.

mod simulator;
mod vehicle_links;
