//! FLIGHT_INFORMATION: when the vehicle was armed and took off, and the number of the flight.

use crate::service::prelude::*;

/// How often the commander is looked at.
const WATCH_NS: Nanos = 20_000_000;

#[derive(Default)]
pub(crate) struct FlightInformation {
    /// Of the present or last flight: times since boot, 0 where it has not happened, and how often it was armed. Its fields are misnamed.
    times: FLIGHT_INFORMATION_DATA,
    armed: bool,
    in_air: bool,
    watch_ns: Nanos,
}

impl Service for FlightInformation {
    fn messages(&self) -> &'static [Produced] {
        const { &[Produced::stateful(FLIGHT_INFORMATION_DATA::ID, [0.0; 3])] }
    }

    fn produce(&self, _message_id: u32, _link: LinkId, core: &Core) -> Option<MavMessage> {
        Some(MavMessage::FLIGHT_INFORMATION(FLIGHT_INFORMATION_DATA {
            time_boot_ms: core.time_boot_ms(),
            ..self.times.clone()
        }))
    }

    fn due_ns(&self) -> Nanos {
        self.watch_ns
    }

    fn step(&mut self, core: &mut Core) {
        self.watch_ns = core.now_ns + WATCH_NS;
        let (armed, in_air) = (core.commander.armed, !core.commander.is_on_ground());
        let (now_us, now_ms) = (core.time_boot_us(), core.time_boot_ms());
        let times = &mut self.times;
        if armed && !self.armed {
            *times = FLIGHT_INFORMATION_DATA {
                arming_time_utc: now_us,
                flight_uuid: times.flight_uuid + 1,
                ..FLIGHT_INFORMATION_DATA::default()
            };
        }
        if in_air && !self.in_air {
            (times.takeoff_time_utc, times.landing_time) = (now_us, 0);
        }
        if !in_air && self.in_air {
            times.landing_time = now_ms;
        }
        (self.armed, self.in_air) = (armed, in_air);
    }
}
