//! Stories of the whole endpoint.

mod connect;
mod documentation;
mod events;
mod failures;
mod flight;
mod follow;
mod ftp;
mod geofence;
mod logs;
mod metadata;
mod mission;
mod offboard;
mod orbit;
mod ownership;
pub mod plans;
mod protocol;
mod rejection;
mod routing;
mod scenarios;
mod shell;
mod sticks;
mod telemetry;
