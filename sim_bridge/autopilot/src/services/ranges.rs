//! OBSTACLE_DISTANCE of a sensor beside the depth camera, for the guidance computer:
//! <https://mavlink.io/en/messages/common.html#OBSTACLE_DISTANCE>.

use crate::core::ZoneRanges;
use crate::service::prelude::*;
use vigil_types::RANGE_SECTORS;

const UNKNOWN: u16 = u16::MAX;
const LEAST_CM: u16 = 1;

pub(super) const MESSAGES: &[Produced] = &[Produced::from(OBSTACLE_DISTANCE_DATA::ID, [15.0, 0.0, 0.0], |core| {
    core.ranges.as_ref().map(|ranges| message(core, ranges))
})];

fn message(core: &Core, ranges: &ZoneRanges) -> MavMessage {
    let farthest_cm = (ranges.farthest_m * 100.0) as u16;
    let mut distances = [UNKNOWN; RANGE_SECTORS];
    for (distance, range_m) in distances.iter_mut().zip(ranges.range_m).take(ranges.columns) {
        *distance = match range_m <= ranges.farthest_m {
            true => ((range_m * 100.0).round() as u16).clamp(LEAST_CM, farthest_cm),
            false => farthest_cm + 1,
        };
    }
    let step_deg = (ranges.fov_rad / ranges.columns as f32).to_degrees();
    MavMessage::OBSTACLE_DISTANCE(OBSTACLE_DISTANCE_DATA {
        time_usec: core.time_boot_us(),
        distances,
        min_distance: LEAST_CM,
        max_distance: farthest_cm,
        sensor_type: MavDistanceSensor::MAV_DISTANCE_SENSOR_LASER,
        // Whole degrees cannot tell it; the extension fields do.
        increment: 0,
        increment_f: step_deg,
        angle_offset: 0.5 * (step_deg - ranges.fov_rad.to_degrees()),
        frame: MavFrame::MAV_FRAME_BODY_FRD,
    })
}
