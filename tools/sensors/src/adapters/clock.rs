//! The stamps of a device's clock on the machine's.

use super::Fault;
use vigil_types::Nanos;

/// The least delay is looked for in this time, and kept for another such: clocks drift by some ten microseconds in a second.
const WINDOW_NS: Nanos = 5_000_000_000;
/// A packet that is so much later than the least delay has no stamp that can be believed.
const MOST_BEHIND_NS: i128 = 50_000_000;
/// Where all are that late for so long, the clock was set: the new delay counts.
const SET_NS: Nanos = 1_000_000_000;

/// Maps a device's stamps to CLOCK_MONOTONIC by the least difference between arrival and stamp: a network delays, it never hurries. So a
/// stamp is too new by the least delay of the network, some tenth of a millisecond on a cable, and by nothing else.
#[derive(Debug, Clone, Default)]
pub struct DeviceClock {
    /// Least difference, arrival minus stamp, in this window and the one before.
    least_ns: [Option<i128>; 2],
    window_from_ns: Nanos,
    last_device_ns: Option<Nanos>,
    behind_since_ns: Option<Nanos>,
}

impl DeviceClock {
    /// The time on CLOCK_MONOTONIC of `stamp_ns`, for a packet whose newest stamp is `newest_ns` and which arrived at `arrived_ns`.
    ///
    /// # Errors
    /// [`Fault::ClockBack`], [`Fault::ClockBehind`]: no stamp can be given.
    pub fn monotonic_ns(&mut self, stamp_ns: Nanos, newest_ns: Nanos, arrived_ns: Nanos) -> Result<Nanos, Fault> {
        let delay_ns = i128::from(arrived_ns) - i128::from(newest_ns);
        if let Some(last_ns) = self.last_device_ns.replace(newest_ns)
            && newest_ns < last_ns
        {
            self.begin_anew();
            return Err(Fault::ClockBack((last_ns - newest_ns) as f64 * 1e-9));
        }
        let known_ns = self.least_ns.into_iter().flatten().min();
        let behind_ns = known_ns.map_or(0, |known_ns| delay_ns - known_ns);
        if behind_ns > MOST_BEHIND_NS {
            let since_ns = *self.behind_since_ns.get_or_insert(arrived_ns);
            if arrived_ns.saturating_sub(since_ns) >= SET_NS {
                self.begin_anew();
            }
            return Err(Fault::ClockBehind(behind_ns as f64 * 1e-9));
        }
        self.behind_since_ns = None;
        if arrived_ns.saturating_sub(self.window_from_ns) >= WINDOW_NS {
            self.window_from_ns = arrived_ns;
            self.least_ns = [None, self.least_ns[0]];
        }
        let least_ns = self.least_ns[0].map_or(delay_ns, |least_ns| least_ns.min(delay_ns));
        self.least_ns[0] = Some(least_ns);
        let offset_ns = self.least_ns[1].map_or(least_ns, |before_ns| before_ns.min(least_ns));
        Ok(Nanos::try_from(i128::from(stamp_ns) + offset_ns).unwrap_or(0))
    }

    /// Forgets all but the newest stamp.
    fn begin_anew(&mut self) {
        *self = Self {
            last_device_ns: self.last_device_ns,
            ..Self::default()
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: Nanos = 50_000_000;
    /// The device was switched on when the machine had run for 100 s.
    const BOOT: Nanos = 100_000_000_000;

    /// Stamps of a device whose packets take `delay_ns(n)`.
    fn stamped(
        steps: u64,
        device_ns: impl Fn(u64) -> Nanos,
        delay_ns: impl Fn(u64) -> Nanos,
    ) -> Vec<Result<Nanos, Fault>> {
        let mut clock = DeviceClock::default();
        let mut stamp = |n| clock.monotonic_ns(device_ns(n), device_ns(n), BOOT + n * STEP + delay_ns(n));
        (0..steps).map(&mut stamp).collect()
    }

    #[test]
    fn a_network_that_delays_some_packets_does_not_make_stamps_newer() {
        let delays = |n| 200_000 + n % 7 * 3_000_000;
        let stamps = stamped(400, |n| n * STEP, delays);
        for (n, stamp) in stamps.into_iter().enumerate().skip(7) {
            assert_eq!(stamp, Ok(BOOT + n as u64 * STEP + 200_000));
        }
    }

    #[test]
    fn a_clock_that_drifts_is_followed() {
        // 20 µs in a second fast, or slow.
        for drift in [1_000_i64, -1_000] {
            let device_ns = |n: u64| (1_000_000_000 + n * STEP).saturating_add_signed(n as i64 * drift);
            let stamps = stamped(2000, device_ns, |_| 300_000);
            let late = *stamps.last().unwrap().as_ref().unwrap() as i64 - (BOOT + 1999 * STEP) as i64;
            assert!((0..=600_000).contains(&late), "{late} ns");
        }
    }

    #[test]
    fn packets_held_up_and_of_a_clock_that_is_set_get_no_stamp_and_afterwards_all_is_well() {
        let held = |n| if (100..110).contains(&n) { (110 - n) * STEP } else { 0 };
        let stamps = stamped(200, |n| n * STEP, held);
        assert!(matches!(stamps[100], Err(Fault::ClockBehind(behind_s)) if (behind_s - 0.5).abs() < 1e-6));
        assert!(stamps[109..].iter().all(Result::is_ok) && stamps[..100].iter().all(Result::is_ok));
        assert_eq!(stamps[150], Ok(BOOT + 150 * STEP));
        // Set back.
        let device_ns = |n: u64| 60_000_000_000 + n * STEP - if n >= 100 { 30_000_000_000 } else { 0 };
        let stamps = stamped(200, device_ns, |_| 0);
        assert!(matches!(stamps[100], Err(Fault::ClockBack(back_s)) if (back_s - 29.95).abs() < 1e-6));
        assert_eq!(stamps[101], Ok(BOOT + 101 * STEP));
        // Behind for a second.
        let late = |n| if n >= 130 { 300_000_000 } else { 0 };
        let stamps = stamped(200, |n| n * STEP, late);
        let faults = stamps.iter().filter(|s| s.is_err()).count();
        assert!((20..=22).contains(&faults), "{faults}");
        assert!(stamps[160..].iter().all(Result::is_ok));
    }
}
