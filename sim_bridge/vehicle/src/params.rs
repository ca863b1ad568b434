//! What the vehicle is made of: every number of the model, with its default and its source.

use serde::{Deserialize, Serialize};

/// Standard gravity, metres per second squared.
pub const GRAVITY_M_S2: f64 = 9.80665;

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

/// The whole vehicle. The default is an X500-class quadcopter of 2 kg; `docs/vehicle.md` says where each default comes from.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VehicleParams {
    /// Mass, inertia, geometry, drag.
    pub airframe: AirframeParams,
    /// The four motors with their propellers.
    pub motors: MotorParams,
    /// What happens when it touches the ground.
    pub ground: GroundParams,
    /// Voltage and charge.
    pub battery: BatteryParams,
    /// Limits and gains of the autopilot's controllers.
    pub control: ControlParams,
    /// Sensor noise and estimator error.
    pub sensors: SensorParams,
}

/// Mass, inertia, geometry and drag.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AirframeParams {
    /// Mass, kilograms.
    pub mass_kg: f64,
    /// Principal moments of inertia about forward, right and down, kg·m².
    pub inertia_kg_m2: [f64; 3],
    /// Distance of each motor forward or behind the centre of mass, metres.
    pub arm_forward_m: f64,
    /// Distance of each motor to the right or left of the centre of mass, metres.
    pub arm_right_m: f64,
    /// Drag proportional to airspeed along each body axis (mostly the rotors), N per m/s.
    pub drag_linear_n_s_m: [f64; 3],
    /// Drag proportional to the square of the airspeed (the body), N per (m/s)².
    pub drag_quadratic_n_s2_m2: f64,
    /// Height of the centre of mass above the feet, metres. On the ground the position is this far above home.
    pub gear_height_m: f64,
    /// Distance of each foot from the centre line, forward and to the side, metres.
    pub gear_half_track_m: f64,
}

impl Default for AirframeParams {
    fn default() -> Self {
        Self {
            mass_kg: 2.0,
            inertia_kg_m2: [0.021_67, 0.021_67, 0.040],
            arm_forward_m: 0.174,
            arm_right_m: 0.174,
            drag_linear_n_s_m: [0.24, 0.24, 0.12],
            drag_quadratic_n_s2_m2: 0.04,
            gear_height_m: 0.12,
            gear_half_track_m: 0.13,
        }
    }
}

/// Motors with their propellers: thrust = coefficient · speed², first-order lag in speed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotorParams {
    /// Thrust per squared speed, N per (rad/s)².
    pub thrust_coefficient_n_s2: f64,
    /// Reaction torque per thrust, metres.
    pub torque_per_thrust_m: f64,
    /// Slowest speed of an armed motor, rad/s.
    pub idle_speed_rad_s: f64,
    /// Fastest speed at the battery's nominal voltage, rad/s; it scales with the voltage below that.
    pub max_speed_rad_s: f64,
    /// Time constant of speeding up, seconds.
    pub rise_s: f64,
    /// Time constant of slowing down, seconds.
    pub fall_s: f64,
}

impl Default for MotorParams {
    fn default() -> Self {
        Self {
            thrust_coefficient_n_s2: 8.548_58e-6,
            torque_per_thrust_m: 0.016,
            idle_speed_rad_s: 150.0,
            max_speed_rad_s: 1100.0,
            rise_s: 0.0125,
            fall_s: 0.025,
        }
    }
}

/// Contact of feet and arms with the flat ground at height 0: spring and damper, Coulomb friction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GroundParams {
    /// Stiffness of each contact point, N/m.
    pub stiffness_n_m: f64,
    /// Damping of each contact point, N per m/s.
    pub damping_n_s_m: f64,
    /// Coefficient of friction.
    pub friction: f64,
}

impl Default for GroundParams {
    fn default() -> Self {
        Self {
            stiffness_n_m: 3000.0,
            damping_n_s_m: 60.0,
            friction: 0.8,
        }
    }
}

/// A battery: open-circuit voltage linear in charge, and a series resistance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BatteryParams {
    /// Capacity, ampere-hours.
    pub capacity_ah: f64,
    /// Charge at the start, 0 to 1.
    pub initial_charge: f64,
    /// Open-circuit voltage when full, volts.
    pub full_v: f64,
    /// Open-circuit voltage when empty, volts.
    pub empty_v: f64,
    /// Voltage at which the motors reach their stated top speed, volts.
    pub nominal_v: f64,
    /// Series resistance, ohms.
    pub resistance_ohm: f64,
    /// Mechanical power out per electrical power in.
    pub motor_efficiency: f64,
    /// Current of everything but the motors, amperes.
    pub avionics_a: f64,
}

impl Default for BatteryParams {
    fn default() -> Self {
        Self {
            capacity_ah: 5.0,
            initial_charge: 1.0,
            full_v: 16.8,
            empty_v: 13.2,
            nominal_v: 14.8,
            resistance_ohm: 0.02,
            motor_efficiency: 0.75,
            avionics_a: 1.5,
        }
    }
}

/// Limits and gains of the controllers. Limits are ArduCopter's stock values where it has one; the gains were set so
/// that the answer to setpoints lies in the measured bands (`docs/vehicle.md`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControlParams {
    /// Fastest horizontal velocity setpoint, m/s.
    pub speed_max_m_s: f64,
    /// Fastest climb, m/s.
    pub climb_max_m_s: f64,
    /// Fastest descent, m/s.
    pub descent_max_m_s: f64,
    /// Horizontal acceleration limit of the shaped velocity, m/s².
    pub accel_horizontal_m_s2: f64,
    /// Horizontal jerk limit, m/s³.
    pub jerk_horizontal_m_s3: f64,
    /// Vertical acceleration limit, m/s².
    pub accel_vertical_m_s2: f64,
    /// Vertical jerk limit, m/s³.
    pub jerk_vertical_m_s3: f64,
    /// How fast the last part of a horizontal velocity step is closed, 1/s.
    pub shaping_horizontal_per_s: f64,
    /// How fast the last part of a vertical velocity step is closed, 1/s.
    pub shaping_vertical_per_s: f64,
    /// Yaw rate limit, rad/s.
    pub yaw_rate_max_rad_s: f64,
    /// Yaw acceleration limit of the shaped yaw rate, rad/s².
    pub yaw_accel_rad_s2: f64,
    /// Yaw jerk limit, rad/s³.
    pub yaw_jerk_rad_s3: f64,
    /// How fast the last part of a yaw rate step is closed, 1/s.
    pub shaping_yaw_per_s: f64,
    /// Largest tilt, radians.
    pub tilt_max_rad: f64,
    /// Largest roll and pitch rate, rad/s.
    pub tilt_rate_max_rad_s: f64,
    /// Position error to velocity, 1/s: horizontal, vertical.
    pub position_gain_per_s: [f64; 2],
    /// Velocity error to acceleration, 1/s: horizontal, vertical.
    pub velocity_gain_per_s: [f64; 2],
    /// Time constant of the filter on collective thrust in velocity and position control, seconds.
    pub thrust_filter_s: f64,
    /// Integral of the velocity error to acceleration, 1/s²: horizontal, vertical.
    pub velocity_integral_per_s2: [f64; 2],
    /// Attitude error to rate, 1/s: roll and pitch, yaw.
    pub attitude_gain_per_s: [f64; 2],
    /// Rate error to angular acceleration, 1/s: roll and pitch, yaw.
    pub rate_gain_per_s: [f64; 2],
    /// Integral of the rate error to angular acceleration, 1/s²: roll and pitch, yaw.
    pub rate_integral_per_s2: [f64; 2],
}

impl Default for ControlParams {
    fn default() -> Self {
        Self {
            speed_max_m_s: 10.0,
            climb_max_m_s: 2.5,
            descent_max_m_s: 1.5,
            accel_horizontal_m_s2: 2.5,
            jerk_horizontal_m_s3: 5.0,
            accel_vertical_m_s2: 1.0,
            jerk_vertical_m_s3: 5.0,
            shaping_horizontal_per_s: 2.0,
            shaping_vertical_per_s: 5.0,
            yaw_rate_max_rad_s: 60f64.to_radians(),
            yaw_accel_rad_s2: 3.0,
            yaw_jerk_rad_s3: 30.0,
            shaping_yaw_per_s: 10.0,
            tilt_max_rad: 30f64.to_radians(),
            tilt_rate_max_rad_s: 220f64.to_radians(),
            position_gain_per_s: [1.0, 1.0],
            velocity_gain_per_s: [2.0, 5.0],
            thrust_filter_s: 0.08,
            velocity_integral_per_s2: [1.0, 1.0],
            attitude_gain_per_s: [8.0, 4.5],
            rate_gain_per_s: [22.0, 8.0],
            rate_integral_per_s2: [20.0, 4.0],
        }
    }
}

/// Sensor noise and estimator error, all as standard deviations per axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorParams {
    /// Accelerometer noise, m/s².
    pub accelerometer_m_s2: f64,
    /// Gyroscope noise, rad/s.
    pub gyroscope_rad_s: f64,
    /// GPS position noise, metres.
    pub gps_position_m: f64,
    /// GPS velocity noise, m/s.
    pub gps_velocity_m_s: f64,
    /// Barometer noise, metres.
    pub barometer_m: f64,
    /// Estimator's velocity error, m/s.
    pub estimate_velocity_m_s: f64,
    /// Correlation time of the velocity error, seconds.
    pub estimate_velocity_time_s: f64,
    /// Correlation time of the position error, seconds. The position error is the velocity error summed up with this
    /// leak, so its standard deviation is about `estimate_velocity_m_s · √(estimate_velocity_time_s · this)`: 5 cm.
    pub estimate_position_time_s: f64,
    /// Estimator's attitude error, radians.
    pub estimate_attitude_rad: f64,
    /// Correlation time of the attitude error, seconds.
    pub estimate_attitude_time_s: f64,
}

impl Default for SensorParams {
    fn default() -> Self {
        Self {
            accelerometer_m_s2: 0.05,
            gyroscope_rad_s: 0.003,
            gps_position_m: 0.3,
            gps_velocity_m_s: 0.05,
            barometer_m: 0.08,
            estimate_velocity_m_s: 0.01,
            estimate_velocity_time_s: 0.25,
            estimate_position_time_s: 100.0,
            estimate_attitude_rad: 0.3f64.to_radians(),
            estimate_attitude_time_s: 20.0,
        }
    }
}

impl SensorParams {
    /// No noise and no error: the estimate is the truth.
    pub const PERFECT: Self = Self {
        accelerometer_m_s2: 0.0,
        gyroscope_rad_s: 0.0,
        gps_position_m: 0.0,
        gps_velocity_m_s: 0.0,
        barometer_m: 0.0,
        estimate_velocity_m_s: 0.0,
        estimate_velocity_time_s: 0.25,
        estimate_position_time_s: 100.0,
        estimate_attitude_rad: 0.0,
        estimate_attitude_time_s: 20.0,
    };
}

/// Wind over the whole course. Gusts are first-order Gauss-Markov, the longitudinal form of Dryden's model; vertical
/// gusts are half as strong, as in MIL-F-8785C close to the ground.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Wind {
    /// Mean wind, NED, metres per second (where the air goes to).
    pub mean_ned_m_s: [f64; 3],
    /// Standard deviation of the horizontal gusts, m/s.
    pub gust_m_s: f64,
    /// Correlation time of the gusts, seconds.
    pub gust_time_s: f64,
}

impl Default for Wind {
    fn default() -> Self {
        Self::CALM
    }
}

impl Wind {
    /// No wind.
    pub const CALM: Self = Self {
        mean_ned_m_s: [0.0; 3],
        gust_m_s: 0.0,
        gust_time_s: 3.0,
    };

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
            ("control.position_gain_per_s", self.position_gain_per_s),
            ("control.velocity_gain_per_s", self.velocity_gain_per_s),
            ("control.velocity_integral_per_s2", self.velocity_integral_per_s2),
            ("control.attitude_gain_per_s", self.attitude_gain_per_s),
            ("control.rate_gain_per_s", self.rate_gain_per_s),
            ("control.rate_integral_per_s2", self.rate_integral_per_s2),
        ] {
            all_in_range(field, &gains, 0.0, 200.0, "from 0 to 200")?;
        }
        Ok(())
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
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
