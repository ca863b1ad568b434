//! Distances by bearing, of a sensor beside the depth camera.

use crate::Nanos;

/// Sectors that one report may have: as many as OBSTACLE_DISTANCE has
/// (<https://mavlink.io/en/messages/common.html#OBSTACLE_DISTANCE>).
pub const RANGE_SECTORS: usize = 72;
/// Components of a vehicle whose reports are looked at side by side.
pub const RANGE_SOURCES: usize = 4;

/// What a second sensor sees at the vehicle's own height: the nearest surface in each of a row of sectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SectorRanges {
    /// The component of the vehicle that it came from.
    pub component: u8,
    /// When it arrived.
    pub at_ns: Nanos,
    /// Bearing of the first sector's middle, radians, clockwise from the nose.
    pub first_rad: f32,
    /// From one sector's middle to the next, radians; negative where they are given counter-clockwise.
    pub step_rad: f32,
    /// Horizontal distance in metres, infinite where nothing is within the sensor's reach; NaN where nothing is known.
    pub range_m: [f32; RANGE_SECTORS],
}

impl SectorRanges {
    /// The sectors of which something is known: bearing of the middle, radians, and distance, metres.
    pub fn known(&self) -> impl Iterator<Item = (f32, f32)> + '_ {
        let each = self.range_m.iter().enumerate();
        each.filter(|(_, range_m)| !range_m.is_nan())
            .map(|(i, range_m)| (self.first_rad + i as f32 * self.step_rad, *range_m))
    }
}
