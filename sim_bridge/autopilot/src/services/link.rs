//! PING, TIMESYNC, SYSTEM_TIME and LINK_NODE_STATUS: whose clock says what, and what a link carries.
//! <https://mavlink.io/en/services/ping.html>, <https://mavlink.io/en/services/timesync.html>

use crate::outbox::Traffic;
use crate::service::prelude::*;

/// 0/0 asks everybody; anything else is somebody's answer.
pub(super) fn answer_ping(ping: PING_DATA, source: Source, core: &mut Core) {
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

/// Over which rates are measured.
const WINDOW_NS: Nanos = 1_000_000_000;
/// Pings a second: as PX4's.
const PING_HZ: f32 = 0.1;

/// What a link had carried at the last look, and how fast it was until then.
#[derive(Debug, Clone, Copy, Default)]
struct Rates {
    sent: Traffic,
    received: Traffic,
    tx_bytes_s: u32,
    rx_bytes_s: u32,
}

#[derive(Debug, Default)]
pub(crate) struct LinkStatus {
    links: Vec<Rates>,
    due_ns: Nanos,
}

impl Service for LinkStatus {
    fn start(&mut self, core: &mut Core) {
        self.links = vec![Rates::default(); core.outbox.links()];
    }

    fn messages(&self) -> &'static [Produced] {
        const {
            &[
                Produced::from(SYSTEM_TIME_DATA::ID, [1.0, 1.0, 1.0], system_time),
                Produced::from(PING_DATA::ID, [0.0, PING_HZ, PING_HZ], ping),
                Produced::stateful(LINK_NODE_STATUS_DATA::ID, [0.0, 1.0, 1.0]),
            ]
        }
    }

    fn produce(&self, _message_id: u32, link: LinkId, core: &Core) -> Option<MavMessage> {
        let rates = self.links.get(usize::from(link.0))?;
        let received = core.received.get(usize::from(link.0))?;
        // Damaged packets and dropped ones are counted for all links together.
        Some(message!(
            LINK_NODE_STATUS,
            timestamp = core.time_boot_us(),
            tx_rate = rates.tx_bytes_s,
            rx_rate = rates.rx_bytes_s,
            messages_sent = core.outbox.sent(link).packets as u32,
            messages_received = received.packets as u32,
            rx_parse_err = (core.framing.bad_crc + core.framing.truncated).min(u64::from(u16::MAX)) as u16,
            tx_overflows = core.outbox.dropped.min(u64::from(u16::MAX)) as u16
        ))
    }

    fn due_ns(&self) -> Nanos {
        self.due_ns
    }

    fn step(&mut self, core: &mut Core) {
        self.due_ns = core.now_ns + WINDOW_NS;
        for (index, rates) in self.links.iter_mut().enumerate() {
            let sent = core.outbox.sent(LinkId(index as u8));
            let received = core.received.get(index).copied().unwrap_or_default();
            rates.tx_bytes_s = (sent.bytes - rates.sent.bytes) as u32;
            rates.rx_bytes_s = (received.bytes - rates.received.bytes) as u32;
            (rates.sent, rates.received) = (sent, received);
        }
    }
}

/// To everybody, who answers as [`answer_ping`] does. The time distinguishes one from the next.
fn ping(core: &Core) -> Option<MavMessage> {
    let seq = (core.time_boot_ms() as f32 * 1e-3 * PING_HZ) as u32;
    Some(message!(PING, time_usec = core.time_boot_us(), seq))
}
