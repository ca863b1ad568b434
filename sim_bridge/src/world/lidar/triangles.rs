//! Surfaces of triangles: one ray after the other down the tree, and a strip's beams together.
//!
//! All rays begin at the sensor, so that what a triangle needs is computed once for all of them: the planes through the sensor and its edges, on
//! whose inner sides every ray that meets it lies, and its own plane, which says how far away. Two triangles at an edge compute the same plane, bit
//! for bit, so no ray slips through between them. Both ways of casting compute the same bits, from either side of a triangle.
//!
//! A strip goes down the tree once, nearest boxes first: 16 boxes, then 16 triangles of a leaf are looked at together, for the rings and firings
//! between which they lie. Most triangles of a fine mesh lie between all beams and are done with; few rings are left for the others.

use super::beams::LIDAR_RINGS;
use super::cast::Rays;
use super::leaf::{MISS, greater, inverse, lesser};
use super::scene::Scene;
use super::tiles::TILE_FIRINGS;
use crate::world::mesh::{Block, Boxes, Child, LANES, ROOT, Surface, Within};
use vigil_types::{PIXEL_PITCH_RAD, column_bearing_rad, row_elevation_rad};

#[inline(always)]
fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// A triangle as the sensor sees it: inward normals of the planes through its edges, its own normal, and that times a corner.
type Seen = [f32; 13];

#[inline(always)]
fn seen([a, b, c]: [[f32; 3]; 3], sensor: [f32; 3]) -> Seen {
    let normal = cross(minus(b, a), minus(c, a));
    let (a, b, c) = (minus(a, sensor), minus(b, sensor), minus(c, sensor));
    let volume = dot(normal, a);
    // Seen from behind, all of them point the other way.
    let sign = if volume < 0.0 { -1.0 } else { 1.0 };
    let sides = [cross(b, c), cross(c, a), cross(a, b), normal].map(|n| n.map(|x| sign * x));
    let [[ux, uy, uz], [vx, vy, vz], [wx, wy, wz], [nx, ny, nz]] = sides;
    [ux, uy, uz, vx, vy, vz, wx, wy, wz, nx, ny, nz, sign * volume]
}

/// The range to its plane where the direction is on the inner side of all planes through its edges; from both sides, and never behind the
/// sensor.
#[inline(always)]
fn range_m(t: &Seen, direction: [f32; 3]) -> f32 {
    let along = |k: usize| dot([t[k], t[k + 1], t[k + 2]], direction);
    let inside = lesser(lesser(along(0), along(3)), along(6));
    let range_m = t[12] / along(9);
    if (inside >= 0.0) & (range_m >= 0.0) {
        range_m
    } else {
        MISS
    }
}

/// The range along one direction, where it is shorter than `nearest_m`.
pub(super) fn ray_range_m(surface: &Surface, sensor: [f32; 3], (x, y, z): (f32, f32, f32), nearest_m: f32) -> f32 {
    let direction = [x, y, z];
    let inverses = direction.map(inverse);
    let enter = |boxes: &Boxes| {
        core::array::from_fn(|lane| {
            let (mut enter, mut leave) = (0.0, MISS);
            for k in 0..3 {
                let middle = (boxes.centre_m[k][lane] - sensor[k]) * inverses[k];
                let half = boxes.half_m[k][lane] * inverses[k].abs();
                (enter, leave) = (greater(enter, middle - half), lesser(leave, middle + half));
            }
            // A box is no nearer than this, whatever was rounded.
            if enter <= leave { 0.999 * enter } else { MISS }
        })
    };
    surface.search(nearest_m, enter, |block, nearest_m| {
        (0..block.count).fold(nearest_m, |nearest_m, lane| {
            let t = seen(block.triangle(lane), sensor);
            lesser(range_m(&t, direction), nearest_m)
        })
    })
}

#[inline(always)]
fn point(axes: &[[f32; LANES]; 3], lane: usize) -> [f32; 3] {
    [axes[0][lane], axes[1][lane], axes[2][lane]]
}

/// For each of 16 things, the first ring and firing that may meet it, the ring and firing after the last, and what no range is shorter than.
#[derive(Default)]
struct Between {
    rings: [[u32; LANES]; 2],
    firings: [[u32; LANES]; 2],
    nearest_m: [f32; LANES],
}

/// What waits to be looked at, with the rings that may meet it.
#[derive(Clone, Copy)]
struct Waiting {
    nearest_m: f32,
    child: Child,
    rings: [u8; 2],
}

/// A strip's axes in NED: ahead through its middle, to the right, and up.
type Axes = [[f32; 3]; 3];

/// How a sensor's beams lie, and working storage.
pub(crate) struct Looks {
    rings: usize,
    /// Bearing of the middle of each strip's firings.
    middles_rad: Vec<f32>,
    top_rad: f32,
    pitch_rad: f32,
    /// Of the angle between a strip's outermost beams and its middle.
    cos_edge: f32,
    edge_slope: f32,
    /// As [`SLACK`], and what the firings' slopes are less even than their angles.
    firing_slack: f32,
    waiting: Vec<Waiting>,
}

/// A beam may be so far outside, in pitches of the beams: single precision and [`arc_tangent`] together are off by less.
const SLACK: f32 = 0.02;
/// What is nearer than this ahead, or behind, has no slope.
const AHEAD_M: f32 = 1e-6;
/// Slopes are bounded by this, which lies outside of every view.
const STEEP: f32 = 1.0;

/// A strip's last firing is as far from its middle as its first.
const HALF: f32 = 0.5 * (TILE_FIRINGS - 1) as f32;
/// From here to twice as much single precision holds whole numbers alone.
const WHOLE: f32 = (1 << 23) as f32;

/// Within 1e-5 of it, for slopes of at most 1 (Abramowitz and Stegun 4.4.47).
#[inline(always)]
fn arc_tangent(slope: f32) -> f32 {
    let s = lesser(greater(slope, -STEEP), STEEP);
    let q = s * s;
    s * (0.999_866 + q * (-0.330_299_5 + q * (0.180_141 + q * (-0.085_133 + q * 0.020_835_1))))
}

impl Looks {
    /// For one ring and firing of `every`.
    pub(crate) fn new(every: usize) -> Self {
        let middle = |k: f32| every as f32 * k + 0.5 * (every - 1) as f32;
        let strips = super::LIDAR_FIRINGS / every / TILE_FIRINGS;
        let pitch_rad = every as f32 * PIXEL_PITCH_RAD;
        let slope = |k: f32| libm::tanf(k * pitch_rad);
        let uneven = |k: f32| SLACK + (k - HALF * slope(k) / slope(HALF)).abs();
        Self {
            rings: LIDAR_RINGS / every,
            middles_rad: (0..strips)
                .map(|s| column_bearing_rad(middle((s * TILE_FIRINGS) as f32 + HALF)))
                .collect(),
            top_rad: row_elevation_rad(2.0 * middle(0.0)),
            pitch_rad,
            cos_edge: libm::cosf(HALF * pitch_rad),
            edge_slope: libm::tanf(HALF * pitch_rad),
            firing_slack: (0..TILE_FIRINGS).map(|k| uneven(k as f32 - HALF)).fold(SLACK, f32::max),
            waiting: Vec::new(),
        }
    }

    fn axes(&self, scene: &Scene, strip: usize) -> Axes {
        let (sin, cos) = (libm::sinf(self.middles_rad[strip]), libm::cosf(self.middles_rad[strip]));
        let ned = |body: [f32; 3]| scene.rotation.0.map(|row| dot(row, body));
        [ned([cos, sin, 0.0]), ned([-sin, cos, 0.0]), ned([0.0, 0.0, -1.0])]
    }

    /// Sets where something lies whose slopes to the right and up, against ahead, are between these, as whole rings and firings.
    #[inline(always)]
    fn place(&self, between: &mut Between, lane: usize, right: [f32; 2], up: [f32; 2], ahead_m: [f32; 2]) {
        let whole = |angle_rad: f32, per_rad: f32, slack: f32, count: usize| {
            let nearest = lesser(greater(angle_rad * per_rad + 0.5 + slack, 0.0), count as f32);
            // Rounded to a whole number by the sum, in whose last bits it is.
            (nearest + WHOLE).to_bits() & 0xFF
        };
        // A beam's slope against its strip's middle is its own one, and as much steeper the farther aside it is.
        let low = lesser(up[0], up[0] * self.cos_edge);
        let high = greater(up[1], up[1] * self.cos_edge);
        let per_rad = 0.5 / self.pitch_rad;
        between.rings[0][lane] = whole(self.top_rad - arc_tangent(high), per_rad, -SLACK, self.rings);
        between.rings[1][lane] = whole(self.top_rad - arc_tangent(low), per_rad, SLACK, self.rings);
        // A strip is so narrow that slopes will do.
        let (edge, per_slope, slack) = (self.edge_slope, HALF / self.edge_slope, self.firing_slack);
        between.firings[0][lane] = whole(right[0] + edge, per_slope, -slack, TILE_FIRINGS);
        between.firings[1][lane] = whole(right[1] + edge, per_slope, slack, TILE_FIRINGS);
        // Wholly behind there is nothing to meet.
        between.nearest_m[lane] = if ahead_m[1] > 0.0 {
            0.999 * greater(ahead_m[0], 0.0)
        } else {
            MISS
        };
    }

    #[inline(always)]
    fn boxes(&self, axes: &Axes, sensor: [f32; 3], boxes: &Boxes) -> Between {
        let mut between = Between::default();
        let sizes = axes.map(|axis| axis.map(f32::abs));
        for lane in 0..LANES {
            let (centre, half) = (minus(point(&boxes.centre_m, lane), sensor), point(&boxes.half_m, lane));
            let along = |k: usize| {
                let (middle, reach) = (dot(axes[k], centre), dot(sizes[k], half));
                [middle - reach, middle + reach]
            };
            let (ahead, right, up) = (along(0), along(1), along(2));
            let (near, far) = (greater(ahead[0], AHEAD_M), greater(ahead[1], AHEAD_M));
            // One division is all that is needed, and cheaper than two.
            let inverse = 1.0 / (near * far);
            let (near, far) = (inverse * far, inverse * near);
            let slopes = |[low, high]: [f32; 2]| [lesser(low * near, low * far), greater(high * near, high * far)];
            self.place(&mut between, lane, slopes(right), slopes(up), ahead);
        }
        between
    }

    #[inline(always)]
    fn block(&self, axes: &Axes, sensor: [f32; 3], block: &Block) -> Between {
        let mut between = Between::default();
        for lane in 0..LANES {
            let along = |corner: usize| {
                let corner = minus(point(&block.corners[corner], lane), sensor);
                (dot(axes[0], corner), dot(axes[1], corner), dot(axes[2], corner))
            };
            let ((a, a_right, a_up), (b, b_right, b_up), (c, c_right, c_up)) = (along(0), along(1), along(2));
            let ahead = [lesser(lesser(a, b), c), greater(greater(a, b), c)];
            let (a, b, c) = (greater(a, AHEAD_M), greater(b, AHEAD_M), greater(c, AHEAD_M));
            // One division is all that is needed, and cheaper than three.
            let inverse = 1.0 / (a * b * c);
            let (a, b, c) = (inverse * b * c, inverse * c * a, inverse * a * b);
            let span = |a: f32, b: f32, c: f32| [lesser(lesser(a, b), c), greater(greater(a, b), c)];
            let right = span(a * a_right, b * b_right, c * c_right);
            let up = span(a * a_up, b * b_up, c * c_up);
            // What reaches behind the sensor may be anywhere.
            let anywhere = |[low, high]: [f32; 2]| {
                let is_ahead = ahead[0] > AHEAD_M;
                [if is_ahead { low } else { -STEEP }, if is_ahead { high } else { STEEP }]
            };
            self.place(&mut between, lane, anywhere(right), anywhere(up), ahead);
        }
        between
    }

    /// Shortens what the surfaces shorten of a strip.
    #[inline(always)]
    pub(super) fn shorten(&mut self, scene: &Scene, strip: usize, rays: &mut [Rays; LIDAR_RINGS]) {
        let axes = self.axes(scene, strip);
        let mut farthest_m = [0.0; LIDAR_RINGS];
        for (farthest_m, rays) in farthest_m.iter_mut().zip(rays.iter()).take(self.rings) {
            *farthest_m = farthest_of(rays);
        }
        let mut waiting = core::mem::take(&mut self.waiting);
        for surface in &scene.surfaces {
            waiting.push(Waiting {
                nearest_m: 0.0,
                child: ROOT,
                rings: [0, self.rings as u8],
            });
            while let Some(next) = waiting.pop() {
                let [first, end] = next.rings.map(usize::from);
                let farther = |any, m: &f32| any | (*m > next.nearest_m);
                if !farthest_m[first..end].iter().fold(false, farther) {
                    continue;
                }
                match surface.within(next.child) {
                    Within::Node(boxes) => {
                        let between = self.boxes(&axes, scene.sensor_ned_m, boxes);
                        between.push(boxes, &mut waiting);
                    }
                    Within::Leaf(block) => {
                        let between = self.block(&axes, scene.sensor_ned_m, block);
                        shorten_by_block(block, scene.sensor_ned_m, &between, &mut farthest_m, rays);
                    }
                }
            }
        }
        self.waiting = waiting;
    }
}

impl Between {
    /// Bit by bit, which of the first `count` may be met by a beam.
    #[inline(always)]
    fn met(&self, count: usize) -> u32 {
        let mut met = 0;
        for k in 0..LANES {
            let some = (self.rings[0][k] < self.rings[1][k])
                & (self.firings[0][k] < self.firings[1][k])
                & (self.nearest_m[k] < MISS);
            met |= u32::from(some) << k;
        }
        met & ((1 << count) - 1)
    }

    /// Puts those boxes on top of what waits that may be met, the nearest last.
    #[inline(always)]
    fn push(&self, boxes: &Boxes, waiting: &mut Vec<Waiting>) {
        let first = waiting.len();
        let mut met = self.met(boxes.count);
        while met != 0 {
            let lane = met.trailing_zeros() as usize;
            met &= met - 1;
            let one = Waiting {
                nearest_m: self.nearest_m[lane],
                child: boxes.child[lane],
                rings: [self.rings[0][lane] as u8, self.rings[1][lane] as u8],
            };
            waiting.push(one);
            let mut at = waiting.len() - 1;
            while at > first && waiting[at - 1].nearest_m < one.nearest_m {
                waiting[at] = waiting[at - 1];
                at -= 1;
            }
            waiting[at] = one;
        }
    }
}

#[inline(always)]
fn shorten_by_block(
    block: &Block,
    sensor: [f32; 3],
    between: &Between,
    farthest_m: &mut [f32; LIDAR_RINGS],
    rays: &mut [Rays; LIDAR_RINGS],
) {
    let mut met = between.met(block.count);
    if met == 0 {
        return;
    }
    let mut all = [[0.0; LANES]; 13];
    for lane in 0..LANES {
        let [a, b, c] = &block.corners;
        let seen = seen([point(a, lane), point(b, lane), point(c, lane)], sensor);
        for (all, of_one) in all.iter_mut().zip(seen) {
            all[lane] = of_one;
        }
    }
    while met != 0 {
        let lane = met.trailing_zeros() as usize;
        met &= met - 1;
        let seen: Seen = core::array::from_fn(|k| all[k][lane]);
        // Not by `map`, which would copy all of them.
        let rings = &between.rings;
        for ring in rings[0][lane] as usize..rings[1][lane] as usize {
            if farthest_m[ring] > between.nearest_m[lane] {
                shorten_ring(&seen, &mut farthest_m[ring], &mut rays[ring]);
            }
        }
    }
}

#[inline(always)]
fn shorten_ring(seen: &Seen, farthest_m: &mut f32, rays: &mut Rays) {
    // Whether any is inside is as good as random: to ask costs more than to compute the ranges.
    for k in 0..TILE_FIRINGS {
        let direction = [rays.x[k], rays.y[k], rays.z[k]];
        rays.range_m[k] = lesser(range_m(seen, direction), rays.range_m[k]);
    }
    *farthest_m = farthest_of(rays);
}

/// The farthest of a ring's ranges. None is negative, so that they are in the order of their bits, which processors compare in any order.
#[inline(always)]
fn farthest_of(rays: &Rays) -> f32 {
    f32::from_bits(rays.range_m.iter().fold(0, |most, m| most.max(m.to_bits())))
}
