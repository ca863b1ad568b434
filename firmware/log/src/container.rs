//! Drives the MCAP reader over a file, as far as the file is complete.

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::decompressor::{DecompressResult, Decompressor};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use vigil_types::files::{FileError, at};

/// No record or chunk of a log comes near this, but what somebody attached to it; a corrupted length must not ask for memory.
pub(crate) const LENGTH_LIMIT: u64 = 64 << 20;

/// What comes next in a file.
pub(crate) enum Next {
    /// A record that was wanted.
    Record(Record<'static>),
    /// The footer: the file is complete.
    End,
    /// The file ends before its footer.
    Cut,
}

/// A reader of MCAP as all of this crate's are: a chunk's checksum comes before its records, no length is believed that is beyond all
/// records, and chunks may be packed by LZ4, by Zstandard, or not at all.
pub(crate) fn linear_reader(options: LinearReaderOptions) -> LinearReader {
    let options = options
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(LENGTH_LIMIT as usize);
    let mut reader = LinearReader::new_with_options(options);
    // Refused are only those without a name.
    let _ = reader.add_decompressor(Zstandard::default());
    reader
}

/// A record by its content. The library believes that an attachment goes on to its checksum, and panics where it does not; what lies
/// behind it would go with it.
pub(crate) fn parse(opcode: u8, data: &[u8]) -> Result<Record<'static>, McapError> {
    let text_end = |at: usize| Some(at + 4 + u32::from_le_bytes(*data.get(at..)?.first_chunk()?) as usize);
    // Behind two times and two texts stand the length and, behind the content, the checksum.
    let texts_end = text_end(16).and_then(text_end);
    let end =
        texts_end.and_then(|at| u64::from_le_bytes(*data.get(at..)?.first_chunk()?).checked_add(at as u64 + 8 + 4));
    if opcode == op::ATTACHMENT && end != Some(data.len() as u64) {
        return Err(McapError::UnexpectedEof);
    }
    Ok(mcap::parse_record(opcode, data)?.into_owned())
}

/// Unpacks Zstandard. Logs of ours are packed by LZ4; other programs write them anew so.
#[derive(Default)]
struct Zstandard(ruzstd::decoding::FrameDecoder);

impl Decompressor for Zstandard {
    fn next_read_size(&self) -> usize {
        // A whole block with the headers before it.
        (128 << 10) + 32
    }

    fn decompress(&mut self, packed: &[u8], to: &mut [u8]) -> Result<DecompressResult, McapError> {
        if self.0.is_finished() && self.0.can_collect() == 0 {
            // Another frame.
            self.0 = ruzstd::decoding::FrameDecoder::new();
        }
        let (consumed, wrote) = self
            .0
            .decode_from_to(packed, to)
            .map_err(|error| McapError::DecompressionError(error.to_string()))?;
        Ok(DecompressResult { consumed, wrote })
    }

    fn reset(&mut self) -> Result<(), McapError> {
        *self = Self::default();
        Ok(())
    }

    fn name(&self) -> &'static str {
        "zstd"
    }
}

/// An MCAP file being read from its start. Chunks whose checksum does not match give an error, not records.
pub(crate) struct Container<R = BufReader<File>> {
    pub(crate) file: R,
    pub(crate) reader: LinearReader,
}

impl Container {
    pub(crate) fn open(path: &Path) -> Result<Self, FileError> {
        Ok(Self::new(vigil_types::files::open(path).map_err(at(path))?))
    }

    pub(crate) fn new(file: File) -> Self {
        Self {
            file: BufReader::new(file),
            reader: linear_reader(LinearReaderOptions::default()),
        }
    }
}

impl<R: Read> Container<R> {
    /// The next channel, metadata, or message of one of these channels.
    pub(crate) fn next_of(&mut self, channels: &BTreeMap<u16, String>) -> Result<Next, McapError> {
        self.next(|opcode, data| match opcode {
            op::CHANNEL | op::METADATA => true,
            op::MESSAGE => data
                .split_first_chunk()
                .is_none_or(|(id, _)| channels.contains_key(&u16::from_le_bytes(*id))),
            _ => false,
        })
    }

    /// The next record that is `wanted`, as shown by its kind and its undecoded bytes.
    pub(crate) fn next(&mut self, wanted: impl Fn(u8, &[u8]) -> bool) -> Result<Next, McapError> {
        while let Some(event) = self.reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(need)) => {
                    let read = loop {
                        match self.file.read(self.reader.insert(need)) {
                            Err(error) if error.kind() == io::ErrorKind::Interrupted => (),
                            result => break result?,
                        }
                    };
                    self.reader.notify_read(read);
                }
                Ok(LinearReadEvent::Record { opcode, data }) if wanted(opcode, data) => {
                    return Ok(Next::Record(parse(opcode, data)?));
                }
                Ok(LinearReadEvent::Record { .. }) => (),
                Err(McapError::UnexpectedEof) => return Ok(Next::Cut),
                // The reader asks for no byte too many: what comes next in the file is the content, as far as there is one.
                Err(McapError::RecordTooLarge { opcode, len }) if opcode == op::ATTACHMENT => {
                    // By its kind alone: one that nobody wants takes no memory.
                    let (is_wanted, mut data) = (wanted(opcode, &[]), Vec::new());
                    let mut content = self.file.by_ref().take(len);
                    let read = match is_wanted {
                        true => content.read_to_end(&mut data)? as u64,
                        false => io::copy(&mut content, &mut io::sink())?,
                    };
                    if read < len {
                        return Ok(Next::Cut);
                    }
                    self.reader = linear_reader(LinearReaderOptions::default().with_skip_start_magic(true));
                    if is_wanted {
                        return Ok(Next::Record(parse(opcode, &data)?));
                    }
                }
                // The file was read above: this is what unpacks a chunk.
                Err(McapError::Io(error)) => return Err(McapError::DecompressionError(error.to_string())),
                Err(error) => return Err(error),
            }
        }
        Ok(Next::End)
    }
}
