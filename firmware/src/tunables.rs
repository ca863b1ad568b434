//! What an operator may set while the firmware runs, as MAVLink parameters (`docs/firmware.md`, "Parameters").
#![deny(clippy::std_instead_of_core, clippy::alloc_instead_of_core)]

use crate::stack::StackConfig;
use vigil_guidance::{AlarmConfig, GuidanceConfig};
use vigil_mavlink::{Parameter, ParameterValue, Parameters};
use vigil_policy::GeometricConfig;
use vigil_types::{AlarmPolicy, AtGoal, Choice, Duty, OnNoProgress, ParameterSpec, parameters};

/// The values in force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tunables {
    pub pilot: GeometricConfig,
    pub speed_limit_m_s: f32,
    goal_radius_m: f32,
    at_goal: AtGoal,
    on_no_progress: OnNoProgress,
    /// The detector's; `None` without one.
    pub threshold: Option<f32>,
    /// `None` when nothing raises an alarm.
    alarm: Option<AlarmPolicy>,
    /// `None` where somebody else's flight is not guarded from the start.
    duty: Option<Duty>,
}

/// A parameter of the table that may be set while the firmware runs.
struct Tunable {
    spec: ParameterSpec,
    /// The value in force; `None` when this firmware has none.
    get: fn(&Tunables) -> Option<ParameterValue>,
    set: fn(&mut Tunables, ParameterValue),
}

/// A number that every firmware has.
macro_rules! real {
    ($spec:ident, $($field:ident).+) => {
        Tunable {
            spec: parameters::$spec,
            get: |all| Some(ParameterValue::Real(all.$($field).+)),
            set: |all, value| all.$($field).+ = value.as_f32(),
        }
    };
}

/// In the order in which they are listed to a ground station.
const TUNABLES: [Tunable; 8] = [
    real!(CRUISE, pilot.cruise_m_s),
    real!(REPULSIVE_RANGE, pilot.repulsive_range_m),
    real!(SPEED_LIMIT, speed_limit_m_s),
    real!(GOAL_RADIUS, goal_radius_m),
    Tunable {
        spec: parameters::AT_GOAL,
        get: |all| Some(ParameterValue::Integer(all.at_goal.code())),
        set: |all, value| all.at_goal = value.as_choice().unwrap_or(all.at_goal),
    },
    Tunable {
        spec: parameters::THRESHOLD,
        get: |all| all.threshold.map(ParameterValue::Real),
        set: |all, value| all.threshold = all.threshold.map(|_| value.as_f32()),
    },
    Tunable {
        spec: parameters::ALARM,
        get: |all| all.alarm.map(|policy| ParameterValue::Integer(policy.code())),
        set: |all, value| all.alarm = all.alarm.map(|policy| value.as_choice().unwrap_or(policy)),
    },
    Tunable {
        spec: parameters::DUTY,
        get: |all| all.duty.map(|duty| ParameterValue::Integer(duty.code())),
        set: |all, value| all.duty = all.duty.map(|duty| value.as_choice().unwrap_or(duty)),
    },
];

impl Tunables {
    /// `threshold` is the detector's, `is_monitored` says whether anything raises an alarm.
    pub fn of(config: &StackConfig, threshold: Option<f32>, is_monitored: bool) -> Self {
        Self {
            pilot: config.pilot,
            speed_limit_m_s: config.guidance.speed_limit_m_s,
            goal_radius_m: config.guidance.goal_radius_m,
            at_goal: config.guidance.at_goal,
            on_no_progress: config.guidance.on_no_progress,
            threshold,
            alarm: is_monitored.then_some(config.guidance.alarm.policy),
            duty: (config.duty != Duty::Fly).then_some(config.duty),
        }
    }

    /// Whose flight it is.
    pub fn duty(&self) -> Duty {
        self.duty.unwrap_or_default()
    }

    /// The table of what this firmware has.
    pub fn parameters(&self) -> Parameters {
        Parameters::new(
            TUNABLES
                .iter()
                .filter_map(|row| Parameter::of(&row.spec, (row.get)(self)?)),
        )
    }

    /// The table of a firmware with everything that can be set.
    #[cfg(feature = "std")]
    pub fn full_table(config: &StackConfig) -> Parameters {
        let mut full = Self::of(config, Some(0.0), true);
        full.duty = Some(config.duty);
        full.parameters()
    }

    /// Takes the table's values over.
    pub fn take(&mut self, table: &Parameters) {
        for row in &TUNABLES {
            let name = row.spec.mavlink.map_or("", |mavlink| mavlink.name);
            if let Some(value) = table.value_of(name) {
                (row.set)(self, value);
            }
        }
    }

    /// A configuration of guidance with these values.
    pub fn guidance(&self, config: &GuidanceConfig) -> GuidanceConfig {
        // A mission that was flown around something is handed back, and does not end there.
        let flies_around = self.duty() == Duty::FlyAround;
        GuidanceConfig {
            goal_radius_m: self.goal_radius_m,
            at_goal: if flies_around { AtGoal::Hold } else { self.at_goal },
            on_no_progress: if flies_around {
                OnNoProgress::Hold
            } else {
                self.on_no_progress
            },
            speed_limit_m_s: self.speed_limit_m_s,
            alarm: AlarmConfig {
                policy: self.alarm.unwrap_or(config.alarm.policy),
                ..config.alarm
            },
            ..*config
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FirmwareConfig;

    #[test]
    fn who_flies_around_something_holds_at_its_end_or_without_a_way_and_no_other_duty_is_changed_by_it() {
        let config = FirmwareConfig {
            duty: Duty::JustStop,
            at_goal: AtGoal::Land,
            ..FirmwareConfig::default()
        };
        let mut tunables = Tunables::of(&config.stack(), None, false);
        let mut guidance = config.stack().guidance;
        let lands = (AtGoal::Land, OnNoProgress::Land);
        for (duty, ends) in [
            (Duty::JustStop, lands),
            (Duty::FlyAround, (AtGoal::Hold, OnNoProgress::Hold)),
            (Duty::JustStop, lands),
        ] {
            tunables.duty = Some(duty);
            guidance = tunables.guidance(&guidance);
            assert_eq!((guidance.at_goal, guidance.on_no_progress), ends, "{duty:?}");
        }
    }
}
