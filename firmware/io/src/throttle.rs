//! Telling of what happens again and again.

use vigil_types::Nanos;

/// Pause between two reports: an attacker must fill neither links nor the terminal.
const PAUSE_NS: Nanos = 10_000_000_000;

/// Reports a count that grows, at most every ten seconds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Throttle {
    reported: u64,
    next_ns: Nanos,
}

impl Throttle {
    /// Whether the count grew since it was reported, and may be now; it then counts as reported.
    pub fn is_due(&mut self, now_ns: Nanos, count: u64) -> bool {
        let is_due = count > self.reported && now_ns >= self.next_ns;
        if is_due {
            self.reported = count;
            self.next_ns = now_ns.saturating_add(PAUSE_NS);
        }
        is_due
    }
}
