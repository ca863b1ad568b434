//! Thresholds and policies of guidance.

use crate::alarm::AlarmConfig;
use vigil_types::parameters::{self, OutOfRange};
use vigil_types::{AtGoal, EngagePolicy, Nanos, NedVector, OnNoProgress};

/// Farthest goal from the local origin, metres north or east.
pub const GREATEST_GOAL_M: f32 = parameters::GREATEST_COORDINATE_M;

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

    /// Whether it is finite and holds something.
    fn is_valid(&self) -> bool {
        let spans = |low: f32, high: f32| low.is_finite() && high.is_finite() && low < high;
        spans(0.0, self.radius_m) && spans(self.min_height_m, self.max_height_m)
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
    /// Missed steps within [`SLIP_WINDOW_NS`](crate::conditions::SLIP_WINDOW_NS) that are too many; 1 to 8.
    pub slip_limit: u8,
    /// Horizontal distance at which the goal is reached.
    pub goal_radius_m: f32,
    /// Farthest goal, metres from the local origin, horizontally.
    pub goal_limit_m: f32,
    /// Time in *guided* that may pass without getting nearer to the goal; `None` for ever. Detours, dead ends and recoveries
    /// take their time; what the vehicle holds for is not counted.
    pub no_progress_limit_ns: Option<Nanos>,
    /// What to do then.
    pub on_no_progress: OnNoProgress,
    /// Permitted region, if there is one.
    pub geofence: Option<Geofence>,
    /// Battery charge (0 to 1) below which to land.
    pub battery_limit: f32,
    /// Longest flight, counted from the first step in guided; then land.
    pub time_limit_ns: Option<Nanos>,
    /// Height for a goal without one, metres above home.
    pub default_height_m: f32,
    /// Greatest forward speed that is wanted; setpoints add up to two thirds of it, 1 m/s at most, where the vehicle lags behind.
    pub speed_limit_m_s: f32,
    /// What the detector's verdicts bring about.
    pub alarm: AlarmConfig,
}

impl Default for GuidanceConfig {
    fn default() -> Self {
        Self {
            engage: EngagePolicy::default(),
            taken_over: false,
            at_goal: AtGoal::default(),
            frame_age_limit_ns: parameters::FRAME_AGE.nanos(),
            telemetry_age_limit_ns: parameters::TELEMETRY_AGE.nanos(),
            heartbeat_age_limit_ns: parameters::HEARTBEAT_AGE.nanos(),
            slip_limit: parameters::SLIPS.number() as u8,
            goal_radius_m: parameters::GOAL_RADIUS.number_f32(),
            goal_limit_m: parameters::GOAL_LIMIT.number_f32(),
            no_progress_limit_ns: Some(parameters::NO_PROGRESS.nanos()),
            on_no_progress: OnNoProgress::default(),
            geofence: None,
            battery_limit: parameters::BATTERY.number_f32(),
            time_limit_ns: None,
            default_height_m: parameters::HEIGHT.number_f32(),
            speed_limit_m_s: parameters::SPEED_LIMIT.number_f32(),
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
            (&parameters::SLIPS, self.slip_limit.into()),
            (&parameters::GOAL_RADIUS, self.goal_radius_m.into()),
            (&parameters::GOAL_LIMIT, self.goal_limit_m.into()),
            (&parameters::NO_PROGRESS, self.no_progress_limit_ns.map_or(0.0, seconds)),
            (&parameters::BATTERY, self.battery_limit.into()),
            (&parameters::HEIGHT, self.default_height_m.into()),
            (&parameters::SPEED_LIMIT, self.speed_limit_m_s.into()),
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
