//! The solids and planes around the sensor, relative to it.

use super::leaf::{Leaf, Rotation, lesser, plane_range_m};
use crate::world::World;
use vigil_types::{Attitude, NedVector};

/// What the sensor sees, relative to it.
pub(crate) struct Scene {
    pub(crate) rotation: Rotation,
    /// Ground and ceiling, metres below the sensor; a missing ceiling is infinitely high.
    planes_z_m: [f32; 2],
    pub(crate) leaves: Vec<Leaf>,
}

impl Scene {
    pub(crate) fn new() -> Self {
        Self {
            rotation: Rotation::of(Attitude::LEVEL_NORTH),
            planes_z_m: [f32::INFINITY, f32::NEG_INFINITY],
            leaves: Vec::new(),
        }
    }

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
    }

    #[inline(always)]
    pub(crate) fn planes_range_m(&self, inverse_z: f32) -> f32 {
        lesser(
            plane_range_m(self.planes_z_m[0], inverse_z),
            plane_range_m(self.planes_z_m[1], inverse_z),
        )
    }
}
