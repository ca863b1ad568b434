//! Between the globe and the local plane: azimuthal equidistant projection about home, as PX4's `MapProjection`.

use crate::HomePosition;
use vigil_types::NedVector;

/// Radius of the sphere in metres, as in PX4.
const EARTH_RADIUS_M: f64 = 6_371_000.0;

/// Degrees as MAVLink sends them: in units of 1e-7.
pub(crate) fn deg_e7(deg: f64) -> i32 {
    libm::round(deg * 1e7) as i32
}

/// Latitude and longitude in degrees of a point of the local plane, and its height above mean sea level in metres.
pub(crate) fn to_global(home: &HomePosition, local: NedVector) -> (f64, f64, f64) {
    let (x, y) = (f64::from(local.x) / EARTH_RADIUS_M, f64::from(local.y) / EARTH_RADIUS_M);
    let altitude_m = home.altitude_m - f64::from(local.z);
    let c = libm::sqrt(x * x + y * y);
    if c < 1e-15 {
        return (home.latitude_deg, home.longitude_deg, altitude_m);
    }
    let (sin_c, cos_c) = (libm::sin(c), libm::cos(c));
    let lat0 = home.latitude_deg.to_radians();
    let (sin0, cos0) = (libm::sin(lat0), libm::cos(lat0));
    let lat = libm::asin((cos_c * sin0 + x * sin_c * cos0 / c).clamp(-1.0, 1.0));
    let lon = home.longitude_deg.to_radians() + libm::atan2(y * sin_c, c * cos0 * cos_c - x * sin0 * sin_c);
    (lat.to_degrees(), lon.to_degrees(), altitude_m)
}

/// North and east of home in metres.
pub(crate) fn to_local(home: &HomePosition, latitude_deg: f64, longitude_deg: f64) -> (f32, f32) {
    let (lat, lat0) = (latitude_deg.to_radians(), home.latitude_deg.to_radians());
    let d_lon = (longitude_deg - home.longitude_deg).to_radians();
    let (sin, cos) = (libm::sin(lat), libm::cos(lat));
    let (sin0, cos0) = (libm::sin(lat0), libm::cos(lat0));
    let cos_d = libm::cos(d_lon);
    let c = libm::acos((sin0 * sin + cos0 * cos * cos_d).clamp(-1.0, 1.0));
    let k = if c > 1e-12 { c / libm::sin(c) } else { 1.0 };
    let north = k * (cos0 * sin - sin0 * cos * cos_d) * EARTH_RADIUS_M;
    let east = k * cos * libm::sin(d_lon) * EARTH_RADIUS_M;
    (north as f32, east as f32)
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
        let expected = 10.0 / (EARTH_RADIUS_M * libm::cos(home.latitude_deg.to_radians()));
        assert!((lon - home.longitude_deg - expected.to_degrees()).abs() < 1e-9);
    }
}
