//! Sans-IO MAVLink: framing and the guidance computer's side of the protocol.
//!
//! Bytes in, bytes out; time is an argument. Both ends of Vigil's link use [`framing`]; [`Companion`] is the guidance
//! computer's end.
//!
//! ```
//! use vigil_mavlink::common::{ATTITUDE_DATA, MavMessage};
//! use vigil_mavlink::framing::{FramingCounters, MAX_PACKET_LEN, packets, serialize};
//! use vigil_mavlink::MavHeader;
//!
//! let header = MavHeader { system_id: 1, component_id: 1, sequence: 7 };
//! let message = MavMessage::ATTITUDE(ATTITUDE_DATA { yaw: 0.5, ..Default::default() });
//! let mut buffer = [0; MAX_PACKET_LEN];
//! let len = serialize(header, &message, &mut buffer)?;
//!
//! let mut counters = FramingCounters::default();
//! let datagram = [b"noise", &buffer[..len]].concat();
//! let packet = packets(&datagram, &mut counters).next().expect("a packet behind the noise");
//! assert_eq!((packet.system_id(), packet.sequence()), (1, 7));
//! assert_eq!(packet.message()?, message);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing))]

#[cfg(feature = "std")]
extern crate std;

mod autopilot;
mod companion;
mod core;
pub mod crc;
mod following;
pub mod framing;
pub mod globe;
mod heading_error;
mod operator;
mod parameter_table;
mod report;
pub mod routing;
mod sender;
mod services;
pub mod signing;
mod status_text;
mod vehicle;
mod velocity_error;

pub use self::core::Allowance;
pub use autopilot::Flavour;
pub use companion::{Companion, CompanionConfig, GUIDANCE_COMPONENT, LinkCounters};
pub use mavlink;
pub use mavlink::MavHeader;
pub use mavlink::dialects::common::{self, MavMessage};
pub use operator::{LET_GO, PendingRequest};
pub use parameter_table::{MAX_PARAMETERS, Parameter, ParameterValue, Parameters, ValueError};
pub use sender::Sender;
pub use status_text::StatusText;
pub use vehicle::{RESTART_MS, Vehicle};

/// A message of the dialect with these fields, the others as they are by default.
///
/// ```
/// use vigil_mavlink::{MavMessage, message};
///
/// let yaw = 0.5;
/// let MavMessage::ATTITUDE(attitude) = message!(ATTITUDE, time_boot_ms = 20, yaw) else { unreachable!() };
/// assert_eq!((attitude.time_boot_ms, attitude.yaw, attitude.roll), (20, 0.5, 0.0));
/// ```
#[macro_export]
macro_rules! message {
    (@of $value:ident) => { $value };
    (@of $field:ident $value:expr) => { $value };
    ($name:ident $(, $field:ident $(= $value:expr)?)* $(,)?) => {{
        let mut message = $crate::MavMessage::$name(Default::default());
        if let $crate::MavMessage::$name(_data) = &mut message {
            $(_data.$field = $crate::message!(@of $field $($value)?);)*
        }
        message
    }};
}
