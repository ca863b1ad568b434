//! What the actor remembers: older scans moved to where the vehicle is now, surfaces that it no longer sees, and where it has been.
//!
//! Everything here is made of the encoder's scans and of odometry, without weights: no gradient goes through time, and a replay memory
//! keeps what the actor saw as it saw it. It is the actor's own: who alters frames must not reach the recovery pilot's map through it
//! (docs/architecture.md).

use crate::geometric::position_ned_m;
use crate::{PilotInput, smaller};
use alloc::vec;
use alloc::vec::Vec;
use core::f32::consts::{FRAC_PI_2, PI, TAU};
use core::mem::take;
use vigil_types::{HORIZONTAL_FOV_RAD, Nanos, NedVector};

const NANOS_PER_S: Nanos = 1_000_000_000;

/// Columns of the encoder's scan over the image's 120°, the leftmost first.
pub const SCAN: usize = 64;
/// How many frames ago the older scans were taken: 1.2, 0.6 and 0.3 s at 20 Hz.
pub const SCAN_AGES: [usize; 3] = [24, 12, 6];
/// Bearings of an older scan over ±90°, the leftmost first.
pub const MOVED: usize = 72;
/// Bearings of the remembered surfaces all around, the first ahead, then clockwise.
pub const RING: usize = 48;
/// Bearings of the own trail, the first ahead, then clockwise.
pub const TRAIL: usize = 16;
/// Values of the older scans.
pub const OLDER_SCANS: usize = SCAN_AGES.len() * MOVED;
/// Values of the memory: the older scans, oldest first; of the ring [`RING`] proximities, then [`RING`] freshnesses; the trail.
pub const CONTEXT: usize = OLDER_SCANS + 2 * RING + TRAIL;

/// The range whose proximity is a half, metres.
const HALF_M: f32 = 3.0;
/// Scans of the last 1.2 s, and the newest.
const HISTORY: usize = SCAN_AGES[0] + 1;
/// Neighbouring columns this near to each other are one surface, metres: the bearings between them are filled.
const SAME_SURFACE_M: f32 = 0.6;

/// Edge of a cell in which a surface is remembered, metres.
const CELL_M: f32 = 0.2;
/// Surfaces nearer than this are remembered, metres: farther away the scan is too coarse.
const REMEMBERED_M: f32 = 8.0;
/// Surfaces nearer than this are observed, metres.
const RING_M: f32 = 10.0;
/// A surface that was not seen for so long is forgotten.
const FORGOTTEN_NS: Nanos = 40 * NANOS_PER_S;
/// Time in which a surface's freshness falls to 1/e, seconds.
const FRESH_S: f32 = 10.0;
/// The ring is empty within this angle of the nose: there the scan says what is there.
const IN_VIEW_RAD: f32 = 56.0 * PI / 180.0;
/// A ray clears what lies nearer than its range by this, metres, and by this share of the range.
const CLEARED_M: f32 = 0.4;
const CLEARED_SHARE: f32 = 0.05;
/// Most cells remembered; the oldest places in the list are taken anew then.
const CELLS: usize = 2048;
/// Cells along an edge of the index, a power of two: 25.6 m.
const INDEX: usize = 128;

/// A place of the trail for each of these, metres or nanoseconds.
const TRAIL_STEP_M: f32 = 0.5;
const TRAIL_STEP_NS: Nanos = 2 * NANOS_PER_S;
/// Most places; when there are more, every second one goes: the trail reaches back to the flight's begin.
const TRAIL_PLACES: usize = 80;
/// Places nearer than this are where the vehicle is, metres.
const HERE_M: f32 = 0.7;
/// Distance over which a place of the trail counts 1/e, metres.
const TRAIL_M: f32 = 4.0;

/// The vehicle cannot have moved faster between two frames, metres per second: its odometry jumped, and what was remembered lies
/// somewhere else.
const FASTEST_M_S: f32 = 20.0;
const JUMP_M: f32 = 1.0;
/// A vehicle of which no frame counts for longer than this, seconds, is held: it goes on no faster than the fastest cruise.
const HELD_AFTER_S: f32 = 0.1;
const HELD_M_S: f32 = 3.0;

/// Where the vehicle believes to be when a scan counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Odometry {
    /// When.
    pub at_ns: Nanos,
    /// From home, metres.
    pub position_ned_m: NedVector,
    /// Clockwise from north, radians.
    pub yaw_rad: f32,
}

impl Odometry {
    /// Of a pilot's input.
    pub fn of(input: &PilotInput<'_>) -> Self {
        Self {
            at_ns: input.now_ns,
            position_ned_m: position_ned_m(input),
            yaw_rad: input.attitude.yaw_rad(),
        }
    }
}

/// A cell in which a surface was seen.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    north: i32,
    east: i32,
    seen_ns: Nanos,
}

/// The memory of one flight. Allocates when it is made; observing does not.
#[derive(Debug, Clone)]
pub struct ActorMemory {
    /// Cosine and sine of each column's bearing.
    columns: [(f32, f32); SCAN],
    /// The last scans as points from home (north, east; metres), and whether there is one; a ring.
    history: Vec<[Option<(f32, f32)>; SCAN]>,
    /// Slot of the newest scan.
    newest: usize,
    last: Option<Odometry>,
    /// Heading of the step before.
    pub(super) yaw_before: Option<(Nanos, f32)>,
    cells: Vec<Cell>,
    /// Cell number + 1 by place, 0 for none.
    index: Vec<u16>,
    /// Next cell to be taken anew when all are used.
    next_overwritten: usize,
    trail: Vec<(f32, f32)>,
    trail_since_ns: Nanos,
    forgotten: u32,
    context: [f32; CONTEXT],
}

/// `1 / (1 + range / 3 m)`: how near a surface is, 1 where it touches, 0 far away.
pub fn proximity(range_m: f32) -> f32 {
    1.0 / (1.0 + range_m / HALF_M)
}

/// The range of a proximity, metres.
pub fn range_m(proximity: f32) -> f32 {
    HALF_M * (1.0 / proximity.max(1e-3) - 1.0)
}

/// Bearing of a scan's column, radians, clockwise from the nose.
pub fn scan_bearing_rad(column: usize) -> f32 {
    (column as f32 + 0.5) * (HORIZONTAL_FOV_RAD / SCAN as f32) - 0.5 * HORIZONTAL_FOV_RAD
}

/// `atan2(right, forward)` to 0.0004 rad, in plain arithmetic: a bin is 0.04 rad or wider.
fn bearing_rad(forward: f32, right: f32) -> f32 {
    let (x, y) = (forward.abs(), right.abs());
    let (low, high) = if x < y { (x, y) } else { (y, x) };
    let a = low / high.max(1e-9);
    let s = a * a;
    let mut angle = ((-0.046_496_475 * s + 0.159_314_22) * s - 0.327_622_76) * s * a + a;
    if y > x {
        angle = FRAC_PI_2 - angle;
    }
    if forward < 0.0 {
        angle = PI - angle;
    }
    if right < 0.0 { -angle } else { angle }
}

/// Bin of a bearing among `bins` all around, the first centred on the nose.
fn around(bearing_rad: f32, bins: usize) -> usize {
    let turns = bearing_rad / TAU;
    let at = libm::roundf(turns * bins as f32) as i32;
    at.rem_euclid(bins as i32) as usize
}

/// The heading's axes.
#[derive(Clone, Copy)]
struct Heading {
    north_m: f32,
    east_m: f32,
    cos: f32,
    sin: f32,
}

impl Heading {
    fn of(at: &Odometry) -> Self {
        Self {
            north_m: at.position_ned_m.x,
            east_m: at.position_ned_m.y,
            cos: libm::cosf(at.yaw_rad),
            sin: libm::sinf(at.yaw_rad),
        }
    }

    /// Forward and right of a place, metres.
    fn seen(&self, (north_m, east_m): (f32, f32)) -> (f32, f32) {
        let (north, east) = (north_m - self.north_m, east_m - self.east_m);
        (self.cos * north + self.sin * east, self.cos * east - self.sin * north)
    }

    /// The place of what is forward and right.
    fn place(&self, forward_m: f32, right_m: f32) -> (f32, f32) {
        (
            self.north_m + self.cos * forward_m - self.sin * right_m,
            self.east_m + self.sin * forward_m + self.cos * right_m,
        )
    }
}

impl Default for ActorMemory {
    /// One that has seen nothing.
    fn default() -> Self {
        let columns = core::array::from_fn(|k| {
            let bearing_rad = scan_bearing_rad(k);
            (libm::cosf(bearing_rad), libm::sinf(bearing_rad))
        });
        Self {
            columns,
            history: vec![[None; SCAN]; HISTORY],
            newest: 0,
            last: None,
            yaw_before: None,
            cells: Vec::with_capacity(CELLS),
            index: vec![0; INDEX * INDEX],
            next_overwritten: 0,
            trail: Vec::with_capacity(TRAIL_PLACES + 1),
            trail_since_ns: 0,
            forgotten: 0,
            context: [0.0; CONTEXT],
        }
    }
}

impl ActorMemory {
    /// Forgets everything but the heading.
    pub fn reset(&mut self) {
        self.last = None;
        self.cells.clear();
        self.index.fill(0);
        self.trail.clear();
        self.context = [0.0; CONTEXT];
    }

    /// Takes over what another remembers, without allocating.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.history.clone_from(&other.history);
        self.cells.clone_from(&other.cells);
        self.index.clone_from(&other.index);
        self.trail.clone_from(&other.trail);
        *self = Self {
            history: take(&mut self.history),
            cells: take(&mut self.cells),
            index: take(&mut self.index),
            trail: take(&mut self.trail),
            ..*other
        };
    }

    /// The memory's values ([`CONTEXT`]), as of the last scan.
    pub fn context(&self) -> &[f32; CONTEXT] {
        &self.context
    }

    /// How often everything was forgotten because the odometry jumped.
    pub fn forgotten(&self) -> u32 {
        self.forgotten
    }

    /// Takes a new scan: [`SCAN`] proximities, the leftmost first. Of one that holds no numbers nothing is remembered.
    pub(super) fn remember(&mut self, scan: &[f32; SCAN], at: Odometry) {
        if !scan.iter().all(|proximity| proximity.is_finite()) {
            return;
        }
        if let Some(last) = self.last {
            let moved_m = (at.position_ned_m - last.position_ned_m).horizontal_norm();
            let waited_s = at.at_ns.saturating_sub(last.at_ns) as f32 * 1e-9;
            let fastest_m = FASTEST_M_S * waited_s.min(HELD_AFTER_S) + HELD_M_S * (waited_s - HELD_AFTER_S).max(0.0);
            // A position that is not a number is a jump too.
            let goes_on = moved_m <= JUMP_M + fastest_m && at.at_ns >= last.at_ns;
            if !goes_on {
                self.reset();
                self.forgotten = self.forgotten.saturating_add(1);
            }
        }
        let heading = Heading::of(&at);
        let mut ranges_m = [0.0; SCAN];
        for (range, proximity) in ranges_m.iter_mut().zip(scan) {
            *range = range_m(*proximity);
        }
        self.keep(&ranges_m, &heading);
        self.clear_and_tell(&ranges_m, &heading, at.at_ns);
        self.mark(&ranges_m, &heading, at.at_ns);
        self.tell_older(&heading);
        self.follow(&heading, at.at_ns);
        self.last = Some(at);
    }

    /// Keeps the newest scan's points; the first stands for the missing older ones as well.
    fn keep(&mut self, ranges_m: &[f32; SCAN], heading: &Heading) {
        self.newest = (self.newest + 1) % HISTORY;
        let mut points = [None; SCAN];
        for ((point, range_m), (cos, sin)) in points.iter_mut().zip(ranges_m).zip(&self.columns) {
            *point = (*range_m < RING_M).then(|| heading.place(range_m * cos, range_m * sin));
        }
        if self.last.is_none() {
            self.history.fill(points);
        } else if let Some(slot) = self.history.get_mut(self.newest) {
            *slot = points;
        }
    }

    /// Forgets cells that are old or that the newest scan sees through, and writes the ring of those out of view.
    fn clear_and_tell(&mut self, ranges_m: &[f32; SCAN], heading: &Heading, now_ns: Nanos) {
        let mut nearest_m = [f32::INFINITY; RING];
        let mut seen_ns = [0; RING];
        let mut at = 0;
        while let Some(cell) = self.cells.get(at).copied() {
            let place = (cell.north as f32 * CELL_M, cell.east as f32 * CELL_M);
            let (forward, right) = heading.seen(place);
            let away_m = libm::sqrtf(forward * forward + right * right);
            let bearing = bearing_rad(forward, right);
            let old = now_ns.saturating_sub(cell.seen_ns) > FORGOTTEN_NS;
            if old || (bearing.abs() < 0.5 * HORIZONTAL_FOV_RAD && seen_through(ranges_m, bearing, away_m)) {
                self.remove(at);
                continue;
            }
            if bearing.abs() > IN_VIEW_RAD && away_m < RING_M {
                let bin = around(bearing, RING);
                if let (Some(nearest_m), Some(seen_ns)) = (nearest_m.get_mut(bin), seen_ns.get_mut(bin))
                    && away_m < *nearest_m
                {
                    (*nearest_m, *seen_ns) = (away_m, cell.seen_ns);
                }
            }
            at += 1;
        }
        let (_, observed) = self.context.split_at_mut(OLDER_SCANS);
        let (near, rest) = observed.split_at_mut(RING);
        let slots = near.iter_mut().zip(rest.iter_mut());
        for ((near, fresh), (range_m, seen_ns)) in slots.zip(nearest_m.into_iter().zip(seen_ns)) {
            if range_m.is_finite() {
                *near = proximity(range_m);
                let age_s = now_ns.saturating_sub(seen_ns) as f32 * 1e-9;
                *fresh = libm::expf(-age_s / FRESH_S);
            } else {
                (*near, *fresh) = (0.0, 0.0);
            }
        }
    }

    /// Remembers what the newest scan shows near by.
    fn mark(&mut self, ranges_m: &[f32; SCAN], heading: &Heading, now_ns: Nanos) {
        for (range_m, (cos, sin)) in ranges_m.iter().zip(self.columns) {
            if *range_m >= REMEMBERED_M {
                continue;
            }
            let (north_m, east_m) = heading.place(range_m * cos, range_m * sin);
            let cell = Cell {
                north: libm::roundf(north_m / CELL_M) as i32,
                east: libm::roundf(east_m / CELL_M) as i32,
                seen_ns: now_ns,
            };
            self.put(cell);
        }
    }

    fn slot_of(cell: &Cell) -> usize {
        let wrap = |number: i32| (number & (INDEX as i32 - 1)) as usize;
        wrap(cell.north) * INDEX + wrap(cell.east)
    }

    fn put(&mut self, cell: Cell) {
        let slot = Self::slot_of(&cell);
        let number = self.index.get(slot).map_or(0, |number| usize::from(*number));
        if let Some(known) = number.checked_sub(1).and_then(|number| self.cells.get_mut(number)) {
            // The same place, or one 25.6 m from it, which this one takes the place of.
            *known = cell;
            return;
        }
        if self.cells.len() < CELLS {
            self.cells.push(cell);
            self.point_to(slot, self.cells.len());
            return;
        }
        let number = self.next_overwritten;
        self.next_overwritten = (number + 1) % CELLS;
        if let Some(oldest) = self.cells.get_mut(number) {
            let old_slot = Self::slot_of(oldest);
            *oldest = cell;
            self.point_to(old_slot, 0);
            self.point_to(slot, number + 1);
        }
    }

    fn point_to(&mut self, slot: usize, number: usize) {
        if let Some(index) = self.index.get_mut(slot) {
            // At most `CELLS`, 2 048.
            *index = number as u16;
        }
    }

    fn remove(&mut self, number: usize) {
        let removed = self.cells.swap_remove(number);
        self.point_to(Self::slot_of(&removed), 0);
        if let Some(moved) = self.cells.get(number).copied() {
            self.point_to(Self::slot_of(&moved), number + 1);
        }
    }

    /// Writes the older scans as they would be seen from here.
    fn tell_older(&mut self, heading: &Heading) {
        const WIDTH_RAD: f32 = PI / MOVED as f32;
        for (observed, age) in self.context.chunks_exact_mut(MOVED).zip(SCAN_AGES) {
            observed.fill(0.0);
            let Some(points) = self.history.get((self.newest + HISTORY - age) % HISTORY) else {
                continue;
            };
            let mut before: Option<(f32, f32, i32)> = None;
            for point in points {
                let Some(place) = *point else {
                    before = None;
                    continue;
                };
                let (forward, right) = heading.seen(place);
                let range_m = libm::sqrtf(forward * forward + right * right);
                let bin = libm::floorf((bearing_rad(forward, right) + FRAC_PI_2) / WIDTH_RAD) as i32;
                // Straight behind, where bearings wrap, a surface seen from its other side fills all between: the frozen actor learned with it.
                let (first, farther_m) = match before {
                    Some((forward_before, right_before, bin_before))
                        if (forward - forward_before).abs() + (right - right_before).abs() < SAME_SURFACE_M
                            && bin_before < bin =>
                    {
                        let before_m = libm::sqrtf(forward_before * forward_before + right_before * right_before);
                        (bin_before + 1, if before_m < range_m { range_m } else { before_m })
                    }
                    _ => (bin, range_m),
                };
                for between in first..bin {
                    raise(observed, between, proximity(farther_m));
                }
                raise(observed, bin, proximity(range_m));
                before = Some((forward, right, bin));
            }
        }
    }

    /// Notes where the vehicle is, and writes the trail.
    fn follow(&mut self, heading: &Heading, now_ns: Nanos) {
        let here = (heading.north_m, heading.east_m);
        let due = self.trail.last().is_none_or(|(north_m, east_m)| {
            libm::hypotf(north_m - here.0, east_m - here.1) > TRAIL_STEP_M
                || now_ns.saturating_sub(self.trail_since_ns) > TRAIL_STEP_NS
        });
        if due {
            self.trail.push(here);
            self.trail_since_ns = now_ns;
            if self.trail.len() > TRAIL_PLACES {
                let mut number = 0;
                self.trail.retain(|_| {
                    number += 1;
                    number % 2 == 1
                });
            }
        }
        let mut visits = [0.0; TRAIL];
        for place in &self.trail {
            let (forward, right) = heading.seen(*place);
            let away_m = libm::sqrtf(forward * forward + right * right);
            if away_m > HERE_M
                && let Some(visits) = visits.get_mut(around(bearing_rad(forward, right), TRAIL))
            {
                *visits += libm::expf(-away_m / TRAIL_M);
            }
        }
        let (_, observed) = self.context.split_at_mut(CONTEXT - TRAIL);
        for (observed, visits) in observed.iter_mut().zip(visits) {
            *observed = visits / (1.0 + visits);
        }
    }
}

/// Whether the scan's rays pass where a cell is.
fn seen_through(ranges_m: &[f32; SCAN], bearing_rad: f32, away_m: f32) -> bool {
    let column = (bearing_rad + 0.5 * HORIZONTAL_FOV_RAD) / (HORIZONTAL_FOV_RAD / SCAN as f32);
    let column = libm::floorf(column) as usize;
    let about = ranges_m.iter().skip(column.saturating_sub(1)).take(3);
    let least_m = about.fold(f32::INFINITY, |least_m, range_m| smaller(least_m, *range_m));
    away_m < least_m * (1.0 - CLEARED_SHARE) - CLEARED_M
}

/// Raises a bin to a proximity; nothing for a bin out of view.
fn raise(observed: &mut [f32], bin: i32, near: f32) {
    if let Some(observed) = usize::try_from(bin).ok().and_then(|bin| observed.get_mut(bin))
        && *observed < near
    {
        *observed = near;
    }
}

#[cfg(test)]
mod tests;
