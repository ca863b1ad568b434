//! The guidance computer as a MAVLink component.

use crate::autopilot::Flavour;
use crate::framing::{Command, CommandAck, FramingCounters, Packet, packets};
use crate::handover::Handover;
use crate::obstacles;
use crate::operator::{PendingRequest, ReplyTo, decode, result, result_of};
use crate::parameters::{ParameterRequest, Parameters, SetRefusal};
use crate::report;
use crate::sender::Sender;
use crate::setpoint_timeout::{Next, SetpointTimeout};
use crate::streams::Streams;
use crate::time;
use crate::vehicle::Vehicle;
use heapless::{Deque, Vec};
use mavlink::dialects::common::{MavMessage, MavState};
use vigil_types::{
    Alarm, Datagrams, GuidanceState, HandoverProgress, Nanos, Reasons, RequestOutcome, STEP_NS, StepReport,
    VehicleRequest, VehicleTelemetry, VelocitySetpoint, Verdict,
};

/// The autopilot's component.
const AUTOPILOT: u8 = 1;
const HEARTBEAT_NS: Nanos = 1_000_000_000;
const VALUES_NS: Nanos = 250_000_000;
/// Answers that one step can owe: more than several links ask for in a step.
const REPLIES: usize = 128;
/// Requests that guidance can owe an answer to.
const REQUESTS: usize = 32;

/// Ten setpoints.
const DEFAULT_SETPOINT_TIMEOUT_S: f32 = 0.5;

/// Identity and vehicle of the guidance computer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CompanionConfig {
    /// The vehicle's system; `None` takes the first vehicle whose heartbeat is heard.
    pub system_id: Option<u8>,
    /// The guidance computer's component.
    pub component_id: u8,
    /// The vehicle's autopilot.
    pub flavour: Flavour,
    /// The longest time, seconds, that the vehicle may keep to its last setpoint; a longer one is set in the vehicle's
    /// parameters when it is taken over. `None` neither asks nor sets.
    pub setpoint_timeout_s: Option<f32>,
    /// Link to the vehicle, which is heard there and nowhere else; answers go back on the link that the question came
    /// from.
    pub link: u8,
}

impl Default for CompanionConfig {
    fn default() -> Self {
        Self {
            system_id: None,
            // MAV_COMP_ID_ONBOARD_COMPUTER
            component_id: 191,
            flavour: Flavour::Px4,
            setpoint_timeout_s: Some(DEFAULT_SETPOINT_TIMEOUT_S),
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
}

impl LinkCounters {
    /// Packets that were damaged, cut, of an incompatible protocol or unreadable: telemetry's "rx_bad".
    pub fn bad_packets(&self) -> u64 {
        let f = &self.framing;
        f.bad_crc + f.truncated + f.incompatible + self.unreadable
    }
}

/// Something that recurs at a fixed rate, whatever the jitter of the steps.
#[derive(Debug, Clone, Copy)]
struct Periodic {
    period_ns: Nanos,
    next_ns: Nanos,
}

impl Periodic {
    const fn new(period_ns: Nanos) -> Self {
        Self { period_ns, next_ns: 0 }
    }

    /// Whether it is due in this step: the one nearest to its time.
    fn is_due(&mut self, now_ns: Nanos) -> bool {
        if now_ns + STEP_NS / 2 < self.next_ns {
            return false;
        }
        let on_grid_ns = self.next_ns + self.period_ns;
        // The first time, or after a gap, it begins anew.
        self.next_ns = if on_grid_ns > now_ns {
            on_grid_ns
        } else {
            now_ns + self.period_ns
        };
        true
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Reply {
    Ack(ReplyTo, u16, u8),
    Time(u8, time::Answer),
    Parameter(u8, usize),
    NoSuchParameter(ReplyTo, [u8; 16], i16),
}

/// The guidance computer's end of the link: keeps what the vehicle told, hands operators' requests to guidance, writes
/// each step's packets. No clock, no allocation; one datagram may hold several packets, a packet is never split.
#[derive(Debug, Clone)]
pub struct Companion {
    config: CompanionConfig,
    sender: Sender,
    vehicle: Vehicle,
    handover: Handover,
    streams: Streams,
    setpoint_timeout: SetpointTimeout,
    counters: LinkCounters,
    replies: Vec<Reply, REPLIES>,
    requests: Deque<PendingRequest, REQUESTS>,
    /// The vehicle's system, once known.
    system_id: Option<u8>,
    said: Option<(GuidanceState, Reasons)>,
    said_verdict: Option<Verdict>,
    said_alarm: Option<Alarm>,
    parameters: Parameters,
    /// The last parameter that was not set, to be told of.
    parameter_refused: Option<(usize, SetRefusal)>,
    heartbeat: Periodic,
    values: Periodic,
    obstacles: Periodic,
    streaming: bool,
}

impl Companion {
    /// A companion that has heard nothing yet.
    pub fn new(config: CompanionConfig) -> Self {
        Self {
            config,
            // Until the vehicle is heard, 1: what a vehicle's system is unless somebody changed it.
            sender: Sender::new(config.system_id.unwrap_or(1), config.component_id),
            vehicle: Vehicle::new(config.flavour),
            handover: Handover::new(config.flavour),
            streams: Streams::new(config.flavour),
            setpoint_timeout: SetpointTimeout::new(config.flavour, config.setpoint_timeout_s),
            counters: LinkCounters::default(),
            replies: Vec::new(),
            requests: Deque::new(),
            system_id: config.system_id,
            said: None,
            said_verdict: None,
            said_alarm: None,
            parameters: Parameters::default(),
            parameter_refused: None,
            heartbeat: Periodic::new(HEARTBEAT_NS),
            values: Periodic::new(VALUES_NS),
            obstacles: Periodic::new(VALUES_NS),
            streaming: false,
        }
    }

    /// The same with parameters of its own.
    pub fn with_parameters(mut self, parameters: Parameters) -> Self {
        self.parameters = parameters;
        self
    }

    /// The parameters, which any ground station may read and set.
    pub fn parameters(&mut self) -> &mut Parameters {
        &mut self.parameters
    }

    /// What is known of the vehicle.
    pub fn telemetry(&self) -> &VehicleTelemetry {
        &self.vehicle.telemetry
    }

    /// How far the vehicle is with the hand-over.
    pub fn handover(&self) -> HandoverProgress {
        self.handover.progress()
    }

    /// How often the autopilot was seen to start anew.
    pub fn vehicle_restarts(&self) -> u32 {
        self.vehicle.restarts
    }

    /// The vehicle's system, once it is known.
    pub fn system_id(&self) -> Option<u8> {
        self.system_id
    }

    /// What was refused or dropped.
    pub fn counters(&self) -> LinkCounters {
        LinkCounters {
            late: self.vehicle.late,
            ..self.counters
        }
    }

    /// Takes a datagram.
    pub fn receive(&mut self, now_ns: Nanos, link: u8, datagram: &[u8]) {
        let mut framing = self.counters.framing;
        for packet in packets(datagram, &mut framing) {
            self.packet(now_ns, link, &packet);
        }
        self.counters.framing = framing;
    }

    fn packet(&mut self, now_ns: Nanos, link: u8, packet: &Packet<'_>) {
        // What the vehicle says counts on its own link only: nobody on another can speak in its place.
        let of_vehicle = link == self.config.link;
        if of_vehicle {
            self.learn_vehicle(packet);
        }
        if of_vehicle && self.system_id == Some(packet.system_id()) && packet.component_id() == AUTOPILOT {
            self.streams.note(now_ns, packet.message_id());
            self.setpoint_timeout.receive(packet);
            if !self.vehicle.receive(now_ns, packet) {
                self.counters.unreadable += 1;
            }
            if let Some(ack) = packet.command_ack()
                && self.is_for_me_or_all(ack.target_system, ack.target_component)
            {
                self.handover.acknowledge(now_ns, &ack);
            }
        }
        let from = ReplyTo {
            link,
            system: packet.system_id(),
            component: packet.component_id(),
        };
        if let Some(command) = packet.command() {
            // Only what is addressed to this very component: a broadcast command is the vehicle's to answer.
            if command.target_system == self.sender.system_id && command.target_component == self.sender.component_id {
                self.command(&command, from);
            }
            return;
        }
        if let Some((request, (system, component))) =
            ParameterRequest::from_payload(packet.message_id(), packet.payload())
        {
            // Of requests to all components it answers what it has.
            if system == self.sender.system_id && self.is_for_me_or_all(system, component) {
                let is_for_me = component == self.sender.component_id;
                self.parameter_request(from, is_for_me, &request);
            }
            return;
        }
        let me = (self.sender.system_id, self.sender.component_id);
        if let Some(answer) = time::answer(now_ns, packet, me) {
            self.reply(Reply::Time(link, answer));
        }
    }

    /// The first autopilot whose heartbeat comes is the vehicle, unless its system is configured.
    fn learn_vehicle(&mut self, packet: &Packet<'_>) {
        if self.system_id.is_none() && packet.is_autopilots_heartbeat() {
            self.system_id = Some(packet.system_id());
            self.sender.system_id = packet.system_id();
        }
    }

    fn is_for_me_or_all(&self, system: u8, component: u8) -> bool {
        (system == 0 || system == self.sender.system_id) && (component == 0 || component == self.sender.component_id)
    }

    fn command(&mut self, command: &Command, reply: ReplyTo) {
        match decode(command, &self.vehicle) {
            Ok(request) => {
                let pending = PendingRequest {
                    request,
                    command: command.number,
                    reply,
                };
                if self.requests.push_back(pending).is_err() {
                    self.acknowledge(reply, command.number, result::TEMPORARILY_REJECTED);
                }
            }
            Err(mav_result) => self.acknowledge(reply, command.number, mav_result),
        }
    }

    /// Answers on the link it came on. What there is not is told to who asked this very component: of a request to all
    /// another one may have it.
    fn parameter_request(&mut self, from: ReplyTo, is_for_me: bool, request: &ParameterRequest) {
        let link = from.link;
        match request {
            ParameterRequest::List => {
                for index in 0..self.parameters.count() {
                    self.reply(Reply::Parameter(link, index));
                }
            }
            ParameterRequest::ReadIndex(index) => {
                if *index < self.parameters.count() {
                    self.reply(Reply::Parameter(link, *index));
                } else if is_for_me {
                    // It came as 16 bits.
                    self.reply(Reply::NoSuchParameter(from, [0; 16], *index as i16));
                }
            }
            ParameterRequest::ReadName(name) => {
                if let Some(index) = self.parameters.find(name) {
                    self.reply(Reply::Parameter(link, index));
                } else if is_for_me {
                    self.reply(Reply::NoSuchParameter(from, *name, -1));
                }
            }
            ParameterRequest::Set { name, raw, mav_type } => {
                let Some(index) = self.parameters.find(name) else {
                    if is_for_me {
                        self.counters.parameters_refused += 1;
                        self.reply(Reply::NoSuchParameter(from, *name, -1));
                    }
                    return;
                };
                let flying = !matches!(
                    self.said,
                    None | Some((GuidanceState::Standby | GuidanceState::Ready, _))
                );
                let flavour = self.config.flavour;
                if let Err(refusal) = self.parameters.set(index, *raw, *mav_type, flavour, flying) {
                    self.counters.parameters_refused += 1;
                    self.parameter_refused = Some((index, refusal));
                }
                // The value in force, whichever it is: that is the protocol's answer.
                self.reply(Reply::Parameter(link, index));
            }
        }
    }

    fn acknowledge(&mut self, reply: ReplyTo, command: u16, mav_result: u8) {
        self.counters.commands_refused += u64::from(mav_result != result::ACCEPTED);
        self.reply(Reply::Ack(reply, command, mav_result));
    }

    fn reply(&mut self, reply: Reply) {
        if self.replies.push(reply).is_err() {
            self.counters.replies_dropped += 1;
        }
    }

    /// The next request of an operator; give guidance's answer to [`Companion::answer`].
    pub fn take_request(&mut self) -> Option<PendingRequest> {
        self.requests.pop_front()
    }

    /// Acknowledges a request.
    pub fn answer(&mut self, pending: &PendingRequest, outcome: RequestOutcome) {
        self.acknowledge(pending.reply, pending.command, result_of(outcome));
    }

    /// Writes this step's packets: `report` is what was decided, `request` what guidance asks of the vehicle.
    pub fn emit(&mut self, report: &StepReport, request: VehicleRequest, out: &mut Datagrams) {
        let now_ns = report.now_ns;
        self.emit_replies(out);
        if self.heartbeat.is_due(now_ns) {
            self.say(out, &report::heartbeat(report::mav_state(report.state, report.reasons)));
        }
        self.streaming = report.setpoint.is_some() && self.system_id.is_some();
        if let (Some(setpoint), Some(system)) = (&report.setpoint, self.system_id) {
            self.say(out, &report::setpoint(now_ns, system, setpoint));
        }
        self.emit_commands(now_ns, request, out);
        self.emit_status(report, out);
    }

    fn say(&mut self, out: &mut Datagrams, message: &MavMessage) {
        self.sender.message(out, self.config.link, message);
    }

    fn emit_replies(&mut self, out: &mut Datagrams) {
        let replies = core::mem::take(&mut self.replies);
        for reply in &replies {
            match reply {
                Reply::Ack(to, command, mav_result) => {
                    let ack = CommandAck {
                        command: *command,
                        result: *mav_result,
                        target_system: to.system,
                        target_component: to.component,
                        ..CommandAck::default()
                    };
                    self.sender.ack(out, to.link, &ack);
                }
                Reply::Time(link, (message_id, payload)) => self.sender.payload(out, *link, *message_id, payload),
                Reply::Parameter(link, index) => {
                    if let Some((message_id, payload)) = self.parameters.told(*index, self.config.flavour) {
                        self.sender.payload(out, *link, message_id, &payload);
                    }
                }
                Reply::NoSuchParameter(to, name, index) => {
                    let error = report::no_such_parameter((to.system, to.component), *name, *index);
                    self.sender.message(out, to.link, &error);
                }
            }
        }
        if let Some((index, refusal)) = self.parameter_refused.take() {
            self.say(
                out,
                &report::parameter_text(self.parameters.name(index), refusal.name()),
            );
        }
    }

    fn emit_commands(&mut self, now_ns: Nanos, request: VehicleRequest, out: &mut Datagrams) {
        let action = self.handover.step(now_ns, request, self.streaming, &self.vehicle);
        let Some(system) = self.system_id else { return };
        if let Some((number, params, confirmation)) = action.send {
            let command = Command::to_autopilot(system, number, params, confirmation);
            self.sender.command(out, self.config.link, &command);
        }
        if let Some(trouble) = action.trouble {
            self.say(out, &report::trouble_text(trouble, self.config.flavour));
        }
        let taking = matches!(request, VehicleRequest::FlyExternal { .. }) && !self.vehicle.is_other_autopilot();
        let message = match self.setpoint_timeout.step(now_ns, taking) {
            Next::Nothing => None,
            Next::Read => Some(self.setpoint_timeout.read(system)),
            Next::Set(value_s) => Some(self.setpoint_timeout.set(system, value_s)),
            Next::Tell(finding) => {
                let name = self.setpoint_timeout.name();
                Some(report::setpoint_timeout_text(name, finding))
            }
        };
        if let Some(message) = message {
            self.say(out, &message);
        }
        if let Some((number, params)) = self.streams.step(now_ns, &self.vehicle) {
            let command = Command::to_autopilot(system, number, params, 0);
            self.sender.command(out, self.config.link, &command);
        }
    }

    fn emit_status(&mut self, report: &StepReport, out: &mut Datagrams) {
        let now = (report.state, report.reasons);
        let before = self.said.replace(now);
        let due = self.values.is_due(report.now_ns);
        if due || before != Some(now) {
            for message in &report::state_values(report) {
                self.say(out, message);
            }
        }
        if due {
            for message in report::values(report, self.counters.bad_packets()) {
                self.say(out, &message);
            }
        }
        if before.map(|(state, _)| state) != Some(report.state) {
            self.say(out, &report::state_text(report.state, report.reasons));
        }
        let verdict = report.judgement.map(|j| j.verdict);
        if due | (core::mem::replace(&mut self.said_verdict, verdict) != verdict) {
            for message in report::judgement_values(report) {
                self.say(out, &message);
            }
        }
        if core::mem::replace(&mut self.said_alarm, report.alarm) != report.alarm {
            self.say(out, &report::alarm_text(report.alarm));
        }
    }

    /// Tells what the pilot sees, four times a second: for each sector its bearing (radians, positive to the right) and
    /// its distance (metres, infinite where nothing was seen). Call it in every step in which the pilot looked.
    pub fn emit_obstacles(&mut self, now_ns: Nanos, sectors: impl Iterator<Item = (f32, f32)>, out: &mut Datagrams) {
        if self.obstacles.is_due(now_ns) {
            self.say(out, &obstacles::message(now_ns, sectors));
        }
    }

    /// The last packets before the guidance computer falls silent: a zero setpoint, three times against loss, if it was
    /// streaming (an autopilot may keep the last velocity for seconds), and word of it.
    pub fn shutdown(&mut self, now_ns: Nanos, out: &mut Datagrams) {
        if let (true, Some(system)) = (self.streaming, self.system_id) {
            for _ in 0..3 {
                self.say(out, &report::setpoint(now_ns, system, &VelocitySetpoint::HOLD));
            }
        }
        self.streaming = false;
        self.say(out, &report::heartbeat(MavState::MAV_STATE_POWEROFF));
        self.say(out, &report::shutdown_text());
    }
}
