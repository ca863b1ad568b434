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
use vigil_guidance::{AtGoal, GuidanceConfig};
use vigil_link::{Parameter, ParameterValue, Parameters};
use vigil_policy::GeometricConfig;
use vigil_types::ACTION_LIMIT;

/// Places in the table.
const CRUISE: usize = 0;
const APF_RANGE: usize = 1;
const SPEED_LIMIT: usize = 2;
const GOAL_RADIUS: usize = 3;
const AT_GOAL: usize = 4;

/// The values in force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tunables {
    pub pilot: GeometricConfig,
    pub speed_limit_m_s: f32,
    goal_radius_m: f32,
    at_goal: AtGoal,
}

impl Tunables {
    pub fn of(config: &StackConfig) -> Self {
        Self {
            pilot: config.pilot,
            // NaN or a negative number would be no limit that can be kept.
            speed_limit_m_s: config.speed_limit_m_s.max(0.0),
            goal_radius_m: config.guidance.goal_radius_m,
            at_goal: config.guidance.at_goal,
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
        Parameters::new(&[
            real("PLT_CRUISE", self.pilot.cruise_m_s, 0.1, ACTION_LIMIT, false),
            real("PLT_APF_RANGE", self.pilot.repulsive_range_m, 0.0, 20.0, false),
            real("GD_SPEED_LIM", self.speed_limit_m_s, 0.1, ACTION_LIMIT, true),
            real("GD_GOAL_RAD", self.goal_radius_m, 0.1, 100.0, true),
            Parameter {
                name: "GD_AT_GOAL",
                value: ParameterValue::Integer(self.at_goal as i32),
                least: 0.0,
                greatest: 1.0,
                in_flight: true,
            },
        ])
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
    }

    /// A configuration of guidance with these values.
    pub fn guidance(&self, config: &GuidanceConfig) -> GuidanceConfig {
        GuidanceConfig {
            goal_radius_m: self.goal_radius_m,
            at_goal: self.at_goal,
            ..*config
        }
    }
}
