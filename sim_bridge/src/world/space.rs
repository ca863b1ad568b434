//! A course as a world that can be touched and looked at.

use crate::world::course::Course;
use crate::world::mesh::Surface;
use crate::world::mover::Mover;
use crate::world::solid::{Solid, UPRIGHT};
use crate::world::vehicle::VEHICLE;
use glamx::{Pose3, Quat, Vec3};
use parry3d::bounding_volume::{Aabb, BoundingVolume};
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::intersection_test;
use parry3d::shape::{Cylinder, SharedShape};
use std::sync::Arc;
use vigil_types::{Attitude, Nanos, NedVector};

/// The obstacles of a course with the shapes and the tree of collision, at one time.
pub struct World {
    /// What stands still.
    solids: Vec<Solid>,
    movers: Vec<Mover>,
    /// The time that was last set; 0 at first.
    pub(crate) now_ns: Nanos,
    /// No obstacle moves faster; 0 where all stand still.
    pub(crate) fastest_mover_m_s: f32,
    shapes: Vec<(Pose3, SharedShape)>,
    bvh: Bvh,
    pub(crate) surfaces: Vec<Arc<Surface>>,
    ceiling_height_m: Option<f32>,
}

/// The tree's boxes are this much larger than the solids, so that rounding in the tree can never hide a solid.
const TREE_MARGIN_M: f32 = 0.01;

impl World {
    /// The world of a course at time zero. The course is taken as it is: check one that was not read from a file or generated.
    pub fn new(course: &Course) -> Self {
        let movers = course.movers.clone();
        let solids = course.solids();
        // A mover's box in the tree holds all of its track, so the tree never changes.
        let tracks = movers.iter().map(Mover::track);
        let boxes: Vec<Aabb> = solids
            .iter()
            .copied()
            .chain(tracks)
            .map(|solid| {
                let (pose, shape) = solid.shape();
                shape.compute_aabb(&pose).loosened(TREE_MARGIN_M)
            })
            .collect();
        let placed = solids.iter().copied().chain(movers.iter().map(|m| m.solid_at(0)));
        Self {
            shapes: placed.map(|solid| solid.shape()).collect(),
            solids,
            fastest_mover_m_s: movers.iter().map(|m| m.speed_m_s).fold(0.0, f32::max),
            movers,
            now_ns: 0,
            bvh: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes),
            surfaces: course.surfaces(),
            ceiling_height_m: course.ceiling_height_m,
        }
    }

    /// The movers are from now on where they are at `now_ns` of simulated time.
    pub fn set_time_ns(&mut self, now_ns: Nanos) {
        self.now_ns = now_ns;
    }

    /// The obstacles, movers last, where they are now.
    pub fn solids(&self) -> impl Iterator<Item = Solid> {
        self.solids_at(self.now_ns)
    }

    fn solids_at(&self, at_ns: Nanos) -> impl Iterator<Item = Solid> {
        let movers = self.movers.iter().map(move |m| m.solid_at(at_ns));
        self.solids.iter().copied().chain(movers)
    }

    /// Height of the ceiling, if there is one.
    pub fn ceiling_height_m(&self) -> Option<f32> {
        self.ceiling_height_m
    }

    /// Whether the vehicle's solid at this pose touches an obstacle or the ceiling, with the movers where they are at `at_ns`. The ground
    /// is not asked: whether touching it is a landing or a crash depends on the motion ([`Referee`](crate::world::Referee)). Exact
    /// within a centimetre.
    pub fn collides_at(&self, at_ns: Nanos, position_ned_m: NedVector, attitude: Attitude) -> bool {
        let p = position_ned_m;
        let reach_m = VEHICLE.vertical_reach_m(attitude);
        if self.ceiling_height_m.is_some_and(|ceiling| -p.z + reach_m >= ceiling) {
            return true;
        }
        let turn = Quat::from_xyzw(attitude.x, attitude.y, attitude.z, attitude.w).normalize() * UPRIGHT;
        let pose = Pose3::from_parts(Vec3::new(p.x, p.y, p.z), turn);
        let shape = Cylinder::new(0.5 * VEHICLE.height_m, VEHICLE.radius_m);
        let around = Vec3::splat(VEHICLE.bounding_radius_m());
        let reach = Aabb::from_half_extents(pose.translation, around);
        let touches_solid = self.bvh.intersect_aabb(&reach).any(|leaf| {
            let (mut other_pose, ref other) = self.shapes[leaf as usize];
            if let Some(mover) = self.mover(leaf as usize) {
                let c = mover.solid_at(at_ns).centre_ned_m();
                other_pose.translation = Vec3::new(c.x, c.y, c.z);
            }
            // Every pair of cylinder and cuboid is supported; were one not, calling it a collision is the safe answer.
            intersection_test(&pose, &shape, &other_pose, &**other).map_or(true, |found| found.intersecting)
        });
        touches_solid || self.surfaces.iter().any(|s| s.touches(&pose, &shape, &reach))
    }

    /// Distance from a point to the nearest obstacle or to the ceiling, whichever is nearer; infinite in an empty world. The
    /// ground is not an obstacle.
    pub fn clearance_m(&self, point_ned_m: NedVector) -> f32 {
        self.clearance_at_m(self.now_ns, point_ned_m)
    }

    /// [`clearance_m`](Self::clearance_m) with the movers where they are at another time.
    pub fn clearance_at_m(&self, at_ns: Nanos, point_ned_m: NedVector) -> f32 {
        let ceiling_m = self
            .ceiling_height_m
            .map_or(f32::INFINITY, |c| (c + point_ned_m.z).max(0.0));
        let surfaces = self.surfaces.iter().map(|s| s.distance_m(point_ned_m));
        self.solids_at(at_ns)
            .map(|s| s.distance_m(point_ned_m))
            .chain(surfaces)
            .fold(ceiling_m, f32::min)
    }

    /// The mover behind a number of [`solids`](Self::solids).
    fn mover(&self, solid: usize) -> Option<&Mover> {
        self.movers.get(solid.checked_sub(self.solids.len())?)
    }
}
