//! Answers to the questions about time: TIMESYNC and its predecessor PING.
//! <https://mavlink.io/en/services/timesync.html>, <https://mavlink.io/en/services/ping.html>

use crate::core::Core;
use crate::framing::{Packet, Zeroed};
use crate::operator::ReplyTo;
use crate::service::Service;
use vigil_types::Nanos;

const PING: u32 = 4;
const TIMESYNC: u32 = 111;

#[derive(Debug, Clone, Default)]
pub(crate) struct TimeService;

impl Service for TimeService {
    fn hear(&mut self, core: &mut Core, now_ns: Nanos, packet: &Packet<'_>, from: ReplyTo) -> bool {
        let me = (core.sender.system_id, core.sender.component_id);
        let Some((message_id, payload)) = answer(now_ns, packet, me) else {
            return false;
        };
        core.reply(from.link, message_id, &payload);
        true
    }
}

/// Message number and payload of an answer; zeros at its end are cut when it is sent.
type Answer = (u32, [u8; 18]);

/// The answer to a question for the component `me` (system, component); `None` when it is none.
fn answer(now_ns: Nanos, packet: &Packet<'_>, me: (u8, u8)) -> Option<Answer> {
    let p = Zeroed(packet.payload());
    let from = [packet.system_id(), packet.component_id()];
    let mut out = [0; 18];
    match packet.message_id() {
        // tc1 (i64), ts1 (i64), target. tc1 is 0 in a question; the answer has our time there and leaves ts1.
        TIMESYNC if p.bytes::<8>(0) == [0; 8] => {
            let [system, component] = p.bytes(16);
            let for_me = (system == 0 || system == me.0) && (component == 0 || component == me.1);
            let now_ns = i64::try_from(now_ns).unwrap_or(i64::MAX);
            for_me.then(|| {
                put(&mut out, 0, &now_ns.to_le_bytes());
                put(&mut out, 8, &p.bytes::<8>(8));
                put(&mut out, 16, &from);
                (TIMESYNC, out)
            })
        }
        // time_usec (u64), seq (u32), target. Only a question goes to everybody; the answer echoes it to the sender.
        PING if p.bytes::<2>(12) == [0; 2] => {
            put(&mut out, 0, &p.bytes::<12>(0));
            put(&mut out, 12, &from);
            Some((PING, out))
        }
        _ => None,
    }
}

fn put(out: &mut [u8; 18], offset: usize, bytes: &[u8]) {
    for (slot, byte) in out.iter_mut().skip(offset).zip(bytes) {
        *slot = *byte;
    }
}
