//! Vehicles as others' are: named models, each fitted to the measured answers of an autopilot, and draws between them.

use crate::vehicle::noise::Noise;
use crate::vehicle::params::{AirframeParams, ControlParams, HoldLaw, SensorParams, VehicleParams, VelocityLaw};
use vigil_types::named;

named! {
    /// A vehicle and its autopilot by its name on the command line. What each was fitted to, and how well it fits: `docs/vehicle.md`.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum VehicleModel {
        /// The light, quiet vehicle that everything here was built on; it answers setpoints as ArduCopter does.
        #[default]
        Ours => "ours",
        /// PX4 1.18 with its own simulator SIH as shipped: strong drag.
        Px4Sih => "px4-sih",
        /// The same with a fifth of the drag.
        Px4Light => "px4-light",
        /// ArduCopter 4.6 with stock parameters, whose BRAKE takes about 1.5 s times the speed.
        ArduCopter => "arducopter",
    }
}

impl VehicleModel {
    /// What it is made of.
    pub fn params(self) -> VehicleParams {
        match self {
            Self::Ours => VehicleParams::default(),
            // SIH_KDV is 1 N per m/s at 1 kg.
            Self::Px4Sih => px4(1.0, 0.85),
            Self::Px4Light => px4(0.2, 0.5),
            Self::ArduCopter => VehicleParams {
                control: ControlParams {
                    hold: HoldLaw::Brake,
                    ..ControlParams::default()
                },
                ..VehicleParams::default()
            },
        }
    }
}

/// A multicopter under PX4's default gains and limits (`MPC_*`, `MC_*`), with this drag in m/s² per m/s.
fn px4(drag_per_s: f64, braking_share: f64) -> VehicleParams {
    let airframe = AirframeParams::default();
    let drag_n_s_m = drag_per_s * airframe.mass_kg;
    VehicleParams {
        airframe: AirframeParams {
            drag_linear_n_s_m: [drag_n_s_m; 3],
            drag_quadratic_n_s2_m2: 0.0,
            ..airframe
        },
        control: ControlParams {
            velocity_law: VelocityLaw::Direct,
            velocity_lag_s: 0.07,
            braking_share,
            hold: HoldLaw::FlyBack,
            speed_max_m_s: 12.0,
            climb_max_m_s: 3.0,
            accel_horizontal_m_s2: 3.0,
            jerk_horizontal_m_s3: 4.0,
            accel_vertical_m_s2: 3.0,
            jerk_vertical_m_s3: 4.0,
            yaw_accel_rad_s2: 1.6,
            yaw_jerk_rad_s3: 20.0,
            shaping_yaw_per_s: 4.5,
            tilt_max_rad: 45f64.to_radians(),
            approach_gain_per_s: [0.95, 1.0],
            position_gain_per_s: [0.95, 1.0],
            velocity_gain_per_s: [1.8, 4.0],
            thrust_filter_s: 0.07,
            velocity_integral_per_s2: [0.46, 2.0],
            attitude_gain_per_s: [4.0, 2.0],
            ..ControlParams::default()
        },
        ..VehicleParams::default()
    }
}

impl VehicleParams {
    /// The same with the estimate of an autopilot that hangs on GPS and barometer: its position wanders by half a metre, its height by
    /// up to a metre over minutes, and a hold wanders with it. PX4's velocity is off beside that, its heading wanders in the air, and
    /// its height faster.
    pub fn with_noisy_estimate(self) -> Self {
        let mut noisy = self.wandering(1.0);
        if noisy.control.velocity_law == VelocityLaw::Direct {
            let sensors = &mut noisy.sensors;
            (sensors.wander_m[1], sensors.wander_time_s[1]) = (0.4, 16.0);
            sensors.heading_error_rad = 4.3f64.to_radians();
        }
        noisy
    }

    fn wandering(mut self, share: f64) -> Self {
        self.sensors = SensorParams {
            wander_m: [0.35 * share, 0.5 * share],
            velocity_error_m_s: match self.control.velocity_law {
                VelocityLaw::Direct => [0.17 * share, 0.1 * share],
                VelocityLaw::Shaped => [0.0; 2],
            },
            ..self.sensors
        };
        self
    }

    /// A vehicle drawn between the models, for training: one seed gives one vehicle. Half of them shape a wanted velocity as
    /// ArduCopter does, half follow it directly as PX4 does, with any drag up to SIH's; limits and gains lie 20 % around the
    /// models', and half of the vehicles have an estimate that wanders, at most as [`Self::with_noisy_estimate`].
    pub fn drawn(seed: u64) -> Self {
        let mut noise = Noise::new(seed, 4);
        let is_direct = noise.uniform() < 0.5;
        let drag_per_s = 1.1 * noise.uniform();
        let mut params = if is_direct {
            px4(drag_per_s, 0.5 + 0.35 * drag_per_s.min(1.0))
        } else {
            Self::default()
        };
        let c = &mut params.control;
        for value in [
            &mut c.accel_horizontal_m_s2,
            &mut c.jerk_horizontal_m_s3,
            &mut c.shaping_horizontal_per_s,
            &mut c.velocity_gain_per_s[0],
            &mut c.velocity_integral_per_s2[0],
            &mut c.attitude_gain_per_s[0],
            &mut c.yaw_accel_rad_s2,
            &mut c.shaping_yaw_per_s,
        ] {
            *value *= 0.8 + 0.4 * noise.uniform();
        }
        let share = (2.0 * noise.uniform() - 1.0).max(0.0);
        params.wandering(share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_and_every_draw_is_a_vehicle() {
        for model in VehicleModel::ALL {
            model.params().validate().unwrap();
            model.params().with_noisy_estimate().validate().unwrap();
        }
        let drawn: Vec<VehicleParams> = (0..500).map(VehicleParams::drawn).collect();
        for params in &drawn {
            params.validate().unwrap();
        }
        assert_eq!(drawn[7], VehicleParams::drawn(7));
        let share = |is: fn(&VehicleParams) -> bool| drawn.iter().filter(|p| is(p)).count();
        let direct = share(|p| p.control.velocity_law == VelocityLaw::Direct);
        let wandering = share(|p| p.sensors.wander_m[0] > 0.0);
        // Half of 500 each, within five standard deviations.
        let is_half = |count: usize| count.abs_diff(250) < 56;
        assert!(is_half(direct) && is_half(wandering), "{direct} {wandering}");
    }
}
