//! From mode to the command for the vehicle's controllers, once per millisecond.

use crate::core::Core;
use crate::flight::manual;
use crate::flight::mode::FlightMode;
use crate::flight::state::{Climb, Maneuver};
use crate::vehicle::{ControlCommand, Goal, Held, HoldLaw, YawCommand};
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::{
    ATTITUDE_TARGET_DATA, AttitudeTargetTypemask, MavFrame, POSITION_TARGET_LOCAL_NED_DATA, PositionTargetTypemask,
};
use vigil_types::{Attitude, Frame, FrdVector, Nanos, NedVector, Vector};

/// Nearer than this the direction of a region of interest is the estimate's noise.
const INTEREST_RADIUS_M: f32 = 1.0;
/// Thrust that carries the weight.
pub(super) const HOVER_THRUST: f32 = 0.5;
/// The fastest touch-down that is flown whatever MPC_LAND_SPEED says: from 1.5 m/s on something breaks.
const TOUCH_DOWN_M_S: f32 = 1.0;
/// Below this height the vehicle comes down no faster than it may touch down, and above it this much faster a metre.
const TOUCH_DOWN_HEIGHT_M: f32 = 1.0;
const TOUCH_DOWN_SLOPE_PER_S: f32 = 0.6;
/// How an acceleration downward is taken back for that, and what brakes at the most.
const TOUCH_DOWN_GAIN_PER_S: f32 = 3.0;
const TOUCH_DOWN_BRAKING_M_S2: f32 = 4.0;
/// So near to a place on the ground, and so slow, the vehicle goes down to it.
const TOUCH_DOWN_RADIUS_M: f32 = 1.0;
const TOUCH_DOWN_DRIFT_M_S: f32 = 0.5;
/// Braking ends here at the latest: the estimate's noise must not keep it from holding a position.
const BRAKE_NS: Nanos = 3_000_000_000;
/// The same for [`HoldLaw::Brake`], which loses speed for longer.
const LONG_BRAKE_NS: Nanos = 6_000_000_000;
/// [`HoldLaw::Brake`] asks for a speed that falls to 1/e of that at which it began in this time, whatever the wind does.
const BRAKE_S: f32 = 1.05;
/// Of the point that [`HoldLaw::FlyBack`] projects: what PX4 reckons a stop with, `MPC_ACC_HOR` and `MPC_JERK_AUTO`, of which it
/// takes 0.6 (`computeBrakingDistanceFromVelocity`).
const PROJECTED_BRAKING_M_S2: f32 = 3.0;
const PROJECTED_JERK_M_S3: f32 = 0.6 * 4.0;

impl Core {
    /// One step of flight: ground contact, failsafes, maneuver.
    pub fn fly(&mut self) -> ControlCommand {
        self.watch_ground();
        if !self.commander.armed || self.commander.terminated {
            self.commander.flown = None;
            return ControlCommand::MotorsOff;
        }
        let command = self.fly_maneuver();
        self.commander.flown = Some(command);
        self.touching_down_softly(command)
    }

    fn fly_maneuver(&mut self) -> ControlCommand {
        let on_ground = self.commander.is_on_ground();
        self.watch_position();
        self.watch_lost_sticks();
        if self.commander.mode == FlightMode::Mission {
            self.step_mission();
        }
        match self.commander.maneuver {
            Maneuver::Climb(climb) => {
                self.expect_lift_off();
                self.fly_climb(climb)
            }
            Maneuver::Offboard => self.fly_offboard(on_ground),
            Maneuver::Sticks { held_down_m } => self.fly_by_sticks(held_down_m, on_ground),
            _ if on_ground => ControlCommand::Idle,
            Maneuver::Brake { began, height_m } => self.fly_brake(began, height_m),
            Maneuver::Station(goal) => self.fly_station(goal),
            Maneuver::Descend => ControlCommand::Descend(self.descent_rate_m_s()),
            Maneuver::Orbit(orbit) => self.fly_orbit(orbit),
            Maneuver::Follow { waits_ned_m } => self.fly_follow(waits_ned_m),
            // In the air there is nothing to wait for.
            Maneuver::Grounded { .. } => self.fly_brake(None, None),
        }
    }

    /// How fast the vehicle may come down where it is, metres per second.
    fn descent_limit_m_s(&self) -> f32 {
        let height_m = -self.view.estimate.position_ned_m.z;
        let above_m = (height_m - TOUCH_DOWN_HEIGHT_M).max(0.0);
        self.param(ParamId::LandSpeedMS).min(TOUCH_DOWN_M_S) + TOUCH_DOWN_SLOPE_PER_S * above_m
    }

    /// Velocities and places that run into the ground end on it: the world is level at home's height.
    fn touching_down_softly(&self, mut command: ControlCommand) -> ControlCommand {
        let limit_m_s = self.descent_limit_m_s();
        let down_to_ground_m_s = limit_m_s.min(self.param(ParamId::MaxDownMS));
        let estimate = &self.view.estimate;
        match &mut command {
            ControlCommand::VelocityHeading(v, _) => v.z = v.z.min(limit_m_s),
            ControlCommand::VelocityNed(v, _) => v.z = v.z.min(limit_m_s),
            ControlCommand::Descend(down) => *down = down.min(limit_m_s),
            ControlCommand::Position(goal) if goal.held == Held::Level => {
                goal.velocity_m_s.z = goal.velocity_m_s.z.min(limit_m_s);
            }
            ControlCommand::Position(goal) if goal.position_ned_m.z >= 0.0 && goal.held == Held::Height => {
                let NedVector { x, y, .. } = goal.velocity_m_s;
                return ControlCommand::VelocityNed(NedVector::new(x, y, down_to_ground_m_s), goal.yaw);
            }
            ControlCommand::Position(goal) if goal.position_ned_m.z >= 0.0 => {
                let off_m = (goal.position_ned_m - estimate.position_ned_m).horizontal_norm();
                let drift_m_s = estimate.velocity_ned_m_s.horizontal_norm();
                if off_m < TOUCH_DOWN_RADIUS_M && drift_m_s < TOUCH_DOWN_DRIFT_M_S {
                    let down = NedVector::new(0.0, 0.0, down_to_ground_m_s);
                    (goal.held, goal.velocity_m_s) = (Held::Level, down);
                } else {
                    goal.position_ned_m.z = -TOUCH_DOWN_HEIGHT_M;
                }
            }
            ControlCommand::Acceleration(a, _) => {
                let slowing_m_s2 = (limit_m_s - estimate.velocity_ned_m_s.z) * TOUCH_DOWN_GAIN_PER_S;
                a.z = a.z.min(slowing_m_s2.max(-TOUCH_DOWN_BRAKING_M_S2));
            }
            _ => {}
        }
        command
    }

    fn fly_brake(&mut self, began: Option<(Nanos, NedVector)>, height_m: Option<f32>) -> ControlCommand {
        let velocity = self.view.estimate.velocity_ned_m_s;
        let level = NedVector::new(velocity.x, velocity.y, 0.0);
        let (began_ns, from_m_s) = began.unwrap_or((self.now_ns, level));
        let since_ns = self.now_ns.saturating_sub(began_ns);
        let kept = libm::expf(-(since_ns as f32 * 1e-9) / BRAKE_S);
        let (wanted, limit_ns) = match self.hold_law {
            HoldLaw::FlyBack => return self.fly_to_projected(velocity, height_m),
            HoldLaw::Brake => (from_m_s * kept, LONG_BRAKE_NS),
            HoldLaw::Stop => (NedVector::ZERO, BRAKE_NS),
        };
        let stopped = velocity.horizontal_norm() < 0.2 && velocity.z.abs() < 0.2;
        if !stopped && since_ns < limit_ns {
            self.commander.maneuver = Maneuver::Brake {
                began: Some((began_ns, from_m_s)),
                height_m,
            };
            return ControlCommand::VelocityNed(wanted, YawCommand::Hold);
        }
        let speed_limit_m_s = self.cruise_speed_m_s(self.commander.speed_m_s);
        self.hold_at(self.view.estimate.position_ned_m, height_m, speed_limit_m_s)
    }

    /// Begins to hold a position, at `height_m` if given.
    fn hold_at(&mut self, mut place: NedVector, height_m: Option<f32>, speed_limit_m_s: f32) -> ControlCommand {
        place.z = height_m.map_or(place.z, |height_m| -height_m);
        let goal = Goal::new(place, YawCommand::Hold, speed_limit_m_s);
        self.commander.maneuver = Maneuver::Station(goal);
        self.fly_station(goal)
    }

    /// Holds the point at which the vehicle would stop if it did not gain speed.
    fn fly_to_projected(&mut self, velocity: NedVector, height_m: Option<f32>) -> ControlCommand {
        let speed_m_s = velocity.horizontal_norm();
        let stop_s = speed_m_s / (2.0 * PROJECTED_BRAKING_M_S2) + PROJECTED_BRAKING_M_S2 / PROJECTED_JERK_M_S3;
        let here = self.view.estimate.position_ned_m;
        let projected = NedVector::new(here.x + velocity.x * stop_s, here.y + velocity.y * stop_s, here.z);
        self.hold_at(projected, height_m, self.param(ParamId::MaxSpeedMS))
    }

    fn fly_station(&mut self, mut goal: Goal) -> ControlCommand {
        if self.commander.mode == FlightMode::Return {
            let off = self.view.estimate.position_ned_m - goal.position_ned_m;
            if off.horizontal_norm() < 0.5 && self.view.estimate.velocity_ned_m_s.horizontal_norm() < 0.5 {
                self.commander.maneuver = Maneuver::Descend;
            }
        }
        if self.commander.mode == FlightMode::Mission {
            goal.velocity_m_s = self.passing_velocity_m_s(goal.position_ned_m);
        }
        goal.yaw = self.towards_interest().unwrap_or(goal.yaw);
        ControlCommand::Position(goal)
    }

    /// The heading towards the region of interest, in hold and on missions, unless it is right below.
    fn towards_interest(&self) -> Option<YawCommand> {
        let (north, east) = self.commander.region_of_interest_m?;
        let here = self.view.estimate.position_ned_m;
        let is_followed = matches!(self.commander.mode, FlightMode::Hold | FlightMode::Mission);
        (is_followed && libm::hypotf(north - here.x, east - here.y) > INTEREST_RADIUS_M)
            .then(|| YawCommand::Angle(libm::atan2f(east - here.y, north - here.x)))
    }

    fn fly_climb(&mut self, climb: Climb) -> ControlCommand {
        if climb.is_cruising(self.view.estimate.position_ned_m.z) {
            return ControlCommand::VelocityNed(NedVector::new(0.0, 0.0, -climb.rate_m_s), YawCommand::Hold);
        }
        let speed_limit_m_s = self.cruise_speed_m_s(None);
        let goal = |place| Goal::new(place, YawCommand::Hold, speed_limit_m_s);
        let target = climb.target_ned_m;
        if climb.is_done(&self.view.estimate) {
            match self.commander.mode {
                FlightMode::Return => {
                    let (north, east) = self.commander.return_to_m;
                    self.commander.maneuver = Maneuver::Station(goal(NedVector::new(north, east, target.z)));
                }
                // The mission goes on in its next step.
                FlightMode::Mission => {}
                _ => self.enter(FlightMode::Hold, Maneuver::Station(goal(target))),
            }
        }
        ControlCommand::Position(goal(target))
    }

    /// The place that is flown to or held in the air, metres from the local origin; `None` where there is none.
    pub fn place_flown_to(&self) -> Option<NedVector> {
        let here = self.view.estimate.position_ned_m;
        let is_flown = self.commander.armed && !self.commander.is_on_ground();
        match self.commander.maneuver {
            _ if !is_flown => None,
            Maneuver::Station(goal) => Some(goal.position_ned_m),
            Maneuver::Climb(climb) => Some(climb.target_ned_m),
            Maneuver::Descend => Some(NedVector::new(here.x, here.y, 0.0)),
            Maneuver::Offboard => match self.owners_setpoint()? {
                ControlCommand::Position(goal) if goal.held == Held::All => Some(goal.position_ned_m),
                _ => None,
            },
            _ => None,
        }
    }

    fn descent_rate_m_s(&self) -> f32 {
        let height_m = -self.view.estimate.position_ned_m.z;
        let slow_m_s = self.param(ParamId::LandSpeedMS);
        if height_m > self.param(ParamId::LandSlowHeightM) {
            self.param(ParamId::AutoDownMS).max(slow_m_s)
        } else {
            slow_m_s
        }
    }

    fn fly_offboard(&mut self, on_ground: bool) -> ControlCommand {
        let Some(command) = self.owners_setpoint() else {
            self.lose_setpoints();
            return if on_ground || self.commander.terminated || !self.commander.armed {
                ControlCommand::Idle
            } else {
                ControlCommand::STOP
            };
        };
        if on_ground {
            if !self.lifts(&command) {
                return ControlCommand::Idle;
            }
            self.expect_lift_off();
        }
        self.limited(command)
    }

    /// The thrust asked for, where the thrust itself is commanded.
    pub(super) fn wanted_thrust(&self) -> Option<f32> {
        match self.commander.mode {
            FlightMode::Stabilized | FlightMode::Manual | FlightMode::Acro => self.current_sticks().map(manual::thrust),
            _ => match self.owners_setpoint()? {
                ControlCommand::Attitude(.., thrust) | ControlCommand::Rates(_, thrust) => Some(thrust),
                _ => None,
            },
        }
    }

    /// Whether a setpoint means to leave the ground.
    fn lifts(&self, command: &ControlCommand) -> bool {
        match command {
            ControlCommand::VelocityHeading(velocity_m_s, _) => velocity_m_s.z < -0.1,
            ControlCommand::VelocityNed(upward, _) | ControlCommand::Acceleration(upward, _) => upward.z < -0.1,
            ControlCommand::Position(goal) if goal.held == Held::Level => goal.velocity_m_s.z < -0.1,
            ControlCommand::Position(goal) => goal.position_ned_m.z < self.view.estimate.position_ned_m.z - 0.3,
            // More than the weight.
            ControlCommand::Attitude(.., thrust) | ControlCommand::Rates(_, thrust) => *thrust > HOVER_THRUST,
            _ => false,
        }
    }

    /// Velocities within MPC_XY_VEL_MAX and MPC_Z_VEL_MAX_*; the direction is kept.
    fn limited(&self, mut command: ControlCommand) -> ControlCommand {
        fn within<F: Frame>(v: Vector<F>, max_m_s: f32, down_m_s: f32) -> Vector<F> {
            let norm = v.horizontal_norm();
            let k = if norm > max_m_s { max_m_s / norm } else { 1.0 };
            Vector::new(v.x * k, v.y * k, down_m_s)
        }
        let max_m_s = self.param(ParamId::MaxSpeedMS);
        let (up, down) = (self.param(ParamId::MaxUpMS), self.param(ParamId::MaxDownMS));
        match &mut command {
            ControlCommand::VelocityHeading(v, _) => *v = within(*v, max_m_s, v.z.clamp(-up, down)),
            ControlCommand::VelocityNed(v, _) => *v = within(*v, max_m_s, v.z.clamp(-up, down)),
            ControlCommand::Position(Goal {
                velocity_m_s: v, held, ..
            }) => match held {
                Held::All => {}
                Held::Level => v.z = v.z.clamp(-up, down),
                Held::Height => *v = within(*v, max_m_s, 0.0),
            },
            _ => {}
        }
        command
    }
}

/// What OFFBOARD or a maneuver flies to, as POSITION_TARGET_LOCAL_NED reports it; `None` where there is no such target.
pub(crate) fn position_target(core: &Core) -> Option<MavMessage> {
    const VELOCITY_ONLY: u16 = 0xDC7;
    const POSITION_ONLY: u16 = 0xDF8;
    const VELOCITY_AND_HEIGHT: u16 = 0xDE3;
    const PLACE_AND_CLIMB: u16 = 0xDDC;
    const ACCELERATION_ONLY: u16 = 0xC3F;
    let mut acceleration = NedVector::ZERO;
    let command = match core.commander.maneuver {
        Maneuver::Offboard => core.owners_setpoint()?,
        _ => core.commander.flown.unwrap_or(ControlCommand::STOP),
    };
    let yaw_rad = core.view.estimate.attitude.yaw_rad();
    let still = NedVector::ZERO;
    let (position, velocity, mask, yaw) = match command {
        ControlCommand::VelocityHeading(ahead, yaw) => (still, ahead.to_ned(yaw_rad), VELOCITY_ONLY, yaw),
        ControlCommand::VelocityNed(velocity_m_s, yaw) => (still, velocity_m_s, VELOCITY_ONLY, yaw),
        ControlCommand::Position(goal) => {
            let mask = match goal.held {
                Held::All => POSITION_ONLY,
                Held::Level => PLACE_AND_CLIMB,
                Held::Height => VELOCITY_AND_HEIGHT,
            };
            (goal.position_ned_m, goal.velocity_m_s, mask, goal.yaw)
        }
        ControlCommand::Descend(rate_m_s) => {
            let descent = NedVector::new(0.0, 0.0, rate_m_s);
            (still, descent, VELOCITY_ONLY, YawCommand::Hold)
        }
        ControlCommand::Acceleration(acceleration_ned_m_s2, yaw) => {
            acceleration = acceleration_ned_m_s2;
            (still, still, ACCELERATION_ONLY, yaw)
        }
        ControlCommand::Idle | ControlCommand::MotorsOff => (still, still, VELOCITY_ONLY, YawCommand::Hold),
        ControlCommand::Attitude(..) | ControlCommand::Rates(..) => return None,
    };
    let (yaw, yaw_rate, mask) = match yaw {
        YawCommand::Hold => (0.0, 0.0, mask),
        YawCommand::Angle(yaw_rad) => (yaw_rad, 0.0, mask & !0x400),
        YawCommand::Rate(yaw_rate_rad_s) => (0.0, yaw_rate_rad_s, mask & !0x800),
    };
    let mut m = POSITION_TARGET_LOCAL_NED_DATA::default();
    [m.x, m.y, m.z] = position.to_array();
    [m.vx, m.vy, m.vz] = velocity.to_array();
    [m.afx, m.afy, m.afz] = acceleration.to_array();
    (m.yaw, m.yaw_rate, m.time_boot_ms) = (yaw, yaw_rate, core.time_boot_ms());
    m.type_mask = PositionTargetTypemask::from_bits_truncate(mask);
    m.coordinate_frame = MavFrame::MAV_FRAME_LOCAL_NED;
    Some(MavMessage::POSITION_TARGET_LOCAL_NED(m))
}

/// The attitude or body rates that OFFBOARD flies to, as ATTITUDE_TARGET reports them. Where positions or velocities are flown,
/// the vehicle's own controllers ask for what it does, but for their lag.
pub(crate) fn attitude_target(core: &Core) -> Option<MavMessage> {
    const RATES_IGNORED: u8 = 0x07;
    const TILT_RATES_IGNORED: u8 = 0x03;
    const ATTITUDE_IGNORED: u8 = 0x80;
    let (estimate, throttle) = (&core.view.estimate, core.view.sensors.throttle);
    let (attitude, rates, thrust, mask) = match core.owners_setpoint() {
        Some(ControlCommand::Attitude(attitude, yaw_rate_rad_s, thrust)) => {
            let turns = yaw_rate_rad_s != 0.0;
            let mask = if turns { TILT_RATES_IGNORED } else { RATES_IGNORED };
            (attitude, FrdVector::new(0.0, 0.0, yaw_rate_rad_s), thrust, mask)
        }
        Some(ControlCommand::Rates(rates_frd_rad_s, thrust)) => {
            (Attitude::LEVEL_NORTH, rates_frd_rad_s, thrust, ATTITUDE_IGNORED)
        }
        _ => (estimate.attitude, estimate.rates_frd_rad_s, throttle, 0),
    };
    Some(MavMessage::ATTITUDE_TARGET(ATTITUDE_TARGET_DATA {
        time_boot_ms: core.time_boot_ms(),
        q: [attitude.w, attitude.x, attitude.y, attitude.z],
        body_roll_rate: rates.x,
        body_pitch_rate: rates.y,
        body_yaw_rate: rates.z,
        thrust,
        type_mask: AttitudeTargetTypemask::from_bits_truncate(mask),
    }))
}
