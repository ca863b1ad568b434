//! Thresholds and policies of guidance.

use crate::alarm::AlarmConfig;
use vigil_types::{Nanos, NedVector};

const MS: Nanos = 1_000_000;

/// Farthest goal from the local origin, metres north or east: beyond it f32 no longer holds centimetres well.
pub const GREATEST_GOAL_M: f32 = 10_000.0;

/// Who starts a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EngagePolicy {
    /// Guidance engages by itself as soon as it is ready, where no person has the vehicle, once per start of its own, and
    /// takes the vehicle back after a failsafe hold.
    Auto,
    /// An operator engages.
    #[default]
    Command,
}

/// What to do at the goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AtGoal {
    /// Hover until there is another goal.
    #[default]
    Hold,
    /// Hover for [`GuidanceConfig::goal_dwell_ns`], then land.
    Land,
}

/// What to do about a vehicle that does not get nearer to its goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OnNoProgress {
    /// Hover until there is another goal, or an operator engages.
    Hold,
    /// Hover for [`GuidanceConfig::no_progress_dwell_ns`], then land.
    #[default]
    Land,
}

/// Horizontal outline of the permitted region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FenceShape {
    /// A rectangle along north and east.
    Box {
        /// Southern, western corner: metres north and east of home.
        min_m: [f32; 2],
        /// Northern, eastern corner.
        max_m: [f32; 2],
    },
    /// A circle.
    Cylinder {
        /// Centre: metres north and east of home.
        center_m: [f32; 2],
        /// Radius in metres.
        radius_m: f32,
    },
}

/// The permitted region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geofence {
    /// Horizontal outline.
    pub shape: FenceShape,
    /// Lowest height in metres above home; counts in the states guided and hold only.
    pub min_height_m: f32,
    /// Greatest height in metres above home.
    pub max_height_m: f32,
}

impl Geofence {
    /// Whether the place, seen from home, is within the outline and below the greatest height, each reduced by `margin_m`.
    pub fn contains(&self, position_ned_m: NedVector, margin_m: f32) -> bool {
        let NedVector { x, y, z, .. } = position_ned_m;
        let inside = match self.shape {
            FenceShape::Box { min_m, max_m } => {
                let within = |v: f32, [low, high]: [f32; 2]| v >= low + margin_m && v <= high - margin_m;
                let ([min_n, min_e], [max_n, max_e]) = (min_m, max_m);
                within(x, [min_n, max_n]) && within(y, [min_e, max_e])
            }
            FenceShape::Cylinder {
                center_m: [north, east],
                radius_m,
            } => NedVector::new(x - north, y - east, 0.0).horizontal_norm() <= radius_m - margin_m,
        };
        inside && -z <= self.max_height_m - margin_m
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
    /// Vertical speed per metre of height error, 1/s.
    pub height_gain_per_s: f32,
    /// Greatest vertical speed that corrects the height.
    pub vertical_limit_m_s: f32,
    /// What the detector's verdicts bring about.
    pub alarm: AlarmConfig,
}

impl Default for GuidanceConfig {
    fn default() -> Self {
        Self {
            engage: EngagePolicy::Command,
            taken_over: false,
            at_goal: AtGoal::Hold,
            frame_age_limit_ns: 250 * MS,
            telemetry_age_limit_ns: 300 * MS,
            heartbeat_age_limit_ns: 1_500 * MS,
            slip_limit: 3,
            slip_window_ns: 1_000 * MS,
            goal_radius_m: 1.0,
            goal_dwell_ns: 2_000 * MS,
            goal_limit_m: 500.0,
            no_progress_limit_ns: Some(120_000 * MS),
            no_progress_gain_m: 1.0,
            on_no_progress: OnNoProgress::Land,
            no_progress_dwell_ns: 10_000 * MS,
            clear_steps: 10,
            release_steps: 10,
            handover_limit_ns: 60_000 * MS,
            handover_pause_ns: 5_000 * MS,
            geofence: None,
            battery_limit: 0.15,
            time_limit_ns: None,
            default_height_m: 2.5,
            height_gain_per_s: 0.8,
            vertical_limit_m_s: 0.5,
            alarm: AlarmConfig::default(),
        }
    }
}

/// A configuration that must not fly.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// A number is out of its range.
    #[error("guidance: {field} is {value}, allowed is {allowed}")]
    OutOfRange {
        /// Field of [`GuidanceConfig`].
        field: &'static str,
        /// The value given.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
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
        let range = |field, value: f64, low: f64, high: f64, allowed| {
            // Written so that NaN is out of range.
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(ConfigError::OutOfRange { field, value, allowed })
            }
        };
        let age = |field, ns: Nanos| range(field, ns as f64 * 1e-9, 0.05, 10.0, "0.05 to 10 seconds");
        age("frame_age_limit", self.frame_age_limit_ns)?;
        age("telemetry_age_limit", self.telemetry_age_limit_ns)?;
        age("heartbeat_age_limit", self.heartbeat_age_limit_ns)?;
        age("slip_window", self.slip_window_ns)?;
        range("slip_limit", self.slip_limit.into(), 1.0, 8.0, "1 to 8 steps")?;
        range(
            "goal_radius_m",
            self.goal_radius_m.into(),
            0.1,
            100.0,
            "0.1 to 100 metres",
        )?;
        range(
            "goal_limit_m",
            self.goal_limit_m.into(),
            1.0,
            GREATEST_GOAL_M.into(),
            "1 to 10000 metres",
        )?;
        if let Some(limit_ns) = self.no_progress_limit_ns {
            range(
                "no_progress_limit",
                limit_ns as f64 * 1e-9,
                1.0,
                86_400.0,
                "1 to 86400 seconds",
            )?;
        }
        range(
            "no_progress_gain_m",
            self.no_progress_gain_m.into(),
            0.1,
            100.0,
            "0.1 to 100 metres",
        )?;
        range("clear_steps", self.clear_steps.into(), 1.0, 1200.0, "1 to 1200 steps")?;
        range(
            "release_steps",
            self.release_steps.into(),
            1.0,
            1200.0,
            "1 to 1200 steps",
        )?;
        range("battery_limit", self.battery_limit.into(), 0.0, 1.0, "0 to 1")?;
        range(
            "default_height_m",
            self.default_height_m.into(),
            0.1,
            1000.0,
            "0.1 to 1000 metres",
        )?;
        range(
            "height_gain_per_s",
            self.height_gain_per_s.into(),
            0.0,
            5.0,
            "0 to 5 per second",
        )?;
        range(
            "vertical_limit_m_s",
            self.vertical_limit_m_s.into(),
            0.0,
            1.0,
            "0 to 1 metres per second",
        )?;
        let alarm = &self.alarm;
        range(
            "alarm.raise_window",
            alarm.raise_window.into(),
            1.0,
            32.0,
            "1 to 32 steps",
        )?;
        range(
            "alarm.raise_count",
            alarm.raise_count.into(),
            1.0,
            alarm.raise_window.into(),
            "1 to alarm.raise_window steps",
        )?;
        range(
            "alarm.unknown_limit",
            alarm.unknown_limit.into(),
            1.0,
            1200.0,
            "1 to 1200 steps",
        )?;
        range(
            "alarm.guard_steps",
            alarm.guard_steps.into(),
            0.0,
            1200.0,
            "0 to 1200 steps",
        )?;
        range(
            "alarm.clear_steps",
            alarm.clear_steps.into(),
            1.0,
            1200.0,
            "1 to 1200 steps",
        )?;
        range(
            "alarm.stopped_m_s",
            alarm.stopped_m_s.into(),
            0.05,
            1.0,
            "0.05 to 1 metres per second",
        )?;
        range(
            "alarm.stop_limit",
            alarm.stop_limit_ns as f64 * 1e-9,
            0.05,
            60.0,
            "0.05 to 60 seconds",
        )?;
        match self.geofence {
            Some(fence) if !fence.is_valid() => Err(ConfigError::Fence),
            _ => Ok(()),
        }
    }
}

impl Geofence {
    fn is_valid(&self) -> bool {
        let outline = match self.shape {
            FenceShape::Box {
                min_m: [min_n, min_e],
                max_m: [max_n, max_e],
            } => (max_n - min_n).min(max_e - min_e),
            FenceShape::Cylinder {
                center_m: [north, east],
                radius_m,
            } => (north + east).abs() * 0.0 + radius_m,
        };
        // NaN and infinities fail the comparisons.
        let height = self.max_height_m - self.min_height_m;
        outline > 0.0 && outline < f32::INFINITY && height > 0.0 && height < f32::INFINITY
    }
}
