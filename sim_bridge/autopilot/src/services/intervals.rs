//! How often messages come, and single requests.
//! <https://mavlink.io/en/mavgen_python/howto_requestmessages.html>

use crate::service::Services;
use crate::service::prelude::*;
use crate::streams::Streams;

const GET_MESSAGE_INTERVAL: u16 = 510;
const SET_MESSAGE_INTERVAL: u16 = 511;
const REQUEST_MESSAGE: u16 = 512;

/// Answers 510, 511 and 512 for the link that the command came on. A message that the vehicle does not have is DENIED, of
/// 511 FAILED, of 510 the interval 0, as in PX4: UNSUPPORTED would tell the client that the command itself does not exist.
pub(crate) fn message_interval(
    command: &Command,
    source: Source,
    core: &mut Core,
    streams: &mut Streams,
    services: &Services,
) -> Option<Answer> {
    if !(GET_MESSAGE_INTERVAL..=REQUEST_MESSAGE).contains(&command.number) {
        return None;
    }
    // The largest message id is 2^24 − 1, which a float holds exactly.
    let id = command
        .param(1)
        .filter(|p| (0.0..=16_777_215.0).contains(p))
        .map(|p| p as u32);
    let is_read = command.number == GET_MESSAGE_INTERVAL;
    let Some(id) = id.filter(|id| is_read || streams.knows(*id)) else {
        return Some(match command.number {
            SET_MESSAGE_INTERVAL => Answer::FAILED,
            _ => Answer::DENIED,
        });
    };
    if command.number == REQUEST_MESSAGE
        && let Some(answer) = streams.request(id, command, source, core, services)
    {
        return Some(answer);
    }
    match command.number {
        GET_MESSAGE_INTERVAL => {
            let message = MavMessage::MESSAGE_INTERVAL(MESSAGE_INTERVAL_DATA {
                interval_us: streams.interval_us(source.link, id),
                message_id: id as u16,
            });
            core.outbox.send(source.link, &message);
        }
        SET_MESSAGE_INTERVAL => {
            let Some(interval_us) = command.param(2) else {
                return Some(Answer::DENIED);
            };
            if !streams.set_interval(core.now_ns, source.link, id, interval_us) {
                return Some(Answer::DENIED);
            }
        }
        // Known, but nothing to tell: a setpoint's echo outside OFFBOARD, a sensor that the vehicle does not have.
        _ if !streams.has(source.link, core, services, id) => return Some(Answer::DENIED),
        _ => core.request(source.link, id),
    }
    Some(Answer::ACCEPTED)
}
