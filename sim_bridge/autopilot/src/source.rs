//! Who sent a packet.

use crate::LinkId;
use vigil_mavlink::routing::ComponentId;

/// Who sent a packet: on which link, from which of the link's ends, and who it says it is. Anybody may claim any identity;
/// the end it comes from is the system's word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Source {
    pub link: LinkId,
    /// Another number for another end of the same link.
    pub peer: u64,
    pub id: ComponentId,
}

impl core::fmt::Display for Source {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} on link {}", self.id, self.link.0)
    }
}
