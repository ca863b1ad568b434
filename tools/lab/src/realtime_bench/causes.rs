//! Why a step began late or took long, as far as what was counted shows it.

use super::ObservedStep;
use super::report::or;
use std::fmt;
use vigil_types::{StepReport, Verdict, named};

/// A step that begins later, or takes so much longer than usual, is asked for its cause.
const NOTABLE_NS: u64 = 1_000_000;

/// What steps have to do.
const PARTS: [&str; 4] = ["new frame", "decision", "explanation and verdict", "alarm"];

/// Which of the parts a step had to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Work(pub [bool; PARTS.len()]);

impl Work {
    /// Of a step after one whose frame was `previous_frame`.
    pub fn of(report: &StepReport, previous_frame: Option<u64>) -> Self {
        Self([
            report.frame_sequence.is_some() && report.frame_sequence != previous_frame,
            report.action.is_some(),
            report.judgement.as_ref().is_some_and(|j| j.verdict != Verdict::Unknown),
            report.alarm.is_some(),
        ])
    }
}

impl fmt::Display for Work {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = PARTS.into_iter().zip(self.0);
        let words: Vec<_> = parts.filter_map(|(word, is)| is.then_some(word)).collect();
        f.write_str(or(&words.join(", "), "telemetry only"))
    }
}

named! {
    /// What kept a step.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Cause {
        /// The step before ran past the deadline.
        Overrun => "overrun",
        /// Others had the processors while the thread was ready.
        Queued => "queued",
        /// The hypervisor had given the processor to another machine.
        Stolen => "stolen",
        /// The kernel woke the thread late, though a processor was free for it.
        WokenLate => "woken late",
        /// Pages came from the disk.
        Disk => "disk",
        /// It waited for something within the step: a lock, a full pipe.
        Blocked => "blocked",
        /// Pages were touched for the first time.
        Pages => "pages",
        Computed => "computed",
        /// It was off the processor for a reason that is not counted.
        Unknown => "unknown",
    }
}

impl Cause {
    /// In words, with the step's figures.
    pub fn text(self, step: &ObservedStep) -> String {
        let c = &step.counted;
        let ms = |ns: u64| format!("{:.2} ms", ns as f64 * 1e-6);
        match self {
            Self::Overrun => "the step before ran past this one's deadline".to_owned(),
            Self::Queued => format!(
                "ready to run, it waited {} for a processor that others had; it was put aside {} times",
                ms(c.queued_ns),
                c.involuntary
            ),
            Self::Stolen => format!("the hypervisor gave {} of the processors to other machines", ms(c.stolen_ns)),
            Self::WokenLate => {
                "the kernel woke it late, with a processor free for it: timer, interrupts, a processor asleep, or the hypervisor".to_owned()
            }
            Self::Disk => format!("{} pages were read from the disk", c.major_faults),
            Self::Blocked => format!("it waited within the step ({} times in all)", c.voluntary),
            Self::Pages => format!("{} pages were touched for the first time", c.minor_faults),
            Self::Computed => "it computed longer: caches, clock, or interrupts that are counted as its own".to_owned(),
            Self::Unknown => {
                "it was off the processor for a reason that the kernel does not count: interrupts, or the hypervisor".to_owned()
            }
        }
    }
}

/// Why a step began more than [`NOTABLE_NS`] late.
pub fn of_lateness(step: &ObservedStep) -> Option<Cause> {
    let late_ns = step.lateness_ns();
    if late_ns <= NOTABLE_NS {
        return None;
    }
    Some(if step.held_up {
        Cause::Overrun
    } else if step.counted.queued_ns >= late_ns / 2 {
        Cause::Queued
    } else if step.counted.stolen_ns > 0 {
        Cause::Stolen
    } else {
        Cause::WokenLate
    })
}

/// Why a step took more than [`NOTABLE_NS`] longer than the `usual_ns` of steps with the same work.
pub fn of_duration(step: &ObservedStep, usual_ns: u64) -> Option<Cause> {
    let c = &step.counted;
    let longer_ns = step.took_ns.saturating_sub(usual_ns);
    if longer_ns <= NOTABLE_NS {
        return None;
    }
    // The counted processor time ends a little after the step: this is the least that it was off the processor.
    let off_ns = step.took_ns.saturating_sub(c.processor_ns);
    // What it was queued for before it began is its lateness.
    let queued_ns = c.queued_ns.saturating_sub(step.late_ns);
    Some(if off_ns < longer_ns / 2 {
        if c.stolen_ns >= longer_ns {
            Cause::Stolen
        } else if c.minor_faults >= 10 {
            Cause::Pages
        } else {
            Cause::Computed
        }
    } else if c.major_faults > 0 {
        Cause::Disk
    } else if c.involuntary > 0 || queued_ns >= off_ns / 2 {
        Cause::Queued
    } else if c.stolen_ns > 0 {
        Cause::Stolen
    } else if c.voluntary > 1 {
        Cause::Blocked
    } else {
        Cause::Unknown
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::realtime_bench::Counters;

    const MS: u64 = 1_000_000;

    fn step(late_ns: u64, took_ns: u64, counted: Counters) -> ObservedStep {
        ObservedStep {
            late_ns,
            took_ns,
            counted,
            ..ObservedStep::default()
        }
    }

    #[test]
    fn a_late_wake_up_is_the_step_befores_the_queues_the_hypervisors_or_the_timers() {
        let late = |late_ns, queued_ns, stolen_ns| {
            let counted = Counters {
                queued_ns,
                stolen_ns,
                ..Counters::default()
            };
            step(late_ns, MS, counted)
        };
        assert_eq!(of_lateness(&late(4 * MS, 3 * MS, 0)), Some(Cause::Queued));
        assert_eq!(of_lateness(&late(4 * MS, MS, 10 * MS)), Some(Cause::Stolen));
        assert_eq!(of_lateness(&late(4 * MS, MS, 0)), Some(Cause::WokenLate));
        assert_eq!(of_lateness(&late(MS, MS, 0)), None);
        let mut held_up = late(4 * MS, 4 * MS, 10 * MS);
        held_up.held_up = true;
        assert_eq!(of_lateness(&held_up), Some(Cause::Overrun));
        // 60 ms late are a missed step and 10 ms: 3 ms in the queue do not explain it.
        let mut missed = late(10 * MS, 6 * MS, 0);
        missed.missed = 1;
        assert_eq!(of_lateness(&missed), Some(Cause::WokenLate));
    }

    #[test]
    fn a_long_step_that_was_on_the_processor_computed_and_one_that_was_off_it_was_kept() {
        let counted = |processor_ns| Counters {
            processor_ns,
            voluntary: 1,
            ..Counters::default()
        };
        let cause = |counted| of_duration(&step(0, 8 * MS, counted), MS);
        assert_eq!(cause(counted(8 * MS)), Some(Cause::Computed));
        assert_eq!(of_duration(&step(0, 2 * MS, counted(2 * MS)), MS), None);
        type Count = fn(&mut Counters);
        let kept: [(u64, Count, Cause); 7] = [
            (8 * MS, |c| c.minor_faults = 300, Cause::Pages),
            (MS, |_| {}, Cause::Unknown),
            (MS, |c| c.involuntary = 1, Cause::Queued),
            (MS, |c| c.queued_ns = 6 * MS, Cause::Queued),
            (MS, |c| (c.major_faults, c.involuntary) = (1, 1), Cause::Disk),
            (MS, |c| c.stolen_ns = 10 * MS, Cause::Stolen),
            (MS, |c| c.voluntary = 2, Cause::Blocked),
        ];
        for (processor_ns, count, expected) in kept {
            let mut counted = counted(processor_ns);
            count(&mut counted);
            assert_eq!(cause(counted), Some(expected), "{counted:?}");
        }
    }

    #[test]
    fn what_a_step_had_to_do_is_reported_by_its_parts() {
        let work = Work([true, true, true, false]);
        assert_eq!(work.to_string(), "new frame, decision, explanation and verdict");
        assert_eq!(Work::default().to_string(), "telemetry only");
    }
}
