//! What any sensor saw, a point cloud or a pinhole camera's depth image, as the depth image that Vigil flies by
//! (docs/sensor-interface.md, "The image").
//!
//! ```
//! use vigil_sensors::{Mount, Projector, Resolution};
//! use vigil_types::{Attitude, DEPTH_COLS, DEPTH_PIXELS, FrdVector};
//!
//! // Beams 1° apart; the sensor sits 10 cm before the vehicle's middle.
//! let mount = Mount::new(FrdVector::new(0.1, 0.0, 0.0), Attitude::LEVEL_NORTH)?;
//! let mut projector = Projector::new(Resolution::of_degrees(1.0, 1.0)?);
//! projector.add_points(&mount, [FrdVector::new(4.9, 0.0, 0.0)]);
//! let mut depth = [1.0; DEPTH_PIXELS];
//! projector.finish(&mut depth);
//! assert_eq!(depth[64 * DEPTH_COLS + 128], 0.05); // 5 m of 100 m
//! # Ok::<(), vigil_sensors::ProjectionError>(())
//! ```
//!
//! Without the feature `std` it is the projection alone (`alloc` at construction only): a picture allocates nothing, does not panic and reads no clock.

#![cfg_attr(not(feature = "std"), no_std)]
#![forbid(unsafe_code)]

extern crate alloc;

#[cfg(feature = "std")]
pub mod adapters;
mod line;
mod mount;
mod pinhole;
mod projector;
mod view;

pub use mount::Mount;
pub use pinhole::Pinhole;
pub use projector::{Counts, Projector, Resolution, check_unit};
pub use view::View;

/// What a projection cannot be made of.
#[allow(missing_docs, reason = "the texts say what the fields are")]
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ProjectionError {
    /// A mount's position is not finite or its quaternion is not of unit length.
    #[error("the mount's position must be finite and its quaternion of unit length")]
    Mount,
    /// An angle between beams that cannot be one.
    #[error("the angle between beams is {0}°, must be above 0° and at most 10°")]
    Resolution(f32),
    /// A camera's focal length, principal point or size is impossible.
    #[error("camera: `{field}` is {value}, must be {expected}")]
    Camera {
        field: &'static str,
        value: f32,
        expected: &'static str,
    },
    /// An image has not as many pixels as its camera.
    #[error("the image has {pixels} pixels, its camera {width} x {height}")]
    ImageSize { pixels: usize, width: usize, height: usize },
}
