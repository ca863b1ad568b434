//! The forest family: trees whose branches are thinner than the LiDAR's beams are apart, and trunks that lie about.

use super::{Builder, Obstacle, cm};
use crate::world::course::{BoxObstacle, Column};
use crate::world::wire::Wire;
use core::ops::Range;
use rand::RngExt;

/// Of a branch, from 1 to 5 cm thick.
const BRANCH_RADIUS_MM: Range<f32> = 5.0..25.0;

/// Trees as close as their gap allows, two of them on the straight way.
pub(super) fn fill(b: &mut Builder) {
    for along in [0.25..0.5, 0.6..0.8] {
        b.try_to_place(|b| {
            let (north_m, east_m, _) = b.on_the_line(along.clone());
            tree(b, north_m, east_m)
        });
    }
    let area = [3.0..19.0, -8.0..8.0];
    for _ in 0..b.rng.random_range(0..4) {
        let [north_m, east_m] = b.point(&area);
        let thickness_m = b.length(0.2..0.5);
        let fallen = BoxObstacle {
            north_m,
            east_m,
            length_m: b.length(2.0..5.0),
            width_m: thickness_m,
            height_m: thickness_m,
            yaw_deg: cm(b.rng.random_range(0.0..180.0)),
        };
        b.place(Obstacle::Box(fallen));
    }
    for _ in 0..b.rng.random_range(24..40) {
        b.try_to_place(|b| {
            let [north_m, east_m] = b.point(&area);
            tree(b, north_m, east_m)
        });
    }
}

/// A trunk and its branches, some of them at the height of flight.
fn tree(b: &mut Builder, north_m: f32, east_m: f32) -> bool {
    let trunk = Column {
        north_m,
        east_m,
        radius_m: b.length(0.1..0.35),
        height_m: b.length(3.0..8.0),
    };
    let mut parts = vec![Obstacle::Column(trunk)];
    for _ in 0..b.rng.random_range(3..9) {
        let height_m = b.length(0.7..0.9 * trunk.height_m);
        let heading = b.rng.random_range(0.0..core::f32::consts::TAU);
        let length_m = trunk.radius_m + b.length(0.4..1.8);
        let rise_m = length_m * b.rng.random_range(-0.3..0.8);
        parts.push(Obstacle::Wire(Wire {
            from_m: [north_m, east_m, height_m],
            to_m: [
                cm(north_m + length_m * libm::cosf(heading)),
                cm(east_m + length_m * libm::sinf(heading)),
                cm(height_m + rise_m).max(0.1),
            ],
            radius_m: b.rng.random_range(BRANCH_RADIUS_MM).round() / 1000.0,
        }));
    }
    b.place_together(&parts)
}
