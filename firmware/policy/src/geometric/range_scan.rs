//! The nearest surface at each bearing, taken from one depth frame.
//!
//! Each pixel becomes a level 3-D point with the attitude at capture. A point counts if it lies within the vertical band
//! that the vehicle sweeps, so floor, ceiling, low boxes and high beams drop out by geometry and not by image row.

use crate::apf::NearestObstacle;
use crate::{PilotInput, larger, smaller};
use vigil_nnet::{Isa, vectorised};
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame, FrdVector, HeadingVector, NedVector, column_bearing_rad,
    row_elevation_rad,
};

/// Sectors over the horizontal field of view: two image columns, 0.94°, each.
pub const SECTORS: usize = DEPTH_COLS / 2;

/// Half height of the band around the vehicle's height within which a surface is an obstacle: the vehicle's own 0.10 m,
/// its tilt (0.30 m · sin 17° = 0.09 m), height keeping and noise.
pub const BAND_HALF_HEIGHT_M: f32 = 0.35;

/// Returns from farther away are ignored: the band is thinner than two rows there, and "no return" is farther still.
pub const USEFUL_RANGE_M: f32 = 30.0;

/// Where a sector's point is put when nothing was seen in it, metres.
pub const FAR_M: f32 = 1e4;

/// Bins, or columns, that are looked at together.
const BLOCK: usize = 16;
/// Squared normalised range that stands for "nothing".
const NOTHING: f32 = 4.0;
/// What a distrusting look takes for level: at 3.3 m the band of [`BAND_HALF_HEIGHT_M`], nearer the vehicle's own height.
const DISTRUST_HALF_ANGLE_RAD: f32 = 0.105;
/// Below one half, so that what fills not quite half of that height is seen; and ranges that were moved err to the near side.
const DISTRUST_QUANTILE: f32 = 0.4;
/// Sectors on either side of a sector.
const DISTRUST_NEIGHBOURS: usize = 2;
/// Ranges are counted in bins; the last takes everything from 16 m on.
const DISTRUST_BIN_M: f32 = 0.25;
const DISTRUST_BINS: usize = 65;
/// A frame older than this is never extrapolated further (the caller refuses it anyway).
const MAX_EXTRAPOLATION_NS: u64 = 500_000_000;

/// The nearest surfaces in level axes along the heading now. Index 0 is the leftmost sector.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Metres ahead of the vehicle; [`FAR_M`] along the sector where no surface was seen.
    pub forward_m: [f32; SECTORS],
    /// Metres to the right of the vehicle; [`FAR_M`] along the sector where no surface was seen.
    pub right_m: [f32; SECTORS],
    /// Horizontal distance in metres; infinite where no surface was seen.
    pub range_m: [f32; SECTORS],
    /// Unit vector of the sector, forward component; always valid.
    pub direction_forward: [f32; SECTORS],
    /// Unit vector of the sector, right component; always valid.
    pub direction_right: [f32; SECTORS],
}

impl Scan {
    /// Nothing seen.
    pub const EMPTY: Self = Self {
        forward_m: [FAR_M; SECTORS],
        right_m: [0.0; SECTORS],
        range_m: [f32::INFINITY; SECTORS],
        direction_forward: [1.0; SECTORS],
        direction_right: [0.0; SECTORS],
    };

    /// The surfaces seen: (forward, right, distance) in metres, left to right.
    pub fn points(&self) -> impl Iterator<Item = (f32, f32, f32)> {
        self.forward_m
            .iter()
            .zip(&self.right_m)
            .zip(&self.range_m)
            .filter(|(_, range_m)| range_m.is_finite())
            .map(|((&x, &y), &r)| (x, y, r))
    }

    /// The nearest surface within ±`half_angle_rad` of the nose: what the repulsive field takes.
    pub fn nearest_within(&self, half_angle_rad: f32) -> Option<NearestObstacle> {
        let cos_limit = libm::cosf(half_angle_rad.clamp(0.0, core::f32::consts::PI));
        self.nearest_where(|x, _, r| x >= r * cos_limit)
    }

    /// The nearest surface of those (forward, right, distance) that count.
    pub(super) fn nearest_where(&self, counts: impl Fn(f32, f32, f32) -> bool) -> Option<NearestObstacle> {
        let points = self.points().filter(|&(x, y, r)| counts(x, y, r));
        let (x, y, distance_m) = points.min_by(|a, b| a.2.total_cmp(&b.2))?;
        Some(NearestObstacle::new(distance_m, libm::atan2f(y, x)))
    }
}

/// Turns depth frames into [`Scan`]s; holds the direction tables. No allocation.
#[derive(Debug, Clone)]
pub struct RangeScan {
    cos_column: [f32; DEPTH_COLS],
    sin_column: [f32; DEPTH_COLS],
    /// Cosine and sine of each row's elevation.
    rows: [(f32, f32); DEPTH_ROWS],
    scan: Scan,
}

impl Default for RangeScan {
    fn default() -> Self {
        Self::new()
    }
}

impl RangeScan {
    /// Computes the tables.
    pub fn new() -> Self {
        let of_columns = |of: fn(f32) -> f32| core::array::from_fn(|c| of(column_bearing_rad(c as f32)));
        let of_row = |r: usize| {
            let elevation = row_elevation_rad(r as f32);
            (libm::cosf(elevation), libm::sinf(elevation))
        };
        Self {
            cos_column: of_columns(libm::cosf),
            sin_column: of_columns(libm::sinf),
            rows: core::array::from_fn(of_row),
            scan: Scan::EMPTY,
        }
    }

    /// The last scan.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// Where the vehicle has moved since the frame was taken, NED metres.
    pub fn moved_since_capture_m(input: &PilotInput<'_>) -> NedVector {
        let age_ns = input.now_ns.saturating_sub(input.depth.header.stamp_ns);
        let age_s = age_ns.min(MAX_EXTRAPOLATION_NS) as f32 * 1e-9;
        input.velocity_m_s.to_ned(input.attitude.yaw_rad()) * age_s
    }

    /// Reads the frame: its points are levelled with the attitude at capture, then turned and shifted into the vehicle's
    /// heading frame now.
    pub fn observe(&mut self, input: &PilotInput<'_>) -> &Scan {
        self.observe_with(input, Self::nearest_by_sector)
    }

    /// The same for a frame whose pixels may have been moved by somebody: a sector's range is a quantile over all level
    /// pixels of it and of its neighbours, so that what a few of them say counts for nothing (docs/detection.md).
    pub fn observe_distrusting(&mut self, input: &PilotInput<'_>) -> &Scan {
        self.observe_with(input, Self::quantile_by_sector)
    }

    fn observe_with(
        &mut self,
        input: &PilotInput<'_>,
        by_sector: fn(&Self, &DepthFrame, &Axes) -> [f32; SECTORS],
    ) -> &Scan {
        let yaw_rad = input.attitude.yaw_rad();
        let capture = input.depth.header.attitude;
        // Body axes at capture, seen in level axes along the heading now.
        let axis = |x: f32, y: f32, z: f32| capture.to_ned(FrdVector::new(x, y, z)).to_heading(yaw_rad);
        let axes = Axes {
            forward: axis(1.0, 0.0, 0.0),
            right: axis(0.0, 1.0, 0.0),
            down: axis(0.0, 0.0, 1.0),
        };
        let moved = Self::moved_since_capture_m(input).to_heading(yaw_rad);
        let squared = by_sector(self, input.depth, &axes);
        self.fill_scan(&squared, &axes, moved);
        &self.scan
    }

    /// Makes the scan of each sector's squared normalised range; [`NOTHING`] where no surface was seen.
    fn fill_scan(&mut self, squared: &[f32; SECTORS], axes: &Axes, moved: HeadingVector) {
        // The down axis of a flying vehicle never gets near level; the limit only keeps the division finite.
        let down_z = if axes.down.z > 0.1 { axes.down.z } else { 0.1 };
        let cos = self.cos_column.as_chunks::<2>().0.iter();
        let sin = self.sin_column.as_chunks::<2>().0.iter();
        let scan = &mut self.scan;
        let out = scan
            .range_m
            .iter_mut()
            .zip(&mut scan.forward_m)
            .zip(&mut scan.right_m)
            .zip(scan.direction_forward.iter_mut().zip(&mut scan.direction_right));
        let columns = squared.iter().copied().zip(cos.zip(sin));
        for ((((range_m, forward_m), right_m), (dir_x, dir_y)), (squared, (cos, sin))) in out.zip(columns) {
            let (cos, sin) = (0.5 * (cos[0] + cos[1]), 0.5 * (sin[0] + sin[1]));
            // The direction within this column that is level: its component along the body's down axis cancels the drop.
            let along_down = -(axes.forward.z * cos + axes.right.z * sin) / down_z;
            let x = axes.forward.x * cos + axes.right.x * sin + axes.down.x * along_down;
            let y = axes.forward.y * cos + axes.right.y * sin + axes.down.y * along_down;
            let scale = 1.0 / libm::sqrtf(x * x + y * y).max(1e-6);
            (*dir_x, *dir_y) = (x * scale, y * scale);
            if squared < NOTHING {
                let range = libm::sqrtf(squared) * DEPTH_FULL_SCALE_M;
                *forward_m = range * *dir_x - moved.x;
                *right_m = range * *dir_y - moved.y;
                *range_m = libm::sqrtf(*forward_m * *forward_m + *right_m * *right_m);
            } else {
                (*forward_m, *right_m, *range_m) = (FAR_M * *dir_x, FAR_M * *dir_y, f32::INFINITY);
            }
        }
    }

    /// For each sector the third smallest squared horizontal range (normalised) of its points within the band.
    fn nearest_by_sector(&self, frame: &DepthFrame, axes: &Axes) -> [f32; SECTORS] {
        let mut nearest = [[NOTHING; 3]; DEPTH_COLS];
        find_nearest(Isa::detect(), self, frame, axes, &mut nearest);
        let mut squared = [NOTHING; SECTORS];
        for (squared, [a, b]) in squared.iter_mut().zip(nearest.as_chunks::<2>().0) {
            *squared = third_smallest(*a, *b);
        }
        squared
    }

    /// For each sector the squared [`DISTRUST_QUANTILE`] (normalised) of the ranges of all pixels that look level to within
    /// [`DISTRUST_HALF_ANGLE_RAD`], its neighbouring sectors' included.
    fn quantile_by_sector(&self, frame: &DepthFrame, axes: &Axes) -> [f32; SECTORS] {
        let mut sectors = [[0_u16; DISTRUST_BINS]; SECTORS];
        count_by_range(Isa::detect(), self, frame, axes, &mut sectors);
        let mut squared = [NOTHING; SECTORS];
        for (sector, squared) in squared.iter_mut().enumerate() {
            let mut bins = [0_u16; DISTRUST_BINS];
            let from = sector.saturating_sub(DISTRUST_NEIGHBOURS);
            for counts in sectors.iter().take(sector + 1 + DISTRUST_NEIGHBOURS).skip(from) {
                // Some thousand pixels at the most; a checked sum would keep the loop from being vectorised.
                for (sum, count) in bins.iter_mut().zip(counts) {
                    *sum = sum.wrapping_add(*count);
                }
            }
            let all = bins.iter().fold(0_u16, |sum, count| sum.wrapping_add(*count));
            let wanted = DISTRUST_QUANTILE * f32::from(all);
            let mut below = 0.0;
            for (chunk, counts) in bins.as_chunks::<BLOCK>().0.iter().enumerate() {
                let chunk_sum = f32::from(counts.iter().fold(0_u16, |sum, count| sum.wrapping_add(*count)));
                if below + chunk_sum < wanted {
                    below += chunk_sum;
                    continue;
                }
                for (bin, count) in (chunk * BLOCK..).zip(counts) {
                    let count = f32::from(*count);
                    if count > 0.0 && below + count >= wanted {
                        let range_m = (bin as f32 + (wanted - below) / count) * DISTRUST_BIN_M;
                        let range = range_m / DEPTH_FULL_SCALE_M;
                        *squared = range * range;
                        break;
                    }
                    below += count;
                }
                break;
            }
        }
        squared
    }
}

vectorised! {
    /// For each sector, how many of its pixels look level, by range.
    fn count_by_range<'a>(
        tables: &'a RangeScan,
        frame: &'a DepthFrame,
        axes: &'a Axes,
        sectors: &'a mut [[u16; DISTRUST_BINS]; SECTORS],
    ) {
        let band = libm::sinf(DISTRUST_HALF_ANGLE_RAD);
        let lean = libm::hypotf(axes.forward.z, axes.right.z);
        for (pixels, &(cos_row, sin_row)) in frame.depth.as_chunks::<DEPTH_COLS>().0.iter().zip(&tables.rows) {
            let rise = axes.down.z * sin_row;
            // None of a row looks level that no bearing brings into the band; the rest is for rounding.
            if rise.abs() > band + cos_row * lean + 1e-4 {
                continue;
            }
            let directions = tables.cos_column.iter().zip(&tables.sin_column);
            let mut bins = [0_i32; DEPTH_COLS];
            for ((bin, depth), (c, s)) in bins.iter_mut().zip(pixels).zip(directions) {
                let below = cos_row * (axes.forward.z * c + axes.right.z * s) - rise;
                // `as` saturates; the last bin takes everything beyond.
                let by_range = ((depth * (DEPTH_FULL_SCALE_M / DISTRUST_BIN_M)) as i32).min(DISTRUST_BINS as i32 - 1);
                *bin = if below.abs() < band { by_range } else { -1 };
            }
            for (bins, counts) in bins.as_chunks::<2>().0.iter().zip(sectors.iter_mut()) {
                for bin in bins {
                    // What does not look level has no bin. At most 128 rows of two.
                    if let Some(count) = counts.get_mut(*bin as usize) {
                        *count += 1;
                    }
                }
            }
        }
    }
}

vectorised! {
    /// For each column the three smallest squared horizontal ranges (normalised) of points within the band, ascending.
    /// Three, because one alone could be a stray return.
    fn find_nearest<'a>(
        tables: &'a RangeScan,
        frame: &'a DepthFrame,
        axes: &'a Axes,
        nearest: &'a mut [[f32; 3]; DEPTH_COLS],
    ) {
        let band = BAND_HALF_HEIGHT_M / DEPTH_FULL_SCALE_M;
        let farthest = USEFUL_RANGE_M / DEPTH_FULL_SCALE_M;
        let directions =
            (tables.cos_column.as_chunks::<BLOCK>().0.iter()).zip(tables.sin_column.as_chunks::<BLOCK>().0);
        let blocks = nearest.as_chunks_mut::<BLOCK>().0.iter_mut().zip(directions);
        // Some columns after the others, so that what was found in them stays in registers.
        for (block, (nearest, (cos, sin))) in blocks.enumerate() {
            let mut drop = [0.0; BLOCK];
            for ((k, c), s) in drop.iter_mut().zip(cos).zip(sin) {
                *k = axes.forward.z * c + axes.right.z * s;
            }
            let [mut first, mut second, mut third] = [[NOTHING; BLOCK]; 3];
            for (pixels, &(cos_row, sin_row)) in frame.depth.as_chunks::<DEPTH_COLS>().0.iter().zip(&tables.rows) {
                let rise = axes.down.z * sin_row;
                let Some(pixels) = pixels.as_chunks::<BLOCK>().0.get(block) else {
                    break;
                };
                for i in 0..BLOCK {
                    // All arrays have BLOCK items.
                    #[allow(clippy::indexing_slicing)]
                    {
                        let depth = pixels[i];
                        let below = depth * (cos_row * drop[i] - rise);
                        let squared = depth * depth - below * below;
                        let counts = (below.abs() < band) & (depth < farthest);
                        let v = if counts { squared } else { NOTHING };
                        let v1 = larger(first[i], v);
                        first[i] = smaller(first[i], v);
                        let v2 = larger(second[i], v1);
                        second[i] = smaller(second[i], v1);
                        third[i] = smaller(third[i], v2);
                    }
                }
            }
            for (((nearest, a), b), c) in nearest.iter_mut().zip(first).zip(second).zip(third) {
                *nearest = [a, b, c];
            }
        }
    }
}

/// Body axes in level axes along the heading.
struct Axes {
    forward: HeadingVector,
    right: HeadingVector,
    down: HeadingVector,
}

/// The third smallest of two ascending triples.
fn third_smallest(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [a1, a2, a3] = a;
    let [b1, b2, b3] = b;
    // Of the six, the third smallest takes i from one triple and 3 − i from the other: the split with the least maximum.
    smaller(smaller(a3, b3), smaller(larger(a1, b2), larger(a2, b1)))
}
