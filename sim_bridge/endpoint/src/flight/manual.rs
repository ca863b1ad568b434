//! Flying by sticks: MANUAL_CONTROL in position mode. <https://docs.px4.io/main/en/flight_modes_mc/position.html>

use crate::core::{ComponentId, Core};
use crate::flight::control::Maneuver;
use crate::flight::{Failsafe, FlightMode};
use crate::parameters::ParamId;
use vigil_link::common::MavSeverity;
use vigil_types::{HeadingVector, Nanos};
use vigil_vehicle::{ControlCommand, YawCommand};

/// Sticks that are older are lost; PX4's COM_RC_LOSS_T.
const LOST_AFTER_NS: Nanos = 500_000_000;
/// Deflections below this are the centre.
const DEAD_ZONE: f32 = 0.05;
/// Turning rate at full deflection.
const MAX_YAW_RATE_RAD_S: f32 = 1.5;

/// Deflections, each from −1 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Deflections {
    pub forward: f32,
    pub right: f32,
    pub up: f32,
    pub clockwise: f32,
}

/// The newest sticks, and whose they are. Two stations' sticks never mix: who streams keeps the vehicle until silent.
#[derive(Debug, Default)]
pub(crate) struct Sticks {
    newest: Option<(ComponentId, Nanos, Deflections)>,
}

impl Sticks {
    /// Takes what a station sends; `false` if another one has the vehicle.
    pub fn take(&mut self, now_ns: Nanos, from: ComponentId, deflections: Deflections) -> bool {
        let is_others = self.current(now_ns).is_some() && self.newest.is_some_and(|(owner, ..)| owner != from);
        if !is_others {
            self.newest = Some((from, now_ns, deflections));
        }
        !is_others
    }

    /// The sticks, unless they are lost.
    pub fn current(&self, now_ns: Nanos) -> Option<Deflections> {
        self.newest
            .filter(|(_, at_ns, _)| now_ns.saturating_sub(*at_ns) <= LOST_AFTER_NS)
            .map(|(_, _, deflections)| deflections)
    }
}

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
