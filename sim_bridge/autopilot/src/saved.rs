//! What outlives a restart of the vehicle: its parameters and plans.

use crate::plan::{PlanItem, PlanKind, Plans};
use crate::vehicle_parameters::{ParameterInfo, ParameterRole, ParameterValue};
use crate::{ConfigError, Endpoint};
use std::collections::BTreeMap;
use vigil_types::settings;
use vigil_types::settings::section;

settings! {
    /// Parameters that differ from their defaults, and the three plans, for a file.
    pub struct Saved {
        /// By name.
        pub parameters: BTreeMap<String, f64> = section(),
        mission: Vec<PlanItem> = section(),
        geofence: Vec<PlanItem> = section(),
        rally: Vec<PlanItem> = section(),
    }
}

impl Endpoint {
    /// What is to outlive a restart.
    pub fn saved(&self) -> Saved {
        let differs = |(info, value): &(&ParameterInfo, ParameterValue)| {
            info.default != *value && info.role != ParameterRole::Fixed
        };
        let differing = self.core.parameters.all().filter(differs);
        let [mission, geofence, rally] = PlanKind::ALL.map(|kind| self.core.plans.wire(kind).items.clone());
        Saved {
            parameters: differing
                .map(|(info, value)| (info.name.to_owned(), exact(value)))
                .collect(),
            mission,
            geofence,
            rally,
        }
    }

    /// Takes over what was saved, before the first step.
    ///
    /// # Errors
    /// A parameter or plan that this vehicle does not have or take, by name.
    pub fn restore(&mut self, saved: &Saved) -> Result<(), ConfigError> {
        for (name, value) in &saved.parameters {
            self.core.parameters.set_by_name(name, *value)?;
        }
        for (kind, items) in PlanKind::ALL
            .into_iter()
            .zip([&saved.mission, &saved.geofence, &saved.rally])
        {
            let refused = |reason: &str| ConfigError::Plan {
                kind: kind.name(),
                reason: reason.to_owned(),
            };
            if items.len() > usize::from(kind.capacity()) {
                return Err(refused("too many items"));
            }
            let core = &mut self.core;
            for (i, item) in items.iter().enumerate() {
                let PlanItem { command, frame, .. } = item;
                let at = |reason| format!("item {i} (command {command}, frame {frame}): {reason}");
                Plans::read(kind, item).map_err(|defect| refused(&at(defect.reason)))?;
            }
            core.plans
                .replace(kind, items.clone())
                .map_err(|defect| refused(defect.reason))?;
        }
        Ok(())
    }
}

/// The value as people write it: 0.4, not the double next to the float.
pub(crate) fn exact(value: ParameterValue) -> f64 {
    match value {
        ParameterValue::Integer(v) => f64::from(v),
        ParameterValue::Real(v) => v.to_string().parse().unwrap_or(f64::from(v)),
    }
}
