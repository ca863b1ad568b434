//! The vehicle's links: the three UDP links of PX4's software in the loop, any number of others by URL, and one gate that
//! all share.

use crate::udp::onboard_api_gcs;
use anyhow::{bail, ensure};
use std::path::PathBuf;
use vigil_autopilot::{LinkId, SigningSetup};
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::link_spec::{Budget, LinkSpec};
use vigil_io::link_url::LinkUrl;
use vigil_io::links::{LinkAdmission, PeerRule, Wire, open_wire, somebody_is_heard};
use vigil_mavlink::signing::{SIGNATURE_LEN, SigningCounters, SigningKey};
use vigil_types::{Datagrams, Nanos};

/// Links by URL, besides the three that every vehicle has.
pub const MAX_EXTRA_LINKS: usize = 4;

/// What all but telemetry may overdraw of a link's burst; telemetry waits until that is made up for.
const ANSWERS_OVERDRAW: f64 = 0.5;

/// Of instance 0.
const ONBOARD: ([u8; 4], u16) = ([127, 0, 0, 1], 14280);

/// How the links are opened.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct LinksConfig {
    /// A further link for ground stations: a URL as of `vigil firmware --link`, then options separated by commas:
    /// unsigned=loopback|never|always and rate=BYTES_PER_SECOND. May be repeated.
    #[arg(long, value_name = "URL[,OPTION]", conflicts_with = "lockstep")]
    pub link: Vec<LinkSpec>,

    /// File with the key of MAVLink signing: 64 hexadecimal digits or 32 bytes, mode 0600. Without it nothing is signed.
    #[arg(long, value_name = "FILE", conflicts_with = "lockstep")]
    pub signing_key: Option<PathBuf>,

    /// While there is no signing key, take one by SETUP_SIGNING from whoever may speak without a signature. Without this,
    /// and once there is a key, only a packet signed with it brings another.
    #[arg(long, conflicts_with = "lockstep")]
    pub accept_first_key: bool,

    /// From whom packets without a signature are accepted: from this machine, nobody, everybody.
    #[arg(long, value_name = "WHO", value_enum, default_value_t, conflicts_with = "lockstep")]
    pub allow_unsigned: AllowUnsigned,
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
    /// Opens the links of a vehicle of this number, 0 to 99.
    ///
    /// # Errors
    /// What cannot be opened, and what to do.
    pub fn open(instance: u32, config: &LinksConfig) -> anyhow::Result<Self> {
        let count = config.link.len();
        ensure!(
            count <= MAX_EXTRA_LINKS,
            "{count} links given with --link: at most {MAX_EXTRA_LINKS}"
        );
        let has_foreign_option = |link: &&LinkSpec| link.system.is_some() || link.values_hz.is_some();
        if let Some(link) = config.link.iter().find(has_foreign_option) {
            let url = &link.url;
            bail!("{url}: the options system= and values= are for the firmware's links: leave them out");
        }
        let allow_unsigned = config.allow_unsigned;
        let gate = match &config.signing_key {
            // Not the name that a guidance computer with the same key has.
            Some(path) => SigningGate::with_key_file(path, &format!("vehicle{instance}"), allow_unsigned)?,
            None => SigningGate::new(None, allow_unsigned),
        }
        .accepting_first_key(config.accept_first_key);
        let is_deaf = |link: &LinkSpec| link.allow_unsigned.is_none_or(|policy| policy == AllowUnsigned::Never);
        if config.link.iter().all(is_deaf) {
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
        let udp = onboard_api_gcs(instance)?.into_iter();
        let mut links: Vec<_> = udp
            .map(|(id, udp)| link(id, Box::new(udp), allow_unsigned, None))
            .collect();
        for extra in &config.link {
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
