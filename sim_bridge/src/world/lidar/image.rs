//! The point cloud as a depth image: gaps filled, rows between rings interpolated, ranges normalised.
//!
//! All of it works on reciprocals of range. Along a line across any plane the reciprocal changes (almost) linearly with the
//! angle, so halfway between two beams that see one plane, be it a wall or the ground at a grazing angle, lies the mean of
//! their reciprocals; and "no return" is simply 0.

use super::beams::{LIDAR_BEAMS, LIDAR_FIRINGS, LIDAR_RINGS, ring_row};
use super::cast::Ranges;
use super::simd::vectorised;
use vigil_types::{DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DEPTH_ROWS};

type Row = [f32; LIDAR_FIRINGS];

const _: () = assert!(LIDAR_FIRINGS == DEPTH_COLS && 2 * LIDAR_RINGS == DEPTH_ROWS && LIDAR_BEAMS * 2 == DEPTH_PIXELS);

/// The nearer of two: the larger reciprocal.
#[inline(always)]
fn nearer(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Whether two ranges, given as reciprocals, differ by at most `tolerance_m`.
#[inline(always)]
fn alike(a: f32, b: f32, tolerance_m: f32) -> bool {
    (a - b).abs() <= tolerance_m * (a * b)
}

fn row(image: &Ranges, ring: usize) -> &Row {
    image[ring * LIDAR_FIRINGS..].first_chunk().expect("a whole ring")
}

vectorised! {
    /// Fills beams without a return whose left and right, or upper and lower, neighbours both have one: the sensor lost these.
    /// The value is the mean if the neighbours' ranges are alike, otherwise the nearer.
    pub(crate) fn fill_gaps(tolerance_m: f32, inverse: &Ranges, filled: &mut Ranges) = fill_gaps_body;
}

#[inline(always)]
fn fill_gaps_body(tolerance_m: f32, inverse: &Ranges, filled: &mut Ranges) {
    for ring in 0..LIDAR_RINGS {
        let here = row(inverse, ring);
        let above = row(inverse, ring.saturating_sub(1));
        let below = row(inverse, (ring + 1).min(LIDAR_RINGS - 1));
        let out: &mut Row = filled[ring * LIDAR_FIRINGS..].first_chunk_mut().expect("a whole ring");
        out[0] = gap(tolerance_m, here[0], 0.0, here[1], above[0], below[0]);
        for c in 1..LIDAR_FIRINGS - 1 {
            out[c] = gap(tolerance_m, here[c], here[c - 1], here[c + 1], above[c], below[c]);
        }
        let last = LIDAR_FIRINGS - 1;
        out[last] = gap(tolerance_m, here[last], here[last - 1], 0.0, above[last], below[last]);
    }
}

#[inline(always)]
fn gap(tolerance_m: f32, here: f32, left: f32, right: f32, above: f32, below: f32) -> f32 {
    let between = |a: f32, b: f32| {
        if alike(a, b, tolerance_m) {
            0.5 * (a + b)
        } else {
            nearer(a, b)
        }
    };
    let (sides, column) = (between(left, right), between(above, below));
    let sides_returned = (left > 0.0) & (right > 0.0);
    let column_returned = (above > 0.0) & (below > 0.0);
    let found = if column_returned { column } else { 0.0 };
    let found = if sides_returned { sides } else { found };
    if here > 0.0 { here } else { found }
}

vectorised! {
    /// Writes the image: ring `k` into row `2k`, and into row `2k + 1` what lies between it and ring `k + 1`.
    pub(crate) fn project(tolerance_m: f32, inverse: &Ranges, depth: &mut [f32; DEPTH_PIXELS]) = project_body;
}

#[inline(always)]
fn project_body(tolerance_m: f32, inverse: &Ranges, depth: &mut [f32; DEPTH_PIXELS]) {
    for ring in 0..LIDAR_RINGS {
        let upper2 = row(inverse, ring.saturating_sub(1));
        let upper = row(inverse, ring);
        let lower = row(inverse, (ring + 1).min(LIDAR_RINGS - 1));
        let lower2 = row(inverse, (ring + 2).min(LIDAR_RINGS - 1));
        let rows = &mut depth[ring_row(ring) * DEPTH_COLS..][..2 * DEPTH_COLS];
        let (measured, between) = rows.split_at_mut(DEPTH_COLS);
        for c in 0..DEPTH_COLS {
            measured[c] = normalised(upper[c]);
            between[c] = normalised(halfway(tolerance_m, [upper2[c], upper[c], lower[c], lower2[c]]));
        }
    }
}

/// Range, as a reciprocal, divided by the full scale; no return is 1.
#[inline(always)]
fn normalised(inverse: f32) -> f32 {
    let depth = (1.0 / DEPTH_FULL_SCALE_M) / inverse;
    if depth < 1.0 { depth } else { 1.0 }
}

/// The reciprocal range halfway between the middle two of four rings. They see one surface if their ranges are alike or if
/// either continues the straight line through the other and its outer neighbour; then the mean holds. Otherwise there is an
/// edge between them, and the nearer one is taken: no range appears where nothing is.
#[inline(always)]
fn halfway(tolerance_m: f32, [upper2, upper, lower, lower2]: [f32; 4]) -> f32 {
    let from_above = 2.0 * upper - upper2;
    let from_below = 2.0 * lower - lower2;
    let one_surface = alike(upper, lower, tolerance_m)
        | ((upper2 > 0.0) & continues(from_above, lower, upper, tolerance_m))
        | ((lower2 > 0.0) & continues(from_below, upper, lower, tolerance_m));
    let both = (upper > 0.0) & (lower > 0.0);
    if one_surface & both {
        0.5 * (upper + lower)
    } else {
        nearer(upper, lower)
    }
}

/// Whether `seen` is where a line predicted it, within a tolerance in metres at the ranges of `seen` and `neighbour`.
#[inline(always)]
fn continues(predicted: f32, seen: f32, neighbour: f32, tolerance_m: f32) -> bool {
    (predicted - seen).abs() <= tolerance_m * (seen * neighbour)
}
