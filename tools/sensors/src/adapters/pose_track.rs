//! Where the vehicle was when a picture was taken.

use std::collections::VecDeque;
use vigil_types::{Attitude, Nanos, NedVector};

/// Reports that are kept: a second at 50 Hz.
const KEPT: usize = 64;
/// A pose is given so long beyond the newest report, and between reports that are no farther apart than the firmware's limit of telemetry.
const MOST_BEYOND_NS: Nanos = 100_000_000;
const MOST_APART_NS: Nanos = 300_000_000;
/// The motion beyond the newest report is taken over at least this: reports are stamped as they arrive, and come in bundles.
const LEAST_APART_NS: Nanos = 50_000_000;

/// A vehicle's reported poses of the last second.
#[derive(Debug, Clone, Default)]
pub struct PoseTrack {
    reports: VecDeque<(Nanos, NedVector, Attitude)>,
}

impl PoseTrack {
    /// Takes a report that arrived at `at_ns`; one that is not finite, not of unit length or not newer is passed over.
    pub fn note(&mut self, at_ns: Nanos, position_ned_m: NedVector, attitude: Attitude) {
        let is_newer = self.reports.back().is_none_or(|(last_ns, ..)| at_ns > *last_ns);
        if !is_newer || !position_ned_m.is_finite() || !attitude.is_valid() {
            return;
        }
        if self.reports.len() == KEPT {
            self.reports.pop_front();
        }
        self.reports.push_back((at_ns, position_ned_m, attitude));
    }

    /// The pose at `at_ns`: between two reports, or a little beyond the newest one as the motion was; `None` where it is not known.
    pub fn at(&self, at_ns: Nanos) -> Option<(NedVector, Attitude)> {
        let after = self.reports.iter().position(|(t, ..)| *t >= at_ns);
        let (a, b) = match after {
            Some(0) => {
                let first = self.reports.front().filter(|(t, ..)| *t == at_ns)?;
                (first, first)
            }
            Some(i) => (self.reports.get(i - 1)?, self.reports.get(i)?),
            None => {
                let newest = self.reports.back().filter(|(t, ..)| at_ns - t <= MOST_BEYOND_NS)?;
                let mut earlier = self.reports.iter().rev();
                let before = earlier.find(|(t, ..)| newest.0 - t >= LEAST_APART_NS);
                let before = before.filter(|(t, ..)| newest.0 - t <= MOST_APART_NS);
                (before.unwrap_or(newest), newest)
            }
        };
        if b.0 - a.0 > MOST_APART_NS {
            return None;
        }
        let part = match b.0 - a.0 {
            0 => 0.0,
            apart_ns => (at_ns - a.0) as f32 / apart_ns as f32,
        };
        Some((a.1 + (b.1 - a.1) * part, between(a.2, b.2, part)))
    }
}

/// An attitude between (0) and (1), or beyond; for turns of some degrees.
fn between(a: Attitude, b: Attitude, part: f32) -> Attitude {
    let (p, mut q) = ([a.w, a.x, a.y, a.z], [b.w, b.x, b.y, b.z]);
    // The two quaternions of a turn: the near one.
    if p.iter().zip(&q).map(|(p, q)| p * q).sum::<f32>() < 0.0 {
        q = q.map(|v| -v);
    }
    let mixed: [f32; 4] = std::array::from_fn(|i| p[i] + part * (q[i] - p[i]));
    let norm = mixed.iter().map(|v| v * v).sum::<f32>().sqrt();
    let [w, x, y, z] = mixed.map(|v| v / norm);
    Attitude { w, x, y, z }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Nanos = 1_000_000;

    fn flown() -> PoseTrack {
        let mut track = PoseTrack::default();
        for n in 0..100u64 {
            let s = n as f32 * 0.02;
            let turn = Attitude::from_euler_rad(0.0, 0.0, 3.0 + 0.5 * s);
            track.note(n * 20 * MS, NedVector::new(2.0 * s, 0.0, -1.5), turn);
        }
        track
    }

    #[test]
    fn a_pose_between_and_a_little_beyond_reports_is_that_of_the_motion() {
        let track = flown();
        for ms in [1500, 1507, 1979, 1980, 2040] {
            let (position, attitude) = track.at(ms * MS).expect("known");
            let s = ms as f32 * 1e-3;
            let off_m = (position - NedVector::new(2.0 * s, 0.0, -1.5)).norm();
            assert!(off_m < 1e-3, "{ms}: {position:?}");
            let error = vigil_types::wrap_pi(attitude.yaw_rad() - 3.0 - 0.5 * s);
            assert!(error.abs() < 1e-3 && attitude.is_valid(), "{ms}: {error}");
        }
    }

    #[test]
    fn two_reports_of_one_bundle_are_not_taken_for_a_leap() {
        let mut track = flown();
        let newest_ns = 1980 * MS + 800_000;
        let turn = Attitude::from_euler_rad(0.0, 0.0, 4.0);
        track.note(newest_ns, NedVector::new(4.0, 0.0, -1.5), turn);
        let (position, attitude) = track.at(newest_ns + 20 * MS).expect("known");
        let off_m = (position - NedVector::new(4.04, 0.0, -1.5)).norm();
        let off_rad = vigil_types::wrap_pi(attitude.yaw_rad() - 4.01);
        assert!(off_m < 0.1 && off_rad.abs() < 0.02, "{position:?}, {attitude:?}");
    }

    #[test]
    fn what_is_not_known_is_not_reported() {
        let mut track = flown();
        assert_eq!(track.at(600 * MS), None, "longer ago than is kept");
        assert_eq!(track.at(2100 * MS), None, "after the reports stopped");
        track.note(2500 * MS, NedVector::ZERO, Attitude::LEVEL_NORTH);
        assert_eq!(track.at(2300 * MS), None, "in the gap");
        track.note(2520 * MS, NedVector::new(f32::NAN, 0.0, 0.0), Attitude::LEVEL_NORTH);
        assert!(track.at(2510 * MS).is_some_and(|(position, _)| position.is_finite()));
        assert_eq!(PoseTrack::default().at(0), None);
    }
}
