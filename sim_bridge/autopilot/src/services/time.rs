//! PING, TIMESYNC and SYSTEM_TIME. <https://mavlink.io/en/services/ping.html>, <https://mavlink.io/en/services/timesync.html>

use crate::service::prelude::*;

pub(super) const MESSAGES: &[Produced] = &[Produced::from(SYSTEM_TIME_DATA::ID, [1.0, 1.0, 1.0], system_time)];

/// 0/0 asks everybody; anything else is somebody's answer.
pub(super) fn ping(ping: PING_DATA, source: Source, core: &mut Core) {
    if (ping.target_system, ping.target_component) == (0, 0) {
        core.outbox.send_to(source, MavMessage::PING(ping));
    }
}

/// tc1 is 0 in a request.
pub(super) fn synchronise(TIMESYNC_DATA { tc1, ts1, .. }: TIMESYNC_DATA, source: Source, core: &mut Core) {
    if tc1 == 0 {
        let tc1 = core.since_boot_ns() as i64;
        core.outbox.send_to(source, message!(TIMESYNC, tc1, ts1));
    }
}

fn system_time(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
        time_unix_usec: core.unix_time_at_zero_us + core.now_ns / 1000,
        time_boot_ms: core.time_boot_ms(),
    }))
}
