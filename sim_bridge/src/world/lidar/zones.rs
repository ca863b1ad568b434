//! Small time-of-flight sensors of 8 × 8 zones that look ahead, as they are sold for a few euros: 45° × 45° each, 4 m, 15 Hz. One, or several side
//! by side.
//!
//! Each zone measures its nearest surface. Its driver knows the vehicle's attitude and keeps what is at the vehicle's own height, so that neither
//! the ground nor a ceiling counts: one horizontal distance a column, as OBSTACLE_DISTANCE has them.

use super::cast::cast_ray;
use super::noise::{NoiseKeys, SPREAD};
use super::scene::Scene;
use crate::world::World;
use vigil_autopilot::ZoneRanges;
use vigil_types::{Attitude, FrdVector, Nanos, NedVector, RANGE_SECTORS};

/// Columns of one sensor's zones, and rows.
const ZONE_COLUMNS: usize = 8;
/// Most sensors side by side.
const ZONE_MOST_HEADS: usize = 5;
/// Field of view of one, each way, radians.
const ZONE_FOV_RAD: f32 = core::f32::consts::FRAC_PI_4;
/// Nothing farther away is measured.
const ZONE_MAX_RANGE_M: f32 = 4.0;
/// Between two measurements: 15 Hz.
const ZONE_INTERVAL_NS: Nanos = 66_666_667;
/// Rays across a zone, each way: it measures the nearest of what they meet.
const RAYS: usize = 3;
/// Standard deviation of a range: 2 cm and 1 % of it.
const SIGMA_M: f32 = 0.02;
const SIGMA_SHARE: f32 = 0.01;
/// One zone in a hundred has no return.
const DROPOUT: u32 = u32::MAX / 100;
/// What is higher or lower than the vehicle by more than this is in nobody's way, metres: as the pilots have it
/// (`vigil_policy::geometric`'s band of height).
const BAND_HALF_HEIGHT_M: f32 = 0.35;

/// The sensor.
pub(crate) struct ZoneSensor {
    seed: u64,
    heads: usize,
    sequence: u64,
    due_ns: Nanos,
    scene: Scene,
}

impl ZoneSensor {
    /// So many side by side, at most [`ZONE_MOST_HEADS`], the middle of all straight ahead; the seed fixes their noise.
    pub(crate) fn new(seed: u64, heads: usize) -> Self {
        Self {
            heads: heads.min(ZONE_MOST_HEADS),
            // Not the LiDAR's noise again.
            seed: seed ^ 0x5A4F_4E45,
            sequence: 0,
            due_ns: 0,
            scene: Scene::default(),
        }
    }

    /// Measures when it is time: the horizontal distance of the nearest surface at the vehicle's height in each column of all sensors, left to
    /// right, infinite where none is within reach.
    pub(crate) fn measure(
        &mut self,
        now_ns: Nanos,
        world: &World,
        position_ned_m: NedVector,
        attitude: Attitude,
    ) -> Option<ZoneRanges> {
        if now_ns < self.due_ns {
            return None;
        }
        self.due_ns += ZONE_INTERVAL_NS;
        self.scene.place(world, position_ned_m, attitude);
        self.sequence += 1;
        let keys = NoiseKeys::new(self.seed, self.sequence);
        let yaw_rad = attitude.yaw_rad();
        let (columns, fov_rad) = (self.heads * ZONE_COLUMNS, self.heads as f32 * ZONE_FOV_RAD);
        let mut nearest_m = [f32::INFINITY; RANGE_SECTORS];
        for zone in 0..ZONE_COLUMNS * columns {
            let (row, column) = (zone / columns, zone % columns);
            // The nearest of its rays that meets something at the vehicle's height, as range and direction.
            let mut nearest: Option<(f32, NedVector)> = None;
            for ray in 0..RAYS * RAYS {
                let angle_rad = |zone: usize, ray: usize, zones: usize, fov_rad: f32| {
                    let place = (zone * RAYS + ray) as f32 + 0.5;
                    (place / (zones * RAYS) as f32 - 0.5) * fov_rad
                };
                let bearing_rad = angle_rad(column, ray % RAYS, columns, fov_rad);
                let depression_rad = angle_rad(row, ray / RAYS, ZONE_COLUMNS, ZONE_FOV_RAD);
                let direction = attitude.to_ned(FrdVector::new(
                    libm::cosf(depression_rad) * libm::cosf(bearing_rad),
                    libm::cosf(depression_rad) * libm::sinf(bearing_rad),
                    libm::sinf(depression_rad),
                ));
                let along = (direction.x, direction.y, direction.z);
                let range_m = cast_ray(&self.scene, along);
                let counts = (direction.z * range_m).abs() <= BAND_HALF_HEIGHT_M && range_m <= ZONE_MAX_RANGE_M;
                if counts && nearest.is_none_or(|(other_m, _)| range_m < other_m) {
                    nearest = Some((range_m, direction));
                }
            }
            let spread = (zone as u32).wrapping_mul(SPREAD);
            let Some((range_m, direction)) = nearest.filter(|_| keys.uniform(spread) >= DROPOUT) else {
                continue;
            };
            let measured_m = (range_m + keys.normal(spread) * (SIGMA_M + SIGMA_SHARE * range_m)).max(0.0);
            let level = direction.to_heading(yaw_rad);
            // In the column that its bearing belongs to, which is another where the vehicle banks.
            let place = (libm::atan2f(level.y, level.x) / fov_rad + 0.5) * columns as f32;
            if place >= 0.0
                && let Some(column_m) = nearest_m[..columns].get_mut(place as usize)
            {
                *column_m = column_m.min(measured_m * libm::hypotf(level.x, level.y));
            }
        }
        Some(ZoneRanges {
            range_m: nearest_m,
            columns,
            fov_rad,
            farthest_m: ZONE_MAX_RANGE_M,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_ahead_is_measured_where_it_is_and_the_ground_is_not() {
        let world = |column: &str| World::new(&crate::testing::field(5.0, 10.0, column));
        let place = NedVector::new(0.0, 0.0, -1.5);
        let (mut one, mut three) = (ZoneSensor::new(3, 1), ZoneSensor::new(3, 3));
        let see = |sensor: &mut ZoneSensor, world: &World, attitude| {
            let seen = sensor
                .measure(sensor.due_ns, world, place, attitude)
                .expect("it is time");
            seen.range_m[..seen.columns].to_vec()
        };
        let nothing = see(&mut three, &world(""), Attitude::LEVEL_NORTH);
        assert_eq!(nothing.len(), 24);
        assert!(nothing.iter().all(|m| m.is_infinite()), "{nothing:?}");
        let with_column = world("column = [{ north_m = 3.0, east_m = 0.0, radius_m = 0.5, height_m = 4.0 }]");
        for _ in 0..20 {
            let seen = see(&mut one, &with_column, Attitude::LEVEL_NORTH);
            let ahead = seen[3].min(seen[4]);
            assert!((2.3..2.7).contains(&ahead), "{seen:?}");
            assert!(seen[0].is_infinite() && seen[7].is_infinite(), "{seen:?}");
            // It stands 45° to the right of a vehicle that is turned to the left by as much.
            let turned = Attitude::from_euler_rad(0.0, 0.0, -ZONE_FOV_RAD);
            let seen = see(&mut one, &with_column, turned);
            assert!(seen.iter().all(|m| m.is_infinite()), "{seen:?}");
            let seen = see(&mut three, &with_column, turned);
            assert!((2.3..2.7).contains(&seen[19].min(seen[20])), "{seen:?}");
        }
        // Nose down the ground comes into view, and is none of what is in the way.
        let nose_down = Attitude::from_euler_rad(0.0, -0.4, 0.0);
        let seen = see(&mut one, &world(""), nose_down);
        assert!(seen.iter().all(|m| m.is_infinite()), "{seen:?}");
    }
}
