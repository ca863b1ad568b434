//! The vehicle's links: the three UDP links of PX4's software in the loop, any number of others by URL, and one gate that
//! all share.

use crate::udp::onboard_api_gcs;
use std::path::PathBuf;
use vigil_autopilot::{LinkId, SigningSetup};
use vigil_io::gate::{AllowUnsigned, SigningFileError, SigningGate};
use vigil_io::link_spec::{Budget, LinkSpec};
use vigil_io::link_url::LinkUrl;
use vigil_io::links::{LinkAdmission, LinkError, PeerRule, Wire, open_wire, somebody_is_heard};
use vigil_mavlink::signing::{SIGNATURE_LEN, SigningCounters, SigningKey};
use vigil_types::{Datagrams, Nanos};

/// Links by URL, besides the three that every vehicle has.
pub const MAX_EXTRA_LINKS: usize = 4;

/// What all but telemetry may overdraw of a link's burst; telemetry waits until that is made up for.
const ANSWERS_OVERDRAW: f64 = 0.5;

/// Of instance 0.
const ONBOARD: ([u8; 4], u16) = ([127, 0, 0, 1], 14280);

/// How the links are opened.
#[derive(Debug, Clone, Default)]
pub struct LinksConfig {
    /// Number of the vehicle, 0 to 99.
    pub instance: u32,
    /// File of the signing key; without it nothing is signed.
    pub signing_key: Option<PathBuf>,
    /// While there is no key, SETUP_SIGNING of whoever may speak without a signature brings one.
    pub accept_first_key: bool,
    /// From whom packets without a signature are accepted.
    pub allow_unsigned: AllowUnsigned,
    /// Links besides the three, at most [`MAX_EXTRA_LINKS`].
    pub extra: Vec<LinkSpec>,
}

/// Why the links cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinksError {
    /// Somebody else has the port of one of the three.
    #[error(
        "UDP port {port} is in use: another simulator with --instance {instance}? Stop it, or choose another number with \
         --instance"
    )]
    PortInUse {
        /// The port.
        port: u16,
        /// The instance it belongs to.
        instance: u32,
    },
    /// The socket of one of the three cannot be opened.
    #[error("cannot open UDP port {port}: {source}")]
    Port {
        /// The port.
        port: u16,
        /// What the system said.
        source: std::io::Error,
    },
    /// One by URL.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The key or its state.
    #[error(transparent)]
    Signing(#[from] SigningFileError),
    /// What only the guidance computer's links have.
    #[error("{0}: the options system= and values= are for the firmware's links: leave them out")]
    NotHere(LinkUrl),
    /// More than there is room for: so many.
    #[error("{0} links given with --link: at most {MAX_EXTRA_LINKS}")]
    TooMany(usize),
}

struct VehicleLink {
    id: LinkId,
    wire: Box<dyn Wire>,
    allow_unsigned: AllowUnsigned,
    budget: Option<Budget>,
    over_budget: u64,
}

/// All links of one vehicle.
pub struct VehicleLinks {
    links: Vec<VehicleLink>,
    gate: SigningGate,
    now_ns: Nanos,
    received: Box<Datagrams>,
    to_send: Box<Datagrams>,
}

impl VehicleLinks {
    /// Opens the links.
    ///
    /// # Errors
    /// [`LinksError`], each with what to do.
    pub fn open(config: &LinksConfig) -> Result<Self, LinksError> {
        if config.extra.len() > MAX_EXTRA_LINKS {
            return Err(LinksError::TooMany(config.extra.len()));
        }
        let has_foreign_option = |link: &&LinkSpec| link.system.is_some() || link.values_hz.is_some();
        if let Some(link) = config.extra.iter().find(has_foreign_option) {
            return Err(LinksError::NotHere(link.url.clone()));
        }
        let allow_unsigned = config.allow_unsigned;
        let gate = match &config.signing_key {
            // Not the name that a guidance computer with the same key has.
            Some(path) => SigningGate::with_key_file(path, &format!("vehicle{}", config.instance), allow_unsigned)?,
            None => SigningGate::new(None, allow_unsigned),
        }
        .accepting_first_key(config.accept_first_key);
        let is_deaf = |link: &LinkSpec| link.allow_unsigned.is_none_or(|policy| policy == AllowUnsigned::Never);
        if config.extra.iter().all(is_deaf) {
            let first = LinkUrl::UdpIn(ONBOARD.into());
            somebody_is_heard(&first, gate.has_key(), allow_unsigned)?;
        }
        let link = |id, wire: Box<dyn Wire>, allow_unsigned, budget| VehicleLink {
            id,
            wire,
            allow_unsigned,
            budget,
            over_budget: 0,
        };
        let udp = onboard_api_gcs(config.instance)?.into_iter();
        let mut links: Vec<_> = udp
            .map(|(id, udp)| link(id, Box::new(udp), allow_unsigned, None))
            .collect();
        for extra in &config.extra {
            let policy = extra.allow_unsigned.unwrap_or(allow_unsigned);
            somebody_is_heard(&extra.url, gate.has_key(), policy)?;
            let (id, wire) = (LinkId(links.len() as u8), open_wire(&extra.url, PeerRule::Anyone)?);
            links.push(link(id, wire, policy, Budget::of(extra, f64::INFINITY)));
        }
        Ok(Self {
            links,
            gate,
            now_ns: 0,
            received: Box::default(),
            to_send: Box::default(),
        })
    }

    /// What signing accepted and refused.
    pub fn signing(&self) -> SigningCounters {
        self.gate.counters()
    }

    /// Packets that a link's rate did not allow.
    pub fn over_budget(&self) -> u64 {
        self.links.iter().map(|l| l.over_budget).sum()
    }

    /// Signs and verifies with a key that SETUP_SIGNING brought past the gate.
    pub fn set_key(&mut self, setup: &SigningSetup) {
        self.gate.set_key(SigningKey(setup.key), setup.initial_timestamp);
    }

    /// What to tell everybody of keys that were refused since the last call, at most every ten seconds.
    pub fn refused_key(&mut self) -> Option<&'static str> {
        self.gate.refused_key(self.now_ns)
    }

    /// Hands over every datagram that has come and may pass, without waiting: the link, a number for the end of it that
    /// sent it, the datagram.
    pub fn receive(&mut self, now_ns: Nanos, mut on_datagram: impl FnMut(LinkId, u64, &[u8])) {
        self.now_ns = now_ns;
        self.gate.begin(now_ns);
        for link in &mut self.links {
            let mut admission = LinkAdmission {
                gate: &mut self.gate,
                allow_unsigned: link.allow_unsigned,
                link: 0,
            };
            link.wire
                .receive_each(now_ns, &mut admission, &mut self.received, &mut |sender, datagram| {
                    on_datagram(link.id, sender, datagram);
                });
        }
    }

    /// Sends a packet to every peer of a link, signed if there is a key. What the link's rate does not allow and what the
    /// system does not take is lost, telemetry first, as on any radio link.
    pub fn send(&mut self, link: LinkId, is_telemetry: bool, packet: &[u8]) {
        let Some(link) = self.links.iter_mut().find(|l| l.id == link) else {
            return;
        };
        let signature_len = if self.gate.has_key() { SIGNATURE_LEN } else { 0 };
        let kept = if is_telemetry { 0.0 } else { -ANSWERS_OVERDRAW };
        if let Some(budget) = &mut link.budget
            && !budget.spend(self.now_ns, packet.len() + signature_len, kept)
        {
            link.over_budget += 1;
            return;
        }
        self.to_send.clear();
        self.to_send.push(0, packet);
        link.wire.send(&mut self.gate, &self.to_send);
    }
}
