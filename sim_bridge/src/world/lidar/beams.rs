//! The sensor's geometry: which way each beam looks, and where a point falls in the image.
//!
//! 64 rings fire 256 times each while the scanner sweeps its 120°. Firings coincide with the image's columns and ring `k` with
//! row `2k`, so every beam's point falls on the centre of its own pixel: the paper's projection is, for the sensor's own points, a
//! matter of indices, and that is how [`capture`](super::Lidar::capture) does it.

use vigil_types::{DEPTH_COLS, DEPTH_ROWS, FrdVector, column_bearing_rad, row_elevation_rad};

/// Rings, from the highest to the lowest.
pub const LIDAR_RINGS: usize = DEPTH_ROWS / 2;
/// Firings of each ring over the sweep, from left to right.
pub const LIDAR_FIRINGS: usize = DEPTH_COLS;
/// Beams of one sweep; beam `ring × LIDAR_FIRINGS + firing`.
pub const LIDAR_BEAMS: usize = LIDAR_RINGS * LIDAR_FIRINGS;

/// Image row that a ring measures.
pub const fn ring_row(ring: usize) -> usize {
    2 * ring
}

/// Direction of a beam in body axes, a unit vector.
pub fn beam_direction_frd(ring: usize, firing: usize) -> FrdVector {
    let elevation = row_elevation_rad(ring_row(ring) as f32);
    let bearing = column_bearing_rad(firing as f32);
    let (se, ce) = (libm::sinf(elevation), libm::cosf(elevation));
    let (sa, ca) = (libm::sinf(bearing), libm::cosf(bearing));
    FrdVector::new(ce * ca, ce * sa, -se)
}

/// Sines and cosines of all elevations and bearings; of fewer, the first `rings` and `firings` count.
#[derive(Clone)]
pub(crate) struct BeamTable {
    pub(crate) rings: usize,
    pub(crate) firings: usize,
    pub(crate) sin_elevation: [f32; LIDAR_RINGS],
    pub(crate) cos_elevation: [f32; LIDAR_RINGS],
    pub(crate) sin_bearing: [f32; LIDAR_FIRINGS],
    pub(crate) cos_bearing: [f32; LIDAR_FIRINGS],
}

impl BeamTable {
    /// One ring and firing of `every`, from the middle of as many.
    pub(crate) fn new(every: usize) -> Self {
        let middle = |k: usize| (every * k) as f32 + 0.5 * (every - 1) as f32;
        let elevation = |ring: usize| row_elevation_rad(2.0 * middle(ring));
        let bearing = |firing: usize| column_bearing_rad(middle(firing));
        Self {
            rings: LIDAR_RINGS / every,
            firings: LIDAR_FIRINGS / every,
            sin_elevation: core::array::from_fn(|k| libm::sinf(elevation(k))),
            cos_elevation: core::array::from_fn(|k| libm::cosf(elevation(k))),
            sin_bearing: core::array::from_fn(|k| libm::sinf(bearing(k))),
            cos_bearing: core::array::from_fn(|k| libm::cosf(bearing(k))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::{HORIZONTAL_FOV_RAD, PIXEL_PITCH_RAD, VERTICAL_FOV_RAD};

    /// By the paper's projection.
    #[test]
    fn every_beams_point_falls_into_its_own_pixel() {
        for (ring, firing) in (0..LIDAR_RINGS).flat_map(|ring| (0..LIDAR_FIRINGS).map(move |firing| (ring, firing))) {
            let point = beam_direction_frd(ring, firing) * 7.5;
            let bearing = libm::atan2f(point.y, point.x);
            let elevation = libm::atan2f(-point.z, point.horizontal_norm());
            let col = (bearing + 0.5 * HORIZONTAL_FOV_RAD) / PIXEL_PITCH_RAD;
            let row = (0.5 * VERTICAL_FOV_RAD - elevation) / PIXEL_PITCH_RAD;
            assert_eq!((row as usize, col as usize), (ring_row(ring), firing));
            assert!((point.norm() - 7.5).abs() < 1e-5);
        }
    }
}
