//! Drives the MCAP reader over a file, as far as the file is complete.

use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::decompressor::{DecompressResult, Decompressor};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use vigil_types::files::{FileError, at};

/// No record or chunk of a log comes near this; a corrupted length must not ask for memory.
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
pub(crate) struct Container {
    file: BufReader<File>,
    reader: LinearReader,
}

impl Container {
    pub(crate) fn open(path: &Path) -> Result<Self, FileError> {
        Ok(Self {
            file: BufReader::new(vigil_types::files::open(path).map_err(at(path))?),
            reader: linear_reader(LinearReaderOptions::default()),
        })
    }

    /// The next record that is `wanted`, judged by its kind and its undecoded bytes.
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
                    return Ok(Next::Record(mcap::parse_record(opcode, data)?.into_owned()));
                }
                Ok(LinearReadEvent::Record { .. }) => (),
                Err(McapError::UnexpectedEof) => return Ok(Next::Cut),
                // The file was read above: this is what unpacks a chunk.
                Err(McapError::Io(error)) => return Err(McapError::DecompressionError(error.to_string())),
                Err(error) => return Err(error),
            }
        }
        Ok(Next::End)
    }
}
