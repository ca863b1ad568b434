//! Obstacles that move: found and followed over the frames, so that the pilot knows where they are going to be.
//!
//! A mover is a small thing that stands free in the scan (on both sides the scan sees past it) and whose middle is somewhere else in NED a moment
//! later. Each such thing is followed with constant velocity ([`Track`]); one that has gone far enough, fast enough, is a mover. Walls, columns that stand, and whatever is partly hidden are none.

use crate::geometric::range_scan::{SECTORS, Scan};
use crate::geometric::track::{MOVER_FRAMES, MOVER_SPEED_M_S, Thing, Track};
use crate::smaller;
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

/// A thing seen this far from where a track expects its own is another one, metres.
const GATE_M: f32 = 0.5;

/// A thing that is not seen is forgotten after this time, seconds; a mover after the second one.
const FORGET_S: f32 = 0.5;
const FORGET_MOVER_S: f32 = 20.0;
/// A mover's trace is forgotten for so many frames since it is known to move: later it leaves none, and what stands beside its way stays known.
const TRACE_FRAMES: u16 = 10;
/// A thing this near to where a lost mover can be is that mover, metres.
const LANE_GATE_M: f32 = 0.4;
/// Where the scan sees this much past a mover's place, it is not there, metres.
const PAST_M: f32 = 0.5;
/// Points this near to a mover's circle are its own, metres.
const OWN_M: f32 = 0.25;
/// A pause between frames beyond this makes all tracks worthless, seconds.
const LONGEST_PAUSE_S: f32 = 1.0;

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
    fn thing(&self, at: impl Fn(f32, f32, f32) -> Thing) -> Option<Thing> {
        if !(self.free_left && self.free_right) {
            return None;
        }
        let half = libm::sinf(0.5 * (self.right_rad - self.left_rad + SECTOR_RAD)).min(0.7);
        let radius_m = (self.nearest_m * half / (1.0 - half)).clamp(LEAST_RADIUS_M, 0.5 * WIDEST_M);
        let bearing_rad = 0.5 * (self.left_rad + self.right_rad);
        Some(at(self.nearest_m + radius_m, bearing_rad, radius_m))
    }

    /// A thing of known radius by the side of it that is seen.
    fn part_of(&self, radius_m: f32, at: impl Fn(f32, f32, f32) -> Thing) -> Option<Thing> {
        let range_m = self.nearest_m + radius_m;
        let half_rad = libm::asinf((radius_m / range_m).min(1.0));
        let bearing_rad = match (self.free_left, self.free_right) {
            (true, false) => self.left_rad - 0.5 * SECTOR_RAD + half_rad,
            (false, true) => self.right_rad + 0.5 * SECTOR_RAD - half_rad,
            _ => return None,
        };
        Some(at(range_m, bearing_rad, radius_m))
    }
}

/// Follows what moves; by default one that has seen nothing. Fixed size, no allocation.
#[derive(Debug, Clone, Default)]
pub struct MoverTracker {
    tracks: [Option<Track>; MAX_TRACKS],
    last_ns: Option<Nanos>,
}

impl MoverTracker {
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
            track.is_seen = false;
        }
        let at = |range_m: f32, bearing_rad: f32, radius_m: f32| {
            let angle = yaw_rad + bearing_rad;
            Thing {
                north_m: here.x + range_m * libm::cosf(angle),
                east_m: here.y + range_m * libm::sinf(angle),
                radius_m,
            }
        };
        for_each_outline(scan, |outline| match outline.thing(at) {
            Some(thing) => self.enter(&thing),
            None => self.enter_part(outline, at),
        });
        let (sin, cos) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        for slot in &mut self.tracks {
            let Some(track) = slot else { continue };
            let radius_m = track.radius_m;
            let is_past = |place| sees_past(scan, place, radius_m, here, (sin, cos));
            if !track.is_seen && track.moves {
                track.refute(is_past);
            }
            track.lost |= !track.is_seen && is_past((track.north_m, track.east_m));
            let forget_s = if track.moves { FORGET_MOVER_S } else { FORGET_S };
            if track.unseen_s > forget_s {
                *slot = None;
            }
        }
        self.forget_doubles();
    }

    /// Enters a thing: of the track that expects it there, of a lost mover that can be there, or of a new track.
    fn enter(&mut self, thing: &Thing) {
        let off_m = |track: &Track| libm::hypotf(track.north_m - thing.north_m, track.east_m - thing.east_m);
        let tracks = self.tracks.iter_mut().flatten();
        let expecting = tracks.filter(|track| !track.is_seen && track.is_located());
        let nearest = expecting.map(|track| (off_m(track), track));
        if let Some((off_m, track)) = nearest.min_by(|a, b| a.0.total_cmp(&b.0))
            && off_m < GATE_M
        {
            track.correct(thing);
            return;
        }
        // What stands on a lost mover's lane is not that mover, which stays lost until the thing is seen to move.
        let on_a_lane = self
            .movers()
            .any(|lost| !lost.is_located() && lost.off_lane_m(thing.north_m, thing.east_m, 0.0) < LANE_GATE_M);
        if let Some(free) = self.tracks.iter_mut().find(|slot| slot.is_none()) {
            let track = if on_a_lane { Track::found } else { Track::new };
            *free = Some(track(thing));
        }
    }

    /// Enters what is seen of one side of a mover.
    fn enter_part(&mut self, outline: &Outline, at: impl Fn(f32, f32, f32) -> Thing + Copy) {
        for track in self.tracks.iter_mut().flatten() {
            if track.moves
                && track.is_located()
                && !track.is_seen
                && let Some(thing) = outline.part_of(track.radius_m, at)
                && libm::hypotf(track.north_m - thing.north_m, track.east_m - thing.east_m) < GATE_M
            {
                track.correct(&thing);
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
