//! Writes records into an MCAP file: which channels there are, what goes to which, and when it is flushed.

use crate::display::{self, MAP_FRAME, Narrator, PathTrail};
use crate::proto::foxglove::log::Level;
use crate::{RecorderConfig, TickRecord, convert, proto};
use mcap::records::{AttachmentHeader, MessageHeader, Metadata};
use mcap::{Compression, McapError, McapResult, WriteOptions};
use prost::Message;
use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, Write};
use vigil_types::{Attitude, Goal, LogContent, Nanos, STEP_NS};

/// Version of what a replay reads: `META`, `topic::TICK` and `topic::DEPTH`. Raised when an older reader would
/// misread a newer log; a field added to a message does not raise it.
pub const LOG_FORMAT: u32 = 1;

/// Name of the metadata record at the start of a log.
pub(crate) const META: &str = "vigil";
/// Name of the metadata record that says how the flight went, written after it.
pub(crate) const META_STORY: &str = "vigil.flight";
/// Name of the metadata record at the end of a log that was closed.
pub(crate) const META_END: &str = "vigil.end";

/// At least this often in log time, what was recorded goes to the file as a complete chunk.
const FLUSH_NS: Nanos = 1_000_000_000;
/// The path and the goal are repeated this often.
const SLOW_NS: Nanos = 1_000_000_000;
/// A frame that people can read is shown this often.
const RANGE_NS: Nanos = 200_000_000;

/// Names of the channels.
pub(crate) mod topic {
    pub(crate) const DEPTH: &str = "/depth";
    pub(crate) const RANGE: &str = "/depth/range";
    pub(crate) const TICK: &str = "/vigil/tick";
    pub(crate) const STATUS: &str = "/status";
    pub(crate) const TRANSFORM: &str = "/tf";
    pub(crate) const POSE: &str = "/pose";
    pub(crate) const PATH: &str = "/path";
    pub(crate) const GOAL: &str = "/goal";
    pub(crate) const SCENE: &str = "/scene";
    pub(crate) const SCENE_POINTS: &str = "/scene/points";
    pub(crate) const LOG: &str = "/log";
    pub(crate) const TRUTH: &str = "/truth/pose";
    pub(crate) const ATTACK: &str = "/attack";
    pub(crate) const CLEAN_DEPTH: &str = "/depth/clean";
    pub(crate) const GRID: &str = "/map/grid";
    pub(crate) const WAY: &str = "/map/way";
    pub(crate) const SHAP: &str = "/shap";
}

/// A topic and the kind of its messages.
pub(crate) type Kind = (&'static str, &'static str);

/// What a recorder writes, in the order of its channels' numbers.
pub(crate) const RECORDED: [Kind; 11] = [
    (topic::DEPTH, "foxglove.RawImage"),
    (topic::TICK, "vigil.log.Tick"),
    (topic::STATUS, "vigil.log.Status"),
    (topic::RANGE, "foxglove.RawImage"),
    (topic::TRANSFORM, "foxglove.FrameTransform"),
    (topic::POSE, "foxglove.PoseInFrame"),
    (topic::PATH, "foxglove.PosesInFrame"),
    (topic::GOAL, "foxglove.PoseInFrame"),
    (topic::SCENE, "foxglove.SceneUpdate"),
    (topic::SCENE_POINTS, "foxglove.PointCloud"),
    (topic::LOG, "foxglove.Log"),
];

/// Adds channels with the schemas of their messages; their numbers by topic.
pub(crate) fn register<W: Write + Seek>(
    writer: &mut mcap::Writer<W>,
    kinds: &[Kind],
) -> McapResult<HashMap<&'static str, u16>> {
    let mut numbers = HashMap::new();
    for (topic, kind) in kinds {
        let schema = writer.add_schema(kind, "protobuf", proto::descriptors(kind))?;
        numbers.insert(*topic, writer.add_channel(schema, topic, "protobuf", &BTreeMap::new())?);
    }
    Ok(numbers)
}

/// How all logs are written.
pub(crate) fn write_options() -> WriteOptions {
    WriteOptions::new()
        .library(concat!("vigil-log/", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Lz4))
        // Chunks are put together in memory and written whole: a kill leaves complete chunks, not half a one.
        .disable_seeking(true)
}

/// An open log. Everything up to the last flush can be read even if nothing more is ever written.
pub(crate) struct LogFile<W: Write + Seek> {
    pub(crate) sheet: Sheet<W>,
    config: RecorderConfig,
    narrator: Narrator,
    trail: PathTrail,
    goal: Option<Goal>,
    last_flush_ns: Option<Nanos>,
    last_slow_ns: Option<Nanos>,
    last_range_ns: Option<Nanos>,
}

impl<W: Write + Seek> LogFile<W> {
    /// Writes what stands before the first record (who flies with which settings, the channels) and flushes it.
    pub(crate) fn create(sink: W, config: RecorderConfig) -> McapResult<Self> {
        let mut writer = write_options().create(sink)?;
        writer.write_metadata(&Metadata {
            name: META.to_owned(),
            metadata: config.info.to_metadata(config.epoch_offset_ns),
        })?;
        let mut sheet = Sheet::new(writer, &RECORDED)?;
        sheet.writer.flush()?;
        Ok(Self {
            sheet,
            config,
            narrator: Narrator::default(),
            trail: PathTrail::new(),
            goal: None,
            last_flush_ns: None,
            last_slow_ns: None,
            last_range_ns: None,
        })
    }

    /// Writes a record into the present chunk. `true` when that made a flush due and it was done: all records so far
    /// are then in the file.
    pub(crate) fn write(&mut self, record: &TickRecord) -> McapResult<bool> {
        let at_ns = record.now_ns.saturating_add(self.config.epoch_offset_ns);
        // The number wraps after 2³² steps, as the MCAP field does.
        let place = (at_ns, record.timing.step as u32);
        let sheet = &mut self.sheet;
        let content = self.config.content;
        let (exact, drawn) = (content != LogContent::Light, content != LogContent::Replay);
        if let Some(scene) = self.config.scene.take() {
            sheet.put(topic::SCENE, place, &scene.to_update(at_ns))?;
            if drawn {
                sheet.put(topic::SCENE_POINTS, place, &scene.to_point_cloud(at_ns))?;
            }
        }
        if let Some(frame) = record.frame().filter(|_| exact) {
            sheet.put(topic::DEPTH, place, &display::depth_image(frame, at_ns))?;
        }
        let mut tick = convert::to_wire(record);
        if !exact {
            // A header announces pixels, and there are none.
            tick.frame = None;
        }
        sheet.put(topic::TICK, place, &tick)?;
        if drawn {
            sheet.put(
                topic::STATUS,
                place,
                &display::status(record, self.config.info.detector_threshold),
            )?;
            let slow_due = due(&mut self.last_slow_ns, record.now_ns, SLOW_NS);
            if let Some(frame) = record.frame()
                && due(&mut self.last_range_ns, record.now_ns, RANGE_NS)
            {
                sheet.put(topic::RANGE, place, &display::range_image(frame, at_ns))?;
            }
            if slow_due {
                sheet.put(topic::TRANSFORM, place, &display::sensor_transform(at_ns))?;
            }
            if let Some(pose) = display::vehicle_pose(record) {
                self.trail.offer(pose);
                let body = display::transform(MAP_FRAME, display::BODY_FRAME, pose, at_ns);
                sheet.put(topic::TRANSFORM, place, &body)?;
                sheet.put(topic::POSE, place, &display::pose_in_map(pose, at_ns))?;
                if slow_due {
                    sheet.put(topic::PATH, place, &self.trail.message(at_ns))?;
                }
            }
            let goal = record.report.goal.filter(|g| g.position_ned_m.is_finite());
            if let Some(goal) = goal
                && (slow_due || self.goal != Some(goal))
            {
                let pose = display::pose(goal.position_ned_m, Attitude::LEVEL_NORTH);
                sheet.put(topic::GOAL, place, &display::pose_in_map(pose, at_ns))?;
            }
            self.goal = goal;
        }

        let mut written = Ok(());
        self.narrator.lines(record, |level: Level, line| {
            if written.is_ok() {
                written = sheet.put(topic::LOG, place, &display::log_line(level, line, at_ns));
            }
        });
        written?;

        let first = self.last_flush_ns.is_none();
        if due(&mut self.last_flush_ns, record.now_ns, FLUSH_NS) && !first {
            self.sheet.writer.flush()?;
            return Ok(true);
        }
        Ok(false)
    }

    /// Closes the log: notes how it ended and writes the index that lets viewers seek.
    pub(crate) fn finish(self, records: u64, dropped: u64) -> McapResult<W> {
        let mut writer = self.sheet.writer;
        writer.write_metadata(&end_metadata(records, dropped))?;
        writer.finish()?;
        Ok(writer.into_inner())
    }
}

/// The record at the end of a log that was closed.
pub(crate) fn end_metadata(records: u64, dropped: u64) -> Metadata {
    Metadata {
        name: META_END.to_owned(),
        metadata: BTreeMap::from([
            ("records".to_owned(), records.to_string()),
            ("dropped".to_owned(), dropped.to_string()),
        ]),
    }
}

/// Copies what somebody attached to a log.
pub(crate) fn attach<W: Write + Seek>(
    writer: &mut mcap::Writer<W>,
    header: AttachmentHeader,
    data: &[u8],
) -> McapResult<()> {
    writer.start_attachment(data.len() as u64, header)?;
    writer.put_attachment_bytes(data)?;
    writer.finish_attachment()
}

/// Whether this step is the one nearest to `period_ns` after `last`, which is then set to `now_ns`. A clock that went back counts
/// as passed.
pub(crate) fn due(last: &mut Option<Nanos>, now_ns: Nanos, period_ns: Nanos) -> bool {
    let is_due = last.is_none_or(|then| then.abs_diff(now_ns).saturating_add(STEP_NS / 2) >= period_ns);
    if is_due {
        *last = Some(now_ns);
    }
    is_due
}

/// Messages that are being written, on the channels of their topics.
pub(crate) struct Sheet<W: Write + Seek> {
    pub(crate) writer: mcap::Writer<W>,
    channels: HashMap<&'static str, u16>,
    buffer: Vec<u8>,
}

impl<W: Write + Seek> Sheet<W> {
    /// Registers the channels.
    pub(crate) fn new(mut writer: mcap::Writer<W>, kinds: &[Kind]) -> McapResult<Self> {
        Ok(Self {
            channels: register(&mut writer, kinds)?,
            writer,
            buffer: Vec::new(),
        })
    }

    /// Puts a message into the file: on this topic, at this time, with this number.
    pub(crate) fn put(&mut self, topic: &str, (at_ns, sequence): (u64, u32), message: &impl Message) -> McapResult<()> {
        self.buffer.clear();
        let header = MessageHeader {
            // A topic that was not registered has no channel, which the writer says.
            channel_id: self.channels.get(topic).copied().unwrap_or(u16::MAX),
            sequence,
            log_time: at_ns,
            publish_time: at_ns,
        };
        message
            .encode(&mut self.buffer)
            .map_err(|error| McapError::Io(std::io::Error::other(error)))?;
        self.writer.write_to_known_channel(&header, &self.buffer)
    }
}
