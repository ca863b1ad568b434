//! Walks through the pieces of an MCAP file that are whole, around those that are damaged or cut off.
//!
//! A file is a row of records: an opcode of one byte, a length of eight, the content. Messages lie in chunks, which have a
//! checksum. Where a length is damaged the next chunk is found by its form: behind opcode and length two times, size,
//! checksum, and the name of the compression, whose stored size must agree with the record's length.

use crate::log_file::META;
use mcap::McapError;
use mcap::read::ChunkReader;
use mcap::records::{Channel, ChunkHeader, Metadata, Record, SchemaHeader, op};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// No record or chunk of a log comes near this; a corrupted length must not ask for memory.
pub(crate) const LENGTH_LIMIT: u64 = 64 << 20;
/// Bytes of the mark at the file's beginning.
const MAGIC: u64 = 8;
/// Opcode and length.
const HEAD: u64 = 9;
/// What [`write_options`](crate::log_file::write_options) compresses with, as a chunk names it.
const COMPRESSION: &[u8] = b"\x03\0\0\0lz4";
/// Where that name stands in a chunk, from its opcode on.
const COMPRESSION_AT: u64 = HEAD + 8 + 8 + 8 + 4;
/// A chunk's content begins so far behind its length.
const CHUNK_HEAD: u64 = 8 + 8 + 8 + 4 + COMPRESSION.len() as u64 + 8;

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
}

/// Reads what describes the messages.
pub(crate) fn describe(path: &Path) -> io::Result<Description> {
    let mut description = Description::default();
    let cut_bytes = walk(path, &mut |record| {
        match record {
            Record::Metadata(metadata) if metadata.name == META => description.start = Some(metadata),
            Record::Schema { header, data } => {
                description.schemas.insert(header.id, (header, data.into_owned()));
            }
            Record::Channel(channel) => {
                description.channels.insert(channel.id, channel);
            }
            _ => {}
        }
        Ok(())
    })
    .map_err(|error| match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    })?;
    description.cut_bytes = cut_bytes;
    Ok(description)
}

/// Hands over every whole record, those of chunks included, in the order of the file.
pub(crate) fn pieces(
    path: &Path,
    mut take: impl FnMut(Record<'static>) -> Result<(), McapError>,
) -> Result<(), McapError> {
    walk(path, &mut take).map(|_| ())
}

fn walk(path: &Path, take: &mut dyn FnMut(Record<'static>) -> Result<(), McapError>) -> Result<u64, McapError> {
    let file = vigil_files::open(path)?;
    let size = file.metadata()?.len();
    let mut at = MAGIC;
    while at < size {
        let Some((opcode, length)) = head(&file, at, size)? else {
            // A length that was damaged, or the end that was cut off.
            match find_chunk(&file, at + 1, size)? {
                Some(next) => at = next,
                None => return Ok(size - at),
            }
            continue;
        };
        let (content, end) = (at + HEAD, at + HEAD + length);
        let whole = match opcode {
            op::CHUNK => chunk(&read(&file, content, length)?),
            op::METADATA | op::SCHEMA | op::CHANNEL => mcap::parse_record(opcode, &read(&file, content, length)?)
                .map(|record| vec![record.into_owned()])
                .ok(),
            // Only the mark follows.
            op::FOOTER => return Ok(0),
            _ => Some(Vec::new()),
        };
        let is_whole = whole.is_some();
        for record in whole.into_iter().flatten() {
            take(record)?;
        }
        let trusted = is_whole || end == size || head(&file, end, size)?.is_some();
        at = match trusted {
            true => end,
            // The piece is damaged, and so may be its length.
            false => find_chunk(&file, at + 1, size)?.unwrap_or(size),
        };
    }
    Ok(0)
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
    let possible = (op::HEADER..=op::DATA_END).contains(opcode) && length <= LENGTH_LIMIT && at + HEAD + length <= size;
    Ok(possible.then_some((*opcode, length)))
}

fn read(file: &File, at: u64, length: u64) -> io::Result<Vec<u8>> {
    // At most LENGTH_LIMIT.
    let mut bytes = vec![0; length as usize];
    file.read_exact_at(&mut bytes, at)?;
    Ok(bytes)
}

/// The records of a chunk; none if anything in it is damaged.
fn chunk(bytes: &[u8]) -> Option<Vec<Record<'static>>> {
    let (head, content) = bytes.split_at_checked(CHUNK_HEAD as usize)?;
    let number = |at: usize| {
        head.get(at..at + 8)
            .map(|b| u64::from_le_bytes(b.try_into().unwrap_or_default()))
    };
    let crc = head.get(24..28)?;
    let header = ChunkHeader {
        message_start_time: number(0)?,
        message_end_time: number(8)?,
        uncompressed_size: number(16).filter(|size| *size <= LENGTH_LIMIT)?,
        uncompressed_crc: u32::from_le_bytes(crc.try_into().unwrap_or_default()),
        compression: "lz4".to_owned(),
        compressed_size: number(CHUNK_HEAD as usize - 8)?,
    };
    if head.get(28..28 + COMPRESSION.len())? != COMPRESSION || header.compressed_size != content.len() as u64 {
        return None;
    }
    let records = ChunkReader::new(header, content).ok()?;
    records
        .map(|record| record.map(Record::into_owned))
        .collect::<Result<_, _>>()
        .ok()
}

/// The next place from `from` on at which a chunk begins, by its form.
fn find_chunk(file: &File, from: u64, size: u64) -> io::Result<Option<u64>> {
    const WINDOW: u64 = 1 << 20;
    // Neighbouring windows overlap by the mark that is looked for.
    let overlap = COMPRESSION.len() as u64 - 1;
    let mut at = from + COMPRESSION_AT;
    while at + overlap < size {
        let bytes = read(file, at, WINDOW.min(size - at))?;
        let marks = bytes.windows(COMPRESSION.len()).enumerate();
        for (offset, _) in marks.filter(|(_, window)| *window == COMPRESSION) {
            let begin = at + offset as u64 - COMPRESSION_AT;
            if let Some((op::CHUNK, length)) = head(file, begin, size)?
                && length >= CHUNK_HEAD
            {
                let stored = read(file, begin + HEAD + CHUNK_HEAD - 8, 8)?;
                if u64::from_le_bytes(stored.try_into().unwrap_or_default()) == length - CHUNK_HEAD {
                    return Ok(Some(begin));
                }
            }
        }
        at += WINDOW - overlap;
    }
    Ok(None)
}
