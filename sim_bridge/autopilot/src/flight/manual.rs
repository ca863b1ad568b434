//! Flying by sticks: MANUAL_CONTROL in position mode. <https://docs.px4.io/main/en/flight_modes_mc/position.html>

use crate::core::Core;
use crate::flight::mode::FlightMode;
use crate::flight::state::{Deflections, Failsafe, Maneuver};
use crate::parameters::ParamId;
use vigil_mavlink::common::MavSeverity;
use vigil_types::HeadingVector;
use vigil_vehicle::{ControlCommand, YawCommand};

/// Deflections below this are the centre.
const DEAD_ZONE: f32 = 0.05;
/// Turning rate at full deflection.
const MAX_YAW_RATE_RAD_S: f32 = 1.5;

fn beyond_dead_zone(deflection: f32) -> f32 {
    let beyond = (deflection.abs() - DEAD_ZONE).max(0.0) / (1.0 - DEAD_ZONE);
    beyond.copysign(deflection)
}

impl Core {
    /// Velocities along the heading, MPC_XY_CRUISE and MPC_Z_VEL_MAX_* at full deflection. On the ground the motors idle
    /// until the stick goes up. Lost sticks end in hold.
    pub(super) fn fly_by_sticks(&mut self, on_ground: bool) -> ControlCommand {
        let Some(sticks) = self.sticks.current(self.now_ns) else {
            self.text(MavSeverity::MAV_SEVERITY_CRITICAL, "manual control lost: hold");
            self.fail_over(FlightMode::Hold, Failsafe::ManualControlLost);
            return if on_ground {
                ControlCommand::Idle
            } else {
                self.fly_by(Deflections::default())
            };
        };
        if on_ground {
            if beyond_dead_zone(sticks.up) < 0.1 {
                return ControlCommand::Idle;
            }
            self.expect_lift_off();
        }
        self.fly_by(sticks)
    }

    fn fly_by(&self, sticks: Deflections) -> ControlCommand {
        let [forward, right, up, clockwise] =
            [sticks.forward, sticks.right, sticks.up, sticks.clockwise].map(beyond_dead_zone);
        let norm = libm::hypotf(forward, right).max(1.0);
        let speed_m_s = self.param(ParamId::CruiseSpeedMS) / norm;
        let climb_m_s = up * self.param(if up > 0.0 { ParamId::MaxUpMS } else { ParamId::MaxDownMS });
        ControlCommand::VelocityHeading {
            velocity_m_s: HeadingVector::new(forward * speed_m_s, right * speed_m_s, -climb_m_s),
            yaw: YawCommand::Rate {
                yaw_rate_rad_s: clockwise * MAX_YAW_RATE_RAD_S,
            },
        }
    }

    /// Enters position mode, if somebody has the sticks.
    pub(super) fn enter_manual(&mut self) -> bool {
        let has_sticks = self.sticks.current(self.now_ns).is_some();
        if has_sticks {
            self.clear_failsafe();
            self.enter(FlightMode::Position, Maneuver::Sticks);
        }
        has_sticks
    }
}
