//! Reads a log back, record by record and bit for bit.

use crate::container::{Container, Next};
use crate::log_file::{LOG_FORMAT, META, META_END, topic};
use crate::proto::foxglove::RawImage;
use crate::{FlightInfo, TickRecord, convert, display, proto, salvage};
use mcap::McapError;
use mcap::records::Record;
use prost::Message;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use vigil_types::files::{FileError, at};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, Nanos};

/// Why a log cannot be read, or cannot be read any further.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("log file {0}")]
    Io(#[from] FileError),
    /// Not an MCAP file; what it is by its first bytes, if that is known.
    #[error(
        "{} is no MCAP file{}; give the .mcap file of a flight",
        .0.display(),
        .1.map(|kind| format!(" but {kind}")).unwrap_or_default()
    )]
    NotMcap(PathBuf, Option<&'static str>),
    /// An MCAP file of another program.
    #[error("{0} is an MCAP file but no flight log of Vigil: it holds no metadata \"vigil\"")]
    NotALog(PathBuf),
    /// The file ends before its first record.
    #[error("{0} ends within its first bytes: the recording was stopped before anything was written")]
    Empty(PathBuf),
    /// A log of another format version: which, and what wrote it.
    #[error(
        "{} has log format {}, this program reads {LOG_FORMAT}; read it with the version of Vigil that wrote it{}",
        .0.display(),
        .1,
        .2.as_deref().map(|p| format!(" ({})", p.escape_debug())).unwrap_or_default()
    )]
    Version(PathBuf, u32, Option<String>),
    /// The metadata at the start lacks this entry or has one that is no number.
    #[error("{0}: metadata \"vigil\" has a missing or invalid entry `{1}`")]
    Metadata(PathBuf, &'static str),
    /// The file is damaged; the records before are good.
    #[error(
        "{path} is damaged after record {records}, {at_s:.2} s into the log{}: {what}; the records before it are good, and \
         `vigil recover` saves those behind it as well",
        at_byte.map(|byte| format!(", at byte {byte}")).unwrap_or_default()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Records read before the damage.
        records: u64,
        /// Time from the first record to the last one before the damage, seconds.
        at_s: f64,
        /// Where the damaged piece begins, bytes from the file's beginning, if the file's form says so.
        at_byte: Option<u64>,
        /// What is wrong.
        what: Damage,
    },
}

/// What is wrong with a container, in words of what was recorded.
pub(crate) fn in_words(error: &McapError) -> String {
    let unpacked = |what: &str| format!("a chunk, a second of flight or less, {what}");
    match error {
        McapError::BadChunkCrc { .. } => unpacked("does not match its checksum"),
        McapError::DecompressionError(_) => unpacked("cannot be unpacked"),
        McapError::UnsupportedCompression(name) => unpacked(&format!(
            "is compressed with `{}`, and lz4, zstd and nothing are what can be read",
            name.escape_debug()
        )),
        McapError::UnexpectedEoc | McapError::BadChunkLength { .. } => unpacked("ends within a record"),
        McapError::RecordTooLarge { len, .. } | McapError::ChunkTooLarge(len) => {
            format!("a piece claims {len} bytes, more than any has")
        }
        McapError::BadMagic => "its end mark is not MCAP's".to_owned(),
        McapError::Parse(_) => "a record's content does not have its kind's form".to_owned(),
        other => format!("the container does not hold together ({other})"),
    }
}

/// Files that are taken for logs, by their first bytes.
const FOREIGN: [(&[u8], &str); 12] = [
    (b"ULog\x01\x12\x35", "a ULog of PX4"),
    (b"#ROSBAG", "a ROS 1 bag"),
    (b"SQLite format 3", "an SQLite database, as ROS 2 records bags in"),
    (b"\x1f\x8b", "a gzip file: unpack it"),
    (b"\x28\xb5\x2f\xfd", "a zstd file: unpack it"),
    (b"PK\x03\x04", "a zip file: unpack it"),
    (b"\x04\x22\x4d\x18", "an LZ4 file: unpack it"),
    (b"\xfd7zXZ", "an xz file: unpack it"),
    (b"BZh", "a bzip2 file: unpack it"),
    (
        b"version https://",
        "a pointer of Git LFS: `git lfs pull` brings the file",
    ),
    (b"\xa3\x95", "a DataFlash log of ArduPilot"),
    (b"\x89HDF", "an HDF5 file"),
];

/// What is wrong in a damaged log.
#[derive(Debug, thiserror::Error)]
pub enum Damage {
    /// The MCAP container does not hold together (length, checksum, compression).
    #[error("{}", in_words(.0))]
    Container(McapError),
    /// It does, and what it holds are no steps, not these steps, or not all of them.
    #[error("{0}")]
    Content(String),
}

/// A record of a later time is none of a flight: a step that is replayed adds to its time.
const LATEST_NS: Nanos = Nanos::MAX / 2;

/// How a log ends, known once all its records were read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogEnd {
    /// The recorder closed it.
    Closed {
        /// Records missing because they were dropped.
        dropped: u64,
    },
    /// The recorder did not close it: its process was killed, or the disk was full.
    Interrupted {
        /// Records that could be read.
        records: u64,
    },
}

impl std::fmt::Display for LogEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Closed { dropped: 0 } => write!(f, "the log is complete"),
            Self::Closed { dropped } => write!(f, "the log was closed; {dropped} records were dropped while recording"),
            Self::Interrupted { records } => write!(
                f,
                "the log was not closed: {records} records are whole; what was recorded after them is missing, at most a \
                 second if the process was killed, more if the disk was full or the file was cut"
            ),
        }
    }
}

/// Who flew, and the epoch offset, by the metadata at the start of the log `path`.
pub(crate) fn flight_of(path: PathBuf, meta: &BTreeMap<String, String>) -> Result<(FlightInfo, u64), ReadError> {
    match FlightInfo::format_version(meta) {
        Some(LOG_FORMAT) => FlightInfo::from_metadata(meta).map_err(|key| ReadError::Metadata(path, key)),
        Some(found) => Err(ReadError::Version(path, found, meta.get("program").cloned())),
        None => Err(ReadError::Metadata(path, "format")),
    }
}

/// Fills `record` from the step's message, which is handed back, and from number and content of the image before it.
pub(crate) fn read_step(
    tick: &[u8],
    image: Option<(u32, &[u8])>,
    record: &mut TickRecord,
) -> Result<proto::Tick, Damage> {
    let broken = |topic| move |error| Damage::Content(format!("a message of {topic} does not decode: {error}"));
    let decoded = image
        .map(|(number, image)| Ok((number, RawImage::decode(image)?)))
        .transpose();
    let image = decoded.map_err(broken(topic::DEPTH))?;
    let tick = proto::Tick::decode(tick).map_err(broken(topic::TICK))?;
    let has_frame = convert::from_wire(&tick, record)
        .map_err(|defect| Damage::Content(format!("a message of /vigil/tick is no step: {defect}")))?;
    let (step, now_ns) = (record.timing.step, record.now_ns);
    let defect = match (has_frame, image) {
        // A time to which a replay cannot add.
        _ if now_ns > LATEST_NS => format!("step {step} has the time {now_ns} ns, later than any loop runs"),
        (false, None) => return Ok(tick),
        (true, Some((number, image))) if number == step as u32 => {
            if display::read_depth_image(&image, &mut record.frame_slot(true).depth) {
                return Ok(tick);
            }
            format!("the depth image of step {step} is no {DEPTH_ROWS} x {DEPTH_COLS} image in 32FC1")
        }
        _ => format!("step {step} and the depth channel disagree on whether it had a frame"),
    };
    Err(Damage::Content(defect))
}

/// A log being read.
pub struct Reader {
    path: PathBuf,
    container: Container,
    info: FlightInfo,
    epoch_offset_ns: u64,
    /// Topics of the channels that a replay needs, by their number in this file.
    channels: BTreeMap<u16, String>,
    /// Number and content of the image that waits for its step.
    image: Option<(u32, Vec<u8>)>,
    records: u64,
    /// Times of the first and the last record.
    span_ns: Option<(Nanos, Nanos)>,
    counted: Option<(u64, u64)>,
    end: Option<LogEnd>,
    done: bool,
}

impl Reader {
    /// Opens a log and reads its metadata.
    ///
    /// # Errors
    /// [`ReadError`] when the file is missing, of another kind or of another format version.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let mut reader = Self {
            path: path.to_owned(),
            container: Container::open(path)?,
            info: FlightInfo::default(),
            epoch_offset_ns: 0,
            channels: BTreeMap::new(),
            image: None,
            records: 0,
            span_ns: None,
            counted: None,
            end: None,
            done: false,
        };
        reader.read_start()?;
        Ok(reader)
    }

    fn read_start(&mut self) -> Result<(), ReadError> {
        let path = self.path.clone();
        let meta = match self.next_container_record() {
            Ok(Next::Record(Record::Metadata(meta))) if meta.name == META => meta.metadata,
            // Programs that write a log anew may put it behind the messages.
            Ok(Next::Record(_)) => {
                let description = salvage::describe(&path).map_err(at(&path))?;
                // Reading begins anew.
                self.container = Container::open(&path)?;
                match description.start {
                    Some(start) => start.metadata,
                    None => return Err(ReadError::NotALog(path)),
                }
            }
            Ok(Next::End) => return Err(ReadError::NotALog(path)),
            Ok(Next::Cut) => return Err(ReadError::Empty(path)),
            Err(Damage::Container(McapError::BadMagic)) => {
                let mut first = [0; 16];
                let _ = vigil_types::files::open(&path).and_then(|mut file| io::Read::read(&mut file, &mut first));
                let known = FOREIGN.iter().find(|(mark, _)| first.starts_with(mark));
                return Err(ReadError::NotMcap(path, known.map(|(_, kind)| *kind)));
            }
            Err(Damage::Container(McapError::Io(error))) => return Err(at(&path)(error).into()),
            Err(what) => return Err(self.damaged(what)),
        };
        (self.info, self.epoch_offset_ns) = flight_of(path, &meta)?;
        Ok(())
    }

    /// Who flew with which settings.
    pub fn info(&self) -> &FlightInfo {
        &self.info
    }

    /// What the recorder added to the loop's time to give the time stamps that viewers show.
    pub fn epoch_offset_ns(&self) -> u64 {
        self.epoch_offset_ns
    }

    /// How the log ends; `None` until all records were read.
    pub fn end(&self) -> Option<LogEnd> {
        self.end
    }

    /// Reads the next record into `record`. `false` means that there is none: [`Reader::end`] then says how the log
    /// ends. A log that was not closed is read as far as it is complete.
    ///
    /// # Errors
    /// [`ReadError`] when the file is damaged; reading then ends.
    pub fn read_next(&mut self, record: &mut TickRecord) -> Result<bool, ReadError> {
        if self.done {
            return Ok(false);
        }
        let result = self.try_next(record).map_err(|what| match what {
            Damage::Container(McapError::Io(error)) => at(&self.path)(error).into(),
            what => self.damaged(what),
        });
        self.done = !matches!(result, Ok(true));
        result
    }

    fn damaged(&self, what: Damage) -> ReadError {
        // Read a second time: where it is damaged is not asked of a log that is whole.
        let at_byte = salvage::describe(&self.path).ok().and_then(|found| found.damaged_at);
        ReadError::Damaged {
            path: self.path.clone(),
            records: self.records,
            at_s: self
                .span_ns
                .map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 * 1e-9),
            at_byte,
            what,
        }
    }

    fn try_next(&mut self, record: &mut TickRecord) -> Result<bool, Damage> {
        loop {
            let next = match self.next_container_record()? {
                Next::Record(next) => next,
                end => {
                    self.end = Some(match self.counted {
                        // Of a log that is cut, only the index behind all records is missing then.
                        Some((counted, dropped)) if counted == self.records => LogEnd::Closed { dropped },
                        Some((counted, _)) if matches!(end, Next::End) => {
                            let text = format!("the log ends with a count of {counted} records");
                            return Err(Damage::Content(text));
                        }
                        _ => LogEnd::Interrupted { records: self.records },
                    });
                    return Ok(false);
                }
            };
            match next {
                Record::Channel(channel) if [topic::DEPTH, topic::TICK].contains(&channel.topic.as_str()) => {
                    self.channels.insert(channel.id, channel.topic);
                }
                Record::Metadata(meta) if meta.name == META_END => {
                    let number = |key| meta.metadata.get(key).and_then(|text| text.parse().ok());
                    self.counted = number("records").zip(number("dropped"));
                }
                Record::Message { header, data } => match self.channels.get(&header.channel_id).map(String::as_str) {
                    Some(topic::DEPTH) => self.image = Some((header.sequence, data.into_owned())),
                    Some(_) => {
                        let image = self.image.take();
                        read_step(
                            &data,
                            image.as_ref().map(|(number, image)| (*number, image.as_slice())),
                            record,
                        )?;
                        self.records += 1;
                        let first_ns = self.span_ns.map_or(record.now_ns, |(first, _)| first);
                        self.span_ns = Some((first_ns, record.now_ns));
                        return Ok(true);
                    }
                    None => (),
                },
                _ => (),
            }
        }
    }

    /// The next channel, metadata or message of interest.
    fn next_container_record(&mut self) -> Result<Next, Damage> {
        self.container.next_of(&self.channels).map_err(Damage::Container)
    }
}

impl Iterator for Reader {
    type Item = Result<Box<TickRecord>, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut record = Box::default();
        let read = self.read_next(&mut record);
        read.map(|more| more.then_some(record)).transpose()
    }
}
