//! The vehicle's size, in the one place where it is defined.

use vigil_types::{Attitude, FrdVector};

/// The vehicle as an upright cylinder in its body axes, centred on its position: propellers included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VehicleSolid {
    /// Radius around the body's down axis.
    pub radius_m: f32,
    /// Height along it.
    pub height_m: f32,
}

/// The simulated quadcopter: 0.60 m over the propeller tips, 0.20 m high.
pub const VEHICLE: VehicleSolid = VehicleSolid {
    radius_m: 0.30,
    height_m: 0.20,
};

impl VehicleSolid {
    /// How far the solid reaches above and below its centre at an attitude.
    pub fn vertical_reach_m(&self, attitude: Attitude) -> f32 {
        let axis = attitude.to_ned(FrdVector::new(0.0, 0.0, 1.0));
        let cos_tilt = axis.z.abs().min(1.0);
        0.5 * self.height_m * cos_tilt + self.radius_m * libm::sqrtf(1.0 - cos_tilt * cos_tilt)
    }

    /// Radius of the sphere around the centre that holds the solid at any attitude.
    pub fn bounding_radius_m(&self) -> f32 {
        libm::hypotf(self.radius_m, 0.5 * self.height_m)
    }
}
