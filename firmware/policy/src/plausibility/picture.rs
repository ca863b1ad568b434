//! A depth frame reduced to cells of 4 × 4 pixels: what two frames are compared by.

use super::{PART, PART_COLS};
use crate::{larger, smaller};
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame, FrdVector, HORIZONTAL_FOV_RAD, PIXEL_PITCH_RAD,
    VERTICAL_FOV_RAD, column_bearing_rad, row_elevation_rad,
};

/// Pixels along a cell's side.
pub(super) const SIDE: usize = 4;
/// Rows of cells.
pub(super) const ROWS: usize = DEPTH_ROWS / SIDE;
/// Columns of cells.
pub(super) const COLS: usize = DEPTH_COLS / SIDE;
/// Cells of a picture.
pub(super) const CELLS: usize = ROWS * COLS;
/// Angle between neighbouring cells' centres.
const PITCH_RAD: f32 = SIDE as f32 * PIXEL_PITCH_RAD;

/// The pixels of a cell see one surface if their ranges differ by no more than this: a part of the range, which a plane at
/// a grazing angle makes, and metres, which noise makes.
pub(super) const SMOOTH_PART: f32 = 0.2;
pub(super) const SMOOTH_M: f32 = 0.16;
/// Ranges of a cell that lie farther apart, with a return in each pixel, are of an edge, or of no picture at all. What an adversary
/// adds, within 20 / 255 of the image's range, is less.
const WILD_M: f32 = 40.0;
/// Pixels of a cell, of 16, that are zero in a cell with holes.
const HOLES: f32 = 4.5;
/// What lies between four cells is interpolated if the farthest of them is no more than this times as far as the nearest.
const BETWEEN_RATIO: f32 = 1.3;

/// What a cell shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Seen {
    /// One surface at this range, metres.
    Surface(f32),
    /// No return.
    Nothing,
    /// An edge, or returns and none: not to be compared.
    Mixed,
}

/// Directions of the cells' centres.
#[derive(Debug, Clone)]
pub(super) struct Directions {
    /// Cosine and sine of the rows' elevations.
    rows: [(f32, f32); ROWS],
    /// Cosine and sine of the columns' bearings.
    columns: [(f32, f32); COLS],
}

impl Directions {
    pub(super) fn new() -> Self {
        let middle = |cell: usize| (cell * SIDE) as f32 + 0.5 * (SIDE as f32 - 1.0);
        let both = |angle: f32| (libm::cosf(angle), libm::sinf(angle));
        Self {
            rows: core::array::from_fn(|r| both(row_elevation_rad(middle(r)))),
            columns: core::array::from_fn(|c| both(column_bearing_rad(middle(c)))),
        }
    }

    /// Cosine and sine of the bearing of a column of cells.
    #[inline]
    pub(super) fn column(&self, column: usize) -> (f32, f32) {
        self.columns.get(column).copied().unwrap_or((1.0, 0.0))
    }

    /// Unit vector of a cell in body axes.
    #[inline]
    pub(super) fn of(&self, row: usize, column: usize) -> FrdVector {
        let (cos_row, sin_row) = self.rows.get(row).copied().unwrap_or((1.0, 0.0));
        let (cos_column, sin_column) = self.column(column);
        FrdVector::new(cos_row * cos_column, cos_row * sin_column, -sin_row)
    }

    /// How much a cell's ray falls a metre, where down is this unit vector in body axes.
    #[inline]
    pub(super) fn falls(&self, down: FrdVector, row: usize, column: usize) -> f32 {
        let ray = self.of(row, column);
        down.x * ray.x + down.y * ray.y + down.z * ray.z
    }
}

/// The column straight ahead, between two.
pub(super) const MIDDLE_COLUMN: f32 = 0.5 * (COLS - 1) as f32;

/// How far to the right of straight ahead the middle of a column of cells is.
#[inline]
pub(super) fn bearing_rad(column: usize) -> f32 {
    (column as f32 - MIDDLE_COLUMN) * PITCH_RAD
}

/// Row and column, fractional, of the cell in which a point is seen; `None` outside the view of the cells' centres.
#[inline]
pub(super) fn place_of(point: FrdVector) -> Option<(f32, f32)> {
    let level = libm::sqrtf(point.x * point.x + point.y * point.y);
    if point.x <= 0.4 * level || level <= 1e-3 {
        return None;
    }
    let bearing = arc_tangent(point.y / point.x);
    let elevation = arc_tangent(-point.z / level);
    let column = (bearing + 0.5 * HORIZONTAL_FOV_RAD) * (1.0 / PITCH_RAD) - 0.5;
    let row = (0.5 * VERTICAL_FOV_RAD - elevation) * (1.0 / PITCH_RAD) - 0.5;
    let inside = column >= 0.0 && row >= 0.0 && column <= (COLS - 1) as f32 && row <= (ROWS - 1) as f32;
    inside.then_some((row, column))
}

/// Arc tangent to 1e-5 (Abramowitz and Stegun 4.4.49): a tenth of what `libm`'s costs.
#[inline]
fn arc_tangent(t: f32) -> f32 {
    let steep = t.abs() > 1.0;
    let x = if steep { 1.0 / t } else { t };
    let s = x * x;
    let a = x * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    if steep {
        core::f32::consts::FRAC_PI_2.copysign(t) - a
    } else {
        a
    }
}

/// How many cells of a frame show what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct CellCounts {
    /// Nothing but zeros, which are no ranges.
    pub zeros: usize,
    /// Zeros in more than a quarter of its pixels.
    pub holes: usize,
    /// Ranges of anywhere.
    pub wild: usize,
    /// With a return in some pixel, and of these those of one surface.
    pub seen: usize,
    pub smooth: usize,
    /// Parts of 4 × 4 cells that are torn: ranges go to and fro in nearly all of their cells.
    pub torn: usize,
}

/// Ranges go to and fro in a cell if rows of its pixels change by so much more than their ends differ: a part of the range, and metres.
/// Along any plane and across any edge they go one way; noise of 6 cm makes 0.14 m.
const RAGGED_PART: f32 = 0.1;
const RAGGED_M: f32 = 0.25;
/// Ragged cells, of 16, of a torn part, which any patch of 32 × 32 covers: no unaltered frame has more than 8 (docs/robustness.md).
const TORN_CELLS: u8 = 13;

/// Cells in which something is seen, of 2048, before their roughness says anything.
const LEAST_SEEN: usize = 100;

impl CellCounts {
    /// Of the cells in which something is seen, the share that shows one surface, 0 where a part of the picture is torn; `None` where next
    /// to nothing is seen.
    pub(super) fn smooth_share(&self) -> Option<f32> {
        let smooth = if self.torn > 0 { 0 } else { self.smooth };
        (self.seen >= LEAST_SEEN).then(|| smooth as f32 / self.seen as f32)
    }
}

/// Cells of a band in which ranges go to and fro, by parts.
fn ragged_cells(band: &[f32; SIDE * DEPTH_COLS]) -> [u8; PART_COLS] {
    let (mut limits, mut more) = ([0.0_f32; COLS], [0.0_f32; COLS]);
    // Every second row is a ring of the LiDAR, those between lie between.
    for row in band.as_chunks::<DEPTH_COLS>().0.iter().step_by(2) {
        for ((limit, more), [a, b, c, d]) in limits.iter_mut().zip(&mut more).zip(row.as_chunks::<SIDE>().0) {
            *limit += RAGGED_PART / SIDE as f32 * (a + b + c + d) + RAGGED_M / DEPTH_FULL_SCALE_M;
            *more += (a - b).abs() + (b - c).abs() + (c - d).abs() - (a - d).abs();
        }
    }
    let cells = limits.as_chunks::<PART>().0.iter().zip(more.as_chunks::<PART>().0);
    let mut parts = [0; PART_COLS];
    for (part, (limits, more)) in parts.iter_mut().zip(cells) {
        *part = more
            .iter()
            .zip(limits)
            .map(|(more, limit)| u8::from(more > limit))
            .sum();
    }
    parts
}

/// A reduced frame.
#[derive(Debug, Clone)]
pub(super) struct Picture {
    /// Reciprocal of the range in 1/m, which changes linearly along any plane; 0 without a return, negative if mixed.
    inverse: [f32; CELLS],
}

impl Picture {
    pub(super) const EMPTY: Self = Self { inverse: [-1.0; CELLS] };

    /// Takes a frame; counts what is counts.
    pub(super) fn take(&mut self, frame: &DepthFrame) -> CellCounts {
        let mut counts = CellCounts::default();
        let bands = frame.depth.as_chunks::<{ SIDE * DEPTH_COLS }>().0;
        for bands in bands.as_chunks::<PART>().0 {
            let mut ragged = [0; PART_COLS];
            for cells in bands.iter().map(ragged_cells) {
                ragged.iter_mut().zip(cells).for_each(|(sum, cells)| *sum += cells);
            }
            counts.torn += ragged.iter().filter(|cells| **cells >= TORN_CELLS).count();
        }
        for (band, cells) in bands.iter().zip(self.inverse.as_chunks_mut::<COLS>().0) {
            let (mut sum, mut low, mut high) = ([0.0_f32; DEPTH_COLS], [1.0_f32; DEPTH_COLS], [0.0_f32; DEPTH_COLS]);
            let mut zero = [0.0_f32; DEPTH_COLS];
            for row in band.as_chunks::<DEPTH_COLS>().0 {
                let limits = low.iter_mut().zip(&mut high).zip(&mut zero);
                for ((sum, ((low, high), zero)), v) in sum.iter_mut().zip(limits).zip(row) {
                    *sum += v;
                    *low = smaller(*low, *v);
                    *high = larger(*high, *v);
                    *zero += if *v <= 0.0 { 1.0 } else { 0.0 };
                }
            }
            let holed = |zero: &[f32; SIDE]| zero.iter().sum::<f32>() > HOLES;
            counts.holes += zero.as_chunks::<SIDE>().0.iter().filter(|zero| holed(zero)).count();
            let sides = sum.as_chunks::<SIDE>().0.iter();
            let limits = low.as_chunks::<SIDE>().0.iter().zip(high.as_chunks::<SIDE>().0);
            for ((cell, sum), (low, high)) in cells.iter_mut().zip(sides).zip(limits) {
                let mean_m = sum.iter().sum::<f32>() * (DEPTH_FULL_SCALE_M / (SIDE * SIDE) as f32);
                let low = low.iter().fold(1.0, |a, b| smaller(a, *b));
                let high = high.iter().fold(0.0, |a, b| larger(a, *b));
                let spread_m = (high - low) * DEPTH_FULL_SCALE_M;
                let smooth = low > 0.0 && high < 1.0 && spread_m <= SMOOTH_PART * mean_m + SMOOTH_M;
                counts.seen += usize::from(low < 1.0);
                counts.smooth += usize::from(smooth);
                counts.zeros += usize::from(high <= 0.0);
                counts.wild += usize::from(high < 1.0 && spread_m > WILD_M);
                *cell = if low >= 1.0 {
                    0.0
                } else if smooth {
                    1.0 / mean_m
                } else {
                    -1.0
                };
            }
        }
        counts
    }

    /// Reciprocal ranges row by row, as they are kept: 0 without a return, negative if mixed.
    pub(super) fn rows(&self) -> &[[f32; COLS]] {
        self.inverse.as_chunks::<COLS>().0
    }

    /// The reciprocal range as it is kept.
    #[inline]
    pub(super) fn inverse(&self, cell: usize) -> f32 {
        self.inverse.get(cell).copied().unwrap_or(-1.0)
    }

    /// Whether a cell shows a surface no farther than this, metres.
    #[inline]
    pub(super) fn is_near(&self, cell: usize, limit_m: f32) -> bool {
        matches!(self.at(cell), Seen::Surface(range_m) if range_m <= limit_m)
    }

    /// What a cell shows.
    #[inline]
    pub(super) fn at(&self, cell: usize) -> Seen {
        seen(self.inverse(cell))
    }

    /// What is seen between cells.
    #[inline]
    pub(super) fn between(&self, row: f32, column: f32) -> Seen {
        // Within the picture: `place_of` gives no other places. `as` truncates, which is down for what is not negative.
        let (r, c) = ((row as usize).min(ROWS - 2), (column as usize).min(COLS - 2));
        let (down, right) = (row - r as f32, column - c as f32);
        let first = r * COLS + c;
        let (a, b) = (self.inverse(first), self.inverse(first + 1));
        let (d, e) = (self.inverse(first + COLS), self.inverse(first + COLS + 1));
        let low = smaller(smaller(a, b), smaller(d, e));
        let high = larger(larger(a, b), larger(d, e));
        if low > 0.0 && high <= BETWEEN_RATIO * low {
            let above = a + (b - a) * right;
            let below = d + (e - d) * right;
            Seen::Surface(1.0 / (above + (below - above) * down))
        } else if low == 0.0 && high == 0.0 {
            Seen::Nothing
        } else {
            Seen::Mixed
        }
    }
}

#[inline]
fn seen(inverse: f32) -> Seen {
    if inverse > 0.0 {
        Seen::Surface(1.0 / inverse)
    } else if inverse == 0.0 {
        Seen::Nothing
    } else {
        Seen::Mixed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arc_tangent_is_right_to_a_hundredth_of_a_pixel() {
        for i in -300..=300 {
            let t = i as f32 * 0.01;
            assert!((arc_tangent(t) - libm::atanf(t)).abs() < 2e-5, "{t}");
        }
    }

    #[test]
    fn a_cell_s_middle_is_seen_in_the_cell() {
        let directions = Directions::new();
        for row in 0..ROWS {
            for column in 0..COLS {
                // The outermost may come out a hair outside.
                if let Some((r, c)) = place_of(directions.of(row, column) * 4.0) {
                    assert!(
                        (r - row as f32).abs() < 1e-2 && (c - column as f32).abs() < 1e-2,
                        "{row} {column}"
                    );
                }
            }
        }
        assert_eq!(place_of(FrdVector::new(-1.0, 0.0, 0.0)), None);
        assert_eq!(place_of(FrdVector::ZERO), None);
    }

    #[test]
    fn edges_and_holes_are_not_taken_for_surfaces() {
        let mut frame = DepthFrame::EMPTY;
        for (i, depth) in frame.depth.iter_mut().enumerate() {
            *depth = if i % DEPTH_COLS < 126 { 0.03 } else { 0.06 };
        }
        frame.depth[0] = 0.0;
        frame.depth[8] = 1.0;
        // Nothing but zeros: four rows of four pixels.
        for row in 0..SIDE {
            frame.depth[row * DEPTH_COLS + 16..][..SIDE].fill(0.0);
        }
        let mut picture = Picture::EMPTY;
        // An edge before something far away.
        frame.depth[24] = 0.6;
        let counts = picture.take(&frame);
        assert_eq!(counts.zeros, 1, "a single zero is noise, a cell of them is none");
        assert_eq!(counts.wild, 1, "and a hole is not far away");
        assert_eq!(picture.at(0), Seen::Mixed, "a zero");
        assert_eq!(picture.at(2), Seen::Mixed, "a hole");
        assert_eq!(picture.at(31), Seen::Mixed, "an edge");
        for (cell, range_m) in [(5, 3.0), (40, 6.0)] {
            assert!(matches!(picture.at(cell), Seen::Surface(m) if (m - range_m).abs() < 1e-4));
        }
        assert!(matches!(picture.between(3.4, 10.7), Seen::Surface(m) if (m - 3.0).abs() < 1e-4));
        assert_eq!(picture.between(3.4, 30.5), Seen::Mixed);
        assert_eq!(picture.take(&DepthFrame::EMPTY), CellCounts::default());
        assert_eq!(picture.between(3.4, 30.5), Seen::Nothing);
    }

    #[test]
    fn a_patch_tears_the_picture_wherever_it_lies_and_posts_a_steep_wall_and_scattered_holes_do_not() {
        let mut frame = DepthFrame::EMPTY;
        for (i, depth) in frame.depth.iter_mut().enumerate() {
            let (row, column) = (i / DEPTH_COLS, i % DEPTH_COLS);
            *depth = match column {
                // Posts of two pixels before a wall at 12 m; a wall along the way, out to 50 m.
                0..128 if column % 16 < 2 => 0.02,
                0..128 => 0.12,
                _ => 0.02 * 1.02_f32.powi(column as i32 - 128).min(25.0),
            };
            if (row * 7 + column * 5) % 24 == 0 {
                *depth = 1.0;
            }
        }
        let mut picture = Picture::EMPTY;
        assert_eq!(picture.take(&frame).torn, 0);
        for (top, left) in [(0, 0), (37, 91), (96, 224)] {
            let mut patched = frame.clone();
            for row in top..top + 32 {
                for column in left..left + 32 {
                    let sign = if (row * 31 + column * 17) % 5 < 2 { 1.0 } else { -1.0 };
                    let depth = &mut patched.depth[row * DEPTH_COLS + column];
                    *depth = (*depth + sign * 0.02).clamp(0.0, 1.0);
                }
            }
            let counts = picture.take(&patched);
            assert!(counts.torn >= 1 && counts.smooth_share() == Some(0.0), "{counts:?}");
        }
    }
}
