//! The geometric pilot and its parts: what a frame shows by direction, the grid of what was seen, the way through it, the limit of
//! the speed; and the recovery pilot, which is built from the same parts.

mod evasion;
mod forward_check;
mod governor;
pub mod movers;
mod occupancy_grid;
mod path_planner;
mod pilot;
pub mod range_scan;
mod recovery;
pub mod track;

pub use forward_check::{Aside, ForwardCheck};
pub use occupancy_grid::{CELL_M, HIT, OccupancyGrid, SCORE_LIMIT, SIDE};
pub(crate) use pilot::position_ned_m;
pub use pilot::{GeometricConfig, GeometricPilot};
pub use range_scan::{RangeScan, Scan};
pub use recovery::RecoveryPilot;
