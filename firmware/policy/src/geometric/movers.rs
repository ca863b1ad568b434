//! Obstacles that move: found and followed over the frames, so that the pilot knows where they are going to be.
//!
//! A mover is a small thing that stands free in the scan (on both sides the scan sees past it) and whose middle is somewhere else in NED a moment
//! later. Each such thing is followed with constant velocity (a Kalman filter whose two axes share one covariance); one that has gone far
//! enough, fast enough, is a mover. Walls, columns that stand, and whatever is partly hidden are none.

use crate::geometric::range_scan::{SECTORS, Scan};
use crate::{larger, smaller};
use vigil_types::{Nanos, NedVector};

/// Things followed at once; further ones are left out.
pub const MAX_TRACKS: usize = 12;

/// Neighbouring points nearer together than this, and [`GAP_PER_RANGE`] of their distance, belong to one thing, metres.
const GAP_M: f32 = 0.20;
/// Neighbouring sectors are 0.016 of the distance apart; a surface seen at a slant has its points farther apart.
const GAP_PER_RANGE: f32 = 0.05;
/// Angle of a sector, radians.
const SECTOR_RAD: f32 = 0.016;
/// A thing stands free where the scan sees this much farther beside it, metres.
const FREE_BEYOND_M: f32 = 0.35;
/// The widest thing that is followed, metres.
const WIDEST_M: f32 = 1.3;
/// Farther things have too few points, metres.
const FARTHEST_M: f32 = 9.0;
/// Least radius of a thing, metres.
const LEAST_RADIUS_M: f32 = 0.15;

/// Variance of a thing's middle in one frame, square metres.
const MIDDLE_VARIANCE_M2: f32 = 0.0025;
/// Variance of a new thing's velocity, (m/s)².
const VELOCITY_VARIANCE: f32 = 0.36;
/// How fast a velocity may change: spectral density of the acceleration, m²/s³.
const ACCELERATION_DENSITY: f32 = 0.05;
/// A thing seen this far from where a track expects its own is another one, metres.
const GATE_M: f32 = 0.5;

/// A mover has been seen in so many frames, gone so far and is so fast.
const MOVER_FRAMES: u16 = 8;
const MOVER_WAY_M: f32 = 0.25;
const MOVER_SPEED_M_S: f32 = 0.18;
/// A mover that is slower than this for so many frames stands: at the end of its lane it turns back.
const STANDS_M_S: f32 = 0.08;
const STANDS_FRAMES: u8 = 15;
/// A thing that is not seen is forgotten after this time, seconds; a mover after the second one.
const FORGET_S: f32 = 0.5;
const FORGET_MOVER_S: f32 = 20.0;
/// A mover that is not seen goes on for so long, seconds; then it may be anywhere on its lane.
const GOES_ON_S: f32 = 1.5;
/// A mover's trace is forgotten for so many frames since it is known to move: later it leaves none, and what stands beside its way stays known.
const TRACE_FRAMES: u16 = 10;
/// A thing this near to where a lost mover can be is that mover, metres.
const LANE_GATE_M: f32 = 0.4;
/// Where the scan sees this much past a mover's place, it is not there, metres.
const PAST_M: f32 = 0.5;
/// Frames after which a velocity that began anew is known.
const SETTLING_FRAMES: u16 = 4;
/// Points this near to a mover's circle are its own, metres.
const OWN_M: f32 = 0.25;
/// A pause between frames beyond this makes all tracks worthless, seconds.
const LONGEST_PAUSE_S: f32 = 1.0;

/// A thing that is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    lane_m: [(f32, f32); 2],
    /// Where it was last seen.
    seen_m: (f32, f32),
    frames: u16,
    slow_frames: u8,
    /// Frames in which it was seen since it is known to move.
    moving_frames: u16,
    unseen_s: f32,
    /// Not where it would be had it gone on.
    lost: bool,
    /// When it turns back, seconds from now, where that is known; otherwise infinite.
    turns_after_s: f32,
    /// Whether it was seen to turn back at either end of `lane_m`.
    turned: [bool; 2],
    /// Whether it last went towards the second of them, if it is known.
    heads_to_second: Option<bool>,
    /// The ends, by bits ([`AHEAD_M`] times [`BEHIND_M`]), with which it would have been seen since it was last seen.
    refuted: u64,
}

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
    fn new(thing: &Thing) -> Self {
        Self {
            north_m: thing.north_m,
            east_m: thing.east_m,
            north_m_s: 0.0,
            east_m_s: 0.0,
            radius_m: thing.radius_m,
            moves: false,
            variance: [MIDDLE_VARIANCE_M2, 0.0, VELOCITY_VARIANCE],
            stood_m: (thing.north_m, thing.east_m),
            lane_m: [(thing.north_m, thing.east_m); 2],
            seen_m: (thing.north_m, thing.east_m),
            frames: 1,
            slow_frames: 0,
            moving_frames: 0,
            unseen_s: 0.0,
            lost: false,
            turns_after_s: f32::INFINITY,
            turned: [false; 2],
            heads_to_second: None,
            refuted: 0,
        }
    }

    /// Where it will be, metres north and east.
    pub fn position_after(&self, seconds: f32) -> (f32, f32) {
        (
            self.north_m + self.north_m_s * seconds,
            self.east_m + self.east_m_s * seconds,
        )
    }

    /// When it turns back, seconds from now; infinite where that is not known.
    pub fn turns_after_s(&self) -> f32 {
        self.turns_after_s
    }

    /// Speed, metres per second.
    pub fn speed_m_s(&self) -> f32 {
        libm::hypotf(self.north_m_s, self.east_m_s)
    }

    /// Seconds since it was last seen.
    pub fn unseen_s(&self) -> f32 {
        self.unseen_s
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

    /// Leaves out the ends with which it would be seen now. `sees_past` tells that nothing can be at a place.
    fn refute(&mut self, sees_past: impl Fn((f32, f32)) -> bool) {
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

    fn predict(&mut self, seconds: f32) {
        (self.north_m, self.east_m) = self.position_after(seconds);
        let [position, both, velocity] = self.variance;
        let q = ACCELERATION_DENSITY;
        self.variance = [
            position + seconds * (2.0 * both + seconds * velocity) + q * seconds * seconds * seconds / 3.0,
            both + seconds * velocity + 0.5 * q * seconds * seconds,
            velocity + q * seconds,
        ];
    }

    fn correct(&mut self, thing: &Thing) {
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
        self.unseen_s = 0.0;
        self.refuted = 0;
        self.seen_m = (self.north_m, self.east_m);
        self.judge();
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
    fn found(thing: &Thing) -> Self {
        Self {
            moves: true,
            frames: MOVER_FRAMES - SETTLING_FRAMES,
            ..Self::new(thing)
        }
    }

    fn judge(&mut self) {
        let speed_m_s = self.speed_m_s();
        let slow = speed_m_s < STANDS_M_S && self.frames >= MOVER_FRAMES;
        self.slow_frames = if slow { self.slow_frames.saturating_add(1) } else { 0 };
        if self.moves && self.slow_frames >= STANDS_FRAMES {
            self.moves = false;
            self.stood_m = (self.north_m, self.east_m);
            self.lane_m = [self.stood_m; 2];
        }
        let way_m = libm::hypotf(self.north_m - self.stood_m.0, self.east_m - self.stood_m.1);
        self.moves |= self.frames >= MOVER_FRAMES && way_m > MOVER_WAY_M && speed_m_s > MOVER_SPEED_M_S;
    }
}

/// A small thing that stands free in one scan.
#[derive(Debug, Clone, Copy)]
struct Thing {
    north_m: f32,
    east_m: f32,
    radius_m: f32,
}

/// What one scan shows of a small thing, in level axes along the heading.
#[derive(Debug, Clone, Copy)]
struct Outline {
    /// Bearings of its leftmost and rightmost points, radians.
    left_rad: f32,
    right_rad: f32,
    /// Whether the scan sees past it there; where it does not, the thing may go on.
    free_left: bool,
    free_right: bool,
    nearest_m: f32,
}

impl Outline {
    /// The thing, if both sides are seen: a circle of radius r at distance d spans the angle 2 asin(r / d), and its nearest point is at d − r.
    fn thing(&self, place: impl Fn(f32, f32) -> (f32, f32)) -> Option<Thing> {
        if !(self.free_left && self.free_right) {
            return None;
        }
        let half = libm::sinf(0.5 * (self.right_rad - self.left_rad + SECTOR_RAD)).min(0.7);
        let radius_m = (self.nearest_m * half / (1.0 - half)).clamp(LEAST_RADIUS_M, 0.5 * WIDEST_M);
        let (north_m, east_m) = place(self.nearest_m + radius_m, 0.5 * (self.left_rad + self.right_rad));
        Some(Thing {
            north_m,
            east_m,
            radius_m,
        })
    }

    /// A thing of known radius by the side of it that is seen.
    fn part_of(&self, radius_m: f32, place: impl Fn(f32, f32) -> (f32, f32)) -> Option<Thing> {
        let range_m = self.nearest_m + radius_m;
        let half_rad = libm::asinf((radius_m / range_m).min(1.0));
        let bearing_rad = match (self.free_left, self.free_right) {
            (true, false) => self.left_rad - 0.5 * SECTOR_RAD + half_rad,
            (false, true) => self.right_rad + 0.5 * SECTOR_RAD - half_rad,
            _ => return None,
        };
        let (north_m, east_m) = place(range_m, bearing_rad);
        Some(Thing {
            north_m,
            east_m,
            radius_m,
        })
    }
}

/// Follows what moves. Fixed size, no allocation.
#[derive(Debug, Clone, Default)]
pub struct MoverTracker {
    tracks: [Option<Track>; MAX_TRACKS],
    last_ns: Option<Nanos>,
}

impl MoverTracker {
    /// One that has seen nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// What moves, as of the last frame.
    pub fn movers(&self) -> impl Iterator<Item = &Track> + Clone {
        self.tracks.iter().flatten().filter(|track| track.moves)
    }

    /// Enters a new frame's scan, seen from `here` with this heading at `stamp_ns`.
    pub fn observe(&mut self, scan: &Scan, here: NedVector, yaw_rad: f32, stamp_ns: Nanos) {
        let seconds = self
            .last_ns
            .map_or(0.0, |last| stamp_ns.saturating_sub(last) as f32 * 1e-9);
        self.last_ns = Some(stamp_ns);
        if seconds > LONGEST_PAUSE_S {
            self.tracks = [None; MAX_TRACKS];
        }
        for track in self.tracks.iter_mut().flatten() {
            if track.is_located() {
                track.predict(seconds);
            }
            track.unseen_s += seconds;
        }
        let place = |range_m: f32, bearing_rad: f32| {
            let angle = yaw_rad + bearing_rad;
            (
                here.x + range_m * libm::cosf(angle),
                here.y + range_m * libm::sinf(angle),
            )
        };
        let mut corrected = [false; MAX_TRACKS];
        for_each_outline(scan, |outline| match outline.thing(place) {
            Some(thing) => self.enter(&thing, &mut corrected),
            None => self.enter_part(outline, place, &mut corrected),
        });
        let (sin, cos) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        for (slot, corrected) in self.tracks.iter_mut().zip(corrected) {
            let Some(track) = slot else { continue };
            if !corrected && track.moves {
                let radius_m = track.radius_m;
                track.refute(|place| sees_past(scan, place, radius_m, here, (sin, cos)));
            }
            track.lost |=
                !corrected && sees_past(scan, (track.north_m, track.east_m), track.radius_m, here, (sin, cos));
            let forget_s = if track.moves { FORGET_MOVER_S } else { FORGET_S };
            if track.unseen_s > forget_s {
                *slot = None;
            }
        }
        self.forget_doubles();
    }

    /// Enters a thing: of the track that expects it there, of a lost mover that can be there, or of a new track.
    fn enter(&mut self, thing: &Thing, corrected: &mut [bool; MAX_TRACKS]) {
        let off_m = |track: &Track| libm::hypotf(track.north_m - thing.north_m, track.east_m - thing.east_m);
        let nearest = self
            .tracks
            .iter_mut()
            .zip(corrected.iter_mut())
            .filter(|(_, corrected)| !**corrected)
            .filter_map(|(track, corrected)| track.as_mut().map(|track| (track, corrected)))
            .filter(|(track, _)| track.is_located())
            .map(|(track, corrected)| (off_m(track), track, corrected))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((off_m, track, corrected)) = nearest
            && off_m < GATE_M
        {
            track.correct(thing);
            *corrected = true;
            return;
        }
        // What stands on a lost mover's lane is not that mover, which stays lost until the thing is seen to move.
        let on_a_lane = self
            .movers()
            .any(|lost| !lost.is_located() && lost.off_lane_m(thing.north_m, thing.east_m, 0.0) < LANE_GATE_M);
        let free = self
            .tracks
            .iter_mut()
            .zip(corrected.iter_mut())
            .find(|(slot, _)| slot.is_none());
        if let Some((slot, corrected)) = free {
            *slot = Some(if on_a_lane {
                Track::found(thing)
            } else {
                Track::new(thing)
            });
            *corrected = true;
        }
    }

    /// Enters what is seen of one side of a mover.
    fn enter_part(
        &mut self,
        outline: &Outline,
        place: impl Fn(f32, f32) -> (f32, f32) + Copy,
        corrected: &mut [bool; MAX_TRACKS],
    ) {
        for (track, corrected) in self.tracks.iter_mut().zip(corrected) {
            if let Some(track) = track
                && track.moves
                && track.is_located()
                && !*corrected
                && let Some(thing) = outline.part_of(track.radius_m, place)
                && libm::hypotf(track.north_m - thing.north_m, track.east_m - thing.east_m) < GATE_M
            {
                track.correct(&thing);
                *corrected = true;
                return;
            }
        }
    }

    /// Forgets a lost mover on whose lane another is seen to move: it is the same, and its lane is known already.
    fn forget_doubles(&mut self) {
        let before = self.tracks;
        for (i, slot) in before.iter().enumerate() {
            let Some(lost) = slot.filter(|lost| lost.moves && !lost.is_located()) else {
                continue;
            };
            let is_it = |m: &&mut Track| {
                m.moves
                    && m.is_located()
                    && m.frames >= MOVER_FRAMES
                    && m.speed_m_s() > MOVER_SPEED_M_S
                    && lost.off_lane_m(m.north_m, m.east_m, 0.0) < LANE_GATE_M
            };
            if let Some(found) = self.tracks.iter_mut().flatten().find(is_it) {
                found.lane_m = lost.lane_m;
                found.turned = lost.turned;
                found.heads_to_second = None;
                if let Some(slot) = self.tracks.get_mut(i) {
                    *slot = None;
                }
            }
        }
    }

    /// Movers that have left something in the grid before they were known to move.
    pub fn traces(&self) -> impl Iterator<Item = &Track> {
        self.movers()
            .filter(|mover| mover.is_located() && mover.moving_frames <= TRACE_FRAMES)
    }

    /// Whether a place is a mover's own, as of the last frame.
    pub fn is_of_a_mover(&self, north_m: f32, east_m: f32) -> bool {
        self.movers()
            .any(|m| m.is_located() && libm::hypotf(m.north_m - north_m, m.east_m - east_m) < m.radius_m + OWN_M)
    }
}

/// Whether the scan sees well past a place: nothing of that radius is there. `turn` is sine and cosine of the heading.
fn sees_past(scan: &Scan, place: (f32, f32), radius_m: f32, here: NedVector, turn: (f32, f32)) -> bool {
    let (north_m, east_m) = (place.0 - here.x, place.1 - here.y);
    let (sin, cos) = turn;
    let (x, y) = (cos * north_m + sin * east_m, cos * east_m - sin * north_m);
    let range_m = libm::hypotf(x, y);
    let directions = scan.direction_forward.iter().zip(&scan.direction_right);
    directions.zip(&scan.range_m).any(|((dx, dy), seen_m)| {
        // Within half a degree of its middle.
        dx * x + dy * y > 0.99996 * range_m && *seen_m > range_m + radius_m + PAST_M
    })
}

/// Calls `each` with what is seen of every small thing of which at least one side stands free, left to right.
fn for_each_outline(scan: &Scan, mut each: impl FnMut(&Outline)) {
    let at = |i: usize| -> Option<(f32, f32, f32)> {
        let (x, y, r) = (scan.forward_m.get(i)?, scan.right_m.get(i)?, scan.range_m.get(i)?);
        Some((*x, *y, *r))
    };
    let mut from = 0;
    while from < SECTORS {
        let Some(first) = at(from) else { return };
        let (mut to, mut last, mut nearest_m) = (from, first, first.2);
        if first.2 < FARTHEST_M {
            while let Some(next) = at(to + 1)
                && next.2.is_finite()
                && libm::hypotf(next.0 - last.0, next.1 - last.1) < GAP_M + GAP_PER_RANGE * smaller(next.2, last.2)
            {
                last = next;
                nearest_m = smaller(nearest_m, next.2);
                to += 1;
            }
            let beside = |i: Option<usize>, edge_m: f32| i.and_then(at).is_some_and(|p| p.2 > edge_m + FREE_BEYOND_M);
            let (free_left, free_right) = (beside(from.checked_sub(1), first.2), beside(Some(to + 1), last.2));
            let width_m = libm::hypotf(last.0 - first.0, last.1 - first.1);
            if (free_left || free_right) && to > from && width_m < WIDEST_M {
                each(&Outline {
                    left_rad: libm::atan2f(first.1, first.0),
                    right_rad: libm::atan2f(last.1, last.0),
                    free_left,
                    free_right,
                    nearest_m,
                });
            }
        }
        from = to + 1;
    }
}

#[cfg(test)]
pub(super) mod tests;
