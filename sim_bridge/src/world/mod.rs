//! Courses, ray casting, collision and the LiDAR that looks at them.
//!
//! ```
//! use vigil_sim::world::{Family, World, generate};
//!
//! let course = generate(Family::Validation, 7);
//! let world = World::new(&course);
//! assert!(world.clearance_m(course.start_ned_m()) > 1.0);
//! ```

mod check;
mod corridor;
mod course;
mod course_file;
mod draw;
mod generate;
mod lidar;
mod mesh;
mod mover;
mod referee;
mod solid;
mod space;
mod timed_way;
mod vehicle;
mod wire;

pub use check::{FieldProblem, MAX_COORDINATE_M, MAX_OBSTACLES, MAX_WIRES};
pub(crate) use corridor::Lattice;
pub use corridor::{CORRIDOR_MARGIN_M, HARD_CORRIDOR_MARGIN_M};
pub use course::{Bounds, BoxObstacle, Checkpoint, Column, Course, Family, GoalPoint, Overhang, Start, Wall};
pub use course_file::CourseError;
pub use draw::{FlightPath, Image, ImageError, check_png_name, draw, draw_svg};
pub use generate::{LONG_GOAL_M, generate, generate_long};
pub(crate) use lidar::ZoneSensor;
pub use lidar::{
    LIDAR_BEAMS, LIDAR_FIRINGS, LIDAR_RINGS, Lidar, LidarConfig, LidarConfigError, Ranges, Shot, beam_direction_frd,
    ring_row, split_mix,
};
pub use mesh::{MAX_TRIANGLES, Mesh, Up};
pub use mover::{BoxOutline, ColumnOutline, MAX_MOVER_SPEED_M_S, Mover, MoverShape};
pub use referee::{GROUND_CRASH_SPEED_M_S, Outcome, Referee};
pub(crate) use solid::Rectangle;
pub use solid::Solid;
pub use space::World;
pub use vehicle::{VEHICLE, VehicleSolid};
pub use wire::Wire;
