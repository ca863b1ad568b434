//! The rigid body: six degrees of freedom, integrated at a fixed step.

use crate::vehicle::math::{Rotation, Vec3};
use nalgebra::Quaternion;

/// Position, velocity, attitude and rates of a rigid body with principal axes along forward, right, down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Body {
    pub(crate) position_ned_m: Vec3,
    pub(crate) velocity_ned_m_s: Vec3,
    /// Body to NED.
    pub(crate) attitude: Rotation,
    pub(crate) rates_frd_rad_s: Vec3,
}

impl Body {
    /// At rest at this position.
    pub(crate) fn at_rest(position_ned_m: Vec3, attitude: Rotation) -> Self {
        Self {
            position_ned_m,
            velocity_ned_m_s: Vec3::zeros(),
            attitude,
            rates_frd_rad_s: Vec3::zeros(),
        }
    }

    /// Advances by `dt_s` under an acceleration and a torque that are constant over the step.
    ///
    /// Translation is exact for a constant acceleration. Rotation is a classical Runge-Kutta step of Euler's equations
    /// `I ω̇ = τ − ω × I ω` together with `q̇ = ½ q ⊗ ω`: fourth order, so that angular momentum and energy of a free
    /// body hold.
    pub(crate) fn advance(
        &mut self,
        acceleration_ned_m_s2: &Vec3,
        torque_frd_n_m: &Vec3,
        inertia: &Inertia,
        dt_s: f64,
    ) {
        let a = acceleration_ned_m_s2;
        self.position_ned_m += self.velocity_ned_m_s * dt_s + a * (0.5 * dt_s * dt_s);
        self.velocity_ned_m_s += a * dt_s;

        let q = self.attitude.into_inner();
        let w = self.rates_frd_rad_s;
        let half = 0.5 * dt_s;
        let (dq1, dw1) = rotation_derivative(&q, &w, torque_frd_n_m, inertia);
        let (dq2, dw2) = rotation_derivative(&(q + dq1 * half), &(w + dw1 * half), torque_frd_n_m, inertia);
        let (dq3, dw3) = rotation_derivative(&(q + dq2 * half), &(w + dw2 * half), torque_frd_n_m, inertia);
        let (dq4, dw4) = rotation_derivative(&(q + dq3 * dt_s), &(w + dw3 * dt_s), torque_frd_n_m, inertia);
        let sixth = dt_s / 6.0;
        self.attitude = Rotation::new_normalize(q + (dq1 + (dq2 + dq3) * 2.0 + dq4) * sixth);
        self.rates_frd_rad_s = w + (dw1 + (dw2 + dw3) * 2.0 + dw4) * sixth;
    }
}

/// Principal moments of inertia and their inverses.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Inertia {
    pub(crate) moments_kg_m2: Vec3,
    inverse: Vec3,
}

impl Inertia {
    pub(crate) fn new(moments_kg_m2: [f64; 3]) -> Self {
        let moments_kg_m2 = Vec3::from(moments_kg_m2);
        Self {
            moments_kg_m2,
            inverse: moments_kg_m2.map(|m| 1.0 / m),
        }
    }

    /// `ω × I ω`.
    pub(crate) fn gyroscopic(&self, rates: &Vec3) -> Vec3 {
        rates.cross(&self.moments_kg_m2.component_mul(rates))
    }
}

fn rotation_derivative(q: &Quaternion<f64>, w: &Vec3, torque: &Vec3, inertia: &Inertia) -> (Quaternion<f64>, Vec3) {
    let dq = q * Quaternion::from_parts(0.0, *w) * 0.5;
    let dw = (torque - inertia.gyroscopic(w)).component_mul(&inertia.inverse);
    (dq, dw)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::vehicle::params::GRAVITY_M_S2;
    use proptest::prelude::*;

    const DT_S: f64 = 1e-3;

    pub(crate) fn vector(limit: f64) -> impl Strategy<Value = Vec3> {
        (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

        /// Angular momentum in NED and rotational energy of a free tumbling body stay what they were.
        #[test]
        fn a_free_tumbling_body_keeps_angular_momentum_and_energy(
            rates in vector(15.0),
            tilt in vector(3.0),
            moments in (0.01..0.05f64, 0.01..0.05f64, 0.02..0.06f64),
        ) {
            prop_assume!(rates.norm() > 0.5);
            let inertia = Inertia::new([moments.0, moments.1, moments.2]);
            let mut body = Body::at_rest(Vec3::zeros(), Rotation::from_scaled_axis(tilt));
            body.rates_frd_rad_s = rates;
            let momentum = |b: &Body| b.attitude * inertia.moments_kg_m2.component_mul(&b.rates_frd_rad_s);
            let energy = |b: &Body| 0.5 * b.rates_frd_rad_s.dot(&inertia.moments_kg_m2.component_mul(&b.rates_frd_rad_s));
            let (momentum_0, energy_0) = (momentum(&body), energy(&body));
            for _ in 0..5_000 {
                body.advance(&Vec3::zeros(), &Vec3::zeros(), &inertia, DT_S);
            }
            let drift = (momentum(&body) - momentum_0).norm() / momentum_0.norm();
            prop_assert!(drift < 1e-5, "momentum drifted by {drift}");
            let drift = (energy(&body) / energy_0 - 1.0).abs();
            prop_assert!(drift < 1e-6, "energy drifted by {drift}");
            prop_assert!((body.attitude.norm() - 1.0).abs() < 1e-12);
        }

        /// Without drag a thrown body trades height for speed and follows the parabola of the school book.
        #[test]
        fn free_fall_keeps_energy_and_follows_the_parabola(velocity in vector(20.0)) {
            let inertia = Inertia::new([0.02, 0.02, 0.04]);
            let mut body = Body::at_rest(Vec3::new(0.0, 0.0, -100.0), Rotation::identity());
            body.velocity_ned_m_s = velocity;
            let g = Vec3::new(0.0, 0.0, GRAVITY_M_S2);
            let energy = |b: &Body| 0.5 * b.velocity_ned_m_s.norm_squared() - GRAVITY_M_S2 * b.position_ned_m.z;
            let before = energy(&body);
            for _ in 0..3_000 {
                body.advance(&g, &Vec3::zeros(), &inertia, DT_S);
            }
            prop_assert!((energy(&body) - before).abs() < 1e-8 * before);
            let expected = Vec3::new(0.0, 0.0, -100.0) + velocity * 3.0 + g * 4.5;
            prop_assert!((body.position_ned_m - expected).norm() < 1e-8);
        }

        /// The work of a torque about a principal axis is the energy gained.
        #[test]
        fn a_torque_about_a_principal_axis_spins_up_by_the_text_book(torque in -0.5..0.5f64) {
            let inertia = Inertia::new([0.02, 0.02, 0.04]);
            let mut body = Body::at_rest(Vec3::zeros(), Rotation::identity());
            for _ in 0..1_000 {
                body.advance(&Vec3::zeros(), &Vec3::new(0.0, 0.0, torque), &inertia, DT_S);
            }
            let expected_rate = torque / 0.04;
            let expected_yaw = 0.5 * expected_rate;
            prop_assert!((body.rates_frd_rad_s.z - expected_rate).abs() < 1e-9);
            let yaw = crate::vehicle::math::yaw_of(&body.attitude);
            prop_assert!(crate::vehicle::math::wrap(yaw - expected_yaw).abs() < 1e-9);
        }
    }
}
