//! Which solids can be seen in which part of the view.
//!
//! The view is cut into strips of bearings and these into bands of elevations. A solid is left out of a tile only when it lies
//! wholly on the outer side of one of the four planes that enclose the tile's beams; a tile is wider than its beams by half a
//! pixel all round, so rounding cannot lose a hit.

use super::beams::{LIDAR_FIRINGS, LIDAR_RINGS, ring_row};
use super::leaf::{Leaf, Rotation};
use super::scene::Scene;
use vigil_types::{column_bearing_rad, row_elevation_rad};

/// Firings of a tile: one vector of AVX-512.
pub(crate) const TILE_FIRINGS: usize = 16;
/// Rings of a tile.
pub(crate) const TILE_RINGS: usize = 8;
const STRIPS: usize = LIDAR_FIRINGS / TILE_FIRINGS;
const BANDS: usize = LIDAR_RINGS / TILE_RINGS;

/// A plane through the sensor by its normal; the inner side is where `normal · p` is positive.
#[derive(Clone, Copy)]
struct Plane([f32; 3]);

impl Plane {
    fn rotated(self, Rotation(m): &Rotation) -> Self {
        let [x, y, z] = self.0;
        Self(core::array::from_fn(|i| m[i][0] * x + m[i][1] * y + m[i][2] * z))
    }

    /// The signed extents of a solid along the normal: from `centre − half` to `centre + half`.
    fn extents(self, leaf: &Leaf) -> (f32, f32) {
        let [nx, ny, nz] = self.0;
        match leaf {
            Leaf::Cuboid(l) => {
                let along = l.cos_yaw * nx + l.sin_yaw * ny;
                let across = l.cos_yaw * ny - l.sin_yaw * nx;
                (
                    along * l.centre_m[0] + across * l.centre_m[1] + nz * l.centre_m[2],
                    along.abs() * l.half_m[0] + across.abs() * l.half_m[1] + nz.abs() * l.half_m[2],
                )
            }
            Leaf::Cylinder(l) => (
                nx * l.centre_m[0] + ny * l.centre_m[1] + nz * l.centre_m[2],
                (nx * nx + ny * ny).sqrt() * l.radius_m + nz.abs() * l.half_height_m,
            ),
        }
    }
}

pub(crate) struct Tiles {
    /// Strips and bands that hold beams, the first of them.
    strips: usize,
    bands_used: usize,
    /// Left edges of the strips and the right edge of the last, normals to the right, in body axes.
    edges: [Plane; STRIPS + 1],
    /// Upper and lower planes of every tile, normals inwards, in body axes.
    bands: [[[Plane; 2]; BANDS]; STRIPS],
    /// Working storage: per strip, the solids that can be seen in it.
    in_strip: [Vec<u32>; STRIPS],
}

impl Tiles {
    /// For one ring and firing of `every`.
    pub(crate) fn new(every: usize) -> Self {
        // At least half a pixel outside of the outermost beams.
        let edge_rad = |strip: usize| column_bearing_rad((every * strip * TILE_FIRINGS) as f32 - 0.5);
        let row = |ring: usize| (ring_row(every * ring) + every - 1) as f32;
        let upper_rad = |band: usize| row_elevation_rad(row(band * TILE_RINGS) - 0.5);
        let lower_rad = |band: usize| row_elevation_rad(row((band + 1) * TILE_RINGS - 1) + 0.5);
        let edges = core::array::from_fn(|s| Plane([-libm::sinf(edge_rad(s)), libm::cosf(edge_rad(s)), 0.0]));
        let bands = core::array::from_fn(|s| {
            let middle = 0.5 * (edge_rad(s) + edge_rad(s + 1));
            let cos_half = libm::cosf(0.5 * (edge_rad(s + 1) - edge_rad(s)));
            let (sin, cos) = (libm::sinf(middle), libm::cosf(middle));
            // A cone of constant elevation e is, within the strip, between the planes of slope tan e and tan e / cos_half over
            // the strip's middle direction. The slope that lies further out encloses it.
            core::array::from_fn(|b| {
                let (upper, lower) = (libm::tanf(upper_rad(b)), libm::tanf(lower_rad(b)));
                let upper = upper.max(upper / cos_half);
                let lower = lower.min(lower / cos_half);
                [
                    Plane([upper * cos, upper * sin, 1.0]),
                    Plane([-lower * cos, -lower * sin, -1.0]),
                ]
            })
        });
        Self {
            strips: STRIPS / every,
            bands_used: BANDS / every,
            edges,
            bands,
            in_strip: core::array::from_fn(|_| Vec::new()),
        }
    }

    /// Calls `tile(strip, band, solids that may be seen in it)` for every tile, the nearest solid first.
    pub(crate) fn cull<'a>(
        &mut self,
        scene: &'a Scene,
        mut tile: impl FnMut(usize, usize, &mut dyn Iterator<Item = &'a Leaf>),
    ) {
        let edges = self.edges.map(|e| e.rotated(&scene.rotation));
        for list in &mut self.in_strip {
            list.clear();
        }
        for i in &scene.nearest_first {
            let leaf = &scene.leaves[*i as usize];
            let mut right = edges[0].extents(leaf);
            for (strip, list) in self.in_strip[..self.strips].iter_mut().enumerate() {
                let left = core::mem::replace(&mut right, edges[strip + 1].extents(leaf));
                if left.0 + left.1 >= 0.0 && right.0 - right.1 <= 0.0 {
                    list.push(*i);
                }
            }
        }
        for (strip, list) in self.in_strip[..self.strips].iter().enumerate() {
            for band in 0..self.bands_used {
                let planes = self.bands[strip][band].map(|p| p.rotated(&scene.rotation));
                let mut visible = list.iter().map(|i| &scene.leaves[*i as usize]).filter(|leaf| {
                    planes.iter().all(|p| {
                        let (centre, half) = p.extents(leaf);
                        centre + half >= 0.0
                    })
                });
                tile(strip, band, &mut visible);
            }
        }
    }
}
