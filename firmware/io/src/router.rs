//! Several links of the guidance computer: one to the vehicle, others for ground stations, and what passes between them.
//!
//! The first link is the vehicle's. What a packet's sender says counts, and where the packet goes is decided, by the
//! [MAVLink routing rules](https://mavlink.io/en/guide/routing.html), with three additions:
//!
//! - Nobody on a ground link is taken for the vehicle's autopilot, and nobody at all for the guidance computer.
//! - No link can use up what another needs: each is read into room of its own, packets are passed on in turn, the guidance
//!   computer's own packets go first, and the flight stack gets a few packets of each ground link per step.
//! - A signing key is passed on to nobody. One for the guidance computer that passed the gate is put into force here, before
//!   the flight stack and its log could see it.

use crate::Link;
use crate::gate::{AllowUnsigned, SigningGate};
use crate::link_spec::{Budget, LinkSpec};
use crate::links::{
    LinkAdmission, LinkError, LinkStatistics, MAX_GROUND_LINKS, PeerRule, Wire, open_wire, somebody_is_heard,
};
use crate::value_rate::ValueRate;
use vigil_mavlink::common::{HEARTBEAT_DATA, MavSeverity};
use vigil_mavlink::framing::{AUTOPILOT, FramingCounters, MAX_PACKET_LEN, Packet, packets, renumber};
use vigil_mavlink::mavlink::MessageData;
use vigil_mavlink::routing::{ComponentId, LinkSet, MAX_LINKS, Routing};
use vigil_mavlink::signing::{SIGNATURE_LEN, SigningKey, Timestamp, carries_key};
use vigil_mavlink::{MavMessage, Sender, message};
use vigil_types::{Datagrams, Nanos};

/// The vehicle's link.
const VEHICLE: u8 = 0;
/// Packets that a ground link may give to the flight stack in one step; a flood's others are dropped.
const PACKETS_PER_STEP: usize = 8;
/// What the vehicle's link leaves for the ground links of the flight stack's datagrams in one step.
const GROUND_COUNT: usize = MAX_GROUND_LINKS * PACKETS_PER_STEP;
const GROUND_BYTES: usize = GROUND_COUNT * 280;
/// A burst of packets that are passed on leaves room in a slow line's queue of 8 KiB for the guidance computer's own.
const BURST_BYTES: f64 = 4096.0;
/// The share of a burst that is kept for them.
const OWN_SHARE: f64 = 0.25;

/// What became of packets between links, since start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RoutingCounters {
    /// Packets passed on, once for each link that they went to.
    pub forwarded: u64,
    /// Packets that a link's rate or room did not allow.
    pub over_rate: u64,
    /// Packets whose sender claimed to be the vehicle or the guidance computer.
    pub impostors: u64,
    /// Packets for the flight stack beyond a link's share of a step.
    pub crowded_out: u64,
}

struct Port {
    wire: Box<dyn Wire>,
    allow_unsigned: AllowUnsigned,
    budget: Option<Budget>,
    /// How often values are sent here.
    values: ValueRate,
    /// Of the guidance computer's packets on this link.
    sequence: u8,
    /// The guidance computer's packets of this step.
    own: Datagrams,
    /// What is passed on in this step.
    onward: Datagrams,
    /// Packets given to the flight stack in this step.
    given: usize,
}

impl Port {
    fn open(spec: &LinkSpec, is_vehicle: bool, gate: &SigningGate) -> Result<Self, LinkError> {
        let allow_unsigned = spec.allow_unsigned.unwrap_or(gate.allow_unsigned());
        somebody_is_heard(&spec.url, gate.has_key(), allow_unsigned)?;
        let rule = match is_vehicle {
            true => PeerRule::Vehicle { system: spec.system },
            false => PeerRule::Anyone,
        };
        let mut values = ValueRate::new(spec.values_per_s());
        values.spares_obstacles = is_vehicle && spec.values_hz.is_none();
        Ok(Self {
            wire: open_wire(&spec.url, rule)?,
            allow_unsigned,
            budget: Budget::of(spec, BURST_BYTES),
            values,
            sequence: 0,
            own: Datagrams::default(),
            onward: Datagrams::default(),
            given: 0,
        })
    }
}

/// Everything but the gate and what was received, which are looked at while this is changed.
struct Switch {
    ports: Vec<Port>,
    routing: Routing,
    /// The guidance computer, as it last called itself.
    own: ComponentId,
    counters: RoutingCounters,
    now_ns: Nanos,
    signature_len: usize,
    /// The newest SETUP_SIGNING for the guidance computer: key and timestamp.
    setup: Option<([u8; 32], Timestamp)>,
}

impl Switch {
    /// Whether a sender is who it may be on that link.
    fn is_genuine(&self, packet: &Packet<'_>, from: u8) -> bool {
        let id = id_of(packet);
        let is_autopilot = id.system == self.own.system && id.component == AUTOPILOT;
        id != self.own && (from == VEHICLE || !is_autopilot)
    }

    /// Passes a packet on, and gives it to the flight stack if it came from a ground station and is for it.
    fn route(&mut self, packet: &Packet<'_>, from: u8, received: &mut Datagrams) {
        if !self.is_genuine(packet, from) {
            self.counters.impostors += 1;
            return;
        }
        // The checksum of an unknown message cannot be verified: it is passed on, but teaches nothing.
        if packet.is_known() {
            self.routing.note(self.now_ns, id_of(packet), from);
        }
        if carries_key(packet) {
            self.set_up(packet);
            return;
        }
        let target = packet.target();
        let onward = self.routing.onward(self.own, target, from, self.ports.len());
        for to in onward.iter() {
            self.forward(to, packet.raw());
        }
        let for_own = target.is_some_and(|(system, component)| {
            system == 0 || system == self.own.system && (component == 0 || component == self.own.component)
        });
        if from != VEHICLE && for_own {
            self.give(packet.raw(), from, received);
        }
    }

    /// To everybody or to another component it is ignored: a key is given to one.
    fn set_up(&mut self, packet: &Packet<'_>) {
        if packet.target() == Some((self.own.system, self.own.component))
            && let Ok(MavMessage::SETUP_SIGNING(m)) = packet.message()
        {
            self.setup = Some((m.secret_key, m.initial_timestamp));
        }
    }

    fn give(&mut self, packet: &[u8], from: u8, received: &mut Datagrams) {
        let Some(port) = self.ports.get_mut(usize::from(from)) else {
            return;
        };
        if port.given < PACKETS_PER_STEP && received.push(from, packet) {
            port.given += 1;
        } else {
            self.counters.crowded_out += 1;
        }
    }

    fn forward(&mut self, to: u8, packet: &[u8]) {
        let Some(port) = self.ports.get_mut(usize::from(to)) else {
            return;
        };
        let len = packet.len() + self.signature_len;
        let allowed = match &mut port.budget {
            Some(budget) => budget.spend(self.now_ns, len, OWN_SHARE),
            None => true,
        };
        if allowed && port.onward.push(to, packet) {
            self.counters.forwarded += 1;
        } else {
            self.counters.over_rate += 1;
        }
    }

    /// Puts a packet of the guidance computer's own to the links that it goes to: those of its target, else `link`.
    fn say(&mut self, link: u8, packet: &[u8]) {
        let Some(parsed) = packets(packet, &mut FramingCounters::default()).next() else {
            return;
        };
        let own = id_of(&parsed);
        if own.system != self.own.system {
            // Before the vehicle was heard, somebody on a ground link may have claimed to be it.
            let component = AUTOPILOT;
            self.routing.keep_only_on(VEHICLE, ComponentId { component, ..own });
        }
        self.own = own;
        let known = self.routing.toward(parsed.target(), self.ports.len());
        let links = if known.is_empty() { LinkSet::only(link) } else { known };
        let len = packet.len() + self.signature_len;
        for (number, port) in (0..).zip(&mut self.ports) {
            if !links.contains(number) || !port.values.passes(self.now_ns, &parsed) {
                continue;
            }
            let allowed = match &mut port.budget {
                // Setpoints go whatever the line says: the others give way.
                Some(budget) if number == VEHICLE => {
                    budget.charge(self.now_ns, len);
                    true
                }
                Some(budget) => budget.spend(self.now_ns, len, 0.0),
                None => true,
            };
            let mut buffer = [0; MAX_PACKET_LEN];
            if let (true, Some(own)) = (allowed, buffer.get_mut(..packet.len())) {
                own.copy_from_slice(packet);
                renumber(own, port.sequence);
                port.sequence = port.sequence.wrapping_add(1);
                port.own.push(number, own);
            } else {
                port.values.forget(&parsed);
                self.counters.over_rate += 1;
            }
        }
    }
}

fn id_of(packet: &Packet<'_>) -> ComponentId {
    ComponentId {
        system: packet.system_id(),
        component: packet.component_id(),
    }
}

/// The vehicle's link and those for ground stations, behind one port of the flight stack.
pub struct RoutedLinks {
    switch: Switch,
    gate: SigningGate,
    inboxes: Vec<Datagrams>,
    /// What is to be sent to everybody in this step.
    text: Option<&'static str>,
}

impl RoutedLinks {
    /// Opens the vehicle's link and those for ground stations, at most [`MAX_GROUND_LINKS`]. All share one gate, so that
    /// a packet taken from one cannot be replayed on another.
    ///
    /// # Errors
    /// [`LinkError`], each naming the link and what to do.
    pub fn open(vehicle: &LinkSpec, ground: &[LinkSpec], gate: SigningGate) -> Result<Self, LinkError> {
        if ground.len() > MAX_GROUND_LINKS {
            return Err(LinkError::TooMany { count: ground.len() });
        }
        if let Some(spec) = ground.iter().find(|spec| spec.system.is_some()) {
            return Err(LinkError::NotTheVehicles { url: spec.url.clone() });
        }
        let mut ports = vec![Port::open(vehicle, true, &gate)?];
        for spec in ground {
            ports.push(Port::open(spec, false, &gate)?);
        }
        Ok(Self {
            inboxes: vec![Datagrams::default(); ports.len()],
            switch: Switch {
                ports,
                routing: Routing::default(),
                own: ComponentId {
                    system: 1,
                    component: 191,
                },
                counters: RoutingCounters::default(),
                now_ns: 0,
                signature_len: 0,
                setup: None,
            },
            text: None,
            gate,
        })
    }

    /// What the vehicle's link did not take or could not deliver, and what signing accepted and refused on all links.
    pub fn statistics(&self) -> LinkStatistics {
        let of_vehicle = self.switch.ports.first().map(|p| p.wire.statistics());
        self.gate.statistics(of_vehicle.unwrap_or_default())
    }

    /// What became of packets between links.
    pub fn routing(&self) -> RoutingCounters {
        self.switch.counters
    }

    fn say_text(&mut self, text: &str) {
        let severity = MavSeverity::MAV_SEVERITY_NOTICE;
        let message = message!(STATUSTEXT, severity, text = text.into());
        let (own, mut said) = (self.switch.own, Datagrams::default());
        Sender::new(own.system, own.component).message(&mut said, VEHICLE, &message);
        for (link, packet) in said.iter() {
            self.switch.say(link, packet);
        }
    }
}

impl Link for RoutedLinks {
    fn receive(&mut self, now_ns: Nanos, received: &mut Datagrams) {
        let Self {
            switch, gate, inboxes, ..
        } = self;
        gate.begin(now_ns);
        switch.now_ns = now_ns;
        switch.signature_len = if gate.has_key() { SIGNATURE_LEN } else { 0 };
        for ((link, port), inbox) in (0..).zip(&mut switch.ports).zip(inboxes.iter_mut()) {
            port.given = 0;
            inbox.clear();
            let mut admission = LinkAdmission {
                allow_unsigned: port.allow_unsigned,
                gate,
                link,
            };
            port.wire.receive(now_ns, &mut admission, inbox);
        }
        for (_, datagram) in inboxes.first().iter().flat_map(|inbox| inbox.iter()) {
            give_of_vehicle(switch, datagram, received);
        }
        route_in_turn(switch, inboxes, received);
        self.text = self.gate.refused_key(now_ns).or(self.text);
        if let Some((key, timestamp)) = self.switch.setup.take() {
            self.text = Some(match self.gate.set_key(SigningKey(key), timestamp) {
                true => "signing key accepted",
                false => "signing key refused: all zeros",
            });
        }
    }

    fn send(&mut self, sent: &Datagrams) {
        for (link, packet) in sent.iter() {
            self.switch.say(link, packet);
        }
        if let Some(text) = self.text.take() {
            self.say_text(text);
        }
        for port in &mut self.switch.ports {
            port.wire.send(&mut self.gate, &port.own);
            port.wire.send(&mut self.gate, &port.onward);
            port.own.clear();
            port.onward.clear();
        }
    }
}

/// Gives the flight stack a datagram of the vehicle's link as it is, damage included, which it counts; without what is
/// none of its business.
fn give_of_vehicle(switch: &mut Switch, datagram: &[u8], received: &mut Datagrams) {
    let mut give = |bytes: &[u8]| {
        let leaves_room =
            received.len() < Datagrams::MAX_COUNT - GROUND_COUNT && received.free_bytes() >= GROUND_BYTES + bytes.len();
        if !(leaves_room && received.push(VEHICLE, bytes)) {
            switch.counters.crowded_out += 1;
        }
    };
    let own = switch.own;
    // The heartbeat of a second guidance computer passes: a person must be warned of it.
    let is_anothers = |packet: &Packet<'_>| id_of(packet) != own || packet.message_id() == HEARTBEAT_DATA::ID;
    let may_pass = |packet: &Packet<'_>| is_anothers(packet) && !carries_key(packet);
    let mut framing = FramingCounters::default();
    if packets(datagram, &mut framing).all(|packet| may_pass(&packet)) {
        give(datagram);
        return;
    }
    for packet in packets(datagram, &mut framing).filter(may_pass) {
        give(packet.raw());
    }
}

/// Routes what came on all links.
fn route_in_turn(switch: &mut Switch, inboxes: &[Datagrams], received: &mut Datagrams) {
    // In turn, a datagram of each link at a time: who sends much waits for himself only.
    let mut heads: [_; MAX_LINKS] = core::array::from_fn(|link| inboxes.get(link).map(|inbox| inbox.iter()));
    loop {
        let mut all_read = true;
        for (link, head) in (0..).zip(&mut heads) {
            if let Some((_, datagram)) = head.as_mut().and_then(Iterator::next) {
                all_read = false;
                for packet in packets(datagram, &mut FramingCounters::default()) {
                    switch.route(&packet, link, received);
                }
            }
        }
        if all_read {
            break;
        }
    }
}
