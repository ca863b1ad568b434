//! A depth frame reduced to cells of 4 × 4 pixels: what two frames are compared by.

use crate::{larger, smaller};
use vigil_nnet::Isa;
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame, FrdVector, HORIZONTAL_FOV_RAD, PIXEL_PITCH_RAD,
    VERTICAL_FOV_RAD, column_bearing_rad, row_elevation_rad,
};

/// Parts of the view of 4 × 4 cells.
pub(super) const PART: usize = 4;
pub(super) const PART_COLS: usize = COLS / PART;
pub(super) const PART_ROWS: usize = ROWS / PART;
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

impl Default for Directions {
    fn default() -> Self {
        let middle = |cell: usize| (cell * SIDE) as f32 + 0.5 * (SIDE as f32 - 1.0);
        let both = |angle: f32| (libm::cosf(angle), libm::sinf(angle));
        Self {
            rows: core::array::from_fn(|r| both(row_elevation_rad(middle(r)))),
            columns: core::array::from_fn(|c| both(column_bearing_rad(middle(c)))),
        }
    }
}

impl Directions {
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

/// What is shown farther away than this is no surface that has sides, metres.
pub(super) const FAR_M: f32 = 60.0;
/// The part of a line's or a column's sum that is its mean, metres.
const LINE_M: f32 = DEPTH_FULL_SCALE_M / SIDE as f32;

/// The means of the cells that show a surface, and of their outermost rows and columns, metres; not a number where none is shown.
#[derive(Debug, Clone)]
pub(super) struct Sides {
    pub(super) mean_m: [[f32; COLS]; ROWS],
    pub(super) top_m: [[f32; COLS]; ROWS],
    pub(super) bottom_m: [[f32; COLS]; ROWS],
    pub(super) left_m: [[f32; COLS]; ROWS],
    pub(super) right_m: [[f32; COLS]; ROWS],
}

impl Default for Sides {
    fn default() -> Self {
        const NONE: [[f32; COLS]; ROWS] = [[f32::NAN; COLS]; ROWS];
        Self {
            mean_m: NONE,
            top_m: NONE,
            bottom_m: NONE,
            left_m: NONE,
            right_m: NONE,
        }
    }
}

/// A reduced frame.
#[derive(Debug, Clone)]
pub(super) struct Picture {
    /// Reciprocal of the range in 1/m, which changes linearly along any plane; 0 without a return, negative if mixed.
    inverse: [f32; CELLS],
}

impl Default for Picture {
    /// Nothing that could be compared.
    fn default() -> Self {
        Self { inverse: [-1.0; CELLS] }
    }
}

impl Picture {
    /// Takes a frame, and the sides of its cells; counts what is counts.
    pub(super) fn take(&mut self, frame: &DepthFrame, sides: &mut Sides) -> CellCounts {
        let mut counts = CellCounts::default();
        reduce(Isa::detect(), self, frame, sides, &mut counts);
        counts
    }

    /// Takes a row of cells; counts the cells of a column in which ranges go to and fro.
    #[inline(always)]
    fn take_row(
        &mut self,
        row: usize,
        band: &[f32; SIDE * DEPTH_COLS],
        sides: &mut Sides,
        counts: &mut CellCounts,
        ragged: &mut [u8; COLS],
    ) {
        // [line][column of the cell][cell]: a vector is of cells.
        let mut pixels = [[[0.0_f32; COLS]; SIDE]; SIDE];
        for (to, line) in pixels.iter_mut().zip(band.as_chunks::<DEPTH_COLS>().0) {
            let [a, b, c, d] = to;
            for ((((a, b), c), d), cell) in a.iter_mut().zip(b).zip(c).zip(d).zip(line.as_chunks::<SIDE>().0) {
                [*a, *b, *c, *d] = *cell;
            }
        }
        let Sides {
            mean_m,
            top_m,
            bottom_m,
            left_m,
            right_m,
        } = sides;
        let rows = [mean_m, top_m, bottom_m, left_m, right_m].map(|rows| rows.get_mut(row));
        let ([Some(mean), Some(top), Some(bottom), Some(left), Some(right)], Some(inverse)) =
            (rows, self.inverse.as_chunks_mut::<COLS>().0.get_mut(row))
        else {
            return;
        };
        let [mut seen, mut smooth, mut zeros, mut holes, mut wild] = [0_u32; 5];
        // What is checked or branches is not vectorised: hence the wrapping sums, and `&`.
        let note = |count: &mut u32, is: bool| *count = count.wrapping_add(u32::from(is));
        for i in 0..COLS {
            // All arrays have COLS items.
            #[allow(clippy::indexing_slicing)]
            {
                let cell = pixels.each_ref().map(|line| line.each_ref().map(|column| column[i]));
                let [first, second, third, last] = cell;
                let add = |sum: [f32; SIDE], line: [f32; SIDE]| core::array::from_fn(|c| sum[c] + line[c]);
                let [a, b, c, d] = add(add(add(first, second), third), last);
                let all = cell.as_flattened().iter();
                let low = all.clone().fold(1.0, |low, v| smaller(low, *v));
                let high = all.clone().fold(0.0, |high, v| larger(high, *v));
                let zero = all.fold(0.0, |zero, v| zero + if *v <= 0.0 { 1.0 } else { 0.0 });
                let mean_m = (a + b + c + d) * (DEPTH_FULL_SCALE_M / (SIDE * SIDE) as f32);
                let spread_m = (high - low) * DEPTH_FULL_SCALE_M;
                let is_smooth = (low > 0.0) & (high < 1.0) & (spread_m <= SMOOTH_PART * mean_m + SMOOTH_M);
                note(&mut seen, low < 1.0);
                note(&mut smooth, is_smooth);
                note(&mut zeros, high <= 0.0);
                note(&mut holes, zero > HOLES);
                note(&mut wild, (high < 1.0) & (spread_m > WILD_M));
                let kept = if is_smooth { 1.0 / mean_m } else { -1.0 };
                inverse[i] = if low >= 1.0 { 0.0 } else { kept };
                // Metres, where the cell has sides.
                let has_sides = is_smooth & (high * DEPTH_FULL_SCALE_M < FAR_M);
                let side = |value_m: f32| if has_sides { value_m } else { f32::NAN };
                let line = |[a, b, c, d]: [f32; SIDE]| a + b + c + d;
                mean[i] = side(mean_m);
                (left[i], right[i]) = (side(a * LINE_M), side(d * LINE_M));
                (top[i], bottom[i]) = (side(line(first) * LINE_M), side(line(last) * LINE_M));
                // Every second row is a ring of the LiDAR, those between lie between.
                let more = |[a, b, c, d]: [f32; SIDE]| (a - b).abs() + (b - c).abs() + (c - d).abs() - (a - d).abs();
                let may = |cells: [f32; SIDE]| RAGGED_PART / SIDE as f32 * line(cells) + RAGGED_M / DEPTH_FULL_SCALE_M;
                let is_ragged = more(first) + more(third) > may(first) + may(third);
                ragged[i] = ragged[i].wrapping_add(u8::from(is_ragged));
            }
        }
        counts.seen += seen as usize;
        counts.smooth += smooth as usize;
        counts.zeros += zeros as usize;
        counts.holes += holes as usize;
        counts.wild += wild as usize;
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
        match self.inverse(cell) {
            inverse if inverse > 0.0 => Seen::Surface(1.0 / inverse),
            0.0 => Seen::Nothing,
            _ => Seen::Mixed,
        }
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

vigil_nnet::vectorised! {
    /// [`Picture::take`], compiled for each instruction set.
    fn reduce<'a>(picture: &'a mut Picture, frame: &'a DepthFrame, sides: &'a mut Sides, counts: &'a mut CellCounts) {
        let bands = frame.depth.as_chunks::<{ SIDE * DEPTH_COLS }>().0;
        for (part, bands) in bands.as_chunks::<PART>().0.iter().enumerate() {
            let mut ragged = [0; COLS];
            for (row, band) in (part * PART..).zip(bands) {
                picture.take_row(row, band, sides, counts, &mut ragged);
            }
            let parts = ragged.as_chunks::<PART>().0.iter();
            counts.torn += parts.filter(|cells| cells.iter().sum::<u8>() >= TORN_CELLS).count();
        }
    }
}

/// The part of the view in which a cell lies.
pub(super) fn part_of(row: usize, column: usize) -> usize {
    (row / PART) * PART_COLS + column / PART
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
        let directions = Directions::default();
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
        let mut picture = Picture::default();
        // An edge before something far away.
        frame.depth[24] = 0.6;
        let counts = picture.take(&frame, &mut Sides::default());
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
        assert_eq!(
            picture.take(&DepthFrame::EMPTY, &mut Sides::default()),
            CellCounts::default()
        );
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
        let mut picture = Picture::default();
        assert_eq!(picture.take(&frame, &mut Sides::default()).torn, 0);
        for (top, left) in [(0, 0), (37, 91), (96, 224)] {
            let mut patched = frame.clone();
            for row in top..top + 32 {
                for column in left..left + 32 {
                    let sign = if (row * 31 + column * 17) % 5 < 2 { 1.0 } else { -1.0 };
                    let depth = &mut patched.depth[row * DEPTH_COLS + column];
                    *depth = (*depth + sign * 0.02).clamp(0.0, 1.0);
                }
            }
            let counts = picture.take(&patched, &mut Sides::default());
            assert!(counts.torn >= 1 && counts.smooth_share() == Some(0.0), "{counts:?}");
        }
    }
}
