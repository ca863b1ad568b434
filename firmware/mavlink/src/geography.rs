//! From the globe to the vehicle's local plane.

/// Radius of the sphere in metres, as PX4's map projection has it.
const EARTH_RADIUS_M: f64 = 6_371_000.0;

/// Where the local origin is on the globe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Origin {
    pub latitude_deg: f64,
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
        let origin = Self {
            latitude_deg: self.latitude_deg - (f64::from(north_m) / EARTH_RADIUS_M).to_degrees(),
            longitude_deg: self.longitude_deg - (f64::from(east_m) / self.parallel_radius_m()).to_degrees(),
            altitude_m: self.altitude_m - f64::from(up_m),
        };
        (origin.latitude_deg.abs() < 89.0 && origin.longitude_deg.is_finite() && origin.altitude_m.is_finite())
            .then_some(origin)
    }

    fn parallel_radius_m(&self) -> f64 {
        EARTH_RADIUS_M * libm::cos(self.latitude_deg.to_radians())
    }

    /// Metres north and east of the origin. A plane: 1 mm wrong at 100 m, 0.1 m at 1 km (at 47° latitude).
    pub fn north_east_m(&self, latitude_deg: f64, longitude_deg: f64) -> (f32, f32) {
        let mut east_deg = longitude_deg - self.longitude_deg;
        if east_deg > 180.0 {
            east_deg -= 360.0;
        } else if east_deg < -180.0 {
            east_deg += 360.0;
        }
        let north_m = (latitude_deg - self.latitude_deg).to_radians() * EARTH_RADIUS_M;
        let east_m = east_deg.to_radians() * self.parallel_radius_m();
        (north_m as f32, east_m as f32)
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
        assert!((east - 752.69).abs() < 0.2 && north.abs() < 0.01, "{north} {east}");
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
    }
}
