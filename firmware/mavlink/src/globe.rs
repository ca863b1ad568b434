//! Between the globe and the local plane: azimuthal equidistant projection, as PX4's `MapProjection`; both ends of the link use it.

/// Radius of the sphere in metres, as in PX4.
pub const EARTH_RADIUS_M: f64 = 6_371_000.0;

/// Latitude and longitude in degrees of the point `north_m`, `east_m` of the plane whose origin has this latitude and longitude.
pub fn to_global((latitude0_deg, longitude0_deg): (f64, f64), north_m: f32, east_m: f32) -> (f64, f64) {
    let (x, y) = (f64::from(north_m) / EARTH_RADIUS_M, f64::from(east_m) / EARTH_RADIUS_M);
    let c = libm::sqrt(x * x + y * y);
    if c < 1e-15 {
        return (latitude0_deg, longitude0_deg);
    }
    let (sin_c, cos_c) = (libm::sin(c), libm::cos(c));
    let lat0 = latitude0_deg.to_radians();
    let (sin0, cos0) = (libm::sin(lat0), libm::cos(lat0));
    let lat = libm::asin((cos_c * sin0 + x * sin_c * cos0 / c).clamp(-1.0, 1.0));
    let lon = longitude0_deg.to_radians() + libm::atan2(y * sin_c, c * cos0 * cos_c - x * sin0 * sin_c);
    let lon_deg = lon.to_degrees();
    // Beyond the date line it is counted from the other side.
    (lat.to_degrees(), lon_deg - 360.0 * libm::round(lon_deg / 360.0))
}

/// Metres north and east, of a place on the globe, in the plane whose origin has this latitude and longitude (degrees).
pub fn to_local((latitude0_deg, longitude0_deg): (f64, f64), latitude_deg: f64, longitude_deg: f64) -> (f32, f32) {
    let (lat, lat0) = (latitude_deg.to_radians(), latitude0_deg.to_radians());
    let d_lon = (longitude_deg - longitude0_deg).to_radians();
    let (sin, cos) = (libm::sin(lat), libm::cos(lat));
    let (sin0, cos0) = (libm::sin(lat0), libm::cos(lat0));
    let cos_d = libm::cos(d_lon);
    let c = libm::acos((sin0 * sin + cos0 * cos * cos_d).clamp(-1.0, 1.0));
    let k = if c > 1e-12 { c / libm::sin(c) } else { 1.0 };
    let north = k * (cos0 * sin - sin0 * cos * cos_d) * EARTH_RADIUS_M;
    let east = k * cos * libm::sin(d_lon) * EARTH_RADIUS_M;
    (north as f32, east as f32)
}

/// Where the local origin is on the globe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Origin {
    /// Latitude, degrees.
    pub latitude_deg: f64,
    /// Longitude, degrees.
    pub longitude_deg: f64,
    /// Above mean sea level.
    pub altitude_m: f64,
}

impl Origin {
    /// From MAVLink's integers: 1e-7 degrees and millimetres. `None` when it cannot be a place.
    pub fn from_integers(latitude: i32, longitude: i32, altitude_mm: i32) -> Option<Self> {
        let origin = Self {
            latitude_deg: f64::from(latitude) * 1e-7,
            longitude_deg: f64::from(longitude) * 1e-7,
            altitude_m: f64::from(altitude_mm) * 1e-3,
        };
        // At a pole east has no direction.
        (origin.latitude_deg.abs() < 89.0 && origin.longitude_deg.abs() <= 180.0).then_some(origin)
    }

    /// The origin, when this is the place of the local point `north_m`, `east_m`, `up_m`.
    pub fn moved_back(self, north_m: f32, east_m: f32, up_m: f32) -> Option<Self> {
        let (latitude_deg, longitude_deg) = to_global((self.latitude_deg, self.longitude_deg), -north_m, -east_m);
        let origin = Self {
            latitude_deg,
            longitude_deg,
            altitude_m: self.altitude_m - f64::from(up_m),
        };
        (origin.latitude_deg.abs() < 89.0 && origin.longitude_deg.is_finite() && origin.altitude_m.is_finite())
            .then_some(origin)
    }

    /// Latitude and longitude, 1e-7 degrees, of the place so many metres north and east of the origin; `None` when that is no place.
    pub fn place_e7(&self, north_m: f32, east_m: f32) -> Option<(i32, i32)> {
        let (latitude_deg, longitude_deg) = to_global((self.latitude_deg, self.longitude_deg), north_m, east_m);
        let is_place = latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 180.0;
        let e7 = |deg: f64| libm::round(deg * 1e7) as i32;
        is_place.then(|| (e7(latitude_deg), e7(longitude_deg)))
    }

    /// Metres north and east of the origin.
    pub fn north_east_m(&self, latitude_deg: f64, longitude_deg: f64) -> (f32, f32) {
        to_local((self.latitude_deg, self.longitude_deg), latitude_deg, longitude_deg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZURICH: (i32, i32, i32) = (473_977_420, 85_455_940, 488_000);

    #[test]
    fn a_hundredth_of_a_degree_is_1112_m_north_and_less_east() {
        let origin = Origin::from_integers(ZURICH.0, ZURICH.1, ZURICH.2).unwrap();
        let (north, east) = origin.north_east_m(47.407742, 8.545594);
        // 2π · 6371 km / 360 / 100
        assert!((north - 1111.949).abs() < 0.01 && east.abs() < 0.01, "{north} {east}");
        let (north, east) = origin.north_east_m(47.397742, 8.555594);
        // Due east along a parallel leads away from the great circle: 0.05 m to the north here.
        assert!(
            (east - 752.69).abs() < 0.2 && (north - 0.05).abs() < 0.01,
            "{north} {east}"
        );
    }

    #[test]
    fn the_origin_follows_from_a_home_that_is_not_at_it() {
        let home = Origin::from_integers(ZURICH.0, ZURICH.1, ZURICH.2).unwrap();
        let origin = home.moved_back(30.0, -40.0, 2.0).unwrap();
        let (north, east) = origin.north_east_m(home.latitude_deg, home.longitude_deg);
        assert!(
            (north - 30.0).abs() < 1e-3 && (east + 40.0).abs() < 1e-3,
            "{north} {east}"
        );
        assert!((origin.altitude_m - 486.0).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_a_place_is_refused() {
        assert!(Origin::from_integers(910_000_000, 0, 0).is_none());
        assert!(
            Origin::from_integers(0, 0, 0)
                .unwrap()
                .moved_back(f32::NAN, 0.0, 0.0)
                .is_none()
        );
    }

    #[test]
    fn east_is_east_across_the_date_line() {
        let origin = Origin::from_integers(0, 1_799_999_000, 0).unwrap();
        let (_, east) = origin.north_east_m(0.0, -179.9999);
        assert!((east - 22.24).abs() < 0.1, "{east}");
        assert_eq!(origin.place_e7(0.0, 20.0), Some((0, -1_799_999_201)));
    }
}
