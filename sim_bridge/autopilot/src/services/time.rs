//! PING, TIMESYNC and SYSTEM_TIME. <https://mavlink.io/en/services/ping.html>, <https://mavlink.io/en/services/timesync.html>

use crate::core::Core;
use crate::service::{Build, Produced, Service, Source};
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::{PING_DATA, SYSTEM_TIME_DATA, TIMESYNC_DATA};
use vigil_mavlink::framing::Packet;
use vigil_mavlink::mavlink::MessageData;

pub(crate) struct Time;

impl Service for Time {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        match packet.message_id() {
            PING_DATA::ID => {
                // 0/0 asks everybody; anything else is somebody's answer.
                if let Ok(MavMessage::PING(ping)) = packet.message()
                    && ping.target_system == 0
                    && ping.target_component == 0
                {
                    let answer = MavMessage::PING(PING_DATA {
                        target_system: source.id.system,
                        target_component: source.id.component,
                        ..ping
                    });
                    core.outbox.send(source.link, &answer);
                }
            }
            TIMESYNC_DATA::ID => {
                // tc1 is 0 in a request.
                if let Ok(MavMessage::TIMESYNC(request)) = packet.message()
                    && request.tc1 == 0
                {
                    let answer = MavMessage::TIMESYNC(TIMESYNC_DATA {
                        tc1: core.since_boot_ns() as i64,
                        ts1: request.ts1,
                        target_system: source.id.system,
                        target_component: source.id.component,
                    });
                    core.outbox.send(source.link, &answer);
                }
            }
            _ => {}
        }
    }

    fn messages(&self) -> &'static [Produced] {
        &[Produced {
            id: SYSTEM_TIME_DATA::ID,
            rate_hz: [1.0, 1.0, 1.0],
            build: Build::From(system_time),
        }]
    }
}

fn system_time(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
        time_unix_usec: core.unix_time_at_zero_us + core.now_ns / 1000,
        time_boot_ms: core.time_boot_ms(),
    }))
}
