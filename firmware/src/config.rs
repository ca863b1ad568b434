//! Configuration of the firmware: a TOML file, command-line flags over it, and what the flight stack makes of both.
#![allow(missing_docs, reason = "the rows of the table say it")]

use crate::link_spec::LinkSpec;
use crate::link_url::LinkUrl;
use crate::stack::StackConfig;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use vigil_detector::FrozenDetector;
use vigil_guidance::{AlarmConfig, Geofence, GuidanceConfig, JustStopConfig};
use vigil_io::gate::{AllowUnsigned, SigningFileError, SigningGate};
use vigil_io::key_file::{KeyFileError, frame_keys};
use vigil_io::links::MAX_GROUND_LINKS;
use vigil_log::FlightInfo;
use vigil_mavlink::{CompanionConfig, Flavour};
use vigil_policy::GeometricConfig;
use vigil_types::parameters::{self, MAX_INSTANCE};
use vigil_types::settings::{SettingsError, Value, at_most, free, required_row, section};
use vigil_types::{
    Ablation, AlarmPolicy, AtGoal, AutopilotChoice, Duty, EngagePolicy, FrameKeys, Goal, LogContent, NedVector,
    ObstacleReports, OnNoProgress, ParameterSpec, PilotKind, settings,
};

/// The port on which instance 0 meets the simulator, as PX4's SITL has it for an onboard computer.
const COMPANION_PORT: u16 = 14030;

settings! {
    /// Everything that can be set of the firmware: its fields are the rows of the table of [`parameters`], by their keys.
    /// `docs/firmware.md` is the reference.
    pub struct FirmwareConfig {
        pub instance: u32 = &parameters::INSTANCE,
        pub link: Option<LinkSpec> = &parameters::LINK,
        pub links: Vec<LinkSpec> = at_most(MAX_GROUND_LINKS, &parameters::LINKS),
        pub signing: SigningConfig = section(),
        pub vehicle: AutopilotChoice = &parameters::VEHICLE,
        pub duty: Duty = &parameters::DUTY,
        pub obstacle_distance: ObstacleReports = &parameters::OBSTACLE_DISTANCE,
        pub sensor_id: u32 = &parameters::SENSOR_ID,
        pub frame_key_files: Vec<PathBuf> = &parameters::FRAME_KEY_FILES,
        pub plausibility: bool = &parameters::PLAUSIBILITY,
        pub second_sensor: bool = &parameters::SECOND_SENSOR,
        pub engage: EngagePolicy = &parameters::ENGAGE,
        pub at_goal: AtGoal = &parameters::AT_GOAL,
        pub height_m: f32 = &parameters::HEIGHT,
        pub goal: Option<GoalConfig> = free(None),
        pub limits: Limits = section(),
        pub just_stop: JustStopSection = section(),
        pub pilot: PilotConfig = section(),
        pub detector: DetectorConfig = section(),
        pub rate: RateConfig = section(),
        pub log: LogConfig = section(),
        pub state: StateConfig = section(),
    }

    /// Who may speak on the links: MAVLink 2 signing.
    #[derive(Eq)]
    pub struct SigningConfig {
        pub key_file: Option<PathBuf> = &parameters::KEY_FILE,
        pub allow_unsigned: AllowUnsigned = &parameters::ALLOW_UNSIGNED,
        pub accept_first_key: bool = &parameters::ACCEPT_FIRST_KEY,
    }

    /// The goal in the local frame; without `height_m` at [`FirmwareConfig::height_m`].
    #[derive(Copy)]
    pub struct GoalConfig {
        pub north_m: f32 = required_row(&parameters::GOAL_NORTH),
        pub east_m: f32 = required_row(&parameters::GOAL_EAST),
        pub height_m: Option<f32> = &parameters::GOAL_HEIGHT,
    }

    /// When to hold or land.
    #[derive(Copy)]
    pub struct Limits {
        pub frame_age_s: f64 = &parameters::FRAME_AGE,
        pub telemetry_age_s: f64 = &parameters::TELEMETRY_AGE,
        pub heartbeat_age_s: f64 = &parameters::HEARTBEAT_AGE,
        pub setpoint_timeout_s: f32 = &parameters::SETPOINT_TIMEOUT,
        pub slips: u8 = &parameters::SLIPS,
        pub goal_radius_m: f32 = &parameters::GOAL_RADIUS,
        pub goal_m: f32 = &parameters::GOAL_LIMIT,
        pub no_progress_s: f64 = &parameters::NO_PROGRESS,
        pub no_progress: OnNoProgress = &parameters::ON_NO_PROGRESS,
        pub speed_m_s: f32 = &parameters::SPEED_LIMIT,
        pub battery: f32 = &parameters::BATTERY,
        pub flight_time_s: Option<f64> = &parameters::FLIGHT_TIME,
        pub geofence: Option<GeofenceConfig> = free(None),
    }

    /// The permitted region: a cylinder around home.
    #[derive(Copy)]
    pub struct GeofenceConfig {
        pub radius_m: f32 = required_row(&parameters::FENCE_RADIUS),
        pub min_height_m: f32 = &parameters::FENCE_MIN_HEIGHT,
        pub max_height_m: f32 = required_row(&parameters::FENCE_MAX_HEIGHT),
    }

    /// How a vehicle that is guarded stops.
    #[derive(Copy)]
    pub struct JustStopSection {
        pub reaction_s: f32 = &parameters::STOP_REACTION,
        pub braking_m_s2: f32 = &parameters::STOP_BRAKING,
        pub jerk_m_s3: f32 = &parameters::STOP_JERK,
        pub spare_m: f32 = &parameters::STOP_SPARE,
        pub unseen_s: f64 = &parameters::STOP_UNSEEN,
    }

    /// Who decides.
    pub struct PilotConfig {
        pub kind: PilotKind = &parameters::PILOT,
        pub apf: bool = &parameters::APF,
        pub ablate: Ablation = &parameters::ABLATE,
        pub actor_file: Option<PathBuf> = &parameters::ACTOR_FILE,
        pub cruise_m_s: f32 = &parameters::CRUISE,
        pub repulsive_range_m: f32 = &parameters::REPULSIVE_RANGE,
    }

    /// What watches the actor; without an actor there is nothing to watch.
    pub struct DetectorConfig {
        pub enabled: Option<bool> = &parameters::DETECTOR,
        pub file: Option<PathBuf> = &parameters::DETECTOR_FILE,
        pub threshold: Option<f32> = &parameters::THRESHOLD,
        pub alarm: AlarmPolicy = &parameters::ALARM,
        pub raise_count: u8 = &parameters::RAISE_COUNT,
        pub raise_window: u8 = &parameters::RAISE_WINDOW,
        pub guard: Option<bool> = &parameters::GUARD,
        pub clear_steps: u16 = &parameters::CLEAR_STEPS,
    }

    /// The loop. The simulator publishes at the multiples of 50 ms, so `offset_ms` is what a frame ages before it is used.
    #[derive(Copy, Eq)]
    pub struct RateConfig {
        pub priority: u8 = &parameters::PRIORITY,
        pub offset_ms: u8 = &parameters::OFFSET,
    }

    /// The flight log.
    #[derive(Eq)]
    pub struct LogConfig {
        pub directory: Option<PathBuf> = &parameters::LOG,
        pub content: LogContent = &parameters::LOG_CONTENT,
        pub scene: Option<PathBuf> = &parameters::SCENE,
    }

    /// What outlives a restart.
    #[derive(Eq)]
    pub struct StateConfig {
        pub directory: Option<PathBuf> = &parameters::STATE,
        pub taken_over: bool = &parameters::TAKEN_OVER,
    }
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
    /// [`SettingsError`]: an unknown key or a bad value with file, line and key.
    pub fn load(path: &Path) -> Result<Self, SettingsError> {
        settings::load(path).map_err(|error| match error {
            SettingsError::Content { path, message } => SettingsError::Content {
                path,
                message: crate::removed::explain_configuration(message),
            },
            read => read,
        })
    }

    /// Reads TOML.
    ///
    /// # Errors
    /// Line, key and what is allowed.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        settings::from_toml(text)
    }

    /// Writes TOML that [`Self::from_toml`] reads back unchanged.
    pub fn to_toml(&self) -> String {
        settings::to_toml(self)
    }

    /// What the log says about a flight with this configuration.
    pub fn flight_info(&self) -> FlightInfo {
        // What is refused flies nothing, and whoever builds the flight stack reports it.
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
        let gate = match (key_file, self.kept_key()) {
            (Some(path), _) => SigningGate::with_key_file(path, &name, *allow_unsigned),
            (None, Some(path)) => SigningGate::with_kept_key(&path, &name, *allow_unsigned),
            (None, None) => Ok(SigningGate::new(None, *allow_unsigned)),
        };
        Ok(gate?.accepting_first_key(*accept_first_key))
    }

    /// Makes the folder of the state, if there is to be one and it is not there, closed to others: a key will lie in it. Whoever
    /// else could write there could take the key away, and nobody would notice.
    ///
    /// # Errors
    /// A folder that cannot be made, or that others may write.
    pub fn make_state_folder(&self) -> anyhow::Result<()> {
        let Some(folder) = &self.state.directory else {
            return Ok(());
        };
        let path = folder.display();
        let made = std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder);
        let found = made.and_then(|()| folder.metadata());
        let found = found.map_err(|e| anyhow::anyhow!("state folder {path}: {e}"))?;
        let user = rustix::process::geteuid();
        let is_ours = user.is_root() || found.uid() == user.as_raw();
        anyhow::ensure!(
            is_ours,
            "state folder {path}: it belongs to another user: `chown` it to the firmware's user"
        );
        anyhow::ensure!(
            found.mode() & 0o022 == 0,
            "state folder {path}: others may write there: `chmod 700 {path}`, as the firmware's user"
        );
        Ok(())
    }

    /// Where a key is kept that SETUP_SIGNING brought, if anything is kept.
    pub(crate) fn kept_key(&self) -> Option<PathBuf> {
        let folder = self.state.directory.as_ref()?;
        Some(folder.join(format!("firmware{}.key", self.instance)))
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
    pub fn is_monitored(&self) -> bool {
        self.has_detector() || self.has_guard()
    }

    /// The same with one value set, as the configuration file would.
    ///
    /// # Errors
    /// A value that the parameter does not accept, with what is allowed.
    pub fn with(&self, parameter: &ParameterSpec, value: &Value) -> Result<Self, String> {
        let mut config = self.clone();
        settings::read_over(&mut config, &format!("{} = {value}", parameter.key))?;
        Ok(config)
    }

    fn guidance(&self) -> GuidanceConfig {
        let limits = &self.limits;
        let alarm = match self.has_guard() {
            true => AlarmConfig::default(),
            false => AlarmConfig::default().without_guard(),
        };
        GuidanceConfig {
            // Who guards somebody else's flight takes it over on command only.
            engage: match self.duty {
                Duty::Fly => self.engage,
                Duty::JustStop | Duty::FlyAround => EngagePolicy::Command,
            },
            taken_over: self.state.taken_over,
            at_goal: self.at_goal,
            frame_age_limit_ns: nanos(limits.frame_age_s),
            telemetry_age_limit_ns: nanos(limits.telemetry_age_s),
            heartbeat_age_limit_ns: nanos(limits.heartbeat_age_s),
            slip_limit: limits.slips,
            goal_radius_m: limits.goal_radius_m,
            goal_limit_m: limits.goal_m,
            no_progress_limit_ns: Some(nanos(limits.no_progress_s)).filter(|limit_ns| *limit_ns > 0),
            on_no_progress: limits.no_progress,
            speed_limit_m_s: limits.speed_m_s,
            battery_limit: limits.battery,
            default_height_m: self.height_m,
            time_limit_ns: limits.flight_time_s.map(nanos),
            geofence: limits.geofence.map(|fence| Geofence {
                radius_m: fence.radius_m,
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
        }
    }

    /// What the flight stack needs of this.
    pub fn stack(&self) -> StackConfig {
        let limits = &self.limits;
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
                ..JustStopConfig::default()
            },
            guidance: self.guidance(),
            companion: CompanionConfig {
                flavour: match self.vehicle {
                    AutopilotChoice::Auto => None,
                    AutopilotChoice::Px4 => Some(Flavour::Px4),
                    AutopilotChoice::ArduPilot => Some(Flavour::ArduPilot),
                },
                obstacles: self.obstacle_distance,
                guards: self.duty != Duty::Fly,
                setpoint_timeout_s: Some(limits.setpoint_timeout_s).filter(|longest_s| *longest_s > 0.0),
                system_id: self.link.as_ref().and_then(|link| link.system),
                ..CompanionConfig::default()
            },
            pilot: GeometricConfig {
                cruise_m_s: self.pilot.cruise_m_s,
                repulsive_range_m: self.pilot.repulsive_range_m,
            },
            goal: self.goal.map(|goal| Goal {
                position_ned_m: NedVector::new(goal.north_m, goal.east_m, -goal.height_m.unwrap_or(self.height_m)),
            }),
        }
    }
}

fn nanos(s: f64) -> u64 {
    (s * 1e9).round() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pilots::Pilots;

    #[test]
    fn an_empty_file_is_the_default_and_every_configuration_survives_its_own_toml() {
        assert_eq!(FirmwareConfig::from_toml(""), Ok(FirmwareConfig::default()));
        let text = r#"
            instance = 7
            link = "udpin://0.0.0.0:14540"
            links = ["tcpin://0.0.0.0:5760,unsigned=always,rate=20000", "serial:///dev/ttyUSB0:57600"]
            signing = { key_file = "keys/vigil.key", allow_unsigned = "never", accept_first_key = true }
            vehicle = "ardupilot"
            engage = "auto"
            goal = { north_m = 19.97, east_m = -5.013, height_m = 2.3 }
            limits.frame_age_s = 0.30000000000000004
            limits.battery = 0.1
            limits.flight_time_s = 300.0
            limits.geofence = { radius_m = 0.3, min_height_m = -1.7, max_height_m = 12.0 }
            log = { directory = 'runs/with "quotes"', content = "light" }
        "#;
        let config = FirmwareConfig::from_toml(text).unwrap();
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
    fn what_is_not_accepted_is_reported_with_line_and_field_and_what_is_allowed() {
        for (text, line, expected) in [
            ("sensor_id = 1\nsensorid = 2", "line 2", "sensorid"),
            ("[limits]\nframe_age = 0.2", "line 2", "frame_age_s"),
            ("vehicle = \"px5\"", "line 1", "px4"),
            ("duty = 3", "line 1", "one of fly, just-stop, fly-around is needed"),
            ("[pilot]\napf = -1", "line 2", "true or false is needed"),
            (
                "\n\n[limits]\nframe_age_s = 99",
                "line 4, column 15",
                "`limits.frame_age_s`: 99 is not allowed: 0.05 to 10 s",
            ),
            ("[limits]\nframe_age_s = nan", "line 2", "0.05 to 10 s"),
            ("[goal]\nnorth_m = inf\neast_m = 0", "line 2", "-10000 to 10000 m"),
            ("[goal]\nnorth_m = 20", "line 1", "east_m"),
            ("instance = 100", "line 1", "0 to 99"),
            ("instance = -1", "line 1", "0 to 99"),
            ("instance = 1.5", "line 1", "whole number"),
            ("link = \"serial:///dev/ttyS0\"", "line 1", "udpout://"),
            (
                "links = [\"tcpin://127.0.0.1:1,rate=1\"]",
                "line 1",
                "rate=BYTES_PER_SECOND",
            ),
            ("links = \"tcpin://127.0.0.1:1\"", "line 1", "a list is needed"),
            ("links = [\"\",\"\",\"\",\"\",\"\"]", "line 1", "at most 4 are allowed"),
            ("[signing]\nallow_unsigned = \"yes\"", "line 2", "loopback"),
            ("[signing]\nkey = \"secret\"", "line 2", "key_file"),
            ("[rate]\npriority = 100", "line 2", "0 to 99"),
            ("goal = 5", "line 1", "a table is needed"),
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
        for why in ["my.safetensors", "truncated"] {
            let error = Pilots::of(&config).err().unwrap().to_string();
            assert!(error.contains("my.safetensors") && error.contains(why), "{error}");
            std::fs::write(&path, "no actor").unwrap();
        }
    }

    #[test]
    fn an_actor_that_may_not_be_as_fast_as_it_was_trained_is_reported() {
        let mut config = FirmwareConfig::default();
        config.pilot.kind = PilotKind::Actor;
        let pilot = config.frozen_pilot().unwrap().unwrap();
        assert_eq!(config.slowed(&pilot), None);
        config.limits.speed_m_s = 0.8;
        let note = config.slowed(&pilot).unwrap();
        assert!(note.contains("for 1.5 m/s and flies 0.8"), "{note}");
    }
}
