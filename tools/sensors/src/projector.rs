//! Samples of all sensors of one moment, and the image that they make.

use crate::line::{Line, Sample};
use crate::{Mount, Pinhole, ProjectionError};
use alloc::{boxed::Box, vec};
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DEPTH_ROWS, FrdVector, HORIZONTAL_FOV_RAD, PIXEL_PITCH_RAD,
    VERTICAL_FOV_RAD,
};

/// What is nearer is the vehicle itself, metres.
const NEAREST_M: f32 = 0.1;
/// Beams are never stated to be farther apart than this.
const WIDEST_RAD: f32 = 10.0 * core::f32::consts::PI / 180.0;
/// Tangent of the view's border, 60° to either side, and a little more.
const WIDEST_TAN: f32 = 1.74;
/// A turned sensor's beams come to lie a little farther apart in the image.
const SLACK: f32 = 1.1;

/// How far apart a sensor's neighbouring beams are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    across_rad: f32,
    down_rad: f32,
}

impl Resolution {
    /// Angles between neighbouring beams, degrees: from left to right and from top to bottom of the image.
    ///
    /// # Errors
    /// [`ProjectionError::Resolution`].
    pub fn of_degrees(across: f32, down: f32) -> Result<Self, ProjectionError> {
        Self::of_rad(across.to_radians(), down.to_radians())
    }

    /// The same in radians.
    ///
    /// # Errors
    /// [`ProjectionError::Resolution`].
    pub fn of_rad(across_rad: f32, down_rad: f32) -> Result<Self, ProjectionError> {
        for angle in [across_rad, down_rad] {
            if !(angle > 0.0 && angle <= WIDEST_RAD) {
                return Err(ProjectionError::Resolution(angle.to_degrees()));
            }
        }
        Ok(Self { across_rad, down_rad })
    }

    /// How far apart, in pixels, samples may be between which nothing is missing but a beam that was lost.
    fn spans(self) -> (f32, f32) {
        let span = |rad: f32| {
            let pitch = rad / PIXEL_PITCH_RAD;
            SLACK * (2.0 * pitch).max(pitch + 1.0)
        };
        (span(self.across_rad), span(self.down_rad))
    }
}

/// What became of the points or pixels that were given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// In view and within range.
    pub used: u32,
    /// Outside the image's 120° × 60°.
    pub out_of_view: u32,
    /// The sensor said that nothing returned (0), or it is 100 m away or farther.
    pub no_return: u32,
    /// Nearer than 0.1 m: the vehicle itself.
    pub too_near: u32,
    /// NaN, infinite or a negative depth: not a measurement.
    pub impossible: u32,
}

impl Counts {
    /// All that were given.
    pub fn total(&self) -> u32 {
        self.used + self.out_of_view + self.no_return + self.too_near + self.impossible
    }
}

/// Makes the image: give it what one or several sensors saw at one moment, then [`finish`](Self::finish).
///
/// Of several points in a pixel the nearest counts. A pixel between points that are no farther apart than two beams of the sensor gets
/// the surface between them, or the nearer where they are of two surfaces. Where no beam looked, or none returned, is no return.
pub struct Projector {
    samples: Box<[Sample]>,
    centred: Box<[Sample]>,
    /// [`Resolution::spans`].
    spans: (f32, f32),
}

impl Projector {
    /// For a sensor whose beams are that far apart; of several sensors the coarsest counts.
    pub fn new(resolution: Resolution) -> Self {
        let samples = || vec![Sample::default(); DEPTH_PIXELS].into_boxed_slice();
        Self {
            samples: samples(),
            centred: samples(),
            spans: resolution.spans(),
        }
    }

    /// Adds a point cloud: points in the sensor's axes (forward, right, down), metres from it; (0, 0, 0) is no return.
    pub fn add_points(&mut self, mount: &Mount, points_frd_m: impl IntoIterator<Item = FrdVector>) -> Counts {
        let mut counts = Counts::default();
        for point in points_frd_m {
            match point.to_array() {
                [0.0, 0.0, 0.0] => counts.no_return += 1,
                _ => self.add(mount.to_vehicle(point), &mut counts),
            }
        }
        counts
    }

    /// Adds a rectified depth image of whole units, row by row from the top left: depth along the camera's axis, 0 is no return.
    /// `metres_per_unit` is 0.001 for most cameras.
    ///
    /// # Errors
    /// [`ProjectionError::ImageSize`]; [`ProjectionError::Camera`] for a unit that cannot be.
    pub fn add_depth_units(
        &mut self,
        mount: &Mount,
        camera: &Pinhole,
        depth: &[u16],
        metres_per_unit: f32,
    ) -> Result<Counts, ProjectionError> {
        check_unit(metres_per_unit)?;
        let depth_m = depth.iter().map(|d| f32::from(*d) * metres_per_unit);
        self.add_image(mount, camera, depth.len(), depth_m)
    }

    /// The same of metres; 0 is no return, and so is infinity.
    ///
    /// # Errors
    /// [`ProjectionError::ImageSize`].
    pub fn add_depth_m(&mut self, mount: &Mount, camera: &Pinhole, depth_m: &[f32]) -> Result<Counts, ProjectionError> {
        self.add_image(mount, camera, depth_m.len(), depth_m.iter().copied())
    }

    fn add_image(
        &mut self,
        mount: &Mount,
        camera: &Pinhole,
        pixels: usize,
        depth_m: impl Iterator<Item = f32>,
    ) -> Result<Counts, ProjectionError> {
        camera.check_size(pixels)?;
        let mut counts = Counts::default();
        for (ray, depth_m) in camera.rays().zip(depth_m) {
            if depth_m == 0.0 || depth_m == f32::INFINITY {
                counts.no_return += 1;
            } else if depth_m > 0.0 {
                self.add(mount.to_vehicle(ray * depth_m), &mut counts);
            } else {
                counts.impossible += 1;
            }
        }
        Ok(counts)
    }

    /// Adds a point in the vehicle's axes.
    #[inline]
    fn add(&mut self, point: FrdVector, counts: &mut Counts) {
        let range_m = point.norm();
        let count = if !point.is_finite() {
            &mut counts.impossible
        } else if range_m < NEAREST_M {
            &mut counts.too_near
        } else if range_m >= DEPTH_FULL_SCALE_M {
            &mut counts.no_return
        } else if self.place(point, range_m) {
            &mut counts.used
        } else {
            &mut counts.out_of_view
        };
        *count += 1;
    }

    /// Puts a point into the pixel of its direction; `false` where none has it.
    #[inline]
    fn place(&mut self, point: FrdVector, range_m: f32) -> bool {
        // Most of what a scanner that turns sees needs no angle.
        if point.y.abs() > WIDEST_TAN * point.x {
            return false;
        }
        let bearing = atan(point.y / point.x);
        let elevation = atan(-point.z / point.horizontal_norm());
        let across = (bearing + 0.5 * HORIZONTAL_FOV_RAD) / PIXEL_PITCH_RAD;
        let down = (0.5 * VERTICAL_FOV_RAD - elevation) / PIXEL_PITCH_RAD;
        let is_inside = across >= 0.0 && down >= 0.0 && across < DEPTH_COLS as f32 && down < DEPTH_ROWS as f32;
        let (row, col) = (down as usize, across as usize);
        let pixel = self.samples.get_mut(row * DEPTH_COLS + col);
        let Some(sample) = pixel.filter(|_| is_inside) else {
            return false;
        };
        let inverse = 1.0 / range_m;
        if inverse > sample.inverse {
            *sample = Sample {
                inverse,
                down: down - row as f32 - 0.5,
                across: across - col as f32 - 0.5,
            };
        }
        true
    }

    /// Writes the image, ranges over 100 m with 1 for no return, and begins the next one. Returns the number of pixels with a range.
    pub fn finish(&mut self, depth: &mut [f32; DEPTH_PIXELS]) -> usize {
        let Self { samples, centred, .. } = self;
        let mut line = Line::new(self.spans.1);
        for col in 0..DEPTH_COLS {
            let at = |row: usize| row * DEPTH_COLS + col;
            line.centre(
                DEPTH_ROWS,
                |row| samples.get(at(row)).copied().unwrap_or_default(),
                |sample| sample.down,
                |row, sample| {
                    if let Some(place) = centred.get_mut(at(row)) {
                        *place = sample;
                    }
                },
            );
        }
        let mut line = Line::new(self.spans.0);
        let mut returned = 0;
        for (row, out) in centred.chunks_exact(DEPTH_COLS).zip(depth.chunks_exact_mut(DEPTH_COLS)) {
            line.centre(
                DEPTH_COLS,
                |col| row.get(col).copied().unwrap_or_default(),
                |sample| sample.across,
                |col, sample| {
                    if let Some(pixel) = out.get_mut(col) {
                        let value = 1.0 / (sample.inverse * DEPTH_FULL_SCALE_M);
                        *pixel = if value < 1.0 { value } else { 1.0 };
                        returned += usize::from(value < 1.0);
                    }
                },
            );
        }
        samples.fill(Sample::default());
        returned
    }
}

/// Whether a depth image's unit can be one, metres.
///
/// # Errors
/// [`ProjectionError::Camera`].
pub fn check_unit(metres_per_unit: f32) -> Result<(), ProjectionError> {
    match metres_per_unit > 0.0 && metres_per_unit <= 0.1 {
        true => Ok(()),
        false => Err(ProjectionError::Camera {
            field: "unit",
            value: metres_per_unit,
            expected: "metres, above 0 and at most 0.1",
        }),
    }
}

/// Arc tangent within 0.000 02 rad, a 400th of a pixel: several times as fast as the exact one, of which a camera needs a million in a
/// second. Polynomial of degree 11, least largest error over ±1.
#[inline]
fn atan(t: f32) -> f32 {
    let (inner, is_steep) = if t.abs() > 1.0 { (1.0 / t, true) } else { (t, false) };
    let s = inner * inner;
    let series = ((((-0.011_721_2 * s + 0.052_653_32) * s - 0.116_432_87) * s + 0.193_543_46) * s - 0.332_623_47) * s;
    let angle = inner * (0.999_977_26 + series);
    match is_steep {
        true => core::f32::consts::FRAC_PI_2.copysign(t) - angle,
        false => angle,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arc_tangent_is_exact_to_a_small_part_of_a_pixel() {
        for i in -10_000..=10_000 {
            let t = i as f32 * 0.001;
            assert!((atan(t) - libm::atanf(t)).abs() < 2e-5, "{t}");
        }
        assert!((atan(1e30) - libm::atanf(1e30)).abs() < 2e-5 && atan(f32::INFINITY) > 1.57);
    }
}
