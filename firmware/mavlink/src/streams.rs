//! Asks the vehicle for the messages that guidance needs. PX4 streams them unprompted; an ArduPilot sends only what is
//! asked for. <https://mavlink.io/en/services/message_intervals.html>

use crate::autopilot::{Flavour, command_number};
use crate::vehicle::Vehicle;
use mavlink::MessageData;
use mavlink::dialects::common::{
    ATTITUDE_DATA, EXTENDED_SYS_STATE_DATA, GPS_GLOBAL_ORIGIN_DATA, HOME_POSITION_DATA, LOCAL_POSITION_NED_DATA,
    SYS_STATUS_DATA,
};
use vigil_types::Nanos;

/// Message and wanted interval in microseconds.
const NEEDED: [(u32, f32); 4] = [
    (LOCAL_POSITION_NED_DATA::ID, 33_333.0),
    (ATTITUDE_DATA::ID, 20_000.0),
    (EXTENDED_SYS_STATE_DATA::ID, 200_000.0),
    (SYS_STATUS_DATA::ID, 1_000_000.0),
];
/// Where the local origin is; asked for once at a time until it is known.
const PLACES: [u32; 2] = [GPS_GLOBAL_ORIGIN_DATA::ID, HOME_POSITION_DATA::ID];

/// Pause between two questions, so that they never come as a burst.
const PAUSE_NS: Nanos = 250_000_000;
/// A message that did not come for this long is asked for again.
const MISSING_NS: Nanos = 3_000_000_000;
/// Without a heartbeat for this long there is nobody to ask.
const SILENT_NS: Nanos = 3_000_000_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Streams {
    /// Of each needed message: when it came last, or was last asked for.
    seen_ns: [Option<Nanos>; NEEDED.len()],
    /// Of each needed message: an ArduPilot sends it too slowly unless asked.
    ask: [bool; NEEDED.len()],
    asked_ns: Nanos,
    restarts: u32,
    next_place: usize,
    flavour: Flavour,
}

impl Streams {
    pub fn new(flavour: Flavour) -> Self {
        Self {
            seen_ns: [None; NEEDED.len()],
            ask: [flavour == Flavour::ArduPilot; NEEDED.len()],
            asked_ns: 0,
            restarts: 0,
            next_place: 0,
            flavour,
        }
    }

    pub fn note(&mut self, now_ns: Nanos, message_id: u32) {
        for ((id, _), seen_ns) in NEEDED.iter().zip(&mut self.seen_ns) {
            if *id == message_id {
                *seen_ns = Some(now_ns);
            }
        }
    }

    /// A command to send in this step: number and parameters.
    pub fn step(&mut self, now_ns: Nanos, vehicle: &Vehicle) -> Option<(u16, [f32; 7])> {
        let heard = vehicle
            .telemetry
            .heartbeat
            .is_some_and(|h| now_ns.saturating_sub(h.at_ns) < SILENT_NS);
        if self.restarts != vehicle.restarts {
            *self = Self {
                restarts: vehicle.restarts,
                ..Self::new(self.flavour)
            };
        }
        if !heard || vehicle.is_other_autopilot() || now_ns.saturating_sub(self.asked_ns) < PAUSE_NS {
            return None;
        }
        let unused = self.flavour.unused();
        for (((id, interval_us), seen_ns), ask) in NEEDED.iter().zip(&mut self.seen_ns).zip(&mut self.ask) {
            let since_ns = *seen_ns.get_or_insert(now_ns);
            if *ask || now_ns.saturating_sub(since_ns) > MISSING_NS {
                *ask = false;
                *seen_ns = Some(now_ns);
                self.asked_ns = now_ns;
                let params = [*id as f32, *interval_us, unused, unused, unused, unused, 0.0];
                return Some((command_number::SET_MESSAGE_INTERVAL, params));
            }
        }
        if vehicle.origin.is_none() && now_ns.saturating_sub(self.asked_ns) > MISSING_NS {
            let id = PLACES.get(self.next_place % PLACES.len())?;
            self.next_place = self.next_place.wrapping_add(1);
            self.asked_ns = now_ns;
            let params = [*id as f32, unused, unused, unused, unused, unused, 0.0];
            return Some((command_number::REQUEST_MESSAGE, params));
        }
        None
    }
}
