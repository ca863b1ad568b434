//! OBSTACLE_DISTANCE of what the pilot sees: <https://mavlink.io/en/messages/common.html#OBSTACLE_DISTANCE>.

use super::Service;
use super::status::VALUES_NS;
use crate::core::{Core, Periodic};
use mavlink::dialects::common::{MavDistanceSensor, MavFrame, MavMessage, OBSTACLE_DISTANCE_DATA};
use vigil_types::{Datagrams, HORIZONTAL_FOV_RAD, Nanos, ObstacleReports};

/// Bins of the message; they share the sensor's field of view.
const BINS: usize = 72;
/// Nearest and farthest distance sent, centimetres.
const LEAST_CM: u16 = 10;
const FARTHEST_CM: u16 = 3000;
/// Nothing within [`FARTHEST_CM`].
const FREE: u16 = FARTHEST_CM + 1;
const UNKNOWN: u16 = u16::MAX;

#[derive(Debug, Clone, Default)]
pub(crate) struct ObstacleService {
    due: Periodic,
}

/// It speaks when the pilot has looked, which is no part of the step's report.
impl Service for ObstacleService {}

impl ObstacleService {
    /// Sends what the pilot sees: see [`crate::Companion::emit_obstacles`].
    pub fn tell(
        &mut self,
        core: &mut Core,
        now_ns: Nanos,
        sectors: Option<impl Iterator<Item = (f32, f32)>>,
        out: &mut Datagrams,
    ) {
        let seen = sectors.filter(|_| core.vehicle.telemetry.is_airborne());
        let sends = match core.config.obstacles {
            ObstacleReports::Off => false,
            ObstacleReports::Flight => seen.is_some(),
            ObstacleReports::KeepAlive => core.vehicle_heard,
        };
        if sends && self.due.is_due(now_ns, VALUES_NS) {
            let message = match seen {
                Some(sectors) => message(now_ns, sectors),
                // Of a sensor that looks nowhere: no distance is known.
                None => message(now_ns, core::iter::empty()),
            };
            core.say(out, &message);
        }
    }
}

/// The message of a scan: bearing (radians, positive to the right of the nose) and horizontal distance (metres, infinite
/// where nothing was seen) of each of its sectors. The nearest of a bin counts; a bin without a sector is unknown.
fn message(now_ns: Nanos, sectors: impl Iterator<Item = (f32, f32)>) -> MavMessage {
    let bin_rad = HORIZONTAL_FOV_RAD / BINS as f32;
    let mut distances = [UNKNOWN; BINS];
    for (bearing_rad, range_m) in sectors {
        let place = libm::floorf((bearing_rad + 0.5 * HORIZONTAL_FOV_RAD) / bin_rad);
        // Left of the first bin or not a number: no bin.
        if place < 0.0 || place.is_nan() {
            continue;
        }
        let distance_cm = if range_m * 100.0 <= f32::from(FARTHEST_CM) {
            libm::roundf(range_m * 100.0) as u16
        } else {
            FREE
        };
        if let Some(bin) = distances.get_mut(place as usize) {
            *bin = (*bin).min(distance_cm.max(LEAST_CM));
        }
    }
    MavMessage::OBSTACLE_DISTANCE(OBSTACLE_DISTANCE_DATA {
        time_usec: now_ns / 1000,
        distances,
        min_distance: LEAST_CM,
        max_distance: FARTHEST_CM,
        sensor_type: MavDistanceSensor::MAV_DISTANCE_SENSOR_LASER,
        // Whole degrees cannot tell it; the extension fields do.
        increment: 0,
        increment_f: bin_rad.to_degrees(),
        angle_offset: (0.5 * (bin_rad - HORIZONTAL_FOV_RAD)).to_degrees(),
        frame: MavFrame::MAV_FRAME_BODY_FRD,
    })
}
