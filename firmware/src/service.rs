//! Reports to the service manager (systemd) that the loop runs and advances, from a thread of its own.
//!
//! Not from the console's: that waits where nobody reads the terminal or the journal, and a firmware that flies would be ended
//! for it.

use sd_notify::NotifyState;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::Duration;
use vigil_types::{GuidanceState, STEP_NS, StepReport};

/// Longest time between two looks at the loop.
const PAUSE: Duration = Duration::from_millis(250);
/// Looks within the time after which the manager takes the service for dead: some may come late.
const LOOKS: u32 = 4;

/// What the loop leaves for the thread to see.
#[derive(Debug, Default)]
struct Progress {
    steps: AtomicU64,
    state: AtomicU8,
    ending: AtomicBool,
}

/// The loop's side of the thread.
pub(crate) struct ServiceManager {
    progress: Arc<Progress>,
    thread: Thread,
}

impl ServiceManager {
    /// Starts the thread where a service manager listens (`NOTIFY_SOCKET`), else there is none.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub(crate) fn find() -> std::io::Result<Option<Self>> {
        if std::env::var_os("NOTIFY_SOCKET").is_none() {
            return Ok(None);
        }
        let progress = Arc::<Progress>::default();
        let seen = Arc::clone(&progress);
        // Nobody waits for it: a manager that hangs does not hold up the end of a flight.
        let thread: JoinHandle<()> = std::thread::Builder::new()
            .name("service".to_owned())
            .spawn(move || report(&seen, sd_notify::watchdog_enabled()))?;
        Ok(Some(Self {
            progress,
            thread: thread.thread().clone(),
        }))
    }

    /// A step has ended. Never waits, allocates nothing, makes no system call.
    pub(crate) fn observe(&self, report: &StepReport) {
        self.progress.state.store(report.state as u8, Ordering::Relaxed);
        self.progress.steps.fetch_add(1, Ordering::Release);
    }

    /// The flight ends on request: what follows is not monitored any more.
    pub(crate) fn end(self) {
        self.progress.ending.store(true, Ordering::Relaxed);
        self.thread.unpark();
    }
}

/// What was reported to the manager.
#[derive(Debug, Default)]
struct Reported {
    monitored: bool,
    steps: u64,
    state: Option<GuidanceState>,
}

impl Reported {
    /// What a look at the loop has to tell: nothing where no step has ended since the look before.
    fn news(&mut self, steps: u64, state: Option<GuidanceState>) -> Vec<NotifyState<'static>> {
        let mut news = Vec::new();
        if steps == self.steps {
            return news;
        }
        if self.steps == 0 {
            news.push(NotifyState::Ready);
        }
        self.steps = steps;
        if self.monitored {
            news.push(NotifyState::Watchdog);
        }
        if let Some(name) = state.filter(|_| state != self.state).map(GuidanceState::name) {
            self.state = state;
            news.push(NotifyState::Status(name));
        }
        news
    }
}

/// Looks until the loop ends; `watchdog` is after what time without a word the manager ends the service, if ever.
fn report(progress: &Progress, watchdog: Option<Duration>) {
    let pause = watchdog.map_or(PAUSE, |limit| {
        (limit / LOOKS).clamp(Duration::from_nanos(STEP_NS), PAUSE)
    });
    let mut reported = Reported {
        monitored: watchdog.is_some(),
        ..Reported::default()
    };
    let mut warned = false;
    loop {
        let ending = progress.ending.load(Ordering::Relaxed);
        let news = if ending {
            vec![NotifyState::Stopping]
        } else {
            let steps = progress.steps.load(Ordering::Acquire);
            reported.news(steps, GuidanceState::from_code(progress.state.load(Ordering::Relaxed)))
        };
        if !news.is_empty()
            && let Err(error) = sd_notify::notify(&news)
            && !std::mem::replace(&mut warned, true)
        {
            tracing::warn!("the service manager cannot be reached to report that the loop runs: {error}");
        }
        if ending {
            return;
        }
        std::thread::park_timeout(pause);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_that_does_not_advance_is_not_reported() {
        let mut reported = Reported {
            monitored: true,
            ..Reported::default()
        };
        let mut look = |steps, state| -> String {
            let news = reported.news(steps, Some(state));
            news.iter().map(|n| format!("{n} ")).collect()
        };
        use GuidanceState::{Guided, Standby};
        assert_eq!(look(0, Standby), "", "no step yet");
        assert_eq!(look(3, Standby), "READY=1 WATCHDOG=1 STATUS=standby ");
        assert_eq!(look(8, Standby), "WATCHDOG=1 ");
        assert_eq!(look(8, Standby), "", "it hangs");
        assert_eq!(look(8, Guided), "", "within a step");
        assert_eq!(look(9, Guided), "WATCHDOG=1 STATUS=guided ", "it goes on");
    }

    #[test]
    fn a_manager_that_does_not_watch_hears_of_changes_only() {
        let mut reported = Reported::default();
        assert_eq!(reported.news(1, Some(GuidanceState::Ready)).len(), 2);
        assert!(reported.news(2, Some(GuidanceState::Ready)).is_empty());
    }
}
