//! What the flight stack and the simulated vehicle share towards the machine: MAVLink over UDP, TCP and serial lines in MAVSDK's notation ([`links`],
//! [`link_url`], [`link_spec`]), several at once ([`router`]), who may speak on a link ([`gate`]), secrets ([`key_file`]), files that outlive a restart ([`state`]), work beside the loop
//! ([`background`]), what is said at most so often ([`throttle`]), a program's end ([`interrupt`]), and [`shared_memory`] with depth frames and lockstep exchanges.
//!
//! ```
//! use vigil_io::link_url::LinkUrl;
//!
//! let url: LinkUrl = "udpin://127.0.0.1:14540".parse()?;
//! assert!(url.is_on_this_machine());
//! let error = "udp:14540".parse::<LinkUrl>().unwrap_err();
//! assert!(error.to_string().contains("udp:14540"), "{error}");
//! # Ok::<(), vigil_io::link_url::LinkUrlError>(())
//! ```
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)
)]

pub mod background;
pub mod clock;
pub mod gate;
pub mod interrupt;
pub mod key_file;
pub mod link_spec;
pub mod link_url;
pub mod links;
pub mod router;
pub mod shared_memory;
pub mod state;
pub mod throttle;
mod value_rate;

use vigil_types::{Datagrams, Nanos};

/// Where datagrams come from and go to.
pub trait Link {
    /// Appends what arrived since the last call, in order of arrival. Never waits. What does not fit stays for the
    /// next call.
    fn receive(&mut self, now_ns: Nanos, received: &mut Datagrams);

    /// Sends the datagrams, in order. Never waits; what cannot be sent is lost, as on any radio link.
    fn send(&mut self, sent: &Datagrams);
}
