//! What only the simulation knows, put into the log after the flight: true poses, and which frames were altered and how they
//! were before. The firmware never sees any of it.
//!
//! Whoever knows it writes a [`SideLog`] beside the flight; [`merge_into`] then puts its messages among the log's own by time.

use crate::container::{Container, Next};
use crate::display::{self, MAP_FRAME};
use crate::log_file::{self, Kind, META_STORY, Sheet, topic};
use crate::proto;
use crate::proto::foxglove::PosesInFrame;
use crate::{DerivedLog, ReadError, Reader};
use mcap::McapError;
use mcap::records::{MessageHeader, Metadata, Record};
use prost::Message;
use std::collections::{BTreeMap, HashMap};
use std::fs::{File, TryLockError};
use std::io::{self, BufWriter, Seek};
use std::path::{Path, PathBuf};
use vigil_types::files::{self, Access, FileError};
use vigil_types::{Attitude, DepthFrame, LogContent, Nanos, NedVector};

/// Names of channels.
type Topics = &'static [&'static str];

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
    #[error("{}: {}", .0.display(), crate::reader::in_words(.1))]
    Mcap(PathBuf, McapError),
}

fn at(path: &Path) -> impl Fn(McapError) -> SideError + '_ {
    |source| match source {
        McapError::Io(error) => files::at(path)(error).into(),
        source => SideError::Mcap(path.to_owned(), source),
    }
}

/// A file of messages of one who knows more than the firmware, in the order of their times. They get their time stamps when they
/// are put into the log, which knows what to add to the loop's time.
pub struct SideLog {
    file: SideFile,
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
        let kinds = [
            (topic::TRUTH, "foxglove.PoseInFrame"),
            (topic::TRANSFORM, "foxglove.FrameTransform"),
            (topic::ATTACK, "vigil.log.Attack"),
            (topic::CLEAN_DEPTH, "foxglove.RawImage"),
        ];
        Ok(Self {
            file: SideFile::new(path, File::create(path), &kinds)?,
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
        let in_map = display::pose_in_map(pose, None);
        self.file.put(topic::TRUTH, (at_ns, 0), &in_map)?;
        if attitude.is_none() {
            return Ok(());
        }
        let transform = display::transform(MAP_FRAME, "base_link_true", pose, None);
        self.file.put(topic::TRANSFORM, (at_ns, 0), &transform)
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
        let place = (at_ns, sequence as u32);
        self.file.put(topic::ATTACK, place, &message)?;
        if let Some((_, clean)) = altered
            && (self.altered < Self::CLEAN_FIRST || log_file::due(&mut self.last_clean_ns, at_ns, Self::CLEAN_NS))
        {
            self.altered = self.altered.saturating_add(1);
            let image = display::depth_image(clean, None);
            self.file.put(topic::CLEAN_DEPTH, place, &image)?;
        }
        Ok(())
    }

    /// Closes the file.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish(self) -> Result<(), SideError> {
        self.file.finish().map(drop)
    }
}

/// A file of messages that is being written, and its name.
pub(crate) struct SideFile {
    path: PathBuf,
    sheet: Sheet<BufWriter<File>>,
}

impl SideFile {
    /// In `sink`, which is named by `path` where something fails.
    pub(crate) fn new(path: &Path, sink: io::Result<File>, kinds: &[Kind]) -> Result<Self, SideError> {
        let sink = sink.map_err(files::at(path))?;
        let writer = log_file::write_options().create(BufWriter::new(sink));
        let sheet = writer.and_then(|writer| Sheet::new(writer, kinds)).map_err(at(path))?;
        Ok(Self {
            path: path.to_owned(),
            sheet,
        })
    }

    pub(crate) fn put(&mut self, topic: &str, place: (Nanos, u32), message: &impl Message) -> Result<(), SideError> {
        self.sheet.put(topic, place, message).map_err(at(&self.path))
    }

    pub(crate) fn finish(mut self) -> Result<File, SideError> {
        self.sheet.writer.finish().map_err(at(&self.path))?;
        let file = self.sheet.writer.into_inner().into_inner();
        file.map_err(|error| files::at(&self.path)(error.into_error()).into())
    }
}

/// Puts the messages of side logs among those of the flight log `log`, by time, and notes `about` (how the flight ended, the
/// command that flew it) in its metadata `vigil.flight`. What a replay reads stays as it is, bit for bit. The file is replaced
/// whole or not at all; one that was not closed is then still marked as such. A side log that was cut off gives what is whole. From
/// a log without frames ([`LogContent::Light`]) those before they were altered stay out, too.
///
/// # Errors
/// [`SideError`]: a log that cannot be read, a file that cannot be written; the log is then as it was.
pub fn merge_into(
    log: &Path,
    sides: &[&Path],
    about: &BTreeMap<String, String>,
    content: LogContent,
) -> Result<(), SideError> {
    let without: Topics = match content {
        LogContent::Light => &[topic::CLEAN_DEPTH],
        _ => &[],
    };
    let sides = sides
        .iter()
        .map(|path| Ok(Source::new(path, Container::open(path)?, without)));
    replace_merged(log, sides.collect::<Result<_, SideError>>()?, about, &[])
}

/// Puts what was derived from the log among its messages ([`crate::DerivedLog`]): `map` and way, `shap`, or both, in the place of
/// what was derived of them earlier.
///
/// # Errors
/// As [`merge_into`].
pub fn merge_derived(log: &Path, derived: DerivedLog, map: bool, shap: bool) -> Result<(), SideError> {
    let mut derived = derived.file.finish()?;
    derived.rewind().map_err(files::at(log))?;
    let replaced: Topics = match (map, shap) {
        (true, true) => &[topic::GRID, topic::WAY, topic::SHAP],
        (true, false) => &[topic::GRID, topic::WAY],
        (false, true) => &[topic::SHAP],
        (false, false) => &[],
    };
    let derived = Source::new(log, Container::new(derived), &[]);
    replace_merged(log, vec![derived], &BTreeMap::new(), replaced)
}

/// `without`: topics of the log that are left out.
fn replace_merged(
    log: &Path,
    mut sides: Vec<Source<'_>>,
    about: &BTreeMap<String, String>,
    without: Topics,
) -> Result<(), SideError> {
    let epoch_offset_ns = Reader::open(log)?.epoch_offset_ns();
    for side in &mut sides {
        side.lacks_ns = Some(epoch_offset_ns);
    }
    // Its recorder would go on with a file that has no name any more. Where there are no locks, nobody holds one.
    let before = files::open(log).map_err(files::at(log))?;
    if let Err(TryLockError::WouldBlock) = before.try_lock_shared() {
        let busy = io::Error::other("it is still being written; wait for the flight's end");
        return Err(files::at(log)(busy).into());
    }
    let merged = files::replace_with(log, Access::Shared, |file| {
        merge(log, sides, about, without, file).map_err(io::Error::other)
    });
    merged.map_err(|error| error.downcast().unwrap_or_else(|error| files::at(log)(error).into()))
}

fn merge(
    log: &Path,
    mut sides: Vec<Source<'_>>,
    about: &BTreeMap<String, String>,
    without: Topics,
    to: &mut File,
) -> Result<(), SideError> {
    let mut writer = log_file::write_options().create(BufWriter::new(to)).map_err(at(log))?;
    let mut main = Source {
        keeps_story: about.is_empty(),
        ..Source::new(log, Container::open(log)?, without)
    };
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
            side.advance(&mut writer)?;
        }
        main.advance(&mut writer)?;
    }
    for side in &mut sides {
        while side.time_ns().is_some() {
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
    /// Of a side log: what its times lack, and the stamps of its messages, too.
    lacks_ns: Option<u64>,
    /// Number in the merged log, and whether the kind has a stamp, by number in this file.
    schemas: HashMap<u16, (u16, bool)>,
    channels: HashMap<u16, (u16, bool)>,
    next: Option<(MessageHeader, Vec<u8>)>,
    end: Option<Metadata>,
    /// Topics whose messages are left out.
    without: Topics,
    /// Its metadata of the flight as a whole goes on.
    keeps_story: bool,
}

impl<'a> Source<'a> {
    fn new(path: &'a Path, container: Container, without: Topics) -> Self {
        Self {
            path,
            container,
            lacks_ns: None,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            next: None,
            end: None,
            without,
            keeps_story: false,
        }
    }

    fn time_ns(&self) -> Option<u64> {
        self.next.as_ref().map(|(header, _)| header.log_time)
    }

    /// Writes the message and goes to the next; schemas, channels, metadata and attachments before that are written.
    fn advance(&mut self, writer: &mut mcap::Writer<BufWriter<&mut File>>) -> Result<(), SideError> {
        self.pass_on(writer).map_err(at(self.path))
    }

    fn pass_on(&mut self, writer: &mut mcap::Writer<BufWriter<&mut File>>) -> Result<(), McapError> {
        if let Some((header, data)) = self.next.take() {
            writer.write_to_known_channel(&header, &data)?;
        }
        while let Next::Record(record) = self.container.next(|_, _| true)? {
            match record {
                Record::Schema { header, data } => {
                    let id = writer.add_schema(&header.name, &header.encoding, &data)?;
                    // Of the kinds of a side log, those that viewers know have one.
                    self.schemas
                        .insert(header.id, (id, header.name.starts_with("foxglove.")));
                }
                Record::Channel(channel) if self.without.contains(&channel.topic.as_str()) => {}
                Record::Channel(channel) => {
                    let (schema, stamped) = self.schemas.get(&channel.schema_id).copied().unwrap_or_default();
                    let id =
                        writer.add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata)?;
                    self.channels.insert(channel.id, (id, stamped));
                }
                Record::Metadata(meta) if meta.name == log_file::META_END => self.end = Some(meta),
                // A second merge says anew what there is to say.
                Record::Metadata(meta) if meta.name == META_STORY && !self.keeps_story => {}
                Record::Metadata(meta) => writer.write_metadata(&meta)?,
                Record::Attachment { header, data, .. } => log_file::attach(writer, header, &data)?,
                Record::Message { mut header, data } => {
                    if let Some((id, stamped)) = self.channels.get(&header.channel_id) {
                        header.channel_id = *id;
                        let mut data = data.into_owned();
                        if let Some(lacks_ns) = self.lacks_ns {
                            header.log_time = header.log_time.saturating_add(lacks_ns);
                            header.publish_time = header.publish_time.saturating_add(lacks_ns);
                            if *stamped {
                                data = with_stamp(header.log_time, &data);
                            }
                        }
                        self.next = Some((header, data));
                        break;
                    }
                }
                // The end of the messages: what follows repeats them as an index.
                Record::DataEnd(_) => break,
                _ => {}
            }
        }
        Ok(())
    }
}

/// The message with its stamp in front, where an encoder puts it: the stamp is the first field of each kind in a side log.
fn with_stamp(at_ns: u64, message: &[u8]) -> Vec<u8> {
    let stamp = PosesInFrame {
        timestamp: display::timestamp(at_ns),
        ..PosesInFrame::default()
    };
    [stamp.encode_to_vec().as_slice(), message].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FlightInfo, Recorder, RecorderConfig, SHAP_COLS, SHAP_ROWS};

    /// The messages of a topic: times in the log and contents.
    fn messages(log: &Path, topic: &str) -> Vec<(u64, Vec<u8>)> {
        let bytes = std::fs::read(log).unwrap();
        let all = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
        all.filter(|message| message.channel.topic == topic)
            .map(|message| (message.log_time, message.data.into_owned()))
            .collect()
    }

    #[test]
    fn what_is_added_has_the_logs_time_and_what_is_not_derived_anew_stays() {
        let folder = tempfile::tempdir().unwrap();
        let (log, side) = (folder.path().join("log.mcap"), folder.path().join("side.part"));
        let epoch_offset_ns = 1_767_323_045_000_000_000;
        let mut recorder = Recorder::start(RecorderConfig {
            epoch_offset_ns,
            ..RecorderConfig::lossless(&log, FlightInfo::default())
        })
        .unwrap();
        recorder.record(|_| {});
        let early = merge_into(&log, &[], &BTreeMap::new(), LogContent::Light)
            .unwrap_err()
            .to_string();
        assert!(early.contains("it is still being written"), "{early}");
        assert_eq!(recorder.finish().failure, None);

        let (at_ns, place) = (50_000_000, NedVector::new(1.0, 2.0, -3.0));
        let mut truth = SideLog::create(&side).unwrap();
        truth.truth(at_ns, place, Some(Attitude::LEVEL_NORTH)).unwrap();
        truth.frame(at_ns, 1, Some((0.5, &DepthFrame::EMPTY))).unwrap();
        let film = mcap::Attachment {
            log_time: at_ns,
            create_time: at_ns,
            name: "film.mp4".to_owned(),
            media_type: "video/mp4".to_owned(),
            // Larger than any record of a recorder's.
            data: vec![7; 65 << 20].into(),
        };
        truth.file.sheet.writer.attach(&film).unwrap();
        truth.finish().unwrap();
        merge_into(&log, &[side.as_path()], &BTreeMap::new(), LogContent::Light).unwrap();
        let of_frames = [topic::ATTACK, topic::CLEAN_DEPTH].map(|topic| messages(&log, topic).len());
        assert_eq!(of_frames, [1, 0], "what was done to the frames, without the frames");
        let shown_ns = epoch_offset_ns + at_ns;
        let pose = display::pose(place, Attitude::LEVEL_NORTH);
        let in_map = display::pose_in_map(pose, shown_ns).encode_to_vec();
        assert_eq!(messages(&log, topic::TRUTH), [(shown_ns, in_map)]);
        let turned = display::transform(MAP_FRAME, "base_link_true", pose, shown_ns).encode_to_vec();
        assert!(messages(&log, topic::TRANSFORM).contains(&(shown_ns, turned)));

        for (map, shap) in [(true, true), (true, false), (false, true)] {
            let mut derived = DerivedLog::create(&log).unwrap();
            // Whoever ends it now leaves nothing: log, its tlog, and the other's notes.
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
            if map {
                derived.way(at_ns, 1, &[(0.0, 1.0)], -1.5).unwrap();
            }
            if shap {
                derived.shap(at_ns, 1, &[0.5; SHAP_ROWS * SHAP_COLS]).unwrap();
            }
            merge_derived(&log, derived, map, shap).unwrap();
            for topic in [topic::WAY, topic::SHAP] {
                let held = messages(&log, topic);
                assert_eq!(held.len(), 1, "{topic}, {map}, {shap}");
                assert!(held[0].1.starts_with(&with_stamp(shown_ns, &[])), "{topic}");
            }
        }
        let copy = folder.path().join("copy.mcap");
        crate::recover(&log, &copy).unwrap();
        for path in [&log, &copy] {
            let bytes = std::fs::read(path).unwrap();
            let index = mcap::Summary::read(&bytes).unwrap().unwrap().attachment_indexes;
            assert!(mcap::read::attachment(&bytes, &index[0]).unwrap() == film);
            assert_eq!(Reader::open(path).unwrap().filter(Result::is_ok).count(), 1);
        }
    }
}
