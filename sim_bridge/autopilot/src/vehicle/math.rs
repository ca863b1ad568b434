//! Vectors and rotations in f64, with libm's functions so that the bits match across machines.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use vigil_types::{Attitude, Frame, Vector};

pub(crate) type Vec3 = Vector3<f64>;
pub(crate) type Rotation = UnitQuaternion<f64>;

/// Turn about the down axis: heading.
pub(crate) fn heading(yaw_rad: f64) -> Rotation {
    let half = 0.5 * yaw_rad;
    Rotation::new_unchecked(Quaternion::new(libm::cos(half), 0.0, 0.0, libm::sin(half)))
}

/// Yaw, clockwise from north, in [−π, π].
pub(crate) fn yaw_of(q: &Rotation) -> f64 {
    libm::atan2(2.0 * (q.w * q.k + q.i * q.j), 1.0 - 2.0 * (q.j * q.j + q.k * q.k))
}

/// The rotation by a small rotation vector, exact to third order and normalised.
pub(crate) fn small_rotation(v: &Vec3) -> Rotation {
    let h = v * 0.5;
    Rotation::new_normalize(Quaternion::new(1.0 - 0.5 * h.norm_squared(), h.x, h.y, h.z))
}

/// Body to NED: the shortest turn that brings the down axis onto `down_ned` (unit), after a turn to the heading.
pub(crate) fn tilt_and_heading(down_ned: &Vec3, yaw_rad: f64) -> Rotation {
    // Half-way construction: (1 + a·b, a × b) with a = (0, 0, 1).
    let w = (1.0 + down_ned.z).max(1e-6);
    let tilt = Rotation::new_normalize(Quaternion::new(w, -down_ned.y, down_ned.x, 0.0));
    tilt * heading(yaw_rad)
}

/// Wraps an angle into [−π, π].
pub(crate) fn wrap(angle_rad: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    if angle_rad.abs() <= PI {
        return angle_rad;
    }
    let r = libm::fmod(angle_rad, TAU);
    if r > PI {
        r - TAU
    } else if r < -PI {
        r + TAU
    } else {
        r
    }
}

/// In single precision.
pub(crate) fn single<F: Frame>(v: &Vec3) -> Vector<F> {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

pub(crate) fn attitude(q: &Rotation) -> Attitude {
    Attitude {
        w: q.w as f32,
        x: q.i as f32,
        y: q.j as f32,
        z: q.k as f32,
    }
}

pub(crate) fn vec3<F: Frame>(v: Vector<F>) -> Vec3 {
    v.to_array().map(f64::from).into()
}

pub(crate) fn from_attitude(a: Attitude) -> Rotation {
    let [w, x, y, z] = [a.w, a.x, a.y, a.z].map(f64::from);
    Rotation::new_normalize(Quaternion::new(w, x, y, z))
}

/// The bits of a state.
#[derive(Default)]
pub(crate) struct StateBytes(pub(crate) Vec<u8>);

impl StateBytes {
    pub(crate) fn word(&mut self, word: u64) {
        self.0.extend(word.to_le_bytes());
    }

    pub(crate) fn numbers<'a>(&mut self, numbers: impl IntoIterator<Item = &'a f64>) {
        numbers.into_iter().for_each(|n| self.word(n.to_bits()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilt_points_the_down_axis_and_keeps_the_heading() {
        let down = Vec3::new(-0.3, 0.2, 0.9).normalize();
        let q = tilt_and_heading(&down, 1.2);
        assert!((q * Vec3::z() - down).norm() < 1e-12);
        // The shortest turn moves the heading only in second order of the tilt.
        assert!((yaw_of(&q) - 1.2).abs() < 0.05);
        assert!((yaw_of(&heading(-3.0)) + 3.0).abs() < 1e-12);
    }

    #[test]
    fn small_rotations_agree_with_the_exponential() {
        let v = Vec3::new(0.004, -0.007, 0.002);
        assert!(small_rotation(&v).angle_to(&Rotation::from_scaled_axis(v)) < 1e-7);
    }

    #[test]
    fn angles_wrap() {
        assert!((wrap(4.0) - (4.0 - core::f64::consts::TAU)).abs() < 1e-12);
        assert!((wrap(-20.0) - (-20.0 + 3.0 * core::f64::consts::TAU)).abs() < 1e-12);
        assert_eq!(wrap(1.0), 1.0);
    }
}
