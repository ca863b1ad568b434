//! Walks through the pieces of an MCAP file that are whole, around those that are damaged or cut off.
//!
//! A file is a row of records: an opcode of one byte, a length of eight, the content. Messages lie in chunks, which have a
//! checksum; a log that other programs wrote anew may have its messages outside of any chunk. Where a length is damaged the next
//! piece is found by its form: of a chunk, behind opcode and length two times, size, checksum, and the name of the compression,
//! the stored size, which must agree with the record's length; of a message, the records that follow it.

use crate::FlightInfo;
use crate::container::{Container, LENGTH_LIMIT, Next, linear_reader, parse};
use crate::log_file::META;
use mcap::McapError;
use mcap::records::{Channel, Metadata, Record, SchemaHeader, op};
use mcap::sans_io::linear_reader::LinearReaderOptions;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Bytes of the mark at the file's beginning.
const MAGIC: u64 = 8;
/// Opcode and length.
const HEAD: u64 = 9;
/// Times, size and checksum stand before a chunk's compression, which is a length of four bytes and a name.
const NAME_AT: usize = 8 + 8 + 8 + 4;
/// No compression has a longer name.
const LONGEST_NAME: usize = 32;
/// A message's channel, number and times.
const MESSAGE_HEAD: u64 = 2 + 4 + 8 + 8;
/// So many records have to follow a message that is found by its form.
const FOLLOWERS: usize = 3;
/// The metadata of a log that its recorder wrote begin within so many bytes of its beginning.
const START_WITHIN: u64 = 4 << 10;
/// No log's metadata are longer.
const LONGEST_START: u64 = 1 << 20;
/// So many places are looked at that may be a log's metadata: one of its own, and those of logs attached to it.
const START_PLACES: usize = 8;

/// What has to be known of a file before its messages are copied.
#[derive(Default)]
pub(crate) struct Description {
    /// The metadata at its start.
    pub(crate) start: Option<Metadata>,
    /// Schemas and channels by number, from chunks or from the summary at the end.
    pub(crate) schemas: BTreeMap<u16, (SchemaHeader, Vec<u8>)>,
    pub(crate) channels: BTreeMap<u16, Channel>,
    /// Bytes of a piece that the end of the file cuts off.
    pub(crate) cut_bytes: u64,
    /// Where the first piece begins that is damaged, bytes from the file's beginning.
    pub(crate) damaged_at: Option<u64>,
    /// A compression that none of the chunks' readers knows.
    pub(crate) unknown_compression: Option<String>,
}

/// Reads what describes the messages.
pub(crate) fn describe(path: &Path) -> io::Result<Description> {
    let (mut start, mut schemas, mut channels) = (None, BTreeMap::new(), BTreeMap::new());
    let walked = walk(path, &mut |record| {
        match record {
            Record::Metadata(metadata) if metadata.name == META => start = Some(metadata),
            // What the summary says again has no checksum: a topic has one channel.
            Record::Schema { header, data } if header.id != 0 => {
                schemas.entry(header.id).or_insert((header, data.into_owned()));
            }
            Record::Channel(channel) if channels.values().all(|known: &Channel| known.topic != channel.topic) => {
                channels.entry(channel.id).or_insert(channel);
            }
            _ => {}
        }
        Ok(())
    })
    .map_err(|error| match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    })?;
    if start.is_none() {
        start = find_start(path)?;
    }
    Ok(Description {
        start,
        schemas,
        channels,
        ..walked
    })
}

/// How a log's metadata begin, behind opcode and length.
fn start_name() -> Vec<u8> {
    [&(META.len() as u32).to_le_bytes(), META.as_bytes()].concat()
}

/// Whether a file without MCAP's mark at its beginning has a log's metadata near it all the same, and not behind the mark of a log
/// within the file.
pub(crate) fn begins_a_log(path: &Path) -> io::Result<bool> {
    let file = vigil_types::files::open(path)?;
    let bytes = read(&file, 0, START_WITHIN.min(file.metadata()?.len()))?;
    let first = |part: &[u8]| bytes.windows(part.len()).position(|window| window == part);
    Ok(first(&start_name()).is_some_and(|start| first(mcap::MAGIC).is_none_or(|mark| mark == 0 || mark > start)))
}

/// The metadata of a log that stand behind a damaged opcode or length: where they end they say themselves.
fn find_start(path: &Path) -> io::Result<Option<Metadata>> {
    let file = vigil_types::files::open(path)?;
    let size = file.metadata()?.len();
    let (name, mut places) = (start_name(), 0);
    let found = find(&file, MAGIC, size, |at, window| {
        // A log within this one, or its end.
        if window.starts_with(mcap::MAGIC) {
            return Ok(Some(None));
        }
        if !window.starts_with(&name) {
            return Ok(None);
        }
        places += 1;
        let content = read(&file, at, LONGEST_START.min(size - at))?;
        let start = match parse(op::METADATA, &content) {
            Ok(Record::Metadata(start)) if FlightInfo::format_version(&start.metadata).is_some() => Some(start),
            _ => None,
        };
        Ok((start.is_some() || places == START_PLACES).then_some(start))
    })?;
    Ok(found.flatten())
}

/// Hands every whole record to `take`, those of chunks included, in the order of the file; what is not whole is described.
pub(crate) fn walk(
    path: &Path,
    take: &mut dyn FnMut(Record<'static>) -> Result<(), McapError>,
) -> Result<Description, McapError> {
    let file = vigil_types::files::open(path)?;
    let size = file.metadata()?.len();
    let mut walked = Description::default();
    // Packed messages may lie in a damaged chunk as they are, or nearly: only a file without chunks has them by their form.
    let kind = match find_piece(&file, MAGIC, size, op::CHUNK)? {
        Some(_) => op::CHUNK,
        None => op::MESSAGE,
    };
    // The channels that a message outside of chunks may have.
    let mut channels = BTreeSet::new();
    let mut at = MAGIC;
    while at < size {
        let Some((opcode, length)) = head(&file, at, size)? else {
            walked.damaged_at.get_or_insert(at);
            // A length that was damaged, or the end that was cut off.
            match find_piece(&file, at + 1, size, kind)? {
                Some(next) => at = next,
                None => {
                    walked.cut_bytes = size - at;
                    return Ok(walked);
                }
            }
            continue;
        };
        let (content, end) = (at + HEAD, at + HEAD + length);
        let is_followed = end == size || head(&file, end, size)?.is_some();
        let whole = match opcode {
            op::CHUNK => {
                let bytes = read(&file, content, length)?;
                chunk(&bytes).unwrap_or_else(|error| {
                    if let McapError::UnsupportedCompression(name) = error {
                        walked.unknown_compression.get_or_insert(name);
                    }
                    None
                })
            }
            op::MESSAGE if kind == op::CHUNK && !is_followed => None,
            op::MESSAGE if kind == op::CHUNK => loose(&read(&file, content, length)?, &channels),
            // The summary repeats channels and has no messages.
            op::DATA_END => {
                channels.clear();
                Some(Vec::new())
            }
            op::METADATA | op::ATTACHMENT | op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                let record = parse(opcode, &read(&file, content, length)?);
                record.map(|record| vec![record]).ok()
            }
            // Only the mark follows, as far as there is one.
            op::FOOTER if mcap::MAGIC.starts_with(&read(&file, end, MAGIC.min(size - end))?) => return Ok(walked),
            _ => Some(Vec::new()),
        };
        let is_whole = whole.is_some();
        // A length without a checksum is believed where something follows it, and a damaged piece's too. An attachment may hold a log.
        let trusted = is_whole && [op::CHUNK, op::ATTACHMENT].contains(&opcode) || is_followed;
        // A chunk may be whole beside a length that is not its own.
        if !is_whole || opcode == op::CHUNK && !is_piece(&file, at, size)? {
            walked.damaged_at.get_or_insert(at);
        }
        for record in whole.into_iter().flatten() {
            if let Record::Channel(channel) = &record {
                channels.insert(channel.id);
            }
            take(record)?;
        }
        at = match trusted {
            true => end,
            false => {
                let next = find_piece(&file, at + 1, size, kind)?.unwrap_or(if is_whole { end } else { size });
                // Its own length where it hid a piece; else what follows it.
                walked.damaged_at.get_or_insert(if next < end { at } else { end });
                next
            }
        };
    }
    Ok(walked)
}

/// The message with this content, outside of chunks in a file that has some, if it is no other piece whose opcode was damaged: its
/// channel stands before it. A chunk's index has a channel too, then a length and, of each message, the time and the place.
fn loose(content: &[u8], channels: &BTreeSet<u16>) -> Option<Vec<Record<'static>>> {
    let record = parse(op::MESSAGE, content).ok()?;
    let Record::Message { header, .. } = &record else {
        return None;
    };
    let is_index = u64::from(header.sequence) + 2 + 4 == content.len() as u64 && header.publish_time < LENGTH_LIMIT;
    (channels.contains(&header.channel_id) && !is_index).then(|| vec![record])
}

/// Opcode and length of the record at `at`, if there can be one that lies within the file.
fn head(file: &File, at: u64, size: u64) -> io::Result<Option<(u8, u64)>> {
    if at + HEAD > size {
        return Ok(None);
    }
    let bytes = read(file, at, HEAD)?;
    let Some((opcode, length)) = bytes.split_first() else {
        return Ok(None);
    };
    let length = u64::from_le_bytes(length.try_into().unwrap_or_default());
    let longest = if *opcode == op::ATTACHMENT { size } else { LENGTH_LIMIT };
    let possible = (op::HEADER..=op::DATA_END).contains(opcode) && length <= longest.min(size - at - HEAD);
    Ok(possible.then_some((*opcode, length)))
}

fn read(file: &File, at: u64, length: u64) -> io::Result<Vec<u8>> {
    // At most LENGTH_LIMIT, of an attachment what the file has.
    let mut bytes = vec![0; length as usize];
    file.read_exact_at(&mut bytes, at)?;
    Ok(bytes)
}

/// Whether what stands before a chunk's records, at the beginning of `bytes`, is that of a chunk of this length; `None` where it is cut.
fn is_chunk(bytes: &[u8], length: u64) -> Option<bool> {
    let number = |at: usize| Some(u64::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
    let name_len = u32::from_le_bytes(*bytes.get(NAME_AT..)?.first_chunk()?) as usize;
    let name = bytes.get(NAME_AT + 4..)?.get(..name_len)?;
    // One more letter in the name is damage; another name altogether is no chunk's.
    let is_named = name_len <= LONGEST_NAME && name.iter().all(u8::is_ascii_graphic);
    let end = NAME_AT + 4 + name_len;
    let is_whole = number(end)?.checked_add(end as u64 + 8) == Some(length);
    Some(is_named && is_whole && number(16)? <= LENGTH_LIMIT)
}

/// The records of a chunk, of which `bytes` is the content; none if anything in it is damaged.
///
/// # Errors
/// A compression that is not known.
fn chunk(bytes: &[u8]) -> Result<Option<Vec<Record<'static>>>, McapError> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true);
    let length = (bytes.len() as u64).to_le_bytes();
    let whole = [&[op::CHUNK], length.as_slice(), bytes].concat();
    let mut container = Container {
        file: whole.as_slice(),
        reader: linear_reader(options),
    };
    let mut records = Vec::new();
    loop {
        match container.next(|_, _| true) {
            Ok(Next::Record(record)) => records.push(record),
            Ok(Next::End) => return Ok(Some(records)),
            Err(error @ McapError::UnsupportedCompression(_)) => return Err(error),
            Ok(Next::Cut) | Err(_) => return Ok(None),
        }
    }
}

/// The next place from `from` on at which a piece of this kind, chunk or message, begins, by its form.
fn find_piece(file: &File, from: u64, size: u64, kind: u8) -> io::Result<Option<u64>> {
    find(file, from, size, |at, window| {
        // The upper half of a length is zero (LENGTH_LIMIT).
        let possible = window.first() == Some(&kind) && window.get(5..) == Some(&[0; 4]);
        Ok((possible && is_piece(file, at, size)?).then_some(at))
    })
}

/// What `seek` finds first from `from` on, of each place and the bytes there, as many as opcode and length have.
fn find<T>(
    file: &File,
    from: u64,
    size: u64,
    mut seek: impl FnMut(u64, &[u8]) -> io::Result<Option<T>>,
) -> io::Result<Option<T>> {
    const WINDOW: u64 = 1 << 20;
    let mut at = from;
    while at + HEAD < size {
        let bytes = read(file, at, WINDOW.min(size - at))?;
        for (window, at) in bytes.windows(HEAD as usize).zip(at..) {
            if let Some(found) = seek(at, window)? {
                return Ok(Some(found));
            }
        }
        // Neighbouring windows overlap by what is looked at.
        at += WINDOW - HEAD + 1;
    }
    Ok(None)
}

/// Whether a chunk or a message begins at `at`, by its form.
fn is_piece(file: &File, at: u64, size: u64) -> io::Result<bool> {
    match head(file, at, size)? {
        Some((op::CHUNK, length)) => {
            let most = (NAME_AT + 4 + LONGEST_NAME + 8) as u64;
            Ok(is_chunk(&read(file, at + HEAD, length.min(most))?, length) == Some(true))
        }
        Some((op::MESSAGE, length)) if length >= MESSAGE_HEAD => {
            let mut next = at + HEAD + length;
            for _ in 0..FOLLOWERS {
                next = match head(file, next, size)? {
                    Some((op::FOOTER, _)) => return Ok(true),
                    Some((_, length)) => next + HEAD + length,
                    None => return Ok(next == size),
                };
            }
            Ok(true)
        }
        _ => Ok(false),
    }
}
