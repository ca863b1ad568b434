//! Makes a closed log of one that was not closed, for viewers that insist on the index at the end.

use crate::container::{Container, Next};
use crate::{LogEnd, ReadError, Reader, file};
use mcap::McapError;
use mcap::records::{Record, op};
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

/// Why a log could not be recovered.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The log itself cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The new file is already there; nothing was touched.
    #[error("{path} already exists and is kept; give another name")]
    Exists {
        /// The new file.
        path: PathBuf,
    },
    /// The new file cannot be written.
    #[error("{path} cannot be written: {source}")]
    Write {
        /// The new file.
        path: PathBuf,
        /// What went wrong.
        source: McapError,
    },
}

/// Copies the complete part of the log `from` into the new file `to` and closes it. `from` is not changed. Returns how
/// `from` ends.
///
/// # Errors
/// [`RecoverError`] when `from` is no log or is damaged before its end, or when `to` exists or cannot be written.
pub fn recover(from: &Path, to: &Path) -> Result<LogEnd, RecoverError> {
    // A first pass checks every record, so that no damaged log is dressed up as a good one.
    let mut reader = Reader::open(from)?;
    let mut record = Box::default();
    while reader.read_next(&mut record)? {}
    let end = reader.end().unwrap_or(LogEnd::Interrupted { records: 0 });

    let sink = File::create_new(to).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => RecoverError::Exists { path: to.to_owned() },
        _ => RecoverError::Write {
            path: to.to_owned(),
            source: error.into(),
        },
    })?;
    copy(from, sink).map_err(|source| RecoverError::Write {
        path: to.to_owned(),
        source,
    })?;
    Ok(end)
}

fn copy(from: &Path, to: File) -> Result<(), McapError> {
    let mut source = Container::open(from)?;
    let mut writer = file::write_options().create(BufWriter::new(to))?;
    // Schemas and channels that the summary at the end repeats have the same numbers and are written once.
    let wanted = |opcode, _: &[u8]| matches!(opcode, op::METADATA | op::SCHEMA | op::CHANNEL | op::MESSAGE);
    while let Next::Record(record) = source.next(wanted)? {
        match record {
            Record::Metadata(metadata) => writer.write_metadata(&metadata)?,
            Record::Schema { header, data } => {
                writer.add_schema_with_id(header.id, &header.name, &header.encoding, &data)?;
            }
            Record::Channel(c) => {
                writer.add_channel_with_id(c.id, c.schema_id, &c.topic, &c.message_encoding, &c.metadata)?;
            }
            Record::Message { header, data } => writer.write_to_known_channel(&header, &data)?,
            _ => (),
        }
    }
    writer.finish()?;
    Ok(())
}
