//! The obstacles for display: a list of solids that the caller hands in; nothing in flight depends on it.

use crate::display::{self, map_point, timestamp};
use crate::proto::foxglove::packed_element_field::NumericType;
use crate::proto::foxglove::{
    Color, CubePrimitive, CylinderPrimitive, PackedElementField, PointCloud, Pose, Quaternion, SceneEntity,
    SceneUpdate, Vector3,
};
use serde::{Deserialize, Serialize};
use std::io;
use std::path::Path;
use vigil_types::NedVector;
use vigil_types::files::{self, FileError};

/// Solids to show around the flight.
///
/// As a file it is JSON:
/// ```json
/// { "solids": [
///     { "cuboid": { "centre_ned_m": [8, -2, -1.5], "half_extents_m": [2, 0.1, 1.5], "yaw_rad": 0.3 } },
///     { "cylinder": { "centre_ned_m": [5, 1, -2], "radius_m": 0.4, "half_height_m": 2 } }
/// ] }
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// The solids, in any order.
    pub solids: Vec<SceneSolid>,
}

/// One solid, in NED metres from home.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SceneSolid {
    /// A box that is turned about the vertical only.
    Cuboid {
        /// Centre.
        centre_ned_m: [f32; 3],
        /// Half of length, width and height. At yaw 0 length lies north and width east.
        half_extents_m: [f32; 3],
        /// Direction of the length axis, clockwise from north.
        yaw_rad: f32,
    },
    /// An upright cylinder.
    Cylinder {
        /// Centre.
        centre_ned_m: [f32; 3],
        /// Radius.
        radius_m: f32,
        /// Half of the height.
        half_height_m: f32,
    },
}

/// A scene of a thousand obstacles has 200 kB.
const SIZE_LIMIT: u64 = 16 << 20;

/// Why a scene could not be read or written. Of a file that is no scene it names line, column and field, or the number that no solid
/// can have.
#[derive(Debug, thiserror::Error)]
#[error("scene file {0}")]
pub struct SceneError(#[from] FileError);

impl Scene {
    /// Reads a scene file.
    ///
    /// # Errors
    /// [`SceneError`] when the file is missing, unreadable or not a scene.
    pub fn load(path: &Path) -> Result<Self, SceneError> {
        let wrong = |text: String| files::at(path)(io::Error::other(text));
        let text = files::read_text(path, SIZE_LIMIT).map_err(files::at(path))?;
        let scene: Self = serde_json::from_str(&text).map_err(|error| {
            let form = "expected { \"solids\": [ { \"cuboid\": {…} }, { \"cylinder\": {…} } ] }";
            wrong(format!("{error}; {form}"))
        })?;
        let mut solids = scene.solids.iter().enumerate();
        match solids.find_map(|(index, solid)| Some(format!("solid {index} has {}", solid.defect()?))) {
            Some(text) => Err(wrong(text).into()),
            None => Ok(scene),
        }
    }

    /// Writes a scene file.
    ///
    /// # Errors
    /// [`SceneError`] when the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), SceneError> {
        let text = serde_json::to_string_pretty(self).map_err(io::Error::other);
        let saved = text.and_then(|text| files::replace(path, (text + "\n").as_bytes(), files::Access::Shared));
        Ok(saved.map_err(files::at(path))?)
    }

    /// The solids as one entity of a 3D view, in the z-up `map` frame.
    pub(crate) fn to_update(&self, at_ns: u64) -> SceneUpdate {
        let mut entity = SceneEntity {
            timestamp: timestamp(at_ns),
            frame_id: crate::display::MAP_FRAME.to_owned(),
            id: "obstacles".to_owned(),
            ..Default::default()
        };
        for solid in &self.solids {
            let (centre_ned_m, half_m, yaw_rad) = solid.parts();
            let (pose, size) = (Some(upright_pose(centre_ned_m, yaw_rad)), Some(size(half_m)));
            match solid {
                SceneSolid::Cuboid { .. } => entity.cubes.push(CubePrimitive {
                    pose,
                    size,
                    color: Some(color(0.55, 0.60, 0.68)),
                }),
                SceneSolid::Cylinder { .. } => entity.cylinders.push(CylinderPrimitive {
                    pose,
                    size,
                    bottom_scale: 1.0,
                    top_scale: 1.0,
                    color: Some(color(0.72, 0.54, 0.36)),
                }),
            }
        }
        SceneUpdate {
            deletions: Vec::new(),
            entities: vec![entity],
        }
    }

    /// The solids' surfaces as points in the `map` frame, for viewers that show no [`SceneUpdate`].
    pub(crate) fn to_point_cloud(&self, at_ns: u64) -> PointCloud {
        let coordinate = |name: &str, offset| PackedElementField {
            name: name.to_owned(),
            offset,
            r#type: NumericType::Float32 as i32,
        };
        let mut data = Vec::new();
        for [north, east, down] in self.solids.iter().flat_map(SceneSolid::surface_points) {
            for value in [east, north, -down] {
                data.extend(value.to_le_bytes());
            }
        }
        PointCloud {
            timestamp: timestamp(at_ns),
            frame_id: crate::display::MAP_FRAME.to_owned(),
            pose: Some(display::unturned_at(Vector3::default())),
            point_stride: 12,
            fields: vec![coordinate("x", 0), coordinate("y", 4), coordinate("z", 8)],
            data,
        }
    }
}

/// The solids of an update that [`Scene::to_update`] made.
pub(crate) fn solids_of(update: &SceneUpdate) -> Vec<SceneSolid> {
    let centre = |pose: &Pose| pose.position.map(|p| display::ned_point(p).to_array());
    let half = |size: &Vector3| [0.5 * size.x as f32, 0.5 * size.y as f32, 0.5 * size.z as f32];
    let cuboid = |cube: &CubePrimitive| {
        let pose = cube.pose?;
        let turn = pose.orientation?;
        Some(SceneSolid::Cuboid {
            centre_ned_m: centre(&pose)?,
            half_extents_m: half(&cube.size?),
            yaw_rad: (std::f64::consts::FRAC_PI_2 - 2.0 * turn.z.atan2(turn.w)) as f32,
        })
    };
    let cylinder = |cylinder: &CylinderPrimitive| {
        let [radius_m, _, half_height_m] = half(&cylinder.size?);
        Some(SceneSolid::Cylinder {
            centre_ned_m: centre(&cylinder.pose?)?,
            radius_m,
            half_height_m,
        })
    };
    let mut solids = Vec::new();
    for entity in &update.entities {
        solids.extend(entity.cubes.iter().filter_map(cuboid));
        solids.extend(entity.cylinders.iter().filter_map(cylinder));
    }
    solids
}

impl SceneSolid {
    /// Centre, half of length, width and height, and direction: a cylinder is as long and as wide as its radius says, and points north.
    pub fn parts(&self) -> ([f32; 3], [f32; 3], f32) {
        match *self {
            Self::Cuboid {
                centre_ned_m,
                half_extents_m,
                yaw_rad,
            } => (centre_ned_m, half_extents_m, yaw_rad),
            Self::Cylinder {
                centre_ned_m,
                radius_m,
                half_height_m,
            } => (centre_ned_m, [radius_m, radius_m, half_height_m], 0.0),
        }
    }

    /// The first number that is not finite or, for a size, not positive, and what is allowed.
    fn defect(&self) -> Option<String> {
        let (centre_ned_m, half_m, yaw_rad) = self.parts();
        let names = match self {
            Self::Cuboid { .. } => ["half_extents_m"; 3],
            Self::Cylinder { .. } => ["radius_m", "radius_m", "half_height_m"],
        };
        let anywhere = centre_ned_m
            .map(|v| ("centre_ned_m", v))
            .into_iter()
            .chain([("yaw_rad", yaw_rad)]);
        let endless = anywhere.map(|(field, v)| (field, v, v.is_finite(), "finite"));
        let sizes = names.into_iter().zip(half_m);
        let shapeless = sizes.map(|(field, v)| (field, v, v.is_finite() && v > 0.0, "positive"));
        let (field, value, _, expected) = endless.chain(shapeless).find(|(_, _, fits, _)| !fits)?;
        Some(format!("{field} = {value}; give a {expected} number"))
    }

    /// Points on the solid's faces (the bottom left out), NED metres: some viewers show point clouds and no solids.
    fn surface_points(&self) -> Vec<[f32; 3]> {
        let mut points = Vec::new();
        let ([north, east, down], [hx, hy, hz], yaw_rad) = self.parts();
        match self {
            Self::Cuboid { .. } => {
                let (sin, cos) = yaw_rad.sin_cos();
                let mut put = |x: f32, y: f32, z: f32| {
                    points.push([north + cos * x - sin * y, east + sin * x + cos * y, down + z])
                };
                for (x, y) in grid(hx, hy) {
                    put(x, y, -hz);
                }
                for (x, z) in grid(hx, hz) {
                    put(x, -hy, z);
                    put(x, hy, z);
                }
                for (y, z) in grid(hy, hz) {
                    put(-hx, y, z);
                    put(hx, y, z);
                }
            }
            Self::Cylinder { .. } => {
                for (angle, z) in grid(std::f32::consts::PI, hz) {
                    let (sin, cos) = angle.sin_cos();
                    points.push([north + hx * cos, east + hx * sin, down + z]);
                }
            }
        }
        points
    }
}

/// A grid over ±`half_a` × ±`half_b`, about 0.3 apart and never more than 17 × 17, so that no scene is too large.
fn grid(half_a: f32, half_b: f32) -> impl Iterator<Item = (f32, f32)> {
    let steps = |half: f32| ((half / 0.15) as u8).clamp(1, 16);
    let (na, nb) = (steps(half_a), steps(half_b));
    let at = |i: u8, n: u8, half: f32| half * (2.0 * f32::from(i) / f32::from(n) - 1.0);
    (0..=na).flat_map(move |i| (0..=nb).map(move |j| (at(i, na, half_a), at(j, nb, half_b))))
}

fn color(r: f64, g: f64, b: f64) -> Color {
    Color { r, g, b, a: 0.9 }
}

fn size(half_m: [f32; 3]) -> Vector3 {
    let [x, y, z] = half_m.map(|half| 2.0 * f64::from(half));
    Vector3 { x, y, z }
}

/// A solid's pose in the map frame: its length axis points `yaw_rad` clockwise from north, which is π/2 − yaw
/// counter-clockwise from east.
fn upright_pose(centre_ned_m: [f32; 3], yaw_rad: f32) -> Pose {
    let [north, east, down] = centre_ned_m;
    let half = 0.5 * (std::f64::consts::FRAC_PI_2 - f64::from(yaw_rad));
    Pose {
        position: Some(map_point(NedVector::new(north, east, down))),
        orientation: Some(Quaternion {
            z: half.sin(),
            w: half.cos(),
            ..display::UNTURNED
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> Scene {
        let text = r#"{ "solids": [
            { "cuboid": { "centre_ned_m": [8, -2, -1.5], "half_extents_m": [2, 0.1, 1.5], "yaw_rad": 1.5707964 } },
            { "cylinder": { "centre_ned_m": [5, 1, -2], "radius_m": 0.4, "half_height_m": 2 } }
        ] }"#;
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn a_saved_scene_is_read_back_and_a_wrong_one_names_line_and_field() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.json");
        scene().save(&path).unwrap();
        assert_eq!(Scene::load(&path).unwrap(), scene());

        std::fs::write(&path, "{ \"solids\": [\n{ \"cylinder\": { \"radius\": 1 } } ] }").unwrap();
        let error = Scene::load(&path).unwrap_err().to_string();
        assert!(error.contains("radius") && error.contains("line 2"), "{error}");
        std::fs::write(
            &path,
            r#"{ "solids": [ { "cylinder": { "centre_ned_m": [0, 0, 1], "radius_m": 0, "half_height_m": 1 } } ] }"#,
        )
        .unwrap();
        let error = Scene::load(&path).unwrap_err().to_string();
        assert!(
            error.contains("solid 0 has radius_m = 0; give a positive number"),
            "{error}"
        );
        let error = Scene::load(&dir.path().join("none.json")).unwrap_err().to_string();
        assert!(error.contains("none.json: No such file"), "{error}");
    }

    #[test]
    fn a_wall_along_east_is_long_along_the_maps_x_axis() {
        let update = scene().to_update(0);
        let wall = update.entities[0].cubes[0];
        let (position, turn) = (
            wall.pose.unwrap().position.unwrap(),
            wall.pose.unwrap().orientation.unwrap(),
        );
        assert_eq!((position.x, position.y, position.z), (-2.0, 8.0, 1.5));
        assert!((turn.w - 1.0).abs() < 1e-6 && turn.z.abs() < 1e-6, "{turn:?}");
        assert_eq!(wall.size.unwrap().x, 4.0);
        assert_eq!(update.entities[0].cylinders[0].size.unwrap().z, 4.0);
    }

    #[test]
    fn the_points_lie_on_the_solids_faces() {
        let solid = SceneSolid::Cuboid {
            centre_ned_m: [8.0, -2.0, -1.5],
            half_extents_m: [2.0, 0.1, 1.5],
            yaw_rad: 0.7,
        };
        let (sin, cos) = 0.7_f32.sin_cos();
        for [north, east, down] in solid.surface_points() {
            let (n, e) = (north - 8.0, east + 2.0);
            // Back into the box's own axes, as shares of its half extents.
            let shares = [(cos * n + sin * e) / 2.0, (cos * e - sin * n) / 0.1, (down + 1.5) / 1.5];
            let largest = shares.into_iter().fold(0.0, |m: f32, s| m.max(s.abs()));
            assert!((largest - 1.0).abs() < 1e-4, "{shares:?}");
        }
        let cylinder = scene().solids[1];
        assert!(cylinder.surface_points().len() > 100);
        for [north, east, down] in cylinder.surface_points() {
            assert!(((north - 5.0).hypot(east - 1.0) - 0.4).abs() < 1e-5 && (down + 2.0).abs() <= 2.0);
        }
        let cloud = scene().to_point_cloud(0);
        let points: usize = scene().solids.iter().map(|s| s.surface_points().len()).sum();
        assert_eq!(cloud.data.len(), 12 * points);
        let huge = SceneSolid::Cylinder {
            centre_ned_m: [0.0; 3],
            radius_m: f32::INFINITY,
            half_height_m: f32::NAN,
        };
        assert!(huge.surface_points().len() < 300);
    }
}
