//! Wires, cables and branches: thin, straight, in any direction. To be seen and touched each is a closed prism of six sides, within 7.2 % of its
//! radius (3.6 mm of the thickest), in one surface with all others of its course.

use crate::world::check::{FieldProblem, ends, within};
use crate::world::course::Course;
use crate::world::mesh::{Surface, standing};
use crate::world::solid::Solid;
use glamx::Vec3;
use std::sync::Arc;
use vigil_types::settings;
use vigil_types::settings::required;

settings! {
    /// A straight wire.
    #[derive(Copy)]
    pub struct Wire {
        /// One end, `[north, east, height above ground]`.
        pub from_m: [f32; 3] = required(),
        /// Other end.
        pub to_m: [f32; 3] = required(),
        /// Radius, 0.005 to 0.05 m.
        pub radius_m: f32 = required(),
    }
}

const SIDES: usize = 6;
/// The radius through the prism's corners of one through corners and sides in the mean: 2 / (1 + cos 30°).
const CORNER: f32 = 1.071_797;

impl Wire {
    fn ends(&self) -> [Vec3; 2] {
        [self.from_m, self.to_m].map(|[north_m, east_m, height_m]| Vec3::new(north_m, east_m, -height_m))
    }

    /// Its triangles, NED.
    fn triangles(&self) -> Vec<[[f32; 3]; 3]> {
        let ends = self.ends();
        let along = (ends[1] - ends[0]).normalize();
        let (u, v) = along.any_orthonormal_pair();
        let corner = |end: usize, side: usize| {
            let angle_rad = (side % SIDES) as f32 * core::f32::consts::TAU / SIDES as f32;
            let out = u * libm::cosf(angle_rad) + v * libm::sinf(angle_rad);
            (ends[end] + CORNER * self.radius_m * out).to_array()
        };
        let middles = ends.map(|end| end.to_array());
        (0..SIDES)
            .flat_map(|side| {
                let [a, b] = [0, 1].map(|end| corner(end, side));
                let [c, d] = [0, 1].map(|end| corner(end, side + 1));
                [[a, c, d], [a, d, b], [middles[0], c, a], [middles[1], b, d]]
            })
            .collect()
    }

    /// Boxes along it that rise by no more than 20 cm each, for pictures.
    pub fn boxes(&self) -> impl Iterator<Item = Solid> {
        let low_m = self.from_m[2].min(self.to_m[2]);
        let rise_m = (self.to_m[2] - self.from_m[2]).abs();
        let count = (rise_m / 0.2) as usize + 1;
        let height_m = move |k: usize| low_m + rise_m * k as f32 / count as f32;
        (0..count).filter_map(move |k| self.between(height_m(k), height_m(k + 1)))
    }

    /// The box, turned with it, around what of it lies between two heights.
    pub(crate) fn between(&self, low_m: f32, high_m: f32) -> Option<Solid> {
        let [from_m, to_m] = [self.from_m[2], self.to_m[2]];
        let (lowest_m, highest_m) = (low_m - self.radius_m, high_m + self.radius_m);
        if from_m == to_m {
            return (lowest_m < from_m && from_m < highest_m).then(|| self.part([0.0, 1.0]));
        }
        // Shares of the way at which it enters and leaves.
        let [a, b] = [lowest_m, highest_m].map(|height_m| (height_m - from_m) / (to_m - from_m));
        let part = [a.min(b).max(0.0), a.max(b).min(1.0)];
        (part[0] < part[1]).then(|| self.part(part))
    }

    /// The same or, where nothing of it lies there, the box around all of it.
    pub(crate) fn solid(&self, low_m: f32, high_m: f32) -> Solid {
        self.between(low_m, high_m).unwrap_or_else(|| self.part([0.0, 1.0]))
    }

    /// The box around what of it lies between two shares of its way.
    pub(crate) fn part(&self, shares: [f32; 2]) -> Solid {
        let [from, to] = [self.from_m, self.to_m].map(Vec3::from);
        let [a, b] = shares.map(|share| from + share * (to - from));
        let (plan, middle, r) = (b - a, 0.5 * (a + b), self.radius_m);
        let length_m = libm::hypotf(plan.x, plan.y) + 2.0 * r;
        let heights_m = [a.z.min(b.z) - r, a.z.max(b.z) + r];
        let yaw_rad = libm::atan2f(plan.y, plan.x);
        Solid::cuboid((middle.x, middle.y), [length_m, 2.0 * r], heights_m, yaw_rad)
    }

    pub(crate) fn check(&self, i: usize) -> Result<(), FieldProblem> {
        ends(&format!("wire[{i}]"), [self.from_m, self.to_m], "another")?;
        let expected = "from 0.005 to 0.05 m; what is thicker is a column or a box";
        within(&format!("wire[{i}].radius_m"), self.radius_m, 0.005..=0.05, expected)
    }
}

impl Course {
    /// What is seen and touched by its triangles: each mesh, and all wires as one.
    pub(crate) fn surfaces(&self) -> Vec<Arc<Surface>> {
        // Prisms are closed.
        let wires = standing(self.wires.iter().flat_map(Wire::triangles).collect(), 0);
        let meshes = self.meshes.iter().filter_map(|mesh| mesh.surface().cloned());
        meshes.chain(wires.map(Arc::new)).collect()
    }
}
