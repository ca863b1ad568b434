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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_survives_the_way_to_the_globe_and_back() {
        let home = HomePosition::default();
        for (n, e) in [(0.0, 0.0), (20.0, -5.0), (0.02, 0.01), (-900.0, 1500.0)] {
            let (lat, lon, alt) = to_global(&home, NedVector::new(n, e, -3.0));
            let (n2, e2) = to_local(&home, lat, lon);
            assert!((n - n2).abs() < 2e-2 && (e - e2).abs() < 2e-2, "{n} {e} -> {n2} {e2}");
            assert!((alt - 491.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_degree_of_latitude_is_111_km_and_east_raises_the_longitude() {
        let home = HomePosition::default();
        let (lat, lon, _) = to_global(&home, NedVector::new(1111.9493, 0.0, 0.0));
        assert!((lat - home.latitude_deg - 0.01).abs() < 1e-7 && (lon - home.longitude_deg).abs() < 1e-9);
        let (_, lon, _) = to_global(&home, NedVector::new(0.0, 10.0, 0.0));
        let expected = 10.0 / (globe::EARTH_RADIUS_M * libm::cos(home.latitude_deg.to_radians()));
        assert!((lon - home.longitude_deg - expected.to_degrees()).abs() < 1e-9);
    }
}
