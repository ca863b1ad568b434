//! A link on which a foreign vehicle is heard, and asked for what is missing of its pose.

use mavlink::MessageData;
use mavlink::dialects::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA, HIL_STATE_QUATERNION_DATA,
    HOME_POSITION_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavMessage, MavModeFlag, MavState, MavType,
};
use vigil_io::gate::{AllowUnsigned, SigningGate};
use vigil_io::link_spec::LinkSpec;
use vigil_io::links::{LinkAdmission, LinkError, PeerRule, Wire, open_wire, somebody_is_heard};
use vigil_mavlink::MavHeader;
use vigil_mavlink::framing::{Command, FramingCounters, MAX_PACKET_LEN, packets, serialize};
use vigil_types::{Datagrams, Nanos};

const SECOND_NS: Nanos = 1_000_000_000;
/// A message that did not come for this long is asked for.
const MISSING_NS: Nanos = 300_000_000;
/// MAV_COMP_ID_PERIPHERAL: who asks. Nothing that commands is sent under it.
const COMPONENT: u8 = 158;
const SET_MESSAGE_INTERVAL: u16 = 511;
const REQUEST_MESSAGE: u16 = 512;

/// Messages that are asked for by an interval, in microseconds, with what counts for the same.
const STREAMS: [(u32, u32, f32); 3] = [
    (LOCAL_POSITION_NED_DATA::ID, LOCAL_POSITION_NED_DATA::ID, 20_000.0),
    (ATTITUDE_QUATERNION_DATA::ID, ATTITUDE_DATA::ID, 20_000.0),
    (HIL_STATE_QUATERNION_DATA::ID, HIL_STATE_QUATERNION_DATA::ID, 20_000.0),
];
/// Those asked for once.
const PLACES: [u32; 2] = [HOME_POSITION_DATA::ID, GPS_GLOBAL_ORIGIN_DATA::ID];

/// One link, with what came on it last.
pub struct PoseLink {
    spec: LinkSpec,
    wire: Box<dyn Wire>,
    gate: SigningGate,
    allow_unsigned: AllowUnsigned,
    received: Box<Datagrams>,
    to_send: Box<Datagrams>,
    /// The vehicle on it, by its heartbeat.
    system: Option<u8>,
    heard_ns: [Nanos; STREAMS.len()],
    ask_next_ns: Nanos,
    asked: usize,
    sequence: u8,
}

impl PoseLink {
    /// Opens the link. The peer is whoever first passes on an autopilot's heartbeat: the vehicle, or a firmware in front of it.
    ///
    /// # Errors
    /// [`LinkError`], naming the link.
    pub fn open(spec: &LinkSpec, allow_unsigned: AllowUnsigned) -> Result<Self, LinkError> {
        let allow_unsigned = spec.allow_unsigned.unwrap_or(allow_unsigned);
        let gate = SigningGate::new(None, allow_unsigned);
        somebody_is_heard(&spec.url, gate.has_key(), allow_unsigned)?;
        Ok(Self {
            wire: open_wire(&spec.url, PeerRule::Vehicle { system: spec.system })?,
            spec: spec.clone(),
            gate,
            allow_unsigned,
            received: Box::default(),
            to_send: Box::default(),
            system: None,
            heard_ns: [0; STREAMS.len()],
            ask_next_ns: 0,
            asked: 0,
            sequence: 0,
        })
    }

    /// The link as it was asked for.
    pub fn spec(&self) -> &LinkSpec {
        &self.spec
    }

    /// Hands over what arrived. Never waits.
    pub fn receive(&mut self, now_ns: Nanos, mut on_datagram: impl FnMut(&[u8])) {
        self.gate.begin(now_ns);
        self.received.clear();
        let mut admission = LinkAdmission {
            gate: &mut self.gate,
            allow_unsigned: self.allow_unsigned,
            link: 0,
        };
        self.wire.receive(now_ns, &mut admission, &mut self.received);
        let mut counters = FramingCounters::default();
        for (_, datagram) in self.received.iter() {
            for packet in packets(datagram, &mut counters) {
                if packet.is_autopilots_heartbeat() && self.spec.system.is_none_or(|s| s == packet.system_id()) {
                    self.system.get_or_insert(packet.system_id());
                }
                for (heard_ns, (id, or, _)) in self.heard_ns.iter_mut().zip(STREAMS) {
                    if packet.message_id() == id || packet.message_id() == or {
                        *heard_ns = now_ns;
                    }
                }
            }
            on_datagram(datagram);
        }
    }

    /// Once a second: says that somebody listens, and asks for what is missing. `wants_truth`: HIL_STATE_QUATERNION too;
    /// `wants_places`: home and origin are not known yet.
    pub fn ask(&mut self, now_ns: Nanos, wants_truth: bool, wants_places: bool) {
        let Some(system) = self.system else { return };
        if now_ns < self.ask_next_ns {
            return;
        }
        self.ask_next_ns = now_ns + SECOND_NS;
        self.to_send.clear();
        self.say_heartbeat(system);
        for (stream, (id, _, interval_us)) in STREAMS.into_iter().enumerate() {
            let is_wanted = wants_truth || id != HIL_STATE_QUATERNION_DATA::ID;
            if is_wanted && now_ns.saturating_sub(self.heard_ns[stream]) > MISSING_NS {
                let params = [id as f32, interval_us, 0.0, 0.0, 0.0, 0.0, 0.0];
                self.command(system, SET_MESSAGE_INTERVAL, params);
            }
        }
        if wants_places {
            let id = PLACES[self.asked % PLACES.len()];
            self.asked += 1;
            self.command(system, REQUEST_MESSAGE, [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        self.wire.send(&mut self.gate, &self.to_send);
    }

    fn header(&mut self, system: u8) -> MavHeader {
        self.sequence = self.sequence.wrapping_add(1);
        MavHeader {
            system_id: system.into(),
            component_id: COMPONENT,
            sequence: self.sequence,
        }
    }

    fn say_heartbeat(&mut self, system: u8) {
        let message = MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_GENERIC,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        });
        let mut packet = [0; MAX_PACKET_LEN];
        if let Ok(len) = serialize(self.header(system), &message, &mut packet) {
            self.to_send.push(0, &packet[..len]);
        }
    }

    fn command(&mut self, system: u8, number: u16, params: [f32; 7]) {
        let command = Command::to_autopilot(system, number, params, 0);
        let mut packet = [0; MAX_PACKET_LEN];
        if let Ok(len) = command.serialize(self.header(system), &mut packet) {
            self.to_send.push(0, &packet[..len]);
        }
    }
}
