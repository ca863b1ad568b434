//! What the detector did in a flight: for campaigns.

use serde::{Deserialize, Serialize};
use vigil_firmware::AlarmTally;
use vigil_types::{AlarmCause, AlarmResponse, GuidanceState, STEP_S, StepReport, Verdict};

/// What the detector did in a flight.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WatchRecord {
    /// Steps in which the actor's decision was scored, in flight.
    pub judged_steps: u64,
    /// Steps of these with the verdict attack, and with none.
    pub attack_verdicts: u64,
    /// Steps without a verdict.
    pub unknown_verdicts: u64,
    /// How often the alarm was raised.
    pub alarms: u64,
    /// How often of these by the guard: the actor was about to fly into something, went astray, or disagreed with the planner.
    pub guard_alarms: u64,
    /// How often of these because it went astray.
    #[serde(default)]
    pub astray_alarms: u64,
    /// How often of these because it disagreed.
    #[serde(default)]
    pub disagreement_alarms: u64,
    /// Step of the first alarm.
    pub first_alarm_step: Option<u64>,
    /// Steps of the flight in which guidance held for an alarm.
    pub stop_steps: u64,
    /// Steps in which the recovery pilot's action counted.
    pub recovery_steps: u64,
    #[serde(skip)]
    raised: bool,
}

impl WatchRecord {
    /// Takes a step's report.
    pub fn observe(&mut self, step: u64, report: &StepReport) {
        let flying = matches!(report.state, GuidanceState::Guided | GuidanceState::Hold);
        if let (true, Some(judgement)) = (flying, &report.judgement) {
            self.judged_steps += 1;
            self.attack_verdicts += u64::from(judgement.verdict == Verdict::Attack);
            self.unknown_verdicts += u64::from(judgement.verdict == Verdict::Unknown);
        }
        let effect = AlarmTally::effect(report);
        self.stop_steps += u64::from(effect == Some(AlarmResponse::Stop));
        self.recovery_steps += u64::from(effect == Some(AlarmResponse::Recovery));
        if report.alarm.is_some() && !self.raised {
            self.alarms += 1;
            let raised_by = |of: fn(AlarmCause) -> bool| u64::from(report.alarm.is_some_and(|alarm| of(alarm.cause)));
            self.guard_alarms += raised_by(AlarmCause::is_of_guard);
            self.astray_alarms += raised_by(|cause| cause == AlarmCause::LedAstray);
            self.disagreement_alarms += raised_by(|cause| cause == AlarmCause::Disagreement);
            self.first_alarm_step = self.first_alarm_step.or(Some(step));
        }
        self.raised = report.alarm.is_some();
    }

    /// A line on all flights of a campaign.
    pub fn summary<'a>(flights: impl Iterator<Item = &'a Self>) -> String {
        let flights: Vec<&Self> = flights.collect();
        let sum = |of: fn(&Self) -> u64| flights.iter().map(|flight| of(flight)).sum::<u64>();
        let (alarms, judged_steps) = (sum(|f| f.alarms), sum(|f| f.judged_steps));
        let share = |steps: u64| 100.0 * steps as f64 / judged_steps.max(1) as f64;
        let hours = judged_steps as f64 * f64::from(STEP_S) / 3600.0;
        format!(
            "{alarms} alarms ({} by the guard: {} led astray, {} disagreements) in {} of {} flights, {:.1} per flight hour; stopping {:.1} %, recovering {:.1} % of the time",
            sum(|f| f.guard_alarms),
            sum(|f| f.astray_alarms),
            sum(|f| f.disagreement_alarms),
            sum(|f| u64::from(f.alarms > 0)),
            flights.len(),
            alarms as f64 / hours.max(f64::MIN_POSITIVE),
            share(sum(|f| f.stop_steps)),
            share(sum(|f| f.recovery_steps)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::{Alarm, Judgement};

    #[test]
    fn an_alarm_counts_once_however_long_it_lasts() {
        let mut record = WatchRecord::default();
        let mut report = StepReport {
            state: GuidanceState::Guided,
            judgement: Some(Judgement::UNKNOWN),
            ..StepReport::default()
        };
        let raised = |response| {
            Some(Alarm {
                cause: AlarmCause::Attack,
                response,
            })
        };
        let story = [
            None,
            raised(AlarmResponse::Stop),
            raised(AlarmResponse::Recovery),
            raised(AlarmResponse::Recovery),
            None,
            raised(AlarmResponse::Stop),
        ];
        for (step, alarm) in (0..).zip(story) {
            report.alarm = alarm;
            report.state = match alarm.map(|alarm: Alarm| alarm.response) {
                Some(AlarmResponse::Stop) => GuidanceState::Hold,
                _ => GuidanceState::Guided,
            };
            record.observe(step, &report);
        }
        assert_eq!((record.alarms, record.first_alarm_step), (2, Some(1)));
        assert_eq!((record.stop_steps, record.recovery_steps), (2, 2));
        assert_eq!((record.judged_steps, record.unknown_verdicts), (6, 6));
        let line = WatchRecord::summary([&record, &WatchRecord::default()].into_iter());
        assert!(
            line.starts_with("2 alarms (0 by the guard: 0 led astray, 0 disagreements) in 1 of 2 flights"),
            "{line}"
        );
    }
}
