//! Asks the vehicle for the messages that guidance needs, and again when they come too rarely: a ground station may slow
//! them down for everybody on a link. PX4 streams them unprompted; an ArduPilot sends only what is asked for.
//! <https://mavlink.io/en/services/message_intervals.html>

use super::{Service, Step};
use crate::autopilot::{Flavour, command_number};
use crate::companion::CompanionConfig;
use crate::core::Core;
use crate::framing::{Command, Packet};
use crate::status_text::WARNING;
use crate::vehicle::Vehicle;
use mavlink::MessageData;
use mavlink::dialects::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, EXTENDED_SYS_STATE_DATA, GPS_GLOBAL_ORIGIN_DATA, HOME_POSITION_DATA,
    LOCAL_POSITION_NED_DATA, POSITION_TARGET_GLOBAL_INT_DATA, SYS_STATUS_DATA,
};
use vigil_types::{Datagrams, Nanos};

/// A message that guidance needs.
#[derive(Debug, Clone, Copy)]
struct Needed {
    id: u32,
    /// What says the same and counts for it.
    or: u32,
    name: &'static str,
    /// Wanted interval in microseconds.
    interval_us: f32,
    /// Longest mean interval that is borne.
    slow_ns: Nanos,
    /// ArduPilot's MAV_DATA_STREAM that has it, for versions that do not know intervals of single messages; 0 is none.
    stream: u8,
    /// Guidance cannot fly without it for longer than fractions of a second: that it is slow is reported.
    flies: bool,
    /// Only an ArduPilot is asked: a PX4 sends it when there is something to tell.
    of_ardupilot: bool,
}

/// Places in the table.
const POSITION: usize = 0;
const ATTITUDE: usize = 1;

/// A message with the interval that is wanted and the longest mean one that is borne, and the rest as most have it.
const fn needed<M: MessageData>(interval_us: f32, slow_ns: Nanos) -> Needed {
    Needed {
        id: M::ID,
        or: M::ID,
        name: M::NAME,
        interval_us,
        slow_ns,
        stream: 0,
        flies: false,
        of_ardupilot: false,
    }
}

const NEEDED: [Needed; 6] = [
    Needed {
        stream: 6,
        flies: true,
        ..needed::<LOCAL_POSITION_NED_DATA>(33_333.0, 100_000_000)
    },
    Needed {
        or: ATTITUDE_QUATERNION_DATA::ID,
        stream: 10,
        flies: true,
        ..needed::<ATTITUDE_DATA>(20_000.0, 100_000_000)
    },
    needed::<EXTENDED_SYS_STATE_DATA>(200_000.0, 1_200_000_000),
    Needed {
        stream: 2,
        ..needed::<SYS_STATUS_DATA>(1_000_000.0, 5_000_000_000)
    },
    Needed {
        of_ardupilot: true,
        ..needed::<HOME_POSITION_DATA>(1_000_000.0, 5_000_000_000)
    },
    // Outside of missions there is none.
    needed::<POSITION_TARGET_GLOBAL_INT_DATA>(500_000.0, 5_000_000_000),
];
/// Where local origin and home are; asked for by turns until both are known.
const PLACES: [u32; 2] = [GPS_GLOBAL_ORIGIN_DATA::ID, HOME_POSITION_DATA::ID];
const REQUEST_DATA_STREAM: u32 = 66;

/// Pause between two questions, so that they never come as a burst.
const PAUSE_NS: Nanos = 250_000_000;
/// A message that did not come for this long is asked for.
const MISSING_NS: Nanos = 3_000_000_000;
/// Without a heartbeat for this long there is nobody to ask.
const SILENT_NS: Nanos = 3_000_000_000;
/// Pause before the same is asked again: doubled each time up to the longest, and short again once the message came as it
/// should for [`GOOD_NS`].
const FIRST_PAUSE_NS: Nanos = 1_000_000_000;
const LONGEST_PAUSE_NS: Nanos = 32_000_000_000;
const GOOD_NS: Nanos = 5_000_000_000;
/// Arrivals that are remembered; the mean interval is that between them.
const ARRIVALS: usize = 5;

/// How one message comes.
#[derive(Debug, Clone, Copy, Default)]
struct Monitored {
    /// The last arrivals, newest first.
    arrivals_ns: [Option<Nanos>; ARRIVALS],
    /// Since when it is waited for.
    since_ns: Option<Nanos>,
    asked_ns: Option<Nanos>,
    /// Questions since it last came as it should.
    asked: u8,
    good_since_ns: Option<Nanos>,
}

impl Monitored {
    fn mean_interval_ns(&self) -> Option<Nanos> {
        let [newest, .., oldest] = self.arrivals_ns;
        Some(newest?.saturating_sub(oldest?) / (ARRIVALS as Nanos - 1))
    }

    fn is_slow(&self, needed: &Needed) -> bool {
        self.mean_interval_ns().is_some_and(|ns| ns > needed.slow_ns)
    }

    fn pause_ns(&self) -> Nanos {
        match self.asked {
            0 => 0,
            asked => (FIRST_PAUSE_NS << (asked - 1).min(5)).min(LONGEST_PAUSE_NS),
        }
    }

    fn note(&mut self, now_ns: Nanos, needed: &Needed) {
        self.arrivals_ns.rotate_right(1);
        if let Some(newest) = self.arrivals_ns.first_mut() {
            *newest = Some(now_ns);
        }
        if self.is_slow(needed) {
            self.good_since_ns = None;
        } else if now_ns.saturating_sub(*self.good_since_ns.get_or_insert(now_ns)) >= GOOD_NS {
            self.asked = 0;
        }
    }

    /// Whether it is to be asked for now.
    fn is_wanting(&self, now_ns: Nanos, needed: &Needed) -> bool {
        let last_ns = self.arrivals_ns.first().copied().flatten().or(self.since_ns);
        let missing = last_ns.is_some_and(|ns| now_ns.saturating_sub(ns) > MISSING_NS.max(needed.slow_ns));
        let waited = self
            .asked_ns
            .is_none_or(|ns| now_ns.saturating_sub(ns) >= self.pause_ns());
        (missing || self.is_slow(needed)) && waited
    }
}

#[derive(Debug, Clone, Default)]
pub(crate) struct StreamService {
    monitored: [Monitored; NEEDED.len()],
    asked_ns: Nanos,
    restarts: u32,
    places_asked: u8,
    flavour: Flavour,
    guards: bool,
    /// A message that comes too rarely, to be reported: name, rate and wanted rate, hertz.
    slow: Option<(&'static str, f32, f32)>,
}

impl StreamService {
    /// Mean time between the last positions or attitudes, whichever is longer.
    fn flight_interval_ns(&self) -> Option<Nanos> {
        let of = |place: usize| self.monitored.get(place)?.mean_interval_ns();
        Some(of(POSITION)?.max(of(ATTITUDE)?))
    }

    /// Asks for at most one message in a step.
    fn ask(&mut self, core: &mut Core, now_ns: Nanos, system: u8, out: &mut Datagrams) {
        let vehicle = &core.vehicle;
        let heard = vehicle
            .telemetry
            .heartbeat
            .is_some_and(|h| now_ns.saturating_sub(h.at_ns) < SILENT_NS);
        if self.restarts != vehicle.restarts || self.flavour != vehicle.flavour() {
            *self = Self {
                restarts: vehicle.restarts,
                flavour: vehicle.flavour(),
                guards: self.guards,
                ..Self::default()
            };
        }
        if !heard || vehicle.is_other_autopilot() || now_ns.saturating_sub(self.asked_ns) < PAUSE_NS {
            return;
        }
        for (needed, monitored) in NEEDED.iter().zip(&mut self.monitored) {
            let is_place = needed.id == POSITION_TARGET_GLOBAL_INT_DATA::ID;
            if is_place && !self.guards || needed.of_ardupilot && self.flavour != Flavour::ArduPilot {
                continue;
            }
            monitored.since_ns.get_or_insert(now_ns);
            // An ArduPilot sends it too slowly unless asked; the mission's place is wanted only by who flies around something.
            let is_new = (is_place || self.flavour == Flavour::ArduPilot) && monitored.asked_ns.is_none();
            if !is_new && !monitored.is_wanting(now_ns, needed) {
                continue;
            }
            let wanted_hz = 1e6 / needed.interval_us;
            let is_said = !is_new && needed.flies && monitored.is_slow(needed);
            if let Some(interval_ns) = monitored.mean_interval_ns().filter(|_| is_said) {
                self.slow = Some((needed.name, 1e9 / interval_ns as f32, wanted_hz));
            }
            // Every third time in the old way, where there is one.
            let old_way = monitored.asked % 3 == 2 && needed.stream != 0 && self.flavour == Flavour::ArduPilot;
            monitored.asked = monitored.asked.saturating_add(1);
            monitored.asked_ns = Some(now_ns);
            self.asked_ns = now_ns;
            if old_way {
                // 50 at most.
                let [low, high] = (libm::roundf(wanted_hz) as u16).to_le_bytes();
                let (link, payload) = (core.config.link, [low, high, system, 1, needed.stream, 1]);
                core.sender.payload(out, link, REQUEST_DATA_STREAM, &payload);
            } else {
                let used = [(1, needed.id as f32), (2, needed.interval_us), (7, 0.0)];
                let params = self.flavour.params(&used);
                let command = Command::to_autopilot(system, command_number::SET_MESSAGE_INTERVAL, params, 0);
                core.command(out, &command);
            }
            return;
        }
        if let Some(id) = self.place_to_ask_for(now_ns, vehicle) {
            let params = self.flavour.params(&[(1, id as f32), (7, 0.0)]);
            let command = Command::to_autopilot(system, command_number::REQUEST_MESSAGE, params, 0);
            core.command(out, &command);
        }
    }

    fn place_to_ask_for(&mut self, now_ns: Nanos, vehicle: &Vehicle) -> Option<u32> {
        let known = [vehicle.is_origin_known(), vehicle.home_ned_m().is_some()];
        // Each at once, again after 3 s, then less and less often: a vehicle without GPS has neither.
        let pause_ns = match self.places_asked {
            0 | 1 => PAUSE_NS,
            asked => MISSING_NS << (asked / 4).min(4),
        };
        if known == [true; 2] || now_ns.saturating_sub(self.asked_ns) <= pause_ns {
            return None;
        }
        let by_turns = PLACES
            .iter()
            .zip(known)
            .cycle()
            .skip(usize::from(self.places_asked) % 2);
        let (id, _) = by_turns.take(2).find(|(_, known)| !known)?;
        self.places_asked = self.places_asked.checked_add(1).unwrap_or(64);
        self.asked_ns = now_ns;
        Some(*id)
    }
}

impl Service for StreamService {
    fn new(config: &CompanionConfig) -> Self {
        Self {
            guards: config.guards,
            ..Self::default()
        }
    }

    fn hear_vehicle(&mut self, core: &mut Core, now_ns: Nanos, packet: &Packet<'_>) {
        for (needed, monitored) in NEEDED.iter().zip(&mut self.monitored) {
            if [needed.id, needed.or].contains(&packet.message_id()) {
                monitored.note(now_ns, needed);
            }
        }
        core.telemetry_interval_ns = self.flight_interval_ns();
    }

    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let Some(system) = core.system_id else { return };
        self.ask(core, step.report.now_ns, system, out);
        core.telemetry_interval_ns = self.flight_interval_ns();
        if let Some((name, rate_hz, wanted_hz)) = self.slow.take() {
            core.counters.slow_streams += 1;
            let text = format_args!("slow: {name} at {rate_hz:.1} Hz, asked for {wanted_hz:.0} Hz");
            core.tell(out, WARNING, text);
        }
    }
}
