//! Configuration of the firmware: a TOML file, command-line flags over it, and what the flight stack makes of both.

use crate::link_spec::LinkSpec;
use crate::link_url::LinkUrl;
use crate::ports::gate::{AllowUnsigned, SigningFileError, SigningGate};
use crate::ports::links::LinkError;
use crate::ports::router::{MAX_GROUND_LINKS, RoutedLinks};
use crate::stack::StackConfig;
use serde::{Deserialize, Serialize};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use vigil_detector::FrozenDetector;
use vigil_guidance::{AlarmConfig, FenceShape, Geofence, GuidanceConfig, JustStopConfig};
use vigil_io::key_file::{KeyFileError, frame_keys};
use vigil_log::FlightInfo;
use vigil_mavlink::{CompanionConfig, Flavour};
use vigil_policy::GeometricConfig;
use vigil_types::parameters::{self, MAX_INSTANCE};
use vigil_types::{
    Ablation, AlarmPolicy, AtGoal, AutopilotChoice, Duty, EngagePolicy, FrameKeys, Goal, LogContent, NedVector,
    ObstacleReports, OnNoProgress, ParameterSpec, PilotKind,
};

/// A configuration file has a page or two.
const SIZE_LIMIT: u64 = 1 << 20;
/// The port on which instance 0 meets the simulator, as PX4's SITL has it for an onboard computer.
const COMPANION_PORT: u16 = 14030;

/// Everything that can be set of the firmware. `docs/firmware.md` is the reference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FirmwareConfig {
    /// Number of this set of processes; 0 to [`MAX_INSTANCE`].
    #[serde(deserialize_with = "number::instance")]
    pub instance: u32,
    /// Where the vehicle's MAVLink is; absent means the simulator of this instance.
    #[serde(
        skip_serializing_if = "Option::is_none",
        serialize_with = "spec::write",
        deserialize_with = "spec::read"
    )]
    pub link: Option<LinkSpec>,
    /// Links for ground stations, besides the vehicle's.
    #[serde(
        skip_serializing_if = "Vec::is_empty",
        serialize_with = "spec::write_all",
        deserialize_with = "spec::read_all"
    )]
    pub links: Vec<LinkSpec>,
    /// Who may speak on the links.
    pub signing: SigningConfig,
    /// Which autopilot the vehicle has.
    #[serde(with = "choice")]
    pub vehicle: AutopilotChoice,
    /// Whose flight it is.
    #[serde(with = "choice")]
    pub duty: Duty,
    /// When OBSTACLE_DISTANCE is sent.
    #[serde(with = "choice")]
    pub obstacle_distance: ObstacleReports,
    /// The sensor whose frames are accepted.
    pub sensor_id: u32,
    /// Files with the secrets of the sensor's frame keys: the one in force, and while it is exchanged another; frames that were made
    /// with neither are refused (docs/frame-authentication.md). None: frames are not authenticated.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frame_key_files: Vec<PathBuf>,
    /// Whether frames are judged before the pilots see them.
    pub plausibility: bool,
    /// Whether a second sensor must see nothing nearer than the frames show.
    pub second_sensor: bool,
    /// Who starts a flight.
    #[serde(with = "choice")]
    pub engage: EngagePolicy,
    /// What to do at the goal.
    #[serde(with = "choice")]
    pub at_goal: AtGoal,
    /// Height of goals that do not tell theirs, metres above home.
    #[serde(deserialize_with = "number::height")]
    pub height_m: f32,
    /// Where to fly; absent means that an operator sets it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goal: Option<GoalConfig>,
    /// When to hold or land.
    pub limits: Limits,
    /// How a guarded vehicle stops.
    pub just_stop: JustStopSection,
    /// Who decides.
    pub pilot: PilotConfig,
    /// What watches the actor.
    pub detector: DetectorConfig,
    /// The loop.
    pub rate: RateConfig,
    /// The flight log.
    pub log: LogConfig,
    /// What outlives a restart.
    pub state: StateConfig,
}

/// Who may speak on the links: MAVLink 2 signing.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SigningConfig {
    /// The file with the key; absent means that nothing is signed. The key itself is in no configuration and no log.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub key_file: Option<PathBuf>,
    /// From whom packets without a signature are accepted.
    pub allow_unsigned: AllowUnsigned,
    /// While there is no key, SETUP_SIGNING of whoever may speak without a signature brings one.
    pub accept_first_key: bool,
}

/// The goal in the local frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalConfig {
    /// Metres north of home.
    #[serde(deserialize_with = "number::goal_north")]
    pub north_m: f32,
    /// Metres east of home.
    #[serde(deserialize_with = "number::goal_east")]
    pub east_m: f32,
    /// Metres above home at which to fly there; absent means [`FirmwareConfig::height_m`].
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "number::goal_height"
    )]
    pub height_m: Option<f32>,
}

/// When to hold or land.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Greatest age of the newest valid depth frame.
    #[serde(deserialize_with = "number::frame_age")]
    pub frame_age_s: f64,
    /// Greatest age of position and attitude.
    #[serde(deserialize_with = "number::telemetry_age")]
    pub telemetry_age_s: f64,
    /// Greatest age of the vehicle's heartbeat.
    #[serde(deserialize_with = "number::heartbeat_age")]
    pub heartbeat_age_s: f64,
    /// Longest time that the vehicle may keep to its last setpoint; a longer one is set in its parameters when it is taken
    /// over. 0 leaves them alone.
    #[serde(deserialize_with = "number::setpoint_timeout")]
    pub setpoint_timeout_s: f32,
    /// Missed steps within a second that are too many.
    #[serde(deserialize_with = "number::slips")]
    pub slips: u8,
    /// Horizontal distance at which the goal is reached.
    #[serde(deserialize_with = "number::goal_radius")]
    pub goal_radius_m: f32,
    /// Farthest goal from home.
    #[serde(deserialize_with = "number::goal_limit")]
    pub goal_m: f32,
    /// Flown so long without getting nearer to the goal, the vehicle holds; 0 never.
    #[serde(deserialize_with = "number::no_progress")]
    pub no_progress_s: f64,
    /// What to do then.
    #[serde(with = "choice")]
    pub no_progress: OnNoProgress,
    /// Greatest forward speed, whatever the pilot wants.
    #[serde(deserialize_with = "number::speed_limit")]
    pub speed_m_s: f32,
    /// Battery charge, 0 to 1, below which to land.
    #[serde(deserialize_with = "number::battery")]
    pub battery: f32,
    /// Longest flight in seconds; absent means no limit.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "number::flight_time")]
    pub flight_time_s: Option<f64>,
    /// Permitted region; absent means none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub geofence: Option<GeofenceConfig>,
}

/// The permitted region: a cylinder around home.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeofenceConfig {
    /// Horizontal distance from home.
    #[serde(deserialize_with = "number::fence_radius")]
    pub radius_m: f32,
    /// Lowest height in flight, metres above home.
    #[serde(default, deserialize_with = "number::fence_min_height")]
    pub min_height_m: f32,
    /// Greatest height, metres above home.
    #[serde(deserialize_with = "number::fence_max_height")]
    pub max_height_m: f32,
}

/// How a vehicle that is guarded stops.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JustStopSection {
    /// From the frame that shows an obstacle until the vehicle begins to change its acceleration.
    #[serde(deserialize_with = "number::stop_reaction")]
    pub reaction_s: f32,
    /// What it brakes with.
    #[serde(deserialize_with = "number::stop_braking")]
    pub braking_m_s2: f32,
    /// How fast it gets there.
    #[serde(deserialize_with = "number::stop_jerk")]
    pub jerk_m_s3: f32,
    /// Kept between its stop and what it must not touch.
    #[serde(deserialize_with = "number::stop_spare")]
    pub spare_m: f32,
    /// Moved so long where the sensor does not look, it is stopped; 0 is never.
    #[serde(deserialize_with = "number::stop_unseen")]
    pub unseen_s: f64,
}

/// Who decides.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PilotConfig {
    /// Which pilot.
    #[serde(with = "choice")]
    pub kind: PilotKind,
    /// Whether the potential field is added to the actor's action.
    pub apf: bool,
    /// What is taken from the actor, as a control.
    #[serde(with = "choice")]
    pub ablate: Ablation,
    /// The frozen actor; absent means the one built into this program.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actor_file: Option<PathBuf>,
    /// Fastest forward speed of the geometric pilot.
    #[serde(deserialize_with = "number::cruise")]
    pub cruise_m_s: f32,
    /// Range of the geometric pilot's repulsive field.
    #[serde(deserialize_with = "number::repulsive_range")]
    pub repulsive_range_m: f32,
}

/// What watches the actor; without an actor there is nothing to watch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetectorConfig {
    /// Whether the actor is watched; absent means that it is, where it flies.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub enabled: Option<bool>,
    /// The frozen detector; absent means the one built into this program.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Score above which the verdict is attack; absent means the detector's own.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "number::threshold")]
    pub threshold: Option<f32>,
    /// What an alarm brings about.
    #[serde(with = "choice")]
    pub alarm: AlarmPolicy,
    /// This many of the last [`DetectorConfig::raise_window`] verdicts raise the alarm.
    #[serde(deserialize_with = "number::raise_count")]
    pub raise_count: u8,
    /// Verdicts that are looked back on.
    #[serde(deserialize_with = "number::raise_window")]
    pub raise_window: u8,
    /// Whether the recovery pilot raises the alarm, whatever the verdict, when the actor is about to fly into something; absent
    /// means that it does where the detector is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guard: Option<bool>,
    /// Consecutive clean verdicts that end the first alarm of a flight; each further one asks for twice as many.
    #[serde(deserialize_with = "number::clear_steps")]
    pub clear_steps: u16,
}

impl Default for DetectorConfig {
    fn default() -> Self {
        let d = AlarmConfig::default();
        Self {
            enabled: None,
            file: None,
            threshold: None,
            alarm: d.policy,
            raise_count: d.raise_count,
            raise_window: d.raise_window,
            guard: None,
            clear_steps: d.clear_steps,
        }
    }
}

/// The loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RateConfig {
    /// FIFO priority of the loop's thread; 0 asks for neither FIFO scheduling nor locked memory.
    #[serde(deserialize_with = "number::priority")]
    pub priority: u8,
    /// How long after each multiple of 50 ms on the monotonic clock a step is due. The simulator publishes at the
    /// multiples, so this is what a frame ages before it is used.
    #[serde(deserialize_with = "number::offset")]
    pub offset_ms: u8,
}

/// The flight log.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LogConfig {
    /// Where the log files go; absent means no log.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub directory: Option<PathBuf>,
    /// What it holds.
    #[serde(with = "choice")]
    pub content: LogContent,
    /// A file with the obstacles, for display only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<PathBuf>,
}

/// What outlives a restart.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StateConfig {
    /// Where a signing key that came by SETUP_SIGNING, parameters that were set and a person's take-over are kept; absent
    /// means that they end with the process.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub directory: Option<PathBuf>,
    /// A person took the vehicle over in an earlier run; the folder has it, and the log.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub taken_over: bool,
}

impl Default for FirmwareConfig {
    fn default() -> Self {
        Self {
            instance: parameters::INSTANCE.number() as u32,
            link: None,
            links: Vec::new(),
            signing: SigningConfig::default(),
            vehicle: AutopilotChoice::default(),
            duty: Duty::default(),
            obstacle_distance: ObstacleReports::default(),
            sensor_id: parameters::SENSOR_ID.number() as u32,
            frame_key_files: Vec::new(),
            plausibility: parameters::PLAUSIBILITY.is_on(),
            second_sensor: parameters::SECOND_SENSOR.is_on(),
            engage: EngagePolicy::default(),
            at_goal: AtGoal::default(),
            height_m: parameters::HEIGHT.number_f32(),
            goal: None,
            limits: Limits::default(),
            just_stop: JustStopSection::default(),
            pilot: PilotConfig::default(),
            detector: DetectorConfig::default(),
            rate: RateConfig::default(),
            log: LogConfig::default(),
            state: StateConfig::default(),
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        let d = GuidanceConfig::default();
        Self {
            frame_age_s: seconds(d.frame_age_limit_ns),
            telemetry_age_s: seconds(d.telemetry_age_limit_ns),
            heartbeat_age_s: seconds(d.heartbeat_age_limit_ns),
            setpoint_timeout_s: CompanionConfig::default().setpoint_timeout_s.unwrap_or(0.0),
            slips: d.slip_limit,
            goal_radius_m: d.goal_radius_m,
            goal_m: d.goal_limit_m,
            no_progress_s: d.no_progress_limit_ns.map_or(0.0, seconds),
            no_progress: d.on_no_progress,
            speed_m_s: parameters::SPEED_LIMIT.number_f32(),
            battery: d.battery_limit,
            flight_time_s: None,
            geofence: None,
        }
    }
}

impl Default for JustStopSection {
    fn default() -> Self {
        let d = JustStopConfig::default();
        Self {
            reaction_s: d.reaction_s,
            braking_m_s2: d.braking_m_s2,
            jerk_m_s3: d.jerk_m_s3,
            spare_m: d.spare_m,
            unseen_s: d.unseen_limit_ns.map_or(0.0, seconds),
        }
    }
}

impl Default for PilotConfig {
    fn default() -> Self {
        let d = GeometricConfig::default();
        Self {
            kind: PilotKind::default(),
            apf: parameters::APF.is_on(),
            ablate: Ablation::default(),
            actor_file: None,
            cruise_m_s: d.cruise_m_s,
            repulsive_range_m: d.repulsive_range_m,
        }
    }
}

impl Default for RateConfig {
    fn default() -> Self {
        Self {
            priority: parameters::PRIORITY.number() as u8,
            offset_ms: parameters::OFFSET.number() as u8,
        }
    }
}

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file's content is not accepted; `message` names line, field and what is allowed.
    #[error("{path}: {message}")]
    Content {
        /// The file.
        path: PathBuf,
        /// The parser's report, several lines.
        message: String,
    },
}

impl FirmwareConfig {
    /// The default configuration that engages by itself and flies to `goal_ned_m`, at its height.
    pub fn to_goal(goal_ned_m: NedVector) -> Self {
        Self {
            engage: EngagePolicy::Auto,
            height_m: -goal_ned_m.z,
            goal: Some(GoalConfig {
                north_m: goal_ned_m.x,
                east_m: goal_ned_m.y,
                height_m: None,
            }),
            ..Self::default()
        }
    }

    /// Reads a file; what it does not mention keeps its default.
    ///
    /// # Errors
    /// [`ConfigError`]: an unknown key or a bad value with file, line and field.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = vigil_types::files::read_text(path, SIZE_LIMIT).map_err(|source| ConfigError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::from_toml(&text).map_err(|message| ConfigError::Content {
            path: path.to_owned(),
            message,
        })
    }

    /// Reads TOML.
    ///
    /// # Errors
    /// The parser's report: line, field and what is allowed.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        toml::from_str(text).map_err(|e| crate::removed::explain(e.to_string()))
    }

    /// Writes TOML that [`Self::from_toml`] reads back unchanged.
    pub fn to_toml(&self) -> String {
        // Plain maps and numbers; serialisation fails for other types only.
        toml::to_string(self).unwrap_or_default()
    }

    /// What the log says about a flight with this configuration.
    pub fn flight_info(&self) -> FlightInfo {
        // What is refused flies nothing, and whoever builds the flight stack tells of it.
        let detector = self.frozen_detector().ok().flatten();
        FlightInfo {
            program: concat!("firmware ", env!("CARGO_PKG_VERSION")).to_owned(),
            git_commit: None,
            instance: self.instance,
            seed: None,
            actor_sha256: self.frozen_pilot().ok().flatten().map(|pilot| pilot.sha256()),
            detector_sha256: detector.as_ref().map(FrozenDetector::sha256),
            detector_threshold: detector.map(|d| self.detector.threshold.unwrap_or(d.threshold)),
            config_toml: self.to_toml(),
        }
    }

    /// Where the vehicle's MAVLink is, the default resolved.
    pub fn vehicle_link(&self) -> LinkSpec {
        let port = COMPANION_PORT + self.instance.min(MAX_INSTANCE) as u16;
        self.link.clone().unwrap_or_else(|| LinkSpec {
            // The simulator's, whose system follows from the instance too.
            system: u8::try_from(self.instance.saturating_add(1)).ok(),
            ..LinkUrl::UdpIn(([127, 0, 0, 1], port).into()).into()
        })
    }

    /// Opens all links, the key read.
    ///
    /// # Errors
    /// [`LinkError`]: a link that cannot be opened or on which nobody would be heard, or a key that is refused.
    pub fn open_links(&self) -> Result<RoutedLinks, LinkError> {
        RoutedLinks::open(&self.vehicle_link(), &self.links, self.gate()?)
    }

    /// The gate of all links, its key read.
    ///
    /// # Errors
    /// [`SigningFileError`]: a key that is not one, that others can read, or a state that cannot be kept.
    pub fn gate(&self) -> Result<SigningGate, SigningFileError> {
        let SigningConfig {
            key_file,
            allow_unsigned,
            accept_first_key,
        } = &self.signing;
        let name = self.instance.to_string();
        let gate = match (key_file, &self.state.directory) {
            (Some(path), _) => SigningGate::with_key_file(path, &name, *allow_unsigned),
            (None, Some(folder)) => {
                let path = folder.join(format!("firmware{name}.key"));
                make_folder(folder).map_err(|source| SigningFileError::State {
                    path: folder.clone(),
                    source,
                })?;
                SigningGate::with_kept_key(&path, &name, *allow_unsigned)
            }
            (None, None) => Ok(SigningGate::new(None, *allow_unsigned)),
        };
        Ok(gate?.accepting_first_key(*accept_first_key))
    }

    /// The keys of the sensor's frames, their files read.
    ///
    /// # Errors
    /// [`KeyFileError`]: a file that cannot be read, that others can read, or that is no key.
    pub fn frame_keys(&self) -> Result<FrameKeys, KeyFileError> {
        frame_keys(&self.frame_key_files, self.sensor_id)
    }

    /// Whether a detector judges the actor.
    pub fn has_detector(&self) -> bool {
        self.detector.enabled.unwrap_or(true) && self.pilot.kind == PilotKind::Actor
    }

    /// Whether the guard raises the alarm when the actor is about to fly into something.
    pub fn has_guard(&self) -> bool {
        self.detector.guard.unwrap_or_else(|| self.has_detector()) && self.pilot.kind == PilotKind::Actor
    }

    /// Whether anything watches the pilot.
    pub fn is_watched(&self) -> bool {
        self.has_detector() || self.has_guard()
    }

    /// The same with one value set, as the configuration file would.
    ///
    /// # Errors
    /// A value that the parameter does not accept, with what is allowed.
    pub fn with(&self, parameter: &ParameterSpec, value: toml::Value) -> Result<Self, String> {
        let mut whole = toml::Table::try_from(self).map_err(|e| e.to_string())?;
        let (sections, name) = parameter.key.rsplit_once('.').unwrap_or(("", parameter.key));
        let mut table = &mut whole;
        for section in sections.split('.').filter(|section| !section.is_empty()) {
            let entry = table.entry(section).or_insert_with(|| toml::Table::new().into());
            table = entry.as_table_mut().ok_or_else(|| format!("{section} is no section"))?;
        }
        table.insert(name.to_owned(), value);
        whole.try_into().map_err(|e: toml::de::Error| e.message().to_owned())
    }

    /// What the flight stack needs of this.
    pub fn stack(&self) -> StackConfig {
        let limits = &self.limits;
        let alarm = match self.has_guard() {
            true => AlarmConfig::default(),
            false => AlarmConfig::default().without_guard(),
        };
        let guidance = GuidanceConfig {
            // Who guards somebody else's flight takes it over on command only.
            engage: match self.duty {
                Duty::Fly => self.engage,
                Duty::JustStop | Duty::FlyAround => EngagePolicy::Command,
            },
            taken_over: self.state.taken_over,
            // A mission that was flown around something is handed back, and does not end there.
            at_goal: if self.duty == Duty::FlyAround {
                AtGoal::Hold
            } else {
                self.at_goal
            },
            frame_age_limit_ns: nanos(limits.frame_age_s),
            telemetry_age_limit_ns: nanos(limits.telemetry_age_s),
            heartbeat_age_limit_ns: nanos(limits.heartbeat_age_s),
            slip_limit: limits.slips,
            goal_radius_m: limits.goal_radius_m,
            goal_limit_m: limits.goal_m,
            no_progress_limit_ns: Some(nanos(limits.no_progress_s)).filter(|limit_ns| *limit_ns > 0),
            on_no_progress: if self.duty == Duty::FlyAround {
                OnNoProgress::Hold
            } else {
                limits.no_progress
            },
            battery_limit: limits.battery,
            default_height_m: self.height_m,
            time_limit_ns: limits.flight_time_s.map(nanos),
            geofence: limits.geofence.map(|fence| Geofence {
                shape: FenceShape::Cylinder {
                    center_m: [0.0, 0.0],
                    radius_m: fence.radius_m,
                },
                min_height_m: fence.min_height_m,
                max_height_m: fence.max_height_m,
            }),
            alarm: AlarmConfig {
                policy: self.detector.alarm,
                raise_count: self.detector.raise_count,
                raise_window: self.detector.raise_window,
                clear_steps: self.detector.clear_steps,
                ..alarm
            },
            ..GuidanceConfig::default()
        };
        StackConfig {
            sensor_id: self.sensor_id,
            plausibility: self.plausibility,
            second_sensor: self.second_sensor,
            duty: self.duty,
            just_stop: JustStopConfig {
                reaction_s: self.just_stop.reaction_s,
                braking_m_s2: self.just_stop.braking_m_s2,
                jerk_m_s3: self.just_stop.jerk_m_s3,
                spare_m: self.just_stop.spare_m,
                unseen_limit_ns: Some(nanos(self.just_stop.unseen_s)).filter(|limit_ns| *limit_ns > 0),
            },
            guidance,
            companion: CompanionConfig {
                flavour: match self.vehicle {
                    AutopilotChoice::Auto => None,
                    AutopilotChoice::Px4 => Some(Flavour::Px4),
                    AutopilotChoice::ArduPilot => Some(Flavour::ArduPilot),
                },
                obstacles: self.obstacle_distance,
                wants_mission_place: self.duty != Duty::Fly,
                setpoint_timeout_s: Some(limits.setpoint_timeout_s).filter(|longest_s| *longest_s > 0.0),
                system_id: self.link.as_ref().and_then(|link| link.system),
                ..CompanionConfig::default()
            },
            pilot: GeometricConfig {
                cruise_m_s: self.pilot.cruise_m_s,
                repulsive_range_m: self.pilot.repulsive_range_m,
            },
            speed_limit_m_s: limits.speed_m_s,
            goal: self.goal.map(|goal| Goal {
                position_ned_m: NedVector::new(goal.north_m, goal.east_m, -goal.height_m.unwrap_or(self.height_m)),
            }),
        }
    }
}

/// Makes the folder of the state if it is not there, closed to others: a key will lie in it.
fn make_folder(folder: &Path) -> std::io::Result<()> {
    std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)
}

fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

fn nanos(s: f64) -> u64 {
    (s * 1e9).round() as u64
}

/// Choices by their names.
mod choice {
    use serde::de::Error as _;
    use serde::{Deserialize, Deserializer, Serializer};
    use vigil_types::Choice;

    pub fn serialize<T: Choice, S: Serializer>(value: &T, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_str(value.name())
    }

    pub fn deserialize<'de, T: Choice, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
        let name = String::deserialize(d)?;
        T::from_name(&name).ok_or_else(|| {
            let names: Vec<_> = T::WORDS.iter().map(|(name, _)| *name).collect();
            D::Error::custom(format_args!("there is no {name:?}, only {}", names.join(", ")))
        })
    }
}

/// Numbers within the range of their row in the table of parameters; the parser adds line and field to what is told.
mod number {
    use serde::de::Error as _;
    use serde::{Deserialize, Deserializer};
    use vigil_types::parameters::{self, ParameterSpec};

    /// A field's type.
    trait Number: Copy {
        /// `None` where nothing is set.
        fn value(self) -> Option<f64>;
    }

    macro_rules! numbers {
        ($($type:ty)+) => {$(
            impl Number for $type {
                fn value(self) -> Option<f64> {
                    Some(self.into())
                }
            }
        )+};
    }
    numbers! { u8 u16 u32 f32 f64 }

    impl<T: Number> Number for Option<T> {
        fn value(self) -> Option<f64> {
            self.and_then(Number::value)
        }
    }

    fn read<'de, D: Deserializer<'de>, T: Number + Deserialize<'de>>(d: D, of: &ParameterSpec) -> Result<T, D::Error> {
        let value = T::deserialize(d)?;
        let checked = value.value().map_or(Ok(()), |value| of.check(value));
        checked
            .map(|()| value)
            .map_err(|refused| D::Error::custom(format_args!("{} is not allowed: {}", refused.value, refused.range)))
    }

    macro_rules! fields {
        ($($name:ident: $type:ty = $row:ident;)+) => {$(
            pub fn $name<'de, D: Deserializer<'de>>(d: D) -> Result<$type, D::Error> {
                read(d, &parameters::$row)
            }
        )+};
    }
    fields! {
        instance: u32 = INSTANCE;
        height: f32 = HEIGHT;
        goal_north: f32 = GOAL_NORTH;
        goal_east: f32 = GOAL_EAST;
        goal_height: Option<f32> = GOAL_HEIGHT;
        frame_age: f64 = FRAME_AGE;
        telemetry_age: f64 = TELEMETRY_AGE;
        heartbeat_age: f64 = HEARTBEAT_AGE;
        setpoint_timeout: f32 = SETPOINT_TIMEOUT;
        slips: u8 = SLIPS;
        goal_radius: f32 = GOAL_RADIUS;
        goal_limit: f32 = GOAL_LIMIT;
        no_progress: f64 = NO_PROGRESS;
        speed_limit: f32 = SPEED_LIMIT;
        battery: f32 = BATTERY;
        flight_time: Option<f64> = FLIGHT_TIME;
        fence_radius: f32 = FENCE_RADIUS;
        fence_min_height: f32 = FENCE_MIN_HEIGHT;
        fence_max_height: f32 = FENCE_MAX_HEIGHT;
        stop_reaction: f32 = STOP_REACTION;
        stop_braking: f32 = STOP_BRAKING;
        stop_jerk: f32 = STOP_JERK;
        stop_spare: f32 = STOP_SPARE;
        stop_unseen: f64 = STOP_UNSEEN;
        cruise: f32 = CRUISE;
        repulsive_range: f32 = REPULSIVE_RANGE;
        threshold: Option<f32> = THRESHOLD;
        raise_count: u8 = RAISE_COUNT;
        raise_window: u8 = RAISE_WINDOW;
        clear_steps: u16 = CLEAR_STEPS;
        priority: u8 = PRIORITY;
        offset: u8 = OFFSET;
    }
}

/// Links as strings, as on the command line.
mod spec {
    use super::{LinkSpec, MAX_GROUND_LINKS};
    use serde::de::Error as _;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn read<'de, D: Deserializer<'de>>(d: D) -> Result<Option<LinkSpec>, D::Error> {
        let text = String::deserialize(d)?;
        text.parse().map(Some).map_err(D::Error::custom)
    }

    pub fn write<S: Serializer>(link: &Option<LinkSpec>, s: S) -> Result<S::Ok, S::Error> {
        match link {
            Some(link) => s.collect_str(link),
            None => s.serialize_none(),
        }
    }

    pub fn read_all<'de, D: Deserializer<'de>>(d: D) -> Result<Vec<LinkSpec>, D::Error> {
        let texts = Vec::<String>::deserialize(d)?;
        if texts.len() > MAX_GROUND_LINKS {
            return Err(D::Error::custom(format_args!("at most {MAX_GROUND_LINKS} links")));
        }
        texts
            .iter()
            .map(|text| text.parse().map_err(D::Error::custom))
            .collect()
    }

    pub fn write_all<S: Serializer>(links: &[LinkSpec], s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(links.iter().map(ToString::to_string))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pilots::Pilots;

    #[test]
    fn an_empty_file_is_the_default_and_every_configuration_survives_its_own_toml() {
        assert_eq!(FirmwareConfig::from_toml(""), Ok(FirmwareConfig::default()));
        let config = FirmwareConfig {
            instance: 7,
            link: Some("udpin://0.0.0.0:14540".parse().unwrap()),
            links: vec![
                "tcpin://0.0.0.0:5760,unsigned=always,rate=20000".parse().unwrap(),
                "serial:///dev/ttyUSB0:57600".parse().unwrap(),
            ],
            signing: SigningConfig {
                key_file: Some("keys/vigil.key".into()),
                allow_unsigned: AllowUnsigned::Never,
                accept_first_key: true,
            },
            vehicle: AutopilotChoice::ArduPilot,
            engage: EngagePolicy::Auto,
            goal: Some(GoalConfig {
                north_m: 19.97,
                east_m: -5.013,
                height_m: Some(2.3),
            }),
            limits: Limits {
                frame_age_s: 0.1 + 0.2,
                battery: 0.1,
                flight_time_s: Some(300.0),
                geofence: Some(GeofenceConfig {
                    radius_m: 0.3,
                    min_height_m: -1.7,
                    max_height_m: 12.0,
                }),
                ..Limits::default()
            },
            log: LogConfig {
                directory: Some("runs/with \"quotes\"".into()),
                content: LogContent::Light,
                scene: None,
            },
            ..FirmwareConfig::default()
        };
        assert_eq!(FirmwareConfig::from_toml(&config.to_toml()), Ok(config));
    }

    #[test]
    fn the_defaults_are_those_of_the_parts() {
        let stack = FirmwareConfig::default().stack();
        assert_eq!(stack.guidance, GuidanceConfig::default());
        assert_eq!(stack.pilot, GeometricConfig::default());
        assert_eq!(stack.goal, None);
    }

    #[test]
    fn the_simulator_of_an_instance_is_the_default_link() {
        let config = FirmwareConfig {
            instance: 3,
            ..FirmwareConfig::default()
        };
        assert_eq!(config.vehicle_link().to_string(), "udpin://127.0.0.1:14033,system=4");
    }

    #[test]
    fn what_is_not_accepted_is_told_with_line_and_field_and_what_is_allowed() {
        for (text, line, expected) in [
            ("sensor_id = 1\nsensorid = 2", "line 2", "sensorid"),
            ("[limits]\nframe_age = 0.2", "line 2", "frame_age_s"),
            ("vehicle = \"px5\"", "line 1", "px4"),
            ("\n\n[limits]\nframe_age_s = 99", "line 4", "0.05 to 10 s"),
            ("[limits]\nframe_age_s = nan", "line 2", "0.05 to 10 s"),
            ("[goal]\nnorth_m = inf\neast_m = 0", "line 2", "-10000 to 10000 m"),
            ("[goal]\nnorth_m = 20", "line 1", "east_m"),
            ("instance = 100", "line 1", "0 to 99"),
            ("instance = -1", "line 1", "integer"),
            ("link = \"serial:///dev/ttyS0\"", "line 1", "udpout://"),
            (
                "links = [\"tcpin://127.0.0.1:1,rate=1\"]",
                "line 1",
                "rate=BYTES_PER_SECOND",
            ),
            ("links = \"tcpin://127.0.0.1:1\"", "line 1", "sequence"),
            ("links = [\"\",\"\",\"\",\"\",\"\"]", "line 1", "at most 4 links"),
            ("[signing]\nallow_unsigned = \"yes\"", "line 2", "loopback"),
            ("[signing]\nkey = \"secret\"", "line 2", "key_file"),
            ("[rate]\npriority = 100", "line 2", "0 to 99"),
            ("goal = 5", "line 1", "GoalConfig"),
            ("engage = \"auto", "line 1", "string"),
        ] {
            let report = FirmwareConfig::from_toml(text).unwrap_err();
            assert!(report.contains(line) && report.contains(expected), "{text}\n{report}");
        }
    }

    #[test]
    fn an_actor_that_is_not_there_or_not_one_is_refused_by_name() {
        let mut config = FirmwareConfig::default();
        config.pilot.kind = PilotKind::Actor;
        assert!(Pilots::of(&config).is_ok());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("my.safetensors");
        config.pilot.actor_file = Some(path.clone());
        let error = Pilots::of(&config).err().unwrap().to_string();
        assert!(error.contains("my.safetensors"), "{error}");
        std::fs::write(&path, "no actor").unwrap();
        let error = Pilots::of(&config).err().unwrap().to_string();
        assert!(
            error.contains("my.safetensors") && error.contains("truncated"),
            "{error}"
        );
    }

    #[test]
    fn a_file_that_is_not_there_is_named() {
        let error = FirmwareConfig::load(Path::new("no/such/file.toml")).unwrap_err();
        assert!(error.to_string().contains("no/such/file.toml"), "{error}");
    }
}
