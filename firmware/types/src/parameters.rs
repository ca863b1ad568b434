//! The table of parameters: everything that can be set of the firmware, each stated once.
//!
//! From a row here come the range that the configuration file ([`ParameterSpec::key`]) and guidance's own check accept, the
//! default, the MAVLink parameter of that name, the text of `--help` and the reference in docs/firmware.md.

use crate::{
    ACTION_LIMIT, Ablation, AlarmPolicy, AtGoal, AutopilotChoice, Choice, Duty, EngagePolicy, FASTEST_M_S, LogContent,
    ObstacleReports, OnNoProgress, PilotKind,
};
use core::fmt;

/// A row of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterSpec {
    /// Its place in the configuration file: sections and name, separated by dots.
    pub key: &'static str,
    /// What its values are.
    pub kind: Kind,
    /// What holds where nothing is set.
    pub default: Preset,
    /// What it means: a phrase, which the range follows.
    pub text: &'static str,
    /// Its place in the MAVLink parameter protocol, if it has one.
    pub mavlink: Option<MavlinkName>,
}

/// What the values of a parameter are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// A number.
    Real(Range),
    /// A whole number.
    Whole(Range),
    /// On or off.
    Switch,
    /// One of these names, each with what it means ([`Choice::WORDS`]).
    Choice(&'static [(&'static str, &'static str)]),
    /// A file, a folder or a link.
    Text,
}

/// The numbers that a parameter accepts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Unit, empty where there is none.
    pub unit: &'static str,
    /// Least value accepted.
    pub least: f64,
    /// Greatest value accepted.
    pub greatest: f64,
    /// 0 is accepted besides, and means never or not at all.
    pub or_zero: bool,
}

/// What holds where nothing is set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Preset {
    /// This number.
    Number(f64),
    /// On or off.
    Switch(bool),
    /// The choice of this number.
    Choice(usize),
    /// Nothing; the parameter's text says what that means. The reference shows this value as an example, written as in TOML.
    Absent(&'static str),
}

/// A name in the MAVLink parameter protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MavlinkName {
    /// At most 16 characters.
    pub name: &'static str,
    /// May be changed while guidance flies.
    pub in_flight: bool,
}

/// A value that a parameter does not accept.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{key} is {value}, allowed is {range}")]
pub struct OutOfRange {
    /// The parameter's [`ParameterSpec::key`].
    pub key: &'static str,
    /// The value given.
    pub value: f64,
    /// What is accepted.
    pub range: Range,
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.greatest.is_finite() {
            true => write!(f, "{} to {}", self.least, self.greatest)?,
            false => write!(f, "{} or more", self.least)?,
        }
        if !self.unit.is_empty() {
            write!(f, " {}", self.unit)?;
        }
        f.write_str(if self.or_zero { ", or 0" } else { "" })
    }
}

impl Range {
    /// So much or more.
    pub const fn from_least(least: f64) -> Self {
        Self::of(least, f64::INFINITY, "")
    }

    /// From `least` to `greatest`.
    pub const fn of(least: f64, greatest: f64, unit: &'static str) -> Self {
        Self {
            unit,
            least,
            greatest,
            or_zero: false,
        }
    }

    /// Whether a value is accepted. NaN is in no range. Of a limit that is no whole number the f32 next to it is accepted as well.
    pub fn contains(&self, value: f64) -> bool {
        let is_whole = |limit: f64| limit == limit as i64 as f64;
        let nearest = |limit: f64| {
            if is_whole(limit) {
                limit
            } else {
                f64::from(limit as f32)
            }
        };
        let least = self.least.min(nearest(self.least));
        let greatest = self.greatest.max(nearest(self.greatest));
        (value >= least && value <= greatest) || (self.or_zero && value == 0.0)
    }
}

impl ParameterSpec {
    /// A number.
    pub const fn real(
        key: &'static str,
        (least, greatest): (f64, f64),
        unit: &'static str,
        default: f64,
        text: &'static str,
    ) -> Self {
        let range = Range::of(least, greatest, unit);
        Self::row(key, Kind::Real(range), Preset::Number(default), text)
    }

    const fn row(key: &'static str, kind: Kind, default: Preset, text: &'static str) -> Self {
        Self {
            key,
            kind,
            default,
            text,
            mavlink: None,
        }
    }

    /// A number that no table lists: only programs set it.
    pub const fn unlisted(key: &'static str, range: (f64, f64), unit: &'static str, default: f64) -> Self {
        Self::real(key, range, unit, default, "")
    }

    /// A whole number.
    pub const fn whole(
        key: &'static str,
        (least, greatest): (u32, u32),
        unit: &'static str,
        default: u32,
        text: &'static str,
    ) -> Self {
        let range = Range::of(least as f64, greatest as f64, unit);
        Self::row(key, Kind::Whole(range), Preset::Number(default as f64), text)
    }

    /// On or off.
    const fn switch(key: &'static str, default: bool, text: &'static str) -> Self {
        Self::row(key, Kind::Switch, Preset::Switch(default), text)
    }

    /// One of the values of a [`Choice`].
    const fn choice(
        key: &'static str,
        words: &'static [(&'static str, &'static str)],
        default: usize,
        text: &'static str,
    ) -> Self {
        Self::row(key, Kind::Choice(words), Preset::Choice(default), text)
    }

    /// A file, a folder or a link.
    const fn text(key: &'static str, example: &'static str, text: &'static str) -> Self {
        Self::row(key, Kind::Text, Preset::Absent(example), text)
    }

    /// The same without a default.
    const fn absent(self, example: &'static str) -> Self {
        Self {
            default: Preset::Absent(example),
            ..self
        }
    }

    /// The same accepting 0 besides.
    const fn or_zero(self) -> Self {
        let kind = match self.kind {
            Kind::Real(range) => Kind::Real(Range { or_zero: true, ..range }),
            other => other,
        };
        Self { kind, ..self }
    }

    /// The same in the MAVLink parameter protocol.
    const fn mavlink(self, name: &'static str, in_flight: bool) -> Self {
        Self {
            mavlink: Some(MavlinkName { name, in_flight }),
            ..self
        }
    }

    /// The numbers accepted; for a choice those of its values, for a switch 0 and 1. `None` for a text.
    pub fn range(&self) -> Option<Range> {
        let codes = |count: usize| Range::of(0.0, count.saturating_sub(1) as f64, "");
        match self.kind {
            Kind::Real(range) | Kind::Whole(range) => Some(range),
            Kind::Switch => Some(codes(2)),
            Kind::Choice(words) => Some(codes(words.len())),
            Kind::Text => None,
        }
    }

    /// Whether a number is accepted.
    ///
    /// # Errors
    /// [`OutOfRange`], with what is.
    pub fn check(&self, value: f64) -> Result<(), OutOfRange> {
        match self.range() {
            Some(range) if !range.contains(value) => Err(OutOfRange {
                key: self.key,
                value,
                range,
            }),
            _ => Ok(()),
        }
    }

    /// The default of a number; 0 where there is none.
    pub const fn number(&self) -> f64 {
        match self.default {
            Preset::Number(value) => value,
            Preset::Switch(_) | Preset::Choice(_) | Preset::Absent(_) => 0.0,
        }
    }

    /// The same as an f32.
    pub const fn number_f32(&self) -> f32 {
        self.number() as f32
    }

    /// The default of a number of seconds, in nanoseconds.
    pub const fn nanos(&self) -> crate::Nanos {
        // To the nearest: 0.3 s are 300 000 000 ns.
        (self.number() * 1e9 + 0.5) as crate::Nanos
    }

    /// The default of a switch; off where there is none.
    pub const fn is_on(&self) -> bool {
        matches!(self.default, Preset::Switch(true))
    }
}

/// A section of the configuration file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Section {
    /// Its name; its parameters' keys begin with it.
    pub name: &'static str,
    /// What it is for.
    pub text: &'static str,
    /// Where it is left out, nothing of it holds.
    pub is_optional: bool,
}

impl Section {
    const fn new(name: &'static str, is_optional: bool, text: &'static str) -> Self {
        Self {
            name,
            text,
            is_optional,
        }
    }
}

/// The sections, in the order of the reference; what belongs to none comes before them.
pub const SECTIONS: &[Section] = &[
    Section::new("goal", true, "without a goal, an operator sets it"),
    Section::new("signing", false, "who may speak on the links"),
    Section::new("limits", false, "when to hold or land"),
    Section::new(
        "limits.geofence",
        true,
        "a cylinder around home; without it there is none",
    ),
    Section::new(
        "just_stop",
        false,
        "how a vehicle that is guarded stops (docs/just-stop.md)",
    ),
    Section::new("pilot", false, "who decides"),
    Section::new(
        "detector",
        false,
        "what watches the actor, and what an alarm brings about; without an actor there is nothing to watch (docs/detection.md)",
    ),
    Section::new("rate", false, "the loop"),
    Section::new("log", false, "the flight log"),
    Section::new("state", false, "what outlives a restart"),
];

/// Highest instance number: the ports of the next one would be the simulator's own.
pub const MAX_INSTANCE: u32 = 99;
/// Farthest place north or east of the local origin, metres: beyond it an f32 no longer holds centimetres well.
pub const GREATEST_COORDINATE_M: f32 = 10_000.0;
const COORDINATE_M: (f64, f64) = (-(GREATEST_COORDINATE_M as f64), GREATEST_COORDINATE_M as f64);
const HEIGHT_M: (f64, f64) = (0.1, 1000.0);
const LENGTH_M: (f64, f64) = (0.1, 100_000.0);
const AGE_S: (f64, f64) = (0.05, 10.0);
const LONG_TIME_S: (f64, f64) = (1.0, 86_400.0);
/// What a vehicle is asked to fly at the most.
const SPEED_M_S: (f64, f64) = (0.1, FASTEST_M_S as f64);
/// The geometric pilot's: its actions have the paper's limit.
const CRUISE_M_S: (f64, f64) = (0.1, ACTION_LIMIT as f64);
/// Longest count of steps: one minute.
const STEPS: (u32, u32) = (1, 1200);

macro_rules! table {
    ($($name:ident = $function:ident($($argument:expr),+ $(,)?) $(.$then:ident($($more:expr),*))*;)+) => {
        $(
            #[allow(missing_docs, reason = "the row says it")]
            pub const $name: ParameterSpec = ParameterSpec::$function($($argument),+) $(.$then($($more),*))*;
        )+

        /// All rows, in the order of the reference.
        pub const ALL: &[ParameterSpec] = &[$($name),+];
    };
}

table! {
    INSTANCE = whole("instance", (0, MAX_INSTANCE), "", 0, "number of this set of processes; port, system and shared memory follow from it");
    LINK = text("link", "\"udpin://127.0.0.1:14030,system=1\"", "where the vehicle's MAVLink is; default: the simulator of this instance");
    LINKS = text(
        "links",
        "[\"udpout://127.0.0.1:14560\", \"tcpin://0.0.0.0:5760,unsigned=never,rate=20000\"]",
        "for ground stations, at most 4"
    );
    VEHICLE = choice("vehicle", AutopilotChoice::WORDS, AutopilotChoice::Auto as usize, "which autopilot the vehicle has; one of another is not flown");
    DUTY = choice("duty", Duty::WORDS, Duty::Fly as usize, "whose flight it is (docs/just-stop.md)").mavlink("GD_DUTY", true);
    OBSTACLE_DISTANCE = choice(
        "obstacle_distance",
        ObstacleReports::WORDS,
        ObstacleReports::Flight as usize,
        "when OBSTACLE_DISTANCE is sent (docs/firmware.md, \"Obstacles for the autopilot\")"
    );
    SENSOR_ID = whole("sensor_id", (0, u32::MAX), "", 1, "frames of other sensors are refused");
    FRAME_KEY_FILES = text(
        "frame_key_files",
        "[\"frame.key\"]",
        "files with the secret of the depth frames' key: 64 hexadecimal digits or 32 bytes, mode 0600; two while a key is exchanged: \
         either is accepted; frames that were made with neither are refused, without it frames are not authenticated \
         (docs/frame-authentication.md)"
    );
    PLAUSIBILITY = switch(
        "plausibility",
        true,
        "check frames before the pilots see them, so that a sensor that is dead, frozen or wrong holds the flight (docs/sensor-faults.md)"
    );
    SECOND_SENSOR = switch(
        "second_sensor",
        false,
        "a second sensor, whose OBSTACLE_DISTANCE comes from the vehicle, must see nothing nearer than the depth frames show (docs/second-sensor.md)"
    );
    ENGAGE = choice("engage", EngagePolicy::WORDS, EngagePolicy::Command as usize, "who starts a flight");
    AT_GOAL = choice("at_goal", AtGoal::WORDS, AtGoal::Hold as usize, "what to do at the goal").mavlink("GD_AT_GOAL", true);
    HEIGHT = real("height_m", HEIGHT_M, "m", 2.5, "height above home of goals that do not tell theirs");

    GOAL_NORTH = real("goal.north_m", COORDINATE_M, "m", 0.0, "from home").absent("20.0");
    GOAL_EAST = real("goal.east_m", COORDINATE_M, "m", 0.0, "from home").absent("5.0");
    GOAL_HEIGHT = real("goal.height_m", HEIGHT_M, "m", 0.0, "above home; default: height_m above").absent("2.5");

    ALLOW_UNSIGNED = choice(
        "signing.allow_unsigned",
        &[("loopback", "senders on this machine"), ("never", "nobody"), ("always", "everybody who reaches the link")],
        0,
        "from whom packets without a signature are accepted"
    );
    ACCEPT_FIRST_KEY = switch(
        "signing.accept_first_key",
        false,
        "while there is no key, take one by SETUP_SIGNING from whoever may speak without a signature; without this, and once there \
         is a key, only a packet signed with it brings another"
    );
    KEY_FILE = text(
        "signing.key_file",
        "\"vigil.key\"",
        "file with the key of MAVLink signing: 64 hexadecimal digits or 32 bytes, mode 0600; without it nothing is signed"
    );

    FRAME_AGE = real("limits.frame_age_s", AGE_S, "s", 0.25, "greatest age of the newest valid depth frame");
    TELEMETRY_AGE = real("limits.telemetry_age_s", AGE_S, "s", 0.3, "greatest age of position and attitude");
    HEARTBEAT_AGE = real("limits.heartbeat_age_s", AGE_S, "s", 1.5, "greatest age of the vehicle's heartbeat");
    SETPOINT_TIMEOUT = real(
        "limits.setpoint_timeout_s",
        (0.0, 10.0),
        "s",
        0.5,
        "longest time that the vehicle may keep to its last setpoint; a longer one is set in its parameters at the hand-over, 0 leaves them alone"
    );
    SLIPS = whole("limits.slips", (1, 8), "steps", 3, "missed steps within a second that are too many");
    GOAL_RADIUS = real("limits.goal_radius_m", (0.1, 100.0), "m", 1.0, "horizontal distance at which the goal is reached").mavlink("GD_GOAL_RAD", true);
    GOAL_LIMIT = real("limits.goal_m", (1.0, GREATEST_COORDINATE_M as f64), "m", 500.0, "farthest goal from home; a farther one is refused");
    NO_PROGRESS = real(
        "limits.no_progress_s",
        LONG_TIME_S,
        "s",
        120.0,
        "flown so long without getting 1 m nearer to the goal, the vehicle holds; 0 is never"
    )
    .or_zero();
    ON_NO_PROGRESS = choice("limits.no_progress", OnNoProgress::WORDS, OnNoProgress::Land as usize, "what to do then");
    SPEED_LIMIT = real("limits.speed_m_s", SPEED_M_S, "m/s", ACTION_LIMIT as f64, "greatest forward speed that a pilot may want").mavlink("GD_SPEED_LIM", true);
    BATTERY = real("limits.battery", (0.0, 1.0), "", 0.15, "charge below which to land");
    FLIGHT_TIME = real("limits.flight_time_s", LONG_TIME_S, "s", 0.0, "longest flight, then land; without it there is no limit").absent("300.0");
    FENCE_RADIUS = real("limits.geofence.radius_m", LENGTH_M, "m", 0.0, "horizontal distance from home").absent("100.0");
    FENCE_MIN_HEIGHT = real("limits.geofence.min_height_m", COORDINATE_M, "m", 0.0, "lowest height in flight, above home");
    FENCE_MAX_HEIGHT = real("limits.geofence.max_height_m", LENGTH_M, "m", 0.0, "greatest height, above home").absent("30.0");

    STOP_REACTION = real("just_stop.reaction_s", (0.05, 5.0), "s", 0.4, "from the frame that shows an obstacle until the vehicle begins to change its acceleration");
    STOP_BRAKING = real("just_stop.braking_m_s2", (0.2, 10.0), "m/s²", 2.0, "what it brakes with");
    STOP_JERK = real("just_stop.jerk_m_s3", (0.5, 100.0), "m/s³", 4.0, "how fast it gets there");
    STOP_SPARE = real("just_stop.spare_m", (0.0, 20.0), "m", 0.5, "kept between its stop and what it must not touch, besides 0.5 m around its middle");
    STOP_UNSEEN = real("just_stop.unseen_s", (0.1, 60.0), "s", 1.0, "moved so long where the sensor does not look, it is stopped; 0 is never").or_zero();

    PILOT = choice("pilot.kind", PilotKind::WORDS, PilotKind::Actor as usize, "who decides");
    ABLATE = choice("pilot.ablate", Ablation::WORDS, Ablation::Nothing as usize, "what is taken from the actor, as a control (docs/learning.md)");
    APF = switch("pilot.apf", true, "add the potential field to the actor's action");
    ACTOR_FILE = text("pilot.actor_file", "\"my.safetensors\"", "the frozen actor; without it the one built into the program");
    CRUISE = real("pilot.cruise_m_s", CRUISE_M_S, "m/s", ACTION_LIMIT as f64, "fastest forward speed of the geometric pilot").mavlink("PLT_CRUISE", false);
    REPULSIVE_RANGE = real("pilot.repulsive_range_m", (0.0, 20.0), "m", 3.0, "range of the geometric pilot's repulsive field").mavlink("PLT_APF_RANGE", false);

    DETECTOR = switch("detector.enabled", true, "the detector judges the actor's explanations; default: on where the actor flies").absent("true");
    GUARD = switch(
        "detector.guard",
        true,
        "the recovery pilot raises the alarm when the actor is about to fly into something, with or without the detector; default: on \
         where the detector is"
    )
    .absent("true");
    DETECTOR_FILE = text("detector.file", "\"my.safetensors\"", "the frozen detector; without it the one built into the program");
    THRESHOLD = real("detector.threshold", (0.01, 0.999), "", 0.0, "score above which a verdict is attack; default: the detector's own")
        .absent("0.5")
        .mavlink("DT_THRESH", true);
    ALARM = choice("detector.alarm", AlarmPolicy::WORDS, AlarmPolicy::Recover as usize, "what an alarm brings about").mavlink("DT_ALARM", true);
    RAISE_COUNT = whole("detector.raise_count", (1, 32), "verdicts", 5, "this many of the last raise_window verdicts raise the alarm when they are attack");
    RAISE_WINDOW = whole("detector.raise_window", (1, 32), "verdicts", 6, "verdicts that are looked back on");
    CLEAR_STEPS = whole("detector.clear_steps", STEPS, "steps", 40, "consecutive clean steps that end the first alarm of a flight; each further one asks for twice as many");

    PRIORITY = whole("rate.priority", (0, 99), "", 50, "FIFO priority of the loop; 0 asks for neither FIFO scheduling nor locked memory");
    OFFSET = whole("rate.offset_ms", (0, 49), "ms", 5, "how long after each multiple of 50 ms a step is due");

    LOG = text("log.directory", "\"runs\"", "folder for the flight log; without it there is none");
    LOG_CONTENT = choice("log.content", LogContent::WORDS, LogContent::Everything as usize, "what the flight log holds (docs/log.md)");
    SCENE = text("log.scene", "\"scene.json\"", "file with the course's obstacles, for display in the log only");

    STATE = text(
        "state.directory",
        "\"state\"",
        "folder that keeps over restarts a signing key that came by SETUP_SIGNING, parameters that were set, and that a person took \
         the vehicle over; without it they end with the process"
    );
    TAKEN_OVER = switch("state.taken_over", false, "a person took the vehicle over in an earlier run: as the folder says; in the log's copy").absent("true");
}

/// The row of a MAVLink parameter.
pub fn of_mavlink_name(name: &str) -> Option<&'static ParameterSpec> {
    ALL.iter()
        .find(|row| row.mavlink.is_some_and(|mavlink| mavlink.name == name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_accepts_its_limits_as_f32_and_as_f64_and_nothing_beyond() {
        for parameter in ALL {
            let (key, Some(range)) = (parameter.key, parameter.range()) else {
                continue;
            };
            for limit in [range.least, range.greatest] {
                let given_as_f32 = f64::from(limit as f32);
                assert!(
                    range.contains(limit) && (range.contains(given_as_f32) || given_as_f32 > 2f64.powi(24)),
                    "{key}"
                );
            }
            for beyond in [f64::NAN, f64::INFINITY, range.greatest + 1.0] {
                assert!(!range.contains(beyond), "{key}: {beyond}");
            }
        }
        assert!(NO_PROGRESS.check(0.0).is_ok() && NO_PROGRESS.check(0.5).is_err());
    }

    #[test]
    fn a_default_is_accepted_and_keys_and_mavlink_names_are_there_once() {
        for (i, parameter) in ALL.iter().enumerate() {
            if let Preset::Number(value) = parameter.default {
                assert_eq!(parameter.check(value), Ok(()));
            }
            let (key, name) = (parameter.key, parameter.mavlink.map(|mavlink| mavlink.name));
            let is_new = |other: &ParameterSpec| other.key != key && of_mavlink_name(name.unwrap_or("")) != Some(other);
            assert!(ALL[..i].iter().all(is_new), "{key}");
            assert!(name.is_none_or(|name| name.len() <= 16), "{key}");
        }
    }

    #[test]
    fn seconds_become_whole_nanoseconds() {
        assert_eq!((FRAME_AGE.nanos(), TELEMETRY_AGE.nanos()), (250_000_000, 300_000_000));
    }

    #[test]
    fn what_is_refused_is_reported_by_name_with_what_is_allowed() {
        extern crate std;
        use std::string::ToString;
        let refused = GOAL_RADIUS.check(1000.0).unwrap_err().to_string();
        assert_eq!(refused, "limits.goal_radius_m is 1000, allowed is 0.1 to 100 m");
    }
}
