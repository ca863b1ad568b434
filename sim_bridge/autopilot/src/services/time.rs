//! PING, TIMESYNC and SYSTEM_TIME. <https://mavlink.io/en/services/ping.html>, <https://mavlink.io/en/services/timesync.html>

use crate::service::prelude::*;

pub(crate) struct Time;

impl Service for Time {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        // 0/0 asks everybody; anything else is somebody's answer.
        if let Some(ping) = core.read::<PING_DATA>(packet)
            && (ping.target_system, ping.target_component) == (0, 0)
        {
            core.outbox.send_to(source, MavMessage::PING(ping));
        }
        // tc1 is 0 in a request.
        if let Some(TIMESYNC_DATA { tc1: 0, ts1, .. }) = core.read(packet) {
            let tc1 = core.since_boot_ns() as i64;
            core.outbox.send_to(source, message!(TIMESYNC, tc1, ts1));
        }
    }

    fn messages(&self) -> &'static [Produced] {
        const { &[Produced::from(SYSTEM_TIME_DATA::ID, [1.0, 1.0, 1.0], system_time)] }
    }
}

fn system_time(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
        time_unix_usec: core.unix_time_at_zero_us + core.now_ns / 1000,
        time_boot_ms: core.time_boot_ms(),
    }))
}
