//! Which parameters the model can fly, and the error that says which it cannot.

use crate::vehicle::params::{ControlParams, GRAVITY_M_S2, SensorParams, VehicleParams, Wind};

/// A vehicle parameter that no vehicle can have.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("vehicle parameter `{field}` is {value}; it must be {must_be}")]
pub struct ParamsError {
    /// The field's path in the configuration, for example `airframe.mass_kg`.
    pub field: &'static str,
    /// The refused value.
    pub value: f64,
    /// What is accepted.
    pub must_be: &'static str,
}

fn in_range(field: &'static str, value: f64, low: f64, high: f64, must_be: &'static str) -> Result<(), ParamsError> {
    // A NaN lies in no range.
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(ParamsError { field, value, must_be })
    }
}

fn all_in_range(
    field: &'static str,
    values: &[f64],
    low: f64,
    high: f64,
    must_be: &'static str,
) -> Result<(), ParamsError> {
    values.iter().try_for_each(|&v| in_range(field, v, low, high, must_be))
}

impl VehicleParams {
    /// Whether the model can fly these parameters.
    ///
    /// # Errors
    /// Names the first field that is not finite or out of range, its value and what is accepted.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let a = &self.airframe;
        in_range("airframe.mass_kg", a.mass_kg, 0.1, 50.0, "from 0.1 to 50 kg")?;
        all_in_range(
            "airframe.inertia_kg_m2",
            &a.inertia_kg_m2,
            1e-4,
            10.0,
            "from 0.0001 to 10 kg·m²",
        )?;
        in_range("airframe.arm_forward_m", a.arm_forward_m, 0.02, 2.0, "from 0.02 to 2 m")?;
        in_range("airframe.arm_right_m", a.arm_right_m, 0.02, 2.0, "from 0.02 to 2 m")?;
        all_in_range(
            "airframe.drag_linear_n_s_m",
            &a.drag_linear_n_s_m,
            0.0,
            10.0,
            "from 0 to 10 N per m/s",
        )?;
        in_range(
            "airframe.drag_quadratic_n_s2_m2",
            a.drag_quadratic_n_s2_m2,
            0.0,
            5.0,
            "from 0 to 5 N per (m/s)²",
        )?;
        in_range("airframe.gear_height_m", a.gear_height_m, 0.02, 1.0, "from 0.02 to 1 m")?;
        in_range(
            "airframe.gear_half_track_m",
            a.gear_half_track_m,
            0.02,
            1.0,
            "from 0.02 to 1 m",
        )?;

        let m = &self.motors;
        in_range(
            "motors.thrust_coefficient_n_s2",
            m.thrust_coefficient_n_s2,
            1e-8,
            1e-2,
            "from 1e-8 to 0.01 N per (rad/s)²",
        )?;
        in_range(
            "motors.torque_per_thrust_m",
            m.torque_per_thrust_m,
            1e-4,
            1.0,
            "from 0.0001 to 1 m",
        )?;
        in_range(
            "motors.max_speed_rad_s",
            m.max_speed_rad_s,
            10.0,
            10_000.0,
            "from 10 to 10 000 rad/s",
        )?;
        in_range(
            "motors.idle_speed_rad_s",
            m.idle_speed_rad_s,
            0.0,
            0.5 * m.max_speed_rad_s,
            "from 0 to half of motors.max_speed_rad_s",
        )?;
        in_range("motors.rise_s", m.rise_s, 1e-3, 0.2, "from 0.001 to 0.2 s")?;
        in_range("motors.fall_s", m.fall_s, 1e-3, 0.2, "from 0.001 to 0.2 s")?;
        let thrust_to_weight =
            4.0 * m.thrust_coefficient_n_s2 * m.max_speed_rad_s * m.max_speed_rad_s / (a.mass_kg * GRAVITY_M_S2);
        in_range(
            "motors (thrust-to-weight ratio)",
            thrust_to_weight,
            1.2,
            20.0,
            "from 1.2 to 20: raise or lower motors.max_speed_rad_s, motors.thrust_coefficient_n_s2 or airframe.mass_kg",
        )?;

        let g = &self.ground;
        // Explicit integration at 1 ms bounds what the ground may be made of.
        in_range(
            "ground.stiffness_n_m",
            g.stiffness_n_m,
            100.0 * a.mass_kg,
            10_000.0 * a.mass_kg,
            "from 100 to 10 000 N/m per kilogram of mass",
        )?;
        in_range(
            "ground.damping_n_s_m",
            g.damping_n_s_m,
            a.mass_kg,
            100.0 * a.mass_kg,
            "from 1 to 100 N per m/s per kilogram of mass",
        )?;
        in_range("ground.friction", g.friction, 0.0, 2.0, "from 0 to 2")?;

        let b = &self.battery;
        in_range(
            "battery.capacity_ah",
            b.capacity_ah,
            0.01,
            1000.0,
            "from 0.01 to 1000 Ah",
        )?;
        in_range("battery.initial_charge", b.initial_charge, 0.0, 1.0, "from 0 to 1")?;
        in_range("battery.empty_v", b.empty_v, 1.0, 1000.0, "from 1 to 1000 V")?;
        in_range(
            "battery.full_v",
            b.full_v,
            b.empty_v,
            1000.0,
            "from battery.empty_v to 1000 V",
        )?;
        in_range("battery.nominal_v", b.nominal_v, 1.0, 1000.0, "from 1 to 1000 V")?;
        in_range("battery.resistance_ohm", b.resistance_ohm, 0.0, 1.0, "from 0 to 1 Ω")?;
        in_range(
            "battery.motor_efficiency",
            b.motor_efficiency,
            0.05,
            1.0,
            "from 0.05 to 1",
        )?;
        in_range("battery.avionics_a", b.avionics_a, 0.0, 100.0, "from 0 to 100 A")?;

        self.control.validate()?;
        self.sensors.validate()
    }
}

impl ControlParams {
    fn validate(&self) -> Result<(), ParamsError> {
        for (field, value) in [
            ("control.speed_max_m_s", self.speed_max_m_s),
            ("control.climb_max_m_s", self.climb_max_m_s),
            ("control.descent_max_m_s", self.descent_max_m_s),
            ("control.accel_horizontal_m_s2", self.accel_horizontal_m_s2),
            ("control.jerk_horizontal_m_s3", self.jerk_horizontal_m_s3),
            ("control.accel_vertical_m_s2", self.accel_vertical_m_s2),
            ("control.jerk_vertical_m_s3", self.jerk_vertical_m_s3),
            ("control.shaping_horizontal_per_s", self.shaping_horizontal_per_s),
            ("control.shaping_vertical_per_s", self.shaping_vertical_per_s),
            ("control.yaw_rate_max_rad_s", self.yaw_rate_max_rad_s),
            ("control.yaw_accel_rad_s2", self.yaw_accel_rad_s2),
            ("control.shaping_yaw_per_s", self.shaping_yaw_per_s),
            ("control.tilt_rate_max_rad_s", self.tilt_rate_max_rad_s),
        ] {
            in_range(field, value, 0.05, 50.0, "from 0.05 to 50")?;
        }
        in_range(
            "control.yaw_jerk_rad_s3",
            self.yaw_jerk_rad_s3,
            0.5,
            500.0,
            "from 0.5 to 500 rad/s³",
        )?;
        in_range(
            "control.tilt_max_rad",
            self.tilt_max_rad,
            0.05,
            1.2,
            "from 0.05 to 1.2 rad",
        )?;
        in_range(
            "control.thrust_filter_s",
            self.thrust_filter_s,
            0.0,
            1.0,
            "from 0 to 1 s",
        )?;
        for (field, gains) in [
            ("control.approach_gain_per_s", self.approach_gain_per_s),
            ("control.position_gain_per_s", self.position_gain_per_s),
            ("control.velocity_gain_per_s", self.velocity_gain_per_s),
            ("control.velocity_integral_per_s2", self.velocity_integral_per_s2),
            ("control.attitude_gain_per_s", self.attitude_gain_per_s),
            ("control.rate_gain_per_s", self.rate_gain_per_s),
            ("control.rate_integral_per_s2", self.rate_integral_per_s2),
        ] {
            all_in_range(field, &gains, 0.0, 200.0, "from 0 to 200")?;
        }
        in_range("control.velocity_lag_s", self.velocity_lag_s, 0.0, 1.0, "from 0 to 1 s")?;
        in_range("control.braking_share", self.braking_share, 0.1, 1.0, "from 0.1 to 1")
    }
}

impl SensorParams {
    fn validate(&self) -> Result<(), ParamsError> {
        for (field, value) in [
            ("sensors.accelerometer_m_s2", self.accelerometer_m_s2),
            ("sensors.gyroscope_rad_s", self.gyroscope_rad_s),
            ("sensors.gps_position_m", self.gps_position_m),
            ("sensors.gps_velocity_m_s", self.gps_velocity_m_s),
            ("sensors.barometer_m", self.barometer_m),
            ("sensors.estimate_velocity_m_s", self.estimate_velocity_m_s),
            ("sensors.estimate_attitude_rad", self.estimate_attitude_rad),
        ] {
            in_range(field, value, 0.0, 10.0, "from 0 to 10")?;
        }
        for (field, value) in [
            ("sensors.estimate_velocity_time_s", self.estimate_velocity_time_s),
            ("sensors.estimate_position_time_s", self.estimate_position_time_s),
            ("sensors.estimate_attitude_time_s", self.estimate_attitude_time_s),
        ] {
            in_range(field, value, 0.05, 100_000.0, "from 0.05 to 100 000 s")?;
        }
        all_in_range("sensors.wander_m", &self.wander_m, 0.0, 10.0, "from 0 to 10 m")?;
        // The wander's velocity is correlated over two seconds.
        all_in_range(
            "sensors.wander_time_s",
            &self.wander_time_s,
            5.0,
            100_000.0,
            "from 5 to 100 000 s",
        )
    }
}

impl Wind {
    /// Whether this wind is one the model can fly in.
    ///
    /// # Errors
    /// Names the first field that is not finite or out of range.
    pub fn validate(&self) -> Result<(), ParamsError> {
        all_in_range("wind.mean_ned_m_s", &self.mean_ned_m_s, -30.0, 30.0, "within ±30 m/s")?;
        in_range("wind.gust_m_s", self.gust_m_s, 0.0, 15.0, "from 0 to 15 m/s")?;
        in_range(
            "wind.gust_time_s",
            self.gust_time_s,
            0.05,
            1000.0,
            "from 0.05 to 1000 s",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::params::MotorParams;

    #[test]
    fn the_defaults_are_valid_and_survive_a_file() {
        let params = VehicleParams::default();
        params.validate().unwrap();
        Wind::CALM.validate().unwrap();
        let text = toml::to_string(&params).unwrap();
        assert_eq!(toml::from_str::<VehicleParams>(&text).unwrap(), params);
    }

    #[test]
    fn a_file_may_name_only_what_differs_but_nothing_unknown() {
        let params: VehicleParams = toml::from_str("[airframe]\nmass_kg = 1.5").unwrap();
        assert_eq!(params.airframe.mass_kg, 1.5);
        assert_eq!(params.motors, MotorParams::default());
        let error = toml::from_str::<VehicleParams>("[airframe]\nmas_kg = 1.5").unwrap_err();
        assert!(error.to_string().contains("mas_kg"), "{error}");
    }

    #[test]
    fn a_refused_value_is_named_with_what_is_accepted() {
        let mut params = VehicleParams::default();
        params.airframe.mass_kg = f64::NAN;
        let error = params.validate().unwrap_err();
        assert_eq!(error.field, "airframe.mass_kg");
        assert!(error.to_string().contains("from 0.1 to 50 kg"), "{error}");

        let mut params = VehicleParams::default();
        params.motors.max_speed_rad_s = 700.0;
        let error = params.validate().unwrap_err();
        assert!(error.to_string().contains("thrust-to-weight"), "{error}");

        let wind = Wind {
            mean_ned_m_s: [0.0, f64::INFINITY, 0.0],
            ..Wind::CALM
        };
        assert_eq!(wind.validate().unwrap_err().field, "wind.mean_ned_m_s");
    }
}
