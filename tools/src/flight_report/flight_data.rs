//! What a report shows of a flight, taken from its log.

use crate::flight_report::film::{self, Film, Picture};
use crate::flight_report::page::DATA_LIMIT;
use crate::flight_report::words;
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use vigil_firmware::FirmwareConfig;
use vigil_log::{FlightInfo, LogEnd, ReadError, Reader, SceneSolid, Story, TickRecord};
use vigil_sim::world::Solid;
use vigil_types::{
    AlarmResponse, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, EXPLAINED_STATE, GuidanceState, Landed, Nanos, NedVector,
    PilotKind, Reason, StepReport,
};

/// What to put into a report besides what the log holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReportOptions {
    /// Frames around the first alarm whose pixels are explained; each costs about as much as a step has time.
    pub explained_frames: usize,
}

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The log cannot be read at all.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The log is good and holds no step.
    #[error("{0} holds no step: the recording ended before the first one, so there is nothing to show")]
    NoSteps(String),
    /// A picture cannot be made.
    #[error("a picture of the report cannot be made: {0}")]
    Picture(String),
}

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

/// A flight as its report shows it. Times are seconds since the first step.
#[derive(Debug, Clone, Serialize)]
pub struct Flight {
    /// What flew where.
    pub title: String,
    /// How it went, in a sentence.
    pub verdict: Verdict,
    /// What the reader must know of the log: damage, gaps, what is missing.
    pub notes: Vec<String>,
    /// Names and values.
    pub facts: Vec<(String, String)>,
    /// The command that flies it again, if it is known.
    pub command: Option<String>,
    /// The configuration in the log.
    pub config: String,
    /// Who made the report.
    pub footer: String,
    /// Names of [`Self::who`]'s numbers.
    pub who_names: [&'static str; WHO.len()],
    /// Time of each step.
    pub t: Vec<f64>,
    /// Quantities, a value for each step; nothing where there is none.
    pub columns: BTreeMap<&'static str, Vec<Option<f64>>>,
    /// Who had the vehicle in each step.
    pub who: Vec<u8>,
    /// Whether each step's frame was altered, where that is known.
    pub attack: Option<Vec<u8>>,
    /// When alarms were raised.
    pub alarms: Vec<AlarmRaised>,
    /// The explanations of all steps, if there are any.
    pub phi: Option<Explanations>,
    /// Seen from above.
    pub map: Map,
    /// The film.
    pub frames: Vec<Picture>,
    /// The frame to show first.
    pub first_frame: usize,
    /// Why there is no film.
    pub film_none: String,
    /// What happened.
    pub events: Vec<Event>,
}

/// How a flight went.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// A sentence.
    pub text: String,
    /// Whether the goal was reached.
    pub good: bool,
}

/// An alarm that was raised.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AlarmRaised {
    /// When.
    pub t: f64,
    /// Why.
    pub cause: &'static str,
}

/// The 48 explained values of each step as bytes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explanations {
    /// Values of a step.
    pub rows: usize,
    /// What 127 stands for, action units.
    pub full: f64,
    /// Signed bytes, step by step, in base64; −128 where there is none.
    pub values: String,
}

/// The course and the true path from above; positions are north, east in metres.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Map {
    /// Obstacles.
    pub solids: Vec<Outline>,
    /// The last goal.
    pub goal: Option<[f64; 2]>,
    /// True positions, where the simulator noted them.
    pub truth: Vec<[f64; 2]>,
}

/// An obstacle from above.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outline {
    /// Corners.
    pub outline: Vec<[f64; 2]>,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// When.
    pub t: f64,
    /// `info`, `warning` or `error`.
    pub weight: &'static str,
    /// What.
    pub text: String,
}

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
    /// What the log tells besides its records.
    pub story: Story,
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
        let solids: Vec<Solid> = story.solids.iter().map(solid).collect();
        let mut steps = Vec::new();
        let mut record = Box::<TickRecord>::default();
        let damage = loop {
            match reader.read_next(&mut record) {
                Ok(true) => steps.push(StepSeen::of(&record, &solids)),
                Ok(false) => break None,
                Err(error) => break Some(error.to_string()),
            }
        };
        Ok(Self {
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
        let geometric = self
            .config
            .as_ref()
            .is_some_and(|c| c.pilot.kind == PilotKind::Geometric);
        match report.state {
            GuidanceState::Standby | GuidanceState::Ready => 0,
            GuidanceState::Engaging => 1,
            GuidanceState::Guided if report.alarm.is_some_and(|a| a.response == AlarmResponse::Recovery) => 3,
            GuidanceState::Guided if geometric => 6,
            GuidanceState::Guided => 2,
            GuidanceState::Hold => 4,
            GuidanceState::Land => 5,
        }
    }

    /// Which frames were altered; `None` when nobody noted it.
    pub fn altered(&self) -> Option<HashMap<u64, f32>> {
        let marks = &self.story.attack;
        (!marks.is_empty()).then(|| {
            let altered = marks.iter().filter(|m| m.altered);
            altered.map(|m| (m.frame_sequence, m.yaw_change)).collect()
        })
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

    /// Whether the firmware held at the goal.
    pub fn reached_goal(&self) -> bool {
        let at_goal = |s: &StepSeen| s.report.reasons.contains(Reason::GoalReached);
        self.steps.iter().any(at_goal)
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
        let position = record.report.telemetry.kinematics.map(|k| k.position_ned_m);
        Self {
            step: record.timing.step,
            now_ns: record.now_ns,
            report: record.report,
            has_frame: record.frame().is_some(),
            nearest_return_m: record.frame().map(|f| nearest_return_m(&f.depth)),
            clearance_m: position
                .filter(|p| p.is_finite())
                .map(clearance)
                .filter(|c| c.is_finite()),
        }
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

/// Reads a log and makes of it what a report shows. A log that was cut off or is damaged shows what is whole, and says so.
///
/// # Errors
/// [`ReportError`]: a file that is no log of this version, or holds no step.
pub fn read(path: &Path, options: ReportOptions) -> Result<Flight, ReportError> {
    let log = LogSeen::read(path)?;
    if log.steps.is_empty() {
        return Err(ReportError::NoSteps(path.display().to_string()));
    }
    let film = film::take(path, &log, options)?;
    Ok(flight(path, &log, film))
}

fn flight(path: &Path, log: &LogSeen, film: Film) -> Flight {
    let stride = log.steps.len().div_ceil(DATA_LIMIT);
    let kept: Vec<&StepSeen> = log.steps.iter().step_by(stride).collect();
    let altered = log.altered();
    let attack = altered.as_ref().map(|altered| {
        let is = |s: &&StepSeen| s.report.frame_sequence.is_some_and(|f| altered.contains_key(&f));
        kept.iter().map(|s| u8::from(is(s))).collect()
    });
    let mut notes = words::notes(log);
    if stride > 1 {
        notes.push(format!(
            "The plots show every {stride}th of {} steps; the log holds all.",
            log.steps.len()
        ));
    }
    notes.extend(film.note);
    Flight {
        title: words::title(path, log),
        verdict: words::verdict(log),
        notes,
        facts: words::facts(path, log),
        command: log.story.about.get("command").cloned(),
        config: log.info.config_toml.clone(),
        footer: format!(
            "Made by vigil {} from {}. Times are seconds since the log's first step.",
            env!("CARGO_PKG_VERSION"),
            path.file_name().unwrap_or_default().to_string_lossy()
        ),
        who_names: WHO,
        t: kept.iter().map(|s| log.seconds(s.now_ns)).collect(),
        columns: columns(&kept, log.threshold()),
        who: kept.iter().map(|s| log.who(&s.report)).collect(),
        attack,
        alarms: log
            .alarms()
            .into_iter()
            .filter_map(|i| {
                let step = log.steps.get(i)?;
                Some(AlarmRaised {
                    t: log.seconds(step.now_ns),
                    cause: step.report.alarm?.cause.name(),
                })
            })
            .collect(),
        phi: explanations(&kept),
        map: map(log),
        film_none: film.none,
        first_frame: film.first,
        frames: film.pictures,
        events: words::events(log),
    }
}

/// A number with so many decimals; the page need not carry more.
pub fn rounded(value: f64, decimals: i32) -> f64 {
    let scale = 10_f64.powi(decimals);
    (value * scale).round() / scale
}

fn columns(steps: &[&StepSeen], threshold: Option<f32>) -> BTreeMap<&'static str, Vec<Option<f64>>> {
    type Value = fn(&StepSeen) -> Option<f32>;
    const MS: f64 = 1e-6;
    let columns: [(&str, Value); 23] = [
        ("detector_score", |s| s.report.judgement?.score),
        ("contribution_image", |s| s.report.judgement.map(|j| j.image)),
        ("contribution_bearing", |s| s.report.judgement.map(|j| j.bearing)),
        ("contribution_distance", |s| s.report.judgement.map(|j| j.distance)),
        ("contribution_told", |s| s.report.judgement.map(|j| j.told)),
        ("actor_yaw", |s| s.report.judgement.map(|j| j.yaw())),
        ("action_yaw", |s| s.report.action.map(|a| a.yaw)),
        ("action_forward_m_s", |s| s.report.action.map(|a| a.forward_m_s)),
        ("setpoint_forward_m_s", |s| s.report.setpoint.map(|p| p.velocity_m_s.x)),
        ("setpoint_yaw_rate_deg_s", |s| {
            s.report.setpoint.map(|p| p.yaw_rate_rad_s.to_degrees())
        }),
        ("speed_m_s", |s| {
            s.report
                .telemetry
                .kinematics
                .map(|k| k.velocity_ned_m_s.horizontal_norm())
        }),
        ("climb_m_s", |s| {
            s.report.telemetry.kinematics.map(|k| -k.velocity_ned_m_s.z)
        }),
        ("north_m", |s| s.report.telemetry.kinematics.map(|k| k.position_ned_m.x)),
        ("east_m", |s| s.report.telemetry.kinematics.map(|k| k.position_ned_m.y)),
        ("height_m", |s| {
            s.report.telemetry.kinematics.map(|k| -k.position_ned_m.z)
        }),
        ("heading_deg", |s| {
            s.report.telemetry.attitude.map(|a| a.attitude.yaw_rad().to_degrees())
        }),
        ("yaw_rate_deg_s", |s| {
            s.report.telemetry.attitude.map(|a| a.rates_frd_rad_s.z.to_degrees())
        }),
        ("goal_distance_m", |s| s.report.goal_relative.map(|g| g.distance_m)),
        ("clearance_m", |s| s.clearance_m),
        ("nearest_return_m", |s| s.nearest_return_m),
        ("frame_age_ms", |s| {
            s.report.frame_age_ns.map(|ns| (ns as f64 * MS) as f32)
        }),
        ("telemetry_age_ms", |s| {
            s.report
                .telemetry
                .flight_data_age_ns(s.now_ns)
                .map(|ns| (ns as f64 * MS) as f32)
        }),
        ("wake_late_ms", |s| {
            timed(s).then_some((s.report.timing.wake_late_ns as f64 * MS) as f32)
        }),
    ];
    let number = |value: Option<f32>| {
        let value = value.map(f64::from).filter(|v| v.is_finite());
        value.map(|v| rounded(v, 4))
    };
    let mut table: BTreeMap<&'static str, Vec<Option<f64>>> = columns
        .into_iter()
        .map(|(name, value)| (name, steps.iter().map(|s| number(value(s))).collect()))
        .collect();
    let judged = |s: &&StepSeen| s.report.judgement.and(threshold);
    table.insert("detector_threshold", steps.iter().map(|s| number(judged(s))).collect());
    // A step knows how long the one before it took.
    let took = |s: &StepSeen| timed(s).then_some((s.report.timing.previous_execution_ns as f64 * MS) as f32);
    let mut times: Vec<Option<f64>> = steps.iter().skip(1).map(|s| number(took(s))).collect();
    times.push(None);
    table.insert("step_time_ms", times);
    table
}

/// Whether the loop measured itself: in lockstep it does not.
fn timed(step: &StepSeen) -> bool {
    step.report.timing.previous_execution_ns > 0
}

fn explanations(steps: &[&StepSeen]) -> Option<Explanations> {
    let phi = |s: &&StepSeen| {
        s.report
            .judgement
            .map(|j| j.phi)
            .filter(|phi| phi.iter().all(|v| v.is_finite()))
    };
    let sizes: Vec<f64> = steps
        .iter()
        .filter_map(phi)
        .flat_map(|phi| phi.map(|v| f64::from(v.abs())))
        .collect();
    // A few steps' extremes must not pale all others.
    let full = crate::statistics::quantile(&sizes, 0.995).filter(|full| *full > 0.0)?;
    let byte = |v: f32| ((f64::from(v) / full).clamp(-1.0, 1.0) * 127.0).round() as i8 as u8;
    let none = [i8::MIN as u8; EXPLAINED_STATE];
    let bytes: Vec<u8> = steps
        .iter()
        .flat_map(|s| phi(s).map_or(none, |phi| phi.map(byte)))
        .collect();
    Some(Explanations {
        rows: EXPLAINED_STATE,
        full,
        values: BASE64.encode(bytes),
    })
}

fn map(log: &LogSeen) -> Map {
    let pair = |p: NedVector| [rounded(p.x.into(), 2), rounded(p.y.into(), 2)];
    let goal = log.steps.iter().rev().find_map(|s| s.report.goal);
    // Before take-off and after landing the vehicle stands still: one point of many says that as well.
    let mut truth: Vec<[f64; 2]> = log.story.truth.iter().map(|(_, p)| pair(*p)).collect();
    truth.dedup();
    let stride = truth.len().div_ceil(DATA_LIMIT).max(1);
    Map {
        solids: log.story.solids.iter().map(outline).collect(),
        goal: goal.map(|g| pair(g.position_ned_m)),
        truth: truth.into_iter().step_by(stride).collect(),
    }
}

fn outline(solid: &SceneSolid) -> Outline {
    Outline {
        outline: outline_of(solid).iter().map(|p| p.map(|v| rounded(v, 2))).collect(),
    }
}

/// Corners of a solid seen from above: north, east in metres.
pub fn outline_of(solid: &SceneSolid) -> Vec<[f64; 2]> {
    let points: Vec<[f32; 2]> = match *solid {
        SceneSolid::Cuboid {
            centre_ned_m: [north, east, _],
            half_extents_m: [length, width, _],
            yaw_rad,
        } => {
            let (sin, cos) = yaw_rad.sin_cos();
            [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]
                .map(|(a, b): (f32, f32)| (a * length, b * width))
                .map(|(x, y)| [north + cos * x - sin * y, east + sin * x + cos * y])
                .to_vec()
        }
        SceneSolid::Cylinder {
            centre_ned_m: [north, east, _],
            radius_m,
            ..
        } => (0..20_u8)
            .map(|i| (f32::from(i) * std::f32::consts::TAU / 20.0).sin_cos())
            .map(|(sin, cos)| [north + radius_m * cos, east + radius_m * sin])
            .collect(),
    };
    points.into_iter().map(|p| p.map(f64::from)).collect()
}

/// The same solid with the world's geometry.
pub fn solid(scene: &SceneSolid) -> Solid {
    let vector = |[x, y, z]: [f32; 3]| NedVector::new(x, y, z);
    match *scene {
        SceneSolid::Cuboid {
            centre_ned_m,
            half_extents_m,
            yaw_rad,
        } => Solid::Cuboid {
            centre_ned_m: vector(centre_ned_m),
            half_extents_m,
            yaw_rad,
        },
        SceneSolid::Cylinder {
            centre_ned_m,
            radius_m,
            half_height_m,
        } => Solid::Cylinder {
            centre_ned_m: vector(centre_ned_m),
            radius_m,
            half_height_m,
        },
    }
}
