//! Keeps the newest valid depth frame.
#![deny(clippy::std_instead_of_core, clippy::alloc_instead_of_core)]

use vigil_types::{DepthFrame, FrameDefect, FrameKeys, Nanos, STEP_NS};

/// A stamp may lie this far in the future: the loop reads its clock before it takes the frame.
const FUTURE_NS: Nanos = STEP_NS;

/// Why a frame was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The frame itself is not acceptable.
    Defect(FrameDefect),
    /// Its stamp is later than now: its age would be unknown.
    FromTheFuture,
    /// Its stamp is not later than that of the frame before: a repetition, or out of order.
    NotNewer,
}

impl Refusal {
    /// Its number, below [`REASONS`].
    const fn code(self) -> usize {
        match self {
            Self::Defect(FrameDefect::WrongSize { .. }) => 0,
            Self::Defect(FrameDefect::WrongSensor { .. }) => 1,
            Self::Defect(FrameDefect::BadChecksum) => 2,
            Self::Defect(FrameDefect::BadPose) => 3,
            Self::Defect(FrameDefect::BadRange) => 4,
            Self::FromTheFuture => 5,
            Self::NotNewer => 6,
            Self::Defect(FrameDefect::BadTag) => 7,
        }
    }
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Defect(defect @ FrameDefect::BadChecksum) => write!(
                f,
                "{defect} (XXH3 of the header, then chained over blocks of 1024 pixels)"
            ),
            Self::Defect(defect @ FrameDefect::WrongSensor { .. }) => {
                write!(f, "{defect}, which is not the configured sensor_id")
            }
            Self::Defect(defect @ FrameDefect::BadTag) => {
                write!(f, "{defect}: not made with --frame-key, or altered on the way")
            }
            Self::Defect(defect) => defect.fmt(f),
            Self::FromTheFuture => f.write_str("frame's stamp lies in the future of CLOCK_MONOTONIC"),
            Self::NotNewer => f.write_str("frame's stamp is not later than that of the frame before"),
        }
    }
}

/// Reasons for which frames are refused.
const REASONS: usize = 8;
/// Their names, by number.
const NAMES: [&str; REASONS] = [
    "size",
    "sensor id",
    "checksum",
    "pose",
    "range",
    "stamp in the future",
    "stamp not newer",
    "authentication",
];

/// Frames refused since start, by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameRefusals {
    counts: [u64; REASONS],
    last: Option<Refusal>,
}

impl FrameRefusals {
    fn count(&mut self, refusal: Refusal) {
        if let Some(count) = self.counts.get_mut(refusal.code()) {
            *count += 1;
        }
        self.last = Some(refusal);
    }

    /// All of them.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Why the last one was refused.
    pub fn last(&self) -> Option<Refusal> {
        self.last
    }

    /// The reasons that there were, and how often.
    pub fn by_reason(&self) -> impl Iterator<Item = (&'static str, u64)> {
        NAMES.into_iter().zip(self.counts).filter(|(_, count)| *count > 0)
    }
}

/// The newest valid frame, and room to check the next.
///
/// A frame is copied first and checked then: the memory it comes from may belong to another process.
#[derive(Debug)]
pub struct FrameKeeper {
    sensor_id: u32,
    keys: FrameKeys,
    frames: [DepthFrame; 2],
    /// The valid frame, if there is one, is the second; the other one is room.
    valid_is_second: Option<bool>,
    refusals: FrameRefusals,
}

impl FrameKeeper {
    /// Accepts frames of `sensor_id`; has none yet.
    pub fn new(sensor_id: u32) -> Self {
        Self {
            sensor_id,
            keys: FrameKeys::default(),
            frames: [DepthFrame::EMPTY; 2],
            valid_is_second: None,
            refusals: FrameRefusals::default(),
        }
    }

    /// From now on takes only frames that were made with one of these keys, if there are any.
    pub fn require(&mut self, keys: FrameKeys) {
        self.keys = keys;
    }

    /// Takes a frame, or counts it as refused; the newest valid one then stays. `known_altered` is what a log says of a frame
    /// whose key is not at hand any more.
    ///
    /// # Errors
    /// The first [`Refusal`] found.
    pub fn take(&mut self, frame: &DepthFrame, known_altered: bool, now_ns: Nanos) -> Result<(), Refusal> {
        let newest_ns = self.newest().map(|valid| valid.header.stamp_ns);
        let [first, second] = &mut self.frames;
        let is_second = self.valid_is_second == Some(true);
        let candidate = if is_second { first } else { second };
        candidate.header = frame.header;
        candidate.depth.copy_from_slice(&frame.depth);
        let checked = check(candidate, self.sensor_id, newest_ns, now_ns).and_then(|()| {
            match !known_altered && self.keys.accept(candidate) {
                true => Ok(()),
                false => Err(Refusal::Defect(FrameDefect::BadTag)),
            }
        });
        match checked {
            Ok(()) => self.valid_is_second = Some(!is_second),
            Err(refusal) => self.refusals.count(refusal),
        }
        checked
    }

    /// The newest valid frame.
    pub fn newest(&self) -> Option<&DepthFrame> {
        let [first, second] = &self.frames;
        Some(if self.valid_is_second? { second } else { first })
    }

    /// Turns the newest valid frame's pose about the vertical: a sensor has it from the vehicle's report.
    pub fn correct_heading(&mut self, turn_rad: f32) {
        let [first, second] = &mut self.frames;
        let is_second = self.valid_is_second == Some(true);
        let header = &mut if is_second { second } else { first }.header;
        header.attitude = header.attitude.turned_heading(turn_rad);
    }

    /// The newest valid frame, if it is at most so old.
    pub fn fresh(&self, now_ns: Nanos, age_limit_ns: Nanos) -> Option<&DepthFrame> {
        self.newest()
            .filter(|frame| now_ns.saturating_sub(frame.header.stamp_ns) <= age_limit_ns)
    }

    /// Frames refused so far, by reason.
    pub fn refusals(&self) -> FrameRefusals {
        self.refusals
    }
}

fn check(frame: &DepthFrame, sensor_id: u32, newest_ns: Option<Nanos>, now_ns: Nanos) -> Result<(), Refusal> {
    frame.check(sensor_id).map_err(Refusal::Defect)?;
    let stamp_ns = frame.header.stamp_ns;
    if stamp_ns > now_ns.saturating_add(FUTURE_NS) {
        return Err(Refusal::FromTheFuture);
    }
    if newest_ns.is_some_and(|newest_ns| stamp_ns <= newest_ns) {
        return Err(Refusal::NotNewer);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sealed(stamp_ns: Nanos, sequence: u64) -> Box<DepthFrame> {
        let mut frame = Box::new(DepthFrame::EMPTY);
        frame.header.stamp_ns = stamp_ns;
        frame.header.sequence = sequence;
        frame.seal();
        frame
    }

    fn keeper() -> Box<FrameKeeper> {
        Box::new(FrameKeeper::new(0))
    }

    #[test]
    fn valid_frames_replace_each_other_and_a_bad_one_leaves_the_newest_in_place() {
        let mut keeper = keeper();
        assert!(keeper.newest().is_none());
        for i in 1..5 {
            assert_eq!(keeper.take(&sealed(i * STEP_NS, i), false, i * STEP_NS), Ok(()));
            assert_eq!(keeper.newest().map(|f| f.header.sequence), Some(i));
            let mut torn = sealed(i * STEP_NS + 1, 99);
            torn.depth[7] = 0.5;
            let refused = keeper.take(&torn, false, i * STEP_NS + 1);
            assert_eq!(refused, Err(Refusal::Defect(FrameDefect::BadChecksum)));
            assert_eq!(keeper.newest(), Some(&*sealed(i * STEP_NS, i)));
        }
        assert_eq!(keeper.refusals().total(), 4);
    }

    #[test]
    fn a_repeated_frame_does_not_become_fresh_and_a_restarted_publisher_does() {
        let mut keeper = keeper();
        assert_eq!(keeper.take(&sealed(100, 41), false, 100), Ok(()));
        assert_eq!(keeper.take(&sealed(100, 41), false, 200), Err(Refusal::NotNewer));
        assert_eq!(keeper.take(&sealed(90, 42), false, 200), Err(Refusal::NotNewer));
        assert_eq!(
            keeper.take(&sealed(300, 0), false, 300),
            Ok(()),
            "sequences start again, stamps go on"
        );
    }

    #[test]
    fn a_stamp_from_the_future_would_stay_fresh_for_ever_and_is_refused() {
        let mut keeper = keeper();
        for stamp_ns in [100 + FUTURE_NS + 1, u64::MAX] {
            let refused = keeper.take(&sealed(stamp_ns, 0), false, 100);
            assert_eq!(refused, Err(Refusal::FromTheFuture));
        }
        assert_eq!(keeper.take(&sealed(100 + FUTURE_NS, 0), false, 100), Ok(()));
    }
}
