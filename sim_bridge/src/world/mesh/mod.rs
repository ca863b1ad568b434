//! Surfaces from files of others: where they stand on a course, and what of a file cannot be used.

mod formats;
mod gltf;
mod plan;
mod surface;

pub(crate) use surface::{Block, Boxes, Child, LANES, ROOT, Surface, Within};

use crate::world::check::{FieldProblem, angle, check_fields, coordinate, problem, within};
use crate::world::course::Bounds;
use crate::world::solid::{UPRIGHT, radians};
use crate::world::vehicle::VEHICLE;
use glamx::{Pose3, Vec3};
use parry3d::bounding_volume::Aabb;
use parry3d::shape::Cylinder;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use surface::Triangle;
use vigil_types::settings::{free, named_setting, required};
use vigil_types::{NedVector, settings};

/// More triangles than this are not cast.
pub const MAX_TRIANGLES: usize = 1_000_000;
/// A text file of as many triangles has 120 MB.
const SIZE_LIMIT: u64 = 256 << 20;
/// What is wider than this is hardly in metres.
const MAX_EXTENT_M: f64 = 1000.0;
/// A triangle no corner of which is higher than this is the ground, which every course has: a hall's floor is nothing to collide with.
const FLOOR_M: f32 = 0.05;

settings! {
    /// A surface from a file, as it stands on a course. It is seen and touched from both sides; what it encloses is air.
    pub struct Mesh {
        /// OBJ, STL or glTF; beside the course's file where it is not absolute, and absolute once it was read.
        pub file: PathBuf = required(),
        /// Metres of the file's unit; 0.001 for millimetres.
        pub unit_m: f32 = free(1.0),
        /// Where the file's origin is, north of home.
        pub north_m: f32 = free(0.0),
        /// East of home.
        pub east_m: f32 = free(0.0),
        /// Above ground.
        pub height_m: f32 = free(0.0),
        /// Turn about the file's origin, clockwise from above.
        pub yaw_deg: f32 = free(0.0),
        /// The file's axis that points up; if absent, z, and y of glTF.
        pub up: Option<Up> = free(None),
        ..
        /// What was read.
        surface: Option<Arc<Surface>> = None,
    }
}

/// A file's axis that points up; x always points east.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Up {
    /// And z south.
    Y,
    /// And y north.
    Z,
}

named_setting!(Up, [("y", Up::Y), ("z", Up::Z)]);

/// What is wrong with a file and what to do.
fn refused(path: &Path) -> impl FnOnce(String) -> String + '_ {
    |problem| format!("{} {problem}", path.display())
}

impl Mesh {
    /// A surface of triangles that are no file's, NED metres from home, for a world in memory.
    ///
    /// # Errors
    /// As for a file.
    pub fn of_triangles(triangles: &[[NedVector; 3]]) -> Result<Self, String> {
        let placed = triangles.iter().map(|t| t.map(|p| p.to_array())).collect();
        let file = PathBuf::from("a mesh in memory");
        let surface = Some(Arc::new(surface_of_mesh(placed).map_err(refused(&file))?));
        Ok(Self {
            surface,
            file,
            ..Self::default()
        })
    }

    /// Reads the file, which is in `folder` where its name is not absolute.
    ///
    /// # Errors
    /// The file's name and what to do.
    pub fn read(&mut self, folder: &Path) -> Result<(), String> {
        let path = folder.join(&self.file);
        self.surface = Some(Arc::new(self.surface_of(&path).map_err(refused(&path))?));
        self.file = std::path::absolute(&path).unwrap_or(path);
        Ok(())
    }

    fn surface_of(&self, path: &Path) -> Result<Surface, String> {
        let bytes = std::fs::metadata(path).map_or(0, |file| file.len());
        if bytes > SIZE_LIMIT {
            let [bytes, most] = [bytes, SIZE_LIMIT].map(|bytes| bytes >> 20);
            return Err(format!(
                "holds {bytes} MB, at most {most} MB are read; simplify it to at most {MAX_TRIANGLES} triangles"
            ));
        }
        let content = vigil_types::files::read(path, SIZE_LIMIT).map_err(|e| format!("cannot be read: {e}"))?;
        let (triangles, up) = formats::triangles(path, &content)?;
        surface_of_mesh(self.placed(&triangles, self.up.unwrap_or(up))?)
    }

    /// How many triangles stand on the course, and how many of their edges belong to one triangle alone: the rims of holes, and of
    /// what has no thickness. None before the file was read.
    pub fn triangles_and_open_edges(&self) -> Option<(usize, usize)> {
        let surface = self.surface.as_ref()?;
        Some((surface.triangles().count(), surface.open_edges))
    }

    pub(crate) fn surface(&self) -> Option<&Arc<Surface>> {
        self.surface.as_ref()
    }

    /// The file's triangles where they stand, NED.
    fn placed(&self, triangles: &[Triangle], up: Up) -> Result<Vec<Triangle>, String> {
        let unit_m = f64::from(self.unit_m);
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for (i, triangle) in triangles.iter().enumerate() {
            for (k, x) in triangle.iter().flat_map(|corner| corner.iter().enumerate()) {
                if !x.is_finite() {
                    let number = i + 1;
                    return Err(format!(
                        "has a corner that is not a number, of triangle {number}; repair the mesh and export it again"
                    ));
                }
                let x = f64::from(*x) * unit_m;
                (low[k], high[k]) = (low[k].min(x), high[k].max(x));
            }
        }
        let extent_m = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        if extent_m > MAX_EXTENT_M {
            return Err(format!(
                "is {extent_m:.0} m wide: is it in millimetres? Then unit_m = 0.001"
            ));
        }
        let farthest_m = low.into_iter().chain(high).map(f64::abs).fold(0.0, f64::max);
        if farthest_m > 2.0 * MAX_EXTENT_M {
            return Err(format!(
                "lies {farthest_m:.0} m from its file's origin; export it about its own middle"
            ));
        }
        let yaw_rad = f64::from(radians(self.yaw_deg));
        let (sin, cos) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
        let [north_m, east_m, height_m] = [self.north_m, self.east_m, self.height_m].map(f64::from);
        let place = |corner: [f32; 3]| {
            let [x, y, z] = corner.map(|x| f64::from(x) * unit_m);
            let [north, east, above] = match up {
                Up::Z => [y, x, z],
                Up::Y => [-z, x, y],
            };
            [
                (north_m + cos * north - sin * east) as f32,
                (east_m + sin * north + cos * east) as f32,
                -(height_m + above) as f32,
            ]
        };
        Ok(triangles.iter().map(|t| t.map(place)).collect())
    }

    /// Checks every value of it, and that it can be met.
    pub(crate) fn check(&self, i: usize, bounds: &Bounds) -> Result<(), FieldProblem> {
        self.check_values(i)?;
        let Some(surface) = &self.surface else {
            return problem(format!("mesh[{i}].file"), "was not read");
        };
        let (low, high) = surface.extent_ned_m();
        let apart = |axis: usize, [lowest, highest]: [f32; 2]| low[axis] > highest || high[axis] < lowest;
        if apart(0, bounds.north_m) || apart(1, bounds.east_m) || -high[2] > bounds.top_m {
            let [north, east, top] = [[low[0], high[0]], [low[1], high[1]], [-high[2], -low[2]]];
            return problem(
                format!("mesh[{i}]"),
                format!(
                    "lies wholly outside of `bounds`, north {north:?}, east {east:?}, heights {top:?} m; \
                     move it by north_m, east_m and height_m"
                ),
            );
        }
        Ok(())
    }

    /// Whether it reaches into the air over a place, as wide as the vehicle, between the ground and `top_m`.
    pub(crate) fn covers(&self, north_m: f32, east_m: f32, top_m: f32) -> bool {
        let half = Vec3::new(VEHICLE.radius_m, VEHICLE.radius_m, 0.5 * top_m);
        let centre = Vec3::new(north_m, east_m, -half.z);
        let reach = Aabb::new(centre - half, centre + half);
        let (pose, shape) = (Pose3::from_parts(centre, UPRIGHT), Cylinder::new(half.z, half.x));
        (self.surface.iter()).any(|surface| surface.touches(&pose, &shape, &reach))
    }

    pub(crate) fn check_values(&self, i: usize) -> Result<(), FieldProblem> {
        let expected = "the metres of the file's unit, from 1e-6 to 1000";
        within(&format!("mesh[{i}].unit_m"), self.unit_m, 1e-6..=1000.0, expected)?;
        check_fields!(self, format!("mesh[{i}]"), coordinate: north_m east_m height_m, angle: yaw_deg);
        Ok(())
    }
}

/// A mesh's surface of its placed triangles.
fn surface_of_mesh(placed: Vec<Triangle>) -> Result<Surface, String> {
    if placed.len() > MAX_TRIANGLES {
        let count = placed.len();
        return Err(format!(
            "has {count} triangles, at most {MAX_TRIANGLES} can be cast; simplify it"
        ));
    }
    let open_edges = surface::open_edges(&placed);
    standing(placed, open_edges)
        .ok_or_else(|| "has no triangles above the ground; raise it by height_m, or set `up`".to_owned())
}

/// What of placed triangles, which have so many open edges, stands above the ground and has an area; `None` where nothing does.
pub(crate) fn standing(mut placed: Vec<Triangle>, open_edges: usize) -> Option<Surface> {
    placed.retain(|t| t.iter().any(|p| -p[2] > FLOOR_M) && surface::has_area(t));
    (!placed.is_empty()).then(|| Surface::new(placed, open_edges))
}
