//! The guidance computer as a MAVLink component.

use crate::autopilot::Flavour;
use crate::framing::{Command, CommandAck, FramingCounters, Packet, packets};
use crate::handover::Handover;
use crate::inputs::{self, MissingInputs};
use crate::obstacles;
use crate::operator::{PendingRequest, ReplyTo, decode, request_name, result, result_of};
use crate::parameters::{ParameterRequest, Parameters, SetRefusal};
use crate::report::{self, Refusal};
use crate::sender::Sender;
use crate::setpoint_timeout::{Next, SetpointTimeout};
use crate::status_text::StatusText;
use crate::streams::{Ask, Streams};
use crate::time;
use crate::vehicle::Vehicle;
use heapless::{Deque, Vec};
use mavlink::dialects::common::{MavMessage, MavState};
use vigil_types::{
    Alarm, Datagrams, GuidanceState, HandoverProgress, Nanos, NedVector, ObstacleReports, OperatorRequest, Reason,
    Reasons, RequestOutcome, STEP_NS, StepReport, VehicleRequest, VehicleTelemetry, VelocitySetpoint, Verdict,
    parameters,
};

/// The autopilot's component.
const AUTOPILOT: u8 = 1;
const HEARTBEAT_NS: Nanos = 1_000_000_000;
const VALUES_NS: Nanos = 250_000_000;
/// Answers that one step can owe: more than several links ask for in a step.
const REPLIES: usize = 128;
/// Requests that guidance can owe an answer to.
const REQUESTS: usize = 32;
/// Texts about refused requests in a second; a flood of requests must not become one of texts.
const REFUSALS_PER_SECOND: usize = 4;
const REFUSALS_NS: Nanos = 1_000_000_000;
/// Texts of a step that whoever runs the program can show.
const TOLD: usize = 16;
/// Texts that are kept for a vehicle's link that nobody answers on yet.
const KEPT: usize = 8;
/// A vehicle of another autopilot than the configured one is told of this often.
const WRONG_VEHICLE_NS: Nanos = 30_000_000_000;
/// Home is told of when it is this much elsewhere than last told, metres.
const HOME_MOVED_M: f32 = 0.5;

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
            flavour: None,
            obstacles: ObstacleReports::default(),
            setpoint_timeout_s: Some(parameters::SETPOINT_TIMEOUT.number_f32()),
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
    Ack(ReplyTo, u16, u8, Reasons),
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
    /// The last goal that was too far, to be told of: its distance and what is allowed, metres.
    goal_refused: Option<(u32, u32)>,
    heartbeat: Periodic,
    values: Periodic,
    obstacles: Periodic,
    streaming: bool,
    missing: MissingInputs,
    /// Requests that were refused since the last step, by name.
    refused: Vec<(&'static str, Refusal), REFUSALS_PER_SECOND>,
    refusals_since_ns: Nanos,
    refusals_told: usize,
    /// The texts of this step.
    told: Vec<StatusText, TOLD>,
    /// The newest texts from before the vehicle was heard.
    kept: Vec<StatusText, KEPT>,
    /// Of the last text of several chunks.
    text_id: u16,
    /// Packets came on the vehicle's link; on others, one bit each.
    vehicle_heard: bool,
    links_heard: u64,
    /// A ground station was heard for the first time: it is told the state.
    newcomer: bool,
    vehicle_named: bool,
    wrong_vehicle_ns: Option<Nanos>,
    home_said_m: NedVector,
    pilot_said: bool,
}

impl Companion {
    /// A companion that has heard nothing yet.
    pub fn new(config: CompanionConfig) -> Self {
        Self {
            config,
            // Until the vehicle is heard, 1: what a vehicle's system is unless somebody changed it.
            sender: Sender::new(config.system_id.unwrap_or(1), config.component_id),
            vehicle: Vehicle::new(config.flavour),
            handover: Handover::new(),
            streams: Streams::new(),
            setpoint_timeout: SetpointTimeout::new(config.setpoint_timeout_s),
            counters: LinkCounters::default(),
            replies: Vec::new(),
            requests: Deque::new(),
            system_id: config.system_id,
            said: None,
            said_verdict: None,
            said_alarm: None,
            parameters: Parameters::default(),
            parameter_refused: None,
            goal_refused: None,
            heartbeat: Periodic::new(HEARTBEAT_NS),
            values: Periodic::new(VALUES_NS),
            obstacles: Periodic::new(VALUES_NS),
            streaming: false,
            missing: MissingInputs::default(),
            refused: Vec::new(),
            refusals_since_ns: 0,
            refusals_told: 0,
            told: Vec::new(),
            kept: Vec::new(),
            text_id: 0,
            vehicle_heard: false,
            links_heard: 0,
            newcomer: false,
            vehicle_named: false,
            wrong_vehicle_ns: None,
            home_said_m: NedVector::ZERO,
            pilot_said: false,
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

    /// How long ago the autopilot started, by its own clock; `None` when it has not told.
    pub fn vehicle_up_ns(&self) -> Option<Nanos> {
        self.vehicle.up_ns()
    }

    /// Home in the local frame; `None` when the vehicle has not told.
    pub fn home_ned_m(&self) -> Option<NedVector> {
        self.vehicle.home_ned_m()
    }

    /// Mean time between the last positions or attitudes, whichever is longer; `None` before there were enough.
    pub fn telemetry_interval_ns(&self) -> Option<Nanos> {
        self.streams.flight_interval_ns()
    }

    /// The vehicle's autopilot: as configured or recognised, PX4 before that.
    pub fn flavour(&self) -> Flavour {
        self.vehicle.flavour()
    }

    /// The texts that the last step told.
    pub fn told(&self) -> &[StatusText] {
        &self.told
    }

    /// The vehicle's system, once it is known.
    pub fn system_id(&self) -> Option<u8> {
        self.system_id
    }

    /// What was refused or dropped.
    pub fn counters(&self) -> LinkCounters {
        LinkCounters {
            late: self.vehicle.late,
            slow_streams: self.streams.slow_asked,
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
        if !of_vehicle {
            let bit = 1_u64.checked_shl(link.into()).unwrap_or(0);
            self.newcomer |= self.links_heard & bit != bit;
            self.links_heard |= bit;
        }
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
                    self.refuse(command.number, Refusal::Busy);
                    self.acknowledge(reply, command.number, result::TEMPORARILY_REJECTED, Reasons::NONE);
                }
            }
            Err(mav_result) => {
                self.refuse(command.number, Refusal::Command(mav_result));
                self.acknowledge(reply, command.number, mav_result, Reasons::NONE);
            }
        }
    }

    /// To be told in the next step, as far as there is room.
    fn refuse(&mut self, command: u16, why: Refusal) {
        if let Some(name) = request_name(command) {
            let _ = self.refused.push((name, why));
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
                let flavour = self.vehicle.flavour();
                if let Err(refusal) = self.parameters.set(index, *raw, *mav_type, flavour, flying) {
                    self.counters.parameters_refused += 1;
                    self.parameter_refused = Some((index, refusal));
                }
                // The value in force, whichever it is: that is the protocol's answer.
                self.reply(Reply::Parameter(link, index));
            }
        }
    }

    fn acknowledge(&mut self, reply: ReplyTo, command: u16, mav_result: u8, reasons: Reasons) {
        self.counters.commands_refused += u64::from(mav_result != result::ACCEPTED);
        self.reply(Reply::Ack(reply, command, mav_result, reasons));
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

    /// Acknowledges a request; one that is refused with the reasons of the last step, and with a text.
    pub fn answer(&mut self, pending: &PendingRequest, outcome: RequestOutcome) {
        let (state, reasons) = self.said.unwrap_or_default();
        let told = match outcome {
            RequestOutcome::Accepted => Reasons::NONE,
            RequestOutcome::TooFar { .. } => Reasons::NONE,
            RequestOutcome::TemporarilyRejected | RequestOutcome::Denied => {
                let why = match pending.request {
                    OperatorRequest::Goal { .. } | OperatorRequest::FixedGoal { .. } => Refusal::Goal,
                    OperatorRequest::Land => Refusal::NotGuiding(state),
                    OperatorRequest::Engage | OperatorRequest::Disengage => Refusal::In(state, reasons),
                };
                self.refuse(pending.command, why);
                reasons
            }
        };
        self.acknowledge(pending.reply, pending.command, result_of(outcome), told);
        if let RequestOutcome::TooFar { distance_m, limit_m } = outcome {
            self.goal_refused = Some((distance_m, limit_m));
        }
    }

    /// Writes this step's packets: `report` is what was decided, `request` what guidance asks of the vehicle.
    pub fn emit(&mut self, report: &StepReport, request: VehicleRequest, out: &mut Datagrams) {
        let now_ns = report.now_ns;
        self.told.clear();
        self.vehicle.in_flight = !matches!(report.state, GuidanceState::Standby | GuidanceState::Ready);
        self.emit_kept(out);
        self.emit_replies(out);
        self.emit_refusals(now_ns, out);
        if self.heartbeat.is_due(now_ns) {
            self.say(out, &report::heartbeat(report::mav_state(report.state, report.reasons)));
        }
        self.streaming = report.setpoint.is_some() && self.system_id.is_some();
        if let (Some(setpoint), Some(system)) = (&report.setpoint, self.system_id) {
            self.say(out, &report::setpoint(now_ns, system, setpoint));
        }
        self.emit_commands(report, request, out);
        self.emit_status(report, out);
        self.emit_warnings(report, out);
    }

    /// Says a text to everybody, and to whoever runs the program; also to a vehicle's link on which nobody answers yet, later.
    fn tell(&mut self, out: &mut Datagrams, text: &StatusText) {
        if !self.vehicle_heard {
            if self.kept.is_full() {
                self.kept.remove(0);
            }
            let _ = self.kept.push(*text);
        }
        self.tell_now(out, text);
    }

    /// The same for what is of no interest later.
    fn tell_now(&mut self, out: &mut Datagrams, text: &StatusText) {
        self.say_text(out, text);
        // More than a step tells at its worst.
        let _ = self.told.push(*text);
    }

    fn say_text(&mut self, out: &mut Datagrams, text: &StatusText) {
        // Texts of one chunk have no number, so that 0 stays free.
        self.text_id = self.text_id % u16::MAX + 1;
        for message in text.messages(self.text_id) {
            self.say(out, &message);
        }
    }

    /// Once the vehicle is heard, its link has a peer: what was told before reaches it now.
    fn emit_kept(&mut self, out: &mut Datagrams) {
        if self.system_id.is_none() || self.vehicle_heard || self.vehicle.telemetry.heartbeat.is_none() {
            return;
        }
        self.vehicle_heard = true;
        for text in &core::mem::take(&mut self.kept) {
            self.say_text(out, text);
        }
    }

    fn emit_refusals(&mut self, now_ns: Nanos, out: &mut Datagrams) {
        if now_ns.saturating_sub(self.refusals_since_ns) >= REFUSALS_NS {
            (self.refusals_since_ns, self.refusals_told) = (now_ns, 0);
        }
        for (request, why) in &core::mem::take(&mut self.refused) {
            if self.refusals_told < REFUSALS_PER_SECOND {
                self.refusals_told += 1;
                self.tell(out, &report::refused_text(request, *why));
            }
        }
    }

    fn say(&mut self, out: &mut Datagrams, message: &MavMessage) {
        self.sender.message(out, self.config.link, message);
    }

    fn emit_replies(&mut self, out: &mut Datagrams) {
        let replies = core::mem::take(&mut self.replies);
        for reply in &replies {
            match reply {
                Reply::Ack(to, command, mav_result, reasons) => {
                    let ack = CommandAck {
                        command: *command,
                        result: *mav_result,
                        // Why it was refused, as the bits of `gd_reason`.
                        result_param2: reasons.0 as i32,
                        target_system: to.system,
                        target_component: to.component,
                        ..CommandAck::default()
                    };
                    self.sender.ack(out, to.link, &ack);
                }
                Reply::Time(link, (message_id, payload)) => self.sender.payload(out, *link, *message_id, payload),
                Reply::Parameter(link, index) => {
                    if let Some((message_id, payload)) = self.parameters.told(*index, self.vehicle.flavour()) {
                        self.sender.payload(out, *link, message_id, &payload);
                    }
                }
                Reply::NoSuchParameter(to, name, index) => {
                    let error = report::no_such_parameter((to.system, to.component), *name, *index);
                    self.sender.message(out, to.link, &error);
                }
            }
        }
        if let Some((distance_m, limit_m)) = self.goal_refused.take() {
            self.tell(out, &report::goal_text(distance_m, limit_m));
        }
        if let Some((index, refusal)) = self.parameter_refused.take() {
            self.tell(
                out,
                &report::parameter_text(self.parameters.name(index), refusal.name()),
            );
        }
    }

    fn emit_commands(&mut self, report: &StepReport, request: VehicleRequest, out: &mut Datagrams) {
        let now_ns = report.now_ns;
        if let (VehicleRequest::None, true, Some(unfinished)) = (
            request,
            report.reasons.contains(Reason::HandoverFailed),
            self.handover.unfinished(),
        ) {
            self.tell(out, &report::overdue_text(unfinished));
        }
        let action = self.handover.step(now_ns, request, self.streaming, &self.vehicle);
        let Some(system) = self.system_id else { return };
        if let Some((number, params, confirmation)) = action.send {
            let command = Command::to_autopilot(system, number, params, confirmation);
            self.sender.command(out, self.config.link, &command);
        }
        if let Some(trouble) = action.trouble {
            self.tell(out, &report::trouble_text(trouble, self.vehicle.flavour()));
        }
        self.check_setpoint_timeout(now_ns, system, request, out);
        match self.streams.step(now_ns, &self.vehicle) {
            Some(Ask::Command(number, params)) => {
                let command = Command::to_autopilot(system, number, params, 0);
                self.sender.command(out, self.config.link, &command);
            }
            Some(Ask::DataStream { stream, rate_hz }) => {
                let (message_id, payload) = Ask::data_stream(system, stream, rate_hz);
                self.sender.payload(out, self.config.link, message_id, &payload);
            }
            None => {}
        }
        if let Some(slow) = self.streams.take_slow() {
            self.tell(out, &report::slow_text(&slow));
        }
    }

    fn check_setpoint_timeout(&mut self, now_ns: Nanos, system: u8, request: VehicleRequest, out: &mut Datagrams) {
        let taking = matches!(request, VehicleRequest::FlyExternal { .. }) && !self.vehicle.is_other_autopilot();
        match self.setpoint_timeout.step(now_ns, taking, self.vehicle.flavour()) {
            Next::Nothing => {}
            Next::Read => {
                let message = self.setpoint_timeout.read(system);
                self.say(out, &message);
            }
            Next::Set(value_s) => {
                let message = self.setpoint_timeout.set(system, value_s);
                self.say(out, &message);
            }
            Next::Tell(finding) => {
                let name = self.setpoint_timeout.name();
                self.tell(out, &report::setpoint_timeout_text(name, finding));
            }
        }
    }

    /// What a person should know of vehicle and inputs.
    fn emit_warnings(&mut self, report: &StepReport, out: &mut Datagrams) {
        let now_ns = report.now_ns;
        if let (true, false, Some(system)) = (self.vehicle_heard, self.vehicle_named, self.system_id) {
            self.vehicle_named = true;
            self.tell(out, &report::vehicle_text(system, &self.vehicle));
        }
        if let (true, Some(named)) = (self.vehicle.is_other_autopilot(), self.vehicle.named) {
            let is_due = self
                .wrong_vehicle_ns
                .is_none_or(|told_ns| now_ns.saturating_sub(told_ns) >= WRONG_VEHICLE_NS);
            if is_due {
                self.wrong_vehicle_ns = Some(now_ns);
                self.tell(out, &report::wrong_vehicle_text(named, self.vehicle.flavour()));
            }
        }
        if let Some(home_ned_m) = self.vehicle.home_ned_m()
            && (home_ned_m - self.home_said_m).norm() > HOME_MOVED_M
        {
            self.home_said_m = home_ned_m;
            self.tell(out, &report::home_text(home_ned_m));
        }
        for missing in self.missing.due(report).iter().flatten() {
            self.tell_now(out, &inputs::text(missing));
        }
    }

    fn emit_status(&mut self, report: &StepReport, out: &mut Datagrams) {
        let now = (report.state, report.reasons);
        let before = self.said.replace(now);
        let (state_before, reasons_before) = (before.map(|b| b.0), before.map_or(Reasons::NONE, |b| b.1));
        let due = self.values.is_due(report.now_ns);
        if due || before != Some(now) {
            for message in report::state_values(report, reasons_before) {
                self.say(out, &message);
            }
        }
        let interval_ns = self.streams.flight_interval_ns();
        if due {
            for message in report::values(report, self.counters.bad_packets(), interval_ns) {
                self.say(out, &message);
            }
        }
        if state_before != Some(report.state) {
            self.tell(out, &report::state_text(report.state, report.reasons));
            if report.state == GuidanceState::Engaging && self.vehicle.home_ned_m().is_none() {
                self.tell(out, &report::no_home_text());
            }
        } else if self.newcomer {
            self.say_text(out, &report::state_text(report.state, report.reasons));
        }
        self.newcomer = false;
        let begins = |reason| report.reasons.contains(reason) && !reasons_before.contains(reason);
        if let (true, Some(interval_ns)) = (begins(Reason::SlowTelemetry), interval_ns) {
            self.tell(out, &report::slow_telemetry_text(interval_ns));
        }
        // Not before the vehicle is known to be ready otherwise: then it is what is waited for.
        let waits = report.state == GuidanceState::Ready && report.reasons.contains(Reason::PilotInCommand);
        if waits && !core::mem::replace(&mut self.pilot_said, waits) {
            self.tell(out, &report::pilot_in_command_text(self.vehicle.flavour()));
        }
        self.pilot_said = waits;
        let verdict = report.judgement.map(|j| j.verdict);
        if due | (core::mem::replace(&mut self.said_verdict, verdict) != verdict) {
            for message in report::judgement_values(report) {
                self.say(out, &message);
            }
        }
        if core::mem::replace(&mut self.said_alarm, report.alarm) != report.alarm {
            self.tell(out, &report::alarm_text(report.alarm));
        }
    }

    /// Tells what the pilot sees, four times a second, as [`ObstacleReports`] says: for each sector its bearing (radians,
    /// positive to the right) and its distance (metres, infinite where nothing was seen). Call it in every step; `sectors`
    /// is `None` in a step in which the pilot did not look.
    pub fn emit_obstacles(
        &mut self,
        now_ns: Nanos,
        sectors: Option<impl Iterator<Item = (f32, f32)>>,
        out: &mut Datagrams,
    ) {
        let seen = sectors.filter(|_| self.vehicle.telemetry.is_airborne());
        let tells = match self.config.obstacles {
            ObstacleReports::Off => false,
            ObstacleReports::Flight => seen.is_some(),
            ObstacleReports::KeepAlive => self.vehicle_heard,
        };
        if tells && self.obstacles.is_due(now_ns) {
            let message = match seen {
                Some(sectors) => obstacles::message(now_ns, sectors),
                None => obstacles::blank(now_ns),
            };
            self.say(out, &message);
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
        self.told.clear();
        self.tell(out, &report::shutdown_text());
    }
}
