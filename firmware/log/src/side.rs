//! What only the simulation knows, put into the log after the flight: true poses, and which frames were altered and how they
//! were before. The firmware never sees any of it.
//!
//! Whoever knows it writes a [`SideLog`] beside the flight; [`merge_into`] then puts its messages among the log's own by time.

use crate::container::{Container, Next};
use crate::display::{self, MAP_FRAME};
use crate::log_file::{self, META_STORY, topic};
use crate::proto;
use crate::{ReadError, Reader};
use mcap::McapError;
use mcap::records::{MessageHeader, Metadata, Record};
use prost::Message;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use vigil_types::files::{self, Access, FileError};
use vigil_types::{Attitude, DepthFrame, Nanos, NedVector};

/// Why a side log cannot be written, or not be put into the log.
#[derive(Debug, thiserror::Error)]
pub enum SideError {
    /// The log cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A file cannot be opened, written or replaced.
    #[error(transparent)]
    Io(#[from] FileError),
    /// A file is no MCAP file, or is damaged.
    #[error("{path}: {}", crate::reader::in_words(.source))]
    Mcap {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: McapError,
    },
}

pub(crate) fn at(path: &Path) -> impl Fn(McapError) -> SideError + '_ {
    |source| match source {
        McapError::Io(error) => files::at(path)(error).into(),
        source => SideError::Mcap {
            path: path.to_owned(),
            source,
        },
    }
}

/// A file of messages of one who knows more than the firmware, in the order of their times.
pub struct SideLog {
    sheet: Sheet,
    truth: u16,
    transform: u16,
    attack: u16,
    clean: u16,
    last_clean_ns: Option<Nanos>,
    altered: u32,
}

impl SideLog {
    /// So many of the first altered frames are kept as they were, too: what is looked at most.
    pub const CLEAN_FIRST: u32 = 60;
    /// After these a frame is kept at most so often: it is as large as the altered one.
    pub const CLEAN_NS: Nanos = 200_000_000;

    /// Starts a file, in the place of what may be there.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn create(path: &Path) -> Result<Self, SideError> {
        let mut sheet = Sheet::create(path)?;
        let begin = |writer: &mut Writer| -> Result<_, McapError> {
            let truth = log_file::channel(writer, topic::TRUTH, "foxglove.PoseInFrame")?;
            let transform = log_file::channel(writer, topic::TRANSFORM, "foxglove.FrameTransform")?;
            let attack = log_file::channel(writer, topic::ATTACK, "vigil.log.Attack")?;
            let clean = log_file::channel(writer, topic::CLEAN_DEPTH, "foxglove.RawImage")?;
            Ok((truth, transform, attack, clean))
        };
        let (truth, transform, attack, clean) = begin(&mut sheet.writer).map_err(at(path))?;
        Ok(Self {
            sheet,
            truth,
            transform,
            attack,
            clean,
            last_clean_ns: None,
            altered: 0,
        })
    }

    /// Where the vehicle truly was at `at_ns` of the loop's clock, and how it was turned if that is known. A pose that is not
    /// finite is left out.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn truth(
        &mut self,
        at_ns: Nanos,
        position_ned_m: NedVector,
        attitude: Option<Attitude>,
    ) -> Result<(), SideError> {
        if !position_ned_m.is_finite() || !attitude.is_none_or(|a| a.is_valid()) {
            return Ok(());
        }
        let pose = display::pose(position_ned_m, attitude.unwrap_or(Attitude::LEVEL_NORTH));
        self.sheet
            .put(self.truth, at_ns, 0, &display::pose_in_map(pose, at_ns))?;
        if attitude.is_none() {
            return Ok(());
        }
        let transform = display::transform(MAP_FRAME, "base_link_true", pose, at_ns);
        self.sheet.put(self.transform, at_ns, 0, &transform)
    }

    /// The frame number `sequence` as the adversary handed it on at `at_ns`: as it was, or altered from `clean` with this effect
    /// on the actor's yaw output (action units). `clean` is kept at first ([`Self::CLEAN_FIRST`]), then a few times a second
    /// ([`Self::CLEAN_NS`]).
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn frame(&mut self, at_ns: Nanos, sequence: u64, altered: Option<(f32, &DepthFrame)>) -> Result<(), SideError> {
        let message = proto::Attack {
            now_ns: at_ns,
            frame_sequence: sequence,
            altered: f64::from(u8::from(altered.is_some())),
            yaw_change: altered.map_or(0.0, |(change, _)| f64::from(change)),
        };
        self.sheet.put(self.attack, at_ns, sequence as u32, &message)?;
        if let Some((_, clean)) = altered
            && (self.altered < Self::CLEAN_FIRST || log_file::due(&mut self.last_clean_ns, at_ns, Self::CLEAN_NS))
        {
            self.altered = self.altered.saturating_add(1);
            self.sheet
                .put(self.clean, at_ns, sequence as u32, &display::depth_image(clean, at_ns))?;
        }
        Ok(())
    }

    /// Closes the file.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish(self) -> Result<(), SideError> {
        self.sheet.finish()
    }
}

impl std::fmt::Debug for SideLog {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SideLog")
            .field("path", &self.sheet.path)
            .finish_non_exhaustive()
    }
}

pub(crate) type Writer = mcap::Writer<BufWriter<File>>;

/// A file of messages that is being written.
pub(crate) struct Sheet {
    pub(crate) path: PathBuf,
    pub(crate) writer: Writer,
    buffer: Vec<u8>,
}

impl Sheet {
    pub(crate) fn create(path: &Path) -> Result<Self, SideError> {
        let sink = File::create(path).map_err(files::at(path))?;
        let writer = log_file::write_options().create(BufWriter::new(sink));
        Ok(Self {
            path: path.to_owned(),
            writer: writer.map_err(at(path))?,
            buffer: Vec::new(),
        })
    }

    pub(crate) fn put(
        &mut self,
        channel_id: u16,
        at_ns: Nanos,
        sequence: u32,
        message: &impl Message,
    ) -> Result<(), SideError> {
        let place = (channel_id, at_ns, sequence);
        log_file::put(&mut self.writer, &mut self.buffer, place, message).map_err(at(&self.path))
    }

    pub(crate) fn finish(mut self) -> Result<(), SideError> {
        self.writer.finish().map(|_| ()).map_err(at(&self.path))
    }
}

/// Puts the messages of side logs among those of the flight log `log`, by time, and notes `about` (how the flight ended, the
/// command that flew it) in its metadata `vigil.flight`. What a replay reads stays as it is, bit for bit. The file is replaced
/// whole or not at all; one that was not closed is then still marked as such. A side log that was cut off gives what is whole.
///
/// # Errors
/// [`SideError`]: a log that cannot be read, a file that cannot be written; the log is then as it was.
pub fn merge_into(log: &Path, sides: &[&Path], about: &BTreeMap<String, String>) -> Result<(), SideError> {
    let epoch_offset_ns = Reader::open(log)?.epoch_offset_ns();
    replace_merged(log, sides, about, &[], epoch_offset_ns)
}

/// Puts what was derived from the log among its messages, in the place of what was derived earlier ([`crate::DerivedLog`]).
///
/// # Errors
/// As [`merge_into`].
pub fn merge_derived(log: &Path, derived: &Path) -> Result<(), SideError> {
    let epoch_offset_ns = Reader::open(log)?.epoch_offset_ns();
    replace_merged(log, &[derived], &BTreeMap::new(), &topic::DERIVED, epoch_offset_ns)
}

fn replace_merged(
    log: &Path,
    sides: &[&Path],
    about: &BTreeMap<String, String>,
    without: &'static [&'static str],
    epoch_offset_ns: u64,
) -> Result<(), SideError> {
    let merged = files::replace_with(log, Access::Shared, |file| {
        merge(log, sides, about, without, epoch_offset_ns, file).map_err(io::Error::other)
    });
    merged.map_err(|error| error.downcast().unwrap_or_else(|error| files::at(log)(error).into()))
}

fn merge(
    log: &Path,
    sides: &[&Path],
    about: &BTreeMap<String, String>,
    without: &'static [&'static str],
    epoch_offset_ns: u64,
    to: &mut File,
) -> Result<(), SideError> {
    let mut writer = log_file::write_options().create(BufWriter::new(to)).map_err(at(log))?;
    let mut main = Source {
        without,
        keeps_story: about.is_empty(),
        ..Source::open(log, 0)?
    };
    let mut sides = sides
        .iter()
        .map(|path| Source::open(path, epoch_offset_ns))
        .collect::<Result<Vec<_>, _>>()?;
    // What stands before the first message goes first: a reader expects the metadata at the start.
    main.advance(&mut writer)?;
    if !about.is_empty() {
        writer
            .write_metadata(&Metadata {
                name: META_STORY.to_owned(),
                metadata: about.clone(),
            })
            .map_err(at(log))?;
    }
    for side in &mut sides {
        side.advance(&mut writer)?;
    }
    while let Some(main_ns) = main.time_ns() {
        // The messages of one record stay together: what has their time comes after them.
        while let Some(side) = sides
            .iter_mut()
            .filter(|s| s.time_ns().is_some_and(|ns| ns < main_ns))
            .min_by_key(|s| s.time_ns())
        {
            side.write(&mut writer)?;
            side.advance(&mut writer)?;
        }
        main.write(&mut writer)?;
        main.advance(&mut writer)?;
    }
    for side in &mut sides {
        while side.time_ns().is_some() {
            side.write(&mut writer)?;
            side.advance(&mut writer)?;
        }
    }
    if let Some(end) = main.end.take() {
        writer.write_metadata(&end).map_err(at(log))?;
    }
    writer.finish().map(|_| ()).map_err(at(log))
}

/// A file that is being read, with its next message.
struct Source<'a> {
    path: &'a Path,
    container: Container,
    offset_ns: u64,
    schemas: HashMap<u16, u16>,
    channels: HashMap<u16, u16>,
    next: Option<(MessageHeader, Vec<u8>)>,
    end: Option<Metadata>,
    /// Topics whose messages are left out.
    without: &'static [&'static str],
    /// Its metadata of the flight as a whole goes on.
    keeps_story: bool,
    over: bool,
}

impl<'a> Source<'a> {
    fn open(path: &'a Path, offset_ns: u64) -> Result<Self, SideError> {
        Ok(Self {
            path,
            container: Container::open(path)?,
            offset_ns,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            next: None,
            end: None,
            without: &[],
            keeps_story: false,
            over: false,
        })
    }

    fn time_ns(&self) -> Option<u64> {
        self.next.as_ref().map(|(header, _)| header.log_time)
    }

    /// Goes to the next message; schemas, channels and metadata before it are written.
    fn advance(&mut self, writer: &mut mcap::Writer<BufWriter<&mut File>>) -> Result<(), SideError> {
        self.next = None;
        while !self.over {
            let record = match self.container.next(|_, _| true).map_err(at(self.path))? {
                Next::Record(record) => record,
                Next::End | Next::Cut => {
                    self.over = true;
                    break;
                }
            };
            match record {
                Record::Schema { header, data } => {
                    let id = writer
                        .add_schema(&header.name, &header.encoding, &data)
                        .map_err(at(self.path))?;
                    self.schemas.insert(header.id, id);
                }
                Record::Channel(channel) if self.without.contains(&channel.topic.as_str()) => {}
                Record::Channel(channel) => {
                    let schema = self.schemas.get(&channel.schema_id).copied().unwrap_or(0);
                    let id = writer
                        .add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata)
                        .map_err(at(self.path))?;
                    self.channels.insert(channel.id, id);
                }
                Record::Metadata(meta) if meta.name == log_file::META_END => self.end = Some(meta),
                // A second merge says anew what there is to say.
                Record::Metadata(meta) if meta.name == META_STORY && !self.keeps_story => {}
                Record::Metadata(meta) => writer.write_metadata(&meta).map_err(at(self.path))?,
                Record::Message { mut header, data } => {
                    if let Some(id) = self.channels.get(&header.channel_id) {
                        header.channel_id = *id;
                        header.log_time = header.log_time.saturating_add(self.offset_ns);
                        header.publish_time = header.publish_time.saturating_add(self.offset_ns);
                        self.next = Some((header, data.into_owned()));
                        break;
                    }
                }
                // The end of the messages: what follows repeats them as an index.
                Record::DataEnd(_) => self.over = true,
                _ => {}
            }
        }
        Ok(())
    }

    fn write(&mut self, writer: &mut mcap::Writer<BufWriter<&mut File>>) -> Result<(), SideError> {
        match &self.next {
            Some((header, data)) => writer.write_to_known_channel(header, data).map_err(at(self.path)),
            None => Ok(()),
        }
    }
}
