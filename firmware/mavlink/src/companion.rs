//! The guidance computer as a MAVLink component: packets in, the services' packets out.

use crate::autopilot::Flavour;
use crate::core::Core;
use crate::framing::{FramingCounters, Packet, packets};
use crate::operator::{PendingRequest, ReplyTo};
use crate::parameter_table::Parameters;
use crate::report;
use crate::services::{Services, Step};
use crate::status_text::{NOTICE, StatusText, WARNING};
use crate::vehicle::Vehicle;
use mavlink::MessageData;
use mavlink::dialects::common::{MavState, MavType, OBSTACLE_DISTANCE_DATA};
use vigil_types::{
    Datagrams, GuardNotice, GuidanceState, HandoverProgress, Nanos, NedVector, ObstacleReports, RequestOutcome,
    StepReport, VehicleRequest, VehicleStatus, VehicleTelemetry, parameters,
};

/// MAV_COMP_ID_ONBOARD_COMPUTER, which the guidance computer has.
pub const GUIDANCE_COMPONENT: u8 = 191;

/// Identity and vehicle of the guidance computer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CompanionConfig {
    /// The vehicle's system; `None` takes the first vehicle whose heartbeat is heard.
    pub system_id: Option<u8>,
    /// The guidance computer's component.
    pub component_id: u8,
    /// The vehicle's autopilot; `None` recognises it from its heartbeat.
    pub flavour: Option<Flavour>,
    /// When OBSTACLE_DISTANCE is sent.
    pub obstacles: ObstacleReports,
    /// The longest time, seconds, that the vehicle may keep to its last setpoint; a longer one is set in the vehicle's
    /// parameters when it is taken over. `None` neither asks nor sets.
    pub setpoint_timeout_s: Option<f32>,
    /// Missions are guarded: the place to which one leads (POSITION_TARGET_GLOBAL_INT) and the parameters by which the vehicle changes its
    /// speed are asked for.
    pub guards: bool,
    /// Link to the vehicle, which is heard there and nowhere else; answers go back on the link that the question came
    /// from.
    pub link: u8,
}

impl Default for CompanionConfig {
    fn default() -> Self {
        Self {
            system_id: None,
            component_id: GUIDANCE_COMPONENT,
            flavour: None,
            obstacles: ObstacleReports::default(),
            setpoint_timeout_s: Some(parameters::SETPOINT_TIMEOUT.number_f32()),
            guards: false,
            link: 0,
        }
    }
}

/// What the link refused or dropped, since start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkCounters {
    /// What the framing refused.
    pub framing: FramingCounters,
    /// Messages of interest that could not be read.
    pub unreadable: u64,
    /// Telemetry that came after newer telemetry.
    pub late: u64,
    /// Commands of operators answered with anything but ACCEPTED.
    pub commands_refused: u64,
    /// Parameters that were not set: wrong type, out of range, not in flight.
    pub parameters_refused: u64,
    /// Answers dropped because one step owed too many.
    pub replies_dropped: u64,
    /// Messages of the vehicle that were asked for again because they came too rarely.
    pub slow_streams: u64,
}

impl LinkCounters {
    /// Packets that were damaged, cut, of an incompatible protocol or unreadable: telemetry's "rx_bad".
    pub fn bad_packets(&self) -> u64 {
        let f = &self.framing;
        f.bad_crc + f.truncated + f.incompatible + self.unreadable
    }
}

/// The guidance computer's end of the link: keeps what the vehicle reported, hands operators' requests to guidance, writes
/// each step's packets. No clock, no allocation; one datagram may hold several packets, a packet is never split.
#[derive(Debug, Clone)]
pub struct Companion {
    core: Core,
    services: Services,
}

impl Companion {
    /// A companion that has heard nothing yet.
    pub fn new(config: CompanionConfig) -> Self {
        Self {
            core: Core::new(config),
            services: Services::new(&config),
        }
    }

    /// The same with parameters of its own.
    pub fn with_parameters(mut self, parameters: Parameters) -> Self {
        self.services.parameters.table = parameters;
        self
    }

    /// The parameters, which any ground station may read and set.
    pub fn parameters(&mut self) -> &mut Parameters {
        &mut self.services.parameters.table
    }

    /// What is known of the vehicle.
    pub fn telemetry(&self) -> &VehicleTelemetry {
        &self.core.vehicle.telemetry
    }

    /// The vehicle itself.
    pub fn vehicle(&self) -> &Vehicle {
        &self.core.vehicle
    }

    /// What its velocity, as it is known here, is more than the pictures say, NED, metres per second.
    pub fn note_seen_error(&mut self, error_m_s: NedVector) {
        self.core.vehicle.seen_error_m_s = error_m_s;
    }

    /// How far the vehicle is with the hand-over.
    pub fn handover(&self) -> HandoverProgress {
        self.services.handover.progress
    }

    /// How it stands with the vehicle.
    pub fn vehicle_status(&self) -> VehicleStatus {
        let vehicle = &self.core.vehicle;
        VehicleStatus {
            handover: self.handover(),
            restarts: vehicle.restarts,
            up_ns: vehicle.up_ns(),
            home_ned_m: vehicle.home_ned_m(),
            telemetry_interval_ns: self.core.telemetry_interval_ns,
        }
    }

    /// The texts of the last step for people.
    pub fn status_texts(&self) -> &[StatusText] {
        &self.core.texts
    }

    /// The vehicle's system, once it is known.
    pub fn system_id(&self) -> Option<u8> {
        self.core.system_id
    }

    /// What was refused or dropped.
    pub fn counters(&self) -> LinkCounters {
        LinkCounters {
            late: self.core.vehicle.late,
            ..self.core.counters
        }
    }

    /// Takes a datagram.
    pub fn receive(&mut self, now_ns: Nanos, link: u8, datagram: &[u8]) {
        let mut framing = self.core.counters.framing;
        for packet in packets(datagram, &mut framing) {
            self.packet(now_ns, link, &packet);
        }
        self.core.counters.framing = framing;
    }

    fn packet(&mut self, now_ns: Nanos, link: u8, packet: &Packet<'_>) {
        let Self { core, services } = self;
        // What the vehicle says counts on its own link only: nobody on another can speak in its place.
        if link == core.config.link {
            // The first autopilot whose heartbeat comes is the vehicle, unless its system is configured.
            let is_autopilots = packet.is_of_autopilot(&mut core.system_id);
            core.sender.system_id = core.system_id.unwrap_or(core.sender.system_id);
            // A second sensor may be a component of its own.
            let is_sensors = packet.message_id() == OBSTACLE_DISTANCE_DATA::ID
                && core.system_id == Some(packet.system_id())
                && packet.component_id() != core.config.component_id;
            if (is_autopilots || is_sensors) && !core.vehicle.receive(now_ns, packet) {
                core.counters.unreadable += 1;
            }
            if is_autopilots {
                services.hear_vehicle(core, now_ns, packet);
            }
        } else {
            core.note_link(link);
        }
        let from = ReplyTo {
            link,
            system: packet.system_id(),
            component: packet.component_id(),
        };
        services.hear(core, now_ns, packet, from);
    }

    /// The next request of an operator; give guidance's answer to [`Companion::answer`].
    pub fn take_request(&mut self) -> Option<PendingRequest> {
        self.services.commands.requests.pop_front()
    }

    /// Acknowledges a request; one that is refused with the reasons of the last step, and with a text.
    pub fn answer(&mut self, pending: &PendingRequest, outcome: RequestOutcome) {
        self.services.commands.answer(&mut self.core, pending, outcome);
    }

    /// Writes this step's packets: `report` is what was decided, `request` what guidance asks of the vehicle.
    pub fn emit(&mut self, report: &StepReport, request: VehicleRequest, out: &mut Datagrams) {
        self.core.vehicle.in_flight = !matches!(report.state, GuidanceState::Standby | GuidanceState::Ready);
        let limit = parameters::SPEED_LIMIT.mavlink.map(|mavlink| mavlink.name);
        let limit = limit.and_then(|name| self.parameters().value_of(name));
        self.core.vehicle.speed_limit_m_s = limit.map(|limit| limit.as_f32());
        // Let go of it is let go of.
        self.core.letting_go &= self.core.vehicle.in_flight;
        let request = match request {
            VehicleRequest::None if self.core.letting_go && report.has_vehicle() => VehicleRequest::Hold {
                cause: None,
                place_m: None,
            },
            other => other,
        };
        self.core.begin_step(out);
        self.services.speak(&mut self.core, &Step { report, request }, out);
    }

    /// Sends what the pilot sees, four times a second, as [`ObstacleReports`] says: for each sector its bearing (radians,
    /// positive to the right) and its distance (metres, infinite where nothing was seen). Call it in every step; `sectors`
    /// is `None` in a step in which the pilot did not look.
    pub fn emit_obstacles(
        &mut self,
        now_ns: Nanos,
        sectors: Option<impl Iterator<Item = (f32, f32)>>,
        out: &mut Datagrams,
    ) {
        self.services.obstacles.tell(&mut self.core, now_ns, sectors, out);
    }

    /// Says to people what becomes of a guarded flight.
    pub fn tell_of_guard(&mut self, notice: GuardNotice, out: &mut Datagrams) {
        self.core.tell(out, WARNING, format_args!("{}", notice.name()));
    }

    /// The last packets before the guidance computer falls silent: zero setpoints if it was streaming, and word of it.
    pub fn shutdown(&mut self, now_ns: Nanos, out: &mut Datagrams) {
        let Self { core, services } = self;
        services.setpoints.end(core, now_ns, out);
        core.say(
            out,
            &report::heartbeat(MavType::MAV_TYPE_ONBOARD_CONTROLLER, MavState::MAV_STATE_POWEROFF),
        );
        // Nothing of the step before stands beside it.
        core.texts.clear();
        core.tell(out, NOTICE, format_args!("guidance: shut down"));
    }
}
