//! HOME_POSITION and GPS_GLOBAL_ORIGIN: both are the local origin. <https://mavlink.io/en/services/home.html>

use crate::core::Core;
use crate::geo::deg_e7;
use crate::service::{Answer, Produced, Service, Source};
use vigil_link::MavMessage;
use vigil_link::common::{GPS_GLOBAL_ORIGIN_DATA, HOME_POSITION_DATA, SET_GPS_GLOBAL_ORIGIN_DATA};
use vigil_link::framing::{Command, Packet};
use vigil_link::mavlink::MessageData;

/// MAV_CMD_GET_HOME_POSITION: the old way to ask for HOME_POSITION.
const GET_HOME_POSITION: u16 = 410;

pub(crate) struct Geography;

impl Service for Geography {
    fn receive(&mut self, packet: &Packet<'_>, _source: Source, core: &mut Core) {
        // The origin is where the simulated world has it; whoever wants another is told the one in force.
        if packet.message_id() == SET_GPS_GLOBAL_ORIGIN_DATA::ID {
            core.announce(GPS_GLOBAL_ORIGIN_DATA::ID);
        }
    }

    fn command(&mut self, command: &Command, source: Source, core: &mut Core) -> Option<Answer> {
        (command.number == GET_HOME_POSITION).then(|| {
            core.request(source.link, HOME_POSITION_DATA::ID);
            Answer::ACCEPTED
        })
    }

    fn messages(&self) -> &'static [Produced] {
        &[
            Produced {
                id: HOME_POSITION_DATA::ID,
                rate_hz: [0.5, 0.5, 0.5],
                build: home,
            },
            Produced {
                id: GPS_GLOBAL_ORIGIN_DATA::ID,
                rate_hz: [0.5, 0.5, 0.5],
                build: origin,
            },
        ]
    }
}

fn home(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::HOME_POSITION(HOME_POSITION_DATA {
        latitude: deg_e7(core.home.latitude_deg),
        longitude: deg_e7(core.home.longitude_deg),
        altitude: (core.home.altitude_m * 1e3) as i32,
        q: [1.0, 0.0, 0.0, 0.0],
        time_usec: core.time_boot_us(),
        ..Default::default()
    }))
}

fn origin(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA {
        latitude: deg_e7(core.home.latitude_deg),
        longitude: deg_e7(core.home.longitude_deg),
        altitude: (core.home.altitude_m * 1e3) as i32,
        time_usec: core.time_boot_us(),
    }))
}
