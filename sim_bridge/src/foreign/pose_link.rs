//! A link on which a foreign vehicle is heard, and asked for what is missing of its pose.

use anyhow::bail;
use mavlink::MessageData;
use mavlink::dialects::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, GPS_GLOBAL_ORIGIN_DATA, HIL_STATE_QUATERNION_DATA, HOME_POSITION_DATA,
    LOCAL_POSITION_NED_DATA,
};
use vigil_io::Link;
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::link_spec::LinkSpec;
use vigil_io::links::{Gated, LinkError, PeerRule, somebody_is_heard};
use vigil_mavlink::Sender;
use vigil_mavlink::framing::{Command, FramingCounters, packets};
use vigil_types::{Datagrams, Nanos};

const SECOND_NS: Nanos = 1_000_000_000;
/// A message that did not come for this long is asked for.
const MISSING_NS: Nanos = 300_000_000;
/// MAV_COMP_ID_PERIPHERAL: who asks. Nothing that commands is sent under it.
const COMPONENT: u8 = 158;
const SET_MESSAGE_INTERVAL: u16 = 511;
const REQUEST_MESSAGE: u16 = 512;

/// Messages that are asked for by an interval, with what counts for the same.
const STREAMS: [[u32; 2]; 3] = [
    [LOCAL_POSITION_NED_DATA::ID; 2],
    [ATTITUDE_QUATERNION_DATA::ID, ATTITUDE_DATA::ID],
    [HIL_STATE_QUATERNION_DATA::ID; 2],
];
/// The interval, microseconds.
const INTERVAL_US: f32 = 20_000.0;
/// Those asked for once.
const PLACES: [u32; 2] = [HOME_POSITION_DATA::ID, GPS_GLOBAL_ORIGIN_DATA::ID];

/// One link, with what came on it last.
pub struct PoseLink {
    spec: LinkSpec,
    link: Gated,
    received: Box<Datagrams>,
    to_send: Box<Datagrams>,
    /// The vehicle on it, by its heartbeat.
    system: Option<u8>,
    heard_ns: [Nanos; STREAMS.len()],
    ask_next_ns: Nanos,
    asked: usize,
    sender: Sender,
    has_looked: bool,
}

impl PoseLink {
    /// Opens all links of `--pose`; the second is the vehicle's system, where one is named.
    ///
    /// # Errors
    /// Options that contradict each other or are not for such a link; a link that cannot be opened.
    pub fn open_all(specs: &[LinkSpec], allow_unsigned: AllowUnsigned) -> anyhow::Result<(Vec<Self>, Option<u8>)> {
        let system = specs.iter().find_map(|spec| spec.system);
        if specs.iter().any(|spec| spec.system.is_some() && spec.system != system) {
            bail!("--pose: the links name different vehicles: give the same system= on each");
        }
        if let Some(spec) = (specs.iter()).find(|s| s.values_hz.is_some() || s.rate_bytes_s.is_some()) {
            bail!("--pose {spec}: the options rate= and values= are for the firmware's links: leave them out");
        }
        let links: Result<_, LinkError> = specs.iter().map(|spec| Self::open(spec, allow_unsigned)).collect();
        Ok((links?, system))
    }

    /// Opens the link. The peer is whoever first passes on an autopilot's heartbeat: the vehicle, or a firmware in front of it.
    ///
    /// # Errors
    /// [`LinkError`], naming the link.
    fn open(spec: &LinkSpec, allow_unsigned: AllowUnsigned) -> Result<Self, LinkError> {
        let allow_unsigned = spec.allow_unsigned.unwrap_or(allow_unsigned);
        let gate = SigningGate::new(None, allow_unsigned);
        somebody_is_heard(&spec.url, gate.has_key(), allow_unsigned)?;
        Ok(Self {
            link: Gated::open(&spec.url, PeerRule::Vehicle { system: spec.system }, gate)?,
            spec: spec.clone(),
            received: Box::default(),
            to_send: Box::default(),
            system: None,
            heard_ns: [0; STREAMS.len()],
            ask_next_ns: 0,
            asked: 0,
            sender: Sender::new(1, COMPONENT),
            has_looked: false,
        })
    }

    /// Hands over what arrived. Never waits.
    pub fn receive(&mut self, now_ns: Nanos, mut on_datagram: impl FnMut(&[u8])) {
        self.received.clear();
        self.link.receive(now_ns, &mut self.received);
        let mut counters = FramingCounters::default();
        for (_, datagram) in self.received.iter() {
            for packet in packets(datagram, &mut counters) {
                if packet.is_autopilots_heartbeat() && self.spec.system.is_none_or(|s| s == packet.system_id()) {
                    self.system.get_or_insert(packet.system_id());
                }
                let is_the_vehicles = self.system.is_none_or(|system| system == packet.system_id());
                for (heard_ns, ids) in self.heard_ns.iter_mut().zip(STREAMS) {
                    if is_the_vehicles && ids.contains(&packet.message_id()) {
                        *heard_ns = now_ns;
                    }
                }
            }
            on_datagram(datagram);
        }
    }

    /// What a person reads, once, where others had sent to the port before the vehicle was heard: they are not. Later the kernel lets in
    /// nobody else, and what is counted may be the vehicle's own from another port.
    pub fn others_put_aside(&mut self) -> Option<String> {
        let heard = self.system.filter(|_| self.spec.system.is_none() && !self.has_looked)?;
        self.has_looked = true;
        let url = &self.spec.url;
        let line = || {
            format!("pose       others beside system {heard} send to {url}, unheard: name one by its option system=")
        };
        (self.link.statistics().foreign > 0).then(line)
    }

    /// Once a second: says that somebody listens, and asks for what is missing. `wants_truth`: HIL_STATE_QUATERNION too;
    /// `wants_places`: home and origin are not known yet.
    pub fn ask(&mut self, now_ns: Nanos, wants_truth: bool, wants_places: bool) {
        if now_ns < self.ask_next_ns {
            return;
        }
        self.ask_next_ns = now_ns + SECOND_NS;
        self.to_send.clear();
        // Some vehicles speak only to whom they have heard.
        self.sender.system_id = self.system.or(self.spec.system).unwrap_or(1);
        self.sender.listener_heartbeat(&mut self.to_send, 0);
        let Some(system) = self.system else {
            return self.link.send(&self.to_send);
        };
        for ([id, _], heard_ns) in STREAMS.into_iter().zip(self.heard_ns) {
            let is_wanted = wants_truth || id != HIL_STATE_QUATERNION_DATA::ID;
            if is_wanted && now_ns.saturating_sub(heard_ns) > MISSING_NS {
                self.command(system, SET_MESSAGE_INTERVAL, [id as f32, INTERVAL_US]);
            }
        }
        if wants_places {
            let id = PLACES[self.asked % PLACES.len()];
            self.asked += 1;
            self.command(system, REQUEST_MESSAGE, [id as f32, 0.0]);
        }
        self.link.send(&self.to_send);
    }

    fn command(&mut self, system: u8, number: u16, [first, second]: [f32; 2]) {
        let params = [first, second, 0.0, 0.0, 0.0, 0.0, 0.0];
        let command = Command::to_autopilot(system, number, params, 0);
        self.sender.command(&mut self.to_send, 0, &command);
    }
}
