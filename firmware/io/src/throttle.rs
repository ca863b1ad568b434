//! Telling of what happens again and again.

use vigil_types::Nanos;

/// Pause between two times that are told: an attacker must fill neither links nor the terminal.
const PAUSE_NS: Nanos = 10_000_000_000;

/// Tells of a count that grows, at most every ten seconds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Throttle {
    told: u64,
    next_ns: Nanos,
}

impl Throttle {
    /// Whether the count grew since it was told of, and may be told of now; it then counts as told.
    pub fn is_due(&mut self, now_ns: Nanos, count: u64) -> bool {
        let is_due = count > self.told && now_ns >= self.next_ns;
        if is_due {
            self.told = count;
            self.next_ns = now_ns.saturating_add(PAUSE_NS);
        }
        is_due
    }
}
