//! Which message goes out on which link when.

use crate::core::{Core, nanos};
use crate::service::{Answer, Build, Produced, Services, Source};
use crate::{LinkId, LinkRole};
use vigil_mavlink::MavMessage;
use vigil_mavlink::framing::Command;
use vigil_types::Nanos;

/// Shortest interval that can be asked for.
const MIN_INTERVAL_NS: Nanos = 2_000_000;

#[derive(Clone, Copy)]
struct Schedule {
    /// `None` is off.
    interval_ns: Option<Nanos>,
    next_ns: Nanos,
}

/// A message and the index of the service that produces it.
struct Origin {
    produced: Produced,
    service: usize,
}

struct Stream {
    origin: Origin,
    per_link: Vec<Schedule>,
}

impl Origin {
    fn build(&self, link: LinkId, core: &Core, services: &Services) -> Option<MavMessage> {
        match self.produced.build {
            Build::From(build) => build(core),
            Build::Stateful => services.get(self.service)?.produce(self.produced.id, link, core),
        }
    }
}

/// All streams of all links.
pub(crate) struct Streams {
    streams: Vec<Stream>,
    roles: Vec<LinkRole>,
    next_ns: Nanos,
}

fn default_interval_ns(produced: &Produced, role: LinkRole) -> Option<Nanos> {
    let rate_hz = produced.rate_hz.get(role.index()).copied().unwrap_or(0.0);
    (rate_hz > 0.0).then(|| (1e9 / f64::from(rate_hz)) as Nanos)
}

impl Streams {
    pub fn new(roles: &[LinkRole], services: &Services) -> Self {
        let produced = services
            .iter()
            .enumerate()
            .flat_map(|(index, service)| service.messages().iter().map(move |produced| (index, *produced)));
        let mut streams: Vec<Stream> = produced
            .map(|(service, produced)| Stream {
                origin: Origin { produced, service },
                per_link: roles
                    .iter()
                    .map(|role| Schedule {
                        interval_ns: default_interval_ns(&produced, *role),
                        next_ns: 0,
                    })
                    .collect(),
            })
            .collect();
        streams.sort_by_key(|s| s.origin.produced.id);
        debug_assert!(streams.is_sorted_by(|a, b| a.origin.produced.id < b.origin.produced.id));
        Self {
            streams,
            roles: roles.to_vec(),
            next_ns: 0,
        }
    }

    /// Earliest time at which something is due.
    #[inline]
    pub fn due_ns(&self) -> Nanos {
        self.next_ns
    }

    fn index_of(&self, id: u32) -> Option<usize> {
        self.streams.binary_search_by_key(&id, |s| s.origin.produced.id).ok()
    }

    fn find(&self, id: u32) -> Option<&Stream> {
        self.streams.get(self.index_of(id)?)
    }

    /// Interval of a message on a link in microseconds as MESSAGE_INTERVAL tells it: 0 unknown message, −1 off.
    pub fn interval_us(&self, link: LinkId, id: u32) -> i32 {
        let schedule = self.find(id).and_then(|s| s.per_link.get(usize::from(link.0)));
        match schedule.map(|schedule| schedule.interval_ns) {
            None => 0,
            Some(None) => -1,
            Some(Some(ns)) => i32::try_from(ns / 1000).unwrap_or(i32::MAX),
        }
    }

    /// Sets the interval as SET_MESSAGE_INTERVAL asks: −1 off, 0 default, else microseconds. `false` if there is no such
    /// message or the number is no time.
    pub fn set_interval(&mut self, now_ns: Nanos, link: LinkId, id: u32, interval_us: f32) -> bool {
        let Some(stream) = self.index_of(id).map(|i| &mut self.streams[i]) else {
            return false;
        };
        let index = usize::from(link.0);
        let (Some(schedule), Some(role)) = (stream.per_link.get_mut(index), self.roles.get(index)) else {
            return false;
        };
        schedule.interval_ns = if interval_us < 0.0 && interval_us.is_finite() {
            None
        } else if interval_us == 0.0 {
            default_interval_ns(&stream.origin.produced, *role)
        } else if let Some(interval_ns) = nanos(f64::from(interval_us) * 1e-6) {
            Some(interval_ns.max(MIN_INTERVAL_NS))
        } else {
            return false;
        };
        schedule.next_ns = now_ns;
        self.next_ns = self.next_ns.min(now_ns);
        true
    }

    /// Whether there is such a message.
    pub fn knows(&self, id: u32) -> bool {
        self.find(id).is_some()
    }

    /// Whether there is such a message and something for it to tell now.
    pub fn has(&self, link: LinkId, core: &Core, services: &Services, id: u32) -> bool {
        self.find(id)
            .is_some_and(|s| s.origin.build(link, core, services).is_some())
    }

    /// Offers a request for a message to the service that produces it.
    pub fn request(
        &self,
        id: u32,
        request: &Command,
        source: Source,
        core: &mut Core,
        services: &Services,
    ) -> Option<Answer> {
        services
            .get(self.find(id)?.origin.service)?
            .request(id, request, source, core)
    }

    /// Sends everything that was asked for besides the streams.
    pub fn send_wanted(&self, core: &mut Core, services: &Services) {
        let mut wanted = std::mem::take(&mut core.wanted);
        for (link, id) in wanted.drain(..) {
            let Some(stream) = self.find(id) else {
                continue;
            };
            let links = match link {
                Some(link) => link.0..link.0 + 1,
                None => 0..self.roles.len() as u8,
            };
            for link in links.map(LinkId) {
                if let Some(message) = stream.origin.build(link, core, services) {
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
        let mut next_ns = Nanos::MAX;
        for stream in &mut self.streams {
            let mut built = None;
            for (link, schedule) in stream.per_link.iter_mut().enumerate() {
                let Some(interval_ns) = schedule.interval_ns else {
                    continue;
                };
                if schedule.next_ns <= now_ns {
                    let link = LinkId(link as u8);
                    if matches!(stream.origin.produced.build, Build::Stateful) {
                        built = None;
                    }
                    let message = built.get_or_insert_with(|| stream.origin.build(link, core, services));
                    if let Some(message) = message {
                        core.outbox.send(link, message);
                    }
                    // On the grid of the interval; after a pause the missed ones are not made up for.
                    schedule.next_ns += interval_ns;
                    if schedule.next_ns <= now_ns {
                        schedule.next_ns = now_ns + interval_ns;
                    }
                }
                next_ns = next_ns.min(schedule.next_ns);
            }
        }
        self.next_ns = next_ns;
    }
}
