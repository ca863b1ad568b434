//! The endpoint: datagrams and the vehicle's view in, datagrams and a command for the controllers out.

use crate::core::{ComponentId, Core, EndpointStatus, SigningSetup, ZoneRanges};
use crate::service::{Refusal, Service, Source, acknowledge};
use crate::streams::Streams;
use crate::vehicle::{ControlCommand, HoldLaw, Truth, VehicleView};
use crate::{ConfigError, EndpointConfig, LinkId, services, used_parameters};
use vigil_mavlink::Allowance;
use vigil_mavlink::framing::{self, Command, Packet};
use vigil_mavlink::routing::{LinkSet, MAX_LINKS, Routing};
use vigil_mavlink::signing::carries_key;
use vigil_types::{Nanos, STEP_NS};

/// A PX4-flavoured MAVLink vehicle, sans IO.
///
/// Call [`Endpoint::receive_from`] for every datagram that came, [`Endpoint::step`] once per millisecond of simulated
/// time, and [`Endpoint::transmit`] whenever datagrams can go out (at least once per 50 ms step).
pub struct Endpoint {
    pub(crate) core: Core,
    services: Vec<Box<dyn Service + Send>>,
    streams: Streams,
    routing: Routing,
    /// Earliest time at which a service or stream wants to run.
    due_ns: Nanos,
    /// Packets of each link that were passed on.
    passed_on: [Allowance; MAX_LINKS],
}

/// Packets of one link that are passed on in 50 ms: a file transfer's burst. What is beyond is counted.
const PASSED_ON_PER_STEP: u32 = 64;

impl core::fmt::Debug for Endpoint {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Endpoint")
            .field("status", &self.status())
            .finish_non_exhaustive()
    }
}

/// Parameters, missions and commands, which count only where they name the system, as in PX4: a 0 there is a script that has not
/// heard the vehicle yet.
fn needs_address(message_id: u32) -> bool {
    matches!(message_id, 20 | 21 | 23 | 37..=47 | 51 | 73 | 75 | 76)
}

impl Endpoint {
    /// A vehicle on the ground, disarmed, in Hold.
    ///
    /// # Errors
    /// [`ConfigError`] names the field and what it may be.
    pub fn new(config: EndpointConfig) -> Result<Self, ConfigError> {
        let mut core = Core::new(&config)?;
        let mut services = services::all();
        for service in &mut services {
            service.start(&mut core);
        }
        let streams = Streams::new(&config.links, &services);
        Ok(Self {
            core,
            services,
            streams,
            routing: Routing::default(),
            due_ns: 0,
            passed_on: [Allowance::default(); MAX_LINKS],
        })
    }

    /// From now on its hold is of this kind; at first it stops and holds where it stopped.
    pub fn set_hold_law(&mut self, law: HoldLaw) {
        self.core.hold_law = law;
    }

    /// Takes one datagram that came on `link`. Whatever it holds, it is obeyed, passed on or counted; never a panic.
    /// A link that the configuration does not have is ignored. On a link with several ends `peer` is another number for
    /// another end, else 0: ownership is of one of them.
    pub fn receive_from(&mut self, now_ns: Nanos, link: LinkId, peer: u64, datagram: &[u8]) {
        if usize::from(link.0) >= self.core.outbox.links() {
            return;
        }
        self.core.now_ns = self.core.now_ns.max(now_ns);
        let mut counters = self.core.framing;
        let before = counters.packets;
        for packet in framing::packets(datagram, &mut counters) {
            self.packet(link, peer, &packet);
        }
        if let Some(received) = self.core.received.get_mut(usize::from(link.0)) {
            received.packets += counters.packets - before;
            received.bytes += datagram.len() as u64;
        }
        self.core.framing = counters;
        self.streams.send_wanted(&mut self.core, &self.services);
        self.due_ns = self.next_due_ns();
    }

    fn packet(&mut self, link: LinkId, peer: u64, packet: &Packet<'_>) {
        let id = ComponentId {
            system: packet.system_id(),
            component: packet.component_id(),
        };
        let own = self.core.id();
        if id == own {
            self.core.refusals.own_identity += 1;
            return;
        }
        // The checksum of an unknown message cannot be verified: it is passed on, but teaches nothing.
        if packet.is_known() {
            self.routing.note(self.core.now_ns, id, link.0);
        }
        let target = packet.target();
        // A signing key is nobody else's business.
        let onward = self.routing.onward(own, target, link.0, self.core.outbox.links());
        let onward = if carries_key(packet) { LinkSet::NONE } else { onward };
        if !onward.is_empty() && !self.may_pass_on(link) {
            self.core.refusals.crowded_out += 1;
        } else {
            for to in onward.iter() {
                self.core.outbox.push(to, packet.raw());
            }
        }
        let for_us = target.is_none_or(|(system, component)| {
            (system == 0 && !needs_address(packet.message_id()))
                || (system == own.system && (component == 0 || component == own.component))
        });
        if !for_us || !packet.is_known() {
            return;
        }
        let source = Source { link, peer, id };
        if let Some(command) = packet.command() {
            self.command(&command, source);
        } else {
            for service in &mut self.services {
                service.receive(packet, source, &mut self.core);
            }
        }
    }

    /// Whether another packet of a link may be passed on: a flood on one link must not become one on the others.
    fn may_pass_on(&mut self, link: LinkId) -> bool {
        let passed_on = self.passed_on.get_mut(usize::from(link.0));
        passed_on.is_some_and(|passed_on| passed_on.takes(self.core.now_ns, STEP_NS, PASSED_ON_PER_STEP))
    }

    fn command(&mut self, command: &Command, source: Source) {
        let (core, number) = (&mut self.core, command.number);
        let answer = match self.services.iter_mut().find(|s| s.serves(number)) {
            None => self.streams.command(command, source, core, &self.services),
            Some(server) => match used_parameters::misused_in_command(command) {
                None => server.command(command, source, core),
                Some(parameter) => {
                    let text = format!("command {number} denied: parameter {parameter} has no meaning");
                    Err(Refusal::DENIED.saying(text))
                }
            },
        };
        acknowledge(answer, number, source, core);
    }

    fn next_due_ns(&self) -> Nanos {
        self.services
            .iter()
            .fold(self.streams.due_ns, |due, service| due.min(service.due_ns()))
    }

    /// Advances to `now_ns` and gives the command for the vehicle's controllers until the next call.
    pub fn step(&mut self, now_ns: Nanos, view: &VehicleView) -> ControlCommand {
        let core = &mut self.core;
        core.now_ns = core.now_ns.max(now_ns);
        core.boot_ns.get_or_insert(now_ns);
        core.view = *view;
        let command = core.fly();
        if self.due_ns <= now_ns {
            for service in &mut self.services {
                if service.due_ns() <= now_ns {
                    service.step(&mut self.core);
                }
            }
            self.streams.step(&mut self.core, &self.services);
            self.due_ns = self.next_due_ns();
        }
        self.streams.send_wanted(&mut self.core, &self.services);
        command
    }

    /// Takes the simulator's truth for HIL_STATE_QUATERNION, which clients know as ground truth. Nothing else looks at it,
    /// and no onboard link gets it.
    pub fn observe_truth(&mut self, truth: &Truth) {
        self.core.truth = Some(*truth);
    }

    /// Takes what the second sensor measured.
    pub fn observe_ranges(&mut self, ranges: ZoneRanges) {
        self.core.ranges = Some(ranges);
    }

    /// Hands out the datagrams that wait, in order, with whether each is of a stream other than the heartbeat: on a slow
    /// link it gives way to all others.
    pub fn transmit(&mut self, send: impl FnMut(LinkId, bool, &[u8])) {
        self.core.outbox.drain(send);
    }

    /// The signing key that SETUP_SIGNING brought since the last call, for the owner of the links.
    pub fn take_signing_setup(&mut self) -> Option<SigningSetup> {
        self.core.signing_setup.take()
    }

    /// The vehicle hit something: says so, disarms, and refuses to arm and to take off until a reboot.
    pub fn break_down(&mut self) {
        self.core.break_down();
    }

    /// The simulation stood still for so long, by everybody else's clock: nothing of the vehicle's own time has passed, and its wall
    /// clock is set right.
    pub fn stood_still(&mut self, lasted_ns: Nanos) {
        self.core.unix_time_at_zero_us = self.core.unix_time_at_zero_us.saturating_add(lasted_ns / 1000);
        self.core
            .warn(&format!("simulator stood still for {:.1} s", lasted_ns as f64 * 1e-9));
    }

    /// Whether the autopilot was started anew since the last call: who simulates the vehicle then has it mended.
    pub fn take_reboot(&mut self) -> bool {
        std::mem::take(&mut self.core.rebooted)
    }

    /// Sends everybody something that the owner of the links knows.
    pub fn warn(&mut self, text: &str) {
        self.core.warn(text);
    }

    /// What is going on.
    pub fn status(&self) -> EndpointStatus {
        let core = &self.core;
        EndpointStatus {
            mode: core.commander.mode,
            armed: core.commander.armed,
            landed: core.commander.landed,
            failsafe: core.commander.failsafe,
            terminated: core.commander.terminated,
            setpoint_owner: core.setpoints.owner.map(|owner| owner.id),
            framing: core.framing,
            refusals: core.refusals,
            dropped: core.outbox.dropped,
        }
    }

    /// Arms and puts the vehicle into Hold in the air at `height_m` above home: for campaigns that begin in flight. The
    /// caller places the vehicle there; it holds where the next step finds it.
    pub fn start_airborne(&mut self, now_ns: Nanos, height_m: f32) {
        self.core.now_ns = self.core.now_ns.max(now_ns);
        self.core.start_airborne(height_m);
    }
}
