//! The sensor's geometry: which way each beam looks, and where a point falls in the image.
//!
//! 64 rings fire 256 times each while the scanner sweeps its 120°. Firings coincide with the image's columns and ring `k` with
//! row `2k`, so every beam's point falls on the centre of its own pixel: the projection of [`pixel_of`] is, for the sensor's own
//! points, a matter of indices, and that is how [`capture`](super::Lidar::capture) does it.

use vigil_types::{
    DEPTH_COLS, DEPTH_ROWS, FrdVector, HORIZONTAL_FOV_RAD, PIXEL_PITCH_RAD, VERTICAL_FOV_RAD, column_bearing_rad,
    row_elevation_rad,
};

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

/// The paper's projection of one point of the cloud: row and column of the pixel it falls into and its range in metres;
/// `None` outside the field of view.
pub fn pixel_of(point_frd_m: FrdVector) -> Option<(usize, usize, f32)> {
    let bearing = libm::atan2f(point_frd_m.y, point_frd_m.x);
    let elevation = libm::atan2f(-point_frd_m.z, point_frd_m.horizontal_norm());
    let col = (bearing + 0.5 * HORIZONTAL_FOV_RAD) / PIXEL_PITCH_RAD;
    let row = (0.5 * VERTICAL_FOV_RAD - elevation) / PIXEL_PITCH_RAD;
    let inside = col >= 0.0 && row >= 0.0 && col < DEPTH_COLS as f32 && row < DEPTH_ROWS as f32;
    inside.then(|| (row as usize, col as usize, point_frd_m.norm()))
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

    #[test]
    fn every_beams_point_falls_into_its_own_pixel() {
        for ring in 0..LIDAR_RINGS {
            for firing in 0..LIDAR_FIRINGS {
                let (row, col, range_m) = pixel_of(beam_direction_frd(ring, firing) * 7.5).expect("in view");
                assert_eq!((row, col), (ring_row(ring), firing));
                assert!((range_m - 7.5).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn points_behind_above_and_beside_are_out_of_view() {
        for p in [
            (-5.0, 0.0, 0.0),
            (1.0, 0.0, -5.0),
            (1.0, 5.0, 0.0),
            (1.0, -5.0, 0.0),
            (1.0, 0.0, 5.0),
        ] {
            assert_eq!(pixel_of(FrdVector::new(p.0, p.1, p.2)), None);
        }
    }
}
