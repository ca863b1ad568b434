//! A rectified camera.

use crate::{ProjectionError, Resolution};
use vigil_types::FrdVector;

/// Longest side of an image.
const MOST_PIXELS: usize = 8192;

/// A pinhole camera without distortion. Pixel (0, 0) is the centre of the upper left one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    size_px: [usize; 2],
    focal_px: [f32; 2],
    centre_px: [f32; 2],
}

impl Pinhole {
    /// A camera of `[width, height]` pixels with focal lengths `[fx, fy]` and principal point `[cx, cy]` in pixels.
    ///
    /// # Errors
    /// [`ProjectionError::Camera`] names what is impossible.
    pub fn new(size_px: [usize; 2], focal_px: [f32; 2], centre_px: [f32; 2]) -> Result<Self, ProjectionError> {
        let refuse = |field, value, expected| Err(ProjectionError::Camera { field, value, expected });
        for (field, size) in ["width", "height"].into_iter().zip(size_px) {
            if !(2..=MOST_PIXELS).contains(&size) {
                return refuse(field, size as f32, "from 2 to 8192 pixels");
            }
        }
        for ((field, focal), size) in ["fx", "fy"].into_iter().zip(focal_px).zip(size_px) {
            // Narrower than a degree, or wider than 170°, is another unit or a wrong number.
            if !(focal >= 0.044 * size as f32 && focal <= 58.0 * size as f32) {
                return refuse(field, focal, "pixels, and so that the view is 1° to 170° wide");
            }
        }
        for ((field, centre), size) in ["cx", "cy"].into_iter().zip(centre_px).zip(size_px) {
            if !(centre >= 0.0 && centre < size as f32) {
                return refuse(field, centre, "pixels, within the image");
            }
        }
        Ok(Self {
            size_px,
            focal_px,
            centre_px,
        })
    }

    /// Width and height, pixels.
    pub fn size_px(&self) -> [usize; 2] {
        self.size_px
    }

    /// The angles between neighbouring pixels in the middle of the image, where they are widest.
    ///
    /// # Errors
    /// [`ProjectionError::Resolution`] where they are above 10°.
    pub fn resolution(&self) -> Result<Resolution, ProjectionError> {
        let [across, down] = self.focal_px.map(|focal| 1.0 / focal);
        Resolution::of_rad(across, down)
    }

    /// The points at depth 1 in the middle of the pixels, row by row.
    pub(crate) fn rays(&self) -> impl Iterator<Item = FrdVector> + use<> {
        let ([fx, fy], [cx, cy], [width, height]) = (self.focal_px, self.centre_px, self.size_px);
        (0..height).flat_map(move |v| {
            let down = (v as f32 - cy) / fy;
            (0..width).map(move |u| FrdVector::new(1.0, (u as f32 - cx) / fx, down))
        })
    }

    pub(crate) fn check_size(&self, pixels: usize) -> Result<(), ProjectionError> {
        let [width, height] = self.size_px;
        let error = ProjectionError::ImageSize { pixels, width, height };
        (pixels == width * height).then_some(()).ok_or(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_that_cannot_be_is_refused_by_the_field() {
        let field = |size, focal, centre| match Pinhole::new(size, focal, centre) {
            Err(ProjectionError::Camera { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        assert_eq!(field([0, 480], [600.0; 2], [320.0, 240.0]), "width");
        assert_eq!(field([640, 9000], [600.0; 2], [320.0, 240.0]), "height");
        assert_eq!(field([640, 480], [0.6, 600.0], [320.0, 240.0]), "fx");
        assert_eq!(field([640, 480], [600.0, f32::NAN], [320.0, 240.0]), "fy");
        assert_eq!(field([640, 480], [600.0; 2], [320.0, 480.0]), "cy");
    }
}
