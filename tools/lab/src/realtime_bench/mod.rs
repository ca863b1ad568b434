//! How punctual the 20 Hz loop is on a machine: each step with what the system counted for the loop's thread, and what follows from it.

mod causes;
mod counters;
mod machine;
mod report;

pub use causes::Work;
pub use counters::{Counters, ThreadCounters};
pub use machine::{Machine, ProcessorTime};
pub use report::{RealtimeReport, RunFacts};

/// A step of the loop, with what the system counted for its thread from the end of the step before to this one's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ObservedStep {
    /// Time since the run began.
    pub at_ns: u64,
    /// How late it began against its deadline; less than a period, as missed steps are counted apart.
    pub late_ns: u64,
    /// From wake-up to its end.
    pub took_ns: u64,
    /// Steps that it missed because it began late.
    pub missed: u64,
    /// The step before ended behind this one's deadline.
    pub held_up: bool,
    pub counted: Counters,
    pub work: Work,
}

impl ObservedStep {
    /// How late it began, with the steps that this cost.
    fn lateness_ns(&self) -> u64 {
        self.late_ns + self.missed * vigil_types::STEP_NS
    }
}
