//! A bench for tests: the endpoint, the vehicle, and clients that read what comes back.

use crate::core::{ComponentId, EndpointStatus};
use crate::vehicle::{ControlCommand, Vehicle, VehicleParams, VehicleView, Wind};
use crate::{Endpoint, EndpointConfig, FlightMode, LandedState, LinkId, ParameterValue};
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::{
    COMMAND_INT_DATA, COMMAND_LONG_DATA, HEARTBEAT_DATA, MavCmd, MavFrame, MavParamType, PARAM_SET_DATA,
    PositionTargetTypemask, SET_MODE_DATA, SET_POSITION_TARGET_LOCAL_NED_DATA, STATUSTEXT_DATA,
};
use vigil_mavlink::framing::{self, CommandAck, FramingCounters, MAX_PACKET_LEN};
use vigil_mavlink::mavlink::{MavHeader, Message, MessageData};
use vigil_types::{Nanos, NedVector};

pub const ONBOARD: LinkId = LinkId::ONBOARD;
pub const API: LinkId = LinkId::API;
pub const GCS: LinkId = LinkId::GCS;
pub const COMPANION: ComponentId = ComponentId {
    system: 1,
    component: 191,
};
pub const SCRIPT: ComponentId = ComponentId {
    system: 245,
    component: 190,
};
pub const STATION: ComponentId = ComponentId {
    system: 255,
    component: 190,
};

/// A packet that the endpoint sent.
#[derive(Debug, Clone)]
pub struct Sent {
    pub at_ns: Nanos,
    pub link: LinkId,
    pub from: ComponentId,
    pub raw: Vec<u8>,
    pub message: Option<MavMessage>,
    pub ack: Option<CommandAck>,
}

/// The bench.
pub struct Bench {
    pub endpoint: Endpoint,
    pub now_ns: Nanos,
    pub sent: Vec<Sent>,
    pub command: ControlCommand,
    vehicle: Vehicle,
    sequence: u8,
    /// From which end of its link everybody sends.
    pub peer: u64,
    /// Components that stream velocity setpoints at 20 Hz, with the velocity along the heading.
    streaming: Vec<(LinkId, ComponentId, [f32; 3])>,
}

impl Bench {
    pub fn new() -> Self {
        Self::with(EndpointConfig::default())
    }

    pub fn with(config: EndpointConfig) -> Self {
        let mut bench = Self {
            endpoint: Endpoint::new(config).expect("valid configuration"),
            now_ns: 1_000_000_000,
            sent: Vec::new(),
            command: ControlCommand::MotorsOff,
            vehicle: Vehicle::new(VehicleParams::default(), Wind::default(), 1).expect("defaults are valid"),
            sequence: 0,
            peer: 0,
            streaming: Vec::new(),
        };
        bench.run_ms(500);
        bench
    }

    /// A vehicle that hovers at 3 m in Hold.
    pub fn airborne() -> Self {
        let mut bench = Self::new();
        bench.vehicle.place(NedVector::new(0.0, 0.0, -3.0), 0.0, true);
        bench.endpoint.start_airborne(bench.now_ns, 3.0);
        bench.run_ms(500);
        bench.sent.clear();
        bench
    }

    pub fn status(&self) -> EndpointStatus {
        self.endpoint.status()
    }

    pub fn view(&self) -> VehicleView {
        self.vehicle.view()
    }

    pub fn height_m(&self) -> f32 {
        -self.vehicle.truth().position_ned_m.z
    }

    pub fn position_m(&self) -> [f32; 3] {
        self.vehicle.truth().position_ned_m.to_array()
    }

    /// Lets simulated time pass.
    pub fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now_ns += 1_000_000;
            if self.now_ns.is_multiple_of(50_000_000) {
                for (link, from, velocity) in self.streaming.clone() {
                    self.send_velocity(link, from, velocity);
                }
            }
            self.endpoint.observe_truth(&self.vehicle.truth());
            self.command = self.endpoint.step(self.now_ns, &self.vehicle.view());
            self.vehicle.step(&self.command);
            self.collect();
        }
    }

    /// Lets time pass until `done`; fails after `limit_s` simulated seconds.
    pub fn run_until(&mut self, limit_s: u64, what: &str, done: impl Fn(&Self) -> bool) {
        for _ in 0..limit_s * 100 {
            if done(self) {
                return;
            }
            self.run_ms(10);
        }
        panic!("not within {limit_s} s: {what}; {:?}", self.status());
    }

    fn collect(&mut self) {
        let (sent, at_ns) = (&mut self.sent, self.now_ns);
        self.endpoint.transmit(|link, datagram| {
            let mut counters = FramingCounters::default();
            let packets: Vec<_> = framing::packets(datagram, &mut counters).collect();
            assert_eq!(packets.len(), 1, "one packet per datagram");
            for packet in packets {
                sent.push(Sent {
                    at_ns,
                    link,
                    from: ComponentId {
                        system: packet.system_id(),
                        component: packet.component_id(),
                    },
                    raw: packet.raw().to_vec(),
                    message: packet.message().ok(),
                    ack: packet.command_ack(),
                });
            }
        });
    }

    /// Hands raw bytes to the endpoint.
    pub fn send_raw(&mut self, link: LinkId, bytes: &[u8]) {
        self.endpoint.receive_from(self.now_ns, link, self.peer, bytes);
        self.collect();
    }

    pub fn packet(&mut self, from: ComponentId, message: &MavMessage) -> Vec<u8> {
        let header = MavHeader {
            system_id: u32::from(from.system),
            component_id: from.component,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut out = [0; MAX_PACKET_LEN];
        let len = framing::serialize(header, message, &mut out).expect("fits");
        out[..len].to_vec()
    }

    pub fn send(&mut self, link: LinkId, from: ComponentId, message: &MavMessage) {
        let packet = self.packet(from, message);
        self.send_raw(link, &packet);
    }

    pub fn send_heartbeat(&mut self, link: LinkId, from: ComponentId) {
        self.send(link, from, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
    }

    /// Sends a COMMAND_LONG to the vehicle and returns the result of the acknowledgement that came back.
    pub fn command_long(&mut self, link: LinkId, from: ComponentId, number: u16, params: [f32; 7]) -> u8 {
        let mut payload = Vec::with_capacity(33);
        for p in params {
            payload.extend_from_slice(&p.to_le_bytes());
        }
        payload.extend_from_slice(&number.to_le_bytes());
        payload.extend_from_slice(&[1, 1, 0]);
        self.command_payload(link, from, number, COMMAND_LONG_ID, &payload)
    }

    fn command_payload(&mut self, link: LinkId, from: ComponentId, number: u16, id: u32, payload: &[u8]) -> u8 {
        let header = MavHeader {
            system_id: u32::from(from.system),
            component_id: from.component,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut out = [0; MAX_PACKET_LEN];
        let len = framing::serialize_payload(header, id, payload, &mut out).expect("fits");
        let before = self.sent.len();
        self.send_raw(link, &out[..len]);
        let acks: Vec<_> = self.sent[before..]
            .iter()
            .filter(|s| s.link == link)
            .filter_map(|s| s.ack)
            .filter(|a| a.command == number)
            .collect();
        assert_eq!(acks.len(), 1, "command {number} has one answer");
        assert_eq!(
            (acks[0].target_system, acks[0].target_component),
            (from.system, from.component)
        );
        acks[0].result
    }

    /// Sends a COMMAND_INT DO_REPOSITION and returns the result.
    pub fn reposition(&mut self, frame: MavFrame, lat: f64, lon: f64, alt: f32, yaw: f32) -> u8 {
        let data = COMMAND_INT_DATA {
            param1: -1.0,
            param2: 1.0,
            param4: yaw,
            x: (lat * 1e7).round() as i32,
            y: (lon * 1e7).round() as i32,
            z: alt,
            command: MavCmd::MAV_CMD_DO_REPOSITION,
            target_system: 1,
            target_component: 1,
            frame,
            ..Default::default()
        };
        let before = self.sent.len();
        self.send(API, SCRIPT, &MavMessage::COMMAND_INT(data));
        self.sent[before..].iter().find_map(|s| s.ack).expect("answered").result
    }

    pub fn arm(&mut self) -> u8 {
        self.command_long(API, SCRIPT, 400, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    pub fn disarm(&mut self, force: f32) -> u8 {
        self.command_long(API, SCRIPT, 400, [0.0, force, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    /// Sends DO_SET_MODE and returns the result.
    pub fn set_mode(&mut self, link: LinkId, from: ComponentId, main: u8, sub: u8) -> u8 {
        let params = [129.0, f32::from(main), f32::from(sub), 0.0, 0.0, 0.0, 0.0];
        self.command_long(link, from, 176, params)
    }

    /// Sends SET_MODE, the message, and returns the result.
    pub fn set_mode_message(&mut self, main: u8, sub: u8) -> u8 {
        self.command_payload(API, SCRIPT, 176, SET_MODE_DATA::ID, &[0, 0, main, sub, 1, 1])
    }

    /// Sets a parameter by PARAM_SET; whole numbers bytewise.
    pub fn set_parameter(&mut self, name: &str, value: ParameterValue) {
        let (param_value, param_type) = match value {
            ParameterValue::Int32(v) => (f32::from_bits(v as u32), MavParamType::MAV_PARAM_TYPE_INT32),
            ParameterValue::Real32(v) => (v, MavParamType::MAV_PARAM_TYPE_REAL32),
        };
        let message = MavMessage::PARAM_SET(PARAM_SET_DATA {
            param_value,
            target_system: 1,
            target_component: 1,
            param_id: name.into(),
            param_type,
        });
        self.send(API, SCRIPT, &message);
    }

    /// Arms and takes off by MAVSDK's commands; ends in Hold.
    pub fn take_off(&mut self) {
        assert_eq!(self.arm(), ACCEPTED);
        assert_eq!(self.command_long(API, SCRIPT, 22, [f32::NAN; 7]), ACCEPTED);
        self.run_until(20, "take-off", |b| {
            b.status().mode == FlightMode::Hold && b.status().landed == LandedState::InAir
        });
    }

    pub fn send_velocity(&mut self, link: LinkId, from: ComponentId, velocity: [f32; 3]) {
        let message = velocity_message(velocity);
        self.send(link, from, &message);
    }

    /// Starts or changes a stream of setpoints.
    pub fn stream(&mut self, link: LinkId, from: ComponentId, velocity: [f32; 3]) {
        self.stop_stream(from);
        self.streaming.push((link, from, velocity));
    }

    pub fn stop_stream(&mut self, from: ComponentId) {
        self.streaming.retain(|s| s.1 != from);
    }

    /// The messages of the vehicle on a link since the last `sent.clear()`.
    pub fn messages(&self, link: LinkId) -> impl DoubleEndedIterator<Item = &MavMessage> {
        self.sent
            .iter()
            .filter(move |s| s.link == link && (s.from.system, s.from.component) == (1, 1))
            .filter_map(|s| s.message.as_ref())
    }

    pub fn count(&self, link: LinkId, message_id: u32) -> usize {
        self.messages(link).filter(|m| m.message_id() == message_id).count()
    }

    pub fn texts(&self) -> Vec<String> {
        self.messages(API)
            .filter_map(|m| match m {
                MavMessage::STATUSTEXT(STATUSTEXT_DATA { text, .. }) => text.to_str().ok().map(str::to_owned),
                _ => None,
            })
            .collect()
    }

    /// The last heartbeat on a link.
    pub fn heartbeat(&self, link: LinkId) -> HEARTBEAT_DATA {
        self.messages(link)
            .rev()
            .find_map(|m| match m {
                MavMessage::HEARTBEAT(h) => Some(h.clone()),
                _ => None,
            })
            .expect("a heartbeat was sent")
    }
}

pub const ACCEPTED: u8 = 0;
pub const REJECTED: u8 = 1;
pub const DENIED: u8 = 2;
pub const UNSUPPORTED: u8 = 3;
pub const FAILED: u8 = 4;
const COMMAND_LONG_ID: u32 = COMMAND_LONG_DATA::ID;

/// Frame 8, mask 0x5C7: what MAVSDK and the companion send.
pub fn velocity_message([vx, vy, vz]: [f32; 3]) -> MavMessage {
    MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
        vx,
        vy,
        vz,
        type_mask: PositionTargetTypemask::from_bits_retain(0x5C7),
        target_system: 1,
        target_component: 1,
        coordinate_frame: MavFrame::MAV_FRAME_BODY_NED,
        ..Default::default()
    })
}
