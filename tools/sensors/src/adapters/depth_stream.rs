//! A depth camera's raw stream: images of 16-bit units one behind the other, nothing between (V4L2's `Z16 `, RealSense's Z16).

use super::{Fault, SetupError};
use crate::{Mount, Pinhole, Projector, View, check_unit};
use vigil_types::DEPTH_PIXELS;

/// Images of a raw stream become depth images.
pub struct DepthStream {
    camera: Pinhole,
    mount: Mount,
    metres_per_unit: f32,
    projector: Projector,
    units: Vec<u16>,
    /// The part of our image that the camera sees.
    pub view: View,
}

impl DepthStream {
    /// For a rectified camera that is mounted so; `metres_per_unit` is 0.001 for most.
    ///
    /// # Errors
    /// A unit or a resolution that cannot be, a mount that turns the camera away.
    pub fn new(camera: Pinhole, mount: Mount, metres_per_unit: f32) -> Result<Self, SetupError> {
        check_unit(metres_per_unit)?;
        let mut projector = Projector::new(camera.resolution()?);
        let [width, height] = camera.size_px();
        projector.add_depth_m(&mount, &camera, &vec![10.0; width * height])?;
        let mut depth = Box::new([1.0; DEPTH_PIXELS]);
        projector.finish(&mut depth);
        Ok(Self {
            view: View::of(&depth).ok_or(SetupError::LooksElsewhere)?,
            units: vec![0; width * height],
            camera,
            mount,
            metres_per_unit,
            projector,
        })
    }

    /// Bytes of an image.
    pub fn image_bytes(&self) -> usize {
        2 * self.units.len()
    }

    /// Projects an image.
    ///
    /// # Errors
    /// [`Fault::ImageLength`], [`Fault::EmptyImage`].
    pub fn image(&mut self, bytes: &[u8], depth: &mut [f32; DEPTH_PIXELS]) -> Result<(), Fault> {
        let wrong = Fault::ImageLength {
            got: bytes.len(),
            expected: self.image_bytes(),
        };
        if bytes.len() != self.image_bytes() {
            return Err(wrong);
        }
        for (unit, pair) in self.units.iter_mut().zip(bytes.chunks_exact(2)) {
            *unit = u16::from_le_bytes([pair[0], pair[1]]);
        }
        self.projector
            .add_depth_units(&self.mount, &self.camera, &self.units, self.metres_per_unit)
            .map_err(|_| wrong)?;
        match self.projector.finish(depth) {
            0 => Err(Fault::EmptyImage),
            _ => Ok(()),
        }
    }
}
