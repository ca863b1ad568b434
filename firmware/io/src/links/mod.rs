//! MAVLink over UDP, TCP or a serial line: links, each behind the trait [`Wire`] once it is open.
//!
//! None of them waits, allocates after its opening, or ends: a peer that is gone is waited for.

mod packet_stream;
mod peer_rule;
mod peers;
mod serial;
mod socket_filter;
mod tcp;
mod udp;
mod wire;

pub use peer_rule::PeerRule;
pub use peers::UdpPeers;
use serial::SerialWire;
use tcp::TcpWire;
use udp::UdpWire;
pub use wire::{Gated, LinkAdmission, Wire, open_wire};

use crate::gate::AllowUnsigned;
use crate::link_url::LinkUrl;
use std::io::ErrorKind;
use std::net::SocketAddr;
use vigil_mavlink::framing::FramingCounters;
use vigil_mavlink::signing::SigningCounters;
use vigil_types::Nanos;

/// Links for ground stations, besides the vehicle's.
pub const MAX_GROUND_LINKS: usize = 4;
/// The number in [`Datagrams`] of a link that is alone.
const LINK: u8 = 0;
/// Who is answered: another caller takes over a listening link only when the present one was silent this long.
const PEER_SILENCE_NS: Nanos = 2_000_000_000;
/// Pause between two attempts to reach a peer or a device that is not there.
const RETRY_NS: Nanos = 1_000_000_000;

/// Why a link could not be opened.
#[allow(missing_docs, reason = "the texts say what the fields are")]
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The port or device is taken.
    #[error("{url}: in use by another process: stop it, or choose another address or --instance")]
    InUse { url: LinkUrl },
    /// Any other refusal by the system.
    #[error("{url}: {source}{hint}")]
    Io {
        url: LinkUrl,
        source: std::io::Error,
        hint: &'static str,
    },
    /// The policy leaves nobody who could be heard.
    #[error(
        "{url}: nobody would be heard: there is no signing key, and packets without a signature are refused{from_whom}. \
         Give --signing-key, or --allow-unsigned always if everybody who reaches the link may command the vehicle \
         (docs/firmware.md, \"Signing\")"
    )]
    NobodyHeard { url: LinkUrl, from_whom: &'static str },
    /// More links than there is room for.
    #[error("{count} links for ground stations: at most {MAX_GROUND_LINKS} besides the vehicle's")]
    TooMany { count: usize },
    /// `system=` on a link that is not the firmware's to its vehicle.
    #[error("{url}: the option system= is for the firmware's link to its vehicle only: leave it out")]
    NotTheVehicles { url: LinkUrl },
}

impl LinkError {
    /// What the system said of a link.
    pub fn of(url: &LinkUrl, source: std::io::Error) -> Self {
        let url = url.clone();
        match source.kind() {
            ErrorKind::AddrInUse | ErrorKind::ResourceBusy => Self::InUse { url },
            ErrorKind::PermissionDenied if matches!(url, LinkUrl::Serial { .. }) => Self::Io {
                url,
                source,
                hint: ": add yourself to the device's group (dialout on most systems)",
            },
            _ => Self::Io { url, source, hint: "" },
        }
    }
}

/// What a link did not take or could not deliver, since it was opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkStatistics {
    /// Datagrams or connections of others than the peer, which were not read.
    pub foreign: u64,
    /// Packets that could not be sent: no peer, or the line is full.
    pub unsent: u64,
    /// Connections made or devices opened; always 0 on UDP.
    pub connections: u64,
    /// The system of a vehicle that called last and is not the link's.
    pub other_system: Option<u8>,
    /// What the framing of a byte stream or of the signatures' check refused.
    pub framing: FramingCounters,
    /// What signing accepted and refused.
    pub signing: SigningCounters,
}

/// Refuses a link on which nobody could be heard.
///
/// # Errors
/// [`LinkError::NobodyHeard`]: there is no key, and the policy covers nobody who could be at the other end.
pub fn somebody_is_heard(url: &LinkUrl, has_key: bool, policy: AllowUnsigned) -> Result<(), LinkError> {
    let refused_from = match policy {
        _ if has_key => None,
        AllowUnsigned::Always => None,
        AllowUnsigned::Never => Some(""),
        AllowUnsigned::Loopback => (!may_be_local(url)).then_some(" from other machines"),
    };
    refused_from.map_or(Ok(()), |from_whom| {
        Err(LinkError::NobodyHeard {
            url: url.clone(),
            from_whom,
        })
    })
}

/// Whether a sender's address is this machine's loopback: no packet of another machine bears it.
fn is_local(address: SocketAddr) -> bool {
    address.ip().to_canonical().is_loopback()
}

/// Whether a peer on this machine can speak on the link.
fn may_be_local(url: &LinkUrl) -> bool {
    match url {
        LinkUrl::UdpIn(a) | LinkUrl::TcpIn(a) if a.ip().is_unspecified() => true,
        // What is wrong with it is reported when it is opened.
        LinkUrl::Unknown(_) => true,
        _ => url.is_on_this_machine(),
    }
}
