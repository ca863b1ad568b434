//! The flight log, its download and its streaming. <https://mavlink.io/en/services/log.html> (LOG_REQUEST_LIST and its
//! kin), LOGGING_START
//!
//! From arming to disarming the vehicle records itself into a ULog file under `log`, which can also be read by file transfer:
//! ground stations name what they download from a PX4 `.ulg`. docs/mavlink.md says what is in it.

use crate::core::padded;
use crate::service::prelude::*;
use crate::ulog;
use core::ops::Range;

const DIRECTORY: &str = "log";
/// Ten records per second.
const RECORD_NS: Nanos = 100_000_000;
/// Size of one log, about 12 minutes; more is not recorded.
const MAX_LOG: usize = 1024 * 1024;
/// Logs kept; the oldest gives way.
const MAX_LOGS: usize = 4;
/// Pace of a download, as of file transfer.
const SEND_NS: Nanos = 1_000_000;
const PACKETS_AT_ONCE: usize = 2;
const CHUNK: usize = 90;
/// Downloads at a time, one per client; as many clients may have a log streamed.
const MAX_DOWNLOADS: usize = 4;
const LOGGING_START: u16 = 2510;
const LOGGING_STOP: u16 = 2511;
/// Bytes of LOGGING_DATA, and packets for each record: the beginning of a log is caught up with.
const STREAM_CHUNK: usize = 249;
const STREAM_PACKETS: usize = 4;

/// What LOGGING_DATA says where no message of the log begins in it.
const NO_MESSAGE: u8 = 255;

/// What a client is being sent.
#[derive(Debug, Clone)]
struct Work {
    /// The log's path and number; `None` lists the logs.
    log: Option<(String, u16)>,
    /// Bytes of the log, or logs of the list.
    left: Range<usize>,
}

/// A log that is sent while it is written.
#[derive(Debug, Clone, Default)]
struct Stream {
    path: String,
    offset: usize,
    /// Where the next message of the log begins.
    message: usize,
    sequence: u16,
}

#[derive(Default)]
pub(crate) struct Logs {
    /// The log that is being recorded.
    recording: Option<String>,
    /// Whether it has reached its size.
    full: bool,
    recorded: u32,
    bytes: Vec<u8>,
    record_ns: Nanos,
    send_ns: Nanos,
    work: Vec<(Source, Work)>,
    streams: Vec<(Source, Stream)>,
}

impl Service for Logs {
    fn start(&mut self, core: &mut Core) {
        // Before a client makes a file of that name.
        core.files.own_directories(&format!("{DIRECTORY}/"), core.unix_time_s());
    }

    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        if let Some(LOG_REQUEST_LIST_DATA { start, end, .. }) = core.read(packet) {
            let count = paths(core).len();
            let next = usize::from(start).min(count);
            let end = (usize::from(end) + 1).min(count);
            if count == 0 {
                core.outbox.send(source.link, &entry(core, 0));
            } else {
                self.begin(source, None, next..end, core.now_ns);
            }
        } else if let Some(LOG_REQUEST_DATA_DATA { id, ofs, count, .. }) = core.read(packet) {
            let Some(path) = paths(core).get(usize::from(id)).cloned() else {
                core.refusals.file += 1;
                return core.outbox.send(source.link, &data(id, ofs as usize, &[]));
            };
            let size = core.files.read(&path).map_or(0, <[u8]>::len);
            let offset = (ofs as usize).min(size);
            let end = offset.saturating_add(count as usize).min(size);
            if offset == end {
                core.outbox.send(source.link, &data(id, offset, &[]));
            } else {
                self.begin(source, Some((path, id)), offset..end, core.now_ns);
            }
        } else if core.read::<LOG_REQUEST_END_DATA>(packet).is_some() {
            self.work.retain(|(client, _)| *client != source);
        } else if core.read::<LOG_ERASE_DATA>(packet).is_some() {
            self.work.clear();
            for path in paths(core) {
                if self.recording.as_ref() != Some(&path) {
                    core.files.remove_own(&path);
                }
            }
        }
    }

    fn serves(&self, command: u16) -> bool {
        matches!(command, LOGGING_START | LOGGING_STOP)
    }

    fn command(&mut self, command: &Command, source: Source, _core: &mut Core) -> Answer {
        self.streams.retain(|(client, _)| *client != source);
        if command.number == LOGGING_START {
            if self.streams.len() >= MAX_DOWNLOADS {
                return Err(Refusal::REJECTED.saying("log streaming denied: four clients have it"));
            }
            self.streams.push((source, Stream::default()));
        }
        Ok(())
    }

    fn due_ns(&self) -> Nanos {
        let send_ns = self.work.first().map_or(Nanos::MAX, |_| self.send_ns);
        self.record_ns.min(send_ns)
    }

    fn step(&mut self, core: &mut Core) {
        if self.record_ns <= core.now_ns {
            self.record_ns = core.now_ns + RECORD_NS;
            self.record(core);
            if let Some(path) = &self.recording {
                for (client, stream) in &mut self.streams {
                    stream.send(*client, path, core);
                }
            }
        }
        if !self.work.is_empty() && self.send_ns <= core.now_ns {
            self.send_ns = core.now_ns + SEND_NS;
            self.work
                .retain_mut(|(client, work)| (0..PACKETS_AT_ONCE).all(|_| work.send(*client, core)));
        }
    }
}

/// The logs from the oldest: the position is a log's number on the link.
fn paths(core: &Core) -> Vec<String> {
    let listed = core.files.list(DIRECTORY).unwrap_or_default();
    listed.iter().map(|(name, _)| format!("{DIRECTORY}/{name}")).collect()
}

/// What LOG_ENTRY says of log number `index`; no logs are reported by a count of 0.
fn entry(core: &Core, index: usize) -> MavMessage {
    let entries = core.files.list(DIRECTORY).unwrap_or_default();
    let log = entries.get(index).map(|(_, log)| log);
    MavMessage::LOG_ENTRY(LOG_ENTRY_DATA {
        time_utc: log.map_or(0, |l| l.modified_s as u32),
        size: log.and_then(|l| l.size()).unwrap_or(0) as u32,
        id: index as u16,
        num_logs: entries.len() as u16,
        last_log_num: entries.len().saturating_sub(1) as u16,
    })
}

fn data(id: u16, ofs: usize, bytes: &[u8]) -> MavMessage {
    MavMessage::LOG_DATA(LOG_DATA_DATA {
        ofs: ofs as u32,
        id,
        count: bytes.len().min(CHUNK) as u8,
        data: padded::<CHUNK>(bytes),
    })
}

impl Work {
    /// Sends the next packet; `false` when that was the last.
    fn send(&mut self, client: Source, core: &mut Core) -> bool {
        let Range { start, end } = self.left;
        if start >= end {
            return false;
        }
        let (message, sent) = match &self.log {
            None => (entry(core, start), 1),
            Some((path, id)) => {
                // Empty where the log was erased meanwhile: that ends it.
                let content = core.files.read(path).unwrap_or_default();
                let bytes = content.get(start..end.min(start + CHUNK)).unwrap_or_default();
                (data(*id, start, bytes), bytes.len())
            }
        };
        core.outbox.send(client.link, &message);
        self.left.start += sent;
        sent > 0 && !self.left.is_empty()
    }
}

impl Stream {
    /// Sends what was written to the log at `path` since the last call.
    fn send(&mut self, client: Source, path: &str, core: &mut Core) {
        if self.path != path {
            self.path = path.to_owned();
            (self.offset, self.message) = (0, 0);
        }
        for _ in 0..STREAM_PACKETS {
            let content = core.files.read(path).unwrap_or_default();
            let to = (self.offset + STREAM_CHUNK).min(content.len());
            let bytes = content.get(self.offset..to).unwrap_or_default();
            if bytes.is_empty() {
                return;
            }
            self.message = ulog::next_message(content, self.message, self.offset);
            let first = self.message.saturating_sub(self.offset);
            let message = message!(
                LOGGING_DATA,
                sequence = self.sequence,
                length = bytes.len() as u8,
                first_message_offset = if first < bytes.len() { first as u8 } else { NO_MESSAGE },
                data = padded::<STREAM_CHUNK>(bytes)
            );
            self.offset = to;
            self.sequence = self.sequence.wrapping_add(1);
            core.outbox.send_to(client, message);
        }
    }
}

impl Logs {
    /// A new request of a client ends what it asked for before.
    fn begin(&mut self, client: Source, log: Option<(String, u16)>, left: Range<usize>, now_ns: Nanos) {
        keep(&mut self.work, MAX_DOWNLOADS, client, Work { log, left });
        self.send_ns = now_ns;
    }

    fn record(&mut self, core: &mut Core) {
        let texts = std::mem::take(&mut core.unlogged);
        let is_armed = core.commander.armed;
        // What is said as it ends is part of it.
        let path = match self.recording.take() {
            Some(path) => path,
            None if is_armed => self.begin_log(core),
            None => return,
        };
        self.recording = is_armed.then(|| path.clone());
        self.bytes.clear();
        for (severity, text) in texts {
            ulog::text(&mut self.bytes, core, severity, &text);
        }
        ulog::record(&mut self.bytes, core);
        let size = core.files.read(&path).map_or(0, <[u8]>::len);
        let is_full = size + self.bytes.len() > MAX_LOG;
        if is_full {
            if std::mem::replace(&mut self.full, true) {
                return;
            }
            self.bytes.clear();
            ulog::text(&mut self.bytes, core, MavSeverity::MAV_SEVERITY_WARNING, "log full");
        }
        core.files.append_own(&path, &self.bytes, core.unix_time_s());
    }

    fn begin_log(&mut self, core: &mut Core) -> String {
        let logs = paths(core);
        let surplus = (logs.len() + 1).saturating_sub(MAX_LOGS);
        for oldest in logs.iter().take(surplus) {
            core.files.remove_own(oldest);
        }
        self.recorded += 1;
        let path = format!("{DIRECTORY}/flight_{:05}.ulg", self.recorded);
        core.files.provide(&path, ulog::begin(core), core.unix_time_s());
        self.full = false;
        path
    }
}
