//! One thing that is followed: a Kalman filter of constant velocity whose two axes share one covariance, and, for one that moves to and
//! fro and is not seen, the places at which it may be.

use crate::larger;

/// Variance of a thing's middle in one frame, square metres.
const MIDDLE_VARIANCE_M2: f32 = 0.0025;
/// Variance of a new thing's velocity, (m/s)².
const VELOCITY_VARIANCE: f32 = 0.36;
/// How fast a velocity may change: spectral density of the acceleration, m²/s³.
const ACCELERATION_DENSITY: f32 = 0.05;
/// A mover has been seen in so many frames, gone so far and is so fast.
pub(super) const MOVER_FRAMES: u16 = 8;
const MOVER_TRAVEL_M: f32 = 0.25;
pub(super) const MOVER_SPEED_M_S: f32 = 0.18;
/// A mover that is slower than this for so many frames stands: at the end of its lane it turns back.
const STANDS_M_S: f32 = 0.08;
const STANDS_FRAMES: u8 = 15;
/// A mover that is not seen goes on for so long, seconds; then it may be anywhere on its lane.
const GOES_ON_S: f32 = 1.5;
/// Frames after which a velocity that began anew is known.
const SETTLING_FRAMES: u16 = 4;
/// A lane may end so far beyond where its mover was seen, metres: ahead of it as it went last, and behind it.
const AHEAD_M: [f32; 12] = [0.2, 0.6, 1.0, 1.4, 1.8, 2.2, 2.6, 3.0, 3.4, 3.8, 4.2, 4.6];
/// See [`AHEAD_M`].
const BEHIND_M: [f32; 5] = [0.2, 1.2, 2.2, 3.2, 4.2];
const _: () = assert!(AHEAD_M.len() * BEHIND_M.len() <= u64::BITS as usize, "a bit for each");
/// Lanes have such lengths, metres; each other is this much less likely.
const LANES_M: core::ops::Range<f32> = 3.0..6.5;
const ODD_LANE: f32 = 0.1;
const SHORTEST_LANE_M: f32 = 0.3;
/// How likely it is that a thing that was followed is not on its lane at all.
const ELSEWHERE: f32 = 0.1;
/// Where this much beside a mover's radius is seen past too, it is not there, metres.
const BESIDE_M: f32 = 0.1;
/// A slower mover has no direction, metres per second.
pub const LEAST_SPEED_M_S: f32 = 0.05;

/// A thing that is followed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Track {
    /// Middle, metres north and east.
    pub north_m: f32,
    /// See [`Self::north_m`].
    pub east_m: f32,
    /// Velocity, metres per second north and east.
    pub north_m_s: f32,
    /// See [`Self::north_m_s`].
    pub east_m_s: f32,
    /// Radius of a circle around it, metres.
    pub radius_m: f32,
    /// Whether it moves.
    pub moves: bool,
    /// Variance of the position and of the velocity along each axis, and their covariance.
    variance: [f32; 3],
    /// Where it was when it was last known to stand, or first seen.
    stood_m: (f32, f32),
    /// The places farthest apart at which it was seen since it moves.
    pub(super) lane_m: [(f32, f32); 2],
    /// Where it was last seen.
    seen_m: (f32, f32),
    pub(super) frames: u16,
    slow_frames: u8,
    /// Frames in which it was seen since it is known to move.
    pub(super) moving_frames: u16,
    /// In the last frame.
    pub(super) is_seen: bool,
    pub(super) unseen_s: f32,
    /// Not where it would be had it gone on.
    pub(super) lost: bool,
    /// Whether it was seen to turn back at either end of `lane_m`.
    pub(super) turned: [bool; 2],
    /// Whether it last went towards the second of them, if it is known.
    pub(super) heads_to_second: Option<bool>,
    /// The ends, by bits ([`AHEAD_M`] times [`BEHIND_M`]), with which it would have been seen since it was last seen.
    refuted: u64,
}

/// Where a mover is, given where its lane ends: one of the places that it may be at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whereabouts {
    /// How far from where it was last seen, metres along its velocity then.
    pub along_m: f32,
    /// 1 where it goes as it did when it was last seen, -1 where it comes back.
    pub direction: f32,
    /// How far it goes until it turns, metres.
    pub turns_after_m: f32,
    /// How likely that is, 0 to 1.
    pub weight: f32,
}

impl Track {
    pub(super) fn new(thing: &Thing) -> Self {
        let at = (thing.north_m, thing.east_m);
        Self {
            north_m: thing.north_m,
            east_m: thing.east_m,
            radius_m: thing.radius_m,
            variance: [MIDDLE_VARIANCE_M2, 0.0, VELOCITY_VARIANCE],
            stood_m: at,
            lane_m: [at; 2],
            seen_m: at,
            frames: 1,
            is_seen: true,
            ..Self::default()
        }
    }

    /// Speed, metres per second.
    pub fn speed_m_s(&self) -> f32 {
        libm::hypotf(self.north_m_s, self.east_m_s)
    }

    /// Whether it was seen lately enough to be where it is said to be.
    pub fn is_located(&self) -> bool {
        !self.lost && self.unseen_s < GOES_ON_S
    }

    /// How far a place is beside the line on which it goes to and fro, and how far beyond where it can be by now, metres; 0 where it was seen.
    ///
    /// It turns back somewhere; an end that was not seen yet may be farther.
    pub fn off_lane_m(&self, north_m: f32, east_m: f32, after_s: f32) -> f32 {
        let [from, to] = self.lane_m;
        let (n, e) = (to.0 - from.0, to.1 - from.1);
        let length_m = libm::hypotf(n, e).max(1e-3);
        let (n, e) = (n / length_m, e / length_m);
        let along = |p: (f32, f32)| (p.0 - from.0) * n + (p.1 - from.1) * e;
        let here = along((north_m, east_m));
        let beside_m = ((north_m - from.0) * e - (east_m - from.1) * n).abs();
        // As far as it can have come since it was last seen.
        let reach_m = self.speed_m_s() * (self.unseen_s + after_s);
        let seen = along(self.seen_m);
        let beyond_m = larger(larger(seen - reach_m - here, here - seen - reach_m), 0.0);
        libm::hypotf(beside_m, beyond_m)
    }

    /// Calls `each` with the places at which it may be `ahead_s` from the last frame: it goes to and fro at a constant speed between ends of which
    /// those that it was seen to turn at are known, and the others lie anywhere beyond where it was seen. Ends are left out where it would have been
    /// seen since. All weights together are less than 1.
    pub fn for_each_whereabouts(&self, ahead_s: f32, mut each: impl FnMut(Whereabouts)) {
        let is_left = |bit: usize| (self.refuted >> bit) & 1 == 0;
        let (mut all, mut left) = (0.0, 0.0);
        self.for_each_ends(ahead_s, |bit, w| {
            all += w.weight;
            left += if is_left(bit) { w.weight } else { 0.0 };
        });
        let scale = 1.0 / (left + ELSEWHERE * all);
        self.for_each_ends(ahead_s, |bit, w| {
            if is_left(bit) {
                each(Whereabouts {
                    weight: w.weight * scale,
                    ..w
                });
            }
        });
    }

    /// The same for all ends, each with its bit in `refuted` and a weight that is not scaled.
    fn for_each_ends(&self, ahead_s: f32, mut each: impl FnMut(usize, Whereabouts)) {
        let speed_m_s = larger(self.speed_m_s(), LEAST_SPEED_M_S);
        let seen_along = self.lane_m.map(|(north_m, east_m)| {
            ((north_m - self.seen_m.0) * self.north_m_s + (east_m - self.seen_m.1) * self.east_m_s) / speed_m_s
        });
        let [first_m, second_m] = seen_along;
        let [first_turned, second_turned] = self.turned;
        let ((front_m, front_is_end), (rear_m, rear_is_end)) = if first_m > second_m {
            ((first_m, first_turned), (-second_m, second_turned))
        } else {
            ((second_m, second_turned), (-first_m, first_turned))
        };
        let gone_m = speed_m_s * (self.unseen_s + ahead_s);
        let beyond = |is_end: bool, beyond_m: f32| if is_end { 0.0 } else { beyond_m };
        let ends = |is_end: bool, all: usize| if is_end { 1 } else { all };
        for (i, ahead_m) in AHEAD_M.iter().enumerate().take(ends(front_is_end, AHEAD_M.len())) {
            let front_m = larger(front_m, 0.0) + beyond(front_is_end, *ahead_m);
            for (k, behind_m) in BEHIND_M.iter().enumerate().take(ends(rear_is_end, BEHIND_M.len())) {
                let rear_m = larger(rear_m, 0.0) + beyond(rear_is_end, *behind_m);
                let length_m = larger(front_m + rear_m, SHORTEST_LANE_M);
                // Its way there and back, unrolled from the rear end.
                let unrolled_m = gone_m + rear_m;
                let round_m = unrolled_m - 2.0 * length_m * libm::floorf(unrolled_m / (2.0 * length_m));
                let (at_m, direction, turns_after_m) = if round_m < length_m {
                    (round_m, 1.0, length_m - round_m)
                } else {
                    (2.0 * length_m - round_m, -1.0, 2.0 * length_m - round_m)
                };
                each(
                    i * BEHIND_M.len() + k,
                    Whereabouts {
                        along_m: at_m - rear_m,
                        direction,
                        turns_after_m,
                        weight: if LANES_M.contains(&length_m) { 1.0 } else { ODD_LANE },
                    },
                );
            }
        }
    }

    /// A place on its lane, metres north and east, from how far it is from where the mover was last seen, along its velocity then.
    pub fn place_m(&self, along_m: f32) -> (f32, f32) {
        let speed_m_s = larger(self.speed_m_s(), LEAST_SPEED_M_S);
        (
            self.seen_m.0 + along_m * self.north_m_s / speed_m_s,
            self.seen_m.1 + along_m * self.east_m_s / speed_m_s,
        )
    }

    /// Leaves out the ends with which it would be seen now. `sees_past` says that nothing can be at a place.
    pub(super) fn refute(&mut self, sees_past: impl Fn((f32, f32)) -> bool) {
        let mut refuted = self.refuted;
        let beside_m = self.radius_m + BESIDE_M;
        self.for_each_ends(0.0, |bit, w| {
            let is_seen_past = |off_m: f32| sees_past(self.place_m(w.along_m + off_m));
            if (refuted >> bit) & 1 == 0 && [0.0, -beside_m, beside_m].into_iter().all(is_seen_past) {
                refuted |= 1 << bit;
            }
        });
        self.refuted = refuted;
    }

    pub(super) fn predict(&mut self, seconds: f32) {
        self.north_m += self.north_m_s * seconds;
        self.east_m += self.east_m_s * seconds;
        let [position, both, velocity] = self.variance;
        let q = ACCELERATION_DENSITY;
        self.variance = [
            position + seconds * (2.0 * both + seconds * velocity) + q * seconds * seconds * seconds / 3.0,
            both + seconds * velocity + 0.5 * q * seconds * seconds,
            velocity + q * seconds,
        ];
    }

    pub(super) fn correct(&mut self, thing: &Thing) {
        let [position, both, velocity] = self.variance;
        let sum = position + MIDDLE_VARIANCE_M2;
        let (gain, velocity_gain) = (position / sum, both / sum);
        let (off_north_m, off_east_m) = (thing.north_m - self.north_m, thing.east_m - self.east_m);
        self.north_m += gain * off_north_m;
        self.east_m += gain * off_east_m;
        self.north_m_s += velocity_gain * off_north_m;
        self.east_m_s += velocity_gain * off_east_m;
        self.variance = [
            (1.0 - gain) * position,
            (1.0 - gain) * both,
            velocity - velocity_gain * both,
        ];
        // A box shows one side now, another then: the larger of what it showed, slowly forgotten.
        self.radius_m = larger(thing.radius_m, 0.98 * self.radius_m + 0.02 * thing.radius_m);
        self.frames = self.frames.saturating_add(1);
        (self.is_seen, self.unseen_s) = (true, 0.0);
        self.refuted = 0;
        self.seen_m = (self.north_m, self.east_m);
        self.classify();
        if self.moves {
            self.moving_frames = self.moving_frames.saturating_add(1);
            let apart_m = |a: (f32, f32), b: (f32, f32)| libm::hypotf(a.0 - b.0, a.1 - b.1);
            let [from, to] = self.lane_m;
            if apart_m(self.seen_m, from) > apart_m(from, to) {
                self.lane_m = [from, self.seen_m];
                self.turned[1] = false;
            } else if apart_m(self.seen_m, to) > apart_m(from, to) {
                self.lane_m = [self.seen_m, to];
                self.turned[0] = false;
            }
            self.watch_for_turns();
        }
    }

    /// Remembers at which end of its lane it turned back.
    fn watch_for_turns(&mut self) {
        let [from, to] = self.lane_m;
        if self.speed_m_s() < MOVER_SPEED_M_S {
            return;
        }
        let to_second = (to.0 - from.0) * self.north_m_s + (to.1 - from.1) * self.east_m_s > 0.0;
        match (self.heads_to_second, to_second) {
            (Some(true), false) => self.turned[1] = true,
            (Some(false), true) => self.turned[0] = true,
            _ => {}
        }
        self.heads_to_second = Some(to_second);
    }

    /// What may be a lost mover, it is not known going which way: it counts as one until it is seen to stand.
    pub(super) fn found(thing: &Thing) -> Self {
        Self {
            moves: true,
            frames: MOVER_FRAMES - SETTLING_FRAMES,
            ..Self::new(thing)
        }
    }

    fn classify(&mut self) {
        let speed_m_s = self.speed_m_s();
        let slow = speed_m_s < STANDS_M_S && self.frames >= MOVER_FRAMES;
        self.slow_frames = if slow { self.slow_frames.saturating_add(1) } else { 0 };
        if self.moves && self.slow_frames >= STANDS_FRAMES {
            self.moves = false;
            self.stood_m = (self.north_m, self.east_m);
            self.lane_m = [self.stood_m; 2];
        }
        let way_m = libm::hypotf(self.north_m - self.stood_m.0, self.east_m - self.stood_m.1);
        self.moves |= self.frames >= MOVER_FRAMES && way_m > MOVER_TRAVEL_M && speed_m_s > MOVER_SPEED_M_S;
    }
}

/// A small thing that stands free in one scan.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thing {
    pub(super) north_m: f32,
    pub(super) east_m: f32,
    pub(super) radius_m: f32,
}
