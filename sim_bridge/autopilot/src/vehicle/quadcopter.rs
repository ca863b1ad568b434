//! The vehicle: one millisecond at a time.

use crate::vehicle::body::{Body, Inertia};
use crate::vehicle::control::{Controller, Stage};
use crate::vehicle::ground::Ground;
use crate::vehicle::interface::{ControlCommand, Motion, Truth, VehicleView};
use crate::vehicle::math::{StateBytes, Vec3, attitude, heading, single, vec3};
use crate::vehicle::noise::{Noise, OrnsteinUhlenbeck};
use crate::vehicle::params::{GRAVITY_M_S2, VehicleParams, Wind};
use crate::vehicle::rotors::Rotors;
use crate::vehicle::sensors::{Battery, Errors};
use crate::vehicle::validate::ParamsError;
use vigil_types::NedVector;

/// Simulated time of one [`Vehicle::step`], nanoseconds.
pub const STEP_NS: u64 = 1_000_000;
const STEP_S: f64 = 1e-3;
/// Physics steps per update of the slow parts (path, position, velocity and attitude control; gusts; estimator errors).
const SLOW_EVERY: u64 = 4;
const SLOW_S: f64 = STEP_S * SLOW_EVERY as f64;

/// Steps with weight on the feet and little motion until the vehicle counts as landed.
const LANDED_AFTER: u32 = 150;
/// Steps without any contact until it counts as flying.
const FLYING_AFTER: u32 = 20;

/// A quadcopter with its autopilot's controllers and sensors, at 1 kHz.
///
/// The position is that of the centre of mass. Standing on its feet it is [`Vehicle::standing_height_m`] above the ground.
/// One seed gives one flight, bit for bit, on every machine.
#[derive(Debug, Clone)]
pub struct Vehicle {
    params: VehicleParams,
    steps: u64,
    body: Body,
    acceleration_ned_m_s2: Vec3,
    rotors: Rotors,
    ground: Ground,
    controller: Controller,
    errors: Errors,
    battery: Battery,
    gusts: OrnsteinUhlenbeck,
    gust_noise: Noise,
    mean_wind_ned_m_s: Vec3,
    armed: bool,
    on_ground: bool,
    /// Steps towards a change of `on_ground`.
    contact_steps: u32,
}

impl Vehicle {
    /// A vehicle on the ground at home, heading north, motors off, at time 0.
    ///
    /// # Errors
    /// A parameter that the model cannot fly: names the field, its value and what is accepted.
    pub fn new(params: VehicleParams, wind: Wind, seed: u64) -> Result<Self, ParamsError> {
        params.validate()?;
        wind.validate()?;
        let inertia = Inertia::new(params.airframe.inertia_kg_m2);
        let ground = Ground::new(&params.ground, &params.airframe);
        let mut gust_noise = Noise::new(seed, 1);
        let gust = Vec3::new(wind.gust_m_s, wind.gust_m_s, 0.5 * wind.gust_m_s);
        let mut vehicle = Self {
            params,
            steps: 0,
            body: Body::at_rest(Vec3::zeros(), heading(0.0)),
            acceleration_ned_m_s2: Vec3::zeros(),
            rotors: Rotors::new(&params.motors, &params.airframe, STEP_S),
            ground,
            controller: Controller::new(&params.control, params.airframe.mass_kg, inertia),
            errors: Errors::new(&params.sensors, Noise::new(seed, 2), Noise::new(seed, 3), SLOW_S),
            battery: Battery::new(&params.battery),
            gusts: OrnsteinUhlenbeck::new(gust, wind.gust_time_s, SLOW_S, &mut gust_noise),
            gust_noise,
            mean_wind_ned_m_s: Vec3::from(wind.mean_ned_m_s),
            armed: false,
            on_ground: true,
            contact_steps: 0,
        };
        vehicle.place(NedVector::ZERO, 0.0, false);
        Ok(vehicle)
    }

    /// Height of the centre of mass above the ground when standing, metres.
    pub fn standing_height_m(&self) -> f64 {
        let weight_n = self.params.airframe.mass_kg * GRAVITY_M_S2;
        self.ground.standing_height_m(&self.params.airframe, weight_n)
    }

    /// Puts the vehicle somewhere else, at rest. The clock, the battery and the random streams go on.
    ///
    /// `airborne`: hovering in trim against the mean wind, armed, with an estimator that has settled (its errors drawn
    /// from their stationary distribution); never below the standing height. Otherwise standing on the ground with
    /// motors off; `position_ned_m.z` is not used then.
    pub fn place(&mut self, position_ned_m: NedVector, yaw_rad: f32, airborne: bool) {
        let (mut position, stand) = (vec3(position_ned_m), -self.standing_height_m());
        position.z = if airborne { position.z.min(stand) } else { stand };
        self.body = Body::at_rest(position, heading(f64::from(yaw_rad)));
        self.ground.release();
        self.acceleration_ned_m_s2 = Vec3::zeros();
        self.armed = airborne;
        self.on_ground = !airborne;
        self.contact_steps = 0;
        if airborne {
            let wind_acceleration = self.drag_ned_n(&self.mean_wind_ned_m_s) / self.params.airframe.mass_kg;
            self.errors.settle(&self.body);
            let (attitude, thrust_n) = self
                .controller
                .settle(&self.errors.belief(&self.body), &wind_acceleration);
            self.body.attitude = attitude;
            self.rotors.settle(thrust_n);
        } else {
            self.controller.stop(Stage::Off);
            self.rotors.stop();
            self.rotors.speeds_rad_s = [0.0; 4];
        }
    }

    /// Advances by 1 ms ([`STEP_NS`]). No allocation. Path, attitude and errors are updated every fourth step, so a
    /// changed command takes effect within 4 ms; stopping the motors takes effect at once.
    pub fn step(&mut self, command: &ControlCommand) {
        self.armed = !matches!(command, ControlCommand::MotorsOff);
        if self.steps.is_multiple_of(SLOW_EVERY) {
            self.errors.advance(&self.body, self.params.airframe.gear_height_m);
            self.gusts.advance(&mut self.gust_noise);
            self.battery.advance(self.rotors.power_w(), SLOW_S);
            let belief = self.errors.belief(&self.body);
            self.controller.plan(command, &belief, self.on_ground, SLOW_S);
        }
        if !self.armed {
            self.controller.stop(Stage::Off);
        }
        match self.controller.wrench(&self.errors.rates_frd_rad_s(&self.body), STEP_S) {
            Some(wanted) => self.controller.saturated = self.rotors.ask(&wanted, self.battery.speed_scale()),
            None if self.controller.stage == Stage::Idle => self.rotors.idle(),
            None => self.rotors.stop(),
        }
        self.rotors.advance();

        let given = self.rotors.wrench();
        let wind = self.mean_wind_ned_m_s + self.gusts.value;
        let mut force = self.drag_ned_n(&wind) - self.body.attitude * Vec3::new(0.0, 0.0, given.thrust_n);
        let mut torque = given.torque_frd_n_m;
        let weight_n = self.params.airframe.mass_kg * GRAVITY_M_S2;
        let contact = self.ground.contact(&self.body);
        let mut load_n = 0.0;
        if let Some((of_ground_n, of_ground_n_m)) = &contact {
            force += of_ground_n;
            torque += of_ground_n_m;
            load_n = -of_ground_n.z;
        }
        self.judge_landed(contact.is_some(), load_n > 0.2 * weight_n);
        force.z += weight_n;
        self.acceleration_ned_m_s2 = force / self.params.airframe.mass_kg;
        self.body
            .advance(&self.acceleration_ned_m_s2, &torque, &self.controller.inertia, STEP_S);
        self.steps += 1;
    }

    /// Drag in NED for this wind: linear along each body axis, quadratic along the airspeed.
    fn drag_ned_n(&self, wind_ned_m_s: &Vec3) -> Vec3 {
        let a = &self.params.airframe;
        let through_air = self.body.velocity_ned_m_s - wind_ned_m_s;
        let airspeed = self.body.attitude.inverse_transform_vector(&through_air);
        let quadratic = a.drag_quadratic_n_s2_m2 * airspeed.norm();
        let drag = Vec3::from(a.drag_linear_n_s_m).map(|linear| -(linear + quadratic));
        self.body.attitude * drag.component_mul(&airspeed)
    }

    fn judge_landed(&mut self, touches: bool, loaded: bool) {
        let slow = self.body.velocity_ned_m_s.norm_squared() < 0.25;
        let (changing, after) = if self.on_ground {
            (!touches, FLYING_AFTER)
        } else {
            (loaded && slow, LANDED_AFTER)
        };
        self.contact_steps = if changing { self.contact_steps + 1 } else { 0 };
        if self.contact_steps >= after {
            self.on_ground = !self.on_ground;
            self.contact_steps = 0;
        }
    }

    /// Simulated time, nanoseconds.
    pub fn now_ns(&self) -> u64 {
        self.steps * STEP_NS
    }

    /// What the autopilot knows: estimate, sensors, whether it stands, whether it is armed.
    pub fn view(&self) -> VehicleView {
        let specific = self.acceleration_ned_m_s2 - Vec3::new(0.0, 0.0, GRAVITY_M_S2);
        let specific_frd = self.body.attitude.inverse_transform_vector(&specific);
        VehicleView {
            estimate: self.motion(&self.errors.belief(&self.body)),
            sensors: self
                .errors
                .readings(&self.body, &specific_frd, &self.battery, &self.rotors),
            on_ground: self.on_ground,
            armed: self.armed,
        }
    }

    /// The truth, for referee, LiDAR and tests.
    pub fn truth(&self) -> Truth {
        self.motion(&self.body)
    }

    fn motion(&self, body: &Body) -> Motion {
        Motion {
            at_ns: self.now_ns(),
            position_ned_m: single(&body.position_ned_m),
            velocity_ned_m_s: single(&body.velocity_ned_m_s),
            attitude: attitude(&body.attitude),
            rates_frd_rad_s: single(&body.rates_frd_rad_s),
        }
    }

    /// A hash of everything that the vehicle's future depends on, given the same parameters, seed and commands.
    pub fn state_hash(&self) -> u64 {
        let mut bytes = StateBytes::default();
        bytes.word(self.steps);
        for v in [
            &self.body.position_ned_m,
            &self.body.velocity_ned_m_s,
            &self.body.rates_frd_rad_s,
            &self.acceleration_ned_m_s2,
            &self.gusts.value,
        ] {
            bytes.numbers(v);
        }
        bytes.numbers(&self.body.attitude.coords);
        bytes.numbers(&self.rotors.speeds_rad_s);
        bytes.numbers(&self.rotors.commands_rad_s);
        for (north, east) in self.ground.anchors_m() {
            bytes.numbers(&[north, east]);
        }
        self.controller.tell_state(&mut bytes);
        self.errors.tell_state(&mut bytes);
        bytes.numbers(&[self.battery.charge, self.battery.voltage_v]);
        bytes.word(self.gust_noise.position());
        bytes.word(u64::from(self.armed) | u64::from(self.on_ground) << 1 | u64::from(self.contact_steps) << 8);
        twox_hash::XxHash3_64::oneshot(&bytes.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::body::tests::vector;
    use crate::vehicle::math::Rotation;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

        /// Thrown into calm air with stopped motors, a tumbling vehicle only ever loses energy: the air has none to give.
        /// Its rotation, which the model's drag does not touch, keeps its angular momentum.
        #[test]
        fn drag_only_removes_energy(velocity in vector(15.0), rates in vector(8.0), tilt in vector(3.0)) {
            let mut vehicle = Vehicle::new(VehicleParams::default(), Wind::CALM, 1).unwrap();
            vehicle.body = Body::at_rest(Vec3::new(0.0, 0.0, -200.0), Rotation::from_scaled_axis(tilt));
            vehicle.body.velocity_ned_m_s = velocity;
            vehicle.body.rates_frd_rad_s = rates;
            let mass_kg = vehicle.params.airframe.mass_kg;
            let energy = |b: &Body| mass_kg * (0.5 * b.velocity_ned_m_s.norm_squared() - GRAVITY_M_S2 * b.position_ned_m.z);
            let moments_kg_m2 = vehicle.controller.inertia.moments_kg_m2;
            let momentum = |b: &Body| b.attitude * moments_kg_m2.component_mul(&b.rates_frd_rad_s);
            let momentum_0 = momentum(&vehicle.body);
            let first = energy(&vehicle.body);
            let mut before = first;
            let mut stepped = vehicle.clone();
            for _ in 0..3_000 {
                stepped.step(&ControlCommand::MotorsOff);
                let now = energy(&stepped.body);
                prop_assert!(now <= before + 1e-9 * first, "{} J gained", now - before);
                before = now;
            }
            prop_assert!(before < first - 0.1);
            prop_assert!((momentum(&stepped.body) - momentum_0).norm() <= 1e-5 * momentum_0.norm().max(1e-3));
        }
    }

    #[test]
    fn a_fall_ends_at_the_speed_where_drag_carries_the_weight() {
        let mut vehicle = Vehicle::new(VehicleParams::default(), Wind::CALM, 1).unwrap();
        vehicle.body = Body::at_rest(Vec3::new(0.0, 0.0, -5_000.0), heading(0.0));
        for _ in 0..40_000 {
            vehicle.step(&ControlCommand::MotorsOff);
        }
        let a = vehicle.params.airframe;
        // 0.04 v² + 0.12 v = m g.
        let (q, l) = (a.drag_quadratic_n_s2_m2, a.drag_linear_n_s_m[2]);
        let w = a.mass_kg * GRAVITY_M_S2;
        let terminal = (-l + (l * l + 4.0 * q * w).sqrt()) / (2.0 * q);
        assert!((vehicle.body.velocity_ned_m_s.z - terminal).abs() < 0.01);
    }

    #[test]
    fn a_heading_wanders_in_the_air_and_not_while_it_stands_on_a_tall_gear() {
        let mut params = VehicleParams::default();
        params.airframe.gear_height_m = 0.2;
        params.sensors.heading_error_rad = 0.1;
        let mut vehicle = Vehicle::new(params, Wind::CALM, 1).unwrap();
        for is_airborne in [false, true] {
            vehicle.place(NedVector::new(0.0, 0.0, -3.0), 0.0, is_airborne);
            (0..1_000).for_each(|_| vehicle.step(&ControlCommand::STOP));
            assert_eq!(vehicle.errors.heading_error_rad() != Some(0.0), is_airborne);
        }
    }

    #[test]
    fn placed_in_the_air_it_hovers_in_trim_at_once() {
        let wind = Wind {
            mean_ned_m_s: [5.0, 0.0, 0.0],
            ..Wind::CALM
        };
        let params = VehicleParams {
            sensors: crate::vehicle::SensorParams::perfect(),
            ..VehicleParams::default()
        };
        let mut vehicle = Vehicle::new(params, wind, 1).unwrap();
        vehicle.place(NedVector::new(1.0, 2.0, -3.0), 0.5, true);
        for _ in 0..5_000 {
            vehicle.step(&ControlCommand::STOP);
            let off = vehicle.truth().position_ned_m - NedVector::new(1.0, 2.0, -3.0);
            assert!(off.norm() < 0.02, "{off:?}");
        }
    }
}
