//! First-in-first-out scheduling and locked memory, where the system permits them.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};

/// What the system granted; its `Display` is the one line the program shows at start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Granted {
    /// FIFO priority of the loop's thread, or why it has none.
    pub fifo: Result<i32, String>,
    /// Whether memory is locked, or why it is not.
    pub locked: Result<(), String>,
}

/// Asks for FIFO scheduling at `priority` (1 to 99; 0 asks for nothing) for the calling thread, and locks the process's
/// memory. Call it when everything is allocated, in the thread that runs the loop.
pub fn request(priority: i32) -> Granted {
    if priority == 0 {
        let off = || "switched off by rate.priority = 0".to_owned();
        return Granted {
            fifo: Err(off()),
            locked: Err(off()),
        };
    }
    Granted {
        fifo: set_fifo(priority),
        locked: lock_memory(),
    }
}

fn set_fifo(priority: i32) -> Result<i32, String> {
    let parameters = libc::sched_param {
        sched_priority: priority,
    };
    // Threads started later must not inherit it: the log writer would compete with the loop.
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: 0 is the calling thread; the parameters outlive the call.
    if unsafe { libc::sched_setscheduler(0, policy, &parameters) } == 0 {
        Ok(priority)
    } else {
        Err(format!(
            "{} (needs CAP_SYS_NICE or an rtprio limit of {priority})",
            std::io::Error::last_os_error()
        ))
    }
}

fn lock_memory() -> Result<(), String> {
    // With a limit, locking what is mapped later would make later allocations fail: lock only what is there now.
    let unlimited = getrlimit(Resource::Memlock).current.is_none();
    let flags = if unlimited || rustix::process::geteuid().is_root() {
        MlockAllFlags::CURRENT | MlockAllFlags::FUTURE
    } else {
        MlockAllFlags::CURRENT
    };
    mlockall(flags).map_err(|e| format!("{e} (needs CAP_IPC_LOCK or a larger memlock limit)"))
}

impl std::fmt::Display for Granted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.fifo {
            Ok(priority) => write!(f, "SCHED_FIFO priority {priority}")?,
            Err(why) => write!(f, "normal scheduling, steps may slip on a busy machine: {why}")?,
        }
        match &self.locked {
            Ok(()) => write!(f, "; memory locked"),
            Err(why) => write!(f, "; memory not locked: {why}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_granted_is_reported_in_one_line_with_what_it_needs() {
        let refused = Granted {
            fifo: Err("Operation not permitted (needs CAP_SYS_NICE or an rtprio limit of 50)".into()),
            locked: Ok(()),
        };
        let line = refused.to_string();
        assert!(line.contains("normal scheduling") && line.contains("CAP_SYS_NICE") && line.contains("memory locked"));
        assert!(!line.contains('\n'));
        // An impossible priority is refused by the system whatever the privileges.
        let impossible = std::thread::spawn(|| set_fifo(1000)).join().unwrap();
        assert!(impossible.is_err());
        assert!(request(0).to_string().contains("rate.priority = 0"));
    }
}
