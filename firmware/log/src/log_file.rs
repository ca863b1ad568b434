//! Writes records into an MCAP file: which channels there are, what goes to which, and when it is flushed.

use crate::display::{self, MAP_FRAME, Narrator, PathTrail};
use crate::proto::foxglove::log::Level;
use crate::{FlightInfo, Scene, TickRecord, convert, proto};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapError, McapResult, WriteOptions};
use prost::Message;
use std::collections::BTreeMap;
use std::io::{Seek, Write};
use vigil_types::{Goal, LogContent, Nanos};

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

pub(crate) struct Channels {
    pub(crate) depth: u16,
    pub(crate) tick: u16,
    range: u16,
    status: u16,
    transform: u16,
    pose: u16,
    path: u16,
    goal: u16,
    scene: u16,
    scene_points: u16,
    log: u16,
}

impl Channels {
    pub(crate) fn register<W: Write + Seek>(writer: &mut mcap::Writer<W>) -> McapResult<Self> {
        Ok(Self {
            depth: channel(writer, topic::DEPTH, "foxglove.RawImage")?,
            tick: channel(writer, topic::TICK, "vigil.log.Tick")?,
            status: channel(writer, topic::STATUS, "vigil.log.Status")?,
            range: channel(writer, topic::RANGE, "foxglove.RawImage")?,
            transform: channel(writer, topic::TRANSFORM, "foxglove.FrameTransform")?,
            pose: channel(writer, topic::POSE, "foxglove.PoseInFrame")?,
            path: channel(writer, topic::PATH, "foxglove.PosesInFrame")?,
            goal: channel(writer, topic::GOAL, "foxglove.PoseInFrame")?,
            scene: channel(writer, topic::SCENE, "foxglove.SceneUpdate")?,
            scene_points: channel(writer, topic::SCENE_POINTS, "foxglove.PointCloud")?,
            log: channel(writer, topic::LOG, "foxglove.Log")?,
        })
    }
}

/// A channel of messages of one kind, with their schema.
pub(crate) fn channel<W: Write + Seek>(writer: &mut mcap::Writer<W>, topic: &str, kind: &str) -> McapResult<u16> {
    let schema = writer.add_schema(kind, "protobuf", proto::descriptors(kind))?;
    writer.add_channel(schema, topic, "protobuf", &BTreeMap::new())
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
    writer: mcap::Writer<W>,
    channels: Channels,
    epoch_offset_ns: u64,
    scene: Option<Scene>,
    content: LogContent,
    /// Score above which the detector's verdict is attack.
    threshold: Option<f32>,
    buffer: Vec<u8>,
    narrator: Narrator,
    trail: PathTrail,
    goal: Option<Goal>,
    last_flush_ns: Option<Nanos>,
    last_slow_ns: Option<Nanos>,
    last_range_ns: Option<Nanos>,
}

impl<W: Write + Seek> LogFile<W> {
    /// Writes what stands before the first record (who flies with which settings, the channels) and flushes it.
    pub(crate) fn create(
        sink: W,
        info: &FlightInfo,
        epoch_offset_ns: u64,
        scene: Option<Scene>,
        content: LogContent,
    ) -> McapResult<Self> {
        let mut writer = write_options().create(sink)?;
        writer.write_metadata(&Metadata {
            name: META.to_owned(),
            metadata: info.to_metadata(epoch_offset_ns),
        })?;
        let channels = Channels::register(&mut writer)?;
        writer.flush()?;
        Ok(Self {
            writer,
            channels,
            epoch_offset_ns,
            scene,
            content,
            threshold: info.detector_threshold,
            buffer: Vec::new(),
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
        let at_ns = record.now_ns.saturating_add(self.epoch_offset_ns);
        // Wraps after 2³² steps, as the MCAP field does.
        let sequence = record.timing.step as u32;
        let mut messages = Messages {
            writer: &mut self.writer,
            buffer: &mut self.buffer,
            at_ns,
            sequence,
        };
        let (exact, drawn) = (self.content != LogContent::Light, self.content != LogContent::Replay);
        if let Some(scene) = self.scene.take() {
            messages.put(self.channels.scene, &scene.to_update(at_ns))?;
            if drawn {
                messages.put(self.channels.scene_points, &scene.to_point_cloud(at_ns))?;
            }
        }
        if let Some(frame) = record.frame().filter(|_| exact) {
            messages.put(self.channels.depth, &display::depth_image(frame, at_ns))?;
        }
        let mut tick = convert::to_wire(record);
        if !exact {
            // A header announces pixels, and there are none.
            tick.frame = None;
        }
        messages.put(self.channels.tick, &tick)?;
        if drawn {
            messages.put(self.channels.status, &display::status(record, self.threshold))?;
            let slow_due = due(&mut self.last_slow_ns, record.now_ns, SLOW_NS);
            if let Some(frame) = record.frame()
                && due(&mut self.last_range_ns, record.now_ns, RANGE_NS)
            {
                messages.put(self.channels.range, &display::range_image(frame, at_ns))?;
            }
            if slow_due {
                messages.put(self.channels.transform, &display::sensor_transform(at_ns))?;
            }
            if let Some(pose) = display::vehicle_pose(record) {
                self.trail.offer(pose);
                messages.put(
                    self.channels.transform,
                    &display::transform(MAP_FRAME, display::BODY_FRAME, pose, at_ns),
                )?;
                messages.put(self.channels.pose, &display::pose_in_map(pose, at_ns))?;
                if slow_due {
                    messages.put(self.channels.path, &self.trail.message(at_ns))?;
                }
            }
            let goal = record.report.goal.filter(|g| g.position_ned_m.is_finite());
            if let Some(goal) = goal
                && (slow_due || self.goal != Some(goal))
            {
                messages.put(self.channels.goal, &display::goal_in_map(goal, at_ns))?;
            }
            self.goal = goal;
        }

        let mut told = Ok(());
        self.narrator.lines(record, |level: Level, line| {
            if told.is_ok() {
                told = messages.put(self.channels.log, &display::log_line(level, line, at_ns));
            }
        });
        told?;

        let first = self.last_flush_ns.is_none();
        if due(&mut self.last_flush_ns, record.now_ns, FLUSH_NS) && !first {
            self.writer.flush()?;
            return Ok(true);
        }
        Ok(false)
    }

    /// Puts everything written so far into the file as a complete chunk.
    pub(crate) fn flush(&mut self) -> McapResult<()> {
        self.writer.flush()
    }

    /// Closes the log: notes how it ended and writes the index that lets viewers seek.
    pub(crate) fn finish(mut self, records: u64, dropped: u64) -> McapResult<W> {
        self.writer.write_metadata(&end_metadata(records, dropped))?;
        self.writer.finish()?;
        Ok(self.writer.into_inner())
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

/// Whether `period_ns` passed since `last`, which is then set to `now_ns`. A clock that went back counts as passed.
pub(crate) fn due(last: &mut Option<Nanos>, now_ns: Nanos, period_ns: Nanos) -> bool {
    let is_due = last.is_none_or(|then| then.abs_diff(now_ns) >= period_ns);
    if is_due {
        *last = Some(now_ns);
    }
    is_due
}

/// Puts messages of one instant into the file.
struct Messages<'a, W: Write + Seek> {
    writer: &'a mut mcap::Writer<W>,
    buffer: &'a mut Vec<u8>,
    at_ns: u64,
    sequence: u32,
}

impl<W: Write + Seek> Messages<'_, W> {
    fn put(&mut self, channel_id: u16, message: &impl Message) -> McapResult<()> {
        put(
            self.writer,
            self.buffer,
            (channel_id, self.at_ns, self.sequence),
            message,
        )
    }
}

/// Puts a message into a file: to this channel, at this time, with this number. `buffer` is overwritten.
pub(crate) fn put<W: Write + Seek>(
    writer: &mut mcap::Writer<W>,
    buffer: &mut Vec<u8>,
    (channel_id, at_ns, sequence): (u16, u64, u32),
    message: &impl Message,
) -> McapResult<()> {
    buffer.clear();
    let header = MessageHeader {
        channel_id,
        sequence,
        log_time: at_ns,
        publish_time: at_ns,
    };
    message
        .encode(buffer)
        .map_err(|error| McapError::Io(std::io::Error::other(error)))?;
    writer.write_to_known_channel(&header, buffer)
}
