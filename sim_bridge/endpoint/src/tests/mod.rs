//! Stories of the whole endpoint.

mod flight;
mod ownership;
mod protocol;
mod rejection;
mod routing;
