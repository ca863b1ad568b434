//! Stories of the whole endpoint.

mod documentation;
mod flight;
mod geofence;
mod mission;
mod orbit;
mod ownership;
mod plans;
mod protocol;
mod rejection;
mod routing;
