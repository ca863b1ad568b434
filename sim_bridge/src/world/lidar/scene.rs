//! The solids and planes around the sensor, relative to it.

use super::leaf::{Leaf, Rotation, lesser, plane_range_m};
use crate::world::World;
use crate::world::mesh::Surface;
use std::sync::Arc;
use vigil_types::{Attitude, NedVector};

/// What the sensor sees, relative to it.
#[derive(Default)]
pub(crate) struct Scene {
    pub(crate) rotation: Rotation,
    /// Ground and ceiling, metres below the sensor; a missing ceiling is infinitely high.
    planes_z_m: [f32; 2],
    pub(crate) leaves: Vec<Leaf>,
    /// Their numbers, the nearest first.
    pub(crate) nearest_first: Vec<u32>,
    pub(crate) surfaces: Vec<Arc<Surface>>,
    pub(crate) sensor_ned_m: [f32; 3],
}

impl Scene {
    /// Places the sensor in a world.
    pub(crate) fn place(&mut self, world: &World, sensor_ned_m: NedVector, attitude: Attitude) {
        self.rotation = Rotation::of(attitude);
        let ceiling_z_m = world
            .ceiling_height_m()
            .map_or(f32::NEG_INFINITY, |height| -height - sensor_ned_m.z);
        self.planes_z_m = [-sensor_ned_m.z, ceiling_z_m];
        self.leaves.clear();
        self.leaves
            .extend(world.solids().map(|solid| Leaf::of(&solid, sensor_ned_m)));
        self.nearest_first.clear();
        self.nearest_first.extend(0..self.leaves.len() as u32);
        let nearest_m = |number: &u32| self.leaves[*number as usize].nearest_m();
        self.nearest_first
            .sort_unstable_by(|a, b| nearest_m(a).total_cmp(&nearest_m(b)));
        self.surfaces.clear();
        self.surfaces.extend_from_slice(&world.surfaces);
        self.sensor_ned_m = sensor_ned_m.to_array();
    }

    /// Whether a beam that looks up meets no plane.
    pub(crate) fn is_open_above(&self) -> bool {
        self.planes_z_m[0] >= 0.0 && self.planes_z_m[1] == f32::NEG_INFINITY
    }

    #[inline(always)]
    pub(crate) fn planes_range_m(&self, inverse_z: f32) -> f32 {
        lesser(
            plane_range_m(self.planes_z_m[0], inverse_z),
            plane_range_m(self.planes_z_m[1], inverse_z),
        )
    }
}
