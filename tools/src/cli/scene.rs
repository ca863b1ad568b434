//! A course's obstacles in the form that the flight log shows: a mesh where it crosses the heights that a corridor needs.

use vigil_log::{Scene, SceneSolid};
use vigil_sim::world::{Course, Solid};

/// The obstacles for display in the log; movers stand where they are at time zero.
pub fn of(course: &Course) -> Scene {
    let movers = course.movers.iter().map(|m| m.solid_at(0));
    of_solids(course.shown_solids().into_iter().chain(movers))
}

/// Any solids in that form.
pub fn of_solids(solids: impl Iterator<Item = Solid>) -> Scene {
    let solids = solids
        .map(|solid| match solid {
            Solid::Cuboid {
                centre_ned_m,
                half_extents_m,
                yaw_rad,
            } => SceneSolid::Cuboid {
                centre_ned_m: centre_ned_m.to_array(),
                half_extents_m,
                yaw_rad,
            },
            Solid::Cylinder {
                centre_ned_m,
                radius_m,
                half_height_m,
            } => SceneSolid::Cylinder {
                centre_ned_m: centre_ned_m.to_array(),
                radius_m,
                half_height_m,
            },
        })
        .collect();
    Scene { solids }
}
