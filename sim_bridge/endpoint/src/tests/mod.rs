//! Stories of the whole endpoint.

mod documentation;
mod flight;
mod ownership;
mod protocol;
mod rejection;
mod routing;
