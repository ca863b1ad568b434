//! A bench for tests: the endpoint, the vehicle, and clients that read what comes back.

use crate::core::EndpointStatus;
use crate::vehicle::{Vehicle, VehicleParams, VehicleView, Wind};
use crate::{Endpoint, geo};
use vigil_mavlink::framing::{self, Command, CommandAck, CommandForm, FramingCounters, MAX_PACKET_LEN};
use vigil_mavlink::globe;
use vigil_mavlink::mavlink::{MavHeader, MavlinkVersion, Message};
use vigil_types::{Nanos, NedVector};

// What tests name besides the bench.
pub use crate::core::ComponentId;
pub use crate::vehicle::ControlCommand;
pub use crate::{EndpointConfig, Failsafe, FlightMode, LandedState, LinkId, ParameterValue, parameter_table};
pub use vigil_mavlink::MavMessage;
pub use vigil_mavlink::common::*;
pub use vigil_mavlink::mavlink::MessageData;
pub use vigil_mavlink::message;

pub const ONBOARD: LinkId = LinkId::ONBOARD;
pub const API: LinkId = LinkId::API;
pub const GCS: LinkId = LinkId::GCS;
pub const VEHICLE: ComponentId = component(1, 1);
pub const COMPANION: ComponentId = component(1, 191);
pub const SCRIPT: ComponentId = component(245, 190);
pub const STATION: ComponentId = component(255, 190);

const fn component(system: u8, component: u8) -> ComponentId {
    ComponentId { system, component }
}

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
    /// The vehicle's system, as parameters are addressed.
    pub system: u8,
    /// From which end of its link everybody sends.
    pub peer: u64,
    /// Components that stream velocity setpoints at 20 Hz, with the velocity along the heading.
    streaming: Vec<(LinkId, ComponentId, [f32; 3])>,
}

impl Bench {
    /// A vehicle on the ground; what it sent at its start is forgotten.
    pub fn new() -> Self {
        let mut bench = Self::with(EndpointConfig::default());
        bench.sent.clear();
        bench
    }

    pub fn with(config: EndpointConfig) -> Self {
        let mut bench = Self {
            endpoint: Endpoint::new(config).expect("valid configuration"),
            now_ns: 1_000_000_000,
            sent: Vec::new(),
            command: ControlCommand::MotorsOff,
            vehicle: Vehicle::new(VehicleParams::default(), Wind::default(), 1).expect("defaults are valid"),
            sequence: 0,
            system: 1,
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
        self.endpoint.transmit(|link, _, datagram| {
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
        self.sequence = self.sequence.wrapping_add(1);
        framing::encode((from.system, from.component), self.sequence, message)
    }

    pub fn send(&mut self, link: LinkId, from: ComponentId, message: &MavMessage) {
        let packet = self.packet(from, message);
        self.send_raw(link, &packet);
    }

    /// Sends a script's message to the vehicle.
    pub fn tell(&mut self, mut message: MavMessage) {
        let system = message.target_system_id_mut();
        system.into_iter().for_each(|id| *id = self.system);
        message.target_component_id_mut().into_iter().for_each(|id| *id = 1);
        self.send(API, SCRIPT, &message);
    }

    /// Sends a script's COMMAND_LONG, further parameters zero, and returns the result.
    pub fn ask(&mut self, number: u16, params: &[f32]) -> u8 {
        let mut all = [0.0; 7];
        all[..params.len()].copy_from_slice(params);
        self.command_long(API, SCRIPT, number, all)
    }

    /// Sends a COMMAND_LONG to the vehicle and returns the result of the acknowledgement that came back.
    pub fn command_long(&mut self, link: LinkId, from: ComponentId, number: u16, params: [f32; 7]) -> u8 {
        self.answer(link, from, number, &command(from, number, params, LONG))
    }

    fn answer(&mut self, link: LinkId, from: ComponentId, number: u16, packet: &[u8]) -> u8 {
        let before = self.sent.len();
        self.send_raw(link, packet);
        let came = self.sent[before..].iter().filter(|s| s.link == link);
        let acks: Vec<_> = came.filter_map(|s| s.ack).filter(|a| a.command == number).collect();
        assert_eq!(acks.len(), 1, "command {number} has one answer");
        let to = (acks[0].target_system, acks[0].target_component);
        assert_eq!(to, (from.system, from.component));
        acks[0].result
    }

    /// Sends a COMMAND_INT with a place and returns the result.
    pub fn command_at(
        &mut self,
        command: MavCmd,
        params: [f32; 4],
        frame: MavFrame,
        (lat, lon): (f64, f64),
        z: f32,
    ) -> u8 {
        let (number, [p1, p2, p3, p4]) = (command as u16, params);
        let (frame, x, y) = (frame as u8, geo::deg_e7(lat), geo::deg_e7(lon));
        let params = [p1, p2, p3, p4, f32::NAN, f32::NAN, z];
        let packet = self::command(SCRIPT, number, params, CommandForm::Int { frame, x, y });
        self.answer(API, SCRIPT, number, &packet)
    }

    /// Sends DO_REPOSITION and returns the result.
    pub fn reposition(&mut self, frame: MavFrame, place: (f64, f64), alt: f32, yaw: f32) -> u8 {
        let params = [-1.0, 1.0, 0.0, yaw];
        self.command_at(MavCmd::MAV_CMD_DO_REPOSITION, params, frame, place, alt)
    }

    /// Has it fly to a place, metres north and east of home and above sea level.
    pub fn go_to(&mut self, place: (f32, f32), altitude_m: f32) -> u8 {
        self.reposition(MavFrame::MAV_FRAME_GLOBAL_INT, on_globe(place), altitude_m, f32::NAN)
    }

    pub fn arm(&mut self) -> u8 {
        self.ask(400, &[1.0])
    }

    pub fn disarm(&mut self, force: f32) -> u8 {
        self.ask(400, &[0.0, force])
    }

    /// Sends DO_SET_MODE and returns the result.
    pub fn set_mode(&mut self, link: LinkId, from: ComponentId, main: u8, sub: u8) -> u8 {
        let params = [129.0, f32::from(main), f32::from(sub), 0.0, 0.0, 0.0, 0.0];
        self.command_long(link, from, 176, params)
    }

    /// Sends SET_MODE, the message, and returns the result.
    pub fn set_mode_message(&mut self, base: u8, main: u8, sub: u8) -> u8 {
        let packet = raw(SCRIPT, SET_MODE_DATA::ID, &[0, 0, main, sub, 1, base]);
        self.answer(API, SCRIPT, 176, &packet)
    }

    /// Sets a parameter by PARAM_SET; whole numbers bytewise.
    pub fn set_parameter(&mut self, name: &str, value: ParameterValue) {
        let (param_value, param_type) = value.on_wire();
        self.set_parameter_as(name, param_value, param_type);
    }

    pub fn set_parameter_as(&mut self, name: &str, param_value: f32, param_type: MavParamType) {
        self.tell(message!(PARAM_SET, param_value, param_id = name.into(), param_type));
    }

    /// Asks for a parameter, by its name where the index is −1.
    pub fn read_parameter(&mut self, name: &str, param_index: i16) {
        self.tell(message!(PARAM_REQUEST_READ, param_index, param_id = name.into()));
    }

    /// Streams a message at 20 Hz for this long.
    pub fn hold(&mut self, link: LinkId, from: ComponentId, message: &MavMessage, ms: u64) {
        for _ in 0..ms / 50 {
            self.send(link, from, message);
            self.run_ms(50);
        }
    }

    /// Lets time pass, and gives the largest of what is read every 10 ms.
    pub fn most(&mut self, ms: u64, read: impl Fn(&Self) -> f32) -> f32 {
        let mut most = f32::NEG_INFINITY;
        for _ in 0..ms / 10 {
            self.run_ms(10);
            most = most.max(read(self));
        }
        most
    }

    /// Whether it is at metres north and east of home, and above it.
    pub fn is_at(&self, (north, east): (f32, f32), height_m: f32, within_m: f32) -> bool {
        let [x, y, z] = self.position_m();
        (x - north).hypot(y - east) < within_m && (z + height_m).abs() < within_m
    }

    pub fn velocity_m_s(&self) -> NedVector {
        self.view().estimate.velocity_ned_m_s
    }

    pub fn yaw_rad(&self) -> f32 {
        self.view().estimate.attitude.yaw_rad()
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

    /// Streams a velocity for this long, then has it flown.
    pub fn fly(&mut self, link: LinkId, from: ComponentId, velocity: [f32; 3], ms: u64) {
        self.stream(link, from, velocity);
        self.run_ms(ms);
        assert_eq!(self.set_mode(link, from, 6, 0), ACCEPTED);
    }

    pub fn stop_stream(&mut self, from: ComponentId) {
        self.streaming.retain(|s| s.1 != from);
    }

    /// The messages of the vehicle on a link since the last `sent.clear()`.
    pub fn messages(&self, link: LinkId) -> impl DoubleEndedIterator<Item = &MavMessage> {
        self.sent
            .iter()
            .filter(move |s| s.link == link && s.from == VEHICLE)
            .filter_map(|s| s.message.as_ref())
    }

    /// The vehicle's messages of one kind on a link since the last `sent.clear()`.
    pub fn all<M: MessageData<Message = MavMessage>>(&self, link: LinkId) -> Vec<M> {
        let vehicle = component(self.system, 1);
        let own = self.sent.iter().filter(|s| s.link == link && s.from == vehicle);
        let of_kind = own.filter(|s| s.message.as_ref().is_some_and(|m| m.message_id() == M::ID));
        let read = |s: &Sent| M::deser(MavlinkVersion::V2, &s.raw[10..s.raw.len() - 2]).expect("it was read once");
        of_kind.map(read).collect()
    }

    pub fn first<M: MessageData<Message = MavMessage>>(&self, link: LinkId) -> Option<M> {
        self.all(link).into_iter().next()
    }

    /// The first on the scripts' link, which must be there.
    pub fn one<M: MessageData<Message = MavMessage>>(&self) -> M {
        self.first(API).unwrap_or_else(|| panic!("{} was not sent", M::NAME))
    }

    /// The last within this time from now.
    pub fn fresh<M: MessageData<Message = MavMessage>>(&mut self, ms: u64) -> M {
        self.sent.clear();
        self.run_ms(ms);
        self.last(API)
    }

    /// Asks for a message and returns it.
    pub fn request<M: MessageData<Message = MavMessage>>(&mut self) -> M {
        self.sent.clear();
        assert_eq!(self.ask(512, &[M::ID as f32]), ACCEPTED);
        self.one()
    }

    /// The last on a link, which must be there.
    pub fn last<M: MessageData<Message = MavMessage>>(&self, link: LinkId) -> M {
        self.all(link)
            .pop()
            .unwrap_or_else(|| panic!("{} was not sent", M::NAME))
    }

    pub fn count(&self, link: LinkId, message_id: u32) -> usize {
        self.messages(link).filter(|m| m.message_id() == message_id).count()
    }

    pub fn texts(&self) -> Vec<String> {
        let texts = self.all::<STATUSTEXT_DATA>(API).into_iter();
        texts.filter_map(|t| Some(t.text.to_str().ok()?.to_owned())).collect()
    }

    /// Fails unless a status text with these words was sent.
    pub fn assert_said(&self, words: &str) {
        let texts = self.texts();
        assert!(texts.iter().any(|text| text.contains(words)), "{words}: {texts:?}");
    }
}

/// The form of a COMMAND_LONG.
pub const LONG: CommandForm = CommandForm::Long { confirmation: 0 };

/// The packet of a command to the vehicle, whose number may be any.
pub fn command(from: ComponentId, number: u16, params: [f32; 7], form: CommandForm) -> Vec<u8> {
    let command = Command {
        form,
        ..Command::to_autopilot(1, number, params, 0)
    };
    let header = MavHeader {
        system_id: from.system.into(),
        component_id: from.component,
        sequence: 0,
    };
    let mut out = [0; MAX_PACKET_LEN];
    let len = command.serialize(header, &mut out).expect("fits");
    out[..len].to_vec()
}

/// A packet of a payload that may be any.
pub fn raw(from: ComponentId, id: u32, payload: &[u8]) -> Vec<u8> {
    framing::encode_payload((from.system, from.component), 0, id, payload).expect("fits")
}

pub const ACCEPTED: u8 = 0;
pub const REJECTED: u8 = 1;
pub const DENIED: u8 = 2;
pub const UNSUPPORTED: u8 = 3;
pub const FAILED: u8 = 4;

/// Frame 8, mask 0x5C7: what MAVSDK and the companion send.
pub fn velocity_message(velocity: [f32; 3]) -> MavMessage {
    local_setpoint(0x5C7, |m| {
        [m.vx, m.vy, m.vz] = velocity;
        m.coordinate_frame = MavFrame::MAV_FRAME_BODY_NED;
    })
}

/// SET_POSITION_TARGET_LOCAL_NED in frame 1 with a mask.
pub fn local_setpoint(mask: u16, change: impl FnOnce(&mut SET_POSITION_TARGET_LOCAL_NED_DATA)) -> MavMessage {
    let mut data = SET_POSITION_TARGET_LOCAL_NED_DATA {
        type_mask: PositionTargetTypemask::from_bits_retain(mask),
        target_system: 1,
        target_component: 1,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..Default::default()
    };
    change(&mut data);
    MavMessage::SET_POSITION_TARGET_LOCAL_NED(data)
}

/// SET_POSITION_TARGET_GLOBAL_INT of a position alone.
pub fn global_setpoint(frame: MavFrame, (lat, lon): (f64, f64), alt: f32) -> MavMessage {
    message!(
        SET_POSITION_TARGET_GLOBAL_INT,
        lat_int = geo::deg_e7(lat),
        lon_int = geo::deg_e7(lon),
        alt,
        type_mask = PositionTargetTypemask::from_bits_retain(0xDF8),
        target_system = 1,
        target_component = 1,
        coordinate_frame = frame
    )
}

/// SET_ATTITUDE_TARGET of a pitch, a yaw rate and a thrust.
pub fn attitude_setpoint(mask: u8, pitch_deg: f32, body_yaw_rate: f32, thrust: f32) -> MavMessage {
    let half_rad = pitch_deg.to_radians() / 2.0;
    message!(
        SET_ATTITUDE_TARGET,
        q = [half_rad.cos(), 0.0, half_rad.sin(), 0.0],
        body_yaw_rate,
        thrust,
        type_mask = AttitudeTargetTypemask::from_bits_retain(mask),
        target_system = 1,
        target_component = 1
    )
}

/// Latitude and longitude of a place, metres north and east of home.
pub fn on_globe((north, east): (f32, f32)) -> (f64, f64) {
    let origin = (geo::ORIGIN.latitude_deg, geo::ORIGIN.longitude_deg);
    globe::to_global(origin, north, east)
}
