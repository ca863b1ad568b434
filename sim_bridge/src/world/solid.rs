//! The shapes a course is made of, and distances to them.

use glamx::{Pose3, Quat, Vec3};
use parry3d::shape::SharedShape;
use vigil_types::NedVector;

/// An obstacle as plain geometry, in NED metres from home. Cuboids turn about the vertical only; cylinders stand upright.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// A box.
    Cuboid {
        /// Centre.
        centre_ned_m: NedVector,
        /// Half of length, width and height. At yaw 0 length lies north and width east.
        half_extents_m: [f32; 3],
        /// Direction of the length axis, clockwise from north.
        yaw_rad: f32,
    },
    /// An upright cylinder.
    Cylinder {
        /// Centre.
        centre_ned_m: NedVector,
        /// Radius.
        radius_m: f32,
        /// Half of the height.
        half_height_m: f32,
    },
}

/// Degrees to radians.
pub(crate) fn radians(degrees: f32) -> f32 {
    degrees * (core::f32::consts::PI / 180.0)
}

impl Solid {
    /// A box that stands on `bottom_m` and ends at `top_m` (heights above ground).
    pub(crate) fn cuboid(
        (north_m, east_m): (f32, f32),
        [length_m, width_m]: [f32; 2],
        [bottom_m, top_m]: [f32; 2],
        yaw_rad: f32,
    ) -> Self {
        Self::Cuboid {
            centre_ned_m: NedVector::new(north_m, east_m, -0.5 * (bottom_m + top_m)),
            half_extents_m: [0.5 * length_m, 0.5 * width_m, 0.5 * (top_m - bottom_m)],
            yaw_rad,
        }
    }

    /// An upright cylinder on the ground.
    pub(crate) fn cylinder((north_m, east_m): (f32, f32), radius_m: f32, height_m: f32) -> Self {
        Self::Cylinder {
            centre_ned_m: NedVector::new(north_m, east_m, -0.5 * height_m),
            radius_m,
            half_height_m: 0.5 * height_m,
        }
    }

    /// A box on the ground along a line, at each end so much longer than that.
    pub(crate) fn along(from_m: [f32; 2], to_m: [f32; 2], longer_m: f32, width_m: f32, height_m: f32) -> Self {
        let [north, east] = [0, 1].map(|k| to_m[k] - from_m[k]);
        let middle_m = (0.5 * (from_m[0] + to_m[0]), 0.5 * (from_m[1] + to_m[1]));
        let length_m = libm::hypotf(north, east) + 2.0 * longer_m;
        let yaw_rad = libm::atan2f(east, north);
        Self::cuboid(middle_m, [length_m, width_m], [0.0, height_m], yaw_rad)
    }

    /// Its centre, half of its size along its own axes, and a cuboid's yaw.
    pub(crate) fn parts(&self) -> (NedVector, [f32; 3], Option<f32>) {
        match *self {
            Self::Cuboid {
                centre_ned_m,
                half_extents_m,
                yaw_rad,
            } => (centre_ned_m, half_extents_m, Some(yaw_rad)),
            Self::Cylinder {
                centre_ned_m,
                radius_m,
                half_height_m,
            } => (centre_ned_m, [radius_m, radius_m, half_height_m], None),
        }
    }

    /// Centre, NED metres.
    pub fn centre_ned_m(&self) -> NedVector {
        self.parts().0
    }

    fn half_height_m(&self) -> f32 {
        self.parts().1[2]
    }

    /// Height of the lowest face above ground.
    pub fn bottom_m(&self) -> f32 {
        -self.centre_ned_m().z - self.half_height_m()
    }

    /// Height of the highest face above ground.
    pub fn top_m(&self) -> f32 {
        -self.centre_ned_m().z + self.half_height_m()
    }

    /// Whether any of it lies between two heights above ground.
    pub(crate) fn reaches_into(&self, [low_m, high_m]: [f32; 2]) -> bool {
        self.bottom_m() < high_m && self.top_m() > low_m
    }

    /// Distance in the plan view from a point to the solid's outline; negative inside.
    pub fn plan_distance_m(&self, north_m: f32, east_m: f32) -> f32 {
        self.plan_distances_m()(north_m, east_m)
    }

    /// [`plan_distance_m`](Self::plan_distance_m) for many points: what does not depend on the point is computed once.
    pub(crate) fn plan_distances_m(&self) -> impl Fn(f32, f32) -> f32 + use<> {
        let (centre, [hx, hy, _], yaw_rad) = self.parts();
        let (s, c) = yaw_rad.map_or((0.0, 1.0), |yaw_rad| (libm::sinf(yaw_rad), libm::cosf(yaw_rad)));
        move |north_m, east_m| {
            let (x, y) = (north_m - centre.x, east_m - centre.y);
            if yaw_rad.is_none() {
                return libm::hypotf(x, y) - hx;
            }
            let qx = (c * x + s * y).abs() - hx;
            let qy = (c * y - s * x).abs() - hy;
            libm::hypotf(qx.max(0.0), qy.max(0.0)) + qx.max(qy).min(0.0)
        }
    }

    /// Distance from a point to the solid; 0 inside.
    pub fn distance_m(&self, point_ned_m: NedVector) -> f32 {
        let plan = self.plan_distance_m(point_ned_m.x, point_ned_m.y).max(0.0);
        let vertical = ((point_ned_m.z - self.centre_ned_m().z).abs() - self.half_height_m()).max(0.0);
        libm::hypotf(plan, vertical)
    }

    /// Gap between the outlines of two solids in the plan view; 0 or less where they overlap.
    pub fn plan_gap_m(&self, other: &Self) -> f32 {
        let (centre, other_centre) = (self.centre_ned_m(), other.centre_ned_m());
        match (self.plan_rectangle(), other.plan_rectangle()) {
            (_, None) => self.plan_distance_m(other_centre.x, other_centre.y) - other.plan_half_extents_m().0,
            (None, _) => other.plan_distance_m(centre.x, centre.y) - self.plan_half_extents_m().0,
            (Some(a), Some(b)) if a.overlaps(&b) => 0.0,
            // Two convex outlines that do not overlap are nearest at a corner of one of them.
            (Some(a), Some(b)) => {
                let to_other = a.corners().map(|[n, e]| other.plan_distance_m(n, e));
                let to_self = b.corners().map(|[n, e]| self.plan_distance_m(n, e));
                to_other.into_iter().chain(to_self).fold(f32::INFINITY, f32::min)
            }
        }
    }

    /// The outline of a cuboid in the plan view.
    pub(crate) fn plan_rectangle(&self) -> Option<Rectangle> {
        let (centre, [length, width, _], yaw_rad) = self.parts();
        yaw_rad.map(|yaw_rad| Rectangle {
            centre: [centre.x, centre.y],
            half_m: [length, width],
            along: [libm::cosf(yaw_rad), libm::sinf(yaw_rad)],
        })
    }

    /// Half extents of the plan view's bounding box: (north, east).
    pub fn plan_half_extents_m(&self) -> (f32, f32) {
        let (_, [hx, hy, _], yaw_rad) = self.parts();
        yaw_rad.map_or((hx, hy), |yaw_rad| {
            let (s, c) = (libm::sinf(yaw_rad).abs(), libm::cosf(yaw_rad).abs());
            (c * hx + s * hy, s * hx + c * hy)
        })
    }

    /// The same solid as a parry shape at its pose; the geometry behind collision and the tree's boxes.
    pub(crate) fn shape(&self) -> (Pose3, SharedShape) {
        let (centre, [hx, hy, hz], yaw_rad) = self.parts();
        let at = Vec3::from(centre.to_array());
        match yaw_rad.map(|yaw_rad| 0.5 * yaw_rad) {
            Some(half) => {
                let turn = Quat::from_xyzw(0.0, 0.0, libm::sinf(half), libm::cosf(half));
                (Pose3::from_parts(at, turn), SharedShape::cuboid(hx, hy, hz))
            }
            None => (Pose3::from_parts(at, UPRIGHT), SharedShape::cylinder(hz, hx)),
        }
    }
}

/// A turned rectangle, north and east in metres.
#[derive(Clone, Copy)]
pub(crate) struct Rectangle {
    pub(crate) centre: [f32; 2],
    /// Half of its size along its direction and across it.
    pub(crate) half_m: [f32; 2],
    /// Cosine and sine of the direction.
    pub(crate) along: [f32; 2],
}

impl Rectangle {
    /// From the centre to the middle of two neighbouring sides.
    fn half_axes(&self) -> [[f32; 2]; 2] {
        let ([length, width], [c, s]) = (self.half_m, self.along);
        [[length * c, length * s], [-width * s, width * c]]
    }

    /// The corners, going round.
    pub(crate) fn corners(&self) -> [[f32; 2]; 4] {
        let [u, v] = self.half_axes();
        [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]
            .map(|(i, j)| [0, 1].map(|k| self.centre[k] + i * u[k] + j * v[k]))
    }

    /// Separating axis test.
    fn overlaps(&self, other: &Self) -> bool {
        let dot = |a: [f32; 2], b: [f32; 2]| a[0] * b[0] + a[1] * b[1];
        let between = [0, 1].map(|k| other.centre[k] - self.centre[k]);
        let (ours, theirs) = (self.half_axes(), other.half_axes());
        ours.iter().chain(&theirs).all(|axis| {
            let reach = |[u, v]: [[f32; 2]; 2]| dot(u, *axis).abs() + dot(v, *axis).abs();
            dot(between, *axis).abs() <= reach(ours) + reach(theirs)
        })
    }
}

/// Turns parry's cylinder axis (y) into the vertical (z): a quarter turn about x.
pub(crate) const UPRIGHT: Quat = Quat::from_xyzw(
    core::f32::consts::FRAC_1_SQRT_2,
    0.0,
    0.0,
    core::f32::consts::FRAC_1_SQRT_2,
);

#[cfg(test)]
mod tests {
    use super::*;
    use parry3d::query::details::distance_support_map_support_map;

    #[test]
    fn distances_agree_with_parry() {
        let solids = [
            // A wall whose length lies east.
            Solid::cuboid((5.0, 0.0), [4.0, 0.2], [0.0, 3.0], core::f32::consts::FRAC_PI_2),
            Solid::cuboid((3.0, -2.0), [1.0, 2.0], [1.0, 1.8], 0.7),
            Solid::cylinder((-2.0, 4.0), 0.4, 3.0),
        ];
        for solid in solids {
            let (pose, shape) = solid.shape();
            for k in 0..200 {
                let f = k as f32;
                let p = NedVector::new(
                    6.0 * libm::sinf(f),
                    6.0 * libm::cosf(1.7 * f),
                    -2.0 + 2.0 * libm::sinf(0.3 * f),
                );
                let theirs = shape.distance_to_point(&pose, Vec3::new(p.x, p.y, p.z), true);
                assert!((solid.distance_m(p) - theirs).abs() < 1e-4, "{solid:?} {p:?} {theirs}");
            }
        }
    }

    #[test]
    fn gaps_in_the_plan_view_are_the_least_distances_between_outlines() {
        let (mut apart, mut together) = (0, 0);
        for k in 0..90 {
            let f = k as f32;
            let solids = [0.0, 100.0].map(|shift| {
                let g = f + shift;
                let (north, east) = (1.6 * libm::sinf(1.3 * g), 1.6 * libm::cosf(2.1 * g));
                if k % 3 == 0 && shift > 0.0 {
                    Solid::cylinder((north, east), 0.2 + 0.3 * libm::sinf(g).abs(), 2.0)
                } else {
                    Solid::cuboid((north, east), [3.0, 0.2 + libm::cosf(g).abs()], [0.0, 2.0], g)
                }
            });
            // All are of one height, so that a gap is a distance; parry's own of two cuboids errs.
            let [(pose, shape), (other_pose, other)] = solids.map(|solid| solid.shape());
            let [shape, other] = [&shape, &other].map(|shape| shape.as_support_map().expect("convex"));
            let expected = distance_support_map_support_map(&pose.inv_mul(&other_pose), shape, other);
            let ours = solids[0].plan_gap_m(&solids[1]);
            assert!((ours.max(0.0) - expected).abs() < 0.01, "{solids:?}: {ours} {expected}");
            assert_eq!(ours, solids[1].plan_gap_m(&solids[0]));
            *(if expected == 0.0 { &mut together } else { &mut apart }) += 1;
        }
        assert!(apart > 30 && together > 15, "{apart} {together}");
    }
}
