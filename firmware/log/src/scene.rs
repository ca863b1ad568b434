//! The obstacles for display: a list of solids that the caller hands in; nothing in flight depends on it.

use crate::display::{map_point, timestamp};
use foxglove::messages::{
    Color, CubePrimitive, CylinderPrimitive, Pose, Quaternion, SceneEntity, SceneUpdate, Vector3,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use vigil_types::NedVector;

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

/// Why a scene could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The file could not be read or written.
    #[error("scene file {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no scene; the message names line, column and field.
    #[error(
        "scene file {path}: {source}; expected {{ \"solids\": [ {{ \"cuboid\": {{…}} }}, {{ \"cylinder\": {{…}} }} ] }}"
    )]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        source: serde_json::Error,
    },
}

impl Scene {
    /// Reads a scene file.
    ///
    /// # Errors
    /// [`SceneError`] when the file is missing, unreadable or not a scene.
    pub fn load(path: &Path) -> Result<Self, SceneError> {
        let text = std::fs::read_to_string(path).map_err(|source| SceneError::Io {
            path: path.to_owned(),
            source,
        })?;
        serde_json::from_str(&text).map_err(|source| SceneError::Format {
            path: path.to_owned(),
            source,
        })
    }

    /// Writes a scene file.
    ///
    /// # Errors
    /// [`SceneError`] when the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), SceneError> {
        let text = serde_json::to_string_pretty(self).map_err(|source| SceneError::Format {
            path: path.to_owned(),
            source,
        })?;
        std::fs::write(path, text + "\n").map_err(|source| SceneError::Io {
            path: path.to_owned(),
            source,
        })
    }

    /// The solids as one entity of a 3D view, in the z-up `map` frame.
    pub(crate) fn to_update(&self, at_ns: u64) -> SceneUpdate {
        let mut entity = SceneEntity {
            timestamp: Some(timestamp(at_ns)),
            frame_id: crate::display::MAP_FRAME.to_owned(),
            id: "obstacles".to_owned(),
            ..Default::default()
        };
        for solid in &self.solids {
            match *solid {
                SceneSolid::Cuboid {
                    centre_ned_m,
                    half_extents_m: [hx, hy, hz],
                    yaw_rad,
                } => entity.cubes.push(CubePrimitive {
                    pose: Some(upright_pose(centre_ned_m, yaw_rad)),
                    size: Some(size(hx, hy, hz)),
                    color: Some(Color {
                        r: 0.55,
                        g: 0.60,
                        b: 0.68,
                        a: 0.9,
                    }),
                }),
                SceneSolid::Cylinder {
                    centre_ned_m,
                    radius_m,
                    half_height_m,
                } => entity.cylinders.push(CylinderPrimitive {
                    pose: Some(upright_pose(centre_ned_m, 0.0)),
                    size: Some(size(radius_m, radius_m, half_height_m)),
                    bottom_scale: 1.0,
                    top_scale: 1.0,
                    color: Some(Color {
                        r: 0.72,
                        g: 0.54,
                        b: 0.36,
                        a: 0.9,
                    }),
                }),
            }
        }
        SceneUpdate {
            deletions: Vec::new(),
            entities: vec![entity],
        }
    }
}

fn size(half_x: f32, half_y: f32, half_z: f32) -> Vector3 {
    Vector3 {
        x: 2.0 * f64::from(half_x),
        y: 2.0 * f64::from(half_y),
        z: 2.0 * f64::from(half_z),
    }
}

/// A solid's pose in the map frame: its length axis points `yaw_rad` clockwise from north, which is π/2 − yaw
/// counter-clockwise from east.
fn upright_pose(centre_ned_m: [f32; 3], yaw_rad: f32) -> Pose {
    let [north, east, down] = centre_ned_m;
    let half = 0.5 * (std::f64::consts::FRAC_PI_2 - f64::from(yaw_rad));
    Pose {
        position: Some(map_point(NedVector::new(north, east, down))),
        orientation: Some(Quaternion {
            x: 0.0,
            y: 0.0,
            z: half.sin(),
            w: half.cos(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> Scene {
        Scene {
            solids: vec![
                SceneSolid::Cuboid {
                    centre_ned_m: [8.0, -2.0, -1.5],
                    half_extents_m: [2.0, 0.1, 1.5],
                    yaw_rad: std::f32::consts::FRAC_PI_2,
                },
                SceneSolid::Cylinder {
                    centre_ned_m: [5.0, 1.0, -2.0],
                    radius_m: 0.4,
                    half_height_m: 2.0,
                },
            ],
        }
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
        assert!(matches!(
            Scene::load(&dir.path().join("none.json")),
            Err(SceneError::Io { .. })
        ));
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
}
