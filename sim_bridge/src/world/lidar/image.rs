//! The point cloud as a depth image: gaps filled, rows between rings interpolated, ranges normalised.
//!
//! All of it works on reciprocals of range. Along a line across any plane the reciprocal changes (almost) linearly with the
//! angle, so halfway between two beams that see one plane, be it a wall or the ground at a grazing angle, lies the mean of
//! their reciprocals; and "no return" is simply 0.

use super::beams::{LIDAR_BEAMS, LIDAR_FIRINGS, LIDAR_RINGS, ring_row};
use super::cast::Ranges;
// The nearer of two is the larger reciprocal.
use super::leaf::greater as nearer;
use super::simd::vectorised;
use super::tiles::TILE_FIRINGS;
use vigil_types::{DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DEPTH_ROWS};

/// What is computed at once, or left out at once where it is empty, as much of a view is: sky.
type Part = [f32; TILE_FIRINGS];
const PARTS: usize = LIDAR_FIRINGS / TILE_FIRINGS;

const _: () = assert!(LIDAR_FIRINGS == DEPTH_COLS && 2 * LIDAR_RINGS == DEPTH_ROWS && LIDAR_BEAMS * 2 == DEPTH_PIXELS);

/// Whether two ranges, given as reciprocals, differ by at most `tolerance_m`.
#[inline(always)]
fn alike(a: f32, b: f32, tolerance_m: f32) -> bool {
    (a - b).abs() <= tolerance_m * (a * b)
}

/// A ring, a part at a time; the first and the last stand for those beyond them.
fn parts(image: &Ranges, ring: usize) -> &[Part; PARTS] {
    let row = &image[ring.min(LIDAR_RINGS - 1) * LIDAR_FIRINGS..][..LIDAR_FIRINGS];
    row.as_chunks().0.try_into().expect("a whole ring")
}

/// Whether no beam returned: reciprocals are not negative.
#[inline(always)]
fn is_empty(part: &Part) -> bool {
    part.iter().fold(0, |bits, inverse| bits | inverse.to_bits()) == 0
}

/// Whether every beam returned.
#[inline(always)]
fn is_whole(part: &Part) -> bool {
    part.iter().fold(true, |all, inverse| all & (*inverse > 0.0))
}

vectorised! {
    /// Fills `inverse`'s gaps and writes the image, ring by ring: what was filled is still at hand. Ring `k` goes into row `2k`, and into row
    /// `2k + 1` what lies between it and ring `k + 1`. All times `scale`.
    pub(crate) fn image(
        tolerance_m: f32,
        scale: f32,
        inverse: &Ranges,
        filled: &mut Ranges,
        depth: &mut [f32; DEPTH_PIXELS],
    ) = image_body;
}

#[inline(always)]
fn image_body(tolerance_m: f32, scale: f32, inverse: &Ranges, filled: &mut Ranges, depth: &mut [f32; DEPTH_PIXELS]) {
    // Between two rings one sees what is two below.
    const AHEAD: usize = 2;
    for ring in 0..LIDAR_RINGS + AHEAD {
        if ring < LIDAR_RINGS {
            fill_ring(tolerance_m, ring, inverse, filled);
        }
        if let Some(ring) = ring.checked_sub(AHEAD) {
            project_ring(tolerance_m, scale, ring, filled, depth);
        }
    }
}

/// A part with what is to the left and to the right of it: of all, no return.
#[inline(always)]
fn with_sides(ring: &[Part; PARTS], part: usize) -> [f32; TILE_FIRINGS + 2] {
    let ring = ring.as_flattened();
    let first = part * TILE_FIRINGS;
    match first.checked_sub(1).and_then(|left| ring[left..].first_chunk()) {
        Some(sides) => *sides,
        None => core::array::from_fn(|k| {
            let beam = (first + k).checked_sub(1);
            beam.and_then(|beam| ring.get(beam)).copied().unwrap_or(0.0)
        }),
    }
}

/// Fills a ring's beams without a return whose left and right, or upper and lower, neighbours both have one: the sensor lost these.
/// The value is the mean if the neighbours' ranges are alike, otherwise the nearer.
#[inline(always)]
fn fill_ring(tolerance_m: f32, ring: usize, inverse: &Ranges, filled: &mut Ranges) {
    let [above, here, below] = [ring.saturating_sub(1), ring, ring + 1].map(|ring| parts(inverse, ring));
    let out = &mut filled[ring * LIDAR_FIRINGS..][..LIDAR_FIRINGS];
    for (part, out) in out.as_chunks_mut::<TILE_FIRINGS>().0.iter_mut().enumerate() {
        let (above, middle, below) = (&above[part], &here[part], &below[part]);
        if is_whole(middle) || (is_empty(middle) && is_empty(above)) {
            *out = *middle;
            continue;
        }
        let sides = with_sides(here, part);
        for c in 0..TILE_FIRINGS {
            out[c] = gap(tolerance_m, middle[c], sides[c], sides[c + 2], above[c], below[c]);
        }
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

#[inline(always)]
fn project_ring(tolerance_m: f32, scale: f32, ring: usize, inverse: &Ranges, depth: &mut [f32; DEPTH_PIXELS]) {
    let rings = [ring.saturating_sub(1), ring, ring + 1, ring + 2].map(|ring| parts(inverse, ring));
    let rows = &mut depth[ring_row(ring) * DEPTH_COLS..][..2 * DEPTH_COLS];
    let (measured, between) = rows.as_chunks_mut::<TILE_FIRINGS>().0.split_at_mut(PARTS);
    for (part, (measured, between)) in measured.iter_mut().zip(between).enumerate() {
        let [upper2, upper, lower, lower2] = rings.map(|ring| &ring[part]);
        if is_empty(upper) && is_empty(lower) {
            (*measured, *between) = ([scale; TILE_FIRINGS], [scale; TILE_FIRINGS]);
            continue;
        }
        for c in 0..TILE_FIRINGS {
            measured[c] = scale * normalised(upper[c]);
            between[c] = scale * normalised(halfway(tolerance_m, [upper2[c], upper[c], lower[c], lower2[c]]));
        }
    }
}

/// Range, as a reciprocal, divided by the full scale; no return is 1.
#[inline(always)]
pub(crate) fn normalised(inverse: f32) -> f32 {
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
