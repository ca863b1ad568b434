//! How much of the image a sensor can fill.

use core::fmt;
use vigil_types::{DEPTH_COLS, DEPTH_PIXELS, HORIZONTAL_FOV_RAD, PIXEL_PITCH_RAD, VERTICAL_FOV_RAD};

/// The part of the image in which there are ranges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Share of the image's pixels, 0 to 1.
    pub share: f32,
    /// From the leftmost to the rightmost of them, degrees to the right of ahead.
    pub across_deg: [f32; 2],
    /// From the lowest to the highest, degrees above ahead.
    pub up_deg: [f32; 2],
}

impl View {
    /// The view of an image; of one to which every beam contributed (all at one range), it is the sensor's field of view. `None` where
    /// there is nothing.
    pub fn of(depth: &[f32; DEPTH_PIXELS]) -> Option<Self> {
        let seen = || {
            let seen = depth.iter().enumerate().filter(|(_, v)| **v < 1.0);
            seen.map(|(pixel, _)| (pixel / DEPTH_COLS, pixel % DEPTH_COLS))
        };
        let degrees = |pixels: usize, fov_rad: f32| (pixels as f32 * PIXEL_PITCH_RAD - 0.5 * fov_rad).to_degrees();
        let (left, right) = (seen().map(|(_, c)| c).min()?, seen().map(|(_, c)| c).max()?);
        let (top, bottom) = (seen().map(|(r, _)| r).min()?, seen().map(|(r, _)| r).max()?);
        Some(Self {
            share: seen().count() as f32 / DEPTH_PIXELS as f32,
            across_deg: [
                degrees(left, HORIZONTAL_FOV_RAD),
                degrees(right + 1, HORIZONTAL_FOV_RAD),
            ],
            up_deg: [-degrees(bottom + 1, VERTICAL_FOV_RAD), -degrees(top, VERTICAL_FOV_RAD)],
        })
    }

    /// Whether all of the image is seen but its outermost pixels.
    pub fn is_whole(&self) -> bool {
        self.share >= 0.97
    }
}

impl fmt::Display for View {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // No zero with a sign.
        let whole = |degrees: f32| if degrees.abs() <= 0.5 { 0.0 } else { degrees };
        let ([left, right], [low, high]) = (self.across_deg.map(whole), self.up_deg.map(whole));
        write!(
            f,
            "{left:.0}° to {right:.0}° across and {low:.0}° to {high:.0}° in height, {:.0} % of the image's ±60° and ±30°",
            100.0 * self.share
        )
    }
}
