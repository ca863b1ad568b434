//! The ranges of all beams of one sweep, and of one ray, with the same bits.

use super::beams::{BeamTable, LIDAR_BEAMS, LIDAR_RINGS};
use super::leaf::{CuboidLeaf, CylinderLeaf, Leaf, MISS, Ray, inverse, lesser, plan2};
use super::scene::Scene;
use super::simd::vectorised;
use super::tiles::{TILE_FIRINGS, Tiles};
use super::triangles::{Looks, ray_range_m};

/// Range along every beam in metres, infinite where it meets nothing; beam `ring × LIDAR_FIRINGS + firing`.
pub type Ranges = [f32; LIDAR_BEAMS];

/// The range along one direction (NED, of length 1) in metres, infinite where there is nothing.
pub(crate) fn cast_ray(scene: &Scene, direction: (f32, f32, f32)) -> f32 {
    let ray = Ray::new(direction);
    let mut nearest = scene.planes_range_m(ray.inverse_z);
    for number in &scene.nearest_first {
        let leaf = &scene.leaves[*number as usize];
        if leaf.nearest_m() >= nearest {
            break;
        }
        nearest = lesser(leaf.range_m(&ray), nearest);
    }
    let surfaces = scene.surfaces.iter();
    surfaces.fold(nearest, |nearest, surface| {
        ray_range_m(surface, scene.sensor_ned_m, direction, nearest)
    })
}

/// A beam whose direction is less far down than this looks up.
const LOOKS_UP: f32 = -1e-6;

/// The fast way: strip by strip and ring by ring against the solids that may be seen there, 16 beams at a time.
pub(crate) struct TileCaster {
    tiles: Tiles,
    cuboids: Vec<(CuboidLeaf, u64)>,
    cylinders: Vec<(CylinderLeaf, u64)>,
    strip: Box<[Rays; LIDAR_RINGS]>,
    looks: Looks,
}

impl TileCaster {
    pub(crate) fn new(every: usize) -> Self {
        Self {
            tiles: Tiles::new(every),
            cuboids: Vec::new(),
            cylinders: Vec::new(),
            strip: Box::new([Rays::default(); LIDAR_RINGS]),
            looks: Looks::new(every),
        }
    }
}

/// The rays of a strip's ring, field by field, so that vector code loads them without shuffling, and their ranges.
#[derive(Clone, Copy, Default)]
pub(super) struct Rays {
    pub(super) range_m: [f32; TILE_FIRINGS],
    pub(super) x: [f32; TILE_FIRINGS],
    pub(super) y: [f32; TILE_FIRINGS],
    pub(super) z: [f32; TILE_FIRINGS],
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

/// Shortens what a solid shortens of the rings, a bit each, that may see it: not where it lies wholly beyond all ranges.
#[inline(always)]
fn shorten(strip: &mut [Rays; LIDAR_RINGS], rings: u64, nearest_m: f32, of_solid_m: impl Fn(&Ray) -> f32) {
    let seen = rings.trailing_zeros() as usize..=rings.ilog2() as usize;
    for rays in &mut strip[seen] {
        let beyond = |any, range_m: &f32| any | (*range_m > nearest_m);
        if !rays.range_m.iter().fold(false, beyond) {
            continue;
        }
        // All first: taken one by one, those that shorten nothing become masked stores, which cost more than the ranges do.
        let mut solid_m = [MISS; TILE_FIRINGS];
        for (k, range_m) in solid_m.iter_mut().enumerate() {
            *range_m = of_solid_m(&rays.get(k));
        }
        for (range_m, solid_m) in rays.range_m.iter_mut().zip(solid_m) {
            *range_m = lesser(solid_m, *range_m);
        }
    }
}

vectorised! {
    /// Casts all beams.
    pub(crate) fn cast(caster: &mut TileCaster, scene: &Scene, beams: &BeamTable, ranges: &mut Ranges) = cast_body;
}

#[inline(always)]
fn cast_body(caster: &mut TileCaster, scene: &Scene, beams: &BeamTable, ranges: &mut Ranges) {
    let TileCaster {
        tiles,
        cuboids,
        cylinders,
        strip,
        looks,
    } = caster;
    tiles.sort(scene);
    for number in 0..tiles.strips {
        cuboids.clear();
        cylinders.clear();
        let mut see_any = 0;
        tiles.strip(scene, number, |leaf, rings| {
            see_any |= rings;
            match leaf {
                Leaf::Cuboid(leaf) => cuboids.push((*leaf, rings)),
                Leaf::Cylinder(leaf) => cylinders.push((*leaf, rings)),
            }
        });
        begin_strip(scene, beams, number * TILE_FIRINGS, see_any, strip);
        // A solid after the other: whether a ring sees it is what the ring before it says, so processors foresee it.
        for (leaf, rings) in cuboids.iter().copied() {
            shorten(strip, rings, leaf.nearest_m, |ray| leaf.range_m(ray));
        }
        let see_cylinders = cylinders.iter().fold(0, |all, (_, rings)| all | rings);
        for ring in (0..beams.rings).filter(|ring| see_cylinders >> ring & 1 == 1) {
            let rays = &mut strip[ring];
            for k in 0..TILE_FIRINGS {
                (rays.plan2[k], rays.inverse_plan2[k]) = plan2(rays.x[k], rays.y[k]);
            }
        }
        for (leaf, rings) in cylinders.iter().copied() {
            shorten(strip, rings, leaf.nearest_m, |ray| leaf.range_m(ray));
        }
        if !scene.surfaces.is_empty() {
            looks.shorten(scene, number, strip);
        }
        for (rays, ring) in strip
            .iter()
            .zip(ranges.chunks_exact_mut(beams.firings))
            .take(beams.rings)
        {
            ring[number * TILE_FIRINGS..][..TILE_FIRINGS].copy_from_slice(&rays.range_m);
        }
    }
}

/// The rays of a strip from its first firing on, and their ranges to ground and ceiling. `seen`: the rings, a bit each, that see more.
#[inline(always)]
fn begin_strip(scene: &Scene, beams: &BeamTable, first: usize, seen: u64, strip: &mut [Rays; LIDAR_RINGS]) {
    let sin_bearing: &[f32; TILE_FIRINGS] = beams.sin_bearing[first..].first_chunk().expect("a whole strip");
    let cos_bearing: &[f32; TILE_FIRINGS] = beams.cos_bearing[first..].first_chunk().expect("a whole strip");
    for (ring, rays) in strip[..beams.rings].iter_mut().enumerate() {
        let (sin_elevation, cos_elevation) = (beams.sin_elevation[ring], beams.cos_elevation[ring]);
        for k in 0..TILE_FIRINGS {
            (rays.x[k], rays.y[k], rays.z[k]) =
                (scene.rotation).beam(sin_elevation, cos_elevation, sin_bearing[k], cos_bearing[k]);
        }
        let z = rays.z;
        let is_empty = seen >> ring & 1 == 0;
        if is_empty && scene.is_open_above() && z.iter().fold(true, |all, z| all & (*z < LOOKS_UP)) {
            rays.range_m = [MISS; TILE_FIRINGS];
            continue;
        }
        for (k, z) in z.into_iter().enumerate() {
            rays.inverse_z[k] = inverse(z);
            rays.range_m[k] = scene.planes_range_m(rays.inverse_z[k]);
        }
    }
}
