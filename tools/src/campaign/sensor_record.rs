//! What was found wrong with the sensor in a flight, and campaigns over the sensor's faults.

use serde::{Deserialize, Serialize};
use vigil_sim::{SensorFault, SensorFaultMode};
use vigil_types::{GuidanceState, Reason, STEP_S, StepReport};

/// Conditions that say that frames cannot be used.
const SENSOR_REASONS: [Reason; 10] = [
    Reason::StaleFrame,
    Reason::BadFrame,
    Reason::UnauthenticatedFrame,
    Reason::BlindSensor,
    Reason::FrozenSensor,
    Reason::ImplausiblePose,
    Reason::InconsistentPicture,
    Reason::SecondSensorSilent,
    Reason::SensorsDisagree,
    Reason::BeneathGround,
];

/// What was found wrong with the sensor in a flight.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorRecord {
    /// Steps in the states guided and hold.
    pub flown_steps: u64,
    /// How often something began to be wrong in flight.
    pub holds: u64,
    /// The first step of these.
    pub first_step: Option<u64>,
    /// Steps in which something was wrong.
    pub hold_steps: u64,
    /// Everything that was wrong, by name.
    pub reasons: Vec<String>,
    /// Something was wrong at the end.
    pub held_at_end: bool,
}

impl SensorRecord {
    /// Takes a step's report.
    pub fn observe(&mut self, step: u64, report: &StepReport) {
        if !matches!(report.state, GuidanceState::Guided | GuidanceState::Hold) {
            return;
        }
        self.flown_steps += 1;
        let held_before = std::mem::take(&mut self.held_at_end);
        for reason in report.reasons.iter().filter(|reason| SENSOR_REASONS.contains(reason)) {
            self.held_at_end = true;
            if !self.reasons.iter().any(|known| known == reason.name()) {
                self.reasons.push(reason.name().to_owned());
            }
        }
        if self.held_at_end {
            self.hold_steps += 1;
            self.first_step.get_or_insert(step);
            self.holds += u64::from(!held_before);
        }
    }

    /// A line on all flights of a campaign.
    pub fn summary<'a>(flights: impl Iterator<Item = &'a Self>) -> String {
        let flights: Vec<&Self> = flights.collect();
        let sum = |of: fn(&Self) -> u64| flights.iter().map(|flight| of(flight)).sum::<u64>();
        let (holds, held, count) = (sum(|f| f.holds), sum(|f| u64::from(f.holds > 0)), flights.len());
        let hours = sum(|f| f.flown_steps) as f64 * f64::from(STEP_S) / 3600.0;
        let found = SENSOR_REASONS.into_iter().map(Reason::name).filter_map(|name| {
            let n = flights.iter().filter(|f| f.reasons.iter().any(|r| r == name)).count();
            (n > 0).then(|| format!("{name} {n}"))
        });
        let named: Vec<String> = found.collect();
        format!(
            "{holds} holds in {held} of {count} flights, {:.2} per flight hour{}{}",
            holds as f64 / hours.max(f64::MIN_POSITIVE),
            if named.is_empty() { "" } else { ": " },
            named.join(", ")
        )
    }
}

/// Which faults a campaign flies.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultChoice {
    /// As on the command line: of one fault, or `all` with the onset.
    pub name: String,
    /// In order.
    pub faults: Vec<SensorFault>,
}

impl FaultChoice {
    /// `MODE[@ONSET]` or `all[@ONSET]`.
    ///
    /// # Errors
    /// Anything else, with what there is.
    pub fn parse(text: &str) -> Result<Self, String> {
        let onset = text.strip_prefix("all");
        let (name, faults) = match onset.filter(|rest| rest.is_empty() || rest.starts_with('@')) {
            Some(onset) => {
                let first: SensorFault = format!("zeros{onset}").parse()?;
                let all = SensorFaultMode::ALL.map(|mode| SensorFault { mode, ..first });
                (first.to_string().replacen("zeros", "all", 1), all.into())
            }
            None => {
                let fault: SensorFault = text.parse()?;
                (fault.to_string(), vec![fault])
            }
        };
        Ok(Self { name, faults })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::Reasons;

    #[test]
    fn a_hold_counts_once_however_long_it_lasts_and_only_in_flight() {
        let mut record = SensorRecord::default();
        let blind = Reasons::of(Reason::BlindSensor);
        let story = [
            (GuidanceState::Ready, blind),
            (GuidanceState::Guided, Reasons::of(Reason::GoalReached)),
            (GuidanceState::Hold, blind),
            (GuidanceState::Hold, blind),
            (GuidanceState::Guided, Reasons::NONE),
            (GuidanceState::Hold, Reasons::of(Reason::BadFrame)),
        ];
        for (step, (state, reasons)) in (0..).zip(story) {
            let report = StepReport {
                state,
                reasons,
                ..StepReport::default()
            };
            record.observe(step, &report);
        }
        assert_eq!((record.holds, record.hold_steps, record.first_step), (2, 3, Some(2)));
        assert!(record.held_at_end);
        assert_eq!(record.reasons, ["blind sensor", "bad frame"]);
    }

    #[test]
    fn all_faults_share_the_onset_that_was_given() {
        let FaultChoice { name, faults } = FaultChoice::parse("all@random").unwrap();
        assert_eq!(name, "all@random");
        assert!(faults.len() > 20 && faults.iter().all(|f| f.to_string().ends_with("@random")));
        assert_eq!(FaultChoice::parse("frozen@3").unwrap().faults.len(), 1);
        assert!(FaultChoice::parse("allone").is_err());
    }
}
