//! The machine's monotonic clock, which all processes on it share: frame stamps and the loop's deadlines are its.

use rustix::thread::{ClockId, clock_nanosleep_absolute};
use rustix::time::{Timespec, clock_gettime};
use vigil_types::Nanos;

/// The time now, nanoseconds since an arbitrary start.
pub fn monotonic_ns() -> Nanos {
    let now = clock_gettime(ClockId::Monotonic);
    // Both parts are positive on the monotonic clock.
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Microseconds since 1970 at zero of [`monotonic_ns`], which is `now_ns` now; 0 on a machine whose clock is before 1970.
pub fn unix_us_at_zero(now_ns: Nanos) -> u64 {
    let unix_us = std::time::UNIX_EPOCH
        .elapsed()
        .map_or(0, |since| since.as_micros() as u64);
    unix_us.saturating_sub(now_ns / 1000)
}

/// Sleeps until `deadline_ns` of [`monotonic_ns`]; signals do not shorten it.
pub fn sleep_until(deadline_ns: Nanos) {
    let deadline = Timespec {
        tv_sec: (deadline_ns / 1_000_000_000) as i64,
        tv_nsec: (deadline_ns % 1_000_000_000) as i64,
    };
    while clock_nanosleep_absolute(ClockId::Monotonic, &deadline).is_err_and(|e| e == rustix::io::Errno::INTR) {}
}
