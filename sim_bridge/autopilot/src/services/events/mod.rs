//! Events: what happened, sent reliably and in the order it happened. <https://mavlink.io/en/services/events.html> And
//! FLIGHT_INFORMATION: when the vehicle was armed and took off, and the number of the flight.
//!
//! The service watches the commander instead of being called, so flight code knows nothing of it.

mod catalogue;

use crate::core::padded;
use crate::flight::state::Commander;
use crate::service::prelude::*;
use std::collections::VecDeque;

pub(crate) use catalogue::definitions;
use catalogue::*;

const RUN_PREARM_CHECKS: u16 = 401;
/// How often the commander is looked at.
const WATCH_NS: Nanos = 20_000_000;
/// How often the last sequence number is sent, so that the loss of the last event is noticed.
const TELL_NS: Nanos = 1_000_000_000;
/// Events kept for those who ask for them again.
const KEPT: usize = 64;

/// The check that keeps the vehicle from being armed.
fn failing(core: &Core) -> Option<ArmingCheck> {
    core.arming_check().err().as_ref().map(check_of)
}

#[derive(Default)]
pub(crate) struct Events {
    /// At the last look.
    seen: Option<(Commander, Option<ArmingCheck>)>,
    /// Of the present or last flight: times since boot, 0 where it has not happened, and how often it was armed. Its fields are misnamed.
    times: FLIGHT_INFORMATION_DATA,
    kept: VecDeque<EVENT_DATA>,
    /// Of the last event; the first has 1.
    sequence: u16,
    /// Whether the sequence has been sent since the start.
    is_sent: bool,
    watch_ns: Nanos,
    tell_ns: Nanos,
}

impl Service for Events {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        if let Some(request) = core.read(packet) {
            self.send_again(&request, source, core);
        }
    }

    fn serves(&self, command: u16) -> bool {
        command == RUN_PREARM_CHECKS
    }

    fn command(&mut self, _command: &Command, _source: Source, core: &mut Core) -> Answer {
        if core.commander.armed {
            return Err(Refusal::REJECTED.saying("pre-arm checks denied: armed"));
        }
        self.report_checks(failing(core), core);
        Ok(())
    }

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
        self.watch_ns.min(self.tell_ns)
    }

    fn step(&mut self, core: &mut Core) {
        if self.watch_ns <= core.now_ns {
            self.watch_ns = core.now_ns + WATCH_NS;
            self.watch(core);
        }
        if self.tell_ns <= core.now_ns {
            self.tell_sequence(core);
        }
    }
}

impl Events {
    fn watch(&mut self, core: &mut Core) {
        let (now, check) = (core.commander, failing(core));
        let seen = self.seen.replace((now, check));
        self.note_times(&seen.map(|(before, _)| before).unwrap_or_default(), core);
        let Some((before, check_before)) = seen else {
            // What was so from the start is no event, but a client that knows the metadata wants the checks once.
            self.report_checks(check, core);
            return;
        };
        if now.terminated && !before.terminated {
            self.send(TERMINATED, &[], core);
        }
        if now.armed != before.armed {
            self.send(if now.armed { ARMED } else { DISARMED }, &[], core);
        }
        if now.mode != before.mode {
            self.send(MODE_CHANGED, &now.mode.custom_mode().to_le_bytes(), core);
        }
        if now.failsafe != before.failsafe {
            match now.failsafe {
                Some(failsafe) => self.send(FAILSAFE_ENTERED, &[failsafe as u8 + 1], core),
                None => self.send(FAILSAFE_ENDED, &[], core),
            }
        }
        if now.is_on_ground() != before.is_on_ground() {
            self.send(if now.is_on_ground() { LANDED } else { TOOK_OFF }, &[], core);
        }
        if check != check_before && !now.armed {
            self.report_checks(check, core);
        }
    }

    fn note_times(&mut self, before: &Commander, core: &Core) {
        let (times, now) = (&mut self.times, &core.commander);
        if now.armed && !before.armed {
            *times = FLIGHT_INFORMATION_DATA {
                arming_time_utc: core.time_boot_us(),
                flight_uuid: times.flight_uuid + 1,
                ..FLIGHT_INFORMATION_DATA::default()
            };
        }
        match (before.is_on_ground(), now.is_on_ground()) {
            (true, false) => (times.takeoff_time_utc, times.landing_time) = (core.time_boot_us(), 0),
            (false, true) => times.landing_time = core.time_boot_ms(),
            _ => {}
        }
    }

    /// The health and arming check protocol: a summary, each problem, a summary of health.
    fn report_checks(&mut self, check: Option<ArmingCheck>, core: &mut Core) {
        let (failing, can) = check.map_or((0, MODE_GROUP), |(component, _)| (1 << component, 0));
        self.send(CHECK_SUMMARY, &chunk([failing, 0, can, can]), core);
        if let Some((component, event)) = check {
            let arguments = [&MODE_GROUP.to_le_bytes()[..], &[component]].concat();
            self.send(event, &arguments, core);
        }
        self.send(HEALTH_SUMMARY, &chunk([PRESENT, 0, 0]), core);
    }

    fn send(&mut self, event: Event, arguments: &[u8], core: &mut Core) {
        self.sequence = self.sequence.wrapping_add(1);
        let severity = event.4 as u8;
        let data = EVENT_DATA {
            id: event.id(),
            event_time_boot_ms: core.time_boot_ms(),
            sequence: self.sequence,
            // The level for logs above the level for people.
            log_levels: severity << 4 | severity,
            arguments: padded(arguments),
            ..EVENT_DATA::default()
        };
        if self.kept.len() >= KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(data.clone());
        core.outbox.send_all(&MavMessage::EVENT(data));
        // Soon, so that the loss of this one is noticed soon.
        self.tell_ns = self.tell_ns.min(core.now_ns + TELL_NS / 4);
    }

    fn tell_sequence(&mut self, core: &mut Core) {
        self.tell_ns = core.now_ns + TELL_NS;
        let mut flags = MavEventCurrentSequenceFlags::empty();
        flags.set(
            MavEventCurrentSequenceFlags::MAV_EVENT_CURRENT_SEQUENCE_FLAGS_RESET,
            !std::mem::replace(&mut self.is_sent, true),
        );
        let message = message!(CURRENT_EVENT_SEQUENCE, sequence = self.sequence, flags);
        core.outbox.send_all(&message);
    }

    /// Sends the events asked for again, to the asker; of one that is kept no longer, how far back it can ask.
    fn send_again(&self, request: &REQUEST_EVENT_DATA, source: Source, core: &mut Core) {
        let count = request.last_sequence.wrapping_sub(request.first_sequence);
        for i in 0..=count.min(KEPT as u16) {
            let sequence = request.first_sequence.wrapping_add(i);
            let Some(event) = self.kept.iter().find(|e| e.sequence == sequence) else {
                let error = message!(
                    RESPONSE_EVENT_ERROR,
                    sequence,
                    sequence_oldest_available = self.kept.front().map_or(0, |e| e.sequence),
                    reason = MavEventErrorReason::MAV_EVENT_ERROR_REASON_UNAVAILABLE
                );
                return core.outbox.send_to(source, error);
            };
            core.outbox.send(source.link, &MavMessage::EVENT(event.clone()));
        }
    }
}

/// The first and only chunk of a summary.
fn chunk<const N: usize>(words: [u32; N]) -> Vec<u8> {
    let words = words.into_iter().flat_map(u32::to_le_bytes);
    [0].into_iter().chain(words).collect()
}
