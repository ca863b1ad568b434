//! Four motors in X: from wanted force and torque to motor speeds, and from motor speeds to force and torque.

use crate::vehicle::math::Vec3;
use crate::vehicle::params::{AirframeParams, MotorParams};

/// Where each motor sits and which way it turns, in PX4's numbering of the quad X: front right, rear left, front left,
/// rear right. `yaw` is the sign of the reaction torque about the down axis: a propeller that turns counter-clockwise
/// (seen from above) pushes the nose to the right.
const FORWARD: [f64; 4] = [1.0, -1.0, 1.0, -1.0];
const RIGHT: [f64; 4] = [1.0, -1.0, -1.0, 1.0];
const YAW: [f64; 4] = [1.0, 1.0, -1.0, -1.0];

/// The motors' speeds and what they were made of.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rotors {
    /// Speeds, rad/s.
    pub(crate) speeds_rad_s: [f64; 4],
    /// Speeds that the controllers ask for, rad/s.
    pub(crate) commands_rad_s: [f64; 4],
    motors: MotorParams,
    arm_forward_m: f64,
    arm_right_m: f64,
    rise: f64,
    fall: f64,
}

/// Collective thrust and torque of all motors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Wrench {
    /// Along the body's up axis, newtons.
    pub(crate) thrust_n: f64,
    /// About forward, right, down, newton metres.
    pub(crate) torque_frd_n_m: Vec3,
}

impl Rotors {
    pub(crate) fn new(motors: &MotorParams, airframe: &AirframeParams, step_s: f64) -> Self {
        Self {
            speeds_rad_s: [0.0; 4],
            commands_rad_s: [0.0; 4],
            motors: *motors,
            arm_forward_m: airframe.arm_forward_m,
            arm_right_m: airframe.arm_right_m,
            rise: 1.0 - libm::exp(-step_s / motors.rise_s),
            fall: 1.0 - libm::exp(-step_s / motors.fall_s),
        }
    }

    /// Asks all motors to stop.
    pub(crate) fn stop(&mut self) {
        self.commands_rad_s = [0.0; 4];
    }

    /// Asks all motors to idle.
    pub(crate) fn idle(&mut self) {
        self.commands_rad_s = [self.motors.idle_speed_rad_s; 4];
    }

    /// Sets commands and speeds to what gives this thrust, at once.
    pub(crate) fn settle(&mut self, thrust_n: f64) {
        let speed = self.speed_for(0.25 * thrust_n, self.motors.max_speed_rad_s);
        self.commands_rad_s = [speed; 4];
        self.speeds_rad_s = self.commands_rad_s;
    }

    fn speed_for(&self, thrust_n: f64, top_speed_rad_s: f64) -> f64 {
        let speed_rad_s = (thrust_n / self.motors.thrust_coefficient_n_s2).max(0.0).sqrt();
        speed_rad_s.clamp(self.motors.idle_speed_rad_s, top_speed_rad_s)
    }

    /// Asks for a wrench. `speed_scale` is the share of the top speed that the battery gives.
    ///
    /// What the motors cannot give is dropped in this order: yaw torque first, then collective thrust, roll and pitch
    /// torque last (the order of PX4's and ArduPilot's mixers with attitude priority). Returns whether anything was dropped.
    pub(crate) fn ask(&mut self, wanted: &Wrench, speed_scale: f64) -> bool {
        let low = self.motors.thrust_coefficient_n_s2 * self.motors.idle_speed_rad_s * self.motors.idle_speed_rad_s;
        let top_speed = (self.motors.max_speed_rad_s * speed_scale).max(self.motors.idle_speed_rad_s);
        let room = self.motors.thrust_coefficient_n_s2 * top_speed * top_speed - low;
        let roll = -0.25 * wanted.torque_frd_n_m.x / self.arm_right_m;
        let pitch = 0.25 * wanted.torque_frd_n_m.y / self.arm_forward_m;
        let yaw = 0.25 * wanted.torque_frd_n_m.z / self.motors.torque_per_thrust_m;

        // Each pair of opposite motors gets plus and minus the same, so the largest of roll ± pitch spans the range.
        let tilt_half_span = roll.abs() + pitch.abs();
        let tilt_scale = if 2.0 * tilt_half_span > room {
            room / (2.0 * tilt_half_span)
        } else {
            1.0
        };
        let (roll, pitch) = (roll * tilt_scale, pitch * tilt_scale);
        // Leave a little yaw authority even when tilting takes all there is.
        let yaw_limit = (0.5 * room - tilt_half_span * tilt_scale).max(0.04 * room);
        let yaw_given = yaw.clamp(-yaw_limit, yaw_limit);

        let mut parts = [0.0; 4];
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for (part, ((right, forward), turn)) in parts.iter_mut().zip(RIGHT.iter().zip(FORWARD).zip(YAW)) {
            *part = right * roll + forward * pitch + turn * yaw_given;
            least = least.min(*part);
            most = most.max(*part);
        }
        let wanted_each = 0.25 * wanted.thrust_n;
        let each = wanted_each.min(low + room - most).max(low - least);
        self.commands_rad_s = parts.map(|part| self.speed_for(each + part, top_speed));
        tilt_scale < 1.0 || yaw_given != yaw || (each - wanted_each).abs() > 0.01 * room
    }

    /// One physics step of the first-order lag.
    pub(crate) fn advance(&mut self) {
        for (speed, command) in self.speeds_rad_s.iter_mut().zip(self.commands_rad_s) {
            let error = command - *speed;
            *speed += error * if error > 0.0 { self.rise } else { self.fall };
        }
    }

    /// What the motors give now.
    pub(crate) fn wrench(&self) -> Wrench {
        let (mut thrust_n, mut roll, mut pitch, mut yaw) = (0.0, 0.0, 0.0, 0.0);
        for (speed, ((right, forward), turn)) in self.speeds_rad_s.iter().zip(RIGHT.iter().zip(FORWARD).zip(YAW)) {
            let thrust = self.motors.thrust_coefficient_n_s2 * speed * speed;
            thrust_n += thrust;
            roll -= right * thrust;
            pitch += forward * thrust;
            yaw += turn * thrust;
        }
        Wrench {
            thrust_n,
            torque_frd_n_m: Vec3::new(
                roll * self.arm_right_m,
                pitch * self.arm_forward_m,
                yaw * self.motors.torque_per_thrust_m,
            ),
        }
    }

    /// Mechanical power, watts: torque times speed.
    pub(crate) fn power_w(&self) -> f64 {
        let cubes: f64 = self.speeds_rad_s.iter().map(|w| w * w * w).sum();
        self.motors.torque_per_thrust_m * self.motors.thrust_coefficient_n_s2 * cubes
    }

    /// Mean command as a share of the top speed's thrust, 0 to 1.
    pub(crate) fn throttle(&self) -> f64 {
        let squares: f64 = self.commands_rad_s.iter().map(|w| w * w).sum();
        0.25 * squares / (self.motors.max_speed_rad_s * self.motors.max_speed_rad_s)
    }

    /// Commanded speeds as shares of the top speed, 0 to 1.
    pub(crate) fn command_shares(&self) -> [f64; 4] {
        self.commands_rad_s.map(|speed| speed / self.motors.max_speed_rad_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotors() -> Rotors {
        Rotors::new(&MotorParams::default(), &AirframeParams::default(), 1e-3)
    }

    fn wrench(thrust_n: f64, torque_frd_n_m: [f64; 3]) -> Wrench {
        Wrench {
            thrust_n,
            torque_frd_n_m: torque_frd_n_m.into(),
        }
    }

    fn settled(wanted: &Wrench) -> (Wrench, bool) {
        let mut r = rotors();
        let dropped = r.ask(wanted, 1.0);
        for _ in 0..1_000 {
            r.advance();
        }
        (r.wrench(), dropped)
    }

    #[test]
    fn a_wrench_within_reach_is_given_exactly() {
        let wanted = wrench(20.0, [0.3, -0.4, 0.05]);
        let (given, dropped) = settled(&wanted);
        assert!(!dropped);
        assert!((given.thrust_n - wanted.thrust_n).abs() < 1e-9);
        assert!((given.torque_frd_n_m - wanted.torque_frd_n_m).norm() < 1e-9);
    }

    #[test]
    fn positive_torques_turn_the_right_side_down_the_nose_up_and_the_nose_right() {
        // From the geometry alone: more thrust on the left rolls right, more in front pitches up.
        let mut r = rotors();
        r.speeds_rad_s = [0.0, 500.0, 500.0, 0.0]; // both left motors
        assert!(r.wrench().torque_frd_n_m.x > 0.0);
        r.speeds_rad_s = [500.0, 0.0, 500.0, 0.0]; // both front motors
        assert!(r.wrench().torque_frd_n_m.y > 0.0);
        r.speeds_rad_s = [500.0, 500.0, 0.0, 0.0]; // both counter-clockwise ones
        assert!(r.wrench().torque_frd_n_m.z > 0.0);
    }

    #[test]
    fn saturation_takes_yaw_and_thrust_before_roll_and_pitch() {
        let (given, dropped) = settled(&wrench(41.0, [1.0, 0.5, 0.5]));
        assert!(dropped);
        assert!((given.torque_frd_n_m.x - 1.0).abs() < 1e-9);
        assert!((given.torque_frd_n_m.y - 0.5).abs() < 1e-9);
        assert!(given.torque_frd_n_m.z < 0.5);
        assert!(given.thrust_n < 41.0);
    }

    #[test]
    fn no_command_leaves_what_a_motor_can_do() {
        let m = MotorParams::default();
        for thrust_n in [-10.0, 0.0, 20.0, 200.0] {
            for roll in [-9.0, 0.0, 9.0] {
                for yaw in [-2.0, 0.0, 2.0] {
                    let mut r = rotors();
                    r.ask(&wrench(thrust_n, [roll, -roll, yaw]), 0.9);
                    for c in r.commands_rad_s {
                        assert!(c >= m.idle_speed_rad_s && c <= 0.9 * m.max_speed_rad_s + 1e-9);
                    }
                }
            }
        }
    }

    #[test]
    fn a_motor_reaches_63_percent_of_a_step_after_its_time_constant() {
        let mut r = rotors();
        r.settle(0.0);
        let start = r.speeds_rad_s[0];
        r.ask(&wrench(20.0, [0.0; 3]), 1.0);
        let end = r.commands_rad_s[0];
        for _ in 0..12 {
            r.advance();
        }
        let share = (r.speeds_rad_s[0] - start) / (end - start);
        assert!((0.60..0.64).contains(&share), "{share}");
    }
}
