//! Drives the MCAP reader over a file, as far as the file is complete.

use crate::salvage::LENGTH_LIMIT;
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

/// What comes next in a file.
pub(crate) enum Next {
    /// A record that was wanted.
    Record(Record<'static>),
    /// The footer: the file is complete.
    End,
    /// The file ends before its footer.
    Cut,
}

/// An MCAP file being read from its start. Chunks whose checksum does not match give an error, not records.
pub(crate) struct Container {
    file: BufReader<File>,
    reader: LinearReader,
}

impl Container {
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(LENGTH_LIMIT as usize);
        Ok(Self {
            file: BufReader::new(vigil_files::open(path)?),
            reader: LinearReader::new_with_options(options),
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
                Err(error) => return Err(error),
            }
        }
        Ok(Next::End)
    }
}
