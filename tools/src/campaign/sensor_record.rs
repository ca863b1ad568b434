//! What was found wrong with the sensor in a flight, and campaigns over the sensor's faults.

use super::Flight;
use crate::report::TextTable;
use serde::{Deserialize, Serialize};
use vigil_sim::world::Outcome;
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
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultChoice {
    /// One.
    One(SensorFault),
    /// Each in turn, with the onset of this one.
    All(SensorFault),
}

impl FaultChoice {
    /// `MODE[@ONSET]` or `all[@ONSET]`.
    ///
    /// # Errors
    /// Anything else, with what there is.
    pub fn parse(text: &str) -> Result<Self, String> {
        match text
            .strip_prefix("all")
            .filter(|rest| rest.is_empty() || rest.starts_with('@'))
        {
            Some(onset) => format!("zeros{onset}").parse().map(Self::All),
            None => text.parse().map(Self::One),
        }
    }

    /// The faults, in order.
    pub fn faults(self) -> Vec<SensorFault> {
        use clap::ValueEnum;
        match self {
            Self::One(fault) => vec![fault],
            Self::All(fault) => {
                let modes = SensorFaultMode::value_variants().iter();
                modes.map(|mode| SensorFault { mode: *mode, ..fault }).collect()
            }
        }
    }
}

impl std::fmt::Display for FaultChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::One(fault) => fault.fmt(f),
            Self::All(fault) => write!(f, "all{}", fault.to_string().trim_start_matches(fault.mode.name())),
        }
    }
}

/// How the flights with a fault ended.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct FaultTally {
    /// The fault, as it is named on the command line.
    pub fault: String,
    /// Flights flown.
    pub flights: usize,
    /// Flights that touched something or left the course.
    pub collisions: usize,
    /// Flights that were held at the end.
    pub held: usize,
    /// Flights that reached the goal.
    pub arrived: usize,
    /// Flights that did neither in time.
    pub time_outs: usize,
}

impl FaultTally {
    /// Counts the flights with the fault of this name.
    pub fn of(fault: &str, flights: &[&Flight]) -> Self {
        let mut tally = Self {
            fault: fault.to_owned(),
            ..Self::default()
        };
        for flight in flights.iter().filter(|f| f.sensor_fault.as_deref() == Some(fault)) {
            tally.flights += 1;
            match flight.record.outcome {
                Some(Outcome::Success) => tally.arrived += 1,
                Some(Outcome::Collision | Outcome::OutOfBounds) => tally.collisions += 1,
                None => tally.held += 1,
                // One that guidance never flew was held from the start, on the ground as in the air.
                Some(Outcome::TimeOut) if flight.sensor.held_at_end || flight.sensor.flown_steps == 0 => {
                    tally.held += 1;
                }
                Some(Outcome::TimeOut) => tally.time_outs += 1,
            }
        }
        tally
    }

    /// The table of all faults.
    pub fn table(tallies: &[Self]) -> TextTable {
        let mut table = TextTable::new("sensor fault | > flights | > collision | > safe hold | > arrived | > time-out");
        for t in tallies {
            let counts = [t.flights, t.collisions, t.held, t.arrived, t.time_outs].map(|n| n.to_string());
            table.row([t.fault.clone()].into_iter().chain(counts));
        }
        table
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
    fn a_flight_that_guidance_never_flew_was_held_on_the_ground_as_in_the_air() {
        let flight = |outcome: Option<&str>, flown_steps: u64| {
            let of_sensor = SensorRecord {
                flown_steps,
                ..SensorRecord::default()
            };
            let flight = serde_json::json!({
                "seed": 4, "from_ground": false, "sensor_fault": "zeros", "outcome": outcome, "flight_time_s": 45.0,
                "path_length_m": 0.0, "closest_goal_m": 20.0, "closest_obstacle_m": 1.0, "steps": 900, "state_hash": "0",
                "sensor": of_sensor,
            });
            serde_json::from_value::<Flight>(flight).unwrap()
        };
        let flights = [
            flight(None, 0),
            flight(Some("time-out"), 0),
            flight(Some("time-out"), 900),
        ];
        let tally = FaultTally::of("zeros", &flights.iter().collect::<Vec<_>>());
        assert_eq!((tally.held, tally.time_outs), (2, 1));
    }

    #[test]
    fn all_faults_share_the_onset_that_was_given() {
        let faults = FaultChoice::parse("all@random").unwrap().faults();
        assert!(faults.len() > 20 && faults.iter().all(|f| f.to_string().ends_with("@random")));
        assert_eq!(FaultChoice::parse("frozen@3").unwrap().faults().len(), 1);
        assert!(FaultChoice::parse("allone").is_err());
    }
}
