//! How an endpoint is set up.

use crate::vehicle_parameters::ParameterError;
use std::collections::BTreeMap;
use vigil_mavlink::routing::ComponentId;
use vigil_types::Nanos;

/// A link of the vehicle: index into [`EndpointConfig::links`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(pub u8);

impl LinkId {
    /// The companion computer's link among the default links.
    pub const ONBOARD: Self = Self(0);
    /// The scripts' link among the default links.
    pub const API: Self = Self(1);
    /// The ground stations' link among the default links.
    pub const GCS: Self = Self(2);
}

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

/// What a link is for; decides which telemetry streams on it unasked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkRole {
    /// The companion computer: what guidance needs, at 50 Hz.
    Onboard,
    /// Scripts.
    Api,
    /// Ground stations.
    Gcs,
}

impl LinkRole {
    /// All roles, in the order of the default links.
    pub const ALL: [Self; 3] = [Self::Onboard, Self::Api, Self::Gcs];
}

/// An endpoint's configuration. Every field has a default.
#[derive(Debug, Clone, PartialEq)]
pub struct EndpointConfig {
    /// MAVLink system id of the vehicle; its component id is always 1.
    pub system_id: u8,
    /// The links, in the order of their [`LinkId`].
    pub links: Vec<LinkRole>,
    /// Parameters that differ from their defaults, by name (`MIS_TAKEOFF_ALT = 4.0`).
    pub parameters: BTreeMap<String, f64>,
    /// Unix time in microseconds at time 0 of the clock, for SYSTEM_TIME. Fixed by default: the endpoint reads no clock.
    pub unix_time_at_zero_us: u64,
    /// When it starts, by that clock.
    pub started_ns: Nanos,
}

impl Default for EndpointConfig {
    fn default() -> Self {
        Self {
            system_id: 1,
            links: LinkRole::ALL.to_vec(),
            parameters: BTreeMap::new(),
            // 2026-01-01T00:00:00Z.
            unix_time_at_zero_us: 1_767_225_600_000_000,
            started_ns: 0,
        }
    }
}

impl EndpointConfig {
    /// Most links an endpoint can have.
    pub const MAX_LINKS: usize = 8;

    /// One onboard link and nothing else: for lockstep, where no socket listens.
    pub fn companion_only() -> Self {
        Self {
            links: vec![LinkRole::Onboard],
            ..Self::default()
        }
    }
}

/// Why an endpoint cannot be set up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// 0 means "everybody" in MAVLink.
    #[error("system_id is 0, which means everybody: use 1 to 255")]
    SystemId,
    /// No link, or too many: as many as this.
    #[error("links has {0} entries: use 1 to {max}", max = EndpointConfig::MAX_LINKS)]
    Links(usize),
    /// A plan that was saved.
    #[error("{kind}: {reason}")]
    Plan {
        /// Which plan.
        kind: &'static str,
        /// Why it is refused.
        reason: String,
    },
    /// A parameter's name or value.
    #[error("parameters: {0}")]
    Parameter(#[from] ParameterError),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Endpoint;

    #[test]
    fn a_bad_configuration_is_refused_with_what_to_do() {
        let with = |change: fn(&mut EndpointConfig)| {
            let mut config = EndpointConfig::default();
            change(&mut config);
            Endpoint::new(config).err().map(|e| e.to_string()).unwrap_or_default()
        };
        assert!(with(|c| c.system_id = 0).contains("use 1 to 255"));
        assert!(with(|c| c.links.clear()).contains("use 1 to 8"));
        assert!(with(|c| c.parameters.extend([("MIS_TAKEOFF_ATL".into(), 3.0)])).contains("MIS_TAKEOFF_ATL"));
        assert!(with(|c| c.parameters.extend([("MIS_TAKEOFF_ALT".into(), -3.0)])).contains("0.5"));
    }
}
