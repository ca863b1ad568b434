//! Between the globe and the local plane about home ([`vigil_mavlink::globe`]), and how far from home a place may be.

use vigil_mavlink::globe::{self, Origin};
use vigil_types::NedVector;

/// Where the local origin is, which is home until that is moved: where PX4's simulation starts.
pub const ORIGIN: Origin = Origin {
    latitude_deg: 47.397_742,
    longitude_deg: 8.545_594,
    altitude_m: 488.0,
};

/// Farther than this is a mistake in the coordinates, not a place to fly to.
pub(crate) const MAX_DISTANCE_M: f32 = 10_000.0;
pub(crate) const MAX_HEIGHT_M: f32 = 500.0;
/// A height that is farther below home was meant above something else than its frame says; the world is level.
pub(crate) const BELOW_HOME_M: f32 = 1.0;

/// Whether a MAV_FRAME is one of places on the globe.
pub(crate) fn is_global(frame: u8) -> bool {
    matches!(frame, 0 | 3 | 5 | 6)
}

/// Height above home of an altitude above sea level.
pub(crate) fn height_m(altitude_m: f32) -> f32 {
    (f64::from(altitude_m) - ORIGIN.altitude_m) as f32
}

/// Degrees as MAVLink sends them: in units of 1e-7.
pub(crate) fn deg_e7(deg: f64) -> i32 {
    libm::round(deg * 1e7) as i32
}

/// Latitude and longitude of a point of the local plane, in units of 1e-7 degrees, and its height above sea level, metres.
pub fn to_global(local: NedVector) -> (i32, i32, f64) {
    let (lat_deg, lon_deg) = globe::to_global((ORIGIN.latitude_deg, ORIGIN.longitude_deg), local.x, local.y);
    (deg_e7(lat_deg), deg_e7(lon_deg), ORIGIN.altitude_m - f64::from(local.z))
}
