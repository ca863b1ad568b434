//! Thresholds and policies of guidance.

use crate::alarm::AlarmConfig;
use vigil_types::parameters::{self, OutOfRange};
use vigil_types::{AtGoal, EngagePolicy, Nanos, NedVector, OnNoProgress, ParameterSpec};

/// Farthest goal from the local origin, metres north or east.
pub const GREATEST_GOAL_M: f32 = parameters::GREATEST_COORDINATE_M;

// What only programs set, stated as the table states the rest.
const SLIP_WINDOW: ParameterSpec = ParameterSpec::unlisted("slip_window", (0.05, 10.0), "s", 1.0);
const NO_PROGRESS_GAIN: ParameterSpec = ParameterSpec::unlisted("no_progress_gain", (0.1, 100.0), "m", 1.0);
const CLEAR_STEPS: ParameterSpec = ParameterSpec::unlisted("clear_steps", (1.0, 1200.0), "steps", 10.0);
const RELEASE_STEPS: ParameterSpec = ParameterSpec::unlisted("release_steps", (1.0, 1200.0), "steps", 10.0);
const HEIGHT_GAIN: ParameterSpec = ParameterSpec::unlisted("height_gain", (0.0, 5.0), "1/s", 0.8);
const VERTICAL_LIMIT: ParameterSpec = ParameterSpec::unlisted("vertical_limit", (0.0, 1.0), "m/s", 0.5);

/// The permitted region: a cylinder around home.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geofence {
    /// Radius in metres.
    pub radius_m: f32,
    /// Lowest height in metres above home; counts in the states guided and hold only.
    pub min_height_m: f32,
    /// Greatest height in metres above home.
    pub max_height_m: f32,
}

impl Geofence {
    /// Whether the place, seen from home, is within the radius and below the greatest height, each reduced by `margin_m`.
    pub fn contains(&self, position_ned_m: NedVector, margin_m: f32) -> bool {
        let inside = position_ned_m.horizontal_norm() <= self.radius_m - margin_m;
        inside && -position_ned_m.z <= self.max_height_m - margin_m
    }

    /// Whether the place, seen from home, is high enough.
    pub fn is_high_enough(&self, position_ned_m: NedVector, margin_m: f32) -> bool {
        -position_ned_m.z >= self.min_height_m + margin_m
    }
}

/// Configuration of guidance; [`GuidanceConfig::default`] is what `docs/guidance.md` states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidanceConfig {
    /// Who starts a flight.
    pub engage: EngagePolicy,
    /// A person took the vehicle over in an earlier run, and no operator has engaged since.
    pub taken_over: bool,
    /// What to do at the goal.
    pub at_goal: AtGoal,
    /// Greatest age of the newest valid depth frame.
    pub frame_age_limit_ns: Nanos,
    /// Greatest age of position and attitude.
    pub telemetry_age_limit_ns: Nanos,
    /// Greatest age of the vehicle's heartbeat.
    pub heartbeat_age_limit_ns: Nanos,
    /// Missed steps within [`GuidanceConfig::slip_window_ns`] that are too many; 1 to 8.
    pub slip_limit: u8,
    /// Window in which missed steps are counted.
    pub slip_window_ns: Nanos,
    /// Horizontal distance at which the goal is reached.
    pub goal_radius_m: f32,
    /// Hover at the goal before landing.
    pub goal_dwell_ns: Nanos,
    /// Farthest goal, metres from the local origin, horizontally.
    pub goal_limit_m: f32,
    /// Time in *guided* that may pass without getting nearer to the goal; `None` for ever. Detours, dead ends and recoveries
    /// take their time; what the vehicle holds for is not counted.
    pub no_progress_limit_ns: Option<Nanos>,
    /// How much nearer than ever before counts as nearer.
    pub no_progress_gain_m: f32,
    /// What to do then.
    pub on_no_progress: OnNoProgress,
    /// Hover before landing for it.
    pub no_progress_dwell_ns: Nanos,
    /// Consecutive steps without a blocking condition before standby ends and before hold ends.
    pub clear_steps: u16,
    /// Consecutive steps of zero setpoints after the vehicle left its external mode, before guidance falls silent.
    pub release_steps: u16,
    /// Longest hand-over, take-off included.
    pub handover_limit_ns: Nanos,
    /// How long a failed hand-over blocks the next.
    pub handover_pause_ns: Nanos,
    /// Permitted region, if there is one.
    pub geofence: Option<Geofence>,
    /// Battery charge (0 to 1) below which to land.
    pub battery_limit: f32,
    /// Longest flight, counted from the first step in guided; then land.
    pub time_limit_ns: Option<Nanos>,
    /// Height for a goal without one, metres above home.
    pub default_height_m: f32,
    /// Greatest forward speed.
    pub speed_limit_m_s: f32,
    /// Vertical speed per metre of height error, 1/s.
    pub height_gain_per_s: f32,
    /// Greatest vertical speed that corrects the height.
    pub vertical_limit_m_s: f32,
    /// What the detector's verdicts bring about.
    pub alarm: AlarmConfig,
}

impl Default for GuidanceConfig {
    fn default() -> Self {
        const S: Nanos = 1_000_000_000;
        Self {
            engage: EngagePolicy::default(),
            taken_over: false,
            at_goal: AtGoal::default(),
            frame_age_limit_ns: parameters::FRAME_AGE.nanos(),
            telemetry_age_limit_ns: parameters::TELEMETRY_AGE.nanos(),
            heartbeat_age_limit_ns: parameters::HEARTBEAT_AGE.nanos(),
            slip_limit: parameters::SLIPS.number() as u8,
            slip_window_ns: SLIP_WINDOW.nanos(),
            goal_radius_m: parameters::GOAL_RADIUS.number_f32(),
            goal_dwell_ns: 2 * S,
            goal_limit_m: parameters::GOAL_LIMIT.number_f32(),
            no_progress_limit_ns: Some(parameters::NO_PROGRESS.nanos()),
            no_progress_gain_m: NO_PROGRESS_GAIN.number_f32(),
            on_no_progress: OnNoProgress::default(),
            no_progress_dwell_ns: 10 * S,
            clear_steps: CLEAR_STEPS.number() as u16,
            release_steps: RELEASE_STEPS.number() as u16,
            handover_limit_ns: 60 * S,
            handover_pause_ns: 5 * S,
            geofence: None,
            battery_limit: parameters::BATTERY.number_f32(),
            time_limit_ns: None,
            default_height_m: parameters::HEIGHT.number_f32(),
            speed_limit_m_s: parameters::SPEED_LIMIT.number_f32(),
            height_gain_per_s: HEIGHT_GAIN.number_f32(),
            vertical_limit_m_s: VERTICAL_LIMIT.number_f32(),
            alarm: AlarmConfig::default(),
        }
    }
}

/// A configuration that must not fly.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// A number is out of its range.
    #[error("guidance: {0}")]
    OutOfRange(#[from] OutOfRange),
    /// The goal given at the start is not permitted.
    #[error(
        "the goal is {distance_m} m from home, and {limit_m} m are allowed: take a nearer one, or set goal_m under [limits] in the configuration"
    )]
    GoalTooFar {
        /// How far it is.
        distance_m: u32,
        /// What is allowed.
        limit_m: u32,
    },
    /// The goal given at the start is not permitted.
    #[error("the goal is not permitted: outside the geofence, at or below the ground, or not a number")]
    GoalDenied,
    /// The fence is empty or not finite.
    #[error("guidance: geofence is empty or not finite: check that min is below max and the radius is positive")]
    Fence,
}

impl GuidanceConfig {
    /// Whether guidance may fly with this configuration.
    ///
    /// # Errors
    /// [`ConfigError`] names the first field that is out of range.
    pub fn check(&self) -> Result<(), ConfigError> {
        let seconds = |ns: Nanos| ns as f64 / 1e9;
        for (parameter, value) in [
            (&parameters::FRAME_AGE, seconds(self.frame_age_limit_ns)),
            (&parameters::TELEMETRY_AGE, seconds(self.telemetry_age_limit_ns)),
            (&parameters::HEARTBEAT_AGE, seconds(self.heartbeat_age_limit_ns)),
            (&SLIP_WINDOW, seconds(self.slip_window_ns)),
            (&parameters::SLIPS, self.slip_limit.into()),
            (&parameters::GOAL_RADIUS, self.goal_radius_m.into()),
            (&parameters::GOAL_LIMIT, self.goal_limit_m.into()),
            (&parameters::NO_PROGRESS, self.no_progress_limit_ns.map_or(0.0, seconds)),
            (&NO_PROGRESS_GAIN, self.no_progress_gain_m.into()),
            (&CLEAR_STEPS, self.clear_steps.into()),
            (&RELEASE_STEPS, self.release_steps.into()),
            (&parameters::BATTERY, self.battery_limit.into()),
            (&parameters::HEIGHT, self.default_height_m.into()),
            (&parameters::SPEED_LIMIT, self.speed_limit_m_s.into()),
            (&HEIGHT_GAIN, self.height_gain_per_s.into()),
            (&VERTICAL_LIMIT, self.vertical_limit_m_s.into()),
        ] {
            parameter.check(value)?;
        }
        self.alarm.check()?;
        match self.geofence {
            Some(fence) if !fence.is_valid() => Err(ConfigError::Fence),
            _ => Ok(()),
        }
    }
}

impl Geofence {
    /// Whether it is finite and holds something.
    fn is_valid(&self) -> bool {
        let spans = |low: f32, high: f32| low.is_finite() && high.is_finite() && low < high;
        spans(0.0, self.radius_m) && spans(self.min_height_m, self.max_height_m)
    }
}
