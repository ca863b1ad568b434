//! A course's obstacles in the form that the flight log shows: a mesh where it crosses the heights that a corridor needs.

use vigil_log::{Scene, SceneSolid};
use vigil_sim::world::{Course, Solid};
use vigil_types::NedVector;

/// A solid of one type as the same of the other, its centre converted.
macro_rules! same {
    ($solid:expr, $from:ident => $to:ident, $centre:expr) => {
        match $solid {
            $from::Cuboid {
                centre_ned_m,
                half_extents_m,
                yaw_rad,
            } => $to::Cuboid {
                centre_ned_m: $centre(centre_ned_m),
                half_extents_m,
                yaw_rad,
            },
            $from::Cylinder {
                centre_ned_m,
                radius_m,
                half_height_m,
            } => $to::Cylinder {
                centre_ned_m: $centre(centre_ned_m),
                radius_m,
                half_height_m,
            },
        }
    };
}

/// The obstacles for display in the log; movers stand where they are at time zero.
pub fn of(course: &Course) -> Scene {
    let movers = course.movers.iter().map(|m| m.solid_at(0));
    of_solids(course.shown_solids().into_iter().chain(movers))
}

/// Any solids in that form.
pub fn of_solids(solids: impl Iterator<Item = Solid>) -> Scene {
    let shown = |solid| same!(solid, Solid => SceneSolid, |centre: NedVector| centre.to_array());
    Scene {
        solids: solids.map(shown).collect(),
    }
}

/// A solid of the log with the world's geometry.
pub fn solid(shown: &SceneSolid) -> Solid {
    same!(*shown, SceneSolid => Solid, |[x, y, z]: [f32; 3]| NedVector::new(x, y, z))
}
