//! Vectors whose frame is part of their type, and the attitude that turns one frame into another.

use core::marker::PhantomData;
use core::ops::{Add, Mul, Neg, Sub};

/// Marks the coordinate frame of a [`Vector`].
pub trait Frame: Copy {}

/// North, east, down; origin at the vehicle's home.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Ned;

/// Forward, right, down; fixed to the body, tilting with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Frd;

/// Forward, right, down with forward along the heading and down along gravity: NED turned by yaw alone.
/// This is what `MAV_FRAME_BODY_NED` velocity setpoints mean to PX4 and ArduPilot (docs/mavlink.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Heading;

impl Frame for Ned {}
impl Frame for Frd {}
impl Frame for Heading {}

/// Three components in frame `F`; the unit is that of the field which holds it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct Vector<F: Frame> {
    /// North or forward.
    pub x: f32,
    /// East or right.
    pub y: f32,
    /// Down.
    pub z: f32,
    frame: PhantomData<F>,
}

/// A vector in north-east-down axes.
pub type NedVector = Vector<Ned>;
/// A vector in body axes.
pub type FrdVector = Vector<Frd>;
/// A vector in level axes along the heading.
pub type HeadingVector = Vector<Heading>;

impl<F: Frame> Vector<F> {
    /// The zero vector.
    pub const ZERO: Self = Self::new(0.0, 0.0, 0.0);

    /// A vector of the three components.
    #[inline]
    pub const fn new(x: f32, y: f32, z: f32) -> Self {
        Self {
            x,
            y,
            z,
            frame: PhantomData,
        }
    }

    /// Components as an array `[x, y, z]`.
    #[inline]
    pub const fn to_array(self) -> [f32; 3] {
        [self.x, self.y, self.z]
    }

    /// Length of the horizontal part (x, y).
    #[inline]
    pub fn horizontal_norm(self) -> f32 {
        libm::sqrtf(self.x * self.x + self.y * self.y)
    }

    /// Euclidean length.
    #[inline]
    pub fn norm(self) -> f32 {
        libm::sqrtf(self.x * self.x + self.y * self.y + self.z * self.z)
    }

    /// Whether no component is NaN or infinite.
    #[inline]
    pub fn is_finite(self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.z.is_finite()
    }
}

impl<F: Frame> Add for Vector<F> {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        Self::new(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl<F: Frame> Sub for Vector<F> {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        Self::new(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl<F: Frame> Neg for Vector<F> {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}

impl<F: Frame> Mul<f32> for Vector<F> {
    type Output = Self;
    #[inline]
    fn mul(self, k: f32) -> Self {
        Self::new(self.x * k, self.y * k, self.z * k)
    }
}

impl HeadingVector {
    /// Turns a heading-frame vector into NED, given the heading (yaw, clockwise from north).
    #[inline]
    pub fn to_ned(self, yaw_rad: f32) -> NedVector {
        let (s, c) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        NedVector::new(c * self.x - s * self.y, s * self.x + c * self.y, self.z)
    }
}

impl NedVector {
    /// Turns a NED vector into level axes along the heading (yaw, clockwise from north).
    #[inline]
    pub fn to_heading(self, yaw_rad: f32) -> HeadingVector {
        let (s, c) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        HeadingVector::new(c * self.x + s * self.y, -s * self.x + c * self.y, self.z)
    }
}

/// A unit quaternion that turns body (FRD) vectors into NED: `v_ned = q ⊗ v_frd ⊗ q*`, Hamilton convention, as in
/// MAVLink's ATTITUDE_QUATERNION.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct Attitude {
    /// Scalar part.
    pub w: f32,
    /// First vector part.
    pub x: f32,
    /// Second vector part.
    pub y: f32,
    /// Third vector part.
    pub z: f32,
}

impl Default for Attitude {
    fn default() -> Self {
        Self::LEVEL_NORTH
    }
}

impl Attitude {
    /// Level, heading north.
    pub const LEVEL_NORTH: Self = Self {
        w: 1.0,
        x: 0.0,
        y: 0.0,
        z: 0.0,
    };

    /// From roll, pitch and yaw in radians (intrinsic yaw, then pitch, then roll).
    pub fn from_euler_rad(roll_rad: f32, pitch_rad: f32, yaw_rad: f32) -> Self {
        let (sr, cr) = (libm::sinf(roll_rad / 2.0), libm::cosf(roll_rad / 2.0));
        let (sp, cp) = (libm::sinf(pitch_rad / 2.0), libm::cosf(pitch_rad / 2.0));
        let (sy, cy) = (libm::sinf(yaw_rad / 2.0), libm::cosf(yaw_rad / 2.0));
        Self {
            w: cr * cp * cy + sr * sp * sy,
            x: sr * cp * cy - cr * sp * sy,
            y: cr * sp * cy + sr * cp * sy,
            z: cr * cp * sy - sr * sp * cy,
        }
    }

    /// Roll in radians, positive right side down.
    pub fn roll_rad(self) -> f32 {
        libm::atan2f(
            2.0 * (self.w * self.x + self.y * self.z),
            1.0 - 2.0 * (self.x * self.x + self.y * self.y),
        )
    }

    /// Pitch in radians, positive nose up.
    pub fn pitch_rad(self) -> f32 {
        libm::asinf((2.0 * (self.w * self.y - self.z * self.x)).clamp(-1.0, 1.0))
    }

    /// Heading in radians, clockwise from north, in (−π, π].
    pub fn yaw_rad(self) -> f32 {
        libm::atan2f(
            2.0 * (self.w * self.z + self.x * self.y),
            1.0 - 2.0 * (self.y * self.y + self.z * self.z),
        )
    }

    /// The same with the heading turned clockwise.
    pub fn turned_heading(self, by_rad: f32) -> Self {
        let (s, c) = (libm::sinf(by_rad / 2.0), libm::cosf(by_rad / 2.0));
        Self {
            w: c * self.w - s * self.z,
            x: c * self.x - s * self.y,
            y: c * self.y + s * self.x,
            z: c * self.z + s * self.w,
        }
    }

    /// Turns a body vector into NED.
    #[inline]
    pub fn to_ned(self, v: FrdVector) -> NedVector {
        let (x, y, z) = rotate(self.w, self.x, self.y, self.z, v.x, v.y, v.z);
        NedVector::new(x, y, z)
    }

    /// Turns a NED vector into body axes.
    #[inline]
    pub fn to_frd(self, v: NedVector) -> FrdVector {
        let (x, y, z) = rotate(self.w, -self.x, -self.y, -self.z, v.x, v.y, v.z);
        FrdVector::new(x, y, z)
    }

    /// Whether all parts are finite and the norm is 1 within 1 %.
    pub fn is_valid(self) -> bool {
        let n2 = self.w * self.w + self.x * self.x + self.y * self.y + self.z * self.z;
        n2.is_finite() && (n2 - 1.0).abs() < 0.02
    }
}

#[inline]
fn rotate(w: f32, qx: f32, qy: f32, qz: f32, x: f32, y: f32, z: f32) -> (f32, f32, f32) {
    // v + 2w (q × v) + 2 q × (q × v)
    let (tx, ty, tz) = (
        2.0 * (qy * z - qz * y),
        2.0 * (qz * x - qx * z),
        2.0 * (qx * y - qy * x),
    );
    (
        x + w * tx + (qy * tz - qz * ty),
        y + w * ty + (qz * tx - qx * tz),
        z + w * tz + (qx * ty - qy * tx),
    )
}

/// Wraps an angle in radians into (−π, π]. Non-finite input gives NaN.
pub fn wrap_pi(angle_rad: f32) -> f32 {
    use core::f32::consts::{PI, TAU};
    let r = libm::fmodf(angle_rad, TAU);
    if r > PI {
        r - TAU
    } else if r <= -PI {
        r + TAU
    } else {
        r
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f32::consts::{FRAC_PI_2, PI};

    #[test]
    fn a_nose_east_vehicle_sees_north_on_its_left() {
        let east = Attitude::from_euler_rad(0.0, 0.0, FRAC_PI_2);
        let north = east.to_frd(NedVector::new(1.0, 0.0, 0.0));
        assert!((north.y + 1.0).abs() < 1e-6, "{north:?}");
        let back = east.to_ned(north);
        assert!((back.x - 1.0).abs() < 1e-6);
        let h = NedVector::new(1.0, 0.0, 0.5).to_heading(FRAC_PI_2);
        assert!((h.y + 1.0).abs() < 1e-6 && (h.z - 0.5).abs() < 1e-6);
        assert!((h.to_ned(FRAC_PI_2).x - 1.0).abs() < 1e-6);
    }

    #[test]
    fn euler_angles_survive_the_quaternion() {
        let q = Attitude::from_euler_rad(0.2, -0.3, 2.5);
        assert!((q.roll_rad() - 0.2).abs() < 1e-5);
        assert!((q.pitch_rad() + 0.3).abs() < 1e-5);
        assert!((q.yaw_rad() - 2.5).abs() < 1e-5);
        assert!(q.is_valid());
    }

    #[test]
    fn a_nose_up_vehicle_points_its_forward_axis_at_the_sky() {
        let up = Attitude::from_euler_rad(0.0, 0.5, 0.0).to_ned(FrdVector::new(1.0, 0.0, 0.0));
        assert!(up.z < -0.4);
    }

    #[test]
    fn angles_wrap_into_half_open_pi() {
        assert!((wrap_pi(3.0 * PI) - PI).abs() < 1e-5);
        assert!((wrap_pi(-0.5) + 0.5).abs() < 1e-7);
        assert!((wrap_pi(4.0) - (4.0 - 2.0 * PI)).abs() < 1e-6);
        assert!(wrap_pi(f32::NAN).is_nan());
    }
}
