//! What an operator may set while the firmware runs, as MAVLink parameters (`docs/firmware.md`, "Parameters").
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::std_instead_of_core,
    clippy::alloc_instead_of_core
)]

use crate::stack::StackConfig;
use vigil_guidance::{AlarmConfig, AlarmPolicy, AtGoal, GuidanceConfig};
use vigil_mavlink::{Parameter, ParameterValue, Parameters};
use vigil_policy::GeometricConfig;
use vigil_types::ACTION_LIMIT;

/// Places in the table.
const CRUISE: usize = 0;
const APF_RANGE: usize = 1;
const SPEED_LIMIT: usize = 2;
const GOAL_RADIUS: usize = 3;
const AT_GOAL: usize = 4;
const THRESHOLD: usize = 5;
const ALARM: usize = 6;

/// Thresholds of the detector that can be set; the configuration file's are the same.
pub(crate) const LEAST_THRESHOLD: f32 = 0.01;
pub(crate) const GREATEST_THRESHOLD: f32 = 0.999;

/// The values in force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tunables {
    pub pilot: GeometricConfig,
    pub speed_limit_m_s: f32,
    goal_radius_m: f32,
    at_goal: AtGoal,
    /// The detector's; `None` without one, and then the table has neither it nor the policy.
    pub threshold: Option<f32>,
    alarm: AlarmPolicy,
}

impl Tunables {
    pub fn of(config: &StackConfig, threshold: Option<f32>) -> Self {
        Self {
            pilot: config.pilot,
            // NaN or a negative number would be no limit that can be kept.
            speed_limit_m_s: config.speed_limit_m_s.max(0.0),
            goal_radius_m: config.guidance.goal_radius_m,
            at_goal: config.guidance.at_goal,
            threshold,
            alarm: config.guidance.alarm.policy,
        }
    }

    /// The table, in the order of the places above. The ranges are those of the configuration file.
    pub fn parameters(&self) -> Parameters {
        let real = |name, value, least, greatest, in_flight| Parameter {
            name,
            value: ParameterValue::Real(value),
            least,
            greatest,
            in_flight,
        };
        let integer = |name, value, greatest| Parameter {
            name,
            value: ParameterValue::Integer(value),
            least: 0.0,
            greatest,
            in_flight: true,
        };
        let all = [
            real("PLT_CRUISE", self.pilot.cruise_m_s, 0.1, ACTION_LIMIT, false),
            real("PLT_APF_RANGE", self.pilot.repulsive_range_m, 0.0, 20.0, false),
            real("GD_SPEED_LIM", self.speed_limit_m_s, 0.1, ACTION_LIMIT, true),
            real("GD_GOAL_RAD", self.goal_radius_m, 0.1, 100.0, true),
            integer("GD_AT_GOAL", self.at_goal as i32, 1.0),
            real(
                "DT_THRESH",
                self.threshold.unwrap_or_default(),
                LEAST_THRESHOLD,
                GREATEST_THRESHOLD,
                true,
            ),
            integer("DT_ALARM", self.alarm as i32, 2.0),
        ];
        let own = if self.threshold.is_some() { all.len() } else { THRESHOLD };
        Parameters::new(all.get(..own).unwrap_or(&all))
    }

    /// The table of a firmware with everything that can be set.
    pub fn full_table(config: &StackConfig) -> Parameters {
        Self::of(config, Some(LEAST_THRESHOLD)).parameters()
    }

    /// Takes the table's values over.
    pub fn take(&mut self, parameters: &Parameters) {
        let real = |index, value: &mut f32| {
            if let Some(ParameterValue::Real(set)) = parameters.value(index) {
                *value = set;
            }
        };
        real(CRUISE, &mut self.pilot.cruise_m_s);
        real(APF_RANGE, &mut self.pilot.repulsive_range_m);
        real(SPEED_LIMIT, &mut self.speed_limit_m_s);
        real(GOAL_RADIUS, &mut self.goal_radius_m);
        if let Some(ParameterValue::Integer(set)) = parameters.value(AT_GOAL) {
            self.at_goal = if set == AtGoal::Land as i32 {
                AtGoal::Land
            } else {
                AtGoal::Hold
            };
        }
        if let Some(threshold) = &mut self.threshold {
            real(THRESHOLD, threshold);
        }
        if let Some(ParameterValue::Integer(set)) = parameters.value(ALARM) {
            self.alarm = match set {
                0 => AlarmPolicy::Ignore,
                1 => AlarmPolicy::Stop,
                _ => AlarmPolicy::Recover,
            };
        }
    }

    /// A configuration of guidance with these values.
    pub fn guidance(&self, config: &GuidanceConfig) -> GuidanceConfig {
        GuidanceConfig {
            goal_radius_m: self.goal_radius_m,
            at_goal: self.at_goal,
            alarm: AlarmConfig {
                policy: self.alarm,
                ..config.alarm
            },
            ..*config
        }
    }
}
