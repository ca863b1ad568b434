//! What the alarms of a flight came to, for the summary at its end.

use vigil_guidance::conditions::{Demand, demanding};
use vigil_types::{AlarmCause, AlarmResponse, GuidanceState, Landed, Reason, STEP_S, StepReport};

/// Counts alarms, by whom they were raised, and what they brought about.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AlarmTally {
    is_monitored: bool,
    flown_steps: u64,
    /// By [`AlarmCause`].
    raised: [u64; AlarmCause::ALL.len()],
    first_at_step: Option<u64>,
    stop_steps: u64,
    recovery_steps: u64,
    was_raised: bool,
}

impl AlarmTally {
    /// No step yet; `is_monitored` says whether anything can raise an alarm.
    pub fn new(is_monitored: bool) -> Self {
        Self {
            is_monitored,
            ..Self::default()
        }
    }

    /// Takes a step's report.
    pub fn observe(&mut self, report: &StepReport) {
        // It may hold before it took off.
        let flown = matches!(report.state, GuidanceState::Guided | GuidanceState::Hold)
            && report.telemetry.landed != Landed::OnGround;
        let flown_before = self.flown_steps;
        self.flown_steps += u64::from(flown);
        let effect = Self::effect(report);
        self.stop_steps += u64::from(effect == Some(AlarmResponse::Stop));
        self.recovery_steps += u64::from(effect == Some(AlarmResponse::Recovery));
        if let Some(alarm) = report.alarm.filter(|_| !self.was_raised) {
            self.first_at_step = self.first_at_step.or(Some(flown_before));
            if let Some(count) = self.raised.get_mut(alarm.cause as usize) {
                *count += 1;
            }
        }
        self.was_raised = report.alarm.is_some();
    }

    /// What an alarm does to a step of the flight: the vehicle holds for it, or the recovery pilot flies.
    pub fn effect(report: &StepReport) -> Option<AlarmResponse> {
        match (report.state, report.alarm?.response) {
            (GuidanceState::Guided, AlarmResponse::Recovery) => Some(AlarmResponse::Recovery),
            (GuidanceState::Hold, AlarmResponse::Stop) if !report.reasons.contains(Reason::GoalReached) => {
                Some(AlarmResponse::Stop)
            }
            // Stopped; the hold lasts until nothing has demanded it for a while. The end of a hold for something else counts too.
            (GuidanceState::Hold, AlarmResponse::Recovery) if !report.reasons.intersects(demanding(Demand::Hold)) => {
                Some(AlarmResponse::Stop)
            }
            _ => None,
        }
    }
}

impl std::fmt::Display for AlarmTally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let seconds = |steps: u64| steps as f64 * f64::from(STEP_S);
        let flown_s = seconds(self.flown_steps);
        if !self.is_monitored {
            return write!(f, "nothing monitored the pilot in {flown_s:.1} s of flight");
        }
        let Some(first) = self.first_at_step else {
            return write!(f, "none in {flown_s:.1} s of flight");
        };
        let by = AlarmCause::ALL.map(|cause| match cause {
            AlarmCause::Attack => "by the detector: an attack",
            AlarmCause::NoVerdict => "for want of a verdict",
            AlarmCause::CollisionCourse => "by the guard: a collision course",
            AlarmCause::LedAstray => "by the guard: led astray",
            AlarmCause::Disagreement => "by the guard: a disagreement",
            AlarmCause::RoughPicture => "by the guard: a rough picture",
        });
        write!(
            f,
            "{}{}, the first after {:.1} s of flight; of {flown_s:.1} s it stopped for {:.1} s and the recovery pilot \
             flew {:.1} s",
            self.raised.iter().sum::<u64>(),
            in_brackets(by.into_iter().zip(self.raised), ""),
            seconds(first),
            seconds(self.stop_steps),
            seconds(self.recovery_steps)
        )
    }
}

/// " (3 for their size, 1 for their pose)" of what there is; nothing for none.
pub(crate) fn in_brackets(counts: impl IntoIterator<Item = (&'static str, u64)>, words: &str) -> String {
    let counts = counts.into_iter().filter(|(_, count)| *count > 0);
    let listed: Vec<_> = counts.map(|(what, count)| format!("{count} {words}{what}")).collect();
    match listed.is_empty() {
        true => String::new(),
        false => format!(" ({})", listed.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::{Alarm, Reasons};

    #[test]
    fn a_flight_s_alarms_are_shown_with_who_raised_them_and_what_came_of_them() {
        use {AlarmCause::*, AlarmResponse::*, GuidanceState::*};
        let mut tally = AlarmTally::new(true);
        let mut report = StepReport {
            state: GuidanceState::Hold,
            ..StepReport::default()
        };
        report.telemetry.landed = Landed::OnGround;
        tally.observe(&report);
        report.telemetry.landed = Landed::InAir;
        report.state = GuidanceState::Guided;
        (0..100).for_each(|_| tally.observe(&report));
        assert_eq!(tally.to_string(), "none in 5.0 s of flight");
        let at_goal = Reasons::of(Reason::GoalReached);
        for (steps, state, raised, reasons) in [
            (2, Hold, Some((Attack, Stop)), Reasons::of(Reason::Attack)),
            (8, Hold, Some((Attack, Recovery)), Reasons::of(Reason::Recovering)),
            (40, Guided, Some((Attack, Recovery)), Reasons::of(Reason::Recovering)),
            (20, Guided, None, Reasons::NONE),
            (10, Hold, Some((CollisionCourse, Stop)), Reasons::NONE),
            (20, Hold, Some((CollisionCourse, Recovery)), at_goal),
            (50, Land, Some((CollisionCourse, Recovery)), at_goal),
        ] {
            report.alarm = raised.map(|(cause, response)| Alarm { cause, response });
            (report.state, report.reasons) = (state, reasons);
            (0..steps).for_each(|_| tally.observe(&report));
        }
        assert_eq!(
            tally.to_string(),
            "2 (1 by the detector: an attack, 1 by the guard: a collision course), the first after 5.0 s of flight; of 10.0 s it \
             stopped for 1.0 s and the recovery pilot flew 2.0 s"
        );
        assert!(AlarmTally::new(false).to_string().starts_with("nothing monitored"));
    }
}
