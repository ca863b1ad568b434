//! Answers to the questions about time: TIMESYNC and its predecessor PING.
//! <https://mavlink.io/en/services/timesync.html>, <https://mavlink.io/en/services/ping.html>
// Clients still ask by PING.
#![allow(deprecated)]

use super::Service;
use crate::core::Core;
use crate::framing::Packet;
use crate::operator::ReplyTo;
use mavlink::MessageData;
use mavlink::dialects::common::{MavMessage, PING_DATA, TIMESYNC_DATA};
use vigil_types::Nanos;

#[derive(Debug, Clone, Default)]
pub(crate) struct TimeService;

impl Service for TimeService {
    fn hear(&mut self, core: &mut Core, now_ns: Nanos, packet: &Packet<'_>, from: ReplyTo) -> bool {
        if ![PING_DATA::ID, TIMESYNC_DATA::ID].contains(&packet.message_id()) {
            return false;
        }
        let (target_system, target_component) = (from.system, from.component);
        let answer = match packet.message() {
            // tc1 is 0 in a question; the answer has our time there and leaves ts1.
            Ok(MavMessage::TIMESYNC(m)) if m.tc1 == 0 && core.is_for_me_or_all(m.target_system, m.target_component) => {
                MavMessage::TIMESYNC(TIMESYNC_DATA {
                    tc1: i64::try_from(now_ns).unwrap_or(i64::MAX),
                    target_system,
                    target_component,
                    ..m
                })
            }
            // Only a question goes to everybody; the answer echoes it to the sender.
            Ok(MavMessage::PING(m)) if (m.target_system, m.target_component) == (0, 0) => MavMessage::PING(PING_DATA {
                target_system,
                target_component,
                ..m
            }),
            _ => return false,
        };
        core.reply(from.link, &answer);
        true
    }
}
