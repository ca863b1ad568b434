//! Stories of the whole simulator.

mod packet;
mod packets;
mod simulator;
mod vehicle_links;
mod vehicle_models;
