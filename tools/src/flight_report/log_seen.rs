//! A log as a report reads it: its steps, its story, and how far it goes.

use std::collections::HashMap;
use std::path::Path;
use vigil_firmware::FirmwareConfig;
use vigil_log::{FlightInfo, LogEnd, ReadError, Reader, Story, TickRecord};
use vigil_sim::world::Solid;
use vigil_types::{
    AlarmResponse, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, GuidanceState, Kinematics, Landed, Nanos, NedVector, PilotKind,
    StepReport,
};

/// Who had the vehicle in a step; the number is the place in this list.
pub const WHO: [&str; 7] = [
    "nobody",
    "take-off",
    "actor",
    "recovery pilot",
    "hold",
    "landing",
    "geometric pilot",
];

/// What is kept of a step while the log is read.
#[derive(Debug, Clone)]
pub struct StepSeen {
    /// Its number.
    pub step: u64,
    /// Its time by the loop's clock.
    pub now_ns: Nanos,
    /// What it decided.
    pub report: StepReport,
    /// Whether it had a new frame.
    pub has_frame: bool,
    /// Nearest return in the frame that was new, metres.
    pub nearest_return_m: Option<f32>,
    /// Distance to the course's nearest obstacle, metres.
    pub clearance_m: Option<f32>,
}

/// A log as far as it can be read.
pub struct LogSeen {
    /// Who flew with which settings.
    pub info: FlightInfo,
    /// The configuration, if this version understands it.
    pub config: Option<FirmwareConfig>,
    /// Added to the loop's time gives UNIX time.
    pub epoch_offset_ns: u64,
    /// What the log holds besides its records.
    pub story: Story,
    /// By how much each altered frame moved the yaw output, by the frame's number; `None` when nobody noted it.
    pub altered: Option<HashMap<u64, f32>>,
    /// The steps.
    pub steps: Vec<StepSeen>,
    /// How the log ends, if it is whole.
    pub end: Option<LogEnd>,
    /// Why it could not be read further.
    pub damage: Option<String>,
}

impl LogSeen {
    /// Reads a log from its first record to its end or to where it is damaged.
    ///
    /// # Errors
    /// [`ReadError`] of what is no log, or one of another version.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        let mut reader = Reader::open(path)?;
        let story = Story::read(path)?;
        let solids: Vec<Solid> = story.solids.iter().map(crate::cli::scene::solid).collect();
        let mut steps = Vec::new();
        let mut record = Box::<TickRecord>::default();
        let damage = loop {
            match reader.read_next(&mut record) {
                Ok(true) => steps.push(StepSeen::of(&record, &solids)),
                Ok(false) => break None,
                Err(error) => break Some(error.to_string()),
            }
        };
        let altered = story.attack.iter().filter(|m| m.altered);
        let altered = altered.map(|m| (m.frame_sequence, m.yaw_change)).collect();
        Ok(Self {
            altered: (!story.attack.is_empty()).then_some(altered),
            config: FirmwareConfig::from_toml(&reader.info().config_toml).ok(),
            info: reader.info().clone(),
            epoch_offset_ns: reader.epoch_offset_ns(),
            end: reader.end(),
            story,
            steps,
            damage,
        })
    }

    /// Seconds since the first step.
    pub fn seconds(&self, at_ns: Nanos) -> f64 {
        let first_ns = self.steps.first().map_or(0, |s| s.now_ns);
        // Signed: what the simulator saw before the first step lies before it.
        rounded((at_ns as i64).wrapping_sub(first_ns as i64) as f64 * 1e-9, 4)
    }

    /// The detector's threshold: as logged, else that of the detector which the configuration names, if it is the one that flew.
    pub fn threshold(&self) -> Option<f32> {
        self.info.detector_threshold.or_else(|| {
            let config = self.config.as_ref()?;
            let detector = config.frozen_detector().ok().flatten()?;
            let flew = self.info.detector_sha256.as_ref()?;
            (*flew == detector.sha256()).then(|| config.detector.threshold.unwrap_or(detector.threshold))
        })
    }

    /// Who has the vehicle, as a place in [`WHO`].
    pub fn who(&self, report: &StepReport) -> u8 {
        let kind = self.config.as_ref().map(|c| c.pilot.kind);
        match report.state {
            GuidanceState::Standby | GuidanceState::Ready => 0,
            GuidanceState::Engaging => 1,
            GuidanceState::Guided if report.alarm.is_some_and(|a| a.response == AlarmResponse::Recovery) => 3,
            GuidanceState::Guided if kind == Some(PilotKind::Geometric) => 6,
            GuidanceState::Guided => 2,
            GuidanceState::Hold => 4,
            GuidanceState::Land => 5,
        }
    }

    /// By how much the altered frame of a step moved the yaw output, if it had one.
    pub fn yaw_change(&self, step: &StepSeen) -> Option<f32> {
        self.altered.as_ref()?.get(&step.report.frame_sequence?).copied()
    }

    /// Whether a step had an altered frame.
    pub fn is_altered(&self, step: &StepSeen) -> bool {
        self.yaw_change(step).is_some()
    }

    /// The last goal.
    pub fn goal_ned_m(&self) -> Option<NedVector> {
        let goal = self.steps.iter().rev().find_map(|s| s.report.goal)?;
        Some(goal.position_ned_m)
    }

    /// When the flight ended, where that is known; the log may go on.
    pub fn ended_ns(&self) -> Option<Nanos> {
        self.story.about.get("ended_ns")?.parse().ok()
    }

    /// Whether the vehicle was ever in the air.
    pub fn took_off(&self) -> bool {
        let in_air = |s: &StepSeen| {
            let telemetry = &s.report.telemetry;
            telemetry.landed == Landed::InAir
                || telemetry.kinematics.is_some_and(|k| k.position_ned_m.z < -0.5)
                || matches!(s.report.state, GuidanceState::Guided)
        };
        self.steps.iter().any(in_air)
    }

    /// The steps in which an alarm was raised, or changed its cause.
    pub fn alarms(&self) -> Vec<usize> {
        let cause = |i: usize| self.steps[i].report.alarm.map(|a| a.cause);
        (0..self.steps.len())
            .filter(|&i| cause(i).is_some() && (i == 0 || cause(i - 1) != cause(i)))
            .collect()
    }
}

impl StepSeen {
    fn of(record: &TickRecord, solids: &[Solid]) -> Self {
        let clearance = |position: NedVector| {
            let to_solid = solids.iter().map(|s| s.distance_m(position));
            to_solid.fold(f32::INFINITY, f32::min)
        };
        let mut seen = Self {
            step: record.timing.step,
            now_ns: record.now_ns,
            report: record.report,
            has_frame: record.frame().is_some(),
            nearest_return_m: record.frame().map(|f| nearest_return_m(&f.depth)),
            clearance_m: None,
        };
        seen.clearance_m = seen.position_ned_m().map(clearance).filter(|c| c.is_finite());
        seen
    }

    /// How the vehicle took itself to move.
    pub fn moves(&self) -> Option<Kinematics> {
        self.report.telemetry.kinematics
    }

    /// Where the vehicle took itself to be.
    pub fn position_ned_m(&self) -> Option<NedVector> {
        Some(self.moves()?.position_ned_m).filter(|p| p.is_finite())
    }
}

/// The range that one in a hundred pixels within 15° of level falls short of, metres: a single pixel may be noise, or the
/// adversary's, and the ground below is no obstacle.
fn nearest_return_m(depth: &[f32; DEPTH_PIXELS]) -> f32 {
    const QUARTER: usize = DEPTH_PIXELS / 4;
    let mut level: Vec<f32> = depth[QUARTER..3 * QUARTER].to_vec();
    let (_, range, _) = level.select_nth_unstable_by(2 * QUARTER / 100, f32::total_cmp);
    *range * DEPTH_FULL_SCALE_M
}

/// A number with so many decimals; the page need not carry more.
pub fn rounded(value: f64, decimals: i32) -> f64 {
    let scale = 10_f64.powi(decimals);
    (value * scale).round() / scale
}
