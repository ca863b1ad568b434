//! The fixed grid of deadlines, without a clock of its own: plain arithmetic on times that are handed in.

use vigil_types::{Nanos, STEP_NS, StepTiming};

/// Deadlines at `offset + k · period` of the machine's monotonic clock. Because the grid is the clock's own, a simulator
/// on the same grid keeps a constant phase to the loop across restarts of either.
///
/// A step that begins more than a period late, or runs past later deadlines, takes the place of the newest of them; the
/// deadlines in between are counted as slips and never made up for.
#[derive(Debug, Clone)]
pub struct RateSchedule {
    next_deadline_ns: Nanos,
    began_ns: Nanos,
    /// Of the next step, but for its lateness.
    timing: StepTiming,
}

impl RateSchedule {
    /// A 20 Hz schedule whose first deadline is the first grid point after `now_ns`.
    pub fn new(now_ns: Nanos, offset_ns: Nanos) -> Self {
        let offset_ns = offset_ns % STEP_NS;
        let passed = (now_ns + STEP_NS - offset_ns) / STEP_NS;
        Self {
            next_deadline_ns: passed * STEP_NS + offset_ns,
            began_ns: now_ns,
            timing: StepTiming::default(),
        }
    }

    /// When the next step is due.
    pub fn next_deadline_ns(&self) -> Nanos {
        self.next_deadline_ns
    }

    /// The step that was due begins now: counts what was missed and returns the step's timing.
    pub fn begin(&mut self, now_ns: Nanos) -> StepTiming {
        let late_ns = now_ns.saturating_sub(self.next_deadline_ns);
        let missed = late_ns / STEP_NS;
        self.timing.slips += missed;
        self.next_deadline_ns += (missed + 1) * STEP_NS;
        self.began_ns = now_ns;
        let timing = StepTiming {
            wake_late_ns: late_ns % STEP_NS,
            ..self.timing
        };
        self.timing.step += 1;
        timing
    }

    /// The step has ended; returns how long it took.
    pub fn end(&mut self, now_ns: Nanos) -> u64 {
        self.timing.previous_execution_ns = now_ns.saturating_sub(self.began_ns);
        self.timing.previous_execution_ns
    }

    /// Steps begun, deadlines missed, and how long the last step took that has ended.
    pub fn timing(&self) -> StepTiming {
        self.timing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFFSET: Nanos = 5_000_000;

    #[test]
    fn the_first_deadline_is_the_next_grid_point_whenever_the_loop_starts() {
        for now in [0, 1, OFFSET - 1, OFFSET, OFFSET + 1, 7 * STEP_NS, 123_456_789_012] {
            let deadline = RateSchedule::new(now, OFFSET).next_deadline_ns();
            assert!(deadline > now && deadline <= now + STEP_NS, "{now} {deadline}");
            assert_eq!(deadline % STEP_NS, OFFSET);
        }
    }

    #[test]
    fn punctual_steps_stay_on_the_grid_and_know_how_long_the_previous_one_took() {
        let mut schedule = RateSchedule::new(0, OFFSET);
        for step in 0..10 {
            let due = schedule.next_deadline_ns();
            assert_eq!(due, OFFSET + step * STEP_NS);
            let timing = schedule.begin(due + 30);
            let previous_execution_ns = if step == 0 { 0 } else { 1_000 + step - 1 };
            assert_eq!(
                timing,
                StepTiming {
                    step,
                    previous_execution_ns,
                    wake_late_ns: 30,
                    slips: 0
                }
            );
            schedule.end(due + 30 + 1_000 + step);
        }
        assert_eq!((schedule.timing().step, schedule.timing().slips), (10, 0));
    }

    #[test]
    fn a_step_that_overruns_two_deadlines_costs_them_and_the_grid_goes_on() {
        let mut schedule = RateSchedule::new(0, 0);
        let due = schedule.next_deadline_ns();
        schedule.begin(due);
        schedule.end(due + 2 * STEP_NS + STEP_NS / 2);
        // The next deadline (due + 1 period) passed long ago, and so did the one after it.
        let timing = schedule.begin(due + 2 * STEP_NS + STEP_NS / 2);
        assert_eq!((timing.step, timing.slips, timing.wake_late_ns), (1, 1, STEP_NS / 2));
        assert_eq!(schedule.next_deadline_ns(), due + 3 * STEP_NS);
        let timing = schedule.begin(due + 3 * STEP_NS);
        assert_eq!((timing.step, timing.slips, timing.wake_late_ns), (2, 1, 0));
    }
}
