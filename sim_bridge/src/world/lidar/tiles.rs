//! Which solids can be seen in which part of the view.
//!
//! The view is cut into strips of bearings and these into rings. A solid is left out only where it lies wholly on the outer side of one
//! of the four planes that enclose a strip's beams of a ring; these are half a pixel or more away from the beams, so rounding cannot lose a hit.

use super::beams::{LIDAR_FIRINGS, LIDAR_RINGS, ring_row};
use super::leaf::{Leaf, lesser};
use super::scene::Scene;
use vigil_types::{column_bearing_rad, row_elevation_rad};

/// Firings of a strip's ring: one vector of AVX-512.
pub(crate) const TILE_FIRINGS: usize = 16;
const STRIPS: usize = LIDAR_FIRINGS / TILE_FIRINGS;
/// What separates as many rings, in whole vectors.
const PLANES: usize = (LIDAR_RINGS + 1).next_multiple_of(TILE_FIRINGS);

/// Planes through the sensor one behind the other, by their normals, which point at the next one.
struct Planes([[f32; PLANES]; 3]);

impl Planes {
    /// Bit `k`: the leaf reaches in between the planes `k` and `k + 1`, of `spaces` at most.
    #[inline(always)]
    fn seen_between(&self, spaces: usize, leaf: &Leaf, reach_m: &mut [[f32; PLANES]; 2]) -> u64 {
        match *leaf {
            Leaf::Cuboid(leaf) => self.reached(spaces, |normal| leaf.extents_m(normal), reach_m),
            Leaf::Cylinder(leaf) => self.reached(spaces, |normal| leaf.extents_m(normal), reach_m),
        }
    }

    #[inline(always)]
    fn reached(
        &self,
        spaces: usize,
        extents_m: impl Fn([f32; 3]) -> (f32, f32),
        [behind_m, before_m]: &mut [[f32; PLANES]; 2],
    ) -> u64 {
        let [x, y, z] = &self.0;
        for k in 0..(spaces + 1).next_multiple_of(8) {
            let (centre_m, half_m) = extents_m([x[k], y[k], z[k]]);
            (behind_m[k], before_m[k]) = (half_m + centre_m, half_m - centre_m);
        }
        // The sign's bit: 1 where it does not.
        let missed = [0, 32].map(|first| {
            let (behind_m, before_m) = (&behind_m[first..][..32], &before_m[first + 1..][..32]);
            (0..32).fold(0, |all, k| {
                all | (lesser(behind_m[k], before_m[k]).to_bits() >> 31) << k
            })
        });
        let beyond = u64::MAX.checked_shl(spaces as u32).unwrap_or(0);
        !(u64::from(missed[0]) | u64::from(missed[1]) << 32 | beyond)
    }
}

pub(crate) struct Tiles {
    /// Strips and rings that hold beams.
    pub(crate) strips: usize,
    rings: usize,
    /// Normals of the strips' edges, forward and right, in body axes.
    edges: [[f32; PLANES]; 2],
    /// The direction of each strip's middle, forward and right, in body axes.
    middles: [[f32; 2]; STRIPS],
    /// Slopes of the planes between the rings over a strip's middle.
    slopes: [f32; PLANES],
    /// Working storage: per strip, the solids that can be seen in it; how far one reaches behind planes and before them.
    in_strip: [Vec<u32>; STRIPS],
    reach_m: [[f32; PLANES]; 2],
}

impl Tiles {
    /// For one ring and firing of `every`.
    pub(crate) fn new(every: usize) -> Self {
        // At least half a pixel outside of the outermost beams.
        let edge_rad = |strip: usize| column_bearing_rad((every * strip * TILE_FIRINGS) as f32 - 0.5);
        let direction = |rad: f32| [libm::cosf(rad), libm::sinf(rad)];
        Self {
            strips: STRIPS / every,
            rings: LIDAR_RINGS / every,
            edges: [|rad: f32| -libm::sinf(rad), libm::cosf].map(|of| core::array::from_fn(|s| of(edge_rad(s)))),
            middles: core::array::from_fn(|s| direction(0.5 * (edge_rad(s) + edge_rad(s + 1)))),
            // Half-way between two rings, `every` pixels from both. At a strip's edges a cone of constant elevation is less than that
            // away from the plane that touches it in the strip's middle: 0.1 pixels, and 7.4 where one of eight is left.
            slopes: core::array::from_fn(|ring| {
                let row = ring_row(every * ring) as f32 + every as f32 - 1.0;
                libm::tanf(row_elevation_rad(row - every as f32))
            }),
            in_strip: core::array::from_fn(|_| Vec::new()),
            reach_m: [[0.0; PLANES]; 2],
        }
    }

    /// Sorts the solids into the strips in which they may be seen.
    #[inline(always)]
    pub(crate) fn sort(&mut self, scene: &Scene) {
        let [forward, right] = &self.edges;
        let axis = |[x, y, _]: [f32; 3]| core::array::from_fn(|k| x * forward[k] + y * right[k]);
        let edges = Planes(scene.rotation.0.map(axis));
        for list in &mut self.in_strip {
            list.clear();
        }
        for i in &scene.nearest_first {
            let mut strips = edges.seen_between(self.strips, &scene.leaves[*i as usize], &mut self.reach_m);
            while strips != 0 {
                self.in_strip[strips.trailing_zeros() as usize].push(*i);
                strips &= strips - 1;
            }
        }
    }

    /// Calls `seen` with every solid that may be seen in a strip and the rings, a bit each, from the first to the last that may see it; the
    /// nearest solid first.
    #[inline(always)]
    pub(crate) fn strip(&mut self, scene: &Scene, strip: usize, mut seen: impl FnMut(&Leaf, u64)) {
        let [x, y] = self.middles[strip];
        let axis = |row: [f32; 3]| {
            let ahead = row[0] * x + row[1] * y;
            core::array::from_fn(|k| self.slopes[k] * ahead + row[2])
        };
        let planes = Planes(scene.rotation.0.map(axis));
        for i in &self.in_strip[strip] {
            let leaf = &scene.leaves[*i as usize];
            let rings = planes.seen_between(self.rings, leaf, &mut self.reach_m);
            if rings != 0 {
                seen(
                    leaf,
                    u64::MAX << rings.trailing_zeros() & u64::MAX >> rings.leading_zeros(),
                );
            }
        }
    }
}
