//! What the vehicle is made of: every number of the model, with its default and its source.

use vigil_types::settings::{free, named_setting, section, within};
use vigil_types::{named, settings};

/// Standard gravity, metres per second squared.
pub const GRAVITY_M_S2: f64 = 9.80665;

settings! {
    /// The whole vehicle. The default is an X500-class quadcopter of 2 kg; `docs/vehicle.md` says where each default comes from.
    #[derive(Copy)]
    pub struct VehicleParams {
        /// Mass, inertia, geometry, drag.
        pub airframe: AirframeParams = section(),
        /// The four motors with their propellers.
        pub motors: MotorParams = section(),
        /// What happens when it touches the ground.
        pub ground: GroundParams = section(),
        /// Voltage and charge.
        pub battery: BatteryParams = section(),
        /// Limits and gains of the autopilot's controllers.
        pub control: ControlParams = section(),
        /// Sensor noise and estimator error.
        pub sensors: SensorParams = section(),
    }

    /// Mass, inertia, geometry and drag.
    #[derive(Copy)]
    pub struct AirframeParams {
        /// Mass, kilograms.
        pub mass_kg: f64 = within(2.0, (0.1, 50.0), "kg"),
        /// Principal moments of inertia about forward, right and down, kg·m².
        pub inertia_kg_m2: [f64; 3] = within([0.021_67, 0.021_67, 0.040], (1e-4, 10.0), "kg·m²"),
        /// Distance of each motor forward or behind the centre of mass, metres.
        pub arm_forward_m: f64 = within(0.174, (0.02, 2.0), "m"),
        /// Distance of each motor to the right or left of the centre of mass, metres.
        pub arm_right_m: f64 = within(0.174, (0.02, 2.0), "m"),
        /// Drag proportional to airspeed along each body axis (mostly the rotors), N per m/s.
        pub drag_linear_n_s_m: [f64; 3] = within([0.24, 0.24, 0.12], (0.0, 10.0), "N per m/s"),
        /// Drag proportional to the square of the airspeed (the body), N per (m/s)².
        pub drag_quadratic_n_s2_m2: f64 = within(0.04, (0.0, 5.0), "N per (m/s)²"),
        /// Height of the centre of mass above the feet, metres. On the ground the position is this far above home.
        pub gear_height_m: f64 = within(0.10, (0.02, 1.0), "m"),
        /// Distance of each foot from the centre line, forward and to the side, metres.
        pub gear_half_track_m: f64 = within(0.13, (0.02, 1.0), "m"),
    }

    /// Motors with their propellers: thrust = coefficient · speed², first-order lag in speed.
    #[derive(Copy)]
    pub struct MotorParams {
        /// Thrust per squared speed, N per (rad/s)².
        pub thrust_coefficient_n_s2: f64 = within(8.548_58e-6, (1e-8, 1e-2), "N per (rad/s)²"),
        /// Reaction torque per thrust, metres.
        pub torque_per_thrust_m: f64 = within(0.016, (1e-4, 1.0), "m"),
        /// Slowest speed of an armed motor, rad/s.
        pub idle_speed_rad_s: f64 = free(150.0),
        /// Fastest speed at the battery's nominal voltage, rad/s; it scales with the voltage below that.
        pub max_speed_rad_s: f64 = within(1100.0, (10.0, 10_000.0), "rad/s"),
        /// Time constant of speeding up, seconds.
        pub rise_s: f64 = within(0.0125, (1e-3, 0.2), "s"),
        /// Time constant of slowing down, seconds.
        pub fall_s: f64 = within(0.025, (1e-3, 0.2), "s"),
    }

    /// Contact of feet and arms with the flat ground at height 0: spring and damper, Coulomb friction.
    #[derive(Copy)]
    pub struct GroundParams {
        /// Stiffness of each contact point, N/m.
        pub stiffness_n_m: f64 = free(3000.0),
        /// Damping of each contact point, N per m/s.
        pub damping_n_s_m: f64 = free(60.0),
        /// Coefficient of friction.
        pub friction: f64 = within(0.8, (0.0, 2.0), ""),
    }

    /// A battery: open-circuit voltage linear in charge, and a series resistance.
    #[derive(Copy)]
    pub struct BatteryParams {
        /// Capacity, ampere-hours.
        pub capacity_ah: f64 = within(5.0, (0.01, 1000.0), "Ah"),
        /// Charge at the start, 0 to 1.
        pub initial_charge: f64 = within(1.0, (0.0, 1.0), ""),
        /// Open-circuit voltage when full, volts.
        pub full_v: f64 = within(16.8, (1.0, 1000.0), "V"),
        /// Open-circuit voltage when empty, volts.
        pub empty_v: f64 = within(13.2, (1.0, 1000.0), "V"),
        /// Voltage at which the motors reach their stated top speed, volts.
        pub nominal_v: f64 = within(14.8, (1.0, 1000.0), "V"),
        /// Series resistance, ohms.
        pub resistance_ohm: f64 = within(0.02, (0.0, 1.0), "Ω"),
        /// Mechanical power out per electrical power in.
        pub motor_efficiency: f64 = within(0.75, (0.05, 1.0), ""),
        /// Current of everything but the motors, amperes.
        pub avionics_a: f64 = within(1.5, (0.0, 100.0), "A"),
    }
}

named! {
    /// How a wanted velocity becomes an acceleration.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum VelocityLaw {
        /// Along a reference of limited acceleration and jerk, whose place is followed too: ArduCopter's.
        #[default]
        Shaped => "shaped",
        /// By the velocity's error itself, without a reference, so that drag is overcome by the integral alone and a wanted
        /// velocity of zero holds no place: PX4's `PositionControl`. Places are gone to along a shaped path here too.
        Direct => "direct",
    }
}

named! {
    /// What the autopilot does when it is ordered to hold.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum HoldLaw {
        /// It stops, and holds where it stopped.
        #[default]
        Stop => "stop",
        /// It goes to the point where it would stop, reckoned from its velocity alone: ordered while it gains speed it passes that
        /// point and flies back to it. PX4's HOLD.
        FlyBack => "fly_back",
        /// It loses its speed in proportion to it: ArduCopter's BRAKE.
        Brake => "brake",
    }
}

settings! {
    /// Limits and gains of the controllers. Limits are ArduCopter's stock values where it has one; the gains were set so
    /// that the answer to setpoints lies in the measured bands (`docs/vehicle.md`).
    #[derive(Copy)]
    pub struct ControlParams {
        /// How a wanted velocity is followed.
        pub velocity_law: VelocityLaw = free(VelocityLaw::Shaped),
        /// Time constant with which [`VelocityLaw::Direct`] takes up a wanted horizontal velocity, seconds.
        pub velocity_lag_s: f64 = within(0.0, (0.0, 1.0), "s"),
        /// Share of the horizontal velocity gain that [`VelocityLaw::Direct`] brakes with, where less than half of the speed is wanted.
        pub braking_share: f64 = within(1.0, (0.1, 1.0), ""),
        /// What a hold is.
        pub hold: HoldLaw = free(HoldLaw::Stop),
        /// Fastest horizontal velocity setpoint, m/s.
        pub speed_max_m_s: f64 = within(10.0, (0.05, 50.0), ""),
        /// Fastest climb, m/s.
        pub climb_max_m_s: f64 = within(2.5, (0.05, 50.0), ""),
        /// Fastest descent, m/s.
        pub descent_max_m_s: f64 = within(1.5, (0.05, 50.0), ""),
        /// Horizontal acceleration limit of the shaped velocity, m/s².
        pub accel_horizontal_m_s2: f64 = within(2.5, (0.05, 50.0), ""),
        /// Horizontal jerk limit, m/s³.
        pub jerk_horizontal_m_s3: f64 = within(5.0, (0.05, 50.0), ""),
        /// Vertical acceleration limit, m/s².
        pub accel_vertical_m_s2: f64 = within(0.8, (0.05, 50.0), ""),
        /// Vertical jerk limit, m/s³.
        pub jerk_vertical_m_s3: f64 = within(5.0, (0.05, 50.0), ""),
        /// How fast the last part of a horizontal velocity step is closed, 1/s.
        pub shaping_horizontal_per_s: f64 = within(1.95, (0.05, 50.0), ""),
        /// How fast the last part of a vertical velocity step is closed, 1/s.
        pub shaping_vertical_per_s: f64 = within(4.0, (0.05, 50.0), ""),
        /// Yaw rate limit, rad/s.
        pub yaw_rate_max_rad_s: f64 = within(60f64.to_radians(), (0.05, 50.0), ""),
        /// Yaw acceleration limit of the shaped yaw rate, rad/s².
        pub yaw_accel_rad_s2: f64 = within(2.2, (0.05, 50.0), ""),
        /// Yaw jerk limit, rad/s³.
        pub yaw_jerk_rad_s3: f64 = within(25.0, (0.5, 500.0), "rad/s³"),
        /// How fast the last part of a yaw rate step is closed, 1/s.
        pub shaping_yaw_per_s: f64 = within(10.0, (0.05, 50.0), ""),
        /// Largest tilt, radians.
        pub tilt_max_rad: f64 = within(30f64.to_radians(), (0.05, 1.2), "rad"),
        /// Largest roll and pitch rate, rad/s.
        pub tilt_rate_max_rad_s: f64 = within(220f64.to_radians(), (0.05, 50.0), ""),
        /// Distance to a goal position to wanted velocity, 1/s: horizontal, vertical.
        pub approach_gain_per_s: [f64; 2] = within([0.7, 0.8], (0.0, 200.0), ""),
        /// Error against the shaped path to velocity, 1/s: horizontal, vertical.
        pub position_gain_per_s: [f64; 2] = within([1.0, 1.0], (0.0, 200.0), ""),
        /// Velocity error to acceleration, 1/s: horizontal, vertical.
        pub velocity_gain_per_s: [f64; 2] = within([1.5, 4.0], (0.0, 200.0), ""),
        /// Time constant of the filter on collective thrust in velocity and position control, seconds.
        pub thrust_filter_s: f64 = within(0.13, (0.0, 1.0), "s"),
        /// Integral of the velocity error to acceleration, 1/s²: horizontal, vertical.
        pub velocity_integral_per_s2: [f64; 2] = within([1.0, 1.0], (0.0, 200.0), ""),
        /// Attitude error to rate, 1/s: roll and pitch, yaw.
        pub attitude_gain_per_s: [f64; 2] = within([8.0, 4.0], (0.0, 200.0), ""),
        /// Rate error to angular acceleration, 1/s: roll and pitch, yaw.
        pub rate_gain_per_s: [f64; 2] = within([22.0, 8.0], (0.0, 200.0), ""),
        /// Integral of the rate error to angular acceleration, 1/s²: roll and pitch, yaw.
        pub rate_integral_per_s2: [f64; 2] = within([20.0, 4.0], (0.0, 200.0), ""),
    }

    /// Sensor noise and estimator error, all as standard deviations per axis.
    #[derive(Copy)]
    pub struct SensorParams {
        /// Accelerometer noise, m/s².
        pub accelerometer_m_s2: f64 = within(0.05, (0.0, 10.0), ""),
        /// Gyroscope noise, rad/s.
        pub gyroscope_rad_s: f64 = within(0.003, (0.0, 10.0), ""),
        /// GPS position noise, metres.
        pub gps_position_m: f64 = within(0.3, (0.0, 10.0), ""),
        /// GPS velocity noise, m/s.
        pub gps_velocity_m_s: f64 = within(0.05, (0.0, 10.0), ""),
        /// Barometer noise, metres.
        pub barometer_m: f64 = within(0.08, (0.0, 10.0), ""),
        /// Estimator's velocity error, m/s.
        pub estimate_velocity_m_s: f64 = within(0.008, (0.0, 10.0), ""),
        /// Correlation time of the velocity error, seconds.
        pub estimate_velocity_time_s: f64 = within(0.25, (0.05, 100_000.0), "s"),
        /// Correlation time of the position error, seconds. The position error is the velocity error summed up with this
        /// leak, so its standard deviation is about `estimate_velocity_m_s · √(estimate_velocity_time_s · this)`: 4 cm.
        pub estimate_position_time_s: f64 = within(100.0, (0.05, 100_000.0), "s"),
        /// Estimator's attitude error, radians.
        pub estimate_attitude_rad: f64 = within(0.3f64.to_radians(), (0.0, 10.0), ""),
        /// Correlation time of the attitude error, seconds.
        pub estimate_attitude_time_s: f64 = within(20.0, (0.05, 100_000.0), "s"),
        /// What the estimated position wanders beside that, as one that hangs on GPS and barometer does: horizontal, vertical, metres.
        pub wander_m: [f64; 2] = within([0.0; 2], (0.0, 10.0), "m"),
        /// Correlation time of the wander: horizontal, vertical, seconds.
        pub wander_time_s: [f64; 2] = within([20.0, 150.0], (5.0, 100_000.0), "s"),
        /// What the estimated velocity is off beside that, without the position's following it: horizontal, vertical, m/s.
        pub velocity_error_m_s: [f64; 2] = within([0.0; 2], (0.0, 10.0), "m/s"),
        /// Correlation time of that error, seconds.
        pub velocity_error_time_s: f64 = within(4.0, (0.05, 100_000.0), "s"),
        /// What the estimated heading wanders in the air, radians.
        pub heading_error_rad: f64 = within(0.0, (0.0, 1.0), "rad"),
        /// Correlation time of that error, seconds.
        pub heading_error_time_s: f64 = within(8.0, (0.05, 100_000.0), "s"),
    }
}

impl SensorParams {
    /// No noise and no error: the estimate is the truth.
    pub fn perfect() -> Self {
        Self {
            accelerometer_m_s2: 0.0,
            gyroscope_rad_s: 0.0,
            gps_position_m: 0.0,
            gps_velocity_m_s: 0.0,
            barometer_m: 0.0,
            estimate_velocity_m_s: 0.0,
            estimate_attitude_rad: 0.0,
            ..Self::default()
        }
    }
}

settings! {
    /// Wind over the whole course. Gusts are first-order Gauss-Markov, the longitudinal form of Dryden's model; vertical
    /// gusts are half as strong, as in MIL-F-8785C close to the ground.
    #[derive(Copy)]
    pub struct Wind {
        /// Mean wind, NED, metres per second (where the air goes to).
        pub mean_ned_m_s: [f64; 3] = within([0.0; 3], (-30.0, 30.0), "m/s"),
        /// Standard deviation of the horizontal gusts, m/s.
        pub gust_m_s: f64 = within(0.0, (0.0, 15.0), "m/s"),
        /// Correlation time of the gusts, seconds.
        pub gust_time_s: f64 = within(3.0, (0.05, 1000.0), "s"),
    }
}

impl Wind {
    /// No wind.
    pub const CALM: Self = Self {
        mean_ned_m_s: [0.0; 3],
        gust_m_s: 0.0,
        gust_time_s: 3.0,
    };

    /// A wind of mean speed `mean_m_s` towards a direction clockwise from north, with gusts a third as strong.
    pub fn gusty(mean_m_s: f64, towards_rad: f64) -> Self {
        Self {
            mean_ned_m_s: [
                mean_m_s * libm::cos(towards_rad),
                mean_m_s * libm::sin(towards_rad),
                0.0,
            ],
            gust_m_s: mean_m_s / 3.0,
            ..Self::CALM
        }
    }
}

named_setting!(VelocityLaw);
named_setting!(HoldLaw);
