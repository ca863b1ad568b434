//! Which message goes out on which link when, and the commands that say so.
//! <https://mavlink.io/en/mavgen_python/howto_requestmessages.html>

use crate::core::{Core, nanos};
use crate::service::{Answer, Produced, Refusal, Services, Source};
use crate::{LinkId, LinkRole};
use vigil_mavlink::common::HEARTBEAT_DATA;
use vigil_mavlink::framing::Command;
use vigil_mavlink::mavlink::MessageData;
use vigil_mavlink::{MavMessage, message};
use vigil_types::Nanos;

const GET_MESSAGE_INTERVAL: u16 = 510;
const SET_MESSAGE_INTERVAL: u16 = 511;
const REQUEST_MESSAGE: u16 = 512;
/// Shortest interval that can be asked for.
const MIN_INTERVAL_NS: Nanos = 2_000_000;

#[derive(Clone, Copy)]
struct Schedule {
    /// `None` is off.
    interval_ns: Option<Nanos>,
    next_ns: Nanos,
}

struct Stream {
    produced: Produced,
    /// Index of the service that produces it.
    service: usize,
    per_link: Vec<Schedule>,
}

impl Stream {
    fn build(&self, link: LinkId, core: &Core, services: &Services) -> Option<MavMessage> {
        match self.produced.build {
            Some(build) => build(core),
            None => services.get(self.service)?.produce(self.produced.id, link, core),
        }
    }
}

/// All streams of all links.
pub(crate) struct Streams {
    streams: Vec<Stream>,
    /// Earliest time at which something is due.
    pub due_ns: Nanos,
}

fn default_interval_ns(produced: &Produced, role: LinkRole) -> Option<Nanos> {
    let rate_hz = produced.rate_hz.get(role as usize).copied().unwrap_or(0.0);
    (rate_hz > 0.0).then(|| (1e9 / f64::from(rate_hz)) as Nanos)
}

impl Streams {
    pub fn new(roles: &[LinkRole], services: &Services) -> Self {
        let mut streams: Vec<Stream> = Vec::new();
        for (service, producer) in services.iter().enumerate() {
            for produced in producer.messages() {
                let schedule = |role: &LinkRole| Schedule {
                    interval_ns: default_interval_ns(produced, *role),
                    next_ns: 0,
                };
                streams.push(Stream {
                    produced: *produced,
                    service,
                    per_link: roles.iter().map(schedule).collect(),
                });
            }
        }
        streams.sort_by_key(|s| s.produced.id);
        debug_assert!(streams.is_sorted_by(|a, b| a.produced.id < b.produced.id));
        Self { streams, due_ns: 0 }
    }

    fn index_of(&self, id: u32) -> Option<usize> {
        self.streams.binary_search_by_key(&id, |s| s.produced.id).ok()
    }

    /// Answers 510, 511 and 512 for the link that the command came on; UNSUPPORTED is any other. A message that the vehicle does
    /// not have is DENIED, of 511 FAILED, of 510 the interval 0, as in PX4: UNSUPPORTED would tell the client that the command
    /// itself does not exist.
    pub fn command(&mut self, command: &Command, source: Source, core: &mut Core, services: &Services) -> Answer {
        // The largest message id is 2^24 − 1, which a float holds exactly.
        let number = command.param(1).filter(|p| (0.0..=16_777_215.0).contains(p));
        let id = number.map(|p| p as u32);
        let index = id.and_then(|id| self.index_of(id));
        match (command.number, id, index) {
            (GET_MESSAGE_INTERVAL, Some(id), _) => {
                let interval_us = index.map_or(0, |index| self.interval_us(source.link, index));
                let message = message!(MESSAGE_INTERVAL, interval_us, message_id = id as u16);
                core.outbox.send(source.link, &message);
                Ok(())
            }
            (SET_MESSAGE_INTERVAL, _, Some(index)) => {
                let is_set = self.set_interval(core, source.link, index, command.param(2));
                is_set.ok_or(Refusal::DENIED)
            }
            (SET_MESSAGE_INTERVAL, ..) => Err(Refusal::FAILED),
            (REQUEST_MESSAGE, _, Some(index)) => {
                let stream = &self.streams[index];
                if let Some(answer) = stream.produced.request {
                    return answer(command, source, core);
                }
                // Known, but nothing to tell: a setpoint's echo outside OFFBOARD, a sensor that the vehicle does not have.
                let has_content = stream.build(source.link, core, services).is_some();
                has_content
                    .then(|| core.wanted.push((Some(source.link), stream.produced.id)))
                    .ok_or(Refusal::DENIED)
            }
            (GET_MESSAGE_INTERVAL | REQUEST_MESSAGE, ..) => Err(Refusal::DENIED),
            _ => Err(Refusal::UNSUPPORTED),
        }
    }

    /// Interval of a message on a link in microseconds as MESSAGE_INTERVAL says it: −1 off.
    fn interval_us(&self, link: LinkId, index: usize) -> i32 {
        let schedule = self.streams[index].per_link.get(usize::from(link.0));
        match schedule.map(|schedule| schedule.interval_ns) {
            None => 0,
            Some(None) => -1,
            Some(Some(ns)) => i32::try_from(ns / 1000).unwrap_or(i32::MAX),
        }
    }

    /// Sets the interval as SET_MESSAGE_INTERVAL asks: −1 off, 0 default, else microseconds. `None` if the number is no time.
    fn set_interval(&mut self, core: &Core, link: LinkId, index: usize, interval_us: Option<f32>) -> Option<()> {
        let (stream, link, interval_us) = (&mut self.streams[index], usize::from(link.0), interval_us?);
        let schedule = stream.per_link.get_mut(link)?;
        schedule.interval_ns = if interval_us < 0.0 && interval_us.is_finite() {
            None
        } else if interval_us == 0.0 {
            default_interval_ns(&stream.produced, *core.roles.get(link)?)
        } else {
            Some(nanos(f64::from(interval_us) * 1e-6)?.max(MIN_INTERVAL_NS))
        };
        schedule.next_ns = core.now_ns;
        self.due_ns = self.due_ns.min(core.now_ns);
        Some(())
    }

    /// Sends everything that was asked for besides the streams.
    pub fn send_wanted(&self, core: &mut Core, services: &Services) {
        let mut wanted = std::mem::take(&mut core.wanted);
        for (link, id) in wanted.drain(..) {
            let Some(stream) = self.index_of(id).map(|index| &self.streams[index]) else {
                continue;
            };
            let links = match link {
                Some(link) => link.0..link.0 + 1,
                None => 0..core.outbox.links() as u8,
            };
            for link in links.map(LinkId) {
                if let Some(message) = stream.build(link, core, services) {
                    core.outbox.send(link, &message);
                }
            }
        }
        // Emptied; its memory is used again.
        core.wanted = wanted;
    }

    /// Sends what is due.
    pub fn step(&mut self, core: &mut Core, services: &Services) {
        let now_ns = core.now_ns;
        self.due_ns = Nanos::MAX;
        for stream in &mut self.streams {
            core.outbox.is_telemetry = stream.produced.id != HEARTBEAT_DATA::ID;
            let mut built = None;
            for link in 0..stream.per_link.len() {
                let Schedule { interval_ns, next_ns } = stream.per_link[link];
                let Some(interval_ns) = interval_ns else {
                    continue;
                };
                if next_ns <= now_ns {
                    let id = LinkId(link as u8);
                    if stream.produced.build.is_none() {
                        built = None;
                    }
                    if let Some(message) = built.get_or_insert_with(|| stream.build(id, core, services)) {
                        core.outbox.send(id, message);
                    }
                    // On the grid of the interval; after a pause the missed ones are not made up for.
                    let next_ns = next_ns + interval_ns;
                    let is_late = next_ns <= now_ns;
                    stream.per_link[link].next_ns = if is_late { now_ns + interval_ns } else { next_ns };
                }
                self.due_ns = self.due_ns.min(stream.per_link[link].next_ns);
            }
        }
        core.outbox.is_telemetry = false;
    }
}
