//! Flying by sticks: MANUAL_CONTROL and RC_CHANNELS_OVERRIDE. <https://docs.px4.io/main/en/flight_modes_mc/>

use crate::config::Source;
use crate::core::Core;
use crate::flight::control::HOVER_THRUST;
use crate::flight::mode::FlightMode;
use crate::flight::state::{Deflections, Failsafe, Maneuver};
use crate::vehicle::{ControlCommand, YawCommand};
use crate::vehicle_parameters::ParamId;
use vigil_types::{Attitude, FrdVector, HeadingVector};

/// Deflections below this are the centre.
const DEAD_ZONE: f32 = 0.05;
/// Turning rate at full deflection.
const MAX_YAW_RATE_RAD_S: f32 = 1.5;
/// Tilt at full deflection; PX4's default of MPC_MAN_TILT_MAX.
const MAX_TILT_RAD: f32 = 35.0 * core::f32::consts::PI / 180.0;
/// Rates at full deflection in acro; PX4's defaults of MC_ACRO_*_MAX.
const MAX_ACRO_RATE_RAD_S: f32 = 100.0 * core::f32::consts::PI / 180.0;
const GRAVITY_M_S2: f32 = 9.806_65;
/// From height error to climb rate, and from that error to acceleration, in altitude mode.
const HEIGHT_GAIN_PER_S: f32 = 0.8;
const CLIMB_GAIN_PER_S: f32 = 3.0;
/// Largest vertical acceleration in altitude mode.
const MAX_CLIMB_ACCELERATION_M_S2: f32 = 3.0;

fn beyond_dead_zone(deflection: f32) -> f32 {
    let beyond = (deflection.abs() - DEAD_ZONE).max(0.0) / (1.0 - DEAD_ZONE);
    beyond.copysign(deflection)
}

/// The throttle stick from 0 to 1.
pub(super) fn thrust([.., up, _]: Deflections) -> f32 {
    (up + 1.0) / 2.0
}

impl Core {
    /// Takes what a station sends; counted where another one has the vehicle.
    pub fn take_sticks(&mut self, from: Source, deflections: Deflections) {
        let max_age_ns = self.param_ns(ParamId::SticksLossS);
        let is_taken = self.sticks.take(self.now_ns, max_age_ns, from, deflections);
        self.refusals.setpoint_foreign += u64::from(!is_taken);
    }

    /// The sticks, unless they are lost.
    pub(super) fn current_sticks(&self) -> Option<Deflections> {
        self.sticks.current(self.now_ns, self.param_ns(ParamId::SticksLossS))
    }

    /// What the sticks ask for in the present mode. On the ground the motors idle until the throttle goes up. Lost sticks
    /// end in NAV_RCL_ACT.
    pub(super) fn fly_by_sticks(&mut self, held_down_m: Option<f32>, on_ground: bool) -> ControlCommand {
        // After lost setpoints sticks that nobody has are centred, as in PX4.
        let nobodys = (self.commander.failsafe == Some(Failsafe::SetpointLost)).then(Deflections::default);
        let Some(sticks) = self.current_sticks().or(nobodys) else {
            self.lose_sticks();
            return if on_ground || self.commander.terminated || !self.commander.armed {
                ControlCommand::Idle
            } else {
                self.velocity_by(Deflections::default())
            };
        };
        let mode = self.commander.mode;
        if on_ground {
            let lifts = match mode {
                FlightMode::Position | FlightMode::Altitude => beyond_dead_zone(sticks[2]) >= 0.1,
                _ => thrust(sticks) > HOVER_THRUST,
            };
            if !lifts {
                return ControlCommand::Idle;
            }
            self.expect_lift_off();
        }
        match mode {
            FlightMode::Altitude => self.tilt_at_height(sticks, held_down_m),
            FlightMode::Stabilized | FlightMode::Manual => self.attitude_by(sticks),
            FlightMode::Acro => rates_by(sticks),
            _ => self.velocity_by(sticks),
        }
    }

    /// Velocities along the heading, MPC_XY_CRUISE and MPC_Z_VEL_MAX_* at full deflection.
    fn velocity_by(&self, sticks: Deflections) -> ControlCommand {
        let [forward, right, _, clockwise] = sticks.map(beyond_dead_zone);
        let norm = libm::hypotf(forward, right).max(1.0);
        let speed_m_s = self.cruise_speed_m_s(None) / norm;
        let velocity_m_s = HeadingVector::new(forward * speed_m_s, right * speed_m_s, -self.climb_m_s(sticks));
        ControlCommand::VelocityHeading(velocity_m_s, YawCommand::Rate(clockwise * MAX_YAW_RATE_RAD_S))
    }

    fn climb_m_s(&self, [.., up, _]: Deflections) -> f32 {
        let up = beyond_dead_zone(up);
        up * self.param(if up > 0.0 { ParamId::MaxUpMS } else { ParamId::MaxDownMS })
    }

    /// Tilt by the right stick, climb by the throttle; the height is held while that is centred.
    fn tilt_at_height(&mut self, sticks: Deflections, held_down_m: Option<f32>) -> ControlCommand {
        let [forward, right, _, clockwise] = sticks.map(beyond_dead_zone);
        let estimate = self.view.estimate;
        let climb_m_s = self.climb_m_s(sticks);
        let held_down_m = (climb_m_s == 0.0).then(|| held_down_m.unwrap_or(estimate.position_ned_m.z));
        self.commander.maneuver = Maneuver::Sticks { held_down_m };
        let down_m_s = match held_down_m {
            None => -climb_m_s,
            Some(held) => {
                let (up, down) = (self.param(ParamId::MaxUpMS), self.param(ParamId::MaxDownMS));
                ((held - estimate.position_ned_m.z) * HEIGHT_GAIN_PER_S).clamp(-up, down)
            }
        };
        let down_m_s2 = ((down_m_s - estimate.velocity_ned_m_s.z) * CLIMB_GAIN_PER_S)
            .clamp(-MAX_CLIMB_ACCELERATION_M_S2, MAX_CLIMB_ACCELERATION_M_S2);
        let level_m_s2 = |stick: f32| GRAVITY_M_S2 * libm::tanf(stick * MAX_TILT_RAD);
        let wanted = HeadingVector::new(level_m_s2(forward), level_m_s2(right), down_m_s2);
        let acceleration_ned_m_s2 = wanted.to_ned(estimate.attitude.yaw_rad());
        ControlCommand::Acceleration(acceleration_ned_m_s2, YawCommand::Rate(clockwise * MAX_YAW_RATE_RAD_S))
    }

    fn attitude_by(&self, sticks: Deflections) -> ControlCommand {
        let [forward, right, _, clockwise] = sticks.map(beyond_dead_zone);
        let heading_rad = self.view.estimate.attitude.yaw_rad();
        let attitude = Attitude::from_euler_rad(right * MAX_TILT_RAD, -forward * MAX_TILT_RAD, heading_rad);
        ControlCommand::Attitude(attitude, clockwise * MAX_YAW_RATE_RAD_S, thrust(sticks))
    }
}

fn rates_by(sticks: Deflections) -> ControlCommand {
    let [forward, right, _, clockwise] = sticks.map(beyond_dead_zone);
    let rates_frd_rad_s = FrdVector::new(right, -forward, clockwise) * MAX_ACRO_RATE_RAD_S;
    ControlCommand::Rates(rates_frd_rad_s, thrust(sticks))
}
