//! Where a ray meets a solid: the one arithmetic of both ways of casting.
//!
//! Single precision, multiplications and additions in a fixed order and never fused, so that scalar and vector code on any
//! machine give the same bits. Everything is relative to the sensor, whose position is the origin of all rays.

use crate::world::solid::Solid;
use vigil_types::{Attitude, NedVector};

/// What a ray that meets nothing returns.
pub(crate) const MISS: f32 = f32::INFINITY;

/// The smaller; the same as `minps`, which `f32::min` is not for its care of NaN.
#[inline(always)]
pub(crate) fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
pub(crate) fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Keeps a divisor away from 0, so that no quotient is infinite or NaN.
#[inline(always)]
fn nonzero(x: f32) -> f32 {
    const TINY: f32 = 1e-9;
    if x < TINY && x > -TINY { TINY } else { x }
}

/// 1 / x, never infinite.
#[inline(always)]
pub(crate) fn inverse(x: f32) -> f32 {
    1.0 / nonzero(x)
}

/// A rotation matrix, body to NED, row by row.
#[derive(Clone, Copy, Default)]
pub(crate) struct Rotation(pub(crate) [[f32; 3]; 3]);

impl Rotation {
    pub(crate) fn of(q: Attitude) -> Self {
        // Normalised first: an attitude is valid within 1 %, and ranges should not inherit that.
        let n = 1.0 / libm::sqrtf(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
        let (w, x, y, z) = (q.w * n, q.x * n, q.y * n, q.z * n);
        Self([
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y - w * z),
                2.0 * (x * z + w * y),
            ],
            [
                2.0 * (x * y + w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z - w * x),
            ],
            [
                2.0 * (x * z - w * y),
                2.0 * (y * z + w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ])
    }

    /// The beam of these sines and cosines in NED.
    #[inline(always)]
    pub(crate) fn beam(
        &self,
        sin_elevation: f32,
        cos_elevation: f32,
        sin_bearing: f32,
        cos_bearing: f32,
    ) -> (f32, f32, f32) {
        let (x, y, z) = (cos_elevation * cos_bearing, cos_elevation * sin_bearing, -sin_elevation);
        let [a, b, c] = self.0;
        (
            a[0] * x + a[1] * y + a[2] * z,
            b[0] * x + b[1] * y + b[2] * z,
            c[0] * x + c[1] * y + c[2] * z,
        )
    }
}

/// A ray's direction (a unit vector in NED) with what every solid needs of it.
#[derive(Clone, Copy)]
pub(crate) struct Ray {
    pub(crate) x: f32,
    pub(crate) y: f32,
    /// 1 / z.
    pub(crate) inverse_z: f32,
    /// x² + y².
    pub(crate) plan2: f32,
    /// 1 / (x² + y²).
    pub(crate) inverse_plan2: f32,
}

impl Ray {
    #[inline(always)]
    pub(crate) fn new((x, y, z): (f32, f32, f32)) -> Self {
        let (plan2, inverse_plan2) = plan2(x, y);
        Self {
            x,
            y,
            inverse_z: inverse(z),
            plan2,
            inverse_plan2,
        }
    }
}

/// x² + y² and its inverse.
#[inline(always)]
pub(crate) fn plan2(x: f32, y: f32) -> (f32, f32) {
    let plan2 = nonzero(x * x + y * y);
    (plan2, 1.0 / plan2)
}

/// What no range of a solid is shorter than: its distance in the plan view, less what rounding may take from it.
fn nearest_m(plan_distance_m: f32) -> f32 {
    0.999 * plan_distance_m - 0.01
}

/// A horizontal plane, ground or ceiling, `z_m` below the sensor.
#[inline(always)]
pub(crate) fn plane_range_m(z_m: f32, inverse_z: f32) -> f32 {
    let t = z_m * inverse_z;
    if t > 0.0 { t } else { MISS }
}

/// Where the ray is between two horizontal faces, at `z_m ± half_m`.
#[inline(always)]
fn between_faces(z_m: f32, half_m: f32, inverse_z: f32) -> (f32, f32) {
    let (middle, half) = (z_m * inverse_z, half_m * inverse_z.abs());
    (middle - half, middle + half)
}

/// Range of the first contact, given where the ray enters and leaves; 0 from inside.
#[inline(always)]
fn contact(enter: f32, leave: f32, possible: bool) -> f32 {
    if possible & (enter <= leave) & (leave >= 0.0) {
        greater(enter, 0.0)
    } else {
        MISS
    }
}

/// A box relative to the sensor, in the box's own axes.
#[derive(Clone, Copy)]
pub(crate) struct CuboidLeaf {
    pub(crate) centre_m: [f32; 3],
    pub(crate) half_m: [f32; 3],
    pub(crate) sin_yaw: f32,
    pub(crate) cos_yaw: f32,
    pub(crate) nearest_m: f32,
}

impl CuboidLeaf {
    /// Where its centre is along a normal, and how far it extends from there.
    #[inline(always)]
    pub(crate) fn extents_m(&self, [x, y, z]: [f32; 3]) -> (f32, f32) {
        let (along, across) = (self.cos_yaw * x + self.sin_yaw * y, self.cos_yaw * y - self.sin_yaw * x);
        (
            along * self.centre_m[0] + across * self.centre_m[1] + z * self.centre_m[2],
            along.abs() * self.half_m[0] + across.abs() * self.half_m[1] + z.abs() * self.half_m[2],
        )
    }

    /// Slab test (Kay and Kajiya 1986).
    #[inline(always)]
    pub(crate) fn range_m(&self, ray: &Ray) -> f32 {
        let along = nonzero(self.cos_yaw * ray.x + self.sin_yaw * ray.y);
        let across = nonzero(self.cos_yaw * ray.y - self.sin_yaw * ray.x);
        let (enter_x, leave_x) = between_faces(self.centre_m[0], self.half_m[0], 1.0 / along);
        let (enter_y, leave_y) = between_faces(self.centre_m[1], self.half_m[1], 1.0 / across);
        let (enter_z, leave_z) = between_faces(self.centre_m[2], self.half_m[2], ray.inverse_z);
        contact(
            greater(greater(enter_x, enter_y), enter_z),
            lesser(lesser(leave_x, leave_y), leave_z),
            true,
        )
    }
}

/// An upright cylinder relative to the sensor.
#[derive(Clone, Copy)]
pub(crate) struct CylinderLeaf {
    pub(crate) centre_m: [f32; 3],
    pub(crate) radius2_m2: f32,
    pub(crate) half_height_m: f32,
    pub(crate) radius_m: f32,
    pub(crate) nearest_m: f32,
}

impl CylinderLeaf {
    /// As a cuboid's.
    #[inline(always)]
    pub(crate) fn extents_m(&self, [x, y, z]: [f32; 3]) -> (f32, f32) {
        (
            x * self.centre_m[0] + y * self.centre_m[1] + z * self.centre_m[2],
            (x * x + y * y).sqrt() * self.radius_m + z.abs() * self.half_height_m,
        )
    }

    /// The circle's equation in the plan view, in the form that keeps its precision at a distance (the cross product is the
    /// distance from the axis times the plan length), and the slab between the faces.
    #[inline(always)]
    pub(crate) fn range_m(&self, ray: &Ray) -> f32 {
        let [x, y, z] = self.centre_m;
        let along = x * ray.x + y * ray.y;
        let across = x * ray.y - y * ray.x;
        let discriminant = self.radius2_m2 * ray.plan2 - across * across;
        let root = greater(discriminant, 0.0).sqrt();
        let (enter_z, leave_z) = between_faces(z, self.half_height_m, ray.inverse_z);
        contact(
            greater((along - root) * ray.inverse_plan2, enter_z),
            lesser((along + root) * ray.inverse_plan2, leave_z),
            discriminant >= 0.0,
        )
    }
}

/// A solid relative to the sensor.
#[derive(Clone, Copy)]
pub(crate) enum Leaf {
    Cuboid(CuboidLeaf),
    Cylinder(CylinderLeaf),
}

impl Leaf {
    /// The leaf of a solid as seen from a sensor position.
    pub(crate) fn of(solid: &Solid, sensor_ned_m: NedVector) -> Self {
        let (centre_ned_m, half_m, yaw_rad) = solid.parts();
        let [x, y, z] = (centre_ned_m - sensor_ned_m).to_array();
        let Some(yaw_rad) = yaw_rad else {
            let [radius_m, _, half_height_m] = half_m;
            return Self::Cylinder(CylinderLeaf {
                centre_m: [x, y, z],
                radius2_m2: radius_m * radius_m,
                half_height_m,
                radius_m,
                nearest_m: nearest_m(libm::hypotf(x, y) - radius_m),
            });
        };
        let (sin_yaw, cos_yaw) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        let centre_m = [cos_yaw * x + sin_yaw * y, cos_yaw * y - sin_yaw * x, z];
        let beside_m = [0, 1].map(|k| greater(centre_m[k].abs() - half_m[k], 0.0));
        Self::Cuboid(CuboidLeaf {
            centre_m,
            half_m,
            sin_yaw,
            cos_yaw,
            nearest_m: nearest_m(libm::hypotf(beside_m[0], beside_m[1])),
        })
    }

    /// What no range of it is shorter than, metres.
    pub(crate) fn nearest_m(&self) -> f32 {
        match self {
            Self::Cuboid(leaf) => leaf.nearest_m,
            Self::Cylinder(leaf) => leaf.nearest_m,
        }
    }

    #[inline(always)]
    pub(crate) fn range_m(&self, ray: &Ray) -> f32 {
        match self {
            Self::Cuboid(leaf) => leaf.range_m(ray),
            Self::Cylinder(leaf) => leaf.range_m(ray),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn from_inside_the_range_is_zero() {
        let solid = Solid::cuboid((0.0, 0.0), [2.0, 2.0], [0.0, 2.0], 0.3);
        let leaf = Leaf::of(&solid, NedVector::new(0.1, 0.1, -1.0));
        assert_eq!(leaf.range_m(&Ray::new((1.0, 0.0, 0.0))), 0.0);
    }

    #[test]
    fn the_ground_is_below_and_the_ceiling_above() {
        let down = Ray::new((0.8, 0.0, 0.6));
        assert!((plane_range_m(1.5, down.inverse_z) - 2.5).abs() < 1e-6);
        assert_eq!(plane_range_m(-1.5, down.inverse_z), MISS);
        // A level ray meets the ground far beyond any sensor's reach.
        assert!(plane_range_m(1.5, Ray::new((1.0, 0.0, 0.0)).inverse_z) > 1e6);
    }
}
