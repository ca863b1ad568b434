//! Makes a closed log of one that was not closed or is damaged: everything that is whole, and what was lost in words.

use crate::log_file::{self, META_END, META_STORY, topic};
use crate::reader::{flight_of, read_step};
use crate::{LogEnd, ReadError, Reader, TickRecord, proto, salvage, tlog};
use mcap::McapError;
use mcap::records::{MessageHeader, Record};
use prost::Message;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use vigil_types::files::{at, folder_of, sync_folder};
use vigil_types::{Nanos, STEP_S};

/// Why a log could not be recovered.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The log itself cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Nothing says which version wrote it.
    #[error("{0} is damaged where it says which version of Vigil wrote it with which settings; nothing was written")]
    Nameless(PathBuf),
    /// There is nothing in it to recover, perhaps because of its chunks' compression.
    #[error(
        "{} holds no whole record{}; nothing was written",
        .0.display(),
        .1.as_deref().map(|name| format!(
            ": its chunks are compressed with `{}`, and lz4, zstd and nothing are what can be read",
            name.escape_debug()
        )).unwrap_or_default()
    )]
    Nothing(PathBuf, Option<String>),
    /// The new file is already there; nothing was touched.
    #[error("{0} already exists and is kept; give another name")]
    Exists(PathBuf),
    /// Whoever asked for it stopped it.
    #[error("interrupted; nothing was written")]
    Interrupted,
    /// The new file cannot be written.
    #[error("{} cannot be written: {}", .0.display(), crate::recorder::describe(.1))]
    Write(PathBuf, McapError),
}

/// What is in the new log, and what is not.
#[derive(Debug, Clone, PartialEq)]
pub struct Recovery {
    /// Records in the new log.
    pub records: u64,
    /// Time from the first of them to the last.
    pub span_s: f64,
    /// How the old log ends.
    pub end: LogEnd,
    /// What is missing between whole records.
    pub gaps: Vec<Gap>,
    /// Records that a closed log counts and that are whole nowhere.
    pub lost: u64,
    /// Bytes of a piece that was cut off at the file's end.
    pub cut_bytes: u64,
    /// How much longer the tlog beside the old log goes on than its whole records, when it does.
    pub tlog_beyond_s: Option<f64>,
}

/// Records that are missing between two that are whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// The last step before it; none if it is at the beginning.
    pub after_step: Option<u64>,
    /// The first step behind it.
    pub before_step: u64,
    /// Records that were in it.
    pub records: u64,
    /// Time without records.
    pub seconds: f64,
}

impl std::fmt::Display for Recovery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} records over {:.2} s are whole", self.records, self.span_s)?;
        for gap in &self.gaps {
            let first = gap.after_step.map_or(0, |step| step + 1);
            let last = gap.before_step.saturating_sub(1);
            write!(
                f,
                "; lost to damage: steps {first} to {last} ({} records, {:.2} s)",
                gap.records, gap.seconds
            )?;
        }
        match self.end {
            LogEnd::Closed { .. } => {
                let inside: u64 = self.gaps.iter().map(|gap| gap.records).sum();
                match self.lost.saturating_sub(inside) {
                    0 => Ok(()),
                    behind => write!(
                        f,
                        "; lost to damage at the end: {behind} records, {:.2} s",
                        behind as f64 * f64::from(STEP_S)
                    ),
                }
            }
            LogEnd::Interrupted { .. } => {
                f.write_str("; the log was not closed, and what came after them is lost")?;
                match self.tlog_beyond_s {
                    Some(seconds) => write!(
                        f,
                        ": by the tlog beside it {seconds:.2} s, about {:.0} records",
                        seconds / f64::from(STEP_S)
                    ),
                    None => f.write_str(": at most a second if the process was killed, more if the file was cut"),
                }?;
                match self.cut_bytes {
                    0 => Ok(()),
                    bytes => write!(f, " ({bytes} bytes of it are an unfinished piece)"),
                }
            }
        }
    }
}

/// Copies every whole record of the log `from` into the new file `to` and closes it: a record is left out only if its own
/// chunk is damaged or cut off. `from` is not changed. The first record behind a gap counts what is missing as dropped, so
/// that a replay stops there.
///
/// # Errors
/// [`RecoverError`] when `from` is no log or holds no whole record, or when `to` exists or cannot be written.
pub fn recover(from: &Path, to: &Path) -> Result<Recovery, RecoverError> {
    recover_until(from, to, &AtomicBool::new(false))
}

/// The same, unless it is to stop before it is done.
///
/// # Errors
/// Those of [`recover`]; [`RecoverError::Interrupted`] when it was stopped: nothing is left of the copy.
pub fn recover_until(from: &Path, to: &Path, stop: &AtomicBool) -> Result<Recovery, RecoverError> {
    let opened = match Reader::open(from) {
        Err(error @ (ReadError::Io(_) | ReadError::NotMcap(_, Some(_)))) => return Err(error.into()),
        // One that lies in another file, as in an archive of several, is not that file.
        Err(error @ ReadError::NotMcap(..)) if !salvage::begins_a_log(from).unwrap_or(false) => {
            return Err(error.into());
        }
        opened => opened,
    };
    let description = salvage::describe(from).map_err(at(from)).map_err(ReadError::Io)?;
    // Whose log it is, and of which version.
    let Some(start) = &description.start else {
        return Err(match opened {
            Ok(_) | Err(ReadError::Damaged { .. }) => RecoverError::Nameless(from.to_owned()),
            Err(error) => error.into(),
        });
    };
    let (_, epoch_offset_ns) = flight_of(from.to_owned(), &start.metadata)?;
    let exists = || RecoverError::Exists(to.to_owned());
    let unwritable = |what: McapError| RecoverError::Write(to.to_owned(), what);
    if to.symlink_metadata().is_ok() {
        return Err(exists());
    }
    // Half a copy would be read as a whole log: it has its name once it is whole.
    let folder = folder_of(to);
    let beside = tempfile::Builder::new()
        .prefix(".vigil-recover.")
        .make_in(folder, |path| File::create_new(path))
        .map_err(|error| unwritable(error.into()))?;
    let failed = |error| match stop.load(Ordering::Relaxed) {
        true => RecoverError::Interrupted,
        false => unwritable(error),
    };
    let copied = copy(from, &description, beside.as_file(), stop).map_err(failed)?;
    if copied.records == 0 {
        let compression = description.unknown_compression.clone();
        return Err(RecoverError::Nothing(from.to_owned(), compression));
    }
    let recovery = copied.recovery(&description, from, epoch_offset_ns);
    beside
        .persist_noclobber(to)
        .map_err(|failed| match failed.error.kind() {
            io::ErrorKind::AlreadyExists => exists(),
            _ => unwritable(failed.error.into()),
        })?;
    sync_folder(folder).map_err(|error| unwritable(error.into()))?;
    Ok(recovery)
}

fn copy<'a>(
    from: &Path,
    description: &salvage::Description,
    to: &'a File,
    stop: &AtomicBool,
) -> Result<Copy<'a>, McapError> {
    let of = |topic: &str| description.channels.values().find(|channel| channel.topic == topic);
    let number = |topic| of(topic).map(|channel| channel.id);
    let mut copy = Copy {
        writer: log_file::write_options().create(BufWriter::new(to))?,
        known: description.channels.keys().copied().collect(),
        depth: number(topic::DEPTH),
        tick: number(topic::TICK),
        group: Vec::new(),
        scratch: Box::default(),
        records: 0,
        first_ns: 0,
        last: None,
        lost: 0,
        gaps: Vec::new(),
        counted: None,
    };
    if let Some(start) = &description.start {
        copy.writer.write_metadata(start)?;
    }
    if description.channels.is_empty() {
        // Those of this version, which numbers them as the one that wrote the log did: the format is the same.
        let channels = log_file::register(&mut copy.writer, &log_file::RECORDED)?;
        let number = |topic: &str| channels.get(topic).copied();
        (copy.depth, copy.tick) = (number(topic::DEPTH), number(topic::TICK));
        copy.known.extend(channels.values());
    }
    for (header, data) in description.schemas.values() {
        copy.writer
            .add_schema_with_id(header.id, &header.name, &header.encoding, data)?;
    }
    for channel in description.channels.values() {
        // None where it is lost.
        let schema = Some(channel.schema_id).filter(|id| description.schemas.contains_key(id));
        copy.writer.add_channel_with_id(
            channel.id,
            schema.unwrap_or(0),
            &channel.topic,
            &channel.message_encoding,
            &channel.metadata,
        )?;
    }
    salvage::walk(from, &mut |piece| match piece {
        _ if stop.load(Ordering::Relaxed) => Err(io::Error::from(io::ErrorKind::Interrupted).into()),
        Record::Message { header, data } => copy.take(header, data.into_owned()),
        Record::Metadata(metadata) if metadata.name == META_END => {
            let number = |key: &str| metadata.metadata.get(key).and_then(|text| text.parse().ok());
            copy.counted = number("records").zip(number("dropped"));
            Ok(())
        }
        Record::Metadata(metadata) if metadata.name == META_STORY => copy.writer.write_metadata(&metadata),
        Record::Attachment { header, data, .. } => log_file::attach(&mut copy.writer, header, &data),
        _ => Ok(()),
    })?;
    copy.end_group()?;
    if let Some((counted, dropped)) = copy.counted {
        let lost = counted.saturating_sub(copy.records);
        copy.writer
            .write_metadata(&log_file::end_metadata(copy.records, dropped.saturating_add(lost)))?;
    }
    copy.writer.finish()?;
    to.sync_all()?;
    Ok(copy)
}

/// What was copied so far.
struct Copy<'a> {
    writer: mcap::Writer<BufWriter<&'a File>>,
    /// The channels of the copy: a message of another has a damaged number, or what says whose it was is lost.
    known: BTreeSet<u16>,
    depth: Option<u16>,
    tick: Option<u16>,
    /// The messages of one record: they follow one another and have the same number and time.
    group: Vec<(MessageHeader, Vec<u8>)>,
    scratch: Box<TickRecord>,
    records: u64,
    first_ns: Nanos,
    /// Step, time and dropped records of the last one.
    last: Option<(u64, Nanos, u64)>,
    lost: u64,
    gaps: Vec<Gap>,
    counted: Option<(u64, u64)>,
}

impl Copy<'_> {
    fn take(&mut self, header: MessageHeader, data: Vec<u8>) -> Result<(), McapError> {
        if !self.known.contains(&header.channel_id) {
            return Ok(());
        }
        let is_next = self
            .group
            .first()
            .is_some_and(|(first, _)| (first.sequence, first.log_time) != (header.sequence, header.log_time));
        if is_next {
            self.end_group()?;
        }
        self.group.push((header, data));
        Ok(())
    }

    /// Writes the record that was being put together, if it is whole.
    fn end_group(&mut self) -> Result<(), McapError> {
        let mut group = std::mem::take(&mut self.group);
        let of_record = [self.tick, self.depth];
        let Some(mut tick) = self.whole(&group) else {
            // Of no record is what the simulation or a replay added.
            let mut channels = group.iter().map(|(header, _)| Some(header.channel_id));
            if !channels.any(|channel| of_record.contains(&channel)) {
                for (header, data) in group {
                    self.writer.write_to_known_channel(&header, &data)?;
                }
            }
            return Ok(());
        };
        let (step, now_ns, dropped) = (self.scratch.timing.step, self.scratch.now_ns, tick.dropped_before);
        // Who joins files that overlap writes a step twice.
        if self
            .last
            .is_some_and(|(last, then_ns, _)| step <= last && now_ns <= then_ns)
        {
            return Ok(());
        }
        let (expected, dropped_then) = self
            .last
            .map_or((0, 0), |(last, _, dropped)| (last.saturating_add(1), dropped));
        let missing = step
            .saturating_sub(expected)
            .saturating_sub(dropped.saturating_sub(dropped_then));
        if missing > 0 {
            let seconds = match self.last {
                Some((_, then_ns, _)) => now_ns.saturating_sub(then_ns) as f64 * 1e-9 - f64::from(STEP_S),
                None => missing as f64 * f64::from(STEP_S),
            };
            self.gaps.push(Gap {
                after_step: self.last.map(|(last, _, _)| last),
                before_step: step,
                records: missing,
                seconds: seconds.max(0.0),
            });
            self.lost = self.lost.saturating_add(missing);
        }
        if self.records == 0 {
            self.first_ns = now_ns;
        }
        self.last = Some((step, now_ns, dropped));
        self.records += 1;
        // Side by side too, and in any order: a reader expects an image before its step.
        group.sort_by_key(|(header, _)| Some(header.channel_id) == self.tick);
        let mut written = BTreeSet::new();
        for (header, data) in group {
            let channel = Some(header.channel_id);
            if of_record.contains(&channel) && !written.insert(channel) {
                continue;
            }
            if channel == self.tick && self.lost > 0 {
                tick.dropped_before = tick.dropped_before.saturating_add(self.lost);
                self.writer.write_to_known_channel(&header, &tick.encode_to_vec())?;
            } else {
                self.writer.write_to_known_channel(&header, &data)?;
            }
        }
        Ok(())
    }

    /// The step's message of a record that a reader accepts.
    fn whole(&mut self, group: &[(MessageHeader, Vec<u8>)]) -> Option<proto::Tick> {
        let of = |channel: Option<u16>| {
            let (header, data) = group.iter().find(|(header, _)| Some(header.channel_id) == channel)?;
            Some((header.sequence, data.as_slice()))
        };
        read_step(of(self.tick)?.1, of(self.depth), &mut self.scratch).ok()
    }

    fn recovery(self, description: &salvage::Description, from: &Path, epoch_offset_ns: u64) -> Recovery {
        let last_ns = self.last.map_or(0, |(_, at_ns, _)| at_ns);
        let beyond_s = tlog::last_stamp_ns(&from.with_extension("tlog"))
            .map(|at_ns| at_ns.saturating_sub(last_ns.saturating_add(epoch_offset_ns)) as f64 * 1e-9)
            .filter(|beyond_s| *beyond_s >= f64::from(STEP_S));
        Recovery {
            records: self.records,
            span_s: last_ns.saturating_sub(self.first_ns) as f64 * 1e-9,
            end: match self.counted {
                Some((_, dropped)) => LogEnd::Closed { dropped },
                None => LogEnd::Interrupted { records: self.records },
            },
            gaps: self.gaps,
            lost: self
                .counted
                .map_or(0, |(counted, _)| counted.saturating_sub(self.records)),
            cut_bytes: description.cut_bytes,
            tlog_beyond_s: beyond_s.filter(|_| self.counted.is_none()),
        }
    }
}
