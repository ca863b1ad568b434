//! The autopilot's cascade: position → velocity → attitude → rate, on the estimate.

use crate::vehicle::body::{Body, Inertia};
use crate::vehicle::interface::{ControlCommand, Held, YawCommand};
use crate::vehicle::math::{Rotation, StateBytes, Vec3, from_attitude, heading, tilt_and_heading, vec3, wrap, yaw_of};
use crate::vehicle::params::{ControlParams, GRAVITY_M_S2, VelocityLaw};
use crate::vehicle::rotors::Wrench;
use crate::vehicle::shaping::{Limits, Shaped, advance_horizontal, square_root_law};

/// The reference never runs further ahead of the vehicle than this, metres: what is blocked or blown away does not
/// wind up a debt.
const LEASH_M: f64 = 1.0;
/// The same for the heading, radians.
const YAW_LEASH_RAD: f64 = 0.5;
/// A wanted climb faster than this takes off from the ground, m/s. It is above what the slow error of the estimated height
/// asks of a vehicle that holds its position on the ground.
const TAKEOFF_CLIMB_M_S: f64 = 0.15;
/// Largest acceleration that the velocity integral may hold against wind and drag, m/s².
const INTEGRAL_MAX_M_S2: f64 = 4.0;
/// Time constant of the acceleration measured under [`VelocityLaw::Direct`], from which a path to a place begins.
const ACCELERATION_FILTER_S: f64 = 0.05;
/// Fastest rate about any axis that a rates command may ask for: 720 °/s, in rad/s.
const RATE_MAX_RAD_S: f64 = 4.0 * core::f64::consts::PI;
/// Largest angular acceleration that the rate integral may hold, rad/s².
const RATE_INTEGRAL_MAX_RAD_S2: f64 = 5.0;

/// Which part of the cascade runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Stage {
    /// Motors stopped.
    #[default]
    Off,
    /// Motors idle.
    Idle,
    /// Following a shaped path.
    Path,
    /// Attitude and thrust from outside.
    Attitude,
    /// Rates and thrust from outside.
    Rates,
    /// Acceleration from outside.
    Acceleration,
}

/// The shaped path that the position controller follows.
#[derive(Debug, Clone, Copy, Default)]
struct Reference {
    position_ned_m: Vec3,
    velocity_ned_m_s: Vec3,
    acceleration_ned_m_s2: Vec3,
    yaw_rad: f64,
    yaw_rate: Shaped,
}

/// All controllers and their memory.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Controller {
    params: ControlParams,
    pub(crate) inertia: Inertia,
    mass_kg: f64,
    tilt_max_tan: f64,
    horizontal: Limits,
    vertical: Limits,
    yaw: Limits,
    /// Which part of the cascade runs.
    pub(crate) stage: Stage,
    reference: Reference,
    /// The wanted velocity as far as [`VelocityLaw::Direct`] has taken it up.
    taken_up_m_s: Vec3,
    velocity_integral_m_s2: Vec3,
    rates_wanted_rad_s: Vec3,
    thrust_wanted_n: f64,
    rate_integral_rad_s2: Vec3,
    /// Whether the motors could not give the last wrench: integrals wait.
    pub(crate) saturated: bool,
}

impl Controller {
    pub(crate) fn new(params: &ControlParams, mass_kg: f64, inertia: Inertia) -> Self {
        Self {
            params: *params,
            inertia,
            mass_kg,
            tilt_max_tan: libm::tan(params.tilt_max_rad),
            horizontal: Limits {
                accel: params.accel_horizontal_m_s2,
                jerk: params.jerk_horizontal_m_s3,
                gain_per_s: params.shaping_horizontal_per_s,
            },
            vertical: Limits {
                accel: params.accel_vertical_m_s2,
                jerk: params.jerk_vertical_m_s3,
                gain_per_s: params.shaping_vertical_per_s,
            },
            yaw: Limits {
                accel: params.yaw_accel_rad_s2,
                jerk: params.yaw_jerk_rad_s3,
                gain_per_s: params.shaping_yaw_per_s,
            },
            ..Self::default()
        }
    }

    /// Thrust of one weight, newtons.
    fn weight_n(&self) -> f64 {
        self.mass_kg * GRAVITY_M_S2
    }

    /// Starts over as one that has hovered here for long, against this acceleration by wind. Gives the attitude and
    /// the thrust of that hover.
    pub(crate) fn settle(&mut self, belief: &Body, wind_acceleration: &Vec3) -> (Rotation, f64) {
        self.stage = Stage::Path;
        self.rate_integral_rad_s2 = Vec3::zeros();
        self.velocity_integral_m_s2 = -wind_acceleration;
        self.reset_reference(belief);
        self.reference.velocity_ned_m_s = Vec3::zeros();
        let force = self.force_for(&self.velocity_integral_m_s2);
        let thrust_n = force.norm();
        self.rates_wanted_rad_s = Vec3::zeros();
        self.thrust_wanted_n = thrust_n;
        (
            tilt_and_heading(&(force / thrust_n), yaw_of(&belief.attitude)),
            thrust_n,
        )
    }

    /// The slow part, once per control interval: from the command to wanted rates and thrust. A command with a number
    /// that is not finite is a hold.
    pub(crate) fn plan(&mut self, command: &ControlCommand, belief: &Body, on_ground: bool, dt_s: f64) {
        match *command {
            ControlCommand::MotorsOff => self.stop(Stage::Off),
            ControlCommand::Idle => self.stop(Stage::Idle),
            ControlCommand::Attitude(attitude, yaw_rate_rad_s, thrust)
                if attitude.is_valid() && yaw_rate_rad_s.is_finite() && thrust.is_finite() =>
            {
                self.stage = Stage::Attitude;
                self.thrust_wanted_n = self.thrust_for(thrust);
                let yaw_rate = self.limit_yaw_rate(yaw_rate_rad_s);
                self.rates_wanted_rad_s = self.rates_towards(&from_attitude(attitude), belief, yaw_rate);
            }
            ControlCommand::Acceleration(ned_m_s2, yaw) if ned_m_s2.is_finite() => {
                self.accelerate(&vec3(ned_m_s2), yaw, belief);
            }
            ControlCommand::Rates(frd_rad_s, thrust) if frd_rad_s.is_finite() && thrust.is_finite() => {
                self.stage = Stage::Rates;
                self.thrust_wanted_n = self.thrust_for(thrust);
                self.rates_wanted_rad_s = vec3(frd_rad_s).map(|r| r.clamp(-RATE_MAX_RAD_S, RATE_MAX_RAD_S));
            }
            _ => {
                self.enter(Stage::Path, belief);
                let (velocity, yaw) = self.path_velocity(command, belief);
                let law = match command {
                    ControlCommand::VelocityHeading(..) | ControlCommand::VelocityNed(..) => self.params.velocity_law,
                    _ => VelocityLaw::Shaped,
                };
                self.follow(&velocity, yaw, (belief, on_ground), law, dt_s);
            }
        }
    }

    /// The velocity that a command wants now, and the yaw.
    fn path_velocity(&self, command: &ControlCommand, belief: &Body) -> (Vec3, YawCommand) {
        match *command {
            ControlCommand::VelocityHeading(velocity_m_s, yaw) if velocity_m_s.is_finite() => {
                (heading(yaw_of(&belief.attitude)) * vec3(velocity_m_s), yaw)
            }
            ControlCommand::VelocityNed(velocity_m_s, yaw) if velocity_m_s.is_finite() => (vec3(velocity_m_s), yaw),
            ControlCommand::Position(goal) if goal.position_ned_m.is_finite() && goal.velocity_m_s.is_finite() => {
                let (mut place, mut velocity) = (vec3(goal.position_ned_m), vec3(goal.velocity_m_s));
                let here = self.reference.position_ned_m;
                match goal.held {
                    Held::All => {}
                    Held::Level => place.z = here.z,
                    Held::Height => (place.x, place.y, velocity.z) = (here.x, here.y, 0.0),
                }
                let limit_m_s = f64::from(goal.speed_limit_m_s);
                (self.velocity_towards(&place, &velocity, limit_m_s), goal.yaw)
            }
            ControlCommand::Descend(rate_m_s) if rate_m_s.is_finite() => {
                (Vec3::new(0.0, 0.0, f64::from(rate_m_s.max(0.0))), YawCommand::Hold)
            }
            _ => (Vec3::zeros(), YawCommand::Hold),
        }
    }

    /// The fast part, every physics step: from wanted and measured rates to a wrench, `None` while the motors stop or idle.
    pub(crate) fn wrench(&mut self, rates_rad_s: &Vec3, dt_s: f64) -> Option<Wrench> {
        if matches!(self.stage, Stage::Off | Stage::Idle) {
            return None;
        }
        let error = self.rates_wanted_rad_s - rates_rad_s;
        if !self.saturated {
            let sum = self.rate_integral_rad_s2 + weighed(&error, self.params.rate_integral_per_s2) * dt_s;
            self.rate_integral_rad_s2 = sum.map(|v| v.clamp(-RATE_INTEGRAL_MAX_RAD_S2, RATE_INTEGRAL_MAX_RAD_S2));
        }
        let angular = weighed(&error, self.params.rate_gain_per_s) + self.rate_integral_rad_s2;
        Some(Wrench {
            thrust_n: self.thrust_wanted_n,
            torque_frd_n_m: self.inertia.moments_kg_m2.component_mul(&angular) + self.inertia.gyroscopic(rates_rad_s),
        })
    }

    /// Forgets everything, motors off or idle.
    pub(crate) fn stop(&mut self, stage: Stage) {
        self.stage = stage;
        self.velocity_integral_m_s2 = Vec3::zeros();
        self.rate_integral_rad_s2 = Vec3::zeros();
        self.rates_wanted_rad_s = Vec3::zeros();
        self.thrust_wanted_n = 0.0;
        self.saturated = false;
    }

    /// 0.5 hovers.
    fn thrust_for(&self, thrust: f32) -> f64 {
        2.0 * self.weight_n() * f64::from(thrust.clamp(0.0, 1.0))
    }

    /// The path begins where the vehicle is and as fast as it moves, but no faster than it may fly: from a fall or a
    /// throw the velocity controller brakes with all thrust, not within the shaping limits.
    fn reset_reference(&mut self, belief: &Body) {
        let mut velocity_ned_m_s = belief.velocity_ned_m_s;
        self.limit_velocity(&mut velocity_ned_m_s);
        self.taken_up_m_s = velocity_ned_m_s;
        self.reference = Reference {
            position_ned_m: belief.position_ned_m,
            velocity_ned_m_s,
            acceleration_ned_m_s2: Vec3::zeros(),
            yaw_rad: yaw_of(&belief.attitude),
            yaw_rate: Shaped::default(),
        };
    }

    fn limit_velocity(&self, velocity_ned_m_s: &mut Vec3) {
        limit_horizontal(velocity_ned_m_s, self.params.speed_max_m_s);
        velocity_ned_m_s.z = velocity_ned_m_s
            .z
            .clamp(-self.params.climb_max_m_s, self.params.descent_max_m_s);
    }

    fn enter(&mut self, stage: Stage, belief: &Body) {
        if self.stage != stage {
            self.stage = stage;
            self.reset_reference(belief);
        }
    }

    fn limit_yaw_rate(&self, yaw_rate_rad_s: f32) -> f64 {
        let most = self.params.yaw_rate_max_rad_s;
        f64::from(yaw_rate_rad_s).clamp(-most, most)
    }

    /// From a wanted acceleration to attitude and thrust, without a path. The heading is held from where this began.
    fn accelerate(&mut self, acceleration: &Vec3, yaw: YawCommand, belief: &Body) {
        self.enter(Stage::Acceleration, belief);
        let (yaw_rad, yaw_rate) = match yaw {
            YawCommand::Angle(yaw_rad) if yaw_rad.is_finite() => (wrap(f64::from(yaw_rad)), 0.0),
            YawCommand::Rate(yaw_rate_rad_s) if yaw_rate_rad_s.is_finite() => {
                (yaw_of(&belief.attitude), self.limit_yaw_rate(yaw_rate_rad_s))
            }
            _ => (self.reference.yaw_rad, 0.0),
        };
        self.reference.yaw_rad = yaw_rad;
        let force = self.force_for(acceleration);
        let wanted = tilt_and_heading(&force.normalize(), yaw_rad);
        self.rates_wanted_rad_s = self.rates_towards(&wanted, belief, yaw_rate);
        self.thrust_wanted_n = force.dot(&(belief.attitude * Vec3::z())).max(0.0);
    }

    /// The velocity that goes to a position and stops there.
    fn velocity_towards(&self, goal_ned_m: &Vec3, feed_forward: &Vec3, speed_limit_m_s: f64) -> Vec3 {
        let [horizontal_gain, vertical_gain] = self.params.approach_gain_per_s;
        let error = goal_ned_m - self.reference.position_ned_m;
        // Half the acceleration limit: the other half is for what the jerk limit delays.
        let distance = (error.x * error.x + error.y * error.y).sqrt();
        let speed = square_root_law(distance, horizontal_gain, 0.5 * self.horizontal.accel);
        let share = if distance > 0.0 { speed / distance } else { 0.0 };
        let climb = square_root_law(error.z.abs(), vertical_gain, 0.5 * self.vertical.accel);
        let mut v = feed_forward + Vec3::new(error.x * share, error.y * share, climb * error.z.signum());
        // A limit that is not a number limits to nothing.
        limit_horizontal(&mut v, speed_limit_m_s.max(0.0));
        v
    }

    /// One interval towards this wanted velocity.
    fn follow(
        &mut self,
        velocity_ned_m_s: &Vec3,
        yaw: YawCommand,
        (belief, on_ground): (&Body, bool),
        law: VelocityLaw,
        dt_s: f64,
    ) {
        let p = self.params;
        let mut target = *velocity_ned_m_s;
        self.limit_velocity(&mut target);

        if on_ground && target.z > -TAKEOFF_CLIMB_M_S {
            self.stop(Stage::Idle);
            return;
        }
        let (ahead, velocity_error) = match law {
            VelocityLaw::Shaped => self.shaped(&target, belief, dt_s),
            VelocityLaw::Direct => self.direct(&target, belief, dt_s),
        };

        let r = &mut self.reference;
        let yaw_rate_wanted = match yaw {
            YawCommand::Rate(yaw_rate_rad_s) if yaw_rate_rad_s.is_finite() => f64::from(yaw_rate_rad_s),
            YawCommand::Angle(yaw_rad) if yaw_rad.is_finite() => {
                let turn = wrap(f64::from(yaw_rad) - r.yaw_rad);
                square_root_law(turn.abs(), 2.0, 0.5 * p.yaw_accel_rad_s2) * turn.signum()
            }
            _ => 0.0,
        };
        let (most, yaw_rad) = (p.yaw_rate_max_rad_s, yaw_of(&belief.attitude));
        r.yaw_rate.advance(yaw_rate_wanted.clamp(-most, most), &self.yaw, dt_s);
        let turned = wrap(r.yaw_rad + r.yaw_rate.value * dt_s - yaw_rad).clamp(-YAW_LEASH_RAD, YAW_LEASH_RAD);
        r.yaw_rad = wrap(yaw_rad + turned);
        let r = *r;

        let acceleration = ahead + weighed(&velocity_error, p.velocity_gain_per_s) + self.velocity_integral_m_s2;
        let unlimited = self.unlimited_force(&acceleration);
        let force = self.force_for(&acceleration);
        if !self.saturated && (force - unlimited).norm() < 1e-9 {
            let sum = self.velocity_integral_m_s2 + weighed(&velocity_error, p.velocity_integral_per_s2) * dt_s;
            self.velocity_integral_m_s2 = sum.map(|v| v.clamp(-INTEGRAL_MAX_M_S2, INTEGRAL_MAX_M_S2));
        }

        let wanted = tilt_and_heading(&force.normalize(), r.yaw_rad);
        self.rates_wanted_rad_s = self.rates_towards(&wanted, belief, r.yaw_rate.value);
        // Thrust along the axis that the body has, not the one that it should have.
        let thrust_n = force.dot(&(belief.attitude * Vec3::z())).max(0.0);
        self.thrust_wanted_n += (thrust_n - self.thrust_wanted_n) * dt_s / (dt_s + p.thrust_filter_s);
    }

    /// The reference an interval on; its acceleration, and the error of the velocity that follows it.
    fn shaped(&mut self, target: &Vec3, belief: &Body, dt_s: f64) -> (Vec3, Vec3) {
        self.taken_up_m_s = belief.velocity_ned_m_s;
        let r = &mut self.reference;
        advance_horizontal(
            &mut r.velocity_ned_m_s,
            &mut r.acceleration_ned_m_s2,
            (target.x, target.y),
            &self.horizontal,
            dt_s,
        );
        let mut vertical = Shaped {
            value: r.velocity_ned_m_s.z,
            slope: r.acceleration_ned_m_s2.z,
        };
        vertical.advance(target.z, &self.vertical, dt_s);
        r.velocity_ned_m_s.z = vertical.value;
        r.acceleration_ned_m_s2.z = vertical.slope;
        r.position_ned_m += r.velocity_ned_m_s * dt_s;
        let mut error = r.position_ned_m - belief.position_ned_m;
        limit_horizontal(&mut error, LEASH_M);
        error.z = error.z.clamp(-LEASH_M, LEASH_M);
        r.position_ned_m = belief.position_ned_m + error;
        let wanted_m_s = r.velocity_ned_m_s + weighed(&error, self.params.position_gain_per_s);
        (r.acceleration_ned_m_s2, wanted_m_s - belief.velocity_ned_m_s)
    }

    /// The reference is where the vehicle is and moves as it does, for the path that may follow; the error of the velocity,
    /// weighed as the gain for braking is.
    fn direct(&mut self, target: &Vec3, belief: &Body, dt_s: f64) -> (Vec3, Vec3) {
        let p = &self.params;
        let velocity = belief.velocity_ned_m_s;
        let r = &mut self.reference;
        let measured = (velocity - r.velocity_ned_m_s) / dt_s;
        r.acceleration_ned_m_s2 += (measured - r.acceleration_ned_m_s2) * (dt_s / (dt_s + ACCELERATION_FILTER_S));
        r.velocity_ned_m_s = velocity;
        r.position_ned_m = belief.position_ned_m;
        self.taken_up_m_s += (target - self.taken_up_m_s) * (dt_s / (dt_s + p.velocity_lag_s));
        let wanted = Vec3::new(self.taken_up_m_s.x, self.taken_up_m_s.y, target.z);
        let mut error = wanted - velocity;
        if target.x * target.x + target.y * target.y < 0.25 * (velocity.x * velocity.x + velocity.y * velocity.y) {
            error.x *= p.braking_share;
            error.y *= p.braking_share;
        }
        (Vec3::zeros(), error)
    }

    /// The force along the body's down axis whose reaction gives this acceleration, NED.
    fn unlimited_force(&self, acceleration: &Vec3) -> Vec3 {
        (Vec3::new(0.0, 0.0, GRAVITY_M_S2) - acceleration) * self.mass_kg
    }

    /// The same within tilt and thrust limits; the vertical part has priority.
    fn force_for(&self, acceleration: &Vec3) -> Vec3 {
        let mut force = self.unlimited_force(acceleration);
        force.z = force.z.clamp(0.2 * self.weight_n(), 2.0 * self.weight_n());
        let limit = force.z * self.tilt_max_tan;
        limit_horizontal(&mut force, limit);
        force
    }

    /// Rates that turn the body to the wanted attitude, while its heading turns at `yaw_rate`.
    fn rates_towards(&self, wanted: &Rotation, belief: &Body, yaw_rate_rad_s: f64) -> Vec3 {
        let error = belief.attitude.inverse() * wanted;
        let side = if error.w < 0.0 { -2.0 } else { 2.0 };
        let feed_forward = belief
            .attitude
            .inverse_transform_vector(&Vec3::new(0.0, 0.0, yaw_rate_rad_s));
        let mut rates = weighed(&(error.imag() * side), self.params.attitude_gain_per_s) + feed_forward;
        limit_horizontal(&mut rates, self.params.tilt_rate_max_rad_s);
        let yaw_limit = 1.5 * self.params.yaw_rate_max_rad_s;
        rates.z = rates.z.clamp(-yaw_limit, yaw_limit);
        rates
    }

    /// Everything that the next step depends on, for the state hash.
    pub(crate) fn tell_state(&self, bytes: &mut StateBytes) {
        let r = &self.reference;
        let vectors = [
            r.position_ned_m,
            r.velocity_ned_m_s,
            r.acceleration_ned_m_s2,
            self.velocity_integral_m_s2,
            self.rates_wanted_rad_s,
            self.rate_integral_rad_s2,
        ];
        bytes.numbers(vectors.iter().flatten());
        bytes.numbers(&[r.yaw_rad, r.yaw_rate.value, r.yaw_rate.slope, self.thrust_wanted_n]);
        bytes.word(u64::from(self.saturated));
        bytes.word(self.stage as u64);
        if self.params.velocity_law == VelocityLaw::Direct {
            bytes.numbers(&self.taken_up_m_s);
        }
    }
}

/// A vector with one gain for the first two components and another for the third.
fn weighed(v: &Vec3, [level, down]: [f64; 2]) -> Vec3 {
    Vec3::new(v.x * level, v.y * level, v.z * down)
}

/// Shortens the first two components to a length of at most `limit`.
fn limit_horizontal(v: &mut Vec3, limit: f64) {
    let norm = (v.x * v.x + v.y * v.y).sqrt();
    if norm > limit {
        v.x *= limit / norm;
        v.y *= limit / norm;
    }
}
