//! A course as a world that can be touched and looked at.

use crate::course::Course;
use crate::solid::{Solid, UPRIGHT};
use crate::vehicle::VehicleSolid;
use glamx::{Pose3, Quat, Vec3};
use parry3d::bounding_volume::Aabb;
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::intersection_test;
use parry3d::shape::{Cylinder, SharedShape};
use vigil_types::{Attitude, NedVector};

/// The obstacles of a course with the shapes and the tree that collision and reference ray casting share.
pub struct World {
    solids: Vec<Solid>,
    shapes: Vec<(Pose3, SharedShape)>,
    bvh: Bvh,
    ceiling_height_m: Option<f32>,
}

/// The tree's boxes are this much larger than the solids, so that rounding in the tree can never hide a solid.
const TREE_MARGIN_M: f32 = 0.01;

impl World {
    /// The world of a course. The course is taken as it is: check one that was not read from a file or generated.
    pub fn new(course: &Course) -> Self {
        let solids = course.solids();
        let shapes: Vec<_> = solids.iter().map(Solid::shape).collect();
        let boxes: Vec<Aabb> = shapes
            .iter()
            .map(|(pose, shape)| {
                let aabb = shape.compute_aabb(pose);
                Aabb::new(
                    aabb.mins - Vec3::splat(TREE_MARGIN_M),
                    aabb.maxs + Vec3::splat(TREE_MARGIN_M),
                )
            })
            .collect();
        Self {
            solids,
            shapes,
            bvh: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes),
            ceiling_height_m: course.ceiling_height_m,
        }
    }

    /// The obstacles.
    pub fn solids(&self) -> &[Solid] {
        &self.solids
    }

    /// Height of the ceiling, if there is one.
    pub fn ceiling_height_m(&self) -> Option<f32> {
        self.ceiling_height_m
    }

    pub(crate) fn bvh(&self) -> &Bvh {
        &self.bvh
    }

    /// Whether the vehicle's solid at this pose touches an obstacle or the ceiling. The ground is not asked: whether touching
    /// it is a landing or a crash depends on the motion ([`Referee`](crate::Referee)). Exact within a centimetre.
    pub fn collides(&self, vehicle: &VehicleSolid, position_ned_m: NedVector, attitude: Attitude) -> bool {
        let p = position_ned_m;
        let reach_m = vehicle.vertical_reach_m(attitude);
        if self.ceiling_height_m.is_some_and(|ceiling| -p.z + reach_m >= ceiling) {
            return true;
        }
        let turn = Quat::from_xyzw(attitude.x, attitude.y, attitude.z, attitude.w).normalize() * UPRIGHT;
        let pose = Pose3::from_parts(Vec3::new(p.x, p.y, p.z), turn);
        let shape = Cylinder::new(0.5 * vehicle.height_m, vehicle.radius_m);
        let around = Vec3::splat(vehicle.bounding_radius_m());
        let centre = pose.translation;
        let reach = Aabb::new(centre - around, centre + around);
        self.bvh.intersect_aabb(&reach).any(|leaf| {
            let (other_pose, other) = &self.shapes[leaf as usize];
            // Every pair of cylinder and cuboid is supported; were one not, calling it a collision is the safe answer.
            intersection_test(&pose, &shape, other_pose, &**other).map_or(true, |found| found.intersecting)
        })
    }

    /// Distance from a point to the nearest obstacle or to the ceiling, whichever is nearer; infinite in an empty world. The
    /// ground is not an obstacle.
    pub fn clearance_m(&self, point_ned_m: NedVector) -> f32 {
        let ceiling_m = self
            .ceiling_height_m
            .map_or(f32::INFINITY, |c| (c + point_ned_m.z).max(0.0));
        self.solids
            .iter()
            .map(|s| s.distance_m(point_ned_m))
            .fold(ceiling_m, f32::min)
    }
}
