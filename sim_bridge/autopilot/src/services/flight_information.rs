//! FLIGHT_INFORMATION: when the vehicle was armed and took off, and the number of the flight.

use crate::service::prelude::*;

/// How often the commander is looked at.
const WATCH_NS: Nanos = 20_000_000;

/// Times of the present or last flight, microseconds since the first step; 0 where it has not happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct FlightTimes {
    armed_us: u64,
    took_off_us: u64,
    landed_ms: u32,
    /// Times armed.
    flight: u64,
}

#[derive(Default)]
pub(crate) struct FlightInformation {
    times: FlightTimes,
    armed: bool,
    in_air: bool,
    watch_ns: Nanos,
}

impl Service for FlightInformation {
    fn messages(&self) -> &'static [Produced] {
        const { &[Produced::stateful(FLIGHT_INFORMATION_DATA::ID, [0.0; 3])] }
    }

    fn produce(&self, _message_id: u32, _link: LinkId, core: &Core) -> Option<MavMessage> {
        Some(flight_information(&self.times, core))
    }

    fn due_ns(&self) -> Nanos {
        self.watch_ns
    }

    fn step(&mut self, core: &mut Core) {
        self.watch_ns = core.now_ns + WATCH_NS;
        let (armed, in_air) = (core.commander.is_armed(), !core.commander.is_on_ground());
        let (now_us, now_ms) = (core.time_boot_us(), core.time_boot_ms());
        let times = &mut self.times;
        if armed && !self.armed {
            *times = FlightTimes {
                armed_us: now_us,
                flight: times.flight + 1,
                ..FlightTimes::default()
            };
        }
        if in_air && !self.in_air {
            times.took_off_us = now_us;
            times.landed_ms = 0;
        }
        if !in_air && self.in_air {
            times.landed_ms = now_ms;
        }
        (self.armed, self.in_air) = (armed, in_air);
    }
}

/// Times since boot and the number of the flight, as the message is defined; its fields are misnamed.
fn flight_information(times: &FlightTimes, core: &Core) -> MavMessage {
    MavMessage::FLIGHT_INFORMATION(FLIGHT_INFORMATION_DATA {
        arming_time_utc: times.armed_us,
        takeoff_time_utc: times.took_off_us,
        flight_uuid: times.flight,
        time_boot_ms: core.time_boot_ms(),
        landing_time: times.landed_ms,
    })
}
