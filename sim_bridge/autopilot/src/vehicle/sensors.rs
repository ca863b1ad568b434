//! Sensor noise, the estimator's error and the battery.

use crate::vehicle::body::Body;
use crate::vehicle::interface::Sensors;
use crate::vehicle::math::{StateBytes, Vec3, heading, single, small_rotation};
use crate::vehicle::noise::{Noise, OrnsteinUhlenbeck};
use crate::vehicle::params::{BatteryParams, SensorParams};
use crate::vehicle::rotors::Rotors;

/// Updates of the errors per barometer reading.
const BAROMETER_EVERY: u32 = 5;
/// Updates of the errors per GPS reading.
const GPS_EVERY: u32 = 25;
/// Correlation time of the drift's velocity, seconds: what a hold has to follow, slower than the controllers.
const WANDER_VELOCITY_TIME_S: f64 = 2.0;

/// The errors between truth and belief, and the readings of the slower sensors.
///
/// The estimator is modelled by its error, not by a filter: attitude error is a slow random process; velocity error is a fast
/// one; position error is the sum of the velocity error with a slow leak, so that estimated position and velocity fit
/// together as they do in a filter.
#[derive(Debug, Clone)]
pub(crate) struct Errors {
    params: SensorParams,
    noise: Noise,
    interval_s: f64,
    position_keep: f64,
    velocity: OrnsteinUhlenbeck,
    attitude: OrnsteinUhlenbeck,
    position_m: Vec3,
    drift: Option<Drift>,
    accelerometer: Vec3,
    gyroscope: Vec3,
    gps_position_m: Vec3,
    gps_velocity_m_s: Vec3,
    barometer_height_m: f64,
    updates: u32,
}

impl Errors {
    /// Starts at home: no position error, the others drawn from their stationary distribution.
    pub(crate) fn new(params: &SensorParams, mut noise: Noise, wander_noise: Noise, interval_s: f64) -> Self {
        let mut drawn = |each, time_s| OrnsteinUhlenbeck::new(Vec3::repeat(each), time_s, interval_s, &mut noise);
        let velocity = drawn(params.estimate_velocity_m_s, params.estimate_velocity_time_s);
        let attitude = drawn(params.estimate_attitude_rad, params.estimate_attitude_time_s);
        Self {
            params: *params,
            noise,
            interval_s,
            position_keep: libm::exp(-interval_s / params.estimate_position_time_s),
            velocity,
            attitude,
            position_m: Vec3::zeros(),
            drift: Drift::new(params, wander_noise, interval_s),
            accelerometer: Vec3::zeros(),
            gyroscope: Vec3::zeros(),
            gps_position_m: Vec3::zeros(),
            gps_velocity_m_s: Vec3::zeros(),
            barometer_height_m: 0.0,
            updates: 0,
        }
    }

    /// As an estimator that has flown for long: all errors drawn from their stationary distribution.
    pub(crate) fn settle(&mut self, body: &Body) {
        let p = &self.params;
        let deviation = p.estimate_velocity_m_s * libm::sqrt(p.estimate_velocity_time_s * p.estimate_position_time_s);
        self.velocity.redraw(&mut self.noise);
        self.attitude.redraw(&mut self.noise);
        self.position_m = self.noise.normal3() * deviation;
        if let Some(drift) = &mut self.drift {
            drift.settle();
        }
        self.read_barometer(body);
        self.read_gps(body);
    }

    /// One interval later. Above `gear_height_m` the compass is no longer trusted as on the ground, and the heading wanders.
    pub(crate) fn advance(&mut self, body: &Body, gear_height_m: f64) {
        self.velocity.advance(&mut self.noise);
        self.attitude.advance(&mut self.noise);
        self.position_m = self.position_m * self.position_keep + self.velocity.value * self.interval_s;
        if let Some(drift) = &mut self.drift {
            drift.advance(self.interval_s, -body.position_ned_m.z > gear_height_m);
        }
        self.accelerometer = self.noise.normal3() * self.params.accelerometer_m_s2;
        self.gyroscope = self.noise.normal3() * self.params.gyroscope_rad_s;
        self.updates = self.updates.wrapping_add(1);
        if self.updates.is_multiple_of(BAROMETER_EVERY) {
            self.read_barometer(body);
        }
        if self.updates.is_multiple_of(GPS_EVERY) {
            self.read_gps(body);
        }
    }

    fn read_barometer(&mut self, body: &Body) {
        self.barometer_height_m = -body.position_ned_m.z + self.noise.normal() * self.params.barometer_m;
    }

    fn read_gps(&mut self, body: &Body) {
        self.gps_position_m = body.position_ned_m + self.noise.normal3() * self.params.gps_position_m;
        self.gps_velocity_m_s = body.velocity_ned_m_s + self.noise.normal3() * self.params.gps_velocity_m_s;
    }

    /// What the estimator believes of the body.
    pub(crate) fn belief(&self, body: &Body) -> Body {
        let mut belief = Body {
            position_ned_m: body.position_ned_m + self.position_m,
            velocity_ned_m_s: body.velocity_ned_m_s + self.velocity.value,
            attitude: body.attitude * small_rotation(&self.attitude.value),
            rates_frd_rad_s: self.rates_frd_rad_s(body),
        };
        if let Some(drift) = &self.drift {
            belief.position_ned_m += drift.position_m;
            belief.velocity_ned_m_s = belief.velocity_ned_m_s + drift.rate_m_s() + drift.astray_m_s();
        }
        if let Some(error_rad) = self.heading_error_rad() {
            belief.attitude = heading(error_rad) * belief.attitude;
        }
        belief
    }

    /// Measured rates: the estimator trusts the gyroscope.
    pub(crate) fn rates_frd_rad_s(&self, body: &Body) -> Vec3 {
        body.rates_frd_rad_s + self.gyroscope
    }

    /// All readings, given the true specific force.
    pub(crate) fn readings(
        &self,
        body: &Body,
        specific_force_frd: &Vec3,
        battery: &Battery,
        rotors: &Rotors,
    ) -> Sensors {
        Sensors {
            accelerometer_frd_m_s2: single(&(specific_force_frd + self.accelerometer)),
            gyroscope_frd_rad_s: single(&self.rates_frd_rad_s(body)),
            gps_position_ned_m: single(&self.gps_position_m),
            gps_velocity_ned_m_s: single(&self.gps_velocity_m_s),
            barometer_height_m: self.barometer_height_m as f32,
            battery_voltage_v: battery.voltage_v as f32,
            battery_current_a: battery.current_a as f32,
            battery_remaining: battery.charge as f32,
            throttle: rotors.throttle() as f32,
            motors: rotors.command_shares().map(|share| share as f32),
        }
    }

    /// Everything that the next step depends on, for the state hash.
    pub(crate) fn tell_state(&self, bytes: &mut StateBytes) {
        let vectors = [
            self.velocity.value,
            self.attitude.value,
            self.position_m,
            self.accelerometer,
            self.gyroscope,
            self.gps_position_m,
            self.gps_velocity_m_s,
        ];
        bytes.numbers(vectors.iter().flatten());
        bytes.numbers(&[self.barometer_height_m]);
        bytes.word(self.noise.position());
        bytes.word(u64::from(self.updates));
        if let Some(drift) = &self.drift {
            let vectors = [drift.velocity.value, drift.position_m, drift.astray_m_s()];
            bytes.numbers(vectors.iter().flatten());
            bytes.word(drift.noise.position());
        }
        bytes.numbers(&self.heading_error_rad());
    }

    /// What the estimated heading is off beside the attitude's error, radians, where it wanders.
    pub(super) fn heading_error_rad(&self) -> Option<f64> {
        Some(self.drift.as_ref()?.heading.as_ref()?.value.z)
    }
}

/// The slow error of a position that hangs on GPS and barometer: a velocity error of [`WANDER_VELOCITY_TIME_S`] summed up with a
/// leak, so that the vehicle's own velocity estimate follows it too. What the velocity is off beside that, the position does not follow.
#[derive(Debug, Clone)]
struct Drift {
    noise: Noise,
    velocity: OrnsteinUhlenbeck,
    position_m: Vec3,
    deviation_m: Vec3,
    leak_per_s: Vec3,
    astray: Option<OrnsteinUhlenbeck>,
    heading: Option<OrnsteinUhlenbeck>,
}

impl Drift {
    fn new(params: &SensorParams, mut noise: Noise, interval_s: f64) -> Option<Self> {
        let [horizontal_m, vertical_m] = params.wander_m;
        let [level_m_s, down_m_s] = params.velocity_error_m_s;
        let is_astray = level_m_s > 0.0 || down_m_s > 0.0;
        if horizontal_m == 0.0 && vertical_m == 0.0 && !is_astray && params.heading_error_rad == 0.0 {
            return None;
        }
        let [horizontal_s, vertical_s] = params.wander_time_s;
        // Of the sum's stationary distribution: var = deviation² · time · leak_time² / (time + leak_time).
        let velocity = |deviation_m: f64, leak_s: f64| {
            deviation_m / leak_s * libm::sqrt((WANDER_VELOCITY_TIME_S + leak_s) / WANDER_VELOCITY_TIME_S)
        };
        let (level, down) = (velocity(horizontal_m, horizontal_s), velocity(vertical_m, vertical_s));
        let mut drawn = |x, y, z, time_s| OrnsteinUhlenbeck::new(Vec3::new(x, y, z), time_s, interval_s, &mut noise);
        Some(Self {
            velocity: drawn(level, level, down, WANDER_VELOCITY_TIME_S),
            astray: is_astray.then(|| drawn(level_m_s, level_m_s, down_m_s, params.velocity_error_time_s)),
            // Begins at 0, in a flight that begins in the air too: on the ground the compass is right, and the firmware heard it there.
            heading: (params.heading_error_rad > 0.0).then(|| {
                let mut error = drawn(0.0, 0.0, params.heading_error_rad, params.heading_error_time_s);
                error.value = Vec3::zeros();
                error
            }),
            noise,
            position_m: Vec3::zeros(),
            deviation_m: Vec3::new(horizontal_m, horizontal_m, vertical_m),
            leak_per_s: Vec3::new(1.0 / horizontal_s, 1.0 / horizontal_s, 1.0 / vertical_s),
        })
    }

    fn settle(&mut self) {
        self.velocity.redraw(&mut self.noise);
        if let Some(astray) = &mut self.astray {
            astray.redraw(&mut self.noise);
        }
        self.position_m = self.deviation_m.component_mul(&self.noise.normal3());
    }

    fn advance(&mut self, interval_s: f64, is_airborne: bool) {
        if let Some(heading) = self.heading.as_mut().filter(|_| is_airborne) {
            heading.advance(&mut self.noise);
        }
        self.velocity.advance(&mut self.noise);
        if let Some(astray) = &mut self.astray {
            astray.advance(&mut self.noise);
        }
        self.position_m += self.rate_m_s() * interval_s;
    }

    fn astray_m_s(&self) -> Vec3 {
        self.astray.as_ref().map_or_else(Vec3::zeros, |astray| astray.value)
    }

    /// How fast the error changes.
    fn rate_m_s(&self) -> Vec3 {
        self.velocity.value - self.leak_per_s.component_mul(&self.position_m)
    }
}

/// Charge, current and the voltage that sags with it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Battery {
    params: BatteryParams,
    pub(crate) charge: f64,
    pub(crate) voltage_v: f64,
    pub(crate) current_a: f64,
}

impl Battery {
    pub(crate) fn new(params: &BatteryParams) -> Self {
        let mut battery = Self {
            params: *params,
            charge: params.initial_charge,
            voltage_v: 0.0,
            current_a: 0.0,
        };
        battery.advance(0.0, 0.0);
        battery
    }

    /// Draws this mechanical power for `dt_s`.
    pub(crate) fn advance(&mut self, power_w: f64, dt_s: f64) {
        let p = &self.params;
        let open_v = p.empty_v + (p.full_v - p.empty_v) * self.charge;
        // One step of the fixed point I = P / V(I), from the last voltage: it converges within a few milliseconds.
        let voltage_v = if self.voltage_v > 0.0 { self.voltage_v } else { open_v };
        self.current_a = p.avionics_a + power_w / (p.motor_efficiency * voltage_v);
        // Half the open voltage is where a source gives the most it can.
        self.voltage_v = (open_v - self.current_a * p.resistance_ohm).max(0.5 * open_v);
        self.charge = (self.charge - self.current_a * dt_s / (3600.0 * p.capacity_ah)).max(0.0);
    }

    /// Share of the motors' top speed that this voltage gives, at most 1.
    pub(crate) fn speed_scale(&self) -> f64 {
        (self.voltage_v / self.params.nominal_v).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_battery_sags_under_load_and_empties_by_its_capacity() {
        let params = BatteryParams::default();
        let mut battery = Battery::new(&params);
        let idle_v = battery.voltage_v;
        // 300 W for six minutes.
        for _ in 0..360 * 250 {
            battery.advance(300.0, 0.004);
        }
        assert!(battery.voltage_v < idle_v);
        // 300 W / 0.75 / about 15.2 V + 1.5 A = 27.8 A; a tenth of an hour of it are 2.78 Ah of 5 Ah.
        assert!((battery.charge - (1.0 - 0.556)).abs() < 0.02, "{}", battery.charge);
        let open_v = params.empty_v + (params.full_v - params.empty_v) * battery.charge;
        assert!((open_v - battery.voltage_v - battery.current_a * params.resistance_ohm).abs() < 1e-3);
        for _ in 0..3600 * 250 {
            battery.advance(300.0, 0.004);
        }
        assert_eq!(battery.charge, 0.0);
        assert!(battery.speed_scale() > 0.8 && battery.speed_scale() < 1.0);
    }
}
