//! Whole regions of a picture that were moved: found by the lines along which everything jumps, and moved back to where the ground says that
//! they were.
//!
//! Who moves a region moves what lies in it together: the differences of ranges within it stay as they were. Along its sides everything
//! jumps, and no edge of things runs straight through the whole picture. Ground is known by how its range changes from row to row, at
//! whatever range it is shown, and where it is by the vehicle's height and attitude: so a region that shows ground says itself by how much
//! it was moved, and one beside it by what goes on across their common side. Of a region that neither reaches nothing is known.

use super::picture::{CELLS, COLS, CellCounts, Directions, FAR_M, Picture, ROWS, SIDE, Sides};
use crate::smaller;
use vigil_types::{Attitude, DEPTH_COLS, DEPTH_FULL_SCALE_M, DepthFrame, NedVector};

/// Two cells jump if their sides are apart by more than their slopes make: metres, and a part of the range.
const JUMP_M: f32 = 0.2;
const JUMP_PART: f32 = 0.03;
/// A line is torn where two in five of its pairs of cells jump, of at least so many down a column and along a row.
const TORN_SHARE: f32 = 0.4;
const LEAST_DOWN: u16 = 6;
const LEAST_ALONG: u16 = 12;
/// So many torn lines along rows, and down columns, make a picture of moved regions: an unaltered one has none along rows but for one in
/// thousands. A line that was torn counts for two frames in which it was not; from so many on it is a region's side.
const LINES_ALONG: usize = 3;
const LINES_DOWN: usize = 6;
const TORN_COUNTS: u8 = 2;
const LINE_FRAMES: u8 = 8;
const MOST_FRAMES: u8 = 60;
/// More such lines are of regions of a single cell: what goes on across their sides says too little, and nothing is moved back.
const MOST_LINES_ALONG: usize = ROWS * 5 / 8;
const MOST_LINES_DOWN: usize = COLS * 5 / 8;
/// Such pictures, of the last ones, tell that regions are moved, for the rest of the flight.
const RAISE_FRAMES: u32 = 5;
const LAST_FRAMES: u32 = 6;
/// Rays that fall by less, a metre, say too little of the ground: 9°.
const LEAST_FALL: f32 = 0.15;
/// How the range may change from row to row, over what it does on the ground: a wall's changes the other way.
const GROUND_SLOPE: core::ops::Range<f32> = 0.6..1.4;
/// What cells of a region say of its move, or pairs of cells across a side, agrees within this, metres, and a part of the range.
const AGREE_M: f32 = 0.12;
const AGREE_PART: f32 = 0.01;
/// Values of a region or a side that are looked at.
const LOOKED_AT: usize = 16;
/// A region is moved back by a neighbour's move where such shares of the pairs across their common side agree, the surest first.
const SHARES: [f32; 2] = [0.95, 0.6];
/// Passes over the picture for each of them.
const PASSES: usize = 6;
/// No range is moved back nearer than this, metres; and where nothing is known of a region its columns are shown apart by so much, so that
/// it shows no surface.
const NEAREST_M: f32 = 0.3;
const APART_M: f32 = 4.0;

/// How much farther away the second of two neighbouring cells is shown than the first's slope and its own make it, metres: of each the side
/// before and the side behind. Not a number where one shows no surface.
#[inline]
fn step_m([before_a, behind_a]: [f32; 2], [before_b, behind_b]: [f32; 2]) -> f32 {
    before_b - behind_a - 0.5 * (behind_a - before_a + (behind_b - before_b)) / (SIDE - 1) as f32
}

/// Whether such a step is a jump, where the cells have these means.
#[inline]
fn is_jump(step_m: f32, mean_a: f32, mean_b: f32) -> bool {
    step_m.abs() > JUMP_M + JUMP_PART * smaller(mean_a, mean_b)
}

/// A value of several, and which share of them agrees with it.
fn agreed(values: &mut [f32], tolerance_m: f32, of: usize) -> Option<(f32, f32)> {
    values.sort_unstable_by(f32::total_cmp);
    let middle = *values.get(values.len() / 2)?;
    let agreeing = values.iter().filter(|value| (**value - middle).abs() < tolerance_m);
    Some((middle, agreeing.count() as f32 / of.max(1) as f32))
}

/// Finds moved regions and moves them back. A large value without pointers; no allocation.
#[derive(Debug, Clone)]
pub(super) struct Regions {
    /// Of the last frame's cells.
    pub(super) sides: Sides,
    /// Frames in which the line above a row of cells, and left of a column, was torn.
    above: [u8; ROWS],
    left_of: [u8; COLS],
    /// The last pictures, the newest lowest: set where regions were moved.
    last: u32,
    are_moved: bool,
    /// The last frame was looked at.
    is_current: bool,
    /// Regions of this flight are too small.
    too_small: bool,
    /// By how much the region of each cell is shown too far, metres; not a number where nothing is known.
    moved_m: [f32; CELLS],
    restored: DepthFrame,
}

impl Default for Regions {
    fn default() -> Self {
        Self {
            sides: Sides::default(),
            above: [0; ROWS],
            left_of: [0; COLS],
            last: 0,
            are_moved: false,
            is_current: false,
            too_small: false,
            moved_m: [f32::NAN; CELLS],
            restored: DepthFrame::EMPTY,
        }
    }
}

/// The cells of a region: rows and columns from the first up to the second.
#[derive(Debug, Clone, Copy)]
struct Region {
    rows: (usize, usize),
    columns: (usize, usize),
}

impl Regions {
    /// Takes a frame, whose sides are known, from so high above the ground, metres. Returns whether it is the first of a flight that is
    /// known to be of moved regions.
    pub(super) fn note(&mut self, frame: &DepthFrame, directions: &Directions, height_m: f32) -> bool {
        self.is_current = true;
        let is_torn = self.find_lines();
        self.last = (self.last << 1 | u32::from(is_torn)) & ((1 << LAST_FRAMES) - 1);
        let sides = |frames: &[u8]| frames.iter().filter(|frames| **frames >= LINE_FRAMES).count();
        self.too_small |= sides(&self.above) > MOST_LINES_ALONG || sides(&self.left_of) > MOST_LINES_DOWN;
        let begins = !self.are_moved && self.last.count_ones() >= RAISE_FRAMES;
        self.are_moved |= begins;
        if self.restored().is_some() {
            self.moved_m.fill(f32::NAN);
            self.measure_by_ground(directions, frame.header.attitude, height_m);
            self.measure_by_neighbours();
            self.restore(frame);
        }
        begins
    }

    /// The last frame is not looked at: too near the ground.
    pub(super) fn skip(&mut self) {
        self.is_current = false;
    }

    /// The flight is over.
    pub(super) fn forget(&mut self) {
        (self.above, self.left_of) = ([0; ROWS], [0; COLS]);
        (self.last, self.are_moved, self.too_small) = (0, false, false);
    }

    /// The last frame with its regions where they were; `None` where none are moved.
    pub(super) fn restored(&self) -> Option<&DepthFrame> {
        (self.are_moved && self.is_current && !self.too_small).then_some(&self.restored)
    }

    /// Takes that frame into a picture; returns what was counted there.
    pub(super) fn take_restored(&mut self, picture: &mut Picture) -> Option<CellCounts> {
        self.restored()?;
        Some(picture.take(&self.restored, &mut self.sides))
    }

    /// From a cell to the one below it, metres.
    fn step_down_m(&self, row: usize, column: usize) -> Option<f32> {
        let Sides { top_m, bottom_m, .. } = &self.sides;
        let sides = |row: usize| Some([*top_m.get(row)?.get(column)?, *bottom_m.get(row)?.get(column)?]);
        Some(step_m(sides(row)?, sides(row + 1)?))
    }

    /// From a cell to the one right of it, metres.
    fn step_right_m(&self, row: usize, column: usize) -> Option<f32> {
        let (left_m, right_m) = (self.sides.left_m.get(row)?, self.sides.right_m.get(row)?);
        let sides = |column: usize| Some([*left_m.get(column)?, *right_m.get(column)?]);
        Some(step_m(sides(column)?, sides(column + 1)?))
    }

    /// Counts the frames in which each line was torn; whether so many are in this one that it is of moved regions.
    fn find_lines(&mut self) -> bool {
        let sides = &self.sides;
        let (mut above, mut left_of) = ([(0_u16, 0_u16); ROWS], [(0_u16, 0_u16); COLS]);
        // A checked sum would keep the loops from being vectorised.
        let note = |count: &mut u16, is: bool| *count = count.wrapping_add(u16::from(is));
        let down = sides
            .mean_m
            .windows(2)
            .zip(sides.top_m.windows(2))
            .zip(sides.bottom_m.windows(2));
        for (counts, ((means, tops), bottoms)) in above.iter_mut().skip(1).zip(down) {
            let ([mean_a, mean_b], [top_a, top_b], [bottom_a, bottom_b]) = (means, tops, bottoms) else {
                continue;
            };
            let (mut all, mut jumps) = (0, 0);
            let pairs = mean_a
                .iter()
                .zip(mean_b)
                .zip(top_a.iter().zip(top_b))
                .zip(bottom_a.iter().zip(bottom_b));
            for (((mean_a, mean_b), (top_a, top_b)), (bottom_a, bottom_b)) in pairs {
                let step_m = step_m([*top_a, *bottom_a], [*top_b, *bottom_b]);
                note(&mut all, !step_m.is_nan());
                note(&mut jumps, is_jump(step_m, *mean_a, *mean_b));
            }
            *counts = (all, jumps);
        }
        for ((means, left), right) in sides.mean_m.iter().zip(&sides.left_m).zip(&sides.right_m) {
            let pairs = means.windows(2).zip(left.windows(2)).zip(right.windows(2));
            for ((all, jumps), ((means, left), right)) in left_of.iter_mut().skip(1).zip(pairs) {
                let ([mean_a, mean_b], [left_a, left_b], [right_a, right_b]) = (means, left, right) else {
                    continue;
                };
                let step_m = step_m([*left_a, *right_a], [*left_b, *right_b]);
                note(all, !step_m.is_nan());
                note(jumps, is_jump(step_m, *mean_a, *mean_b));
            }
        }
        let torn = |frames: &mut [u8], counts: &[(u16, u16)], least: u16| {
            let mut lines = 0;
            for (frames, (all, jumps)) in frames.iter_mut().zip(counts) {
                let is_torn = *all >= least && f32::from(*jumps) >= TORN_SHARE * f32::from(*all);
                lines += usize::from(is_torn);
                if is_torn {
                    *frames = (*frames + TORN_COUNTS).min(MOST_FRAMES);
                } else if *all >= least {
                    *frames = frames.saturating_sub(1);
                }
            }
            lines
        };
        let along = torn(&mut self.above, &above, LEAST_ALONG);
        let down = torn(&mut self.left_of, &left_of, LEAST_DOWN);
        along >= LINES_ALONG && down >= LINES_DOWN
    }

    /// The region that begins at a cell; `None` where none does.
    fn region_at(&self, row: usize, column: usize) -> Option<Region> {
        let begins = |frames: &[u8], i: usize| i == 0 || frames.get(i).is_some_and(|frames| *frames >= LINE_FRAMES);
        let end = |frames: &[u8], from: usize| {
            (from + 1..frames.len())
                .find(|i| begins(frames, *i))
                .unwrap_or(frames.len())
        };
        (begins(&self.above, row) && begins(&self.left_of, column)).then(|| Region {
            rows: (row, end(&self.above, row)),
            columns: (column, end(&self.left_of, column)),
        })
    }

    fn set(&mut self, region: Region, moved_m: f32) {
        for row in region.rows.0..region.rows.1 {
            let cells = self
                .moved_m
                .get_mut(row * COLS + region.columns.0..row * COLS + region.columns.1);
            cells.into_iter().flatten().for_each(|cell| *cell = moved_m);
        }
    }

    /// Regions that show ground: where it is, against where it is shown.
    fn measure_by_ground(&mut self, directions: &Directions, attitude: Attitude, height_m: f32) {
        let down = attitude.to_frd(NedVector::new(0.0, 0.0, 1.0));
        for (row, column) in (0..ROWS).flat_map(|row| (0..COLS).map(move |column| (row, column))) {
            let Some(region) = self.region_at(row, column) else {
                continue;
            };
            let (mut moves, mut count) = ([0.0; LOOKED_AT], 0);
            for (r, c) in (row..region.rows.1).flat_map(|r| (column..region.columns.1).map(move |c| (r, c))) {
                let falls = directions.falls(down, r, c);
                let of = |sides: &[[f32; COLS]; ROWS]| sides.get(r).and_then(|row| row.get(c)).copied();
                let sides = [&self.sides.mean_m, &self.sides.top_m, &self.sides.bottom_m].map(of);
                let ([Some(mean_m), Some(top_m), Some(bottom_m)], true) = (sides, falls >= LEAST_FALL) else {
                    continue;
                };
                let (up, low) = (r.saturating_sub(1), (r + 1).min(ROWS - 1));
                let falls_a_row = directions.falls(down, low, c) - directions.falls(down, up, c);
                let falls_a_pixel = falls_a_row / ((low - up) * SIDE) as f32;
                let range_m = height_m / falls;
                let slope_m = range_m * falls_a_pixel / falls * (SIDE - 1) as f32;
                if GROUND_SLOPE.contains(&((top_m - bottom_m) / slope_m))
                    && let Some(to) = moves.get_mut(count)
                {
                    *to = mean_m - range_m;
                    count += 1;
                }
            }
            let cells = ((region.rows.1 - row) * (region.columns.1 - column)).min(LOOKED_AT);
            let values = moves.get_mut(..count).unwrap_or_default();
            if let Some((moved_m, share)) = agreed(values, AGREE_M + JUMP_M, cells)
                && share >= 0.5
            {
                self.set(region, moved_m);
            }
        }
    }

    /// The others: by what goes on across the sides of those that are known, the surest sides first.
    fn measure_by_neighbours(&mut self) {
        for least_share in SHARES {
            for pass in 0..PASSES {
                let mut found = false;
                for i in 0..CELLS {
                    // Up from the ground and to the right; then back.
                    let i = if pass % 2 == 0 { CELLS - 1 - i } else { i };
                    let (row, column) = (i / COLS, i % COLS);
                    if self.moved_m.get(i).is_none_or(|moved_m| !moved_m.is_nan()) {
                        continue;
                    }
                    if let Some(region) = self.region_at(row, column)
                        && let Some(moved_m) = self.by_neighbours(region, least_share)
                    {
                        self.set(region, moved_m);
                        found = true;
                    }
                }
                if !found {
                    break;
                }
            }
        }
    }

    /// By how much a region was moved, by the surest of its neighbours.
    fn by_neighbours(&self, region: Region, least_share: f32) -> Option<f32> {
        let Region { rows, columns } = region;
        // What wraps is no line, as what follows the last one is none.
        let (above, left) = (rows.0.wrapping_sub(1), columns.0.wrapping_sub(1));
        let (below, right) = (rows.1, columns.1);
        let sides = [
            self.across(columns, |c| (above, c), |c| self.step_down_m(above, c), 1.0),
            self.across(columns, |c| (below, c), |c| self.step_down_m(below - 1, c), -1.0),
            self.across(rows, |r| (r, left), |r| self.step_right_m(r, left), 1.0),
            self.across(rows, |r| (r, right), |r| self.step_right_m(r, right - 1), -1.0),
        ];
        let sure = sides.into_iter().flatten().filter(|(_, share)| *share >= least_share);
        let surest = sure.reduce(|first, next| if next.1 > first.1 { next } else { first });
        surest.map(|(moved_m, _)| moved_m)
    }

    /// What the cells beyond a side say of the region before it: the neighbour's move and the steps across; and the share of them that agrees.
    fn across(
        &self,
        along: (usize, usize),
        beyond: impl Fn(usize) -> (usize, usize),
        step_m: impl Fn(usize) -> Option<f32>,
        sign: f32,
    ) -> Option<(f32, f32)> {
        let (mut values, mut count, mut range_m) = ([0.0; LOOKED_AT], 0, 0.0);
        for i in (along.0..along.1).take(LOOKED_AT) {
            let (row, column) = beyond(i);
            if row >= ROWS || column >= COLS {
                return None;
            }
            let moved_m = *self.moved_m.get(row * COLS + column)?;
            let mean_m = *self.sides.mean_m.get(row)?.get(column)?;
            let value = step_m(i).map_or(f32::NAN, |step_m| moved_m + sign * step_m);
            if let (false, Some(to)) = (value.is_nan(), values.get_mut(count)) {
                *to = value;
                range_m = mean_m;
                count += 1;
            }
        }
        let values = values.get_mut(..count).filter(|values| values.len() > 1)?;
        agreed(
            values,
            AGREE_M + AGREE_PART * range_m,
            (along.1 - along.0).min(LOOKED_AT),
        )
    }

    /// The frame with its regions where they were.
    fn restore(&mut self, frame: &DepthFrame) {
        self.restored.header = frame.header;
        let lines = self.restored.depth.as_chunks_mut::<DEPTH_COLS>().0.iter_mut();
        let taken = frame.depth.as_chunks::<DEPTH_COLS>().0;
        for (row, (line, taken)) in lines.zip(taken).enumerate() {
            let moves = self.moved_m.as_chunks::<COLS>().0.get(row / SIDE);
            let cells = line
                .as_chunks_mut::<SIDE>()
                .0
                .iter_mut()
                .zip(taken.as_chunks::<SIDE>().0);
            for ((to, from), moved_m) in cells.zip(moves.into_iter().flatten()) {
                let from_m = from.map(|range| range * DEPTH_FULL_SCALE_M);
                let unknown = moved_m.is_nan() || from_m.iter().any(|range_m| range_m - moved_m < NEAREST_M);
                let moved_m = if unknown { 0.0 } else { *moved_m };
                for (i, (to, range_m)) in to.iter_mut().zip(from_m).enumerate() {
                    let apart_m = if unknown && i % 2 == 1 { APART_M } else { 0.0 };
                    *to = if range_m >= FAR_M {
                        1.0
                    } else {
                        (range_m - moved_m + apart_m) * (1.0 / DEPTH_FULL_SCALE_M)
                    };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::larger;
    use std::boxed::Box;
    use vigil_types::{column_bearing_rad, row_elevation_rad};

    const HEIGHT_M: f32 = 1.5;

    /// Ground, a wall 9 m ahead, and posts before it at 4 and 6 m, with a noise of 2 cm.
    fn hall() -> Box<DepthFrame> {
        let mut frame = Box::new(DepthFrame::EMPTY);
        for (i, depth) in frame.depth.iter_mut().enumerate() {
            let (row, column) = (i / DEPTH_COLS, i % DEPTH_COLS);
            let (elevation, bearing) = (row_elevation_rad(row as f32), column_bearing_rad(column as f32));
            let (sin, cos) = libm::sincosf(elevation);
            let ahead_m = match column {
                61..=75 => 4.0,
                150..=158 => 6.0,
                _ => 9.0 / libm::cosf(bearing),
            };
            let ground_m = if sin < 0.0 { HEIGHT_M / -sin } else { f32::INFINITY };
            let noise_m = 0.02 * ((i * 7 % 13) as f32 / 6.0 - 1.0);
            *depth = (smaller(ahead_m / cos, ground_m) + noise_m) / DEPTH_FULL_SCALE_M;
        }
        frame
    }

    /// Moves squares of so many pixels, each by up to 3.9 m to and fro, another way in each frame.
    fn moved(frame: &DepthFrame, side: usize, number: usize) -> Box<DepthFrame> {
        let mut frame = Box::new(frame.clone());
        for (i, depth) in frame.depth.iter_mut().enumerate() {
            let (row, column) = (i / DEPTH_COLS / side, i % DEPTH_COLS / side);
            let steps = (((row * 31 + column * 17 + number * 5) * 2_654_435_761) >> 7) % 21;
            *depth = larger(*depth + (steps as f32 - 10.0) / 255.0, 0.005);
        }
        frame
    }

    fn note(regions: &mut Regions, frame: &DepthFrame) -> bool {
        let mut picture = Picture::default();
        picture.take(frame, &mut regions.sides);
        regions.note(frame, &Directions::default(), HEIGHT_M)
    }

    #[test]
    fn moved_regions_are_found_and_moved_back_and_what_was_not_moved_is_left_alone() {
        let hall = hall();
        for side in [8, 16] {
            let mut regions = Box::new(Regions::default());
            for _ in 0..20 {
                assert!(!note(&mut regions, &hall) && regions.restored().is_none());
            }
            let began = (0..12).filter(|i| note(&mut regions, &moved(&hall, side, *i)));
            assert_eq!(began.count(), 1);
            let restored = regions.restored().unwrap();
            let error_m = |i: usize| (restored.depth[i] - hall.depth[i]).abs() * DEPTH_FULL_SCALE_M;
            // What stands in the way, at the height of the vehicle.
            let level = 60 * DEPTH_COLS..68 * DEPTH_COLS;
            let right = level.clone().filter(|i| error_m(*i) < 0.3).count();
            assert!(right * 4 > level.len() * 3, "{side}: {right} of {}", level.len());
            regions.skip();
            assert!(regions.restored().is_none(), "of a frame that is not looked at");
            assert!(!note(&mut regions, &moved(&hall, side, 12)) && regions.restored().is_some());
            regions.forget();
            assert!(regions.restored().is_none());
        }
    }

    #[test]
    fn pixels_and_cells_moved_one_by_one_and_everything_shown_farther_away_are_not_moved_back() {
        let hall = hall();
        let mut receded = hall.clone();
        let above = 100 * DEPTH_COLS;
        receded.depth[..above].iter_mut().for_each(|depth| *depth += 0.078);
        let mut regions = Box::new(Regions::default());
        for i in 0..20 {
            assert!(!note(&mut regions, &receded));
            assert!(!note(&mut regions, &moved(&hall, 1, i)));
        }
        for i in 0..20 {
            note(&mut regions, &moved(&hall, 4, i));
        }
        assert!(regions.restored().is_none(), "too small to tell");
    }
}
