//! The ranges of all beams of one sweep, computed in two ways that agree bit for bit.

use super::beams::{BeamTable, LIDAR_BEAMS};
use super::leaf::{CuboidLeaf, CylinderLeaf, Leaf, MISS, Ray, inverse, lesser, plan2};
use super::scene::Scene;
use super::simd::{Simd, vectorised};
use super::tiles::{TILE_FIRINGS, TILE_RINGS, Tiles};
use crate::world::World;
use glamx::Vec3;
use vigil_types::NedVector;

/// Range along every beam in metres, infinite where it meets nothing; beam `ring × LIDAR_FIRINGS + firing`.
pub type Ranges = [f32; LIDAR_BEAMS];

/// The simple way: every beam walks parry's tree.
pub(crate) fn cast_by_tree(
    world: &World,
    sensor_ned_m: NedVector,
    scene: &Scene,
    beams: &BeamTable,
    ranges: &mut Ranges,
) {
    for ring in 0..beams.rings {
        for firing in 0..beams.firings {
            let direction = scene.rotation.beam(
                beams.sin_elevation[ring],
                beams.cos_elevation[ring],
                beams.sin_bearing[firing],
                beams.cos_bearing[firing],
            );
            ranges[ring * beams.firings + firing] = cast_ray(world, sensor_ned_m, scene, direction);
        }
    }
}

/// The range along one direction (NED, of length 1) in metres, infinite where there is nothing. `scene` is of this place and world.
pub(crate) fn cast_ray(world: &World, sensor_ned_m: NedVector, scene: &Scene, direction: (f32, f32, f32)) -> f32 {
    let origin = Vec3::new(sensor_ned_m.x, sensor_ned_m.y, sensor_ned_m.z);
    let ray = Ray::new(direction);
    let nearest_plane = scene.planes_range_m(ray.inverse_z);
    let tree_ray = parry3d::query::Ray::new(origin, Vec3::new(direction.0, direction.1, direction.2));
    let hit = world
        .bvh()
        .cast_ray(&tree_ray, nearest_plane.min(f32::MAX), |leaf, nearest| {
            let t = scene.leaves[leaf as usize].range_m(&ray);
            (t < nearest).then_some(t)
        });
    hit.map_or(nearest_plane, |(_, t)| lesser(t, nearest_plane))
}

/// A beam whose direction is less far down than this looks up.
const LOOKS_UP: f32 = -1e-6;

/// The fast way: beams in tiles, each with the list of solids that can be seen in it, 16 beams at a time.
pub(crate) struct TileCaster {
    tiles: Tiles,
    cuboids: Vec<CuboidLeaf>,
    cylinders: Vec<CylinderLeaf>,
}

impl TileCaster {
    pub(crate) fn new(every: usize) -> Self {
        Self {
            tiles: Tiles::new(every),
            cuboids: Vec::new(),
            cylinders: Vec::new(),
        }
    }

    pub(crate) fn cast(&mut self, simd: Simd, scene: &Scene, beams: &BeamTable, ranges: &mut Ranges) {
        let Self {
            tiles,
            cuboids,
            cylinders,
        } = self;
        tiles.cull(scene, |strip, band, visible| {
            cuboids.clear();
            cylinders.clear();
            for leaf in visible {
                match leaf {
                    Leaf::Cuboid(leaf) => cuboids.push(*leaf),
                    Leaf::Cylinder(leaf) => cylinders.push(*leaf),
                }
            }
            cast_tile(simd, scene, beams, (strip, band), cuboids, cylinders, ranges);
        });
    }
}

/// The rays of one ring of a tile, field by field, so that vector code loads them without shuffling.
#[derive(Default)]
struct Rays {
    x: [f32; TILE_FIRINGS],
    y: [f32; TILE_FIRINGS],
    z: [f32; TILE_FIRINGS],
    inverse_z: [f32; TILE_FIRINGS],
    plan2: [f32; TILE_FIRINGS],
    inverse_plan2: [f32; TILE_FIRINGS],
}

impl Rays {
    #[inline(always)]
    fn get(&self, k: usize) -> Ray {
        Ray {
            x: self.x[k],
            y: self.y[k],
            inverse_z: self.inverse_z[k],
            plan2: self.plan2[k],
            inverse_plan2: self.inverse_plan2[k],
        }
    }
}

/// Whether any of a ring's ranges is longer: what lies wholly beyond them changes none.
#[inline(always)]
fn reach_beyond(ranges: &[f32; TILE_FIRINGS], near_m: f32) -> bool {
    ranges.iter().fold(false, |any, range_m| any | (*range_m > near_m))
}

/// Shortens what one solid shortens. All its ranges first: taken one by one, those that shorten nothing become masked stores, which
/// cost more than the ranges do.
#[inline(always)]
fn nearer_of(ranges: &mut [f32; TILE_FIRINGS], of_solid_m: impl Fn(usize) -> f32) {
    let mut solid_m = [MISS; TILE_FIRINGS];
    for (k, range_m) in solid_m.iter_mut().enumerate() {
        *range_m = of_solid_m(k);
    }
    for (range_m, solid_m) in ranges.iter_mut().zip(solid_m) {
        *range_m = lesser(solid_m, *range_m);
    }
}

vectorised! {
    /// Casts the beams of one tile against the solids that may be seen in it.
    fn cast_tile(
        scene: &Scene,
        beams: &BeamTable,
        tile: (usize, usize),
        cuboids: &[CuboidLeaf],
        cylinders: &[CylinderLeaf],
        ranges: &mut Ranges,
    ) = cast_tile_body;
}

#[inline(always)]
fn cast_tile_body(
    scene: &Scene,
    beams: &BeamTable,
    (strip, band): (usize, usize),
    cuboids: &[CuboidLeaf],
    cylinders: &[CylinderLeaf],
    ranges: &mut Ranges,
) {
    let first = strip * TILE_FIRINGS;
    let sin_bearing: &[f32; TILE_FIRINGS] = beams.sin_bearing[first..].first_chunk().expect("a whole tile");
    let cos_bearing: &[f32; TILE_FIRINGS] = beams.cos_bearing[first..].first_chunk().expect("a whole tile");
    for ring in band * TILE_RINGS..(band + 1) * TILE_RINGS {
        let (sin_elevation, cos_elevation) = (beams.sin_elevation[ring], beams.cos_elevation[ring]);
        let beam = |k: usize| {
            let rotation = &scene.rotation;
            rotation.beam(sin_elevation, cos_elevation, sin_bearing[k], cos_bearing[k])
        };
        let out: &mut [f32; TILE_FIRINGS] = ranges[ring * beams.firings + first..]
            .first_chunk_mut()
            .expect("a whole tile");
        let mut rays = Rays::default();
        for k in 0..TILE_FIRINGS {
            (rays.x[k], rays.y[k], rays.z[k]) = beam(k);
        }
        let empty = cuboids.is_empty() && cylinders.is_empty();
        if empty && scene.is_open_above() && rays.z.iter().fold(true, |all, z| all & (*z < LOOKS_UP)) {
            *out = [MISS; TILE_FIRINGS];
            continue;
        }
        for (k, range_m) in out.iter_mut().enumerate() {
            rays.inverse_z[k] = inverse(rays.z[k]);
            *range_m = scene.planes_range_m(rays.inverse_z[k]);
        }
        if empty {
            continue;
        }
        for leaf in cuboids {
            if !reach_beyond(out, leaf.nearest_m) {
                break;
            }
            nearer_of(out, |k| leaf.range_m(&rays.get(k)));
        }
        if cylinders.is_empty() {
            continue;
        }
        for k in 0..TILE_FIRINGS {
            (rays.plan2[k], rays.inverse_plan2[k]) = plan2(rays.x[k], rays.y[k]);
        }
        for leaf in cylinders {
            if !reach_beyond(out, leaf.nearest_m) {
                break;
            }
            nearer_of(out, |k| leaf.range_m(&rays.get(k)));
        }
    }
}
