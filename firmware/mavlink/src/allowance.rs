//! What may be done so often in a time: texts, packets passed on.

use vigil_types::Nanos;

/// How often something was done in the present period, and when that ends.
#[derive(Debug, Clone, Copy, Default)]
pub struct Allowance {
    until_ns: Nanos,
    count: u32,
}

impl Allowance {
    /// Whether it may be done now: at most `most` times in a period, which begins with the first of them.
    pub fn takes(&mut self, now_ns: Nanos, period_ns: Nanos, most: u32) -> bool {
        if now_ns >= self.until_ns {
            (self.until_ns, self.count) = (now_ns.saturating_add(period_ns), 0);
        }
        self.count = self.count.saturating_add(1);
        self.count <= most
    }
}
