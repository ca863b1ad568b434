//! What a log shows people besides the records: obstacles, lines of the log panel, and what the simulation added.

use crate::container::{Container, Next};
use crate::display;
use crate::log_file::{META_STORY, topic};
use crate::proto;
use crate::proto::foxglove::log::Level;
use crate::proto::foxglove::{Log, PoseInFrame, RawImage, SceneUpdate};
use crate::{ReadError, Reader, SceneSolid};
use mcap::records::Record;
use prost::Message;
use std::collections::BTreeMap;
use std::path::Path;
use vigil_types::{DEPTH_PIXELS, Nanos, NedVector};

/// A line of the log panel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// When, by the loop's clock.
    pub at_ns: Nanos,
    /// How serious: `info`, something happened; `warning`, it keeps the vehicle from flying on; `error`, an alarm, or missing records.
    pub weight: &'static str,
    /// What.
    pub text: String,
}

/// What the adversary did to a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttackMark {
    /// When it was handed on, by the loop's clock.
    pub at_ns: Nanos,
    /// The frame.
    pub frame_sequence: u64,
    /// Whether it was altered.
    pub altered: bool,
    /// By how much that moved the actor's yaw output, action units.
    pub yaw_change: f32,
}

/// A frame as it was before it was altered.
#[derive(Debug, Clone, PartialEq)]
pub struct CleanFrame {
    /// When the altered one was handed on.
    pub at_ns: Nanos,
    /// The low 32 bits of the frame's number.
    pub sequence: u32,
    /// Its pixels.
    pub depth: Box<[f32; DEPTH_PIXELS]>,
}

/// What a log shows besides the records.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Story {
    /// Obstacles.
    pub solids: Vec<SceneSolid>,
    /// Lines of the log panel.
    pub lines: Vec<Line>,
    /// True positions with their times; empty outside simulation.
    pub truth: Vec<(Nanos, NedVector)>,
    /// What the adversary did to each frame; empty without one.
    pub attack: Vec<AttackMark>,
    /// Some frames as they were before they were altered.
    pub clean: Vec<CleanFrame>,
    /// What is known of the flight as a whole: `command`, `seed`, `course`, `outcome` and others.
    pub about: BTreeMap<String, String>,
}

impl Story {
    /// Reads as much as is whole; a log that was cut or is damaged gives what stands before.
    ///
    /// # Errors
    /// [`ReadError`] of a file that is no log of this format, as [`Reader::open`] has it.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        const SHOWN: [&str; 5] = [
            topic::SCENE,
            topic::LOG,
            topic::TRUTH,
            topic::ATTACK,
            topic::CLEAN_DEPTH,
        ];
        Self::read_of(path, &SHOWN)
    }

    /// [`Story::about`](Self) alone.
    ///
    /// # Errors
    /// As [`Story::read`].
    pub fn about(path: &Path) -> Result<BTreeMap<String, String>, ReadError> {
        Self::read_of(path, &[]).map(|story| story.about)
    }

    fn read_of(path: &Path, shown: &[&str]) -> Result<Self, ReadError> {
        let epoch_offset_ns = Reader::open(path)?.epoch_offset_ns();
        let mut container = Container::open(path)?;
        let mut story = Self::default();
        let mut topics = BTreeMap::new();
        loop {
            match container.next_of(&topics) {
                Ok(Next::Record(Record::Channel(channel))) => {
                    if shown.contains(&channel.topic.as_str()) {
                        topics.insert(channel.id, channel.topic);
                    }
                }
                Ok(Next::Record(Record::Metadata(meta))) if meta.name == META_STORY => story.about = meta.metadata,
                Ok(Next::Record(Record::Message { header, data })) => {
                    let at_ns = header.log_time.saturating_sub(epoch_offset_ns);
                    if let Some(topic) = topics.get(&header.channel_id) {
                        story.take(topic, at_ns, header.sequence, &data);
                    }
                }
                Ok(Next::Record(_)) => {}
                Ok(Next::End | Next::Cut) | Err(_) => return Ok(story),
            }
        }
    }

    /// A message that does not decode is left out: the records are what counts, and they are checked elsewhere.
    fn take(&mut self, topic: &str, at_ns: Nanos, sequence: u32, data: &[u8]) -> Option<()> {
        match topic {
            topic::SCENE => self.solids = crate::scene::solids_of(&SceneUpdate::decode(data).ok()?),
            topic::LOG => {
                let log = Log::decode(data).ok()?;
                self.lines.push(Line {
                    at_ns,
                    weight: match log.level {
                        level if level >= Level::Error as i32 => "error",
                        level if level >= Level::Warning as i32 => "warning",
                        _ => "info",
                    },
                    text: log.message,
                });
            }
            topic::TRUTH => {
                let position = PoseInFrame::decode(data).ok()?.pose?.position?;
                self.truth.push((at_ns, display::ned_point(position)));
            }
            topic::ATTACK => {
                let mark = proto::Attack::decode(data).ok()?;
                self.attack.push(AttackMark {
                    at_ns: mark.now_ns,
                    frame_sequence: mark.frame_sequence,
                    altered: mark.altered > 0.5,
                    yaw_change: mark.yaw_change as f32,
                });
            }
            _ => {
                let mut depth = Box::new([0.0; DEPTH_PIXELS]);
                let image = RawImage::decode(data).ok()?;
                display::read_depth_image(&image, &mut depth).then_some(())?;
                self.clean.push(CleanFrame { at_ns, sequence, depth });
            }
        }
        Some(())
    }
}
