//! Stories of the whole endpoint.

mod documentation;
mod events;
mod flight;
mod ftp;
mod geofence;
mod logs;
mod metadata;
mod mission;
mod orbit;
mod ownership;
mod plans;
mod protocol;
mod rejection;
mod routing;
mod shell;
mod telemetry;
