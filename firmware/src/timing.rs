//! Distributions of execution time and wake-up lateness; nothing is allocated after start.

use hdrhistogram::Histogram;

/// Longest time distinguished, 10 s; anything longer counts as that.
const MAX_NS: u64 = 10_000_000_000;
/// Resolution: three significant digits.
const DIGITS: u8 = 3;

/// A histogram of durations.
#[derive(Debug, Clone)]
pub struct Durations(Histogram<u32>);

/// Median, 99th percentile and maximum, in nanoseconds, each exact to 0.1 %.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Spread {
    /// Median.
    pub p50_ns: u64,
    /// 99th percentile.
    pub p99_ns: u64,
    /// Maximum.
    pub max_ns: u64,
}

impl Default for Durations {
    fn default() -> Self {
        // The bounds are constants that hdrhistogram accepts, which the tests show.
        #[expect(clippy::expect_used, reason = "constant bounds")]
        let mut histogram = Histogram::new_with_bounds(1, MAX_NS, DIGITS).expect("constant bounds are valid");
        histogram.auto(false);
        Self(histogram)
    }
}

impl Durations {
    /// Counts a duration.
    pub fn record(&mut self, duration_ns: u64) {
        self.0.saturating_record(duration_ns);
    }

    /// Median, 99th percentile and maximum; zeros when nothing was counted.
    pub fn spread(&self) -> Spread {
        Spread {
            p50_ns: self.0.value_at_quantile(0.5),
            p99_ns: self.0.value_at_quantile(0.99),
            max_ns: self.0.max(),
        }
    }
}

impl std::fmt::Display for Spread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let us = |ns: u64| ns as f64 / 1e3;
        write!(
            f,
            "p50 {:.1} µs, p99 {:.1} µs, max {:.1} µs",
            us(self.p50_ns),
            us(self.p99_ns),
            us(self.max_ns)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_exact_to_a_thousandth() {
        let mut durations = Durations::default();
        assert_eq!(durations.spread(), Spread::default());
        for us in 1..=1000 {
            durations.record(us * 1000);
        }
        let spread = durations.spread();
        let near = |value: u64, expected: u64| value.abs_diff(expected) * 1000 <= expected;
        assert!(near(spread.p50_ns, 500_000), "{spread:?}");
        assert!(near(spread.p99_ns, 990_000), "{spread:?}");
        assert!(near(spread.max_ns, 1_000_000), "{spread:?}");
        assert_eq!(durations.0.len(), 1000);
    }

    #[test]
    fn an_absurd_duration_is_counted_as_the_longest() {
        let mut durations = Durations::default();
        durations.record(u64::MAX);
        assert!(durations.spread().max_ns >= MAX_NS);
    }
}
