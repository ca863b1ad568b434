//! Between the globe and the local plane about home ([`vigil_mavlink::globe`]).

use crate::HomePosition;
use vigil_mavlink::globe;
use vigil_types::NedVector;

/// Degrees as MAVLink sends them: in units of 1e-7.
pub(crate) fn deg_e7(deg: f64) -> i32 {
    libm::round(deg * 1e7) as i32
}

/// Latitude and longitude in degrees of a point of the local plane, and its height above mean sea level in metres.
pub(crate) fn to_global(home: &HomePosition, local: NedVector) -> (f64, f64, f64) {
    let (latitude_deg, longitude_deg) = globe::to_global((home.latitude_deg, home.longitude_deg), local.x, local.y);
    (latitude_deg, longitude_deg, home.altitude_m - f64::from(local.z))
}

/// North and east of home in metres.
pub(crate) fn to_local(home: &HomePosition, latitude_deg: f64, longitude_deg: f64) -> (f32, f32) {
    globe::to_local((home.latitude_deg, home.longitude_deg), latitude_deg, longitude_deg)
}
