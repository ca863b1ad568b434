//! How a sensor sits on the vehicle.

use crate::ProjectionError;
use vigil_types::{Attitude, FrdVector};

/// Position and turn of a sensor on the vehicle. Both have axes forward, right, down; unturned, they are parallel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount {
    /// Columns: the sensor's axes in the vehicle's.
    axes: [FrdVector; 3],
    position_frd_m: FrdVector,
}

impl Mount {
    /// A sensor in the vehicle's middle that looks straight ahead.
    pub const STRAIGHT: Self = Self {
        axes: [
            FrdVector::new(1.0, 0.0, 0.0),
            FrdVector::new(0.0, 1.0, 0.0),
            FrdVector::new(0.0, 0.0, 1.0),
        ],
        position_frd_m: FrdVector::ZERO,
    };

    /// A sensor at `position_frd_m` from the vehicle's middle (the point whose position telemetry reports), metres, whose axes
    /// are turned into the vehicle's by `turn`: as an attitude turns a vehicle's into the world's.
    ///
    /// # Errors
    /// [`ProjectionError::Mount`].
    pub fn new(position_frd_m: FrdVector, turn: Attitude) -> Result<Self, ProjectionError> {
        if !position_frd_m.is_finite() || !turn.is_valid() {
            return Err(ProjectionError::Mount);
        }
        let axis = |v: FrdVector| {
            let [x, y, z] = turn.to_ned(v).to_array();
            FrdVector::new(x, y, z)
        };
        Ok(Self {
            axes: Self::STRAIGHT.axes.map(axis),
            position_frd_m,
        })
    }

    /// A point in the sensor's axes as seen from the vehicle's middle, metres.
    #[inline]
    pub fn to_vehicle(&self, point_frd_m: FrdVector) -> FrdVector {
        let [x, y, z] = self.axes;
        x * point_frd_m.x + y * point_frd_m.y + z * point_frd_m.z + self.position_frd_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f32::consts::FRAC_PI_2;

    #[test]
    fn a_sensor_that_looks_to_the_right_sees_its_ahead_there() {
        let right = Attitude::from_euler_rad(0.0, 0.0, FRAC_PI_2);
        let mount = Mount::new(FrdVector::new(0.1, 0.0, -0.05), right).expect("a mount");
        let seen = mount.to_vehicle(FrdVector::new(2.0, 0.0, 0.0)) - FrdVector::new(0.1, 2.0, -0.05);
        assert!(seen.norm() < 1e-6);
    }

    #[test]
    fn an_impossible_mount_is_refused() {
        let none = Attitude {
            w: 0.5,
            x: 0.0,
            y: 0.0,
            z: 0.0,
        };
        assert_eq!(Mount::new(FrdVector::ZERO, none), Err(ProjectionError::Mount));
        let nowhere = FrdVector::new(f32::NAN, 0.0, 0.0);
        assert_eq!(Mount::new(nowhere, Attitude::LEVEL_NORTH), Err(ProjectionError::Mount));
    }
}
